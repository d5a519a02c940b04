"""Runs studies: many insertions with varied parameters, on all CPUs of a machine or on a cluster.

A study is a YAML file:

    scene: figure8.yaml                 # relative to this file
    set: {needle.bevel_slope: 0.1}      # scene keys to change in all runs; optional
    motion: {script: insert}            # or straight: {depth, speed, hold, back}, poses: FILE.csv, plan: FILE.yaml
    samples: {method: sobol, count: 256, seed: 1}    # or latin hypercube, random, saltelli, grid
    parameters:                         # scene keys, or motion. and one of x, y, z, tilt_x, tilt_y, roll, depth, speed
      regions[prostate].youngs_modulus: {log_uniform: [20e3, 90e3]}    # Pa
      regions[prostate].friction.kinetic: {uniform: [5, 15]}
      motion.x: {normal: [0, 1e-3], within: [-3e-3, 3e-3]}             # m
    record:
      - peak_force
      - tip_error: {at: 1.3}            # s
      - shift: {region: prostate, at: [0.5, 1.3]}

Command line:

    trocar-study estimate | run | collect | summary ...    --help says more; also python3 -m trocar.studies.study
"""
from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any, Sequence

import numpy as np

from .. import Error, __version__
from ._definition import BadStudy, Study, read
from .._files import replacing
from .._program import Progress, ended, say, whole_number
from ._runs import Row, carry_out, cells_of, check_manifest, groups_of, has_frames, heading, line_of, model_of, read_rows, row_files, run
from ..brachy.plan import BadPlan

__all__ = ["BadStudy", "Row", "Study", "collect", "read", "results", "simulate"]


class Incomplete(Exception):
    """Raised if some runs of a study are missing or have failed."""


def simulate(study: Study, index: int) -> dict[str, float]:
    """Does one run without touching any files, and returns its results by column name. Raises Error, BadPlan."""
    samples = study.samples()
    model, scene = model_of(study, samples[index], None, groups_of(study, samples).sparse)
    return dict(zip(study.result_columns(), run(study, samples[index], model, scene)))


# ---- collecting -------------------------------------------------------------------------------------------------------------------------


def results(study: Study, out: Path) -> list[Row]:
    """Reads the rows in all files in the folder, and returns them in order of run. Raises BadStudy if a file belongs to another study, or if a run has
    contradictory rows."""
    samples, rows = study.samples(), {}
    for path in row_files(out):
        for row in read_rows(path, study, samples):
            if row.index in rows and cells_of(rows[row.index]) != cells_of(row):
                raise BadStudy(f"{path}: run {row.index} has different results in another file: remove one of them; did another version compute it?")
            rows[row.index] = row
    return [rows[index] for index in sorted(rows)]


def _replace(path: Path, text: str) -> None:
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        file.write(text)


def _write_hdf5(study: Study, rows: Sequence[Row], path: Path) -> None:
    import h5py
    from . import _hdf5
    with replacing(path) as temporary, h5py.File(temporary, "w") as file:
        _hdf5.describe(file, study, "Results of a study")
        file["run"] = np.array([row.index for row in rows], np.int64)
        _hdf5.scale(file, "run", len(rows))
        file.create_dataset("status", data=[row.status for row in rows], dtype=h5py.string_dtype())
        _hdf5.attach(file, "status", ("run",), "", "ok, or why the run failed")
        _hdf5.add_columns(file, "parameter", [row.parameters for row in rows], study.parameter_columns())
        _hdf5.add_columns(file, "result", [row.results for row in rows], study.result_columns())


def collect(study: Study, out: Path, hdf5: bool = False, partial: bool = False) -> list[Row]:
    """Writes result.csv, result.h5 if `hdf5` is true, and frames.h5 if there are frames. Raises Incomplete if runs are missing, unless `partial` is
    true."""
    check_manifest(study, out)
    rows, samples = results(study, out), study.samples()
    if len(rows) < len(samples) and not partial:
        raise Incomplete(f"{out}: {len(rows)} of {len(samples)} runs are done: carry out the others, or collect with --partial")
    _replace(out / "result.csv", line_of(heading(study)) + "".join(line_of(cells_of(row)) for row in rows))
    if hdf5:
        _write_hdf5(study, rows, out / "result.h5")
    if study.frames_every:
        from . import frames
        frames.collect(out / "frames", out / "frames.h5", study, samples)
    return rows


# ---- Slurm ------------------------------------------------------------------------------------------------------------------------------


def _batch_script(given: argparse.Namespace, out: Path) -> str:
    """Returns a Slurm script for a job array with one element per task."""
    absolute = lambda path: str(Path(path).resolve())
    environment = {}
    if "PYTHONPATH" in os.environ:
        environment["PYTHONPATH"] = os.pathsep.join(absolute(part) for part in os.environ["PYTHONPATH"].split(os.pathsep) if part)
    if "TROCAR_LIBRARY" in os.environ:
        library = os.environ["TROCAR_LIBRARY"]
        environment["TROCAR_LIBRARY"] = absolute(library) if "/" in library else library    # leave a bare name to the dynamic loader's search
    command = [sys.executable, "-m", "trocar.studies.study", "run", absolute(given.study), "--out", str(out)]
    if given.record:
        command += ["--record", given.record]
    lines = ["#!/bin/sh", f"#SBATCH --job-name=trocar-study --array=1-{given.tasks} --ntasks=1 --cpus-per-task={given.workers or 1}",
             f"#SBATCH --output={shlex.quote(str(out / 'slurm-%a.txt'))} --open-mode=append", *(f"#SBATCH {option}" for option in given.sbatch)]
    lines += [f"export {name}={shlex.quote(value)}" for name, value in environment.items()]
    return "\n".join([*lines, f"exec {shlex.join(command)} --task \"$SLURM_ARRAY_TASK_ID/{given.tasks}\" --workers \"$SLURM_CPUS_PER_TASK\"", ""])


def _submit(given: argparse.Namespace, study: Study) -> int:
    out = Path(given.out).resolve()
    out.mkdir(parents=True, exist_ok=True)
    check_manifest(study, out)
    if study.frames_every:
        from . import frames
        _say(frames.size_in_words(study, out))
    script = out / "study.sbatch"
    _replace(script, _batch_script(given, out))
    if not shutil.which("sbatch"):
        raise BadStudy(f"{script}: written, but there is no sbatch to submit it: install Debian's slurm-client, or submit it on the cluster")
    done = subprocess.run(["sbatch", "--parsable", *(["--wait"] if given.wait else []), str(script)], capture_output=True, text=True)
    if done.returncode and not re.match(r"\d", done.stdout):
        raise Incomplete(f"sbatch: {done.stderr.strip()}")
    job = done.stdout.strip().split(";")[0]
    if not given.wait:
        print(f"submitted {script} as job {job}; when it has ended: {shlex.join(['trocar-study', 'collect', given.study, '--out', given.out])}")
        return 0
    return _finish(given, study, out, f"job {job}")


# ---- the program ------------------------------------------------------------------------------------------------------------------------

_say = partial(say, "trocar-study")


def _finish(given: argparse.Namespace, study: Study, out: Path, who: str) -> int:
    rows = collect(study, out, given.hdf5)
    failed = [row for row in rows if row.status != "ok"]
    print(f"{out / 'result.csv'}: {len(rows)} runs")
    if failed:
        _say(f"{len(failed)} of {len(rows)} runs failed ({who}), such as run {failed[0].index}: {failed[0].status}")
    return 1 if failed else 0


def _run(given: argparse.Namespace) -> int:
    study = read(given.study, given.record == "frames")
    if given.engine == "slurm":
        return _submit(given, study)
    task, out = given.task or (1, 1), Path(given.out)
    outcome = carry_out(study, out, task, given.workers or len(os.sched_getaffinity(0)), Progress(given.quiet, "trocar-study", "runs"), _say)
    for words in outcome.lost[:3]:
        _say(f"{words}: ended without a result")
    if outcome.lost:
        raise Incomplete(f"{len(outcome.lost)} runs ended without a result, for lack of memory or because of a defect: start again to repeat them")
    if given.task is None:
        return _finish(given, study, out, "this machine")
    return 1 if outcome.failed else 0


def _estimate(given: argparse.Namespace) -> int:
    from . import _estimate as costs
    study = read(given.study, given.record == "frames")
    folder = next(folder for folder in (Path(given.out).resolve(), *Path(given.out).resolve().parents) if folder.is_dir())
    print(costs.in_words(costs.estimate(study), given.workers or len(os.sched_getaffinity(0)), shutil.disk_usage(folder).free), end="")
    return 0


def _collect(given: argparse.Namespace) -> int:
    study = read(given.study, has_frames(Path(given.out)))
    rows = collect(study, Path(given.out), given.hdf5, given.partial)
    print(f"{Path(given.out) / 'result.csv'}: {len(rows)} runs")
    return 0


def _summary(given: argparse.Namespace) -> int:
    from . import _summary as summaries
    out = Path(given.out)
    study = read(given.study, has_frames(out))
    check_manifest(study, out)
    rows = results(study, out)
    if len(rows) < 2:
        raise Incomplete(f"{out}: {len(rows)} runs are done: a summary needs more")
    text, pictures = summaries.write(study, rows, out, not given.no_plots)
    print(text, end="")
    print(f"{out / 'summary.md'}{''.join(', ' + str(picture) for picture in pictures)}")
    return 0


def _task(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)/(\d+)", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise argparse.ArgumentTypeError(f"{text}: write i/N with i from 1 to N")
    return int(match[1]), int(match[2])


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="trocar-study", description="Thousands of insertions with varied parameters, described by a file: carries them out on all "
                                     "processors or on a cluster, resumes after an interruption, and summarises the results.",
                                     epilog="Exit status: 0, 1 if runs failed or are missing, 2 for bad input, 3 if something else failed, such as a missing package.")
    parser.add_argument("--version", action="version", version=f"trocar-study {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, call: Any, words: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        added.add_argument("study", help="study, a YAML file", metavar="STUDY")
        added.add_argument("--out", default="study", help="folder of the results (default: study)", metavar="FOLDER")
        added.set_defaults(call=call)
        return added

    added = command("estimate", _estimate, "predict processor time, memory and size of the files from three of the runs")
    added.add_argument("--workers", type=whole_number, help="runs at a time on all machines together (default: one for each processor)", metavar="N")
    added.add_argument("--record", choices=("frames",), help="with frames")
    added = command("run", _run, "carry out the runs that are not done yet, and collect them")
    added.add_argument("--workers", type=whole_number, help="runs at a time (default: one for each processor; with Slurm 1 for each task)", metavar="N")
    added.add_argument("--task", type=_task, help="only part i of N, for a cluster or GNU parallel; nothing is collected", metavar="i/N")
    added.add_argument("--engine", choices=("local", "slurm"), default="local", help="slurm: write a job array and submit it (default: local)")
    added.add_argument("--tasks", type=whole_number, default=16, help="with Slurm: number of parts, each of which does many runs (default: 16)", metavar="N")
    added.add_argument("--sbatch", action="append", default=[], help="with Slurm: an option for sbatch, with its dashes; may be repeated", metavar="OPTION")
    added.add_argument("--wait", action="store_true", help="with Slurm: wait for the job and collect")
    added.add_argument("--record", choices=("frames",), help="also write displacement fields, contacts and wrenches, every 20 ms or as the study says")
    added.add_argument("--hdf5", action="store_true", help="also write result.h5")
    added.add_argument("--quiet", action="store_true", help="print no progress")
    added = command("collect", _collect, "write result.csv from the rows of all tasks, sorted by run")
    added.add_argument("--hdf5", action="store_true", help="also write result.h5")
    added.add_argument("--partial", action="store_true", help="collect even if runs are missing")
    added = command("summary", _summary, "write percentiles and sensitivities, with plots")
    added.add_argument("--no-plots", action="store_true", help="write no pictures")
    return parser


def _call(given: argparse.Namespace) -> int:
    try:
        return given.call(given)
    except (BadStudy, BadPlan, Error) as error:
        _say(str(error))
        return 2
    except Incomplete as error:
        _say(str(error))
        return 1


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program; returns its exit status."""
    options = _options()
    given = options.parse_args(arguments)
    if given.command == "run" and given.engine == "slurm" and given.task:
        options.error("--task is for a single task: set the number of Slurm's tasks with --tasks")
    if given.command == "run" and given.wait and given.engine != "slurm":
        options.error("--wait requires --engine slurm")
    return ended("trocar-study", lambda: _call(given), given.out, "python3-yaml python3-scipy python3-h5py python3-matplotlib", "interrupted: start again to continue")


if __name__ == "__main__":
    from trocar.studies import study as _imported  # classes in __main__ would differ from those that other modules import

    sys.exit(_imported.main())
