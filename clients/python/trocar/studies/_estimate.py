"""Estimates the cost of a study from a few pilot runs, without writing any of the study's files."""
from __future__ import annotations

import os
import resource
import tempfile
import time
from pathlib import Path
from typing import Any, Callable, NamedTuple

import numpy as np

from .. import Error, Model
from ..brachy.plan import BadPlan
from ._definition import BadStudy, Study
from ._runs import Pool, Row, cells_of, groups_of, heading, line_of, model_of, run

PILOTS = 3


class Cost(NamedTuple):
    """The estimated cost of a study, from `pilots` of its runs. Times are CPU times unless stated otherwise."""

    runs: int
    pilots: int
    duration: float               # s, mean simulated time of a run
    models: int                   # number of models that several runs share
    model_seconds: float          # s, to build one of these shared models
    run_seconds: tuple[float, float, float]    # s, for a run: mean, minimum and maximum of the pilots, including the model unless it is shared
    memory: float                 # bytes, peak memory of a process that does one run
    table: float                  # bytes, size of result.csv
    frames: float                 # bytes, total size of the frame files of all runs; frames.h5 takes as much again

    @property
    def seconds(self) -> float:
        return self.models * self.model_seconds + self.runs * self.run_seconds[0]


def _pilot(study: Study, values: Any, shared: bool, sparse: bool) -> list[Any]:
    """Does one run in this process. Returns the CPU times (s) for the model and for the run, the simulated time (s), the peak memory (bytes), the size of the
    frames (bytes), and the results."""
    begin = time.process_time()
    base = Model(study.run_scene(values, sparse)) if shared else None
    between = time.process_time()
    model, scene = model_of(study, values, base, sparse)
    if study.frames_every:
        from . import frames
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "run.h5"
            with frames.Writer(path, model) as writer:
                results = run(study, values, model, scene, writer)
            size = path.stat().st_size
    else:
        results, size = run(study, values, model, scene), 0
    end = time.process_time()
    return [between - begin, end - between, study.run_motion(values).duration(), 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, size, results]


def estimate(study: Study, pilots: int = PILOTS) -> Cost:
    """Extrapolates the cost from up to `pilots` runs spread over the study, each done in its own process, one at a time. Raises BadStudy if they all fail."""
    samples = study.samples()
    if not len(samples):
        raise BadStudy(f"{study.path}: has no runs")
    groups = groups_of(study, samples)
    sizes = np.bincount(groups.of_run)
    found, failures = {}, []

    def finished(index: int, outcome: Any, why: str) -> None:
        if isinstance(outcome, list):
            found[index] = outcome
        else:
            failures.append(f"run {index}: {outcome or why}")

    def work(index: int) -> Callable[[], Any]:
        def one() -> Any:
            try:
                return _pilot(study, samples[index], sizes[groups.of_run[index]] > 1, groups.sparse)
            except (Error, BadPlan) as error:
                return " ".join(str(error).split())
        return one

    pool = Pool(1, finished)
    try:
        for index in sorted({int(i) for i in np.linspace(0, len(samples) - 1, pilots)}):
            pool.start(index, work(index))
            pool.join()
    finally:
        pool.kill()
    if not found:
        raise BadStudy(f"{study.path}: the runs tried all fail, such as {failures[0]}")
    models, runs, durations, memory, sizes_of_frames, _ = zip(*found.values())
    rows = [len(line_of(cells_of(Row(i, "ok", tuple(samples[i]), tuple(pilot[5]))))) for i, pilot in found.items()]
    shared = [seconds for i, seconds in zip(found, models) if sizes[groups.of_run[i]] > 1]
    count = len(samples)
    return Cost(count, len(found), float(np.mean(durations)), int(np.sum(sizes > 1)), float(np.mean(shared)) if shared else 0.0,
                (float(np.mean(runs)), min(runs), max(runs)), float(max(memory)), len(line_of(heading(study))) + count * float(np.mean(rows)),
                count * float(np.mean(sizes_of_frames)))


def _time(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h" if seconds < 36000 else f"{seconds / 3600:.0f} h"


def size_in_words(size: float) -> str:
    return f"{size / 1e9:.0f} GB" if size >= 10e9 else f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB" if size >= 10e6 else f"{size / 1e6:.1f} MB" if size >= 1e5 else f"{size / 1e3:.1f} kB"


def in_words(cost: Cost, workers: int, free: float) -> str:
    """Formats the estimate for trocar-study. free: free disk space in bytes."""
    mean, least, most = cost.run_seconds
    lines = [("runs", f"{cost.runs}, of {cost.duration:.2f} s of model time each"),
             ("a run", f"{mean:.3g} s of processor time ({least:.3g} to {most:.3g} s in {cost.pilots} runs), {size_in_words(cost.memory)} of memory"),
             ("models", f"{cost.models} that runs share, {cost.model_seconds:.3g} s of processor time each" if cost.models else "each run builds its own"),
             ("the study", f"{cost.seconds / 3600:.3g} core-hours: {_time(cost.seconds / workers)} with {workers} worker{'s' * (workers > 1)}"),
             ("files", f"result.csv {size_in_words(cost.table)}" + (f"; frames {size_in_words(cost.frames)}, and as much again for frames.h5" if cost.frames else "")
              + f"; {size_in_words(free)} are free")]
    return "".join(f"{name:12}{words}\n" for name, words in lines)
