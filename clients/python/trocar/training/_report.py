"""Writes the report on a run, in HTML with figures, JSON and CSV, and compares it with other runs."""
from __future__ import annotations

import csv
import io
import json
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import Any, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import __version__
from .._files import open_input
from .._page import ACHIEVED, COLOURS, OUTLINES, PLANNED, figure, image, page, section, svg, table
from ..brachy.plan import Frame
from ._measures import MEASURES, shown
from ._score import Result
from ._task import Task
from ._words import ENGLISH, Words

Array = npt.NDArray[np.float64]

FORMAT = 1
MARGIN = 8e-3      # m, margin around the gland and the targets or planned seeds in the section views


class BadReport(Exception):
    """Raised if the report of an earlier run or of the reference run cannot be used."""


class Earlier(NamedTuple):
    """A report read from its JSON file."""

    path: str
    began: str
    passed: bool
    measures: dict[str, float | None]


# ---- JSON and CSV -------------------------------------------------------------------------------------------------------------------------


def began(result: Result) -> str:
    """Returns the time of the first wrench, in UTC, in the form 2026-02-03T14:05:06Z."""
    return datetime.fromtimestamp(result.began // 1000000, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def _millimetres(row: Any) -> dict[str, Any]:
    known = row.offset is not None
    return {"hole": row.hole, "planned": row.planned and row.planned.number, "placed": row.placed and row.placed.number,
            "along": 1e-3 * row.along if known else None, "across": 1e-3 * row.across if known else None,
            "distance": 1e-3 * float(np.linalg.norm(row.offset)) if known else None}


def as_json(result: Result) -> str:
    """Returns the report as JSON, in SI units, Gy and fractions. The text depends only on the recording and the task."""
    return json.dumps({
        "format": FORMAT, "trocar": __version__, "task": result.task.name, "title": result.task.title, "began": began(result), "passed": result.passed,
        "measures": result.measures,
        "criteria": [{"measure": c.measure, "value": value, "least": c.least, "most": c.most, "met": met, "source": c.source} for c, value, met in result.judgements],
        "targets": [{"name": r.target.name, "error": r.error, "tip": None if r.tip is None else r.tip.tolist()} for r in result.reached],
        "seeds": [_millimetres(row) for row in result.seeds],
        "organs": result.organs, "surfaces": result.touched, "lost": {"wrenches": result.lost, "of": result.ticks}}, indent=1) + "\n"


def as_csv(result: Result) -> str:
    """Returns the measures as CSV, in SI units, Gy and fractions."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["measure", "value", "least", "most", "met", "source"])
    number = lambda value: "" if value is None else repr(value)
    judged = {j.criterion.measure for j in result.judgements}
    for c, value, met in result.judgements:
        rows.writerow([c.measure, number(value), number(c.least), number(c.most), "yes" if met else "no", c.source])
    for name, value in result.measures.items():
        if name not in judged:
            rows.writerow([name, number(value), "", "", "", ""])
    return out.getvalue()


def read_report(path: Path, task: str = "") -> Earlier:
    """Reads a report from its JSON file. Raises BadReport if it is not a report, or not one for `task` (if given)."""
    try:
        with open_input(path, encoding="utf-8") as file:
            found = json.load(file)
        made = Earlier(str(path), str(found["began"]), found["passed"] is True,
                       {name: None if value is None else float(value) for name, value in found["measures"].items() if name in MEASURES})
        of, form = found["task"], found["format"]
    except OSError as error:
        raise BadReport(f"{path}: cannot be opened: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise BadReport(f"{path}: not a report of trocar-score: remove it, or choose another folder") from error
    if form != FORMAT:
        raise BadReport(f"{path}: a report of format {form}, but this release reads {FORMAT}: score its recording again")
    if task and of != task:
        raise BadReport(f"{path}: a report of the task \"{of}\", not of \"{task}\"")
    return made


def earlier_runs(folder: Path, task: Task, before: str = "") -> list[Earlier]:
    """Returns a task's runs from a folder of reports, oldest first. If `before` is given, only runs that began earlier."""
    runs = [read_report(path, task.name) for path in sorted(folder.glob(f"{task.name}/*.json"))]
    return sorted((run for run in runs if not before or run.began < before), key=lambda run: run.began)


# ---- figures ------------------------------------------------------------------------------------------------------------------------------


def _points(result: Result) -> tuple[Array, Array]:
    """Returns the desired and the achieved positions (n, 3) m, either of targets and needle tips or of planned and placed seeds."""
    task = result.task
    if task.plan:
        wanted = [row.planned.position for row in result.seeds if row.planned]
        achieved = [row.placed.position for row in result.seeds if row.placed]
    else:
        wanted, achieved = [r.target.position for r in result.reached], [r.tip for r in result.reached if r.tip is not None]
    return np.reshape(wanted, (-1, 3)), np.reshape(achieved, (-1, 3))


def draw_sections(result: Result, words: Words) -> str:
    """Draws the desired and achieved positions, and the needle paths, over three sections through the mean desired position."""
    from matplotlib.collections import LineCollection
    task, model, frame = result.task, result.task.model, Frame(result.task.model)
    wanted, achieved = _points(result)
    middle = wanted.mean(axis=0)
    around = np.concatenate([wanted, achieved, model.nodes[np.unique(task.tets_of("gland"))]])
    low, high = 1e3 * (around.min(axis=0) - MARGIN), 1e3 * (around.max(axis=0) + MARGIN)
    in_roles = {name for names in task.organs.values() for name in names}
    others = [model.groups[i] for i in np.unique(model.part_of[model.tet_regions]) if model.groups[i] not in in_roles]
    size = high - low
    drawn, panels = figure(10.5, 4.4, [size[0], size[1], size[0]])
    for panel, (name_of, axis, across, up) in zip(panels, (("axial", 2, 0, 1), ("sagittal", 0, 1, 2), ("coronal", 1, 0, 2))):
        for name in others:
            panel.add_collection(LineCollection(1e3 * section(model, model.tets_of(name), axis, middle[axis])[:, :, [across, up]], colors=OUTLINES, linewidths=0.7))
        for role in task.organs:
            panel.add_collection(LineCollection(1e3 * section(model, task.tets_of(role), axis, middle[axis])[:, :, [across, up]], colors=COLOURS[role], linewidths=1.5))
            panel.plot([], [], color=COLOURS[role], label=words(f"figure.{role}"))
        for path in result.paths:
            panel.plot(*1e3 * path[:, [across, up]].T, color="black", linewidth=0.8, alpha=0.6)
        panel.plot(*1e3 * wanted[:, [across, up]].T, "o", color=PLANNED, fillstyle="none", markersize=6, label=words("figure.planned" if task.plan else "figure.target"))
        panel.plot(*1e3 * achieved[:, [across, up]].T, ".", color=ACHIEVED, markersize=6, label=words("figure.seed" if task.plan else "figure.tip"))
        panel.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal", xlabel=f"{'xyz'[across]} (mm)", ylabel=f"{'xyz'[up]} (mm)",
                  title=f"{words(f'figure.{name_of}')}, {'xyz'[axis]} = {1e3 * middle[axis]:.0f} mm")
        if frame.is_patient and across == 0:
            panel.invert_xaxis()    # by convention, the patient's right is on the left of the image
    panels[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=5, frameon=False)
    return svg(drawn)


def draw_forces(result: Result, words: Words) -> str:
    """Draws the force on the hand against time."""
    drawn, (panel,) = figure(10.5, 2.8)
    times, forces = result.forces
    # Plot the largest force in each of at most 2000 intervals, so that no peak is lost.
    bins = np.minimum((2000 * times / max(times[-1], 1e-9)).astype(int), 1999)
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    panel.plot(times[first], np.maximum.reduceat(forces, first), color="#0072b2", linewidth=1)
    panel.set(xlabel=words("figure.time"), ylabel=words("figure.force"), xlim=(0, times[-1] or 1), ylim=(0, None))
    panel.grid(alpha=0.3)
    return svg(drawn)


def draw_histograms(result: Result, words: Words) -> str:
    """Draws the organs' dose-volume histograms, as planned and as achieved."""
    drawn, (panel,) = figure(10.5, 3.6)
    prescription = result.task.plan.prescription
    doses = np.linspace(0.0, 3.0 * prescription, 301)
    for role, planned, achieved in result.histograms:
        for dvh, style, state in ((planned, "--", "planned"), (achieved, "-", "achieved")):
            panel.plot(doses, [100.0 * dvh.volume(dose) for dose in doses], style, color=COLOURS[role], label=f"{words(f'figure.{role}')}, {words(f'figure.{state}')}")
    for factor in (1.0, 1.5):
        panel.axvline(factor * prescription, color=OUTLINES, linewidth=1)
    panel.set(xlabel=words("figure.dose"), ylabel=words("figure.volume"), xlim=(0, doses[-1]), ylim=(0, 101))
    panel.grid(alpha=0.3)
    panel.legend(frameon=False)
    return svg(drawn)


# ---- HTML ---------------------------------------------------------------------------------------------------------------------------------


def _best(name: str, runs: Sequence[Earlier], result: Result) -> str:
    """Formats the best value of a measure in earlier runs, where the task's criterion decides what is better. "" if there is none."""
    values = [run.measures[name] for run in runs if run.measures.get(name) is not None]
    criterion = next((c for c in result.task.criteria if c.measure == name), None)
    if not values or not criterion:
        return ""
    return shown(name, max(values) if criterion.least is not None else min(values))


def _comparison(result: Result, runs: Sequence[Earlier], reference: Earlier | None, words: Words) -> str:
    head = [words("criteria.measure"), "", words("criteria.run")]
    if runs:
        head += [words("measures.before"), words("measures.best")]
    if reference:
        head.append(words("measures.reference"))
    rows = []
    for name, value in result.measures.items():
        row = [name, words(f"measure.{name}"), shown(name, value)]
        if runs:
            row += [shown(name, runs[-1].measures.get(name)), _best(name, runs, result)]
        if reference:
            row.append(shown(name, reference.measures.get(name)))
        rows.append(row)
    return table(head, rows, words("measures"), range(2, len(head)))


def _places(result: Result, words: Words) -> str:
    if not result.task.plan:
        return table([words("targets.target"), words("targets.distance")], [[r.target.name, shown("tip_error", r.error)] for r in result.reached], words("targets"), [1])
    mm = lambda value, sign="": "–" if value is None else f"{value:{sign}.1f}".replace("-", "\u2212")
    rows = [[row.hole or words("seeds.none"), str(row.planned.number) if row.planned else "–", mm(row.along, "+"), mm(row.across),
             mm(None if row.offset is None else float(np.linalg.norm(row.offset))), words("seeds.missing") if not row.placed else words("seeds.extra") if not row.planned else ""]
            for row in result.seeds]
    return table([*(words(f"seeds.{column}") for column in ("hole", "seed", "along", "across", "distance")), ""], rows, words("seeds"), [1, 2, 3, 4])


def as_html(result: Result, runs: Sequence[Earlier] = (), reference: Earlier | None = None, language: str = ENGLISH) -> str:
    """Returns the report as a printable HTML page without scripts. runs: earlier runs, oldest first. The language affects only words, not numbers."""
    task, words, texts = result.task, Words(language), result.task.texts(language)
    passed, met = words("passed" if result.passed else "failed"), sum(j.met for j in result.judgements)
    verdict = words("verdict", met=met, count=len(result.judgements), time=began(result).replace("T", " ").replace("Z", " UTC"))
    if runs:
        verdict = words("verdict.runs", verdict=verdict, count=len(runs), passed=sum(run.passed for run in runs))
    parts = [f"<h1>{escape(texts.title)}</h1>", f"<p><strong>{escape(words('notice'))}</strong></p>", f"<p>{escape(texts.text)}</p>",
             f'<p class="verdict {"passed" if result.passed else "failed"}"><strong>{escape(passed)}</strong>: {escape(verdict)}.</p>']
    if result.lost:
        parts.append(f"<p>{escape(words('lost', lost=result.lost, count=result.ticks))}</p>")
    parts.append(table(["", *(words(f"criteria.{column}") for column in ("measure", "run", "criterion", "source"))],
                       [[words("criteria.met" if ok else "criteria.unmet"), words(f"measure.{c.measure}"), shown(c.measure, value), words.limit(c.measure, c.least, c.most), source]
                        for (c, value, ok), source in zip(result.judgements, texts.sources)], words("criteria"), [2, 3]))
    parts.append(image(draw_sections(result, words), words("figure.sections")))
    if len(result.forces[0]):
        parts.append(image(draw_forces(result, words), words("figure.forces")))
    if result.histograms:
        parts.append(image(draw_histograms(result, words), words("figure.histograms")))
    parts.append(_comparison(result, runs, reference, words))
    parts.append(_places(result, words))
    entered = [[name, f"{1e3 * length:.0f} mm", words("regions.avoid") if name in task.avoid else ""] for name, length in result.organs.items()]
    entered += [[name, words("regions.touched"), words("regions.avoid")] for name in result.touched]
    if entered:
        parts.append(table([words("regions.region"), words("regions.length"), ""], entered, words("regions"), [1]))
    parts.append(f"<p>{escape(words('end', version=__version__))}</p>")
    return page(f"{texts.title}: {passed.lower()}", parts, words.language)
