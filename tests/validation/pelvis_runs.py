#!/usr/bin/python3
"""Simulates implants in meshes/pelvis.yaml with tissue values drawn at random from their published ranges, for validate_intervals.py and for the figure
random-implants.

usage: pelvis_runs.py spreads|random --count N [--seed S] [--task I/N] [--needles N] FILE.csv

spreads   a Latin hypercube over the ranges in meshes/PARAMETERS.md; the plan is that of docs/examples/implant-plan.yaml, and the operator follows the image,
          with published errors
random    the same ranges; the plan and the kind of operator are drawn at random as well

Each run appends a row to FILE.csv, and runs that the file already contains are skipped, so the command can be repeated after an interruption. Runs are
independent of each other, except that those of `spreads` depend on --count. --task divides the runs among the tasks of a cluster, each of which writes its own
file:

    sbatch --array=1-32 --wrap 'tests/validation/pelvis_runs.py random --count 500 --task $SLURM_ARRAY_TASK_ID/32 out/random-$SLURM_ARRAY_TASK_ID.csv'
"""
import argparse
import csv
import math
import sys
from pathlib import Path

import numpy as np
import trocar
from scipy.stats import norm, qmc
from trocar import brachy
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator

ROOT = Path(__file__).resolve().parents[2]
SCENE, PLAN = ROOT / "meshes/pelvis.yaml", ROOT / "docs/examples/implant-plan.yaml"
GLAND = "prostate"
DT, FINE = 0.02, 0.005      # s, time steps for an implant and for a single needle
STROKE = 0.01               # m; after strokes longer than this, the gland's rotation is measured
FASTER = 0.12               # m/s; a needle is fast if its hand's top speed exceeds this (as in the Alberta study)

# Ranges of Young's modulus from meshes/PARAMETERS.md, log-uniform. All parts of the gland have the same modulus.
MODULI = {"prostate": (16e3, 54e3), "seminal_vesicles": (3e3, 35e3), "bladder": (10e3, 100e3), "urine": (0.3e3, 3e3), "rectum": (10e3, 100e3), "rectal_content": (1e3, 10e3),
          "levator_ani": (20e3, 30e3), "pelvic_floor": (11e3, 50e3), "obturator_internus": (7e3, 15e3), "fat": (3.2e3, 6.6e3), "perineum": (100e3, 600e3)}    # Pa
PARTS = ("transition_zone", "urethra")
POISSON = (0.45, 0.49)      # Poisson's ratio of all regions except the contents of bladder and rectum, uniform
FORCE_SPREAD = 1.31 / 8.96  # relative standard deviation of friction and puncture forces: published scatter between patients of the force on 18 G needles
CUTTING = (0.5, 2.0)        # range of the factor on cutting forces, assumed; log-uniform
CONTENTS = ("urine", "rectal_content")
NAMES = (*MODULI, "poisson", "friction", "puncture", "cutting")


def values_of(unit):
    """Returns the values of one run. `unit` has their quantiles, from 0 to 1."""
    values = {name: low * (high / low) ** u for (name, (low, high)), u in zip(MODULI.items(), unit)}
    poisson, friction, puncture, cutting = unit[len(MODULI):]
    values["poisson"] = POISSON[0] + (POISSON[1] - POISSON[0]) * poisson
    values["friction"], values["puncture"] = 1 + FORCE_SPREAD * norm.ppf(np.clip((friction, puncture), 0.01, 0.99))
    values["cutting"] = CUTTING[0] * (CUTTING[1] / CUTTING[0]) ** cutting
    return values


def scene_of(values):
    scene = trocar.Scene.load(str(SCENE))
    scene["inverse"] = "sparse"    # each run has its own moduli, and computing a dense inverse would take longer than the run
    for region in scene.names("regions"):
        key = f"regions[{region}]"
        scene[f"{key}.youngs_modulus"] = values[GLAND if region in PARTS else region]
        if region not in CONTENTS:
            scene[f"{key}.poisson_ratio"] = values["poisson"]
        scene[f"{key}.cutting_force"] *= values["cutting"]
        for part in ("static", "kinetic"):
            scene[f"{key}.friction.{part}"] *= values["friction"]
    for membrane in ("skin", "capsule"):
        scene[f"membranes[{membrane}].puncture_force"] *= values["puncture"]
    return scene


class Gland:
    """Motion of the gland, as in scripts/implant_report. The base is the 15 % of its nodes that are farthest from the template."""

    def __init__(self, model):
        tets = model.tets_of(GLAND)
        self.nodes = np.unique(tets)
        self.rest = model.nodes[self.nodes]
        self.base = self.rest[:, 2] > np.quantile(self.rest[:, 2], 0.85)
        faces = np.sort(np.concatenate([tets[:, list(corners)] for corners in ((0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3))]), axis=1)
        found, times = np.unique(faces, axis=0, return_counts=True)
        self.surface = np.isin(self.nodes, found[times == 1])

    def turn(self, moved):
        """Returns the rotation matrix (3, 3) that best fits the motion of the nodes."""
        a, b = self.rest - self.rest.mean(0), self.rest + moved - (self.rest + moved).mean(0)
        u, _, v = np.linalg.svd(a.T @ b)
        return v.T @ np.diag([1, 1, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T

    def coronal(self, field):
        """Returns the rotation in the coronal plane, in degrees."""
        turn = self.turn(field[self.nodes])
        return float(np.degrees(np.arctan2(turn[0, 2], turn[2, 2])))

    def shift(self, field):
        """Returns the base's displacement along the needles (m)."""
        return float(field[self.nodes][self.base, 2].mean())

    def in_plane(self, field):
        """Returns the mean motion of the surface in the axial plane (m)."""
        return float(np.linalg.norm(field[self.nodes][self.surface, :2], axis=1).mean())

    def distortion(self, field):
        """Returns a node's largest displacement (m) along x, y and z relative to the gland's rigid motion, to compare with published marker displacements."""
        moved = field[self.nodes]
        fitted = (self.rest - self.rest.mean(0)) @ self.turn(moved).T + (self.rest + moved).mean(0)
        return np.abs(self.rest + moved - fitted).max(0)


def random_plan(model, rng):
    """Returns a plan of 8 to 16 needles in holes drawn at random, at least 7 mm apart, with seeds at random multiples of 5 mm along each needle's path in the
    gland."""
    plan = plans.read(PLAN)
    points = brachy.Structure.from_region(model, GLAND).points
    guide, needles, taken = plans.guide_of(plan, model), [], []
    for cell in rng.permutation(plan.columns * plan.rows):
        hole = plans.hole_name(cell % plan.columns, cell // plan.columns)
        face = plans.hole_axis(guide, hole)
        path = points[np.hypot(*(points - face)[:, :2].T) < 1.5e-3, 2] - face[2]
        if not len(path) or np.ptp(path) < 0.01 or any(np.hypot(*(face - other)[:2]) < 7e-3 for other in taken):
            continue
        depth, room = path.max() - 1e-3, int((np.ptp(path) - 4.5e-3) / 5e-3)
        behind = np.sort(rng.choice(room + 1, min(room + 1, rng.integers(2, 5)), replace=False))
        needles.append(plans.Needle(hole, float(depth), (2.25e-3 + 5e-3 * behind).tolist()))
        taken.append(face)
        if len(needles) == 16:
            break
    plan.needles = needles[:rng.integers(8, 17)]
    return plan


def d90(plan, structure, seeds):
    """Returns the gland's D90 (Gy)."""
    dose = brachy.Dose.at(brachy.Source(f"{plan.source.isotope} {plan.source.model}"), structure.points)
    for seed in seeds:
        dose.add(seed.position, seed.direction, plan.source.strength)
    return float(np.quantile(dose.values, 0.1))


def implant(model, plan, operator):
    """Carries out an implant. Returns its numbers: lengths in mm, angles in degrees, doses in Gy, speeds in m/s."""
    sim, gland, structure = trocar.Sim(model), Gland(model), brachy.Structure.from_region(model, GLAND)
    work = operator.moves(sim, DT)
    turns, fastest, peak, last, full = [], {}, 0.0, None, None
    for needle, poses in work:
        if full is None and needle != last and needle in fastest:    # all needles are in, and the first one is taken again to drop its seeds
            full = sim.displacements()
            lost = sum(not any(contact.kind != "guide" for contact in sim.contacts(i)) for i in range(len(work.needles)))
        out = sim.run(poses, DT, needle)
        if np.ptp(poses[:, 2]) > STROKE:
            turns.append(gland.coronal(sim.displacements()))
        if full is None:
            peak = max(peak, -float(out["force"][:, 2].min()))
            fastest[needle] = max(fastest.get(needle, 0.0), float(np.diff(poses[:, 2]).max(initial=0.0)) / DT)
        last = needle
    errors, planned = work.errors(), plans.planned_seeds(plan, model)
    total = np.array([error.total for error in errors])
    size, place = np.linalg.norm(total, axis=1), np.array([error.planned for error in errors])
    fast = np.array([fastest[error.needle] > FASTER for error in errors])
    low, high, middle = gland.rest.min(0), gland.rest.max(0), structure.points.mean(0)
    third = np.clip(3 * (place[:, 2] - low[2]) / (high[2] - low[2]), 0, 2.999).astype(int)
    mean = lambda chosen: 1e3 * float(size[chosen].mean()) if chosen.any() else float("nan")
    marker = 1e3 * gland.distortion(full)
    return {"needles": len(plan.needles), "seeds": len(planned), "lost_needles": lost, "lost_seeds": len(planned) - len(errors), "peak_force": peak,
            "base_shift": 1e3 * gland.shift(full), "in_plane": 1e3 * gland.in_plane(full), "turn_least": min(turns), "turn_most": max(turns),
            "marker_x": marker[0], "marker_y": marker[1], "marker_z": marker[2],
            "misplacement": mean(size >= 0), **{f"off_{axis}": 1e3 * float(np.abs(total[:, i]).mean()) for i, axis in enumerate("xyz")},
            "along": 1e3 * float(np.mean([error.along("total") for error in errors])), "across": 1e3 * float(np.mean([error.across("total") for error in errors])),
            "slow": mean(~fast), "fast": mean(fast), "anterior": mean(place[:, 1] > middle[1]), "posterior": mean(place[:, 1] <= middle[1]),
            "apex": mean(third == 0), "middle": mean(third == 1), "base": mean(third == 2),
            "d90_planned": d90(plan, structure, planned), "d90": d90(plan, structure, sim.seeds())}


def single(model):
    """Returns how far (mm) a needle inserted to 80 mm displaces the gland's base, alone and with two stabilising needles in place."""
    gland, template = Gland(model), plans.read(PLAN)
    guide = plans.guide_of(template, model)

    def push(sim, needle, hole, speed):
        face = plans.hole_axis(guide, hole)
        steps = round(0.1 / (speed * FINE))
        poses = np.tile([face[0], face[1], 0, 1, 0, 0, 0], (steps, 1))
        poses[:, 2] = np.linspace(-0.02, 0.08, steps) - model.needle_length
        sim.reset(poses[0], needle)
        sim.run(poses, FINE, needle)
        sim.leave(needle)
        return 1e3 * gland.shift(sim.displacements())

    alone = push(trocar.Sim(model), 0, "F4", 0.12)
    held = trocar.Sim(model)
    push(held, 1, "D4", 0.08)
    before = push(held, 2, "J4", 0.08)
    return {"one": alone, "one_stabilised": push(held, 0, "F4", 0.12) - before}


def run(study, index, unit, seed, most=16):
    """Does one run with at most `most` needles. Returns its row."""
    values = values_of(unit)
    rng = np.random.default_rng((seed, index))
    model = trocar.Model(scene_of(values))
    row = {"run": index, "status": "ok", "operator": "image", **values}
    try:
        if study == "random":
            plan = random_plan(model, rng)
            plan.needles = plan.needles[:most]
            row["operator"] = ("image", "marks")[rng.integers(2)]
            results = implant(model, plan, Operator(plan=plan, follows_image=row["operator"] == "image", seed=index + 1))
        else:
            plan = plans.read(PLAN)
            plan.needles = plan.needles[::math.ceil(len(plan.needles) / most)]
            results = {**implant(model, plan, Operator(plan=plan, follows_image=True, seed=index + 1)), **single(model)}
    except (trocar.Error, plans.BadPlan) as error:
        return {**row, "status": str(error)}
    return {**row, **results}


def units(study, count, seed):
    """Returns each run's quantiles, shape (count, parameters). In the study `random`, they do not depend on the number of runs."""
    if study == "spreads":
        return qmc.LatinHypercube(len(NAMES), seed=seed).random(count)
    return np.random.default_rng(seed).random((count, len(NAMES)))


def read(path):
    """Returns the rows of a file of runs, with numeric cells converted."""
    def cell(text):
        try:
            return float(text)
        except ValueError:
            return text or float("nan")
    with open(path, newline="", encoding="utf-8") as file:
        return [{key: cell(value) for key, value in row.items()} for row in csv.DictReader(file)]


def append(path, row):
    """Appends a row. A failed run has fewer cells, so the file's first row, which gives the columns, must be of a run that succeeded."""
    new = not path.exists()
    columns = list(row) if new else next(csv.reader(open(path, newline="", encoding="utf-8")))
    with open(path, "a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="ignore")
        if new:
            table.writeheader()
        table.writerow({key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("spreads", "random"))
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--task", default="1/1", help="I/N: every N-th run, from the I-th on")
    parser.add_argument("--needles", type=int, default=16, help="largest number of needles: 4 for a quick trial, which takes a tenth of the time")
    parser.add_argument("file", type=Path, help="table to which a row is appended for each run")
    given = parser.parse_args()
    task, tasks = map(int, given.task.split("/"))
    done = {int(row["run"]) for row in read(given.file)} if given.file.exists() else set()
    print(f"{given.study}: {given.count} runs, seed {given.seed}, task {task} of {tasks}; {len(done)} done", flush=True)
    for index, unit in enumerate(units(given.study, given.count, given.seed)):
        if index % tasks == task - 1 and index not in done:
            row = run(given.study, index, unit, given.seed, given.needles)
            append(given.file, row)
            print(index, row["status"], flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
