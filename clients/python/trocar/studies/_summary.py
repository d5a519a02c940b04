"""Summarises a study's results: percentiles and sensitivities, as Markdown and plots."""
from __future__ import annotations

from pathlib import Path
from typing import Any, Sequence

import numpy as np
import numpy.typing as npt

from . import sensitivity
from ._definition import Study
from ._runs import Row

_LEVELS = (5, 25, 50, 75, 95)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows)) + "\n"


def _start_plots() -> Any:
    """Returns matplotlib.pyplot, set up for SVG files."""
    import matplotlib
    matplotlib.use("svg")
    import matplotlib.pyplot as plt
    matplotlib.rcParams.update({"svg.hashsalt": "trocar", "svg.fonttype": "none"})    # reproducible files, and text stored as text
    return plt


def _percentiles(columns: Sequence[str], results: npt.NDArray[np.float64]) -> str:
    rows = []
    for column, values in zip(columns, results.T):
        there = values[np.isfinite(values)]
        if len(there) == 0:
            rows.append([column, "0", *[""] * (2 + len(_LEVELS))])
            continue
        spread = there.std(ddof=1) if len(there) > 1 else 0.0
        rows.append([column, str(len(there)), *(f"{value:.4g}" for value in (there.mean(), spread, *np.percentile(there, _LEVELS)))])
    return _table(["result", "runs", "mean", "st. dev.", *(f"{level} %" for level in _LEVELS)], rows)


def _correlations(study: Study, parameters: npt.NDArray[np.float64], results: npt.NDArray[np.float64]) -> str:
    """Returns a table of Spearman rank correlations between parameters and results. Their sign shows the direction of a monotonic influence."""
    from scipy.stats import spearmanr
    rows = []
    for column, values in zip(study.result_columns(), results.T):
        there = np.isfinite(values)
        cells = [column]
        for given in parameters.T:
            varied = there.sum() > 2 and np.ptp(given[there]) > 0 and np.ptp(values[there]) > 0
            cells.append(f"{spearmanr(given[there], values[there]).statistic:+.2f}" if varied else "")
        rows.append(cells)
    return _table(["result", *(p.name for p in study.parameters)], rows)


def _index_rows(study: Study, found: dict[str, sensitivity.Indices]) -> list[list[str]]:
    rows = []
    for column, indices in found.items():
        for i, parameter in enumerate(study.parameters):
            cells = ["" if not np.isfinite(value) else f"{value:.3f} ({low:.3f} to {high:.3f})" if np.isfinite(low) else f"{value:.3f} (-)"
                     for value, (low, high) in ((indices.first[i], indices.first_interval[i]), (indices.total[i], indices.total_interval[i]))]
            rows.append([column, parameter.name, *cells])
    return rows


def _plot_results(columns: Sequence[str], results: npt.NDArray[np.float64], path: Path) -> None:
    plt = _start_plots()
    figure, axes = plt.subplots((len(columns) + 2) // 3, 3, figsize=(9.0, 2.2 * ((len(columns) + 2) // 3)), squeeze=False, layout="constrained")
    for axis, column, values in zip(axes.flat, columns, results.T):
        there = np.sort(values[np.isfinite(values)])
        if len(there) > 200:    # more points could not be told apart in the plot
            there = np.quantile(there, np.linspace(0.0, 1.0, 201))
        if len(there):
            axis.step(there, np.arange(1, len(there) + 1) / len(there), where="post", color="#0072B2")
        axis.set_xlabel(column, fontsize=8)
        axis.set_ylim(0, 1)
        axis.tick_params(labelsize=7)
        axis.xaxis.get_offset_text().set_size(7)
        axis.grid(color="0.9")
    for axis in axes.flat[len(columns):]:
        axis.axis("off")
    for row in axes:
        row[0].set_ylabel("part of the runs", fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def _plot_indices(study: Study, found: dict[str, sensitivity.Indices], path: Path) -> None:
    plt = _start_plots()
    names = [p.name for p in study.parameters]
    figure, axes = plt.subplots(len(found), 1, figsize=(7.0, (0.5 + 0.34 * len(names)) * len(found) + 0.6), squeeze=False, sharex=True, layout="constrained")
    for axis, (column, indices) in zip(axes.flat, found.items()):
        for offset, values, limits, colour, label in ((-0.18, indices.first, indices.first_interval, "#0072B2", "first order"),
                                                      (0.18, indices.total, indices.total_interval, "#D55E00", "total")):
            place = np.arange(len(names)) + offset
            axis.barh(place, values, height=0.34, color=colour, label=label)
            axis.hlines(place, limits[:, 0], limits[:, 1], color="black", linewidth=1)
        axis.set_yticks(range(len(names)), names, fontsize=7)
        axis.invert_yaxis()
        axis.set_title(column, fontsize=8, loc="left")
        axis.grid(color="0.9", axis="x")
        axis.set_axisbelow(True)
    axes.flat[0].legend(fontsize=7, loc="lower right")
    axes.flat[-1].set_xlabel("part of the variance")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def write(study: Study, rows: Sequence[Row], out: Path, plots: bool) -> tuple[str, list[Path]]:
    """Writes summary.md and plots. Returns the text of the summary and the paths of the plots."""
    columns, p = study.result_columns(), len(study.parameters)
    parameters, results = np.array([row.parameters for row in rows]), np.array([row.results for row in rows]).reshape(len(rows), len(columns))
    failed = sum(row.status != "ok" for row in rows)
    text = [f"# {Path(study.path).name}", f"{len(rows)} runs{f', {failed} of them failed' if failed else ''}; samples: {study.method}, {study.count}"
            f"{'' if study.method == 'grid' else f', seed {study.seed}'}.", "## Results", _percentiles(columns, results)]
    found: dict[str, sensitivity.Indices] = {}
    if study.method == "saltelli":
        blocks = np.full((study.count * (p + 2), len(columns)), np.nan)
        blocks[[row.index for row in rows]] = results
        for column, values in zip(columns, blocks.T):
            if np.nanstd(values) > 0:
                found[column] = sensitivity.indices(values, p)
        text += ["## Sensitivity", "Part of the result's variance due to a parameter alone (first order), and including its interactions with others (total); 95 % confidence "
                 "intervals by bootstrap.", _table(["result", "parameter", "first order", "total"], _index_rows(study, found))]
    else:
        text += ["## Rank correlation", "Spearman's, of results with parameters. Indices of sensitivity need samples: {method: saltelli}.",
                 _correlations(study, parameters, results)]
    whole = "\n\n".join(part.rstrip("\n") for part in text) + "\n"
    (out / "summary.md").write_text(whole, encoding="utf-8")
    pictures = []
    if plots:
        pictures.append(out / "results.svg")
        _plot_results(columns, results, pictures[0])
        if found:
            pictures.append(out / "sensitivity.svg")
            _plot_indices(study, found, pictures[1])
    return whole, pictures
