#!/usr/bin/python3
"""Compares the deflection of bevelled needles with measurements. One bevel slope is fitted to one needle. Results for other gauges, depths and tissues are
predictions."""
import sys

import numpy as np
import trocar
from laboratory import Bench, block
from rows import ABSTRACT, CONSISTENT, FITTED, PREDICTED, SECONDARY, Rows

RAND = "Rand et al. 2016, Anesth. Pain Med. 6 (e36607), ballistic gel"
DRUMMOND = "Drummond and Scott 1980, Anaesthesia 35, beef"
LANCET = "Deflection Analysis of Different Needle Designs for Prostate Biopsy and Focal Therapy (PMID 27708117), 18 G, gelatine like prostate"
WEBSTER = "Webster et al. 2006, Int. J. Robotics Research 25, 0.7 mm nitinol in Plastisol"
DUTY = "Minhas, Engh, Fenske, Riviere 2007, IEEE EMBC; used by PMC4517621"
G22, G25, G18 = 0.718e-3, 0.515e-3, 1.27e-3    # m, outer diameters; the needles contain their stylets, so they are solid
GEL, MEAT, PROSTATE = 100e3, 30e3, 20e3        # Pa, assumed, because the abstracts give no values


def track(youngs_modulus, slope, diameter, depth, *, length=0.09, stiffness=200e9):
    """Returns the positions (m) of the needle's joints, relative to its entry point, after an insertion to `depth`."""
    needle = {"outer_diameter": diameter, "inner_diameter": 0, "length": length, "bevel_slope": slope, "youngs_modulus": stiffness}
    bench = Bench(trocar.Model(block(youngs_modulus, friction=(10, 7, 0), needle=needle)), length=length, x=0.0)
    bench.move(depth, 0.02)
    return bench.sim.centreline() - [0, bench.y, 0]


def deflection(*arguments, **options):
    """Returns the tip's sideways deflection (mm)."""
    end = track(*arguments, **options)[-1]
    return 1e3 * float(np.hypot(end[0], end[1]))


def fitted_slope(target, *arguments, **options):
    """Returns the slope that gives this deflection (mm). Deflections are nearly proportional to the slope."""
    slope = 0.05
    for _ in range(2):
        slope *= target / deflection(arguments[0], slope, *arguments[1:], **options)
    return slope


rows = Rows.from_arguments(__doc__, "Steering")
slope = 0.0434 if rows.short else fitted_slope(8.89, GEL, G22, 0.08)
fit = f"bevel slope {slope:.3f}, to 22 G Quincke at 80 mm"
rows.add("22 G Quincke at 80 mm", RAND, ABSTRACT, (8.72, 9.06), deflection(GEL, slope, G22, 0.08), "mm", published="8.89 +- 0.17 mm", kind=FITTED, fitted=fit)
thin = deflection(GEL, slope, G25, 0.08)
rows.trend("25 G instead of 22 G at 80 mm", RAND, ABSTRACT, "significantly more deflection", thin > 1.1 * 8.89, f"{thin:.1f} mm", kind=PREDICTED, fitted=fit)
shot = track(PROSTATE, slope, G18, 0.02, length=0.2)
side = 1e3 * float(np.hypot(*shot[-1][:2]))
rows.add("18 G lancet after 20 mm", LANCET, ABSTRACT, (0.3, 1.3), side, "mm", published="0.9 mm (0.3 to 1.3)", kind=PREDICTED, fitted=f"{fit}, in the other gel")
rows.add("direction to its tip", LANCET, ABSTRACT, (0.6, 2.8), float(np.degrees(np.arctan2(side, 1e3 * shot[-1][2]))), "degrees", published="1.9 degrees (0.6 to 2.8)", kind=CONSISTENT,
         fitted=f"{fit}; taken as the angle of the chord, so it follows from the row above")
if not rows.short:
    depths = np.array([0.02, 0.03, 0.04, 0.05, 0.06])
    meat = {gauge: [deflection(MEAT, slope, d, depth) for depth in depths] for gauge, d in (("22 G", G22), ("25 G", G25))}
    rates = [m / (100 * d) for values in meat.values() for m, d in zip(values, depths)]
    rows.add("22 and 25 G through meat, mean of 20 to 60 mm", DRUMMOND, ABSTRACT, (0.5, 1.5), float(np.mean(rates)), "mm per cm", published="about 1 mm per cm, depth unknown; tolerance half",
             kind=PREDICTED, fitted=f"{fit}, in the gel", scatter=f"{min(rates):.2f} to {max(rates):.2f}")
    for gauge, values in meat.items():
        rows.curve("steering-depth", f"{gauge}, model, 30 kPa", 1e3 * depths, values, "depth (mm)", "sideways (mm)")
    rows.curve("steering-depth", "published: about 1 mm per cm", [0, 60], [0, 6], "depth (mm)", "sideways (mm)", published=True)


# ---- a spinning needle ----

TRAVEL, PERIOD, SPEED = 0.078, 0.004, 0.02     # TRAVEL: m; PERIOD: travel per cycle, m; SPEED: m/s


def curvature(model, length, share):
    """Returns the curvature (1/m) of the track of a needle that makes one turn during the fraction `share` of each cycle's travel."""
    bench = Bench(model, length=length, x=0.0)
    bench.move(0.0, SPEED)
    tips = []
    while bench.tip < TRAVEL - 1e-9:
        start = bench.tip
        if share > 0:
            bench.move(start + share * PERIOD, SPEED, turn=2 * np.pi * SPEED / (share * PERIOD))
        if share < 1:
            bench.move(start + PERIOD, SPEED)
        tips.append(bench.sim.centreline()[-1])
    tips = np.array(tips)
    deep = tips[tips[:, 2] > 0.02]
    return abs(2 * np.polyfit(deep[:, 2], deep[:, 1], 2)[0])


def nitinol(bevel):
    return trocar.Model(block(GEL, friction=(20, 14, 0), cutting=0.02, needle={"outer_diameter": 0.7e-3, "inner_diameter": 0, "youngs_modulus": 75e9, "poisson_ratio": 0.33,
                                                                         "length": 0.12, "bevel_slope": bevel}))


if not rows.short:
    bevel = 0.05
    radius = 1 / curvature(nitinol(bevel), 0.12, 0)
    bevel *= radius / 0.22
    model = nitinol(bevel)
    shares = np.array([0, 0.25, 0.5, 0.75, 1])
    curvatures = np.array([curvature(model, 0.12, share) for share in shares])
    rows.add("radius of the track", WEBSTER, SECONDARY, (0.18, 0.25), 1 / curvatures[0], "m", published="about 0.22 m; accepted: 0.18 to 0.25", kind=FITTED, fitted=f"bevel slope {bevel:.3f}")
    off = np.max(np.abs(curvatures - curvatures[0] * (1 - shares))) / curvatures[0]
    rows.trend("curvature while spinning during part of the insertion", DUTY, SECONDARY, "falls in proportion to that part, to 0", off < 0.1,
               f"within {100 * off:.0f} % of the line", kind=PREDICTED, fitted="bevel slope, without spinning")
    rows.curve("duty-cycle", "model", 100 * shares, curvatures, "part of the way with spinning (%)", "curvature (1/m)")
    rows.curve("duty-cycle", "published: in proportion", [0, 100], [1 / 0.22, 0], "part of the way with spinning (%)", "curvature (1/m)", published=True)
sys.exit(rows.end())
