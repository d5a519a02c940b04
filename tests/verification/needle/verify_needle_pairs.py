#!/usr/bin/python3
"""Checks two rigid needles a few millimetres apart. When one of them is moved, the force on each is compared with that on needles whose surfaces are resolved
(resolved_pair.json). The needles are closer together than an element is wide, so most of the displacement of one by the other is finer than the mesh.
"""
import json
import os
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / folder) for folder in (".", "references")]
import needle_meshes  # noqa: E402: first, because it skips this check if Gmsh is missing
from rows import REPOSITORY, Rows  # noqa: E402

LIMITS = {448: 0.10, 1440: 0.05}  # number of nodes -> largest permitted error in a force; on other meshes, the error is reported but not checked
RECIPROCAL = 0.02                 # largest permitted difference between the two needles' lateral forces, as a fraction of the largest force
LENGTH = 0.2                      # m, default length of the needle
STEP, TICKS, RISE = 1e-3, 300, 100  # STEP: m; TICKS, RISE: 1 ms ticks in total, and while the needle moves


def block(cubes):
    """Returns Kuhn's mesh of the block: nodes, tetrahedra, and faces at z = 0."""
    nodes, tets = needle_meshes.structured("Kuhn", cubes)
    faces = np.concatenate([tets[:, [0, 1, 2]], tets[:, [0, 1, 3]], tets[:, [0, 2, 3]], tets[:, [1, 2, 3]]])
    return nodes, tets, faces[(np.abs(nodes[faces][:, :, 2]) < 1e-9).all(axis=1)]


def stuck_needles(cubes, case):
    """Returns a model of two rigid needles that stick to the tissue."""
    nodes, tets, low = block(cubes)
    scene = trocar.Scene()
    scene.set_mesh(trocar.Mesh(nodes, tets, regions=["tissue"], surfaces=["low"], triangles=low, triangle_surface=[0] * len(low)))
    scene["fixed"] = ["low"]
    for key, value in {"youngs_modulus": case["youngs_modulus"], "poisson_ratio": case["poisson_ratio"], "cutting_force": 1e4, "friction.static": 1e7,
                       "friction.kinetic": 1e7, "friction.viscous": 0}.items():
        scene[f"regions[tissue].{key}"] = value
    scene["needles"], scene["needle.inner_diameter"], scene["needle.youngs_modulus"] = 2, 0, 2e17
    return len(nodes), trocar.Model(scene)


def forces_of_move(sim, bases, moved, axis):
    """Returns the forces (N) on both hands, shape (2, 3), after needle `moved` has been pushed down along z by STEP."""
    for needle in (0, 1):
        sim.reset(bases[needle], needle)
    forces, base = np.zeros((2, 3)), [b.copy() for b in bases]
    for tick in range(TICKS):
        base[moved][axis] = bases[moved][axis] + STEP * min(1.0, tick / RISE) * (-1 if axis == 2 else 1)
        for needle in (0, 1):
            forces[needle] = sim.step(base[needle], 1e-3, needle).force[:3]
    return forces


def compare(rows, case, cubes):
    count, model = stuck_needles(cubes, case)
    sim, apart = trocar.Sim(model), np.ptp([entry[0] for entry, _ in case["needles"]])
    bases = [np.array([*entry[:2], tip[2] + LENGTH, 0.0, 1.0, 0.0, 0.0]) for entry, tip in case["needles"]]
    columns = np.array([[forces_of_move(sim, bases, moved, axis) for axis in range(3)] for moved in (0, 1)])
    for axis, way in enumerate(("across the gap", "sideways", "along")):
        for needle, whose in ((0, "other needle"), (1, "moved needle")):
            value, expected = abs(columns[1, axis, needle, axis]), abs(case["force"][1][axis][needle][axis])
            check, reference = f"{1e3 * apart:g} mm apart, moved {way}, {count} nodes: on the {whose}", "needles' surfaces resolved, CalculiX C3D10"
            if count in LIMITS:
                rows.compare(check, reference, value, expected, LIMITS[count], "N")
            else:
                rows.measured(check, reference, value, expected, abs(value / expected - 1), "N")
    check_coupling(rows, f"{1e3 * apart:g} mm apart, {count} nodes", columns[:, :2, :, :2].reshape(4, 4))


def check_coupling(rows, name, across):
    """Checks that the lateral stiffness of two needles is symmetric and positive. `across` has the forces along x and y on each needle when each needle is
    moved along x and y."""
    rows.error(f"{name}: forces on each other across the needles, difference over the largest", "reciprocity", np.abs(across - across.T).max() / np.abs(across).max(), RECIPROCAL)
    least, largest = np.linalg.eigvalsh(-0.5 * (across + across.T))[[0, -1]]
    rows.add(f"{name}: least stiffness of both across, over the largest", "positive", least / largest, None, max(0.0, -least / largest), 0.0)


def base_of(entry, tip):
    """Returns the base pose of a straight needle with this entry point and tip."""
    along = (np.array(tip) - entry) / np.linalg.norm(np.array(tip) - entry)
    middle = (along + [0, 0, -1]) / np.linalg.norm(along + [0, 0, -1])
    # half a turn about x turns z to -z; another, about the middle between -z and the needle's direction, turns that to the needle's direction
    return np.array([*(tip - LENGTH * along), -middle[0], *np.cross(middle, [1, 0, 0])])


def compare_all(rows, name, case, cubes):
    """Compares all forces: those on both needles when either is moved along x, y or z. Errors are relative to the largest force."""
    count, model = stuck_needles(cubes, case)
    sim, bases = trocar.Sim(model), [base_of(*needle) for needle in case["needles"]]
    values = np.array([[forces_of_move(sim, bases, moved, axis) * (1 if axis == 2 else -1) for axis in range(3)] for moved in (0, 1)])
    expected = np.array(case["force"])
    for one, whose in ((0, "on the moved needle"), (1, "on the other needle")):
        pairs = [(values[moved, :, (moved + one) % 2], expected[moved, :, (moved + one) % 2]) for moved in (0, 1)]
        error = max(np.abs(value - wanted).max() for value, wanted in pairs) / np.abs(expected).max()
        check = f"{name}, {count} nodes: largest error of a force {whose}, over the largest force"
        rows.error(check, "needles' surfaces resolved, CalculiX C3D10", error, LIMITS[count]) if count in LIMITS else rows.measured(
            check, "needles' surfaces resolved, CalculiX C3D10", error, 0.0, error)


def leaning_base(point, lean):
    """Returns the base pose of a needle tilted about y that passes through the point, with its tip 30 mm beyond it."""
    turn, along = 0.5 * (np.pi - lean), np.array([np.sin(lean), 0.0, -np.cos(lean)])
    return np.array([*(point + (0.03 - LENGTH) * along), np.cos(turn), 0.0, np.sin(turn), 0.0])


def cross(rows, case, cubes, apart, angle):
    """Compares needles that pass each other at this distance and angle with the reference."""
    count, model = stuck_needles(cubes, case)
    sim, middle = trocar.Sim(model), np.array([0.001, 0.0011, 0.045])
    bases = [leaning_base(middle + np.array([0, side * apart, 0]), 2 * (side - 0.5) * 0.5 * angle) for side in (0, 1)]
    columns = np.array([[forces_of_move(sim, bases, moved, axis) for axis in (0, 1)] for moved in (0, 1)])
    check_coupling(rows, f"{1e3 * apart:g} mm apart at {np.degrees(angle):.0f} degrees, {count} nodes", columns[:, :, :, :2].reshape(4, 4))


def main():
    rows = Rows.from_arguments(__doc__, "Needles close to each other: force for 1 mm")
    sys.path.insert(0, str(rows.build / "clients/python"))
    os.environ["TROCAR_LIBRARY"] = str(rows.build / "core/libtrocar.so")
    global trocar
    import trocar
    table = json.loads((REPOSITORY / "tests/verification/references/resolved_pair.json").read_text())
    for cubes in ((7, 7, 6), (11, 11, 9)) if rows.short_form else ((7, 7, 6), (11, 11, 9), (19, 19, 15)):
        compare(rows, table["cases"]["apart_5"], cubes)
        for name, what in (("depths_5", "5 mm apart, 80 and 40 mm deep"), ("crossing_30", "5 mm apart at 30 degrees"), ("crossing_60", "5 mm apart at 60 degrees")):
            if name in table["cases"]:
                compare_all(rows, what, table["cases"][name], cubes)
    for apart, angle in ((1.5e-3, 0.0), (3e-3, 0.5), (3e-3, 1.0), (8e-3, 1.0)):
        cross(rows, table["cases"]["apart_5"], (11, 11, 9), apart, angle)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
