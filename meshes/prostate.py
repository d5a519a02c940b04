#!/usr/bin/python3
"""Makes a mesh of a prostate in surrounding tissue with Gmsh (Debian: python3-gmsh).

The gland is an ellipsoid in a box. World frame, metres: x to the patient's right, y up (anterior), z along the needle
from the skin (z = 0) into the body. Physical volumes: `prostate`, `surrounding`; physical surfaces: `skin` (z = 0),
`capsule` (the gland's surface) and `fixed` (the far face, and the bottom face with the smallest y). Layers between the skin and
the gland are further volumes (--layer).
"""
import argparse
import math
import statistics
import sys

import gmsh

MM = 1e-3
BOX_LOW = (-50 * MM, -45 * MM, 0.0)
BOX_HIGH = (50 * MM, 45 * MM, 100 * MM)


def build_geometry(centre, half_axes, layers):
    """Fragments a box with an ellipsoid and with layers [(name, depth of its end)] under the skin; returns {region: tag}."""
    occ = gmsh.model.occ
    width, height, depth = (high - low for low, high in zip(BOX_LOW, BOX_HIGH))
    box = occ.addBox(*BOX_LOW, width, height, depth)
    gland = occ.addSphere(*centre, 1.0)
    occ.dilate([(3, gland)], *centre, *half_axes)
    parts, start = [(3, gland)], 0.0
    for _, end in layers:
        parts.append((3, occ.addBox(*BOX_LOW[:2], start, width, height, end - start)))
        start = end
    pieces, parents = occ.fragment([(3, box)], parts)
    occ.synchronize()
    regions = {name: parent[0][1] for name, parent in zip(["prostate"] + [name for name, _ in layers], parents[1:])}
    regions["surrounding"] = next(tag for _, tag in pieces if tag not in regions.values())
    return regions


def faces_on(axis, coordinate):
    """Tags of the flat surfaces on which this coordinate is constant."""
    def is_flat(tag):
        bounds = gmsh.model.getBoundingBox(2, tag)
        return all(abs(bounds[axis + side] - coordinate) < 1e-6 for side in (0, 3))
    return [tag for _, tag in gmsh.model.getEntities(2) if is_flat(tag)]


def name_groups(regions):
    capsule = [abs(tag) for _, tag in gmsh.model.getBoundary([(3, regions["prostate"])])]
    fixed = faces_on(2, BOX_HIGH[2]) + faces_on(1, BOX_LOW[1])
    names = ["prostate", "surrounding"] + [name for name in regions if name not in ("prostate", "surrounding")]
    groups = [(3, [regions[name]], name) for name in names] + [
              (2, faces_on(2, BOX_LOW[2]), "skin"), (2, capsule, "capsule"), (2, fixed, "fixed")]
    for number, (dimension, tags, name) in enumerate(groups, 1):
        gmsh.model.addPhysicalGroup(dimension, tags, number)
        gmsh.model.setPhysicalName(dimension, number, name)


def set_sizes(centre, half_axes, fine, coarse):
    """Element size `fine` in the gland, increasing linearly to `coarse` at the corners of the box."""
    reach = max(half_axes)
    distance = "Sqrt({})".format("+".join(
        f"(({name})-({c}))^2" for name, c in zip("xyz", centre)))
    span = math.dist(centre, BOX_LOW) - reach
    field = gmsh.model.mesh.field
    growth = field.add("MathEval")
    field.setString(growth, "F", f"{fine}+({coarse}-{fine})*({distance}-{reach})/{span}")
    floor = field.add("MathEval")
    field.setString(floor, "F", f"{fine}")
    size = field.add("Max")
    field.setNumbers(size, "FieldsList", [growth, floor])
    field.setAsBackgroundMesh(size)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber("Mesh." + option, 0)


def generate():
    gmsh.model.mesh.clear()
    gmsh.model.mesh.generate(3)
    for _ in range(3):
        gmsh.model.mesh.optimize("")
        gmsh.model.mesh.optimize("Relocate3D")
    return len(gmsh.model.mesh.getNodes()[0])


def generate_nodes(wanted, centre, half_axes, ratio):
    """Searches for the element size that gives about the wanted number of nodes; deterministic."""
    volume = math.prod(high - low for low, high in zip(BOX_LOW, BOX_HIGH))
    fine, best = 0.8 * (volume / wanted) ** (1 / 3), None
    for _ in range(12):
        set_sizes(centre, half_axes, fine, ratio * fine)
        count = generate()
        if best is None or abs(count - wanted) < abs(best[0] - wanted):
            best = count, fine
        if abs(count - wanted) <= 0.01 * wanted:
            return
        fine *= (count / wanted) ** (1 / 3)
    set_sizes(centre, half_axes, best[1], ratio * best[1])
    generate()


# ---- quality ----

def sub(a, b):
    return [p - q for p, q in zip(a, b)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(p * q for p, q in zip(a, b))


def dihedral_angles(corners):
    """The six dihedral angles of a tetrahedron, degrees."""
    for i in range(4):
        for j in range(i):
            k, m = (n for n in range(4) if n not in (i, j))
            edge = sub(corners[m], corners[k])
            p, q = cross(edge, sub(corners[i], corners[k])), cross(edge, sub(corners[j], corners[k]))
            yield math.degrees(math.acos(dot(p, q) / math.sqrt(dot(p, p) * dot(q, q))))


def quality():
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    at = {int(tag): coordinates[3 * i:3 * i + 3].tolist() for i, tag in enumerate(tags)}
    _, flat = gmsh.model.mesh.getElementsByType(4)
    tets = [[int(n) for n in flat[i:i + 4]] for i in range(0, len(flat), 4)]
    edges = {(a, b) for tet in tets for a in tet for b in tet if a < b}
    lengths = [math.dist(at[a], at[b]) for a, b in edges]
    angles = [angle for tet in tets for angle in dihedral_angles([at[n] for n in tet])]
    valence = {}
    for tet in tets:
        for n in tet:
            valence[n] = valence.get(n, 0) + 1
    return {"nodes": len(at), "tetrahedra": len(tets),
            "edges (mm)": f"{min(lengths) / MM:.2f} to {max(lengths) / MM:.2f}",
            "dihedral angles (deg)": f"{min(angles):.2f} to {max(angles):.2f}",
            "tetrahedra around a node": f"up to {max(valence.values())}, median {statistics.median(valence.values()):g}"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, default=570, help="wanted number of nodes (default 570)")
    parser.add_argument("--centre", type=float, nargs=3, default=(0, 0, 55), metavar="MM", help="centre of the gland")
    parser.add_argument("--half-axes", type=float, nargs=3, default=(24, 17, 20), metavar="MM", help="semi-axes of the gland")
    parser.add_argument("--ratio", type=float, default=3.0, help="element size at the corners of the box relative to the gland's")
    parser.add_argument("--layer", nargs=2, action="append", default=[], metavar=("NAME", "MM"),
                        help="a layer under the skin, or under the last layer, that ends at this depth, above the gland")
    parser.add_argument("--output", default="prostate-570.msh", help="any format that Gmsh writes (default %(default)s)")
    options = parser.parse_args()
    if options.nodes < 100 or min(options.half_axes) <= 0 or options.ratio < 1:
        parser.error("--nodes must be at least 100, --half-axes positive, --ratio at least 1")
    centre = [c * MM for c in options.centre]
    half_axes = [a * MM for a in options.half_axes]
    try:
        layers = [(name, float(end) * MM) for name, end in options.layer]
    except ValueError as error:
        parser.error(f"--layer: {error}")
    ends = [0.0] + [end for _, end in layers] + [centre[2] - half_axes[2]]
    if not all(above < below for above, below in zip(ends, ends[1:])):
        parser.error("--layer: every layer must end below the one before it, and above the gland")

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    name_groups(build_geometry(centre, half_axes, layers))
    generate_nodes(options.nodes, centre, half_axes, options.ratio)
    for name, value in quality().items():
        print(f"{name}: {value}")
    gmsh.write(options.output)
    gmsh.finalize()


if __name__ == "__main__":
    sys.exit(main())
