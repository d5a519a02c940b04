"""trocar-score: scores a recorded run of a task, and writes its report."""
from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from pathlib import Path
from typing import Any, Sequence

from .. import __version__
from .._page import save
from .._program import ended, say
from ..brachy import plan as plans
from ..brachy._plan_command import planned_table
from . import _report as report
from ._measures import shown
from ._recording import BadRecording
from ._score import Result, score
from ._task import BadTask, Course, Task
from ._words import Words, languages

PROGRAM = "trocar-score"


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=PROGRAM, description="Scores the recording of a task on the simulator: prints each criterion, and writes reports.",
                                     epilog="Exit status: 0 if all criteria are met, 1 if not, 2 for bad input, 3 if something else failed, such as a missing package. With --course: 0 if all tasks have been passed.")
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    parser.add_argument("log", nargs="?", help="LCM log of the server's messages, written by trocar-view --task or lcm-logger", metavar="LOG")
    parser.add_argument("--task", help="the task, a YAML file; without LOG, the task is checked", metavar="FILE")
    parser.add_argument("--html", help="write the report as a page that can be printed", metavar="FILE")
    parser.add_argument("--language", default="en", help=f"language of the page, one of {', '.join(languages())} (default: en); English where it has no texts", metavar="CODE")
    parser.add_argument("--json", help="write the report as JSON, in SI units", metavar="FILE")
    parser.add_argument("--csv", help="write the measures as a table, in SI units", metavar="FILE")
    parser.add_argument("--runs", help="folder of a trainee's runs, as trocar-view --task keeps it: compare with the earlier ones", metavar="FOLDER")
    parser.add_argument("--course", help="instead of a task, with --runs: list the trainee's progress in this course, a YAML file", metavar="FILE")
    parser.add_argument("--prepare", help="without LOG: write task.json, and plan.csv if the task has a plan, for trocar-view, and print its options", metavar="FOLDER")
    return parser


def _criteria(result: Result) -> None:
    words = Words()
    for criterion, value, met in result.judgements:
        limit = words.limit(criterion.measure, criterion.least, criterion.most)
        print(f"{'met    ' if met else 'not met'}  {criterion.measure:18} {shown(criterion.measure, value):>10}   {limit}")
    print("passed" if result.passed else "not passed")


def _score(given: argparse.Namespace) -> int:
    task = Task.read(given.task)
    result = score(task, given.log)
    reference = report.read_report(Path(task.reference), task.name) if task.reference else None
    runs = report.earlier_runs(Path(given.runs), task, report.began(result)) if given.runs else []
    if given.html:
        save(Path(given.html), report.as_html(result, runs, reference, given.language))
    if given.json:
        save(Path(given.json), report.as_json(result))
    if given.csv:
        save(Path(given.csv), report.as_csv(result))
    if result.lost:
        say(PROGRAM, f"warning: {given.log}: {Words()('lost', lost=result.lost, count=result.ticks)}")
    _criteria(result)
    return 0 if result.passed else 1


def _progress(given: argparse.Namespace) -> int:
    course, passed = Course.read(given.course), 0
    print(course.title)
    for path in course.tasks:
        task = Task.read(path)
        runs = report.earlier_runs(Path(given.runs), task)
        good = [run for run in runs if run.passed]
        passed += bool(good)
        said = "not tried" if not runs else f"{len(runs)} run{'s' if len(runs) > 1 else ''}, " + (f"passed on {good[0].began[:10]}" if good else "not passed")
        print(f"  {task.title}: {said}")
    print(f"{passed} of {len(course.tasks)} tasks passed")
    return 0 if passed == len(course.tasks) else 1


def _texts(task: Task, language: str) -> dict[str, Any]:
    texts, words = task.texts(language), Words(language)
    return {"title": texts.title, "text": texts.text, "hints": texts.hints,
            "criteria": [{"measure": c.measure, "words": words(f"measure.{c.measure}"), "source": source, "limit": words.limit(c.measure, c.least, c.most)}
                         for c, source in zip(task.criteria, texts.sources)]}


def describe(task: Task) -> dict[str, Any]:
    """Returns a description of a task for the viewer's web page, with lengths in m and the texts in all languages."""
    return {"name": task.name, "avoid": task.avoid, "texts": {language: _texts(task, language) for language in languages()},
            "targets": [{"name": t.name, "position": t.position.tolist(), "hole": t.hole} for t in task.targets],
            "needles": [{"hole": n.hole, "depth": n.depth, "seeds": n.seeds} for n in task.plan.needles] if task.plan else []}


def _prepare(given: argparse.Namespace) -> int:
    import matplotlib    # noqa: F401    the report at the end of the run needs it
    task, folder = Task.read(given.task), Path(given.prepare)
    folder.mkdir(parents=True, exist_ok=True)
    save(folder / "task.json", json.dumps(describe(task)) + "\n")
    print(f"scene {task.scene}")
    print(f"name {task.name}")
    if task.plan:
        table = io.StringIO()
        csv.writer(table, lineterminator="\n").writerows(planned_table(plans.planned_seeds(task.plan, task.model), plans.Frame(task.model)))
        save(folder / "plan.csv", table.getvalue())
        print(f"plan {folder / 'plan.csv'}")
        if task.plan.source:
            print(f"source {task.plan.source.isotope} {task.plan.source.model}\nstrength {task.plan.source.strength:.9g}")
        if task.plan.prescription:
            print(f"prescription {task.plan.prescription:.9g}")
    return 0


def _check(given: argparse.Namespace) -> int:
    task = Task.read(given.task)
    if task.reference:
        report.read_report(Path(task.reference), task.name)
    what = f"{len(task.plan.needles)} needles, {sum(len(n.seeds) for n in task.plan.needles)} seeds" if task.plan else f"{len(task.targets)} targets"
    print(f"{task.path}: {what}, {len(task.criteria)} criteria")
    return 0


def _run(given: argparse.Namespace, parser: argparse.ArgumentParser) -> int:
    if given.course:
        if given.log or given.task or not given.runs:
            parser.error("--course: give --runs, and neither a log nor --task")
        work = _progress
    elif not given.task:
        parser.error("--task is missing")
    elif given.log:
        if given.prepare:
            parser.error("--prepare: without a log")
        work = _score
    else:
        if given.html or given.json or given.csv or given.runs:
            parser.error("LOG is missing: only a recording has a report")
        work = _prepare if given.prepare else _check
    try:
        return work(given)
    except (BadTask, BadRecording, report.BadReport, plans.BadPlan) as error:
        say(PROGRAM, str(error))
        return 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program; returns its exit status."""
    parser = _options()
    given = parser.parse_args(arguments)
    return ended(PROGRAM, lambda: _run(given, parser), "the report", "python3-yaml python3-matplotlib")


if __name__ == "__main__":
    sys.exit(main())
