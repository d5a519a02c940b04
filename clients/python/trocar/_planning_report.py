"""What trocar-plan writes about its plans: tables as CSV and Markdown, and pictures."""
from __future__ import annotations

import csv
from pathlib import Path
from typing import Any, Sequence

import numpy as np

from . import Model
from . import plan as plans
from ._problem import Problem
from ._summary import _table
from .plan import Frame, Needle

COLOURS = {"without planning": "#D55E00", "rigid planning": "#E69F00", "nominal plan": "#56B4E9", "this plan": "#0072B2"}


def _mm(value: float) -> str:
    return f"{1e3 * value:.2f}" if np.isfinite(value) else "-"


def _described(needle: Needle, frame: Frame) -> list[str]:
    """Entry and direction, depth, roll and turn in words."""
    where = needle.hole or " ".join(f"{x:.1f}" for x in frame.position(needle.entry))
    tilt = "" if needle.hole else " ".join(f"{x:+.1f}" for x in np.degrees(np.arctan2(needle.direction[:2], needle.direction[2])))
    turn = f"{1e3 * needle.turn.depth:.1f}" if needle.turn else ""
    return [where, tilt, f"{1e3 * needle.depth:.1f}", f"{np.degrees(needle.roll):.0f}", turn]


def _kinds(problem: Problem, result: Any) -> dict[str, Any]:
    kinds = {"without planning": result.unplanned, "rigid planning": result.rigid}
    if problem.objective != "nominal":
        kinds["nominal plan"] = result.nominal
    return {**kinds, "this plan": result.expected}


def _tips(problem: Problem, model: Model, results: Sequence[Any]) -> str:
    frame, sampled = Frame(model), bool(problem.study.parameters)
    kinds = list(_kinds(problem, results[0]))
    parts = [("", lambda e: e.error)] if not sampled else [("", lambda e: e.error), (", worst", lambda e: e.worst)]
    head = ["target", "hole" if problem.template else "entry, mm", *([] if problem.template else ["tilt, deg"]), "depth, mm", "roll, deg", "turn at, mm",
            *(kind + part for kind in kinds for part, _ in parts), *(["clearance left, mm"] if problem.obstacles else []), "time, s", ""]
    rows = []
    for result in results:
        cells = _described(result.needle, frame)
        cells = cells if not problem.template else [cells[0], *cells[2:]]
        errors = [_mm(measure(expected)) for expected in _kinds(problem, result).values() for _, measure in parts]
        clear = [_mm(result.expected.clearance)] if problem.obstacles and result.expected.clearance is not None else ["-"] * bool(problem.obstacles)
        rows.append([result.name, *cells, *errors, *clear, f"{result.seconds:.1f}", result.why])
    blank = [""] * (4 if problem.template else 5)
    for words, over in (("mean", np.mean), ("worst", np.max)):
        errors = [_mm(over([measure(_kinds(problem, r)[kind]) for r in results])) for kind in kinds for _, measure in parts]
        seconds = over([r.seconds for r in results])
        rows.append([words, *blank, *errors, *([""] if problem.obstacles else []), f"{seconds:.1f}", ""])
    what = "Distance from the tip at its depth, at rest, to where the target has gone in the displaced tissue, mm."
    if sampled:
        what += f" Worst: of {len(problem.samples())} samples."
    reached = sum(result.reached for result in results)
    return "\n\n".join([what, _table(head, rows).rstrip("\n"), f"{reached} of {len(results)} targets are reached within {1e3 * problem.tolerance:g} mm"
                        f"{', in the worst sample' if problem.objective == 'worst' else ''}."]) + "\n"


def _seeds(problem: Problem, results: Sequence[Any]) -> str:
    kinds = {"nominal": lambda distances: np.array(distances[:1])}
    if problem.study.parameters:
        kinds["in the samples"] = lambda distances: np.array(distances[1:])
    head = ["needle", "depth, mm", "seeds", *(f"{what}, {kind}: {number}" for kind in kinds for what in ("as planned before", "this plan") for number in ("mean", "worst")),
            "time, s", ""]
    rows = []

    def numbers(chosen: Sequence[Any]) -> list[str]:
        cells = []
        for pick in kinds.values():
            for which in ("before", "after"):
                values = np.concatenate([pick(getattr(result, which)).ravel() for result in chosen])
                cells += [_mm(values.mean()), _mm(values.max())]
        return cells

    for result in results:
        rows.append([result.needle.hole, f"{1e3 * result.needle.depth:.1f}", str(len(result.needle.seeds)), *numbers([result]), f"{result.seconds:.1f}", result.why])
    rows.append(["all", "", str(sum(len(result.needle.seeds) for result in results)), *numbers(results), f"{np.mean([r.seconds for r in results]):.1f}", ""])
    return "\n\n".join(["Distance of the seeds, in the tissue at rest when the needles are out, from their places in the plan, mm.", _table(head, rows).rstrip("\n")]) + "\n"


def carried(problem: Problem, rows: Sequence[tuple[Needle, Any]]) -> str:
    """A table of needles and what they lead to."""
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


def _start_plots() -> Any:
    import matplotlib
    matplotlib.use("svg")
    import matplotlib.pyplot as plt
    matplotlib.rcParams.update({"svg.hashsalt": "trocar", "svg.fonttype": "none"})    # the same file each time; text stays text
    return plt


def _plot_errors(problem: Problem, results: Sequence[Any], path: Path) -> None:
    plt = _start_plots()
    figure, axis = plt.subplots(figsize=(7.0, 0.6 + 0.3 * len(results)), layout="constrained")
    places = np.arange(len(results))
    for kind in _kinds(problem, results[0]):
        expected = [_kinds(problem, result)[kind] for result in results]
        nominal, worst = (1e3 * np.array([getattr(e, part) for e in expected]) for part in ("error", "worst"))
        axis.plot(nominal, places, "o", color=COLOURS[kind], label=kind, markersize=5)
        if problem.study.parameters:
            axis.hlines(places, np.minimum(nominal, worst), worst, color=COLOURS[kind], linewidth=1.5)
    axis.axvline(1e3 * problem.tolerance, color="0.5", linestyle="--", linewidth=1)
    axis.set_xscale("log")
    axis.set_yticks(places, [result.name for result in results], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("distance from tip to target, mm" + ("; lines: to the worst sample" if problem.study.parameters else ""), fontsize=8)
    axis.tick_params(axis="x", labelsize=8)
    axis.grid(color="0.9")
    axis.set_axisbelow(True)
    axis.legend(fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _plot_paths(problem: Problem, model: Model, results: Sequence[Any], path: Path) -> None:
    """From above and from the side, as the mesh lies."""
    plt = _start_plots()
    figure, axes = plt.subplots(2, 1, figsize=(7.0, 6.2), sharex=True, layout="constrained")
    gland = model.nodes[np.unique(model.tets[model.tet_regions == model.tet_regions.min()])]
    region = model.groups[int(model.tet_regions.min())]
    for axis, across, name in ((axes[0], 0, "x"), (axes[1], 1, "y")):
        from scipy.spatial import ConvexHull
        for points, colour, label in ((gland, "#009E73", region), *((o.points, "#CC79A7", o.name) for o in problem.obstacles)):
            flat = 1e3 * points[:, [2, across]]
            outline = flat[ConvexHull(flat).vertices]
            axis.fill(*outline.T, facecolor=colour, alpha=0.12, edgecolor=colour, linewidth=1)
            axis.annotate(label, outline.mean(axis=0), fontsize=7, ha="center", color=colour)
        for result in results:
            if result.expected.shaft:
                shaft = 1e3 * np.array(result.expected.shaft)
                axis.plot(shaft[:, 2], shaft[:, across], color="#0072B2", linewidth=1)
            axis.plot(1e3 * result.target[2], 1e3 * result.target[across], "x", color="black", markersize=5)
        axis.set_ylabel(f"{name}, mm", fontsize=8)
        axis.tick_params(labelsize=7)
        axis.set_aspect("equal")
        axis.set_xlim(1e3 * model.nodes[:, 2].min() - 30.0, 1e3 * model.nodes[:, 2].max())
    axes[1].set_xlabel("z, mm: needles as they lie at their targets; targets at rest", fontsize=8)
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
    """Writes result.csv, summary.md and pictures. Returns the text, and the files' paths."""
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
