"""Writes the output of trocar-fit: a table, a scene fragment, confidence intervals and a plot."""
from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from .. import Scene, __version__
from .._files import replacing
from ._fit_problem import FitProblem
from ._fit_result import Estimate, Fitted
from ._summary import _start_plots, _table


def _number(value: float) -> str:
    return f"{value:.4g}"


def table(result: Fitted) -> str:
    """Returns the estimates as a Markdown table."""
    rows = []
    for e in result.estimates:
        note = "not determined" if not e.determined else "at its bound" if e.at_bound else ""
        rows.append([e.key, _number(e.value), _number(e.low), _number(e.high), e.unit, note])
    head = _table(["parameter", "value", "95 % from", "to", "unit", ""], rows)
    if not math.isfinite(result.chi2):
        return head
    return head + f"\nchi squared {result.chi2:.0f}, {result.freedom} degrees of freedom; {result.simulations} simulations\n"


def _comment(e: Estimate) -> str:
    interval = f"95 %: {_number(e.low)} to {_number(e.high)}" if e.determined else "not determined by the data"
    return f"{e.unit}{', ' if e.unit else ''}{interval}{', at its bound' if e.at_bound else ''}"


def scene_keys(scene: Scene, result: Fitted) -> str:
    """Returns the estimates as a fragment of a scene file. Regions and membranes are identified by name. The list of relaxation times is written out in
    full, because its entries have no names."""
    found = {e.key: e for e in result.estimates}
    lists: dict[str, dict[str, dict[str, str]]] = {}
    single: dict[str, dict[str, str]] = {}
    write = lambda e: f"{e.value!r}    # {_comment(e)}"
    for key, e in found.items():
        first, bracket, rest = key.partition("[")
        if bracket and first != "relaxation":
            name, _, part = rest.partition("].")
            name = str(scene[f"{first}[{name}].name"])    # the key may give the entry's index instead of its name
            lists.setdefault(first, {}).setdefault(name, {})[part] = write(e)
        elif not bracket:
            group, _, part = key.partition(".")
            single.setdefault(group, {})[part] = write(e)
    lines = []
    for first, entries in lists.items():
        lines.append(f"{first}:")
        for name, parts in entries.items():
            lines += [f"  - name: {name}", *(f"    {line}" for line in _nested(parts))]
    if any(key.startswith("relaxation[") for key in found):
        lines.append("relaxation:")
        for i in range(scene._count("relaxation")):
            for mark, part in (("- ", "weight"), ("  ", "time")):
                key = f"relaxation[{i}].{part}"
                lines.append(f"  {mark}{part}: {write(found[key]) if key in found else repr(float(scene[key]))}")
    for group, parts in single.items():
        lines += [f"{group}:", *(f"  {line}" for line in _nested(parts))]
    return "\n".join(lines) + "\n"


def _nested(parts: dict[str, str]) -> list[str]:
    """Returns lines of YAML in which dotted keys become nested mappings: "friction.static" goes below "friction"."""
    lines, last = [], ""
    for part in sorted(parts, key=lambda name: (name.rpartition(".")[0], list(parts).index(name))):
        group, dot, name = part.rpartition(".")
        if dot and group != last:
            lines.append(f"{group}:")
        lines.append(f"{'  ' if dot else ''}{name}: {parts[part]}")
        last = group
    return lines


def _json(problem: FitProblem, result: Fitted) -> dict[str, Any]:
    return {"version": f"trocar {__version__}", "fit": Path(problem.path).name, "converged": result.converged, "chi2": result.chi2, "degrees_of_freedom": result.freedom,
            "simulations": result.simulations,
            "parameters": {e.key: {"value": e.value, "low": e.low, "high": e.high, "unit": e.unit, "start": e.start, "at_bound": e.at_bound, "determined": e.determined}
                           for e in result.estimates},
            "correlations": result.correlations.tolist(), "warnings": result.warnings}


def _plot(problem: FitProblem, result: Fitted, path: Path) -> None:
    plt = _start_plots()
    panels = [(k, kind) for k, recording in enumerate(problem.recordings) for kind in ("force", "torque", "position") if any(c.kind == kind for c in recording.channels)]
    figure, axes = plt.subplots(len(panels), 2, figsize=(9.5, 2.4 * len(panels) + 0.4), squeeze=False, layout="constrained", sharex="row")
    colours = ("#0072B2", "#D55E00", "#009E73")
    for (left, right), (k, kind) in zip(axes, panels):
        recording = problem.recordings[k]
        for channel, predicted in zip(recording.channels, result.predicted[k]):
            if channel.kind != kind:
                continue
            measured, colour = channel.means(channel.values), colours[channel.component]
            spread = channel.spreads(problem.noise[kind], problem.noise["time"])
            factor, offset = (1e3, measured[0]) if kind == "position" else (1.0, 0.0)
            left.plot(channel.at(), factor * (measured - offset), ".", color=colour, markersize=2)
            left.plot(channel.at(), factor * (predicted - offset), color=colour, linewidth=0.9, label="xyz"[channel.component] if not channel.point or channel.point == next(iter(problem.points)) else None)
            right.plot(channel.at(), (measured - predicted) / spread, ".", color=colour, markersize=2)
        left.set_ylabel({"force": "force (N)", "torque": "torque (N m)", "position": "displacement (mm)"}[kind], fontsize=8)
        left.set_title(recording.name, fontsize=8, loc="left")
        left.legend(fontsize=7, frameon=False)
        right.axhspan(-1.96, 1.96, color="0.92")
        right.set_ylabel("residual (standard deviations)", fontsize=8)
    for axis in axes.flat:
        axis.tick_params(labelsize=7)
        axis.grid(color="0.9")
        axis.set_axisbelow(True)
    for axis in axes[-1]:
        axis.set_xlabel("time (s)", fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def write(problem: FitProblem, result: Fitted, out: Path, plots: bool) -> list[Path]:
    """Writes fitted.yaml, fit.json and residuals.svg. Returns their paths."""
    scene = problem.scene(np.array([e.value for e in result.estimates]))
    head = f"# Made by trocar-fit {__version__} from {Path(problem.path).name}: keys to be merged into a scene.\n"
    files = [out / "fitted.yaml", out / "fit.json"]
    for path, text in zip(files, (head + scene_keys(scene, result), json.dumps(_json(problem, result), indent=1) + "\n")):
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    if plots:
        files.append(out / "residuals.svg")
        _plot(problem, result, files[-1])
    return files
