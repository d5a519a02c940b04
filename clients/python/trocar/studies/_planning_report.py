"""Writes the output of trocar-plan: CSV and Markdown tables, and plots."""
from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Sequence

import numpy as np

from .. import Model
from .._locate import locate
from ..brachy._obstacles import region_points
from ._problem import Problem
from ._summary import _start_plots, _table
from ..brachy.plan import Frame, Needle

COLOURS = {"without planning": "#D55E00", "rigid planning": "#E69F00", "nominal plan": "#56B4E9", "this plan": "#0072B2"}


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f}" if np.isfinite(value) else "-"


def _described(problem: Problem, needle: Needle, frame: Frame) -> list[str]:
    """Describes a needle in words: entry, tilt towards each edge of the entry rectangle, depth, roll and turn."""
    where = needle.hole or " ".join(f"{x:.1f}" for x in frame.position(needle.entry))
    tilt = ""
    if problem.area is not None:
        direction, edges = np.array(needle.direction), problem.area.edges / np.linalg.norm(problem.area.edges, axis=1)[:, None]
        aside = direction - (direction @ problem.area.direction) * problem.area.direction
        tilt = " ".join(f"{x:+.1f}" for x in np.degrees(np.arctan2(edges @ aside, direction @ problem.area.direction)) + 0.0)
    turn = f"{1e3 * needle.turn.depth:.1f}" if needle.turn else ""
    return [where, tilt, f"{1e3 * needle.depth:.1f}", f"{np.degrees(needle.roll):.0f}", turn]


def _kinds(problem: Problem, result: Any) -> dict[str, Any]:
    kinds = {"without planning": result.unplanned, "rigid planning": result.rigid}
    if problem.objective != "nominal":
        kinds["nominal plan"] = result.nominal
    return {**kinds, "this plan": result.expected}


def _errors(expected: Sequence[Any], sampled: bool, over: Any) -> str:
    """Formats the error for the scene's own parameter values, with the worst case in brackets. over: function that combines the errors of several targets."""
    worst = f" ({_mm(over([e.worst for e in expected]))})" if sampled else ""
    return _mm(over([e.error for e in expected])) + worst


def _tips(problem: Problem, model: Model, results: Sequence[Any]) -> str:
    frame, sampled, template = Frame(model), bool(problem.study.parameters), bool(problem.template)
    kinds = list(_kinds(problem, results[0]))
    where = ["hole"] if template else [f"entry, mm: {', '.join(frame.names)}", "tilt, deg"]
    steering = ["roll, deg", "turn at, mm"] if problem.bevelled else []
    head = ["target", *where, "depth, mm", *steering, *kinds, *(["clearance to spare, mm"] if problem.obstacles else []), "s", ""]
    rows = []
    for result in results:
        place, tilt, depth, roll, turn = _described(problem, result.needle, frame)
        there = _kinds(problem, result)
        clear = [_mm(result.expected.clearance) if result.expected.clearance is not None else "-"] if problem.obstacles else []
        rows.append([result.name, place, *([] if template else [tilt]), depth, *([roll, turn] if problem.bevelled else []),
                     *(_errors([there[kind]], sampled, np.max) for kind in kinds), *clear, f"{result.seconds:.1f}", result.why])
    blank = [""] * (len(where) + 1 + len(steering))
    for words, over in (("mean", np.mean), ("worst", np.max)):
        errors = [_errors([_kinds(problem, result)[kind] for result in results], sampled, over) for kind in kinds]
        rows.append([f"**{words}**", *blank, *errors, *([""] if problem.obstacles else []), f"{over([r.seconds for r in results]):.1f}", ""])
    what = "Distance from the tip, at rest at its final depth, to the displaced target, mm"
    what += f"; in brackets, the largest for the scene's own values and {len(problem.samples())} samples." if sampled else "."
    reached = sum(result.reached for result in results)
    return "\n\n".join([what + " s: seconds of processor time.", _table(head, rows).rstrip("\n"), f"{reached} of {len(results)} targets are reached within "
                        f"{1e3 * problem.tolerance:g} mm{dict(worst=', in the worst sample', mean=', on average', nominal='')[problem.objective]}."]) + "\n"


def _seeds(problem: Problem, results: Sequence[Any]) -> str:
    sampled = bool(problem.study.parameters)

    def numbers(chosen: Sequence[Any]) -> list[str]:
        cells = []
        for which in ("before", "after"):
            values = [np.array(getattr(result, which)) for result in chosen]    # (samples, seeds); the first row is for the scene's own values
            for over in (np.mean, np.max):
                own, all_ = (_mm(over(np.concatenate([part[:end].ravel() for part in values]))) for end in (1, None))
                cells.append(own + (f" ({all_})" if sampled else ""))
        return cells

    head = ["needle", "depth, mm", "seeds", "before: mean", "worst", "this plan: mean", "worst", "s", ""]
    rows = [[result.needle.hole, f"{1e3 * result.needle.depth:.1f}", str(len(result.needle.seeds)), *numbers([result]), f"{result.seconds:.1f}", result.why]
            for result in results]
    rows.append(["**all**", "", str(sum(len(result.needle.seeds) for result in results)), *numbers(results), f"{np.mean([r.seconds for r in results]):.1f}", ""])
    what = "Distance of the seeds, in the tissue at rest after their needle is out, from their planned positions, mm"
    what += f"; in brackets, over the scene's own values and {len(problem.samples())} samples." if sampled else "."
    reached = sum(result.reached for result in results)
    return "\n\n".join([what + " s: seconds of processor time.", _table(head, rows).rstrip("\n"), f"{reached} of {len(results)} needles leave all seeds within "
                        f"{1e3 * problem.tolerance:g} mm{', in each sample' if sampled and problem.objective != 'nominal' else ''}."]) + "\n"


def carried(problem: Problem, rows: Sequence[tuple[Needle, Any]]) -> str:
    """Returns a table of the needles and their results."""
    sampled = bool(problem.study.parameters)
    head = ["target", "error, mm", *(["mean of the samples", "worst"] if sampled else []), *(["clearance left, mm"] if problem.obstacles else [])]
    cells = [[needle.name, _mm(e.error), *([_mm(e.mean), _mm(e.worst)] if sampled else []),
              *(([_mm(e.clearance)] if e.clearance is not None else ["-"]) if problem.obstacles else [])] for needle, e in rows]
    return _table(head, cells)


# ---- files ----------------------------------------------------------------------------------------------------------------------------------


def _write_csv(problem: Problem, results: Sequence[Any], path: Path) -> None:
    number = lambda value: "" if value is None else repr(float(value))
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        if problem.plan:
            writer.writerow(["hole", "seed", "sample", "before [m]", "after [m]"])
            for result in results:
                for k, (before, after) in enumerate(zip(result.before, result.after)):
                    writer.writerows([result.needle.hole, i + 1, k, number(b), number(a)] for i, (b, a) in enumerate(zip(before, after)))
            return
        kinds = ("unplanned", "rigid", "nominal", "expected")
        writer.writerow(["target", "reached", *(f"{kind}.{part} [m]" for kind in kinds for part in ("error", "mean", "worst", "clearance")), "insertions"])
        for result in results:
            cells = [number(getattr(getattr(result, kind), part)) for kind in kinds for part in ("error", "mean", "worst", "clearance")]
            writer.writerow([result.name, int(result.reached), *cells, result.runs])


def _plot_errors(problem: Problem, results: Sequence[Any], path: Path) -> None:
    plt = _start_plots()
    figure, axis = plt.subplots(figsize=(7.0, 0.8 + 0.36 * len(results)), layout="constrained")
    kinds = list(_kinds(problem, results[0]))
    for number, kind in enumerate(kinds):
        places = np.arange(len(results)) + 0.22 * (number - 0.5 * (len(kinds) - 1))
        expected = [_kinds(problem, result)[kind] for result in results]
        nominal, worst = (1e3 * np.array([getattr(e, part) for e in expected]) for part in ("error", "worst"))
        axis.plot(nominal, places, "o", color=COLOURS[kind], label=kind, markersize=4)
        if problem.study.parameters:
            axis.hlines(places, np.minimum(nominal, worst), worst, color=COLOURS[kind], linewidth=1.5)
    axis.axvline(1e3 * problem.tolerance, color="0.5", linestyle="--", linewidth=1)
    axis.set_xlim(left=-0.05)
    axis.set_yticks(range(len(results)), [result.name for result in results], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("distance from tip to target, mm" + ("; lines: to the worst sample" if problem.study.parameters else ""), fontsize=8)
    axis.tick_params(axis="x", labelsize=8)
    axis.grid(color="0.9")
    axis.set_axisbelow(True)
    axis.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _shadow(axis: Any, points: np.ndarray, colour: str, label: str) -> None:
    """Draws the outline of a body from its projected points (n, 2), mm."""
    from scipy.ndimage import binary_closing, gaussian_filter
    low = points.min(axis=0) - 6.0
    cells = np.floor(points - low).astype(int)
    there = np.zeros(cells.max(axis=0) + 7, bool)
    there[tuple(cells.T)] = True
    smooth = gaussian_filter(binary_closing(there, iterations=2).astype(float), 1.0)
    x, y = (low[i] + 0.5 + np.arange(there.shape[i]) for i in (0, 1))
    axis.contourf(x, y, smooth.T, levels=[0.5, 2.0], colors=[colour], alpha=0.15)
    axis.contour(x, y, smooth.T, levels=[0.5], colors=[colour], linewidths=0.8)
    axis.plot([], [], color=colour, linewidth=4, alpha=0.4, label=label)


def _inside(shaft: np.ndarray, depth: float) -> np.ndarray:
    """Returns the part of the shaft that is in the tissue: the `depth` metres next to the tip."""
    behind = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(shaft[::-1], axis=0), axis=1))])
    arc = np.append(behind[behind < depth], depth)
    return np.column_stack([np.interp(arc, behind, column) for column in shaft[::-1].T])[::-1]


def _plot_paths(problem: Problem, model: Model, results: Sequence[Any], path: Path) -> None:
    """Plots the needles, the targets, the regions that contain the targets, and the obstacles, projected onto three planes."""
    plt = _start_plots()
    frame = Frame(model)
    regions = [model.groups[i] for i in np.unique(model.part_of[model.tet_regions[locate(model, [result.target for result in results])[0]]])]
    bodies = [*((name, region_points(model, name, 1e-3)) for name in regions), *((o.name, o.points) for o in problem.obstacles)]
    colours = ["#009E73", "#CC79A7", "#D55E00", "#E69F00", "#8C564B", "#7F7F7F"]
    figure, axes = plt.subplots(1, 3, figsize=(9.5, 3.9), layout="constrained", gridspec_kw={"width_ratios": [1.5, 1.5, 1.2]})
    sign = np.array([1.0, -1.0, 1.0]) if frame.is_patient else np.ones(3)    # front up
    names = ("left", "anterior", "superior") if frame.is_patient else frame.names
    planned = [frame.position(_inside(np.array(result.expected.shaft), result.needle.depth)) * sign for result in results if result.expected.shaft]
    targets = np.array([frame.position(result.target) for result in results]) * sign
    reached = np.concatenate([*(frame.position(points) * sign for _, points in bodies), targets, *planned])
    for axis, (i, k) in zip(axes, ((2, 1), (2, 0), (0, 1))):
        for number, (name, points) in enumerate(bodies):
            _shadow(axis, (frame.position(points) * sign)[:, [i, k]], colours[number % len(colours)], name)
        for shaft in planned:
            axis.plot(shaft[:, i], shaft[:, k], color="#0072B2", linewidth=1)
            axis.plot(*shaft[-1, [i, k]], ".", color="#0072B2", markersize=4)
        axis.plot(targets[:, i], targets[:, k], "x", color="black", markersize=5, label="target at rest")
        axis.set_xlim(reached[:, i].min() - 2.0, reached[:, i].max() + 2.0)
        axis.set_ylim(reached[:, k].min() - 2.0, reached[:, k].max() + 2.0)
        axis.set_xlabel(f"{names[i]}, mm", fontsize=8)
        axis.set_ylabel(f"{names[k]}, mm", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.set_aspect("equal")
    axes[2].legend(fontsize=7, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _plot_seeds(problem: Problem, results: Sequence[Any], path: Path) -> None:
    plt = _start_plots()
    figure, axis = plt.subplots(figsize=(7.0, 3.0), layout="constrained")
    for which, colour, label in (("before", COLOURS["without planning"], "as planned before"), ("after", COLOURS["this plan"], "this plan")):
        values = np.sort(1e3 * np.concatenate([np.ravel(getattr(result, which)) for result in results]))
        axis.step(values, np.arange(1, len(values) + 1) / len(values), where="post", color=colour, label=label)
    axis.set_xlabel("distance of a seed from its place, mm", fontsize=8)
    axis.set_ylabel("part of the seeds", fontsize=8)
    axis.set_ylim(0, 1)
    axis.set_xlim(left=0)
    axis.tick_params(labelsize=7)
    axis.grid(color="0.9")
    axis.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def write(problem: Problem, model: Model, results: Sequence[Any], out: Path, plots: bool) -> tuple[str, list[Path]]:
    """Writes result.csv, summary.md and plots. Returns the text of the summary and the paths of the files."""
    text = _seeds(problem, results) if problem.plan else _tips(problem, model, results)
    files = [out / "result.csv", out / "summary.md"]
    _write_csv(problem, results, files[0])
    files[1].write_text(f"# {Path(problem.path).name}\n\n{text}", encoding="utf-8")
    if plots and problem.plan:
        files.append(out / "seeds.svg")
        _plot_seeds(problem, results, files[-1])
    elif plots:
        files += [out / "errors.svg", out / "paths.svg"]
        _plot_errors(problem, results, files[-2])
        _plot_paths(problem, model, results, files[-1])
    return text, files
