"""The report of a run: HTML with figures, JSON and CSV, and the comparison with other runs."""
from __future__ import annotations

import base64
import csv
import io
import json
from datetime import datetime, timezone
from html import escape
from pathlib import Path
from typing import Any, Iterable, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Model, __version__
from .._files import open_input, replacing
from ..brachy.plan import Frame
from ._measures import MEASURES, shown
from ._score import Result
from ._task import Task

Array = npt.NDArray[np.float64]

FORMAT = 1
STYLE = (Path(__file__).parent / "_report.css").read_text(encoding="utf-8")
COLOURS = {"gland": "#d55e00", "urethra": "#0072b2", "rectum": "#8a5a00"}    # after Okabe and Ito, can be told apart with colour-vision deficiency
PLANNED, ACHIEVED = "#6e40c9", "#007f5f"
OUTLINES = "#9aa4af"
MARGIN = 8e-3      # m, of a section around the targets or the plan and the gland


class BadReport(Exception):
    """A report in the folder of earlier runs, or the reference run, cannot be used."""


class Earlier(NamedTuple):
    """A report read from its JSON file."""

    path: str
    began: str
    passed: bool
    measures: dict[str, float | None]


# ---- JSON and CSV -------------------------------------------------------------------------------------------------------------------------


def began(result: Result) -> str:
    """Returns the time of the first wrench, in UTC, as in 2026-02-03T14:05:06Z."""
    return datetime.fromtimestamp(result.began // 1000000, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def _millimetres(row: Any) -> dict[str, Any]:
    known = row.offset is not None
    return {"hole": row.hole, "planned": row.planned and row.planned.number, "placed": row.placed and row.placed.number,
            "along": 1e-3 * row.along if known else None, "across": 1e-3 * row.across if known else None,
            "distance": 1e-3 * float(np.linalg.norm(row.offset)) if known else None}


def as_json(result: Result) -> str:
    """Returns the report as JSON, in SI units, Gy and fractions. The same recording and task always give the same text."""
    return json.dumps({
        "format": FORMAT, "trocar": __version__, "task": result.task.name, "title": result.task.title, "began": began(result), "passed": result.passed,
        "measures": result.measures,
        "criteria": [{"measure": c.measure, "value": value, "least": c.least, "most": c.most, "met": met, "source": c.source} for c, value, met in result.judgements],
        "targets": [{"name": r.target.name, "error": r.error, "tip": None if r.tip is None else r.tip.tolist()} for r in result.reached],
        "seeds": [_millimetres(row) for row in result.seeds],
        "organs": result.organs}, indent=1) + "\n"


def as_csv(result: Result) -> str:
    """Returns the measures as a table, in SI units, Gy and fractions."""
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
    """Reads a report from its JSON file. Raises BadReport if it is none, or of another task than `task`."""
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
        raise BadReport(f"{path}: a report of format {form}, this release reads {FORMAT}: score its recording again")
    if task and of != task:
        raise BadReport(f"{path}: a report of the task \"{of}\", not of \"{task}\"")
    return made


def earlier_runs(folder: Path, task: Task, before: str = "") -> list[Earlier]:
    """Returns the runs of a task in a folder of runs, oldest first; only those that began before `before`, if it is given."""
    runs = [read_report(path, task.name) for path in sorted(folder.glob(f"{task.name}/*.json"))]
    return sorted((run for run in runs if not before or run.began < before), key=lambda run: run.began)


# ---- figures ------------------------------------------------------------------------------------------------------------------------------


def _svg(figure: Any) -> str:
    """Returns a figure as text of an SVG image; the same figure gives the same text."""
    import matplotlib
    out = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "trocar", "svg.fonttype": "none"}):
        figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()


def _figure(width: float, height: float, widths: Sequence[float] = (1,)) -> tuple[Any, Sequence[Any]]:
    """Makes a figure (inches) with panels of these relative widths."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, np.atleast_1d(figure.subplots(1, len(widths), width_ratios=widths))


def _section(model: Model, tets: npt.NDArray[np.int32], axis: int, at: float) -> Array:
    """Returns the outlines (n, 2, 3) m, of tetrahedra together, in the plane where coordinate `axis` is `at`, as segments."""
    faces = np.sort(np.concatenate([np.delete(tets, corner, axis=1) for corner in range(4)]), axis=1)
    unique, times = np.unique(faces, axis=0, return_counts=True)
    corners = model.nodes[unique[times == 1]]
    height = corners[:, :, axis] - at - 1e-9
    segments = []
    for triangle, above in zip(corners, height):
        crossings = [triangle[i] + above[i] / (above[i] - above[k]) * (triangle[k] - triangle[i]) for i, k in ((0, 1), (1, 2), (2, 0)) if (above[i] > 0) != (above[k] > 0)]
        if len(crossings) == 2:
            segments.append(crossings)
    return np.array(segments).reshape(-1, 2, 3)


def _points(result: Result) -> tuple[Array, Array]:
    """Returns the wanted and the achieved positions (n, 3) m: of targets and tips, or of planned and placed seeds."""
    task = result.task
    if task.plan:
        wanted = [row.planned.position for row in result.seeds if row.planned]
        achieved = [row.placed.position for row in result.seeds if row.placed]
    else:
        wanted, achieved = [r.target.position for r in result.reached], [r.tip for r in result.reached if r.tip is not None]
    return np.reshape(wanted, (-1, 3)), np.reshape(achieved, (-1, 3))


def draw_sections(result: Result) -> str:
    """Draws wanted and achieved places, and the paths of the needles, over three sections through the middle of the wanted places."""
    from matplotlib.collections import LineCollection
    task, model, frame = result.task, result.task.model, Frame(result.task.model)
    wanted, achieved = _points(result)
    middle = wanted.mean(axis=0)
    around = np.concatenate([wanted, achieved, model.nodes[np.unique(task.tets_of("gland"))]])
    low, high = 1e3 * (around.min(axis=0) - MARGIN), 1e3 * (around.max(axis=0) + MARGIN)
    in_roles = {name for names in task.organs.values() for name in names}
    others = [model.groups[i] for i in np.unique(model.part_of[model.tet_regions]) if model.groups[i] not in in_roles]
    size = high - low
    figure, panels = _figure(10.5, 4.4, [size[0], size[1], size[0]])
    for panel, (title, axis, across, up) in zip(panels, (("axial", 2, 0, 1), ("sagittal", 0, 1, 2), ("coronal", 1, 0, 2))):
        for name in others:
            panel.add_collection(LineCollection(1e3 * _section(model, model.tets_of(name), axis, middle[axis])[:, :, [across, up]], colors=OUTLINES, linewidths=0.7))
        for role in task.organs:
            panel.add_collection(LineCollection(1e3 * _section(model, task.tets_of(role), axis, middle[axis])[:, :, [across, up]], colors=COLOURS[role], linewidths=1.5))
            panel.plot([], [], color=COLOURS[role], label=role)
        for path in result.paths:
            panel.plot(*1e3 * path[:, [across, up]].T, color="black", linewidth=0.8, alpha=0.6)
        panel.plot(*1e3 * wanted[:, [across, up]].T, "o", color=PLANNED, fillstyle="none", markersize=6, label="planned" if task.plan else "target")
        panel.plot(*1e3 * achieved[:, [across, up]].T, ".", color=ACHIEVED, markersize=6, label="seed" if task.plan else "tip")
        panel.set(xlim=(low[across], high[across]), ylim=(low[up], high[up]), aspect="equal", xlabel=f"{'xyz'[across]} (mm)", ylabel=f"{'xyz'[up]} (mm)",
                  title=f"{title}, {'xyz'[axis]} = {1e3 * middle[axis]:.0f} mm")
        if frame.is_patient and across == 0:
            panel.invert_xaxis()    # the patient's right is on the left of the image
    panels[1].legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=5, frameon=False)
    return _svg(figure)


def draw_forces(result: Result) -> str:
    """Draws the force on the hand against time."""
    figure, (panel,) = _figure(10.5, 2.8)
    times, forces = result.forces
    # the largest force of each of at most 2000 intervals, so that no peak is lost
    bins = np.minimum((2000 * times / max(times[-1], 1e-9)).astype(int), 1999)
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    panel.plot(times[first], np.maximum.reduceat(forces, first), color="#0072b2", linewidth=1)
    panel.set(xlabel="time since the first contact (s)", ylabel="force on the hand (N)", xlim=(0, times[-1] or 1), ylim=(0, None))
    panel.grid(alpha=0.3)
    return _svg(figure)


def draw_histograms(result: Result) -> str:
    """Draws the dose-volume histograms of the organs, as planned and as achieved."""
    figure, (panel,) = _figure(10.5, 3.6)
    prescription = result.task.plan.prescription
    doses = np.linspace(0.0, 3.0 * prescription, 301)
    for role, planned, achieved in result.histograms:
        for dvh, style, words in ((planned, "--", "planned"), (achieved, "-", "achieved")):
            panel.plot(doses, [100.0 * dvh.volume(dose) for dose in doses], style, color=COLOURS[role], label=f"{role}, {words}")
    for factor in (1.0, 1.5):
        panel.axvline(factor * prescription, color=OUTLINES, linewidth=1)
    panel.set(xlabel="dose (Gy)", ylabel="volume (%)", xlim=(0, doses[-1]), ylim=(0, 101))
    panel.grid(alpha=0.3)
    panel.legend(frameon=False)
    return _svg(figure)


def _image(svg: str, words: str) -> str:
    data = base64.b64encode(svg.encode()).decode()
    return f'<figure><img src="data:image/svg+xml;base64,{data}" alt="{escape(words)}"><figcaption>{escape(words)}</figcaption></figure>'


# ---- HTML ---------------------------------------------------------------------------------------------------------------------------------


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str, numbers: Sequence[int] = ()) -> str:
    """Makes a table; cells are plain text. `numbers`: columns that are aligned to the right."""
    cell = lambda i, text, tag="td": f'<{tag}{" class=number" if i in numbers else ""}>{escape(text)}</{tag}>'
    header = "".join(f'<th scope="col"{" class=number" if i in numbers else ""}>{escape(text)}</th>' for i, text in enumerate(head))
    body = "".join("<tr>" + "".join(cell(i, text) for i, text in enumerate(row)) + "</tr>\n" for row in rows)
    return f"<table><caption>{escape(caption)}</caption>\n<thead><tr>{header}</tr></thead>\n<tbody>\n{body}</tbody></table>\n"


def _limit(criterion: Any) -> str:
    return f"at least {shown(criterion.measure, criterion.least)}" if criterion.least is not None else f"at most {shown(criterion.measure, criterion.most)}"


def _best(name: str, runs: Sequence[Earlier], result: Result) -> str:
    """Returns the best value of earlier runs by the task's criterion of this measure; empty if there is none."""
    values = [run.measures[name] for run in runs if run.measures.get(name) is not None]
    criterion = next((c for c in result.task.criteria if c.measure == name), None)
    if not values or not criterion:
        return ""
    return shown(name, max(values) if criterion.least is not None else min(values))


def _comparison(result: Result, runs: Sequence[Earlier], reference: Earlier | None) -> str:
    head = ["measure", "", "this run"]
    if runs:
        head += ["run before", "best so far"]
    if reference:
        head.append("reference")
    rows = []
    for name, value in result.measures.items():
        row = [name, MEASURES[name].words, shown(name, value)]
        if runs:
            row += [shown(name, runs[-1].measures.get(name)), _best(name, runs, result)]
        if reference:
            row.append(shown(name, reference.measures.get(name)))
        rows.append(row)
    return _table(head, rows, "All measures", range(2, len(head)))


def _places(result: Result) -> str:
    if not result.task.plan:
        return _table(["target", "distance"], [[r.target.name, shown("tip_error", r.error)] for r in result.reached], "Targets", [1])
    mm = lambda value, sign="": "–" if value is None else f"{value:{sign}.1f}".replace("-", "\u2212")
    rows = [[row.hole or "none", str(row.planned.number) if row.planned else "–", mm(row.along, "+"), mm(row.across),
             mm(None if row.offset is None else float(np.linalg.norm(row.offset))), "not left in the tissue" if not row.placed else "not planned" if not row.planned else ""]
            for row in result.seeds]
    return _table(["hole", "seed", "along (mm)", "across (mm)", "distance (mm)", ""], rows, "Seeds; along the needle, positive is too deep", [1, 2, 3, 4])


def as_html(result: Result, runs: Sequence[Earlier] = (), reference: Earlier | None = None) -> str:
    """Returns the report as a page of HTML without scripts, which can be printed. `runs`: earlier runs, oldest first."""
    task, met = result.task, sum(j.met for j in result.judgements)
    verdict = "Passed" if result.passed else "Not passed"
    parts = [f"<h1>{escape(task.title)}</h1>", f"<p>{escape(task.text)}</p>",
             f'<p class="verdict {"passed" if result.passed else "failed"}"><strong>{verdict}</strong>: {met} of {len(result.judgements)} criteria are met. '
             f"Run of {escape(began(result).replace('T', ' ').replace('Z', ' UTC'))}"
             + (f", after {len(runs)} earlier run{'s' if len(runs) > 1 else ''}, of which {sum(run.passed for run in runs)} passed" if runs else "") + ".</p>"]
    parts.append(_table(["", "measure", "this run", "criterion", "source"],
                        [["met" if ok else "not met", MEASURES[c.measure].words, shown(c.measure, value), _limit(c), c.source] for c, value, ok in result.judgements],
                        "Criteria", [2, 3]))
    parts.append(_image(draw_sections(result), "Wanted and achieved places, over sections of the organs, and the paths of the needles in the tissue at rest"))
    if len(result.forces[0]):
        parts.append(_image(draw_forces(result), "Force on the hand"))
    if result.histograms:
        parts.append(_image(draw_histograms(result), "Dose-volume histograms, with all needles out"))
    parts.append(_comparison(result, runs, reference))
    parts.append(_places(result))
    if result.organs:
        parts.append(_table(["region", "length", ""], [[name, f"{1e3 * length:.0f} mm", "to be avoided" if name in task.avoid else ""] for name, length in result.organs.items()],
                            "Regions that needles entered", [1]))
    parts.append(f"<p>trocar {escape(__version__)}. For training at a simulator. Not for treatment.</p>")
    return ("<!DOCTYPE html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">"
            f"<title>{escape(task.title)}: {verdict.lower()}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n" + "\n".join(parts) + "\n</main></body>\n</html>\n")


def save(path: Path, text: str) -> None:
    """Writes a text as a whole."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
