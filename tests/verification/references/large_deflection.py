#!/usr/bin/python3
"""Measures what it costs to assume linear elasticity with small strains: computes the forces on a rigid needle at large displacements with CalculiX.

The needle of the case depth_r0.635_nu0.45 of resolved_needle.py is moved by up to 5 mm on a coarser mesh of quadratic tetrahedra: linearly, and with large
displacements (NLGEOM) in two nearly incompressible hyperelastic materials with the same initial moduli,
    neo-Hookean   C10 = mu / 2,  D1 = 2 / K
Yeoh          the same and C20 = S C10, S = 0.2; it stiffens Writes large_deflection.json, which verify_large_deflection.py and scripts/figures read, next to
this script. Takes a quarter of an hour on one core.

usage: large_deflection.py [FOLDER]     FOLDER: folder for CalculiX's files, by default a temporary one
"""
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

import resolved_needle as rn

CASE = rn.CASES["depth_r0.635_nu0.45"]
MESH = {"rim": 1.0, "slope": 1.0, "far_slope": 0.5, "sectors": 8, "largest": 0.02}
STEPS, LARGEST = 5, 5e-3  # m
STIFFENING = 0.2
NO_MORE = 1e10            # D2 and D3, so large that the pressure has no higher-order terms (CalculiX replaces zero with the value of D1)


def hyperelastic(modulus, nu):
    """Returns CalculiX's material definitions by name. A field of its input holds at most twenty characters."""
    mu, bulk = modulus / 2 / (1 + nu), modulus / 3 / (1 - 2 * nu)
    c10, d1 = mu / 2, 2 / bulk
    return {"linear": f"*ELASTIC\n{modulus!r}, {nu!r}\n", "neo-Hookean": f"*HYPERELASTIC, NEO HOOKE\n{c10:.10g}, {d1:.10g}\n",
            "Yeoh": f"*HYPERELASTIC, YEOH\n{c10:.10g}, {STIFFENING * c10:.10g}, 0., {d1:.10g}, {NO_MORE:g}, {NO_MORE:g}\n"}


def deck(mesh, law, large, way):
    nodes, elements, _, fixed, moved = mesh
    motion = "".join(f"MOVED, {axis}, {axis}, {LARGEST * part!r}\n" for axis, part in enumerate(way, 1))
    return ("*NODE, NSET=ALL\n" + rn.numbered(nodes) + "*ELEMENT, TYPE=C3D10\n" + rn.numbered(elements + 1) + rn.a_set("NSET", "FIXED", fixed)
            + rn.a_set("NSET", "MOVED", moved) + rn.a_set("ELSET", "TISSUE", range(len(elements))) + "*MATERIAL, NAME=TISSUE\n" + law
            + "*SOLID SECTION, ELSET=TISSUE, MATERIAL=TISSUE\n" + f"*STEP{', NLGEOM, INC=100' if large else ''}\n*STATIC, SOLVER=SPOOLES\n"
            + (f"{1 / STEPS}, 1., 1e-4, {1 / STEPS}\n" if large else "")
            + f"*BOUNDARY\nFIXED, 1, 3\n{motion}*NODE PRINT, NSET=MOVED, TOTALS=ONLY\nRF\n*END STEP\n")


def solve(folder, name, mesh, law, large, way):
    """Returns the displacements (m) and the forces along the motion (N) at each increment."""
    (folder / f"{name}.inp").write_text(deck(mesh, law, large, way))
    done = subprocess.run(["nice", "ccx", "-i", name], cwd=folder, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    text = (folder / f"{name}.dat").read_text() if (folder / f"{name}.dat").exists() else ""
    found = re.findall(r"total force.*and time\s+(\S+)\s*\n\s*\n\s*(\S+)\s+(\S+)\s+(\S+)", text)
    if done.returncode or not found or abs(float(found[-1][0]) - 1.0) > 1e-6:
        sys.exit(f"large_deflection: ccx did not finish {name}:\n{done.stdout[-2000:]}{done.stderr}")
    return [(LARGEST * float(time), float(np.dot([float(f) for f in force], way))) for time, *force in found]


def main():
    if len(sys.argv) > 2 or (len(sys.argv) == 2 and sys.argv[1].startswith("-")):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(sys.argv[1] if len(sys.argv) == 2 else scratch)
        mesh, table = rn.block_with_needle(CASE, MESH), {}
        for law, definition in hyperelastic(CASE["youngs_modulus_above"], CASE["poisson_ratio"]).items():
            for name, way in (("sideways", (1.0, 0.0, 0.0)), ("axial", (0.0, 0.0, -1.0))):
                found = solve(folder, f"{law}-{name}", mesh, definition, law != "linear", way)
                table.setdefault(law, {})[name] = [{"moved": moved, "force": force} for moved, force in found]
                print(law, name, *(f"{1e3 * moved:.2f} mm {force:.4f} N, {1e-3 * force / moved:.4f} N/mm;" for moved, force in found), flush=True)
    about = ("Force (N) along the motion on a rigid needle bonded to the block, moved by so much (m), axial: inwards; by large_deflection.py. Yeoh: C20 = "
             f"{STIFFENING} C10. linear: proportional, at {1e3 * LARGEST:g} mm.")
    result = {"about": about, "solver": rn.solver_version(), "case": CASE, "mesh": {**MESH, "nodes": len(mesh[0]), "elements": len(mesh[1])}, "forces": table}
    text = re.sub(r"\{\s+(\"moved\"[^{}]*?)\s+\}", lambda m: "{" + re.sub(r"\s+", " ", m[1]) + "}", json.dumps(result, indent=1))
    Path(__file__).with_suffix(".json").write_text(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
