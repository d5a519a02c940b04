#!/usr/bin/python3
"""Creates the figure-8 anatomy on two other kinds of mesh, for verify_smoothness. FOLDER/figure8-structured.msh has 10 mm cubes cut into six tetrahedra each
(Kuhn), with a box as the gland. FOLDER/figure8-graded.msh is unstructured; around the needle's line, its elements grow from 2 mm at the skin to 20 mm at a
depth of 80 mm.

usage: figure8_meshes.py FOLDER
"""
import importlib.util
import sys
from pathlib import Path

import gmsh
import numpy as np

sys.dont_write_bytecode = True
sys.path.insert(0, str(Path(__file__).resolve().parent / "references"))
import needle_meshes  # noqa: E402
from rows import REPOSITORY  # noqa: E402

LOW, HIGH, CELLS = (-0.05, -0.045, 0.0), (0.05, 0.045, 0.1), (10, 9, 10)
GLAND_LOW, GLAND_HIGH = (-0.02, -0.015, 0.03), (0.02, 0.015, 0.07)
GROUPS = ((3, 1, "prostate"), (3, 2, "surrounding"), (2, 3, "skin"), (2, 4, "capsule"), (2, 5, "fixed"))
AT_SKIN, AT_80_MM, SPREAD = 0.002, 0.020, 0.25  # AT_SKIN, AT_80_MM: m; SPREAD: growth of the element size per unit of distance from the line
LINE = (0.005, 0.003)
TINY = 1e-9


def faces_of(tets, wanted):
    """Returns those triangular faces of these tetrahedra whose corners all satisfy `wanted`."""
    faces = np.concatenate([tets[:, face] for face in needle_meshes.FACES])
    return faces[wanted(faces)]


def capsule_of(tets, inside):
    """Returns the triangular faces between the gland's tetrahedra and others."""
    def keyed(chosen):
        faces = np.concatenate([tets[chosen][:, face] for face in needle_meshes.FACES])
        return {tuple(sorted(face)): face for face in faces.tolist()}
    gland, around = keyed(inside), keyed(~inside)
    return np.array([gland[key] for key in sorted(gland.keys() & around.keys())])


def write_structured(path):
    nodes, tets = needle_meshes.structured("Kuhn", CELLS, LOW, HIGH)
    centre = nodes[tets].mean(axis=1)
    inside = ((centre > GLAND_LOW) & (centre < GLAND_HIGH)).all(axis=1)
    skin = faces_of(tets, lambda faces: (np.abs(nodes[faces][..., 2] - LOW[2]) < TINY).all(axis=1))
    fixed = faces_of(tets, lambda faces: (np.abs(nodes[faces][..., 2] - HIGH[2]) < TINY).all(axis=1) | (np.abs(nodes[faces][..., 1] - LOW[1]) < TINY).all(axis=1))
    elements = [(2, 3, face) for face in skin.tolist()] + [(2, 4, face) for face in capsule_of(tets, inside).tolist()]
    elements += [(2, 5, face) for face in fixed.tolist()] + [(4, 1 if gland else 2, tet) for gland, tet in zip(inside, tets.tolist())]
    path.write_text(needle_meshes.msh(nodes, GROUPS, elements))


def write_graded(path):
    spec = importlib.util.spec_from_file_location("prostate", REPOSITORY / "meshes/prostate.py")
    prostate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(prostate)
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
    prostate.name_groups(prostate.build_geometry((0, 0, 0.055), (0.024, 0.017, 0.020)))
    rate = np.log(AT_80_MM / AT_SKIN) / 0.08
    needle_meshes.set_field(f"{AT_SKIN}*exp({rate}*z) + {SPREAD}*sqrt((x-{LINE[0]})^2+(y-{LINE[1]})^2)")
    prostate.generate()
    gmsh.write(str(path))
    gmsh.finalize()


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    write_structured(Path(sys.argv[1]) / "figure8-structured.msh")
    write_graded(Path(sys.argv[1]) / "figure8-graded.msh")
    return 0


if __name__ == "__main__":
    sys.exit(main())
