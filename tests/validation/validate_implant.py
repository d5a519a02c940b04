#!/usr/bin/python3
"""Compares meshes/implant.yaml and meshes/pelvis.yaml with measurements in patients.

The first scene was fitted to two numbers, both at 80 mm/s: the skin's puncture force was set so that an 18 G needle meets 8.9 N in the perineum, and friction
so that it then meets 5.6 N in the gland. The second scene has the same needles, skin and friction in the anatomy of a pelvis. Results for other gauges, and
the effect of speed on the gland's motion, are predictions. Whole implants are compared in validate_intervals.py.
"""
import sys

import numpy as np
import trocar
from laboratory import AIR, DT, MESHES
from rows import ABSTRACT, CONSISTENT, FITTED, PREDICTED, SECONDARY, Rows

PODDER = "Podder et al. 2006, Med. Phys. 33, 20 patients"
MCLAUGHLIN = "McLaughlin et al., AAPM 2022: phantom, by hand and with a pneumatic device"
PREPRINT = "preprint of a haptic simulator made after Podder et al. 2006"
FIT_SPEED = 0.08         # m/s
FORCES = "puncture force of the skin and level of friction, to the forces of 18 G at 80 mm/s"
DEEP = 0.080             # m, depth at which the tip is 5 mm beyond the gland
HOLES = ((0.005, 0.0), (-0.015, 0.005), (0.015, -0.005), (0.0, 0.01), (-0.005, -0.01))   # m, positions of the template's holes


class Needle:
    """One of the scene's needles, in a hole of the template."""

    def __init__(self, sim, hole, index=0):
        self.sim, self.hole, self.index = sim, hole, index
        self.tip = -AIR
        sim.reset(self.pose(), index)

    def pose(self):
        return np.array([*self.hole, self.tip - 0.2, 1, 0, 0, 0])

    def move(self, to, speed):
        ticks = max(1, round(abs(to - self.tip) / (speed * DT)))
        start, outputs = self.tip, []
        for i in range(ticks):
            self.tip = start + (to - start) * (i + 1) / ticks
            outputs.append(self.sim.step(self.pose(), DT, self.index))
        return outputs


def scene(name="implant"):
    return trocar.Scene.load(str(MESHES / f"{name}.yaml"))


def sideways(sim, hole):
    """Returns the largest distance (m) of the needle from the axis of the hole."""
    return float(np.hypot(*(sim.centreline()[:, :2] - hole).T).max())


rows = Rows.from_arguments(__doc__, "Implant")
model = trocar.Model(scene())

# ---- force ----
speeds = (FIT_SPEED, 0.12) if rows.short else (0.05, FIT_SPEED, 0.12)
holes = HOLES[:1] if rows.short else HOLES
peaks, deep, bent = {}, {}, 0.0
for hole in holes:
    for speed in speeds:
        sim = trocar.Sim(model)
        needle, outputs = Needle(sim, hole), []
        for to in np.arange(0.001, DEEP + 1e-9, 0.001):
            outputs += needle.move(to, speed)
            bent = max(bent, sideways(sim, hole))
        force = np.array([-out.force[2] for out in outputs])
        peaks[hole, speed] = force.max()
        capsule = next(i for i, out in enumerate(outputs) if out.events & trocar.Event.PUNCTURED and out.membrane == 1)
        deep[hole, speed] = force[capsule:].max()
        if hole == holes[0]:
            rows.curve("implant", f"{1e3 * speed:g} mm/s", (np.arange(len(force)) * speed)[::10] * DT * 1e3 - 1, force[::10], "travel beyond the skin (mm)", "force against pushing in (N)")
rows.curve("implant", "published: perineum", [0, 30], [8.96, 8.96], "travel beyond the skin (mm)", "force against pushing in (N)", published=True)
rows.curve("implant", "published: prostate", [40, 80], [5.63, 5.63], "travel beyond the skin (mm)", "force against pushing in (N)", published=True)
fit = holes[0], FIT_SPEED
rows.add(f"largest force, 18 G, {1e3 * FIT_SPEED:g} mm/s", PODDER, SECONDARY, (8.0, 9.8), peaks[fit], "N", published="8.9 N (tolerance 10 %)", kind=FITTED, fitted=FORCES)
rows.add(f"largest force in the gland, 18 G, {1e3 * FIT_SPEED:g} mm/s", PREPRINT, SECONDARY, (5.1, 6.2), deep[fit], "N", published="5.63 +- 0.13 N (tolerance 10 %)", kind=FITTED, fitted=FORCES)
values = np.array(list(peaks.values()))
rows.trend(f"largest force at {1e3 * speeds[0]:g} to {1e3 * speeds[-1]:g} mm/s, holes tried: {len(holes)}", f"{PODDER}; {PREPRINT}: perineum 8.96 +- 1.31 N", SECONDARY, "8 to 10 N, without buckling",
           values.min() >= 8 and values.max() <= 10 and bent < 2e-3, f"{values.min():.1f} to {values.max():.1f} N; needle bent by at most {1e3 * bent:.1f} mm", kind=CONSISTENT, fitted=FORCES)
if not rows.short:
    thick = scene()
    thick["needle.outer_diameter"] = 1.47e-3
    thick["guides[template].hole_diameter"] = 1.7e-3
    ratio = 1.47 / 1.27
    for region in ("prostate", "surrounding", "perineum", "muscle"):
        for key, power in (("friction.static", 1), ("friction.kinetic", 1), ("friction.viscous", 1), ("cutting_force", 2)):
            thick[f"regions[{region}].{key}"] = thick[f"regions[{region}].{key}"] * ratio**power
    for membrane in ("skin", "capsule"):
        thick[f"membranes[{membrane}].puncture_force"] = thick[f"membranes[{membrane}].puncture_force"] * ratio**2
    force = max(-out.force[2] for out in Needle(trocar.Sim(trocar.Model(thick)), HOLES[0]).move(DEEP, 0.08))
    for region in ("prostate", "surrounding", "perineum", "muscle"):
        for key in ("friction.static", "friction.kinetic"):
            thick[f"regions[{region}].{key}"] = 1.3 * thick[f"regions[{region}].{key}"]
    rough = max(-out.force[2] for out in Needle(trocar.Sim(trocar.Model(thick)), HOLES[0]).move(DEEP, 0.08))
    rows.add("largest force, 17 G (1.47 mm)", PODDER, SECONDARY, (13.0, 18.0), force, "N", published="15.6 N (tolerance 15 %)", kind=PREDICTED, fitted=f"{FORCES}; friction as the circumference, cutting and puncture as the area",
             regression=(11.3, 12.5),
             reason="the published ratio of 1.75 to the force of 18 G is the ratio of the diameters, 1.16, to the power of 3.8, and areas grow with the power of 2. "
                    f"Friction is not the cause: with 30 % more of it, the largest force is {rough:.1f} N, because the skin sets it. Other differences between the needles are not known")

# ---- the gland ----
if not rows.short:
    pelvis = trocar.Model(scene("pelvis"))
    gland = np.unique(pelvis.tets_of("prostate"))
    shift = {}
    for speed in (0.005, 0.12):
        sim = trocar.Sim(pelvis)
        Needle(sim, HOLES[0]).move(DEEP, speed)
        shift[speed] = 1e3 * sim.displacements()[gland, 2].mean()
    rows.trend("motion of the gland, slow and fast needle", MCLAUGHLIN, ABSTRACT, "base moved by up to 20 mm by a high-speed needle, 1 mm with the device", shift[0.12] < shift[0.005],
               f"{shift[0.005]:.1f} mm at 5 mm/s, {shift[0.12]:.1f} mm at 120 mm/s", kind=PREDICTED, fitted=FORCES,
               note="only the tendency agrees: neither 20 nor 1 mm is reached. The abstract also calls the needle that moves the gland by 20 mm high-speed, but reports that a timid needle tents the gland more; speeds are not given")
sys.exit(rows.end())
