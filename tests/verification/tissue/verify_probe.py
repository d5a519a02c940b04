#!/usr/bin/python3
"""Compares the probe, pressed into a block that contains a gland, with CalculiX on the same mesh.

CalculiX uses C3D4 elements, small strains, and frictionless node-to-surface penalty contact between the wall's nodes and the probe. Its probe is a body with
flat facets, whose nodes are all moved by the depth. Both programs evaluate the volumetric strain in each element. The penalty and the facets give the
reference an error of about 1 %.

The full form also shows which contact is right on a coarse mesh. On meshes of several sizes, it compares two forces: trocar's, which keeps only the wall's
nodes out of the probe, and CalculiX's with surface-to-surface contact, which keeps the wall's whole faces out. Both decrease to the same force as elements
become smaller.
"""
import os
import re
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import tissue_model as tm  # noqa: E402
from rows import Rows  # noqa: E402

LIMIT = 0.05
RADIUS, LENGTH, DEPTH = 0.010, 0.06, 0.006
TIP = 0.008                                  # m, how far the tip is beyond the middle of the block
WALL = 0.045                                 # m, height of the wall that the probe presses on
MATERIALS = {"gland": (60e3, 0.45), "surrounding": (20e3, 0.45)}
PENALTY = 3e9                                # N/m^3, penalty stiffness; for comparison, that of an element of the wall is about E / h = 5e6
FACET = 0.0012


def block(path, size):
    """Creates a block with an ellipsoid, the gland, 20 mm below its upper face, which is the wall. The bottom is fixed."""
    tm.start_gmsh()
    occ = tm.gmsh.model.occ
    box, ball = occ.addBox(-0.04, -0.03, 0, 0.08, 0.06, WALL), occ.addSphere(0, 0, 0, 0.016)
    occ.dilate([(3, ball)], 0, 0, 0, 1.3, 1, 0.8)
    occ.translate([(3, ball)], 0, 0, 0.022)
    occ.fragment([(3, box)], [(3, ball)])
    occ.synchronize()
    volumes = sorted((occ.getMass(3, tag), tag) for _, tag in tm.gmsh.model.getEntities(3))
    return tm.finish_mesh(path, size, {name: [tag] for (_, tag), name in zip(volumes, ("gland", "surrounding"))},
                          {"fixed": tm.faces_at(0.0), "wall": tm.faces_at(WALL)})


def cylinder():
    """Returns the probe's body as it touches the wall: nodes (k, 3) and tetrahedra."""
    tm.start_gmsh()
    occ = tm.gmsh.model.occ
    height = WALL + RADIUS
    parts = [(3, occ.addCylinder(TIP - LENGTH, 0, height, LENGTH - RADIUS, 0, 0, RADIUS)), (3, occ.addSphere(TIP - RADIUS, 0, height, RADIUS))]
    occ.fuse(parts[:1], parts[1:])
    occ.synchronize()
    for option in ("MeshSizeMin", "MeshSizeMax"):
        tm.gmsh.option.setNumber("Mesh." + option, FACET)
    tm.gmsh.model.mesh.generate(2)
    tags, coordinates, _ = tm.gmsh.model.mesh.getNodes()
    triangles = tm.gmsh.model.mesh.getElementsByType(tm.TRIANGLE)[1].astype(int).reshape(-1, 3)
    tm.gmsh.finalize()
    used, index = np.unique(triangles, return_inverse=True)
    position = dict(zip(tags.tolist(), coordinates.reshape(-1, 3)))
    return np.array([position[tag] for tag in used.tolist()]), index.reshape(-1, 3)


FACES = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))    # faces S1 to S4 of CalculiX's tetrahedra


def wall_faces(model):
    """Yields the wall's faces as "element, face" in CalculiX's numbering."""
    wall = {tuple(sorted(triangle)) for triangle in model.surfaces["wall"].tolist()}
    for t, corners in enumerate(model.tets.tolist(), 1):
        for f, face in enumerate(FACES, 1):
            if tuple(sorted(corners[i] for i in face)) in wall:
                yield f"{t}, S{f}"


def deck(model, nodes, triangles, faces):
    """Returns CalculiX's input deck. Each facet of the probe belongs to a tetrahedron toward the axis that is only there to carry the facet. With `faces`,
    contact uses the wall's faces instead of its nodes."""
    first = len(model.nodes)
    ends = nodes[triangles]
    centre = ends.mean(1)
    inner = np.stack([np.clip(centre[:, 0], TIP - LENGTH + 2e-3, TIP - RADIUS), np.zeros(len(centre)), np.full(len(centre), WALL + RADIUS)], 1)
    normal = np.cross(ends[:, 1] - ends[:, 0], ends[:, 2] - ends[:, 0])
    flipped = np.einsum("kx,kx->k", normal, inner - centre) < 0
    triangles = np.where(flipped[:, None], triangles[:, [0, 2, 1]], triangles)    # so that the volume with the inner node is positive
    total = first + len(nodes)
    yield "*NODE, NSET=ALL"
    for i, (x, y, z) in enumerate(np.concatenate([model.nodes, nodes, inner]).tolist(), 1):
        yield f"{i},{x:.13e},{y:.13e},{z:.13e}"
    for name, members in model.regions.items():
        yield f"*ELEMENT, TYPE=C3D4, ELSET={name}"
        yield from (",".join(map(str, [t + 1] + (model.tets[t] + 1).tolist())) for t in members.tolist())
    yield "*ELEMENT, TYPE=C3D4, ELSET=BODY"
    count = len(model.tets)
    for k, (a, b, c) in enumerate((triangles + first + 1).tolist()):
        yield f"{count + k + 1},{a},{b},{c},{total + k + 1}"
    for name, (e, nu) in [*MATERIALS.items(), ("BODY", (1e6, 0.3))]:
        yield f"*MATERIAL, NAME={name}\n*ELASTIC\n{e:.13e},{nu:.13e}\n*SOLID SECTION, ELSET={name}, MATERIAL={name}"
    sets = {"HELD": np.unique(model.surfaces["fixed"]), "PRESSED": np.unique(model.surfaces["wall"]), "MOVED": np.arange(first, total + len(inner))}
    for name, members in sets.items():
        yield f"*NSET, NSET={name}"
        yield from (f"{i + 1}," for i in members.tolist())
    yield from ["*SURFACE, NAME=WALL, TYPE=ELEMENT", *wall_faces(model)] if faces else ["*SURFACE, NAME=WALL, TYPE=NODE\nPRESSED"]
    yield "*SURFACE, NAME=FACETS\n" + "\n".join(f"{count + k + 1}, S1" for k in range(len(triangles)))
    yield f"*SURFACE INTERACTION, NAME=HARD\n*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR\n{PENALTY:g}, 1e-3, 1e-4"
    yield f"*CONTACT PAIR, INTERACTION=HARD, TYPE={'SURFACE' if faces else 'NODE'} TO SURFACE\nWALL, FACETS"
    yield "*BOUNDARY\nHELD, 1, 3"
    yield f"*STEP, INC=500\n*STATIC\n0.1, 1., 1e-6, 0.2\n*BOUNDARY\nMOVED, 1, 2\nMOVED, 3, 3, {-DEPTH}"
    yield "*NODE PRINT, NSET=ALL, FREQUENCY=1000\nU\n*NODE PRINT, NSET=HELD, TOTALS=ONLY, FREQUENCY=1000\nRF\n*END STEP"


def solve_calculix(model, faces=False):
    nodes, triangles = cylinder()
    text = tm.run_calculix(deck(model, nodes, triangles, faces))
    total = re.findall(r"total force.*\n\s*\n\s*(\S+)\s+(\S+)\s+(\S+)", text)[-1]
    body = text[text.rindex("displacements (vx,vy,vz)"):]
    rows = [line.split() for line in body.splitlines()[1:] if re.match(r"\s+\d+\s+\S+\s+\S+\s+\S+$", line)][:len(model.nodes)]
    return np.array([row[1:] for row in rows], float), np.array(total, float)


def solve_trocar(rows, model):
    os.environ["TROCAR_LIBRARY"] = str(rows.build / "core/libtrocar.so")
    sys.path.insert(0, str(rows.build / "clients/python"))
    import trocar
    scene = trocar.Scene()
    scene["mesh"] = str(model.path)
    for name, (e, nu) in MATERIALS.items():
        scene[f"regions[{name}].youngs_modulus"], scene[f"regions[{name}].poisson_ratio"] = e, nu
    scene["fixed"] = ["fixed"]
    scene["volumetric_strain"] = "element"
    scene["probe.surface"], scene["probe.radius"], scene["probe.tip_radius"], scene["probe.length"] = "wall", RADIUS, RADIUS, LENGTH
    sim = trocar.Sim(trocar.Model(scene))
    away, half = [0, 0, 1, 1, 0, 0, 0], np.sqrt(0.5)
    sim.reset(away)
    sim.set_probe([TIP - LENGTH, 0, WALL + RADIUS - DEPTH, half, 0, half, 0])    # turned so that the probe's +z points along x
    sim.step(away, 1e-3)
    return sim.displacements(), sim.probe


def refine(rows):
    finest = solve_trocar(rows, block(rows.folder / "probe.msh", 0.003))[1].force[2]
    for size in (0.006, 0.004):
        model = block(rows.folder / "probe.msh", size)
        nodes, (_, faces) = solve_trocar(rows, model)[1].force[2], solve_calculix(model, faces=True)
        for what, force in (("nodes, by trocar", nodes), ("whole faces, by CalculiX", faces[2])):
            rows.measured(f"force, elements of {1e3 * size:g} mm, kept out: {what}", "trocar, elements of 3 mm", force, finest, force / finest - 1, "N")


def main():
    rows = Rows.from_arguments(__doc__, "Probe: against contact in CalculiX")
    model = block(rows.folder / "probe.msh", 0.006 if rows.short_form else 0.004)
    u, probe = solve_trocar(rows, model)
    reference, held = solve_calculix(model)
    gland, wall = np.unique(model.tets[model.regions["gland"]]), np.unique(model.surfaces["wall"])
    name = f"{len(model.nodes)} nodes, {len(wall)} of the wall, {probe.contacts} pressed"
    rows.compare(f"force, {name}", "CalculiX, contact", probe.force[2], held[2], LIMIT, "N", f"pressed {1e3 * DEPTH:g} mm deep")
    rows.compare("displacement of the gland, mean", "CalculiX, contact", 1e3 * -u[gland, 2].mean(), 1e3 * -reference[gland, 2].mean(), LIMIT, "mm")
    for what, nodes in (("gland", gland), ("wall", wall)):
        rows.error(f"displacements of the {what}'s nodes", "CalculiX, contact", np.linalg.norm(u[nodes] - reference[nodes]) / np.linalg.norm(reference[nodes]),
                   LIMIT, "relative to the field's norm")
    if not rows.short_form:
        refine(rows)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
