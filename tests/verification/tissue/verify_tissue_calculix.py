#!/usr/bin/python3
"""Compares the tissue's displacements with those of CalculiX's C3D4 elements on the same mesh under the same nodal forces, with one material and with three.

CalculiX integrates the volumetric strain by element, and so does the library here (`volumetric_strain: element`).
"""
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import tissue_model as tm  # noqa: E402
from rows import REPOSITORY, Rows  # noqa: E402

LIMIT = 1e-6
NOTE = "relative to the field's norm; CalculiX prints 7 digits"


def layered_block(path, size):
    """Creates a block of three layers with tilted interfaces, none of them parallel to an axis. The face z = 0 is fixed."""
    tm.start_gmsh()
    occ = tm.gmsh.model.occ
    block = occ.addBox(0, 0, 0, 0.06, 0.05, 0.06)
    cutters = []
    for height, turn in ((0.02, 0.15), (0.04, -0.1)):
        plane = occ.addRectangle(-0.1, -0.1, height, 0.3, 0.3)
        occ.rotate([(2, plane)], 0.03, 0.025, height, 1, 0.5, 0, turn)
        cutters.append((2, plane))
    pieces, _ = occ.fragment([(3, block)], cutters)
    occ.remove([piece for piece in pieces if piece[0] == 2], recursive=True)
    occ.synchronize()
    volumes = [tag for _, tag in tm.gmsh.model.getEntities(3)]
    volumes.sort(key=lambda tag: occ.getCenterOfMass(3, tag)[2])
    return tm.finish_mesh(path, size, {name: [tag] for tag, name in zip(volumes, ("bottom", "middle", "top"))}, {"fixed": tm.faces_at(0.0)})


def load_cases(model):
    """Returns two load cases: a few large forces inside and on the surface, and a force on every node."""
    random = np.random.default_rng(7)
    few, all_over = np.zeros_like(model.nodes), random.normal(size=model.nodes.shape)
    few[random.choice(len(model.nodes), 6, replace=False)] = random.normal(size=(6, 3))
    return [few, all_over]


def compare(rows, name, model, materials):
    cases = load_cases(model)
    ours = tm.solve_core(rows, model, materials, ["fixed"], cases, "element")
    theirs = tm.solve_calculix(model, materials, ["fixed"], cases)
    for load, u, reference in zip(("six nodes loaded", "all nodes loaded"), ours, theirs):
        rows.error(f"{name}, {load}", "CalculiX, C3D4", np.linalg.norm(u - reference) / np.linalg.norm(reference), LIMIT, NOTE)


def main():
    rows = Rows.from_arguments(__doc__, "Tissue: against CalculiX's linear elements")
    block = layered_block(rows.folder / "block.msh", 0.008 if rows.short_form else 0.005)
    compare(rows, f"block of {len(block.nodes)} nodes, one material", block, dict.fromkeys(block.regions, (20e3, 0.45)))
    compare(rows, "the same, three materials", block, {"bottom": (15e3, 0.3), "middle": (80e3, 0.49), "top": (30e3, 0.45)})
    prostate = tm.read_mesh(REPOSITORY / "meshes" / "prostate-570.msh")
    compare(rows, "prostate, two materials", prostate, {"prostate": (60e3, 0.45), "surrounding": (30e3, 0.45)})
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
