#!/usr/bin/python3
"""Compares the effect of speed with measurements on porcine and lamb hearts, using relaxing tissue under a membrane. The relaxation series is that of
meshes/implant.yaml, and the membrane is assumed to rupture at a fixed force. The model predicts that the force rises more steeply for a faster needle. With a
fixed force at rupture, less displacement and less work follow from this, so they do not count as further predictions.

In measurements, the force at rupture falls with speed. To test whether a constant fracture energy would explain this, the needle dents the tissue to the same
force at each speed, without rupture, and is then drawn back fast. The energy is either the hand's work or what the tissue gives back. The force at rupture is
then the force at which a needle reaches the energy that the slowest needle has at its rupture.
"""
import sys

import numpy as np
import trocar
from laboratory import Bench, block, push
from rows import ABSTRACT, CONSISTENT, PREDICTED, Rows

MAHVASH = "Mahvash and Dupont 2009, IEEE ICRA (PMC3051196), porcine heart"
HEART = "J. Engineering in Medicine, doi 10.1243/09544119JEIM698, lamb heart, ex vivo and in vivo"
SPEEDS = (0.005, 0.02, 0.1, 0.5)          # m/s


def until_rupture(model, speed):
    """Returns displacement (m) and force (N) until the needle punctures the skin."""
    bench = Bench(model)
    outputs = bench.move(0.04, speed)
    end = next(i for i, out in enumerate(outputs) if out.events & trocar.Event.PUNCTURED and out.membrane == 0) + 1
    force = push(outputs)[:end]
    way = np.arange(1, end + 1) * speed * 1e-3 - 1e-3
    return way[way > 0], force[way > 0]


def energies(model, speed, force):
    """Dents the tissue at `speed` up to this force (N), then draws the needle back at the largest of SPEEDS. Returns the displacement (m) and force (N) while
    denting, and the work (J) that the tissue gives back."""
    bench, way, there = Bench(model), [0.0], [0.0]
    while there[-1] < force:
        there += push(bench.move(bench.tip + 2e-4, speed)).tolist()
        way += np.linspace(way[-1], bench.tip, len(there) - len(way) + 1)[1:].tolist()
    deepest = bench.tip
    back = np.concatenate([there[-1:], push(bench.move(0.0, SPEEDS[-1]))])
    return np.array(way), np.array(there), np.trapz(back, dx=deepest / (len(back) - 1))


rows = Rows.from_arguments(__doc__, "Speed")
model = trocar.Model(block(35e3, puncture=0.5, relaxation=[(0.34, 0.15), (0.34, 2.5)]))
runs = {speed: until_rupture(model, speed) for speed in (SPEEDS[1:3] if rows.short else SPEEDS)}
slow, fast = min(runs), max(runs)
slope = {speed: np.interp(0.005, *runs[speed]) / 0.005 for speed in runs}
end = {speed: runs[speed][0][-1] for speed in runs}
work = {speed: np.trapz(runs[speed][1], runs[speed][0]) for speed in runs}
peak = {speed: runs[speed][1].max() for speed in runs}


def falls(values):
    ordered = [values[speed] for speed in sorted(values)]
    return all(a > b for a, b in zip(ordered, ordered[1:]))


fitted = "relaxation series; puncture force assumed"
follows = f"{fitted}; follows from the steeper force, as the force at rupture is fixed"
rows.trend("steepness of force against displacement", MAHVASH, ABSTRACT, "steeper when the needle moves faster", falls({v: -k for v, k in slope.items()}),
           f"{1e-3 * slope[slow]:.3f} N/mm at {1e3 * slow:g} mm/s, {1e-3 * slope[fast]:.3f} at {1e3 * fast:g}", kind=PREDICTED, fitted=fitted)
rows.trend("displacement at rupture", f"{MAHVASH}; {HEART}", ABSTRACT, "less when the needle moves faster", falls(end),
           f"{1e3 * end[slow]:.1f} mm at {1e3 * slow:g} mm/s, {1e3 * end[fast]:.1f} at {1e3 * fast:g}", kind=CONSISTENT, fitted=follows)
rows.trend("energy absorbed up to the rupture", MAHVASH, ABSTRACT, "less when the needle moves faster", falls(work),
           f"{1e3 * work[slow]:.2f} mJ at {1e3 * slow:g} mm/s, {1e3 * work[fast]:.2f} at {1e3 * fast:g}", kind=CONSISTENT, fitted=follows)
rows.trend("force at rupture", f"{MAHVASH}; {HEART}", ABSTRACT, "less when the needle moves faster, under certain conditions", falls(peak) and peak[fast] < 0.99 * peak[slow],
           f"{peak[slow]:.2f} N at {1e3 * slow:g} mm/s, {peak[fast]:.2f} at {1e3 * fast:g}", kind=PREDICTED, fitted=fitted,
           number=peak[fast] / peak[slow], unit="of the force of the slow needle", regression=(0.99, 1.01),
           reason="a membrane breaks at a force that does not depend on speed; a constant fracture energy would not change this, see the next rows")
# The forces at which both speeds reach the same energy. At each speed, both kinds of energy are proportional to the square of the force, because the tissue is
# linear.
strong = trocar.Model(block(35e3, puncture=50.0, relaxation=[(0.34, 0.15), (0.34, 2.5)]))
dents = {speed: energies(strong, speed, peak[slow]) for speed in (slow, fast)}
done = {speed: np.trapz(force, way) for speed, (way, force, _) in dents.items()}
for name, energy, bounds in (("a constant work of the hand", done, (1.1, 1.5)), ("a constant energy that the tissue gives back", {v: dent[2] for v, dent in dents.items()}, (0.97, 1.03))):
    ratio = float(np.sqrt(energy[slow] / energy[fast]))
    rows.trend(f"force at rupture, if {name} broke the membrane", f"{MAHVASH}; {HEART}", ABSTRACT, "less when the needle moves faster, under certain conditions", ratio < 0.99,
               f"{ratio:.2f} times the force of the slow needle", kind=CONSISTENT, fitted=fitted, number=ratio, unit="of the force of the slow needle", regression=bounds,
               reason="a faster needle meets stiffer tissue, which takes up less energy at the same force; so no single fracture energy makes the force fall")
for speed, (way, force) in runs.items():
    step = max(1, len(way) // 200)
    rows.curve("speed", f"{1e3 * speed:g} mm/s", 1e3 * way[::step], force[::step], "displacement of the needle (mm)", "force (N)")
sys.exit(rows.end())
