#!/usr/bin/python3
"""Turns a needle in tissue, and compares how far its tip lags behind and how the axial force changes with measurements."""
import sys

import numpy as np
import trocar
from laboratory import Bench, block, push
from rows import ABSTRACT, FITTED, PREDICTED, Rows

REED = "Reed, Okamura, Cowan 2009, IEEE Trans. Robotics 25"
LAG_SOURCE = f"{REED}; Reed 2008 (PMC2905605): more than 40 degrees"
LIN = "Lin and Huang 2020, IEEE Trans. Biomed. Eng. 67, gelatine"
NITINOL = {"outer_diameter": 0.57e-3, "inner_diameter": 0, "youngs_modulus": 75e9, "poisson_ratio": 0.33, "length": 0.105}
DEPTH = 0.099            # m; the far face of the block is 100 mm deep
PATIENT = (63, 51, 0)   # static (N/m), kinetic (N/m) and viscous (N s/m^2) friction of a 1.27 mm needle in the gland of meshes/implant.yaml


def lag(friction, depths):
    """Returns by how much (rad) the tip of a thin needle lags when the needle is turned by one and a half turns at these depths."""
    model = trocar.Model(block(30e3, friction=friction, needle=NITINOL))
    lags = []
    for depth in depths:
        bench = Bench(model, length=NITINOL["length"])
        bench.tip = depth
        bench.sim.reset(bench.pose())
        bench.rotate(3 * np.pi, 6.0)
        lags.append(-bench.sim.tip_lead())
    return np.array(lags)


rows = Rows.from_arguments(__doc__, "Torsion")
# Friction per unit length is proportional to the needle's circumference.
thin = tuple(f * NITINOL["outer_diameter"] / 1.27e-3 for f in PATIENT)
depths = np.array([DEPTH]) if rows.short else np.array([0.02, 0.04, 0.06, 0.08, DEPTH])
lags = np.degrees(lag(thin, depths))
torsion = 75e9 / (2 * 1.33) * np.pi / 32 * NITINOL["outer_diameter"] ** 4
rows.trend("lag of the tip of a 0.57 mm nitinol needle, 100 mm deep, with patients' friction", LAG_SOURCE, ABSTRACT,
           "more than 45 degrees in some phantoms; torques in patients are large enough for similar errors", lags[-1] > 45,
           f"{lags[-1]:.0f} degrees", kind=PREDICTED, fitted="friction per length, to the axial force in patients; in proportion to the circumference",
           number=lags[-1], unit="degrees", regression=(6.3, 7.7), reason="a lag of 45 degrees requires more friction on the thin needle than the tissue of patients causes in this scene; see the next row")
phantom = tuple(f * 45 / lags[-1] for f in (thin[1], thin[1], 0))
needed = float(np.degrees(lag(phantom, [DEPTH]))[0])
rows.add("lag in a phantom whose friction is scaled to it", LAG_SOURCE, ABSTRACT, (40, 60), needed, "degrees", published="more than 40 to 45 degrees", kind=FITTED,
         fitted=f"friction of {phantom[1]:.0f} N/m on the 0.57 mm needle")
if not rows.short:
    fine = np.linspace(0, DEPTH, 40)
    free = NITINOL["length"] - fine
    rows.curve("torsion", "model", 1e3 * depths, lags, "depth (mm)", "lag of the tip (degrees)")
    moment = thin[1] * NITINOL["outer_diameter"] / 2        # torque per metre of shaft, N m/m
    rows.curve("torsion", "f L (L/2 + free length) / G J", 1e3 * fine, np.degrees(moment * fine * (fine / 2 + free) / torsion), "depth (mm)", "lag of the tip (degrees)")
model = trocar.Model(block(30e3, friction=(60, 40, 0)))
turns, deep = ((0, 20), 0.04) if rows.short else ((0, 5, 10, 20, 40), 0.06)
axial = [push(Bench(model).move(deep, 0.01, turn=turn))[-1] for turn in turns]
rows.trend("axial force of a needle that turns during insertion", LIN, ABSTRACT, "less the faster it turns", all(a > b for a, b in zip(axial, axial[1:])),
           f"{axial[0]:.2f} N without turning, {axial[-1]:.2f} N at {turns[-1]} rad/s (10 mm/s, {1e3 * deep:g} mm deep)", kind=PREDICTED,
           fitted="nothing; in the model only friction decreases, in the experiment also cutting")
if not rows.short:
    rows.curve("turning", f"model, 10 mm/s, {1e3 * deep:g} mm deep", turns, axial, "rate of turning (rad/s)", "axial force (N)")
sys.exit(rows.end())
