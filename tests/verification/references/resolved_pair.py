#!/usr/bin/python3
"""Computes the forces on rigid needles close to each other whose surfaces are resolved by the mesh: the reference for verify_needle_pairs.py.

Each needle is represented by a cylindrical hole with a flat end in a block of tissue. All nodes of one needle's surface are moved by 1 mm, without rotation;
those of the others are held. The summed reactions on the needles form a column of the stiffness matrix between them. No code of trocar is used: Gmsh creates
the mesh, and CalculiX solves it with quadratic tetrahedra (C3D10). See README.md next to this file.
Lengths are in m, forces in N, moduli in Pa.
"""
import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gmsh
import numpy as np

from resolved_needle import BALANCE, HALF_WIDTH, HEIGHT, MOVE, a_set, least_jacobian, material, numbered, solver_version, straighten

RADIUS, MODULUS = 0.635e-3, 20e3
# `around`: elements around a needle. `slope`: growth of the element size with distance from the needle's surface. `largest`: element size far from the needles.
MESHES = {"coarse": {"around": 8, "slope": 0.6, "largest": 0.018}, "standard": {"around": 10, "slope": 0.45, "largest": 0.015},
          "fine": {"around": 14, "slope": 0.35, "largest": 0.012}}
BEYOND = 0.010  # m, height above the skin from which the hole is cut
ABOUT = (
    "Forces on rigid needles of radius 0.635 mm bonded to tissue, one of which is moved by 1 mm while the others are held. Lengths in m, forces in N, "
    "modulus 20 kPa. Block |x|, |y| <= 0.06, 0 <= z <= 0.1; z = 0 is held, all else is free. 'needles': where each goes in and where its tip is. "
    "'force': [moved needle][x, y or z that it is moved along][needle][component], the force needed to hold that needle, on the finest mesh solved; a "
    "needle whose entry is null has not been moved, because by symmetry it is like another. 'coarse_above_standard' and 'standard_above_fine': largest "
    "difference of two meshes in any force, over the largest force. 'not_reciprocal': largest difference of two forces that are equal by "
    "reciprocity, over the largest force. Displacement elements are too stiff, so that the exact forces on the moved needle lie below."
)


def vertical(x, y, depth=0.080):
    return [[x, y, HEIGHT], [x, y, HEIGHT - depth]]


def oblique(x, y, angle, azimuth, depth=0.080, crosses=0.0):
    """Returns a needle with a length of `depth` in the tissue, at `angle` degrees to the skin and `azimuth` degrees from x. It passes through (x, y) at the
    skin, or at the depth `crosses` below the skin."""
    along = np.array([math.cos(math.radians(angle)) * math.cos(math.radians(azimuth)), math.cos(math.radians(angle)) * math.sin(math.radians(azimuth)),
                      -math.sin(math.radians(angle))])
    entry = np.array([x, y, HEIGHT - crosses]) + crosses / along[2] * along
    return [entry.round(12).tolist(), (entry + depth * along).round(12).tolist()]


def case(needles, moved=None, nu=0.45):
    """Returns a case to solve. `moved`: numbers of the needles to move, each along x, y and z; by default all of them."""
    return {"radius": RADIUS, "poisson_ratio": nu, "youngs_modulus": MODULUS, "needles": needles, "moved": list(range(len(needles))) if moved is None else moved}


X, Y = 0.0007, 0.0011  # the centre between the needles, which is not on a plane of symmetry of the block


def apart(distance, **more):
    return case([vertical(X - distance / 2, Y), vertical(X + distance / 2, Y)], moved=[1], **more)


def all_cases():
    cases = {f"apart_{1e3 * distance:g}": apart(distance) for distance in (0.003, 0.005, 0.010, 0.020)}
    cases |= {f"apart_5_nu{nu:g}": apart(0.005, nu=nu) for nu in (0.3, 0.49)}
    cases["depths_5"] = case([vertical(X - 0.0025, Y, 0.080), vertical(X + 0.0025, Y, 0.040)])
    cases["shallow_5"] = case([vertical(X - 0.0025, Y, 0.030), vertical(X + 0.0025, Y, 0.030)], moved=[1])
    cases["oblique_5"] = case([oblique(X - 0.020, Y + side, 60, 0) for side in (-0.0025, 0.0025)], moved=[1])
    cases["crossing_30"] = case([vertical(X, Y - 0.0025), oblique(X, Y + 0.0025, 60, 0, crosses=0.040)])
    cases["crossing_60"] = case([vertical(X, Y - 0.0025), oblique(X, Y + 0.0025, 30, 0, 0.080, crosses=0.025)])
    cases["square_5"] = case([vertical(X + 0.0025 * a, Y + 0.0025 * b) for a in (-1, 1) for b in (-1, 1)], moved=[3])
    return cases


CASES = all_cases()


# ---- the mesh --------------------------------------------------------------------------------------------------------

def axis_distance(point, needle):
    """Returns the distance (m) from a point to a needle's axis, extended above the skin. In plain Python, because Gmsh calls it a million times."""
    (ex, ey, ez), (tx, ty, tz) = needle
    wx, wy, wz, x, y, z = ex - tx, ey - ty, ez - tz, point[0] - tx, point[1] - ty, point[2] - tz
    place = max((x * wx + y * wy + z * wz) / (wx * wx + wy * wy + wz * wz), 0.0)
    return math.dist((x, y, z), (place * wx, place * wy, place * wz))


def block_with_needles(one, mesh):
    """Returns nodes (n, 3) and elements (m, 10) in CalculiX's order."""
    radius, needles = one["radius"], one["needles"]
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    occ, holes = gmsh.model.occ, []
    block = occ.addBox(-HALF_WIDTH, -HALF_WIDTH, 0.0, 2 * HALF_WIDTH, 2 * HALF_WIDTH, HEIGHT)
    for entry, tip in needles:
        way = np.subtract(entry, tip)
        holes.append((3, occ.addCylinder(*tip, *(way * (1 + BEYOND / np.linalg.norm(way))), radius)))
    occ.cut([(3, block)], holes)
    occ.synchronize()
    smallest = 2 * math.pi * radius / mesh["around"]

    def size(_dimension, _tag, x, y, z, *_):
        distance = min(axis_distance((x, y, z), needle) for needle in needles) - radius
        return min(mesh["largest"], smallest + mesh["slope"] * max(distance, 0.0))

    gmsh.model.mesh.setSizeCallback(size)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber("Mesh." + option, 0)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("")
    gmsh.model.mesh.setOrder(2)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    elements = np.array(gmsh.model.mesh.getElementsByType(11)[1]).astype(int).reshape(-1, 10)
    gmsh.finalize()
    row = np.zeros(int(max(tags)) + 1, int)
    row[tags.astype(int)] = np.arange(len(tags))
    used, elements = np.unique(row[elements[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]], return_inverse=True)  # Gmsh and CalculiX order the last two nodes differently
    nodes, elements = coordinates.reshape(-1, 3)[used], elements.reshape(-1, 10)
    folded = least_jacobian(nodes, elements) <= 0.0  # a few elements fold because of the curved edges on the holes
    straighten(nodes, elements[folded], np.ones(len(nodes), bool))
    if least_jacobian(nodes, elements).min() <= 0.0:
        sys.exit("resolved_pair: the mesh has folded elements")
    return nodes, elements


def on_needle(one, nodes, needle):
    """Returns the numbers of the nodes on a needle's surface, including its flat end."""
    entry, tip = (np.array(place) for place in one["needles"][needle])
    way = (entry - tip) / np.linalg.norm(entry - tip)
    along = (nodes - tip) @ way
    aside = np.linalg.norm(nodes - tip - along[:, None] * way, axis=1)
    return np.flatnonzero((along > -1e-8) & (aside < one["radius"] + 1e-7))


# ---- the problem for CalculiX ----------------------------------------------------------------------------------------

def steps_of(one):
    return [(needle, axis) for needle in one["moved"] for axis in range(3)]


def static_step(one, moved, axis):
    """Formats one load case. Its boundary conditions replace those of the previous step."""
    lines = ["*STEP\n*STATIC, SOLVER=SPOOLES\n*BOUNDARY, OP=NEW\nFIXED, 1, 3"]
    for needle in range(len(one["needles"])):
        lines += [f"NEEDLE{needle}, {a + 1}, {a + 1}, {MOVE if needle == moved and a == axis else 0.0!r}" for a in range(3)]
    for name in [f"NEEDLE{needle}" for needle in range(len(one["needles"]))] + ["FIXED"]:
        lines.append(f"*NODE PRINT, NSET={name}, TOTALS=ONLY\nRF")
    return "\n".join(lines) + "\n*END STEP\n"


def input_deck(one, nodes, elements):
    deck = "*NODE, NSET=ALL\n" + numbered(nodes) + "*ELEMENT, TYPE=C3D10\n" + numbered(elements + 1)
    deck += a_set("NSET", "FIXED", np.flatnonzero(nodes[:, 2] < 1e-9))
    for needle in range(len(one["needles"])):
        deck += a_set("NSET", f"NEEDLE{needle}", on_needle(one, nodes, needle))
    deck += material("TISSUE", one["youngs_modulus"], one["poisson_ratio"], np.arange(len(elements)))
    return deck + "".join(static_step(one, *step) for step in steps_of(one))


def reactions(one, text):
    """Reads CalculiX's .dat file and returns the forces [moved][axis][needle][component] in N per MOVE."""
    sums = re.findall(r"total force.*for set (\w+) and time.*\n\s*\n\s*(\S+)\s+(\S+)\s+(\S+)", text)
    sets, count = len(one["needles"]) + 1, len(steps_of(one))
    if len(sums) != sets * count:
        sys.exit("resolved_pair: CalculiX printed no reactions; keep its files with --keep and run it by hand")
    values = np.array([xyz for _, *xyz in sums], float).reshape(count, sets, 3)
    if (np.abs(values.sum(axis=1)).max(axis=1) > BALANCE * np.abs(values).max(axis=(1, 2))).any():
        sys.exit("resolved_pair: the reactions don't balance")
    each = iter(values[:, :-1].reshape(-1, 3, sets - 1, 3).tolist())
    return [next(each) if needle in one["moved"] else None for needle in range(len(one["needles"]))]


def solve(one, mesh, folder):
    nodes, elements = block_with_needles(one, mesh)
    (folder / "pair.inp").write_text(input_deck(one, nodes, elements))
    (folder / "pair.dat").unlink(missing_ok=True)
    ccx = subprocess.run(["nice", "ccx", "-i", "pair"], cwd=folder, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    if ccx.returncode or not (folder / "pair.dat").exists():
        sys.exit(f"resolved_pair: ccx failed:\n{ccx.stdout[-2000:]}{ccx.stderr}")
    return {"nodes": len(nodes), "elements": len(elements), "force": reactions(one, (folder / "pair.dat").read_text())}


# ---- the table -------------------------------------------------------------------------------------------------------

def known(force):
    """Returns the columns that were solved, with shape (moved needles, 3, needles, 3)."""
    return np.array([column for column in force if column is not None])


def largest_asymmetry(one, force):
    worst, size = 0.0, np.abs(known(force)).max()
    for a in one["moved"]:
        for b in one["moved"]:
            worst = max(worst, np.abs(np.array(force[a])[:, b] - np.array(force[b])[:, a].T).max())
    return worst / size


def summarise(entry):
    solved = [mesh for mesh in MESHES if mesh in entry["meshes"]]
    force = {mesh: entry["meshes"][mesh]["force"] for mesh in solved}
    entry["force"] = force[solved[-1]]
    entry["not_reciprocal"] = largest_asymmetry(entry, entry["force"])
    for mesh, finer in zip(solved, solved[1:]):
        entry[f"{mesh}_above_{finer}"] = float(np.abs(known(force[mesh]) - known(force[finer])).max() / np.abs(known(force[finer])).max())


def write(path, solved):
    table = {"about": ABOUT, "solver": solver_version(), "mesh_settings": MESHES, "cases": {name: solved[name] for name in CASES if name in solved}}
    text = re.sub(r"\[\s+([^][]*?)\s+\]", lambda m: "[" + re.sub(r"\s+", " ", m[1]) + "]", json.dumps(table, indent=1))
    path.write_text(text + "\n")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases to solve (default: all)")
    parser.add_argument("--mesh", choices=MESHES, default="standard", help="mesh to use (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_suffix(".json"),
                        help="table to add the results to (default: the one next to this script)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep CalculiX's files of the last run in DIR")
    parser.add_argument("--version", action="version", version="resolved_pair 1")
    chosen = parser.parse_args()
    unknown = set(chosen.cases) - set(CASES)
    if unknown:
        parser.error(f"no case named {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    return chosen


def main():
    chosen = arguments()
    table = json.loads(chosen.output.read_text()) if chosen.output.exists() else {"cases": {}}
    solved = table["cases"]
    for name in chosen.cases or CASES:
        start = time.monotonic()
        entry = solved[name] = {**CASES[name], "meshes": solved.get(name, {}).get("meshes", {})}
        with tempfile.TemporaryDirectory() as scratch:
            folder = chosen.keep or Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            result = entry["meshes"][chosen.mesh] = solve(entry, MESHES[chosen.mesh], folder)
        summarise(entry)
        write(chosen.output, solved)
        own = np.diagonal(known(entry["force"])[0, :, entry["moved"][0]])
        other = np.diagonal(known(entry["force"])[0, :, 0 if entry["moved"][0] else 1])
        print(f"{name}: {result['nodes']} nodes, {time.monotonic() - start:.0f} s; moved {own.round(4)} N, other {other.round(4)} N", flush=True)


if __name__ == "__main__":
    main()
