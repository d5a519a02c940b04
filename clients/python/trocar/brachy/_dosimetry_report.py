"""Reports the doses of an implant, as planned, as achieved and after swelling, in HTML with figures, JSON and CSV."""
from __future__ import annotations

import csv
import io
import json
from html import escape
from typing import Sequence

import numpy as np
import numpy.typing as npt

from .. import __version__
from .._page import ACHIEVED, COLOURS, OUTLINES, PLANNED, figure, image, page, svg, table
from . import swelling as swellings
from .evaluation import Dosimetry
from ._goals import Figure
from .plan import Frame, Misplacement, planned_seeds, summary

Array = npt.NDArray[np.float64]

FORMAT = 1
NOTICE = "Not for treatment. The doses are those of a simulation; stiffness, friction and the operator are assumptions."
STYLES = {"planned": "--", "at the last seed": ":", "needles out": "-", "after swelling": "-."}
MARGIN = 6.0       # mm, margin around the gland and the seeds in the section views


def _figures(done: Dosimetry) -> list[Figure]:
    return [f for f in done.goals if f.organ in done.organs]


def limit(f: Figure, prescription: float) -> str:
    """Returns text for the limits on a dose-volume figure, or "" if it has none."""
    least, most = f.limit(prescription)
    return ", ".join(f"at {word} {f.shown(value)}" for word, value in (("least", least), ("most", most)) if value is not None)


def as_text(done: Dosimetry) -> str:
    """Returns the dose-volume figures as a table for a terminal."""
    rows = [["", "limit", *(state.name for state in done.states)]]
    for f in _figures(done):
        rows.append([f.name, limit(f, done.plan.prescription), *(_judged(f, state.figures[f.name], done) for state in done.states)])
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return "\n".join("  ".join(text.ljust(width) if i < 2 else text.rjust(width) for i, (text, width) in enumerate(zip(row, widths))).rstrip() for row in rows)


def _judged(f: Figure, value: float, done: Dosimetry) -> str:
    return f.shown(value) + (" !" if f.met(value, done.plan.prescription) is False else "")


def _metres(row: Misplacement) -> dict[str, object]:
    known = row.offset is not None
    return {"hole": row.hole, "planned": row.planned and row.planned.number, "placed": row.placed and row.placed.number, "along": 1e-3 * row.along if known else None,
            "across": 1e-3 * row.across if known else None, "distance": 1e-3 * float(np.linalg.norm(row.offset)) if known else None}


def as_json(done: Dosimetry, files: Sequence[str] = ()) -> str:
    """Returns the report as JSON, in SI units, Gy, fractions and, for absolute volumes, cm^3. `files`: names of the DICOM files."""
    source, prescription = done.plan.source, done.plan.prescription
    limits = {f.name: f.limit(prescription) for f in _figures(done)}
    return json.dumps({
        "format": FORMAT, "trocar": __version__, "notice": NOTICE, "plan": done.plan.path, "prescription": prescription,
        "source": {"isotope": source.isotope, "model": source.model, "strength": source.strength},
        "swelling": {"ratio": done.swelling.ratio, "days": done.swelling.days, "half_life": done.swelling.half_life, "words": done.swelling.words()},
        "organs": {role: {"name": organ.name, "volume": organ.volume} for role, organ in done.organs.items()},
        "limits": {name: {"least": least, "most": most} for name, (least, most) in limits.items()},
        "states": [{"name": s.name, "words": s.words, "figures": s.figures, "unmet": [f.name for f in _figures(done) if f.met(s.figures[f.name], prescription) is False]}
                   for s in done.states],
        "seeds": [_metres(row) for row in done.misplacement], "dicom": list(files)}, indent=1) + "\n"


def as_csv(done: Dosimetry) -> str:
    """Returns the dose-volume figures as CSV, in Gy, fractions and cm^3."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["figure", "least", "most", *(state.name for state in done.states), "source"])
    for f in _figures(done):
        rows.writerow([f.name, *("" if value is None else repr(value) for value in f.limit(done.plan.prescription)), *(repr(s.figures[f.name]) for s in done.states), f.source])
    return out.getvalue()


def histograms_csv(done: Dosimetry) -> str:
    """Returns the dose-volume histograms as CSV: for each dose, in steps of 1 Gy, the fraction of each organ that receives at least that dose."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["dose [Gy]", *(f"{organ.name}, {state.name}" for organ in done.organs.values() for state in done.states)])
    for dose in range(int(3 * done.plan.prescription) + 1):
        rows.writerow([dose, *(f"{state.histograms[role].volume(float(dose)):.6g}" for role in done.organs for state in done.states)])
    return out.getvalue()


# ---- figures ------------------------------------------------------------------------------------------------------------------------------


def draw_histograms(done: Dosimetry) -> str:
    """Draws the organs' dose-volume histograms for all states of the implant."""
    drawn, panels = figure(10.5, 3.8, [1.0] * len(done.organs))
    doses = np.linspace(0.0, 3.0 * done.plan.prescription, 301)
    for panel, (role, organ) in zip(panels, done.organs.items()):
        for state in done.states:
            panel.plot(doses, [100.0 * state.histograms[role].volume(dose) for dose in doses], STYLES[state.name], color=COLOURS[role], label=state.name)
        for factor in (1.0, 1.5):
            panel.axvline(factor * done.plan.prescription, color=OUTLINES, linewidth=1)
        panel.set(xlabel="dose (Gy)", ylabel="volume (%)", xlim=(0, doses[-1]), ylim=(0, 101), title=organ.name)
        panel.grid(alpha=0.3)
    panels[-1].legend(frameon=False)
    return svg(drawn)


def _mask(points: Array, axis: int, at: float) -> tuple[Array, Array, Array]:
    """Rasterises the voxels centred at `points` (n, 3) mm that lie within 1 mm of the plane where coordinate `axis` is `at`. Returns the coordinates of
    the cells of a 1 mm grid in the plane, and a mask of the cells that contain voxels."""
    across = [a for a in range(3) if a != axis]
    near = points[np.abs(points[:, axis] - at) <= 1.0][:, across]
    if not len(near):
        return np.zeros(0), np.zeros(0), np.zeros((0, 0))
    edges = [np.arange(near[:, a].min() - 2.5, near[:, a].max() + 3.0, 1.0) for a in range(2)]
    counts = np.histogram2d(near[:, 0], near[:, 1], bins=edges)[0] > 0
    return edges[0][:-1] + 0.5, edges[1][:-1] + 0.5, counts.astype(float)


def draw_sections(done: Dosimetry) -> str:
    """Draws the planned and achieved seed positions over three sections of the organs through the gland's centre."""
    frame = Frame(done.model)
    planned = frame.position([seed.position for seed in planned_seeds(done.plan, done.model)])
    placed = frame.position([seed.position for seed in done.placed])
    voxels = {role: frame.position(organ.points) for role, organ in done.organs.items()}
    around = np.concatenate([planned, placed, voxels["gland"]])
    low, high, middle = around.min(axis=0) - MARGIN, around.max(axis=0) + MARGIN, voxels["gland"].mean(axis=0)
    size = high - low
    drawn, panels = figure(10.5, 4.4, [size[0], size[1], size[0]])
    for panel, (title, axis, across, up, down) in zip(panels, (("axial", 2, 0, 1, True), ("sagittal", 0, 1, 2, False), ("coronal", 1, 0, 2, False))):
        for role, points in voxels.items():
            x, y, mask = _mask(points, axis, middle[axis])
            if mask.any():
                panel.contour(x, y, mask.T, levels=[0.5], colors=COLOURS[role], linewidths=1.3)
            panel.plot([], [], color=COLOURS[role], label=role)
        panel.plot(*planned[:, [across, up]].T, "o", color=PLANNED, fillstyle="none", markersize=6, label="planned")
        panel.plot(*placed[:, [across, up]].T, ".", color=ACHIEVED, markersize=6, label="seed")
        panel.set(xlim=(low[across], high[across]), ylim=(high[up], low[up]) if down else (low[up], high[up]), aspect="equal", xlabel=f"{frame.names[across]} (mm)",
                  ylabel=f"{frame.names[up]} (mm)", title=f"{title}, {frame.names[axis]} {middle[axis]:.0f} mm")
    panels[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=5, frameon=False)
    return svg(drawn)


# ---- HTML ---------------------------------------------------------------------------------------------------------------------------------


def _misplacement(done: Dosimetry) -> list[str]:
    mean = summary(done.misplacement)
    if not mean["count"]:
        return ["<p>No seed has a planned position.</p>"]
    mm = lambda value, sign="": "–" if value is None else f"{value:{sign}.1f}".replace("-", "−")
    rows = [[row.hole or "none", str(row.planned.number) if row.planned else "–", mm(row.along, "+"), mm(row.across), mm(None if row.offset is None else float(np.linalg.norm(row.offset))),
             "not left in the tissue" if not row.placed else "not planned" if not row.planned else ""] for row in done.misplacement]
    return [f"<p>{int(mean['count'])} seeds are {mm(mean['distance'])} mm from their planned positions on average: {mm(mean['deeper'], '+')} mm along the needle "
            f"(positive is too deep), {mm(mean['across'])} mm across.</p>",
            table(["hole", "seed", "along (mm)", "across (mm)", "distance (mm)", ""], rows, "Misplacement of the seeds, in the tissue at rest", [1, 2, 3, 4])]


def as_html(done: Dosimetry, files: Sequence[str] = ()) -> str:
    """Returns the report as a printable HTML page without scripts. `files`: names of the DICOM files."""
    plan, prescription = done.plan, done.plan.prescription
    rows = [[f.name, limit(f, prescription), *(_judged(f, s.figures[f.name], done) for s in done.states), f.source] for f in _figures(done)]
    organs = ", ".join(f"{organ.name} ({1e6 * organ.volume:.1f} cm³)" for organ in done.organs.values())
    parts = [f'<p class="verdict failed"><strong>{escape(NOTICE.partition(". ")[0])}.</strong> {escape(NOTICE.partition(". ")[2])}</p>',
             "<h1>Implant: planned, achieved, and after swelling</h1>",
             f"<p>{escape(plan.path)}: {len(plan.needles)} needles, {sum(len(n.seeds) for n in plan.needles)} seeds {escape(done.source.name)} of {plan.source.strength:g} U; "
             f"{len(done.placed)} were left in the tissue. Prescription {prescription:g} Gy. Organs: {escape(organs)}; the urethra within the gland's bounding box.</p>",
             table(["figure", "limit", *(s.name for s in done.states), "source of the limit"], rows, "Dose; an exclamation mark indicates a missed limit", range(2, 2 + len(done.states))),
             "<ul>" + "".join(f"<li><strong>{escape(s.name)}</strong>: {escape(s.words)}.</li>" for s in done.states) + "</ul>",
             f"<p>Swelling: {escape(swellings.SOURCE if done.swelling == swellings.Swelling() else 'as chosen')}. After the implant, the gland swells uniformly with its "
             "seeds, and the surrounding tissue moves aside.</p>",
             image(draw_histograms(done), "Dose-volume histograms"),
             image(draw_sections(done), "Planned and achieved positions of the seeds, over sections of the organs at rest"), *_misplacement(done)]
    if files:
        parts.append(f"<p>DICOM files: {escape(', '.join(files))}.</p>")
    parts.append(f"<p>trocar {escape(__version__)}. Not for treatment.</p>")
    return page("Implant: not for treatment", parts)
