#!/usr/bin/python3
"""Volumetric locking: how much too stiff core's linear tetrahedra become when Poisson's ratio nears 0.5.

The prostate's mesh, under a pressure patch on the skin and along a needle's track. What is compared is the compliance
felt by a load of total force F, (f . u) / F^2; references are CalculiX's quadratic tetrahedra (C3D10, straight sides).
- Loads that do not depend on the mesh, the patch and a force spread around the track over a radius that every mesh
  resolves: against C3D10 on the finest mesh that it solves. The error is the whole error of the elements.
- Points along the track, each shared among the corners of its tetrahedron, as a needle loads the mesh: against C3D10 on
  the same mesh under the same nodal forces. A point force has no finite answer, so elements of another order differ at
  any nu, and the local compliance of the contacts stands for that; the error counts what is added since nu = 0.3.
"""
import subprocess
import sys

import numpy as np

import tissue_model as tm
from rows import REPOSITORY, SKIPPED, Rows

LIMIT = 0.07           # what people notice of a force
POISSON = (0.3, 0.45, 0.48, 0.49, 0.499)
DEFAULT = 0.45
MESHES = (570, 1700, 3300, 6500)
LARGEST_REFERENCE = 3300  # nodes: quadratic elements have eight times as many
TRACK = np.stack([np.full(12, 0.005), np.full(12, 0.003), np.linspace(0.0025, 0.0575, 12)], 1)  # of the figure-8 scene
SPREAD = 0.006         # m, standard deviation of the force spread around the track
PATCH = 0.025          # m, radius of the pressure patch


def pressure(x):
    """Along z, smooth to zero at the patch's rim."""
    r2 = ((x - TRACK[0])[..., :2] ** 2).sum(-1) / PATCH ** 2
    p = np.where(r2 < 1, (1 - r2) ** 2, 0.0)
    return np.stack([0 * p, 0 * p, p], -1)


def around_track(direction):
    def density(x):
        r2 = ((x - TRACK[0])[..., :2] ** 2).sum(-1) / SPREAD ** 2
        along = np.clip(np.minimum(x[..., 2], 0.06 - x[..., 2]) / 0.01, 0, 1)
        return (along * np.exp(-r2 / 2))[..., None] * direction
    return density


def load_cases(model, order=1, middle=None):
    """{name: nodal forces}."""
    sideways, axial = np.eye(3)[1], np.eye(3)[2]
    cases = {"patch on the skin": tm.surface_load(model, model.surfaces["skin"], pressure, order, middle)}
    for name, direction in (("sideways", sideways), ("axial", axial)):
        points = tm.point_load(model, TRACK, direction)
        if middle:
            points = np.concatenate([points, np.zeros((len(middle.pairs), 3))])
        cases[f"points along the track, {name}"] = points
        cases[f"spread around the track, {name}"] = tm.body_load(model, around_track(direction), order, middle)
    return cases


def compliances(cases, displacements):
    return {name: (f * u).sum() / (f.sum(0) ** 2).sum() for (name, f), u in zip(cases.items(), displacements)}


def materials(nu):
    return {"prostate": (60e3, nu), "surrounding": (30e3, nu)}


def linear(rows, model, nu):
    cases = load_cases(model)
    return compliances(cases, tm.solve_core(rows, model, materials(nu), ["fixed"], list(cases.values())))


def reference(model, nu):
    middle = tm.Quadratic(model)
    cases = load_cases(model, 2, middle)
    return compliances(cases, tm.solve_calculix(model, materials(nu), ["fixed"], list(cases.values()), middle))


def mesh_of(rows, nodes):
    path = REPOSITORY / "meshes" / "prostate-570.msh"
    if nodes != 570:
        path = rows.folder.parent / f"prostate-{nodes}.msh"
        if not path.exists():
            subprocess.run([REPOSITORY / "meshes" / "prostate.py", "--nodes", str(nodes), "--output", path], check=True,
                           capture_output=True)
    return tm.read_mesh(path)


def excess(found, load, nodes):
    """How much too stiff at each nu, relative; of point loads, beside what it is at the first nu."""
    solved = [n for n in found if found[n][DEFAULT][1]]
    if not is_points(load):
        return np.array([found[max(solved)][nu][1][load] / ours[load] - 1 for nu, (ours, _) in found[nodes].items()])
    ratio = np.array([same_mesh[load] / ours[load] for ours, same_mesh in found[nodes].values()])
    return ratio / ratio[0] - 1


def is_points(load):
    return load.startswith("points")


def report(rows, found):
    """found[nodes][nu]: compliances by load of core, and of C3D10 on the same mesh or None."""
    finest = max(n for n in found if found[n][DEFAULT][1])
    for load in next(iter(found.values()))[DEFAULT][0]:
        for nodes, by_nu in found.items():
            own = nodes if is_points(load) else finest
            if not found[own][DEFAULT][1]:
                continue
            too_stiff = dict(zip(by_nu, excess(found, load, nodes)))
            note = "too stiff by " + ", ".join(f"{100 * e:.1f} % at nu = {nu}" for nu, e in too_stiff.items())
            rows.add(f"{load}, {nodes} nodes, nu = {DEFAULT}",
                     "C3D10, same mesh and forces, since nu = 0.3" if is_points(load) else f"C3D10, {finest} nodes",
                     by_nu[DEFAULT][0][load], found[own][DEFAULT][1][load], abs(too_stiff[DEFAULT]), LIMIT, "m/N", note)
            rows.curve("locking-" + load.replace(",", "").replace(" ", "-"), f"{nodes} nodes", list(too_stiff),
                       [100 * e for e in too_stiff.values()], "Poisson's ratio", f"{load}: too stiff by (%)")


def main():
    rows = Rows.from_arguments(__doc__, "Tissue: volumetric locking")
    if rows.short_form:
        print("in the full form only: linear tetrahedra exceed the limit at the default nu, as the report says")
        return SKIPPED
    found = {}
    for nodes in MESHES:
        model = mesh_of(rows, nodes)
        found[nodes] = {nu: (linear(rows, model, nu), reference(model, nu) if nodes <= LARGEST_REFERENCE else None)
                        for nu in POISSON}
    report(rows, found)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
