#!/usr/bin/python3
"""Simulates single changes to the pelvis of meshes/pelvis.yaml and writes the tables in docs/results/implant.

usage: pelvis_cases.py [--folder FOLDER] [TABLE...]

gland-motion  16 needles of docs/examples/implant-plan.yaml, inserted one after another and left in place, in the pelvis and in the block
materials     four of these needles (every fourth of the plan) after a change of moduli, membranes, the bladder's filling or the size of the elements
meshes        an implant with these four needles on finer meshes
time-steps    an implant with these four needles in longer and shorter time steps
operators     the whole plan, by different operators
times         start, memory and ticks of the pelvis and the block, from build/tests/benchmarks/bench_resting, three times in alternation; the medians
probe         one needle with the ultrasound probe withdrawn and pressed on the rectum, with tissue values drawn from their ranges

Lengths are in mm, angles in degrees, forces in N.
"""
import argparse
import csv
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import trocar
from pelvis_runs import BLOCK, DT, FINE, NAMES, PLAN, ROOT, SCENE, Gland, scene_of, values_of
from scipy.stats import qmc
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator

PROBE = ROOT / "meshes/pelvis-probe.yaml"
SPEED = 0.08                # m/s, of needles that are inserted and left
COUNTS = 1, 4, 8, 12, 16    # numbers of needles after which the shift is noted
DRAWS = 24                  # of the probe's table
LIFTS = 0.003, 0.006, 0.009 # m, travel of the probe towards the gland; the second one is that of the pressed probe
BEHIND = 0.3                # m, how far back the withdrawn probe is
STABILISERS = "D5", "J5"    # holes on either side of the gland's middle
PARTS = "total", "tissue", "image", "splay", "remainder"


def pelvis(changes=(), path=SCENE):
    """Returns the scene with changed values. The sparse inverse saves computing a dense one that is used only once."""
    scene = trocar.Scene.load(str(path))
    scene["inverse"] = "sparse"
    for key, value in dict(changes).items():
        scene[key] = value
    return scene


def moduli(value, *regions):
    return {f"regions[{region}].youngs_modulus": value for region in regions}


def stiffness(value, *membranes):
    """Returns changes that give membranes a stiffness (N/m)."""
    return {f"membranes[{name}].stiffness": value for name in membranes}


def meshed(folder, *options):
    """Returns the path of a mesh that meshes/pelvis.py makes with these options."""
    path = Path(folder) / ("pelvis" + "".join(options))
    subprocess.run([sys.executable, ROOT / "meshes/pelvis.py", path, *options], check=True)
    return f"{path}.msh"


def quarter():
    """Returns the plan with every fourth needle."""
    plan = plans.read(PLAN)
    plan.needles = plan.needles[::4]
    return plan


def rotation(gland, field):
    """Returns the gland's rotation in the coronal and in the sagittal plane."""
    turn = gland.turn(field[gland.nodes])
    return np.degrees(np.arctan2(turn[:2, 2], turn[2, 2]))


# ---- needles that are inserted and left ------------------------------------------------------------------------------------------------------

def insert(sim, needle, entry, axis, depth, speed):
    """Inserts a needle until its tip is `depth` behind the template's face, and leaves it. Returns the depths and the forces against it."""
    depths = np.append(np.arange(-0.002, depth, speed * FINE), depth)
    poses = np.tile([*entry, 1.0, 0, 0, 0], (len(depths), 1))
    poses[:, :3] += np.outer(depths - sim.model.needle_length, axis)
    sim.reset(poses[0], needle)
    out = sim.run(poses, FINE, needle)
    sim.leave(needle)
    return depths, -(out["force"] @ axis)


def inserted(model, plan):
    """Returns the gland's motion as the plan's needles are inserted one after another and left."""
    sim, gland, row = trocar.Sim(model), Gland(model), {}
    low, high = gland.rest[:, 2].min(), gland.rest[:, 2].max()
    turns, peaks, within = [], [], []
    for number, needle in enumerate(plan.needles, 1):
        entry, axis = plans.needle_axis(plan, needle, model)
        depths, force = insert(sim, number - 1, entry, axis, needle.depth, SPEED)
        tip = entry[2] + depths
        peaks.append(force.max())
        within.append(force[(tip > low) & (tip < high)].max())
        field = sim.displacements()
        turns.append(rotation(gland, field))
        if number in COUNTS:
            row[f"shift_{number}"] = 1e3 * gland.shift(field)
    least, most = np.min(turns, axis=0), np.max(turns, axis=0)
    return {"nodes": len(model.nodes), **row, "coronal_least": least[0], "coronal_most": most[0], "sagittal_least": least[1], "sagittal_most": most[1],
            "in_plane": 1e3 * gland.in_plane(field), "peak_force": max(peaks), "force_in_gland": np.mean(within)}


def gland_motion():
    cases = {"pelvis.yaml": (), "fat 3.2 kPa": moduli(3.2e3, "fat"), "fat 6.6 kPa": moduli(6.6e3, "fat")}
    for case, changes in cases.items():
        yield {"case": case, **inserted(trocar.Model(pelvis(changes)), plans.read(PLAN))}
    yield {"case": "implant.yaml", **inserted(trocar.Model(pelvis(path=BLOCK)), plans.read(PLAN))}


def materials():
    cases = {"pelvis.yaml": (), "fat 3.2 kPa": moduli(3.2e3, "fat"), "fat 6.6 kPa": moduli(6.6e3, "fat"), "fat: Poisson's ratio 0.3": {"regions[fat].poisson_ratio": 0.3},
             "pelvic floor and levator 5 kPa": moduli(5e3, "pelvic_floor", "levator_ani"), "skin 30 kPa": moduli(30e3, "perineum"),
             "walls of bladder and rectum 5 kPa": moduli(5e3, "bladder", "rectum"), "skin membrane 130 N/m": stiffness(130, "skin"),
             **{f"capsule membrane {value} N/m": stiffness(value, "capsule") for value in (77, 770, 7700)},
             "fascia: membranes of capsule, bladder and rectum 770 N/m": {"membranes[bladder_wall].puncture_force": 0, "membranes[rectum_wall].puncture_force": 0,
                                                                            **stiffness(770, "capsule", "bladder_wall", "rectum_wall")}}
    for case, changes in cases.items():
        yield {"case": case, **inserted(trocar.Model(pelvis(changes)), quarter())}
    with tempfile.TemporaryDirectory() as folder:
        for fine, filling in ((7.2, 150), (7.2, 300), (5, 60), (5, 150), (5, 300)):
            model = trocar.Model(pelvis({"mesh": meshed(folder, "--filling", str(filling), "--fine", str(fine))}))
            yield {"case": f"bladder {filling} ml, elements of {fine} mm", **inserted(model, quarter())}


# ---- implants --------------------------------------------------------------------------------------------------------------------------------

def implant(model, plan, step=DT, **options):
    """Carries out an implant. Returns the motion of the gland and the parts of the seeds' misplacement: along the needles (mean and mean magnitude), across
    them, and by thirds of the gland."""
    sim, gland = trocar.Sim(model), Gland(model)
    work = Operator(plan=plan, **options).moves(sim, step)
    known, last, field = set(), None, None
    for needle, poses in work:
        if field is None and needle != last and needle in known:      # all needles are in, and the first one is taken again
            field = sim.displacements()
        sim.run(poses, step, needle)
        known.add(needle)
        last = needle
    errors, (low, high) = work.errors(), (gland.rest[:, 2].min(), gland.rest[:, 2].max())
    size = 1e3 * np.linalg.norm([error.total for error in errors], axis=1)
    third = np.clip([3 * (error.planned[2] - low) / (high - low) for error in errors], 0, 2.999).astype(int)
    row = {"nodes": len(model.nodes), "seeds": len(errors), "base_shift": 1e3 * gland.shift(field), "misplacement": size.mean(), "middle": size[third == 1].mean(),
           "base": size[third == 2].mean()}
    for part in PARTS:
        along, across = 1e3 * np.array([(error.along(part), error.across(part)) for error in errors]).T
        row |= {f"{part}_along": along.mean(), f"{part}_along_size": np.abs(along).mean(), f"{part}_across": across.mean()}
    return row


def meshes():
    with tempfile.TemporaryDirectory() as folder:
        for fine in (7.2, 5, 4):
            model = trocar.Model(pelvis({} if fine == 7.2 else {"mesh": meshed(folder, "--fine", str(fine))}))
            for kind in ("marks", "image"):
                yield {"element size": fine, "operator": kind, **implant(model, quarter(), follows_image=kind == "image")}


def time_steps():
    model = trocar.Model(pelvis())
    for step in (0.004, 0.01, 0.02, 0.03):
        yield {"step [ms]": 1e3 * step, **implant(model, quarter(), step, follows_image=True)}


def operators():
    model, plan = trocar.Model(pelvis({"needles": 18})), plans.read(PLAN)
    for kind, strands, stabilise in (("marks", False, ()), ("marks", False, STABILISERS), ("image", False, ()), ("image", False, STABILISERS), ("image", True, ())):
        yield {"operator": kind, "seeds are": "strands" if strands else "loose", "stabilising needles": " ".join(stabilise),
               **implant(model, plan, follows_image=kind == "image", strands=strands, stabilise=stabilise)}


# ---- the probe -------------------------------------------------------------------------------------------------------------------------------

def move_probe(sim, start, end, outside):
    """Moves the probe's base in half a second and holds it for another half, with the needle outside the tissue."""
    for t in np.arange(DT, 1.0, DT):
        pose = np.array(sim.model.probe_start)
        pose[:3] += start + min(1.0, 2 * t) * (np.subtract(end, start))
        sim.set_probe(pose)
        sim.step(outside, DT)


def probe():
    for number, unit in enumerate(qmc.LatinHypercube(len(NAMES), seed=1).random(DRAWS)):
        values = values_of(unit)
        model = trocar.Model(scene_of(values, PROBE))
        gland, plan = Gland(model), plans.read(PLAN)
        entry, axis = plans.needle_axis(plan, plans.Needle("F4", 0.1, []), model)
        outside = np.array([*(entry - (0.002 + model.needle_length) * axis), 1, 0, 0, 0])
        row = {"run": number}
        for case in ("withdrawn", "pressed"):
            sim, at = trocar.Sim(model), np.zeros(3)
            sim.reset(outside)
            for lift in LIFTS[:2] if case == "pressed" else ():
                move_probe(sim, at, (0, lift, 0), outside)
                at = np.array([0, lift, 0])
                row |= {f"force_{1e3 * lift:g}": abs(sim.probe.force[1]), f"gland_{1e3 * lift:g}": 1e3 * sim.displacements()[gland.nodes, 1].mean()}
            if case == "withdrawn":
                pose = np.array(model.probe_start)
                pose[2] -= BEHIND
                sim.set_probe(pose)
                sim.step(outside, DT)
            before = sim.displacements()
            insert(sim, 0, entry, axis, 0.105, 0.12)
            change = sim.displacements() - before
            row |= {f"shift_{case}": 1e3 * gland.shift(change), f"turn_{case}": np.linalg.norm(rotation(gland, change))}
        sim = trocar.Sim(model)
        sim.reset(outside)
        move_probe(sim, np.zeros(3), (0, LIFTS[2], 0), outside)
        row |= {f"force_{1e3 * LIFTS[2]:g}": abs(sim.probe.force[1]), f"gland_{1e3 * LIFTS[2]:g}": 1e3 * sim.displacements()[gland.nodes, 1].mean()}
        yield {**row, **values}


# ---- times -----------------------------------------------------------------------------------------------------------------------------------

def measured(path):
    """Returns the times and the memory of one run: seconds of CPU time for the start, MB, and the median and 99th percentile of a tick (us) with 0 and 16
    resting needles."""
    begin = time.process_time()
    model = trocar.Model(trocar.Scene.load(str(path)))
    start = time.process_time() - begin
    # A child's peak memory includes that of the process it was forked from, which is small for time(1) and large for this one.
    command = ["/usr/bin/time", "-f", "%M", ROOT / "build/tests/benchmarks/bench_resting", "--processor-time", path, "0", "16"]
    bench = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = [line.split() for line in bench.stdout.splitlines() if line.split()[0] in ("0", "16")]
    ticks = {f"{name}_{row[0]} [us]": float(row[i]) for row in rows for i, name in ((1, "p50"), (2, "p99"))}
    return {"nodes": len(model.nodes), "start [s]": start, "memory with 16 needles [MB]": int(bench.stderr.split()[-1]) / 1024, **ticks}


def times():
    scenes = BLOCK, SCENE
    runs = [[measured(path) for path in scenes] for _ in range(3)]
    for path, rows in zip(scenes, zip(*runs)):
        yield {"scene": path.name, **{key: float(np.median([row[key] for row in rows])) for key in rows[0]}}


TABLES = {"gland-motion": gland_motion, "materials": materials, "meshes": meshes, "time-steps": time_steps, "operators": operators,
          "times": times, "probe": probe}


def write(path, rows):
    """Writes each row as soon as it is known."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        table = None
        for row in rows:
            if not table:
                table = csv.DictWriter(file, list(row), lineterminator="\n")
                table.writeheader()
            table.writerow({key: f"{value:.4g}" if isinstance(value, float) else value for key, value in row.items()})
            file.flush()
            print(row, flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "docs/results/implant", help="for the tables (default docs/results/implant)")
    parser.add_argument("tables", nargs="*", metavar="TABLE", help="default: all")
    given = parser.parse_args()
    for name in given.tables or TABLES:
        if name not in TABLES:
            parser.error(f"no table {name}: expected {', '.join(TABLES)}")
        write(given.folder / f"{name}.csv", TABLES[name]())
    return 0


if __name__ == "__main__":
    sys.exit(main())
