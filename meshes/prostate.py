#!/usr/bin/python3
"""Makes a mesh of a prostate in surrounding tissue with Gmsh (Debian: python3-gmsh).

The gland is an ellipsoid in a box. In the world frame (metres), x points to the patient's right, y up (anterior) and z along the
needle from the skin (z = 0) into the body. Physical volumes: `prostate` and `surrounding`. Physical surfaces: `skin` (z = 0),
`capsule` (the gland's surface) and `fixed` (the far face and the bottom face). --layer adds layers between the skin and the gland
as further volumes. --rectum adds an open rectum behind the gland: a round channel from the skin with a rounded end, whose wall is
the surface `rectum_wall`.
"""
import argparse
import math
import statistics
import sys

import gmsh

MM = 1e-3
BOX_LOW = (-50 * MM, -45 * MM, 0.0)
BOX_HIGH = (50 * MM, 45 * MM, 100 * MM)
RECTUM_LENGTH = 80 * MM
RECTUM_DEPTH = 17 * MM         # thickness of the tissue below the rectum; the box is extended to contain it


def box_low(centre, half_axes, rectum):
    """Returns the box's lower corner. rectum: distance from the gland, and radius; or None."""
    low = centre[1] - half_axes[1] - rectum[0] - 2 * rectum[1] - RECTUM_DEPTH if rectum else BOX_LOW[1]
    return (BOX_LOW[0], low, BOX_LOW[2])


def build_geometry(centre, half_axes, layers=(), rectum=None):
    """Divides a box into an ellipsoid, layers [(name, depth of the far side)] under the skin, and the rest. Returns {region: tag}."""
    occ = gmsh.model.occ
    corner = box_low(centre, half_axes, rectum)
    width, height, depth = (high - low for low, high in zip(corner, BOX_HIGH))
    box = occ.addBox(*corner, width, height, depth)
    if rectum:
        distance, radius = rectum
        middle = centre[1] - half_axes[1] - distance - radius
        channel = [(3, occ.addCylinder(centre[0], middle, -radius, 0, 0, RECTUM_LENGTH, radius)),
                   (3, occ.addSphere(centre[0], middle, RECTUM_LENGTH - radius, radius))]
        occ.cut([(3, box)], channel)
    gland = occ.addSphere(*centre, 1.0)
    occ.dilate([(3, gland)], *centre, *half_axes)
    parts, start = [(3, gland)], 0.0
    for _, end in layers:
        layer = [(3, occ.addBox(*corner[:2], start, width, height, end - start))]
        parts += occ.intersect(layer, [(3, box)], removeTool=False)[0] if rectum else layer
        start = end
    pieces, parents = occ.fragment([(3, box)], parts)
    occ.synchronize()
    regions = {name: parent[0][1] for name, parent in zip(["prostate"] + [name for name, _ in layers], parents[1:])}
    regions["surrounding"] = next(tag for _, tag in pieces if tag not in regions.values())
    return regions


def faces_on(axis, coordinate):
    """Returns the tags of the flat surfaces where the coordinate along `axis` equals `coordinate`."""
    def is_flat(tag):
        bounds = gmsh.model.getBoundingBox(2, tag)
        return all(abs(bounds[axis + side] - coordinate) < 1e-6 for side in (0, 3))
    return [tag for _, tag in gmsh.model.getEntities(2) if is_flat(tag)]


def rectum_walls(centre, half_axes, rectum):
    """Returns the tags of the rectum's walls: all surfaces inside a box around the channel except the skin."""
    middle, reach = centre[1] - half_axes[1] - rectum[0] - rectum[1], rectum[1] + 1e-6
    def is_wall(tag):
        low_x, low_y, low_z, high_x, high_y, high_z = gmsh.model.getBoundingBox(2, tag)
        inside = max(abs(low_x - centre[0]), abs(high_x - centre[0]), abs(low_y - middle), abs(high_y - middle)) <= reach
        return inside and high_z > 1e-6
    return [tag for _, tag in gmsh.model.getEntities(2) if is_wall(tag)]


def name_groups(regions, low=BOX_LOW, walls=()):
    capsule = [abs(tag) for _, tag in gmsh.model.getBoundary([(3, regions["prostate"])])]
    fixed = faces_on(2, BOX_HIGH[2]) + faces_on(1, low[1])
    names = ["prostate", "surrounding"] + [name for name in regions if name not in ("prostate", "surrounding")]
    groups = [(3, [regions[name]], name) for name in names] + [
              (2, faces_on(2, BOX_LOW[2]), "skin"), (2, capsule, "capsule"), (2, fixed, "fixed")]
    groups += [(2, walls, "rectum_wall")] if walls else []
    for number, (dimension, tags, name) in enumerate(groups, 1):
        gmsh.model.addPhysicalGroup(dimension, tags, number)
        gmsh.model.setPhysicalName(dimension, number, name)


def set_sizes(centre, half_axes, fine, coarse, low):
    """Sets the element size to `fine` in the gland, increasing linearly to `coarse` at the corners of the box."""
    reach = max(half_axes)
    distance = "Sqrt({})".format("+".join(
        f"(({name})-({c}))^2" for name, c in zip("xyz", centre)))
    span = math.dist(centre, low) - reach
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


def generate_nodes(wanted, centre, half_axes, ratio, low):
    """Searches for an element size that gives about the desired number of nodes. The result is reproducible."""
    volume = math.prod(end - start for start, end in zip(low, BOX_HIGH))
    fine, best = 0.8 * (volume / wanted) ** (1 / 3), None
    for _ in range(12):
        set_sizes(centre, half_axes, fine, ratio * fine, low)
        count = generate()
        if best is None or abs(count - wanted) < abs(best[0] - wanted):
            best = count, fine
        if abs(count - wanted) <= 0.01 * wanted:
            return
        fine *= (count / wanted) ** (1 / 3)
    set_sizes(centre, half_axes, best[1], ratio * best[1], low)
    generate()


# ---- quality ----

def sub(a, b):
    return [p - q for p, q in zip(a, b)]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(p * q for p, q in zip(a, b))


def dihedral_angles(corners):
    """Returns the six dihedral angles of a tetrahedron, degrees."""
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
    parser.add_argument("--nodes", type=int, default=570, help="desired number of nodes (default 570)")
    parser.add_argument("--centre", type=float, nargs=3, default=(0, 0, 55), metavar="MM", help="centre of the gland")
    parser.add_argument("--half-axes", type=float, nargs=3, default=(24, 17, 20), metavar="MM", help="semi-axes of the gland")
    parser.add_argument("--ratio", type=float, default=3.0, help="element size at the corners of the box relative to the gland's")
    parser.add_argument("--layer", nargs=2, action="append", default=[], metavar=("NAME", "MM"),
                        help="a layer under the skin, or under the last layer, that ends at this depth, above the gland")
    parser.add_argument("--rectum", type=float, nargs=2, metavar="MM", help="an open rectum: its distance from the gland, and its radius")
    parser.add_argument("--output", default="prostate-570.msh", help="any format that Gmsh writes (default %(default)s)")
    options = parser.parse_args()
    if options.nodes < 100 or min(options.half_axes) <= 0 or options.ratio < 1:
        parser.error("--nodes must be at least 100, --half-axes positive, --ratio at least 1")
    if options.rectum and min(options.rectum) <= 0:
        parser.error("--rectum: both must be positive")
    rectum = [r * MM for r in options.rectum] if options.rectum else None
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
    regions, low = build_geometry(centre, half_axes, layers, rectum), box_low(centre, half_axes, rectum)
    name_groups(regions, low, rectum_walls(centre, half_axes, rectum) if rectum else [])
    generate_nodes(options.nodes, centre, half_axes, options.ratio, low)
    for name, value in quality().items():
        print(f"{name}: {value}")
    gmsh.write(options.output)
    gmsh.finalize()


if __name__ == "__main__":
    sys.exit(main())
