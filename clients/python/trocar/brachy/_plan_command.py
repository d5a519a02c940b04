"""Implements the command `python3 -m trocar.brachy.plan`."""
from __future__ import annotations

import argparse
import csv
from typing import Any, Sequence

import numpy as np

from .. import Error, Model, Scene
from .._program import ended, say
from .plan import BadPlan, Frame, Misplacement, Placed, Planned, check, compare, planned_seeds, read, read_seeds, summary, without_steering, write

PROGRAM = "trocar.brachy.plan"


# ---- tables -------------------------------------------------------------------------------------------------------------------------


def planned_table(seeds: Sequence[Planned], frame: Frame) -> list[list[str]]:
    head = ["hole", "seed", "x [m]", "y [m]", "z [m]"] + ([f"{name} [mm]" for name in frame.names] if frame.is_patient else [])
    rows = [head]
    for seed in seeds:
        patient = [f"{value:.3f}" for value in frame.position(seed.position)] if frame.is_patient else []
        rows.append([seed.hole, str(seed.number), *(f"{value:.6f}" for value in seed.position), *patient])
    return rows


def _seed_table(seeds: Sequence[Placed]) -> list[list[str]]:
    """Returns a table of the seeds' rest positions that `read_seeds` can read."""
    head = ["seed", "guide", "hole", *(f"rest_{axis} [m]" for axis in "xyz"), *(f"rest_along_{axis}" for axis in "xyz")]
    return [head] + [[str(seed.number), seed.guide, seed.hole, *(f"{value:.9g}" for value in (*seed.position, *seed.direction))] for seed in seeds]


def _misplacement_table(rows: Sequence[Misplacement], frame: Frame) -> list[list[str]]:
    table = [["hole", "planned", "seed", *(f"{name} [mm]" for name in frame.names), "along [mm]", "across [mm]", "distance [mm]", "remark"]]
    for r in rows:
        numbers = [""] * 6 if r.offset is None else [f"{value:.3f}" for value in (*r.offset, r.along, r.across, np.linalg.norm(r.offset))]
        remark = "not planned" if r.planned is None else "not placed" if r.placed is None else ""
        table.append([r.hole, str(r.planned.number) if r.planned else "", str(r.placed.number) if r.placed else "", *numbers, remark])
    return table


def _print(table: list[list[str]]) -> None:
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    for row in table:
        print("  ".join(text.rjust(width) for text, width in zip(row, widths)).rstrip())


def _save(table: list[list[str]], path: str) -> None:
    with open(path, "w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(table)


def _show(given: argparse.Namespace, model: Model) -> None:
    plan = read(given.plan)
    table = planned_table(planned_seeds(without_steering(plan, "the table") if given.out else plan, model), Frame(model))
    _save(table, given.out) if given.out else _print(table)


def _check(given: argparse.Namespace, model: Model) -> None:
    plan = read(given.plan)
    counts = check(plan, model)
    where = ", ".join(f"{count} in {name}" for name, count in counts.items())
    print(f"{plan.path}: {len(plan.needles)} needles, {sum(counts.values())} seeds{': ' + where if where else ''}")


def _export(given: argparse.Namespace, model: Model) -> None:
    from . import rtplan
    placed = read_seeds(given.seeds, model, given.now) if given.seeds else None
    rtplan.export(without_steering(read(given.plan), "DICOM's plan"), model, given.out, given.structures, placed)


def _import(given: argparse.Namespace, model: Model) -> None:
    from . import rtplan
    if given.seeds:
        _save(_seed_table(rtplan.read_seeds(given.file, model, given.template)), given.seeds)
    if given.out:
        plan = rtplan.read(given.file, model, given.template)
        planned_seeds(plan, model)
        write(plan, given.out, "\n".join([f"From {given.file}", *plan.remarks]))
        for remark in plan.remarks:
            say(PROGRAM, f"{given.file}: {remark}")


def _compare(given: argparse.Namespace, model: Model) -> None:
    frame = Frame(model)
    rows = compare(read(given.plan), model, read_seeds(given.seeds, model, given.now))
    table = _misplacement_table(rows, frame)
    _save(table, given.out) if given.out else _print(table)
    mean = summary(rows)
    if mean["count"]:
        axes = ", ".join(f"{name} {mean[str(i)]:.2f}" for i, name in enumerate(frame.names))
        print(f"mean of {mean['count']} seeds: {mean['distance']:.2f} mm ({axes}); along the needle {mean['along']:.2f}, {mean['deeper']:+.2f} with its sign, "
              f"across {mean['across']:.2f}")


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python3 -m trocar.brachy.plan", description="Plans of an implant: needles by the template's coordinates, seeds along them.",
                                     epilog="Exit status: 0, 2 for bad input, 3 if something else failed, such as a missing package.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Any, words: str, *first: tuple[str, str]) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        for argument, text in first:
            added.add_argument(argument, help=text, metavar=argument.upper())
        added.add_argument("--scene", required=True, help="scene that the plan is for (required)", metavar="FILE")
        added.set_defaults(run=run)
        return added

    plan = ("plan", "plan, a YAML file")
    command("show", _show, "list the planned positions of the seeds, in mesh and patient coordinates", plan).add_argument("--out", help="write a CSV file", metavar="FILE")
    command("check", _check, "check that the plan fits the scene and that its seeds are in the tissue", plan)
    added = command("export", _export, "write the plan, or the seeds left in the tissue, as a DICOM RT Plan", plan)
    added.add_argument("--out", required=True, help="DICOM file (required)", metavar="FILE")
    added.add_argument("--seeds", help="table written by trocar-replay --seeds: use these seeds instead of the planned ones", metavar="FILE")
    added.add_argument("--now", action="store_true", help="with --seeds: positions at the end of the replay (default: in the tissue at rest)")
    added.add_argument("--structures", help="RT Structure Set from which the scene was made: the plan gets its patient and frame of reference", metavar="FILE")
    added = command("import", _import, "make a plan from a DICOM RT Plan", ("file", "RT Plan with permanent seeds"))
    added.add_argument("--out", help="plan, a YAML file: the seeds are on the axes of the template's holes", metavar="FILE")
    added.add_argument("--seeds", help="table of the seeds at their positions in the file, in the format of trocar-replay --seeds; also for seeds that were left in the tissue", metavar="FILE")
    added.add_argument("--template", help="guide of the scene to use, if the file gives it another name", metavar="NAME")
    added = command("compare", _compare, "list the distances of seeds from their planned positions", plan, ("seeds", "table that trocar-replay --seeds has written"))
    added.add_argument("--now", action="store_true", help="use positions at the end of the replay (default: in the tissue at rest)")
    added.add_argument("--out", help="write a CSV file", metavar="FILE")
    return parser


def _run(given: argparse.Namespace) -> int:
    try:
        given.run(given, Model(Scene.load(given.scene), mesh_only=True))
    except (BadPlan, Error) as error:
        say(PROGRAM, str(error))
        return 2
    return 0


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program and returns its exit status."""
    parser = _options()
    given = parser.parse_args(arguments)
    if given.command == "import" and not (given.out or given.seeds):
        parser.error("import: give --out, --seeds or both")
    return ended(PROGRAM, lambda: _run(given), given.scene, "python3-yaml python3-pydicom")
