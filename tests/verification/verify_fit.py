#!/usr/bin/python3
"""Verifies trocar-fit's confidence intervals with noisy synthetic recordings whose parameters are known.

Each data set is an insertion into a block of two layers by a hand that pauses (relaxation), turns the bevel by half a turn, moves sideways and draws back.
Its parameters are drawn at random between the limits of TRUTH; the fit starts at the scene's own values, the same for all sets, and has bounds beyond those
limits. Noise is normal: NOISE for each sample of force, torque and the position of tracked points. About 95 % of the 95 % intervals must contain the true
value, and the errors divided by their computed standard deviations must have a root mean square of about 1. The full form also writes docs/results/fit.csv.
"""
import csv
import multiprocessing
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

os.environ["OPENBLAS_NUM_THREADS"] = "1"
import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent / folder) for folder in (".", "references")]
import needle_meshes as nm  # noqa: E402
from rows import REPOSITORY, Rows  # noqa: E402

rows = Rows.from_arguments(__doc__, "Fit: confidence intervals")
sys.path.insert(0, str(Path(rows.build) / "clients/python"))
os.environ["TROCAR_LIBRARY"] = str(Path(rows.build) / "core/libtrocar.so")
sys.dont_write_bytecode = True
from trocar import motion  # noqa: E402
from trocar.studies import fit  # noqa: E402

SETS = 5 if rows.short_form else 100
RATE = 500                                                            # Hz
NOISE = {"force": 0.03, "torque": 2e-3, "position": 0.3e-3}           # standard deviations: N, N m, m
POINTS = {"shallow": (0.008, 0.0, 0.080), "middle": (0.0, 0.010, 0.060), "below": (-0.008, 0.0, 0.040), "deep": (0.0, -0.006, 0.025)}    # m
FORCE_PERIOD, POINT_PERIOD = 0.005, 0.05                              # s between samples
START = (0.0031, -0.0027, 0.301, 0.0, 1.0, 0.0, 0.0)                  # tip 1 mm above the skin, pointing down
HALF_TURN = (0.0, 0.0, np.pi)
LEGS = [(0.0, 0.45, (0, 0, 0.045)), (0.7, 0.9, (0, 0, 0), HALF_TURN), (0.9, 1.2, (0, 0, 0.030)), (1.25, 1.32, (0, 0.003, 0)), (1.55, 1.85, (0, 0, -0.040))]
SECONDS = 1.85

# For each key: value in the scene, where the fit starts; limits between which the true value is drawn; bounds of the fit.
TRUTH = {
    "regions[upper].youngs_modulus": (20e3, (14e3, 28e3), (4e3, 100e3)),
    "regions[lower].youngs_modulus": (40e3, (28e3, 56e3), (8e3, 200e3)),
    "regions[lower].stiffening": (0.5, (0.2, 0.8), (0.0, 2.0)),
    "regions[upper].friction.kinetic": (8, (6, 10), (1, 12)),
    "regions[lower].friction.kinetic": (8, (6, 10), (1, 12)),
    "regions[upper].cutting_force": (0.3, (0.2, 0.4), (0.0, 1.0)),
    "regions[lower].cutting_force": (0.5, (0.35, 0.65), (0.0, 1.5)),
    "relaxation[0].weight": (0.3, (0.2, 0.4), (0.02, 0.7)),
    "relaxation[0].time": (0.15, (0.1, 0.2), (0.02, 1.0)),
    "needle.bevel_slope": (0.1, (0.05, 0.15), (0.0, 0.3)),
}
SCENE = """mesh: block.msh
rate_hz: {rate}
regions:
  - {{name: upper, youngs_modulus: 20e3, cutting_force: 0.3, cutting_viscosity: 1, friction: {{static: 12, kinetic: 8, viscous: 20}}}}
  - {{name: lower, youngs_modulus: 40e3, stiffening: 0.5, cutting_force: 0.5, cutting_viscosity: 1, friction: {{static: 12, kinetic: 8, viscous: 20}}}}
relaxation: [{{weight: 0.3, time: 0.15}}]
fixed: [fixed]
needle: {{bevel_slope: 0.1, segments: 20}}
"""


def write_problem(folder):
    """Writes the scene, the mesh, the hand's poses and a fit whose measurements are still empty."""
    nodes, tets = nm.structured("five", (6, 6, 8))
    nm.write(folder / "block.msh", nodes, tets, nodes[tets].mean(axis=1)[:, 2] < 0.05)
    (folder / "scene.yaml").write_text(SCENE.format(rate=RATE))
    time_ = np.arange(round(SECONDS * RATE) + 1) / RATE
    start = np.array(START)
    poses = motion.Script(start=start, legs=tuple(motion.Leg(*leg) for leg in LEGS), seconds=SECONDS).poses(start, 1.0 / RATE)
    np.savetxt(folder / "poses.csv", np.column_stack([time_, poses]), "%.17g", ",", header="t,x,y,z,qw,qx,qy,qz", comments="")
    times = np.arange(0.0, SECONDS, FORCE_PERIOD)
    np.savetxt(folder / "forces.csv", np.column_stack([times, np.zeros((len(times), 6))]), "%.17g", ",",
               header="t [s],fx [N],fy [N],fz [N],tx [N m],ty [N m],tz [N m]", comments="")
    times = np.arange(0.0, SECONDS, POINT_PERIOD)
    np.savetxt(folder / "points.csv", np.column_stack([times, np.zeros((len(times), 3 * len(POINTS)))]), "%.17g", ",",
               header=",".join(["t [s]", *(f"{name}_{axis} [m]" for name in POINTS for axis in "xyz")]), comments="")
    lines = ["scene: scene.yaml", "recordings: [{poses: poses.csv, forces: forces.csv, points: points.csv}]",
             f"points: {{{', '.join(f'{name}: [{x}, {y}, {z}]' for name, (x, y, z) in POINTS.items())}}}",
             f"noise: {{{', '.join(f'{kind}: {value}' for kind, value in NOISE.items())}}}", "parameters:",
             *(f"  {key}: {{within: [{low}, {high}]}}" for key, (_, _, (low, high)) in TRUTH.items())]
    (folder / "fit.yaml").write_text("\n".join(lines) + "\n")
    return folder / "fit.yaml"


class Set(NamedTuple):
    """A data set: true values, estimates, limits of their intervals, whether the search converged, CPU time (s), and number of simulations."""

    truth: list[float]
    value: list[float]
    low: list[float]
    high: list[float]
    converged: bool
    seconds: float
    simulations: int


def one_set(path, number):
    """Creates and fits data set `number`, which is also the random seed."""
    begin = time.process_time()
    problem = fit.read(path)
    random = np.random.default_rng(number)
    truth = np.array([random.uniform(*limits) for _, limits, _ in TRUTH.values()])
    recording, = problem.recordings
    clean, = fit.simulate(problem, truth)
    recording.channels = [replace(channel, values=values + NOISE[channel.kind] * random.standard_normal(len(values))) for channel, values in zip(recording.channels, clean)]
    found = fit.fit(problem)
    value, low, high = ([getattr(estimate, part) for estimate in found.estimates] for part in ("value", "low", "high"))
    return Set(truth.tolist(), value, low, high, found.converged, time.process_time() - begin, found.simulations)


def report(sets):
    """Adds the rows of the report and, in the full form, writes the table."""
    truth, value, low, high = (np.array([getattr(each, part) for each in sets]) for part in ("truth", "value", "low", "high"))
    inside, keys = (low <= truth) & (truth <= high), list(TRUTH)
    log = np.array([bounds[0] > 0.0 for _, _, bounds in TRUTH.values()])
    to = lambda x: np.where(log, np.log(np.maximum(x, 1e-300)), x)
    errors = (to(value) - to(truth)) / np.maximum((to(high) - to(low)) / 3.92, 1e-12)    # an interval is 3.92 standard deviations wide, except at a bound
    reference, short, count = "known parameters", rows.short_form, len(sets)
    part, spread, lost = inside.mean(), float(np.sqrt(np.mean(errors ** 2))), sum(not each.converged for each in sets)
    rows.add("95 % intervals that contain the true value, all parameters", reference, part, 0.95, abs(part - 0.95), 0.10 if short else 0.03,
             note=f"{count} data sets; absolute difference")
    # Five sets are too few to judge this value, because the errors within a set are correlated.
    judge = rows.measured if short else lambda *row: rows.add(*row, 0.1)
    judge("errors over their standard deviation, root mean square", reference, spread, 1.0, abs(spread - 1.0))
    rows.add("fits that do not converge", reference, float(lost), None, lost / count, 0.0 if short else 0.02, note=f"of {count}; part of them")
    table = [["parameter", "data sets", "true value in the 95 % interval", "median error [%]", "median half-width of the interval [%]", "rms error over standard deviation"]]
    for i, key in enumerate(keys):
        if not short:
            rows.add(f"{key}: intervals that contain the true value", reference, inside[:, i].mean(), 0.95, abs(inside[:, i].mean() - 0.95), 0.07,
                     note="limit: three standard deviations of a binomial distribution")
        off, half = 100.0 * np.abs(value[:, i] / truth[:, i] - 1.0), 50.0 * (high[:, i] - low[:, i]) / truth[:, i]
        table.append([key, str(count), str(int(inside[:, i].sum())), f"{np.median(off):.2g}", f"{np.median(half):.2g}", f"{np.sqrt(np.mean(errors[:, i] ** 2)):.2f}"])
    for line in table:
        print("  ".join(line))
    seconds = np.array([each.seconds for each in sets])
    print(f"processor time of a fit: median {np.median(seconds):.1f} s, all {seconds.sum():.0f} s; simulations: median {np.median([each.simulations for each in sets]):.0f}")
    if not short:
        with open(REPOSITORY / "docs/results/fit.csv", "w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(table)
    return rows.end()


def main():
    with tempfile.TemporaryDirectory() as folder:
        path = write_problem(Path(folder))
        with multiprocessing.Pool(len(os.sched_getaffinity(0))) as pool:
            sets = pool.starmap(one_set, [(path, number) for number in range(1, SETS + 1)], chunksize=1)
    return report(sets)


if __name__ == "__main__":
    sys.exit(main())
