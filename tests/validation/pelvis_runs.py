#!/usr/bin/python3
"""Simulates implants in meshes/pelvis.yaml with tissue values drawn at random from the ranges in meshes/PARAMETERS.md, for validate_intervals.py and for the
figure random-implants. Some of the ranges are published, others assumed.

usage: pelvis_runs.py spreads|random --count N [--case NAME] [--runs N] [--seed S] [--task I/N] [--needles N] FILE.csv

spreads   a Latin hypercube over the ranges; the plan is that of docs/examples/implant-plan.yaml, and the operator follows the image, with published errors.
          --case changes one thing, in the same tissue and with the same random numbers (CASES)
random    the same ranges; the plan and the kind of operator are drawn at random as well

Each run appends a row to FILE.csv, and runs that the file already contains are skipped, so the command can be repeated after an interruption. Rows of
`spreads` that were made by other mechanics, scenes or plans are removed and made again. Runs are independent of each other, except that those of `spreads`
depend on --count. --task divides the runs among the tasks of a cluster, each of which writes its own file:

    sbatch --array=1-32 --wrap 'tests/validation/pelvis_runs.py random --count 500 --task $SLURM_ARRAY_TASK_ID/32 out/random-$SLURM_ARRAY_TASK_ID.csv'
"""
import argparse
import csv
import hashlib
import math
import sys
from pathlib import Path

import numpy as np
import trocar
from scipy.stats import norm, qmc
from trocar import brachy
from trocar._locate import locate
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator
from trocar.motion import towards

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "tests/verification"))
from results import digest_of_mechanics  # noqa: E402

SCENE, PLAN, BLOCK = ROOT / "meshes/pelvis.yaml", ROOT / "docs/examples/implant-plan.yaml", ROOT / "meshes/implant.yaml"
GLAND = "prostate"
DT, FINE = 0.02, 0.005      # s, time steps for an implant and for a single needle
STROKE = 0.01               # m; after strokes longer than this, the gland's rotation is measured
FASTER = 0.12               # m/s; a needle is fast if its hand's top speed exceeds this (as in the Alberta study)
SLICE = 5e-3                # m, distance of the ultrasound slices that Stone et al. compared
CALM = 10.0                 # s after the last needle, four times the longest relaxation time
ANGLE = math.radians(10)    # tilt of angulated stabilising needles, chosen by judgement: the publication's abstract states none
PEAK = 15 / 8               # peak speed of a minimum-jerk stroke, divided by its mean

# What each case of `spreads` changes. Those after "few" show causes, in implants of every second needle (HALF), which take a third of the time.
HALF = {"needles": 8}
CASES = {"published": {}, "before": {"scene": BLOCK, "follows_image": False}, "few": {"needles": 4}, "half": HALF, "sliding": {**HALF, "sliding": True}, "strands": {**HALF, "strands": True},
         "without errors": {**HALF, "image_error": 0.0, "splay": 0.0, "speed_spread": 0.0}, "splay 0": {**HALF, "splay": 0.0}, "splay 2": {**HALF, "splay": 2 * 0.0104},
         "slow": {**HALF, "speed": 0.10 / PEAK, "speed_spread": 0.0}, "fast": {**HALF, "speed": 0.16 / PEAK, "speed_spread": 0.0}}

# Ranges of Young's modulus from meshes/PARAMETERS.md, log-uniform. All parts of the gland have the same modulus.
MODULI = {"prostate": (16e3, 54e3), "seminal_vesicles": (3e3, 35e3), "bladder": (10e3, 100e3), "urine": (0.3e3, 3e3), "rectum": (10e3, 100e3), "rectal_content": (1e3, 10e3),
          "levator_ani": (20e3, 30e3), "pelvic_floor": (11e3, 50e3), "obturator_internus": (7e3, 15e3), "fat": (3.2e3, 6.6e3), "perineum": (100e3, 600e3)}    # Pa
PARTS = ("transition_zone", "urethra")
POISSON = (0.45, 0.49)      # Poisson's ratio of all regions except the contents of bladder and rectum, uniform
FORCE_SPREAD = 1.31 / 8.96  # relative standard deviation of friction and puncture forces: published scatter between patients of the force on 18 G needles
CUTTING = (0.5, 2.0)        # range of the factor on cutting forces, assumed; log-uniform
CONTENTS = ("urine", "rectal_content")
NAMES = (*MODULI, "poisson", "friction", "puncture", "cutting")
CITED = ("prostate", "levator_ani", "obturator_internus", "fat", "friction", "puncture")    # the other ranges are assumed (meshes/parameters/pelvis.csv)
IN_BLOCK = {"muscle": "pelvic_floor", "perineum": "perineum", GLAND: GLAND}    # the block's other region, `surrounding`, keeps its 25 kPa, as no range is published


def digest():
    """Returns a digest of what a run depends on besides this file: the mechanics, which include the operator, scenes, meshes and plan."""
    sources = (SCENE, SCENE.with_suffix(".msh"), BLOCK, BLOCK.with_suffix(".msh"), PLAN)
    return hashlib.sha256(digest_of_mechanics().encode() + b"".join(path.read_bytes() for path in sources)).hexdigest()[:12]


def values_of(unit):
    """Returns the values of one run. `unit` has their quantiles, from 0 to 1."""
    values = {name: low * (high / low) ** u for (name, (low, high)), u in zip(MODULI.items(), unit)}
    poisson, friction, puncture, cutting = unit[len(MODULI):]
    values["poisson"] = POISSON[0] + (POISSON[1] - POISSON[0]) * poisson
    values["friction"], values["puncture"] = 1 + FORCE_SPREAD * norm.ppf(np.clip((friction, puncture), 0.01, 0.99))
    values["cutting"] = CUTTING[0] * (CUTTING[1] / CUTTING[0]) ** cutting
    return values


def scene_of(values, path=SCENE, sliding=False):
    """Returns the scene of a run. `sliding`: the gland slides in the fat instead of being bonded to it."""
    scene = trocar.Scene.load(str(path))
    scene["inverse"] = "sparse"    # each run has its own moduli, and computing a dense inverse would take longer than the run
    for region in scene.names("regions"):
        key = f"regions[{region}]"
        name = GLAND if region in PARTS else IN_BLOCK.get(region) if path == BLOCK else region
        if name:
            scene[f"{key}.youngs_modulus"] = values[name]
        if region not in CONTENTS:
            scene[f"{key}.poisson_ratio"] = values["poisson"]
        scene[f"{key}.cutting_force"] *= values["cutting"]
        for part in ("static", "kinetic"):
            scene[f"{key}.friction.{part}"] *= values["friction"]
    for membrane in ("skin", "capsule"):
        scene[f"membranes[{membrane}].puncture_force"] *= values["puncture"]
    if sliding:
        scene["sliding[capsule].beside"] = "fat"
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
        faces = np.searchsorted(self.nodes, found[times == 1])
        self.surface = np.isin(np.arange(len(self.nodes)), faces)
        self.edges = np.unique(faces[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=0)    # of the surface

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

    def outlines(self, points):
        """Returns the left, right, back and front edge (m) of the gland's outline in axial slices, counted from the base, shape (slices, 4)."""
        (a, b), base, slices = points[self.edges].transpose(1, 0, 2), points[:, 2].max(), []
        for z in np.arange(base - SLICE / 2, points[:, 2].min(), -SLICE):
            cut = (a[:, 2] > z) != (b[:, 2] > z)
            share = (z - a[cut, 2]) / (b[cut, 2] - a[cut, 2])
            outline = a[cut, :2] + share[:, None] * (b[cut, :2] - a[cut, :2])
            slices.append([outline[:, 0].min(), outline[:, 0].max(), outline[:, 1].min(), outline[:, 1].max()])
        return np.array(slices)

    def deformation(self, field):
        """Returns three means (m) over slices and over x and y, as Stone et al. compared outlines: change of an edge's place, change of the gland's width,
        and displacement of the outline's centre. As in their study, slices are counted from the displaced base, so slices of the same number are
        compared, not slices of the same tissue."""
        before, after = self.outlines(self.rest), self.outlines(self.rest + field[self.nodes])
        count = min(len(before), len(after))
        change = (after[:count] - before[:count]).reshape(count, 2, 2)
        return float(np.abs(change).mean()), float(np.abs(np.diff(change)).mean()), float(np.abs(change.mean(2)).mean())

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


def drag(sim, needle):
    """Returns how far (vector, m) the tissue at a needle's tip is ahead of where the mesh's displacements, which are what the operator's image shows, have it:
    from where the image shows the track's end to the tip; zero without a track."""
    tracks = sim.tracks(needle)
    if not len(tracks):
        return np.zeros(3)
    end = tracks[-1].points[-1]
    (tet,), (weights,) = locate(sim.model, [end])
    return sim.centreline(needle)[-1] - end - weights @ sim.displacements()[sim.model.tets[tet]]


def implant(model, plan, operator):
    """Carries out an implant. Returns its numbers: lengths in mm, angles in degrees, doses in Gy, speeds in m/s."""
    sim, gland, structure = trocar.Sim(model), Gland(model), brachy.Structure.from_region(model, GLAND)
    work = operator.moves(sim, DT)
    turns, fastest, peak, last, full, ahead, dropping = [], {}, 0.0, None, None, {}, set()
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
        elif needle not in dropping:
            if sim.pending_seeds(needle) or any(seed.needle == needle for seed in sim.seeds()):
                dropping.add(needle)
            else:
                ahead[needle] = drag(sim, needle)    # the last one before the first seed is dropped counts
        last = needle
    sim.run(np.tile(sim.base(last), (round(CALM / DT), 1)), DT, last)
    out = 1e3 * gland.distortion(sim.displacements())
    errors, planned = work.errors(), plans.planned_seeds(plan, model)
    total = np.array([error.total for error in errors])
    size, place = np.linalg.norm(total, axis=1), np.array([error.planned for error in errors])
    fast = np.array([fastest[error.needle] > FASTER for error in errors])
    low, high, middle = gland.rest.min(0), gland.rest.max(0), structure.points.mean(0)
    third = np.clip(3 * (place[:, 2] - low[2]) / (high[2] - low[2]), 0, 2.999).astype(int)
    mean = lambda chosen: 1e3 * float(size[chosen].mean()) if chosen.any() else float("nan")
    marker = 1e3 * gland.distortion(full)
    axes, along = np.array([error.axis for error in errors]), np.array([error.along("total") for error in errors])
    first = {error.needle: along[i] for i, error in enumerate(errors) if error.number == 1}
    strand = total + axes * np.array([first.get(error.needle, along[i]) - along[i] for i, error in enumerate(errors)])[:, None]
    shown = total + np.array([ahead[error.needle] @ error.axis * error.axis if error.number == 1 else np.zeros(3) for error in errors])
    of_strands, of_shown = (lambda chosen, which=which: 1e3 * float(np.linalg.norm(which[chosen], axis=1).mean()) if chosen.any() else float("nan") for which in (strand, shown))
    edge, width, centre = gland.deformation(full)
    return {"needles": len(plan.needles), "seeds": len(planned), "lost_needles": lost, "lost_seeds": len(planned) - len(errors), "peak_force": peak,
            "base_shift": 1e3 * gland.shift(full), "in_plane": 1e3 * gland.in_plane(full), "turn_least": min(turns), "turn_most": max(turns),
            "marker_x": marker[0], "marker_y": marker[1], "marker_z": marker[2],
            "misplacement": mean(size >= 0), **{f"off_{axis}": 1e3 * float(np.abs(total[:, i]).mean()) for i, axis in enumerate("xyz")},
            "along": 1e3 * float(np.mean([error.along("total") for error in errors])), "across": 1e3 * float(np.mean([error.across("total") for error in errors])),
            "slow": mean(~fast), "fast": mean(fast), "anterior": mean(place[:, 1] > middle[1]), "posterior": mean(place[:, 1] <= middle[1]),
            "apex": mean(third == 0), "middle": mean(third == 1), "base": mean(third == 2),
            "d90_planned": d90(plan, structure, planned), "d90": d90(plan, structure, sim.seeds()),
            **{f"along_{part}": 1e3 * float(np.mean([error.along(part) for error in errors])) for part in ("tissue", "image", "splay", "remainder")},
            **{f"across_{part}": 1e3 * float(np.mean([error.across(part) for error in errors])) for part in ("tissue", "image", "splay", "remainder")},
            "first_remainder": 1e3 * float(np.mean([error.along("remainder") for error in errors if error.number == 1])),
            "first_ahead": 1e3 * float(np.mean([ahead[error.needle] @ error.axis for error in errors if error.number == 1])),
            "first_agree": float(np.corrcoef(*np.array([(error.along("remainder"), ahead[error.needle] @ error.axis) for error in errors if error.number == 1]).T)[0, 1]),
            "base_shown": of_shown(third == 2), "middle_shown": of_shown(third == 1),
            "strand": of_strands(size >= 0), "strand_z": 1e3 * float(np.abs(strand[:, 2]).mean()), "strand_anterior": of_strands(place[:, 1] > middle[1]),
            "strand_posterior": of_strands(place[:, 1] <= middle[1]), "strand_middle": of_strands(third == 1), "strand_base": of_strands(third == 2),
            "edge": 1e3 * edge, "width": 1e3 * width, "centre": 1e3 * centre, "out_x": out[0], "out_y": out[1], "out_z": out[2]}


def single(model):
    """Returns how far (mm) a needle displaces the gland's base while it is pushed to 80 mm: alone, beside two parallel stabilising needles, and beside two
    angulated ones, which cross the parallel ones' axes in the middle of the gland, further outside at the skin."""
    gland, template = Gland(model), plans.read(PLAN)
    guide, middle = plans.guide_of(template, model), gland.rest[:, 2].mean()

    def push(sim, needle, hole, speed, tilt=0.0):
        face = plans.hole_axis(guide, hole)
        steps = round(0.1 / (speed * FINE))
        direction = np.array([math.sin(tilt), 0, math.cos(tilt)])
        poses = np.tile([0, 0, 0, *towards(direction)], (steps, 1))
        poses[:, :3] = [face[0], face[1], middle] + np.outer((np.linspace(-0.02, 0.08, steps) - middle) / direction[2] - model.needle_length, direction)
        sim.reset(poses[0], needle)
        shifts = []
        for part in np.array_split(poses, 20):
            sim.run(part, FINE, needle)
            shifts.append(gland.shift(sim.displacements()))
        sim.leave(needle)
        return 1e3 * max(shifts)

    def beside(tilt):
        sim = trocar.Sim(model)
        for needle, hole in ((1, "D4"), (2, "J4")):
            push(sim, needle, hole, 0.08, math.copysign(tilt, -plans.hole_axis(guide, hole)[0]))
        before = 1e3 * gland.shift(sim.displacements())
        return push(sim, 0, "F4", 0.12) - before

    return {"one": push(trocar.Sim(model), 0, "F4", 0.12), "one_stabilised": beside(0.0), "one_angulated": beside(ANGLE)}


def run(study, index, unit, seed, most=16, case="published"):
    """Does one run with at most `most` needles. Returns its row."""
    values, changes = values_of(unit), {"scene": SCENE, "follows_image": True, **CASES[case]}
    most = changes.pop("needles", most)
    rng = np.random.default_rng((seed, index))
    model = trocar.Model(scene_of(values, changes.pop("scene"), changes.pop("sliding", False)))
    row = {"case": case, "run": index, "digest": digest(), "status": "ok", "operator": "image" if changes["follows_image"] else "marks", **values}
    try:
        if study == "random":
            plan = random_plan(model, rng)
            plan.needles = plan.needles[:most]
            row["operator"] = ("image", "marks")[rng.integers(2)]
            results = implant(model, plan, Operator(plan=plan, follows_image=row["operator"] == "image", seed=index + 1))
        else:
            plan = plans.read(PLAN)
            plan.needles = plan.needles[::math.ceil(len(plan.needles) / most)]
            results = {**implant(model, plan, Operator(plan=plan, seed=index + 1, **changes)), **(single(model) if case == "published" else {})}
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
        return [{key: value if key == "digest" else cell(value) for key, value in row.items()} for row in csv.DictReader(file)]


def append(path, row):
    """Appends a row. A failed run has fewer cells, so the file's first row, which gives the columns, must be of a run that succeeded."""
    new = not path.exists()
    columns = list(row) if new else next(csv.reader(open(path, newline="", encoding="utf-8")))
    with open(path, "a", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, columns, lineterminator="\n", extrasaction="ignore")
        if new:
            table.writeheader()
        table.writerow({key: f"{value:.6g}" if isinstance(value, float) else value for key, value in row.items()})


def remove_stale(path):
    """Removes the rows of a file that were made by other mechanics, scenes or plans."""
    if path.exists():
        with open(path, newline="", encoding="utf-8") as file:
            table = csv.DictReader(file)
            rows, current = list(table), digest()
        fresh = [row for row in rows if row.get("digest") == current]
        if not fresh:
            path.unlink()
        elif len(fresh) < len(rows):
            with open(path, "w", newline="", encoding="utf-8") as file:
                new = csv.DictWriter(file, table.fieldnames, lineterminator="\n")
                new.writeheader()
                new.writerows(fresh)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=("spreads", "random"))
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--case", choices=CASES, default="published", help="what `spreads` changes")
    parser.add_argument("--runs", type=int, help="only the first of --count runs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--task", default="1/1", help="I/N: every N-th run, from the I-th on")
    parser.add_argument("--needles", type=int, default=16, help="largest number of needles: 4 for a quick trial, which takes a tenth of the time")
    parser.add_argument("file", type=Path, help="table to which a row is appended for each run")
    given = parser.parse_args()
    task, tasks = map(int, given.task.split("/"))
    if given.study == "spreads":
        remove_stale(given.file)
    done = {(row.get("case", given.case), int(row["run"])) for row in read(given.file)} if given.file.exists() else set()
    print(f"{given.study}, {given.case}: {given.runs or given.count} of {given.count} runs, seed {given.seed}, task {task} of {tasks}", flush=True)
    for index, unit in enumerate(units(given.study, given.count, given.seed)[:given.runs]):
        if index % tasks == task - 1 and (given.case, index) not in done:
            row = run(given.study, index, unit, given.seed, given.needles, given.case)
            append(given.file, row)
            print(index, row["status"], flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
