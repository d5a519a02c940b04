#!/usr/bin/python3
"""Compares implants simulated in meshes/pelvis.yaml with measurements in patients. Moduli, friction and forces are drawn from ranges, some published and some
assumed, so each simulated number is an interval. Nothing is fitted here: the needles' forces were fitted elsewhere, to two forces in patients
(validate_implant.py), and the operator's errors are published values.

The runs are those in spreads.csv (pelvis_runs.py). The full form does missing runs first, and those that other mechanics, scenes or plans made. It also
writes intervals.csv, which compares the intervals with those of the block of tissue and an operator who reads the needle's marks, and names the parameter on
which each interval depends most.
"""
import csv
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pelvis_runs
from rows import ABSTRACT, PREDICTED, Rows
from scipy import stats

HERE = Path(__file__).resolve().parent
KEPT = HERE / "spreads.csv"
COUNT, SEED = 24, 1
RUNS = {"published": COUNT, "before": COUNT, "few": 1, "half": COUNT, "sliding": COUNT, "strands": COUNT, **dict.fromkeys(("without errors", "splay 0", "splay 2", "slow", "fast"), 8)}    # number of runs of each case
STONE = "Stone et al. 2002 (PMID 15090279), 19 patients, median 16 needles"
LAGERBURG = "Lagerburg et al. 2005, Radiotherapy and Oncology 77"
SEEDS = "Quantifying 125I placement accuracy in prostate brachytherapy using postimplant transrectal ultrasound images, University of Alberta, 15 patients, 1197 seeds"
SPEED = "Intraoperative factors associated with stranded source placement accuracy in low-dose-rate prostate brachytherapy, University of Alberta, the same patients"
MARKERS = "Radiation Oncology 7:24, 2012, 18 patients, three gold markers each"
PODDER = "Podder et al.: Efficacy of prostate stabilizing techniques during brachytherapy procedure, EMBC"
NEEDLES = "PMC7821271 (abstract)"
FITTED = "puncture force of the skin and level of friction, to forces; nothing to motion"
SEEING = 0.80 / np.sqrt(2) * np.sqrt(2 / np.pi)    # mm, mean error along an axis of finding a needle: two physicists differed by 0.80 mm, and an axis has half of its square


class Runs:
    """The successful runs of one case; runs["name"] is a column."""

    def __init__(self, table, case):
        self.rows = {int(row["run"]): row for row in table if row["case"] == case and row["status"] == "ok"}

    def __len__(self):
        return len(self.rows)

    def __getitem__(self, name):
        return np.array([row[name] for row in self.rows.values()], float)

    def paired(self, other, value):
        """Returns the differences of value(runs) between this case and another, run by run."""
        mine, theirs = dict(zip(self.rows, value(self))), dict(zip(other.rows, value(other)))
        return np.array([mine[run] - theirs[run] for run in mine if run in theirs])


def interval(values):
    known = values[np.isfinite(values)]
    return tuple(np.percentile(known, (5, 50, 95))) if len(known) else (float("nan"),) * 3


def median(values):
    """Returns the word "median" with the number of runs, if some of them lack the value."""
    count = np.isfinite(values).sum()
    return "median" if count == COUNT else f"median of {count} runs"


def span(values, unit=""):
    low, middle, high = interval(values)
    return f"{low:.2g} to {high:.2g} {unit} ({median(values)} {middle:.2g})".replace("  ", " ")


def mean_of(values):
    """Returns the lower end of the mean's 95 % confidence interval, the mean, and the upper end."""
    half = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return values.mean() - half, values.mean(), values.mean() + half


def strongest(values):
    """Returns the drawn parameter that the values depend on most, its rank correlation with them, and whether its range is published; empty texts if there are
    too few runs to tell."""
    known = np.isfinite(values)
    if known.sum() < 12:
        return "", "", ""
    of = {name: stats.spearmanr(published[name][known], values[known])[0] for name in pelvis_runs.NAMES}
    name = max(of, key=lambda name: abs(of[name]))
    return name, f"{of[name]:.2f}", "published" if name in pelvis_runs.CITED else "assumed"


def without(values, name):
    """Returns the values as they would be without the spread of a parameter with middle 1, by linear regression on the parameter's logarithm."""
    x, known = np.log(published[name]), np.isfinite(values)
    if known.sum() < 12:
        return np.full_like(values, float("nan"))
    return values - np.polyfit(x[known], values[known], 1)[0] * x


rows = Rows.from_arguments(__doc__, "Pelvis")
table = KEPT
if not rows.short:
    table = rows.folder / "spreads.csv"
    if not table.exists() and KEPT.exists():
        shutil.copy(KEPT, table)
    for case, count in RUNS.items():
        subprocess.run([sys.executable, HERE / "pelvis_runs.py", "spreads", "--count", str(COUNT), "--runs", str(count), "--seed", str(SEED), "--case", case, table], check=True)
    shutil.copy(table, HERE)
table = pelvis_runs.read(table)
of = {case: Runs(table, case) for case in RUNS}
published, exact = of["published"], of["without errors"]
current = sum(row["digest"] == pelvis_runs.digest() for row in table)
counts = ", ".join(f"{case}: {len(of[case])} of {count}" for case, count in RUNS.items())
rows.remark(f"{counts} runs, Latin hypercube with seed {SEED}. {current} of {len(table)} runs were made by the present mechanics, "
            f"scenes, plan and operator (digest {pelvis_runs.digest()}); `scripts/validate intervals` repeats the others")


def ratio(above, below):
    return lambda runs: runs[above] / runs[below]


def column(name):
    return lambda runs: runs[name]


# ---- causes of what stays outside ----
ahead, tips = published["first_ahead"], published["first_remainder"]
DRAGGED = (f"a needle's first seeds lie in the base and are too shallow by {-np.nanmedian(tips):.1f} mm (median of the runs), because the tissue at the tip of a "
           f"pushed shaft is {np.nanmedian(ahead):.1f} mm ahead of what the mesh's displacements, the operator's image, show (correlation over the needles of a run: "
           f"{np.nanmedian(published['first_agree']):.2f}). Without this error, the ratio is {span(ratio('base_shown', 'middle_shown')(published))}")
EDGES = (f"comparing slices of the same number instead of the same tissue explains little: the tissue of the surface moves by {span(published['in_plane'], 'mm')}. The width of "
         f"the slices changes by {span(published['width'], 'mm')}, and their centres move by {span(published['centre'], 'mm')}. In implants of eight needles, the edges "
         f"change by {span(of['half']['edge'], 'mm')}, and by {span(of['sliding']['edge'], 'mm')} if the gland slides in the fat. The rest is not explained. Swelling, and the "
         "errors of drawing contours and of relocating the probe, are part of the published number")


def apart(axis):
    none, once, twice = (np.median(of[case][f"off_{axis}"]) for case in ("splay 0", "half", "splay 2"))
    sliding = np.median(of["sliding"][f"off_{axis}"])
    return (f"largely because the gland is bonded to the fat: in implants of eight needles, the median is {once:.2f} mm, and {sliding:.2f} mm if the gland slides there. Neither splay "
            f"nor the error of finding seeds suffices: with a bonded gland, it is {none:.2f} mm without splay, {once:.2f} mm with the published one, "
            f"{twice:.2f} mm with twice as much, which the template's holes hardly let through, and {np.hypot(twice, SEEING):.2f} mm if the published error of finding a "
            f"needle in ultrasound is added ({SEEING:.2f} mm, {NEEDLES}; "
            "none was found for seeds). Swelling, migration, needles that were redirected (half of the seeds in the same patients had more than one pass), and the alignment of "
            "the images are not simulated")


FRONT = (f"not an effect of the operator's errors: in implants of eight needles, the ratio is {span(ratio('anterior', 'posterior')(of['half']))} with them and "
         f"{span(ratio('anterior', 'posterior')(exact))} without. With each seed of a needle misplaced along it like the first, as in a strand, it is "
         f"{span(ratio('strand_anterior', 'strand_posterior')(published))}. The cause in patients is not known")
left = max(np.nanmedian(published[f"out_{axis}"]) for axis in "xyz")
ELASTIC = (f"the published displacement is permanent: it was found after a second session. The model has no irreversible motion (swelling, bleeding, tearing): {pelvis_runs.CALM:g} s after "
           f"the last needle has left, at most {left:.2f} mm remain along an axis (median of the runs). The row compares the model with all needles in. The published number is also "
           "the largest of 54 markers")
MARKED = ("to the front or back", "y", 5), ("to the left or right", "x", 7), ("along the needles", "z", 12)
# quantity, source, published, its value, the runs' values, unit, options
QUANTITIES = (
    ("shift of the gland's base, all needles in", STONE, "median 15 mm (0 to 30)", 15, column("base_shift"), "mm", {}),
    ("change of the gland's edges in axial slices counted from its base, all needles in", STONE, "6.8 mm", 6.8, column("edge"), "mm", {"reason": EDGES, "regression": (0.4, 2)}),
    ("misplacement of seeds, mean", SEEDS, "4.9 mm (4.7 to 5.1)", 4.9, column("misplacement"), "mm",
     {"note": "inside only at the interval's edge, which depends on the assumed range of cutting forces; intervals.csv has the interval without it"}),
    ("misplacement along the needles, mean", SEEDS, "3.8 mm", 3.8, column("off_z"), "mm",
     {"note": "nearly the same number as the row above, because the model hardly misplaces seeds across the needles"}),
    ("misplacement to the left or right, mean", SEEDS, "1.3 mm", 1.3, column("off_x"), "mm", {"reason": apart("x"), "regression": (0.28, 0.55)}),
    ("misplacement to the front or back, mean", SEEDS, "1.5 mm", 1.5, column("off_y"), "mm", {"reason": apart("y"), "regression": (0.4, 0.85)}),
    ("misplacement in the front half of the gland, divided by that in the back half", SEEDS, "1.33", 1.33, ratio("anterior", "posterior"), "",
     {"reason": FRONT, "regression": (0.75, 1.1)}),
    ("misplacement in the base, divided by that in the middle", SEEDS, "1.29", 1.29, ratio("base", "middle"), "", {"reason": DRAGGED, "regression": (1.5, 2.9)}),
    *((f"largest displacement of a marker {words}", MARKERS, f"{value} mm at most", value, column(f"marker_{axis}"), "mm",
       {"reason": ELASTIC, "regression": (2.5, 4.7) if axis == "z" else (0.8, 1.9)}) for words, axis, value in MARKED),
)
beside = []
for quantity, source, text, value, values, unit, options in QUANTITIES:
    after, before = values(published), values(of["before"])
    name, rho, sure = strongest(after)
    rows.interval(quantity, source, ABSTRACT, text, value, interval(after), unit, kind=PREDICTED, fitted=FITTED, middle=median(after),
                  depends=f"{name}, range {sure} (rank correlation {rho})" if name else "", **options)
    uncut = without(after, "cutting")
    found = [interval(set_of) for set_of in (before, after, uncut, values(of["half"]), values(of["sliding"]), values(of["strands"]))]
    inside = ("" if np.isnan(low) else "yes" if low <= value <= high else "no" for low, _, high in found)
    beside.append((quantity, text, *(end for ends in found for end in ends), *inside, name, rho, sure))
with open(rows.folder / "intervals.csv", "w", newline="", encoding="utf-8") as file:
    out = csv.writer(file, lineterminator="\n")
    places = "block and marks", "pelvis and image", "the same without the spread of cutting", "eight needles", "eight needles and a gland that slides", "eight needles with strands"
    out.writerow(("quantity", "published", *(f"{place}, {part}" for place in places for part in ("5 %", "median", "95 %")),
                  "inside in the block", "inside in the pelvis", "inside without the spread of cutting", "inside with eight needles", "inside if the gland slides", "inside with strands", "depends most on", "rank correlation", "range of this parameter"))
    out.writerows([("" if np.isnan(cell) else f"{cell:.3g}") if isinstance(cell, float) else cell for cell in row] for row in beside)
if not rows.short:
    shutil.copy(rows.folder / "intervals.csv", HERE)

least, most = np.percentile(published["turn_least"], 5), np.percentile(published["turn_most"], 95)
rows.add("rotation of the gland in the coronal plane, in the course of the implant, either way", LAGERBURG, ABSTRACT, (0, 13.8), max(-least, most), "degrees",
         published="-11.2 to 13.8 degrees", kind=PREDICTED, fitted=FITTED, scatter=f"{least:.1f} to {most:.1f}", weak=True, regression=(1, 13.8), digits=2)

# ---- speed ----
within, paired = published["fast"] - published["slow"], of["fast"].paired(of["slow"], column("misplacement"))
low, mean, high = mean_of(within[np.isfinite(within)])
rows.interval("misplacement by needles with a peak speed of 160 mm/s, less that with 100 mm/s", SPEED, ABSTRACT, "0.49 mm (faster than 120 mm/s, less slower)", 0.49,
              mean_of(paired), "mm", same_sign=True, kind=PREDICTED, fitted=FITTED, middle="95 % confidence interval of the mean; mean", regression=(-1.5, 0.3),
              reason="the same implants of eight needles were simulated with all needles slow and with all fast, so the interval contains only the effect of speed. In the model, a faster "
                     f"needle moves the tissue less. Between the fast and the slow needles of one implant, which is what was published, the difference is {mean:.2f} mm on average (95 % "
                     f"confidence interval {low:.2f} to {high:.2f}). The published difference is an association within 15 patients (p = 0.012); who pushed fast, and why, was not controlled")

# ---- stabilising needles ----
for quantity, text, top, bottom, limits, options in (
        ("largest shift of the base while one needle is pushed, beside two stabilising needles and without", "less beside stabilising needles", "one_stabilised", "one", (0.3, 1.0),
         {"reason": "stabilising needles hold the gland only by friction, and in soft fat it yields with them. The abstract compares kinds of stabilising needles in a phantom, and "
                    "takes their effect for granted"}),
        ("largest shift of the base while one needle is pushed, beside angulated and beside parallel stabilising needles", "about 40 % less beside angulated ones",
         "one_angulated", "one_stabilised", (0.0, 1.0),
         {"reason": "the abstract states neither angles nor the phantom's stiffness; here the needles are tilted by 10 degrees (chosen by judgement), free of the template, and "
                    "held only by friction"})):
    times = ratio(top, bottom)(published)
    less = times[np.isfinite(times)] < 1
    rows.trend(quantity, PODDER, ABSTRACT, text, bool(less.all()), f"{span(times)} times; less in {less.sum()} of {len(less)} runs", kind=PREDICTED, fitted=FITTED, number=float(less.mean()),
               regression=limits, **options)

# ---- rows that explain others ----
for quantity, _, text, _, values, unit, _ in QUANTITIES:
    rows.show(f"{quantity}: eight needles in a gland that slides in the fat", "", ABSTRACT, text, f"{span(values(of['sliding']), unit)}; bonded {span(values(of['half']), unit)}")
    if quantity.startswith("misplacement"):
        rows.show(f"{quantity}: eight needles with strands", "", ABSTRACT, text, span(values(of["strands"]), unit))
rows.show("misplacement if each seed of a needle is misplaced along it like the first, as in a strand: mean", SEEDS, ABSTRACT, "4.9 mm (strands)", span(published["strand"], "mm"),
          note="an estimate for strands, which the patients had; in the model, each seed is dropped by itself")
rows.show("the same, along the needles", SEEDS, ABSTRACT, "3.8 mm", span(published["strand_z"], "mm"))
rows.show("the same, base divided by middle", SEEDS, ABSTRACT, "1.29", span(ratio("strand_base", "strand_middle")(published)))
rows.show("motion of the tissue of the gland's surface in the axial plane", STONE, ABSTRACT, "not measured", span(published["in_plane"], "mm"),
          note="the counted row until the abstract was read")
rows.show("change of the gland's width in axial slices counted from its base", STONE, ABSTRACT, "6.8 mm, if widths are meant", span(published["width"], "mm"))
for part in ("tissue", "image", "splay", "remainder"):
    rows.show(f"part of the misplacement: {part}", "", ABSTRACT, "not separated",
              f"along the needle {span(published[f'along_{part}'], 'mm')}; across {span(published[f'across_{part}'], 'mm')}")
sys.exit(rows.end())
