#!/usr/bin/python3
"""Measures volumetric locking, i.e. by how much the tissue's tetrahedra become too stiff as Poisson's ratio approaches 0.5.

The prostate's mesh is loaded by a pressure patch on the skin, and along a needle's track. The compliance of a load of total force F, (f . u) / F^2, is
compared with that of CalculiX's quadratic tetrahedra (C3D10, straight sides):
- Loads that do not depend on the mesh (the pressure patch, and a force spread around the track over a radius that every mesh resolves) are compared with
  C3D10 on the finest mesh that CalculiX solves. The difference is the total error, due to both locking and coarseness.
- Point forces along the track, each distributed to the corners of its tetrahedron as a needle's forces are, are compared with C3D10 on the same mesh under
  the same nodal forces. Under a point force, the displacement of a continuum is infinite, so elements of different order differ at any nu. The contacts'
  local compliance accounts for that.

Locking is the increase in error over that at nu = 0.3. The figures show three formulations: volumetric strain by patch (the default), by node, and by element
(the standard linear tetrahedron). Strain by element locks and is shown only for comparison: it has no rows, and its point at nu = 0.499 lies outside the
figures.
"""
import itertools
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import tissue_model as tm  # noqa: E402
from rows import REPOSITORY, SKIPPED, Rows  # noqa: E402

LIMIT = 0.07           # relative just noticeable difference in force
POISSON = (0.3, 0.45, 0.48, 0.49, 0.499)
DEFAULT = 0.45
MESHES = (570, 1700, 3300, 6500)
COARSE = (570, 1700)   # node counts of the meshes on which the total error is reported but not checked
REFERENCES = (570, 1700, 3300)  # node counts of the meshes solved with quadratic elements, which have eight times as many nodes
LOCKING, WHOLE = "Tissue: volumetric locking", "Tissue: error of the elements on coarse meshes"
TRACK = np.stack([np.full(12, 0.005), np.full(12, 0.003), np.linspace(0.0025, 0.0575, 12)], 1)  # the needle's track in the figure-8 scene
SPREAD = 0.006         # m, standard deviation of the force spread around the track
PATCH = 0.025          # m, radius of the pressure patch


def pressure(x):
    """Returns a function for a pressure along z that falls smoothly to zero at the rim of the patch."""
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
    """Returns a dict: name -> nodal forces."""
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


def linear(rows, model, nu, strain):
    cases = load_cases(model)
    return compliances(cases, tm.solve_core(rows, model, materials(nu), ["fixed"], list(cases.values()), strain))


def quadratic(rows, model, nu):
    """Solves with C3D10. The result is cached in the parent folder, because the larger meshes take minutes each."""
    kept = rows.folder.parent / f"locking-{model.path.stem}-{nu}.json"
    if kept.exists() and kept.stat().st_mtime > max(Path(file).stat().st_mtime for file in (model.path, __file__, tm.__file__)):
        return json.loads(kept.read_text())
    print(f"C3D10, {len(model.nodes)} corner nodes, nu = {nu}", flush=True)
    middle = tm.Quadratic(model)
    cases = load_cases(model, 2, middle)
    found = compliances(cases, tm.solve_calculix(model, materials(nu), ["fixed"], list(cases.values()), middle))
    kept.write_text(json.dumps(found))
    return found


def mesh_of(rows, nodes):
    path = REPOSITORY / "meshes" / "prostate-570.msh"
    if nodes != 570:
        path = rows.folder.parent / f"prostate-{nodes}.msh"
        if not path.exists():
            subprocess.run([REPOSITORY / "meshes" / "prostate.py", "--nodes", str(nodes), "--output", path], check=True,
                           capture_output=True)
    return tm.read_mesh(path)


def is_points(load):
    return load.startswith("points")


def report(rows, ours, references):
    """Writes the report. `ours[strain][nodes][nu]` and `references[nodes][nu]` have the compliance for each load."""
    for load in ours["patch"][MESHES[0]][DEFAULT]:
        for strain, nodes in itertools.product(ours, MESHES):
            own = nodes if is_points(load) else max(references)
            if own in references:
                mine, theirs = ([table[nu][load] for nu in POISSON] for table in (ours[strain][nodes], references[own]))
                report_mesh(rows, load, strain, nodes, np.array(mine), np.array(theirs))


def report_mesh(rows, load, strain, nodes, mine, theirs):
    """Reports the compliances at each value of POISSON."""
    too_stiff = theirs / mine - 1
    locking = (1 + too_stiff) / (1 + too_stiff[0]) - 1
    at = POISSON.index(DEFAULT)
    rows.section = LOCKING if is_points(load) else WHOLE
    rows.curve("locking-" + load.replace(",", "").replace(" ", "-"), f"{nodes} nodes, strain by {strain}", POISSON[:-1],
               100 * (locking if is_points(load) else too_stiff)[:-1], "Poisson's ratio",
               f"{load}:\n{'stiffer than at nu = 0.3' if is_points(load) else 'too stiff'} by (%)")
    if strain == "element":
        return
    reference = "C3D10, same mesh and forces" if is_points(load) else f"C3D10, {max(REFERENCES)} nodes"
    case = f"{load}, {nodes} nodes, nu = {DEFAULT}, strain by {strain}"
    rows.section = LOCKING
    rows.add(case, f"{reference}; since nu = {POISSON[0]}", mine[at], theirs[at], abs(locking[at]), LIMIT, "m/N",
             "locks by " + percent(locking))
    if strain == "patch" and not is_points(load):
        rows.section = WHOLE
        if nodes in COARSE and not rows.short_form:
            rows.measured(case, reference, mine[at], theirs[at], abs(too_stiff[at]), "m/N",
                          "linear elements as large as the load's reach: too stiff by " + percent(too_stiff))
        else:
            rows.add(case, reference, mine[at], theirs[at], abs(too_stiff[at]), LIMIT, "m/N", "too stiff by " + percent(too_stiff))


def percent(errors):
    return ", ".join(f"{100 * error:.1f} % at nu = {nu}" for nu, error in zip(POISSON, errors))


def main():
    rows = Rows.from_arguments(__doc__, LOCKING)
    if rows.short_form:
        print("in the full form only: the references take minutes")
        return SKIPPED
    models = {nodes: mesh_of(rows, nodes) for nodes in MESHES}
    references = {nodes: {nu: quadratic(rows, models[nodes], nu) for nu in POISSON} for nodes in REFERENCES}
    ours = {strain: {nodes: {nu: linear(rows, model, nu, strain) for nu in POISSON} for nodes, model in models.items()}
            for strain in ("patch", "node", "element")}
    report(rows, ours, references)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
