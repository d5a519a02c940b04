#!/usr/bin/python3
"""Measures what it costs to assume linear elasticity with small strains, using the force on a rigid needle moved by up to 5 mm. The reference,
large_deflection.json, was computed by large_deflection.py with CalculiX: linearly, and with large displacements in a neo-Hookean material and in a
stiffening one (Yeoh). The full form solves the neo-Hookean case for sideways motion again. The core's needle is compared with the linear solution and, in
stiffening tissue (the scene's `stiffening`), with the Yeoh material.
"""
import json
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / folder) for folder in (".", "references")]
import needle_meshes  # noqa: E402: first, because it skips this check if Gmsh is missing
import large_deflection as ld  # noqa: E402
from rows import REPOSITORY, Rows  # noqa: E402

LARGE_DISPLACEMENTS = 0.02   # relative error due to large displacements alone, according to docs/mechanics.md
OURS = 0.05
STIFFENING = 0.04
AGAIN = 1e-4                 # repeatability of the results: CalculiX prints seven digits, and how its increments converge depends on rounding
WAYS = {"sideways": (1.0, 0.0, 0.0), "axial": (0.0, 0.0, -1.0)}
WORDS = {"sideways": "sideways", "axial": "along"}


def per_length(point):
    return point["force"] / point["moved"]


def compare_materials(rows, forces):
    for way, word in WORDS.items():
        linear = per_length(forces["linear"][way][-1])
        for law in ("neo-Hookean", "Yeoh"):
            last = per_length(forces[law][way][-1])
            check, reference = f"{law}, {word}: force per length at {1e3 * ld.LARGEST:g} mm", "CalculiX C3D10: linear, same mesh"
            if law == "Yeoh":
                rows.measured(check, reference, last, linear, last / linear - 1, "N/m", "a property of the material: it stiffens next to the needle")
            else:
                rows.compare(check, reference, last, linear, LARGE_DISPLACEMENTS, "N/m")
            rows.curve("large-deflection", f"{law}, {word}", [1e3 * point["moved"] for point in forces[law][way]],
                       [per_length(point) / linear for point in forces[law][way]], "needle moved by (mm)", "force over that of a linear material")


def compare_ours(rows, forces):
    """Compares the core's rigid needle in the same block, on a coarse mesh, with the reference."""
    mesh, case = rows.folder / "large-deflection.msh", ld.CASE
    needle_meshes.block(mesh, 0.0125)
    words = [rows.build / "tests/verification/rigid_needle", mesh, case["radius"], case["poisson_ratio"], *case["axis"], case["tip"],
             case["youngs_modulus_above"], case["youngs_modulus_below"]]
    nodes, _, sideways, along, *_ = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=True).stdout.split()
    for way, force in (("sideways", sideways), ("axial", along)):
        rows.compare(f"the core's needle, {WORDS[way]}, {nodes} nodes", "CalculiX C3D10, linear", 1e3 * float(force), per_length(forces["linear"][way][-1]),
                     OURS, "N/m")


def compare_stiffening(rows, forces):
    """Compares the core's rigid needle in the stiffening block, on meshes of 500 to 10 000 nodes, with the reference, for axial motions of 1 to 5 mm."""
    case = ld.CASE
    for size in (0.0165, 0.0125) if rows.short_form else (0.0165, 0.0125, 0.0095, 0.007, 0.0052):
        mesh = rows.folder / f"stiffening-{1e3 * size:g}.msh"
        needle_meshes.block(mesh, size)
        words = [rows.build / "tests/verification/rigid_needle", mesh, case["radius"], case["poisson_ratio"], *case["axis"], case["tip"],
                 case["youngs_modulus_above"], case["youngs_modulus_below"], ld.STIFFENING]
        nodes, contacts, *found = subprocess.run([str(word) for word in words], capture_output=True, text=True, check=True).stdout.split()
        for point, force in zip(forces["Yeoh"]["axial"], found):
            rows.compare(f"stiffening, along, by {1e3 * point['moved']:g} mm, {nodes} nodes", "CalculiX C3D10, Yeoh", float(force), point["force"], STIFFENING, "N",
                         f"{contacts} contacts")


def solve_again(rows, forces):
    mesh, law = ld.rn.block_with_needle(ld.CASE, ld.MESH), ld.hyperelastic(ld.CASE["youngs_modulus_above"], ld.CASE["poisson_ratio"])["neo-Hookean"]
    with tempfile.TemporaryDirectory() as folder:
        found = ld.solve(Path(folder), "again", mesh, law, True, WAYS["sideways"])
    rows.compare("neo-Hookean, sideways, solved again", "large_deflection.json", found[-1][1], forces["neo-Hookean"]["sideways"][-1]["force"], AGAIN, "N")


def main():
    rows = Rows.from_arguments(__doc__, "Large deflection: what small strains cost")
    forces = json.loads((REPOSITORY / "tests/verification/references/large_deflection.json").read_text())["forces"]
    compare_materials(rows, forces)
    compare_ours(rows, forces)
    compare_stiffening(rows, forces)
    if not rows.short_form:
        solve_again(rows, forces)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
