"""From RT Structure Set to RT Dose: makes a plan, carries it out in a simulation, and reports the doses as planned, as achieved and after swelling.

Not for clinical use. Command line:

    python3 -m trocar.brachy.dosimetry optimise | implant | report ...    --help says more
"""
from __future__ import annotations

import argparse
import csv
import io
import sys
from os import PathLike, fspath
from pathlib import Path
from typing import Any, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Scene, Sim
from .. import _lcm_messages as messages
from .._files import open_input
from .._lcm_log import events
from .._page import save
from .._program import ended, say, whole_number
from .evaluation import Dosimetry, evaluate, planned_state, seed_model, source_of, write_dicom
from ._goals import Figure, unmet, with_limits
from .organs import ROLES, read_organs
from .optimise import Weights, make_plan
from .plan import BadPlan, Placed, Plan, check, read, read_seeds, seeds_of, seeds_of_message, write
from .swelling import Swelling
from .virtual_operator import Operator

Array = npt.NDArray[np.float64]

__all__ = ["Carried", "Dosimetry", "carry_out", "evaluate", "make_plan", "read_organs", "recorded", "source_of", "write_dicom"]

PROGRAM = "trocar.brachy.dosimetry"
STEP = 4e-3                                 # s, time step of the simulation
PRESCRIPTIONS = {"I-125": 145.0}            # Gy, default prescriptions for monotherapy (docs/dose.md); other isotopes need --prescription


# ---- the implant ----------------------------------------------------------------------------------------------------------------------------


class Carried(NamedTuple):
    """The outcome of an implant."""

    seeds: list[Placed]      # positions in the tissue at rest
    now: list[Placed]        # positions in the displaced tissue at the end
    needles: list[tuple[int, int]]    # for each seed, the index of its needle and its position in its strand
    field: Array             # (nodes, 3) m, displacements of the mesh nodes when the last seed was left
    time: float              # s, until the last seed was left: simulated, or since the first message about seeds in the recording


def carry_out(scene: str | PathLike[str], plan: Plan, **operator: Any) -> Carried:
    """Carries out a plan in a simulation of the scene, which gets as many needles as the plan needs. operator: arguments for
    `trocar.brachy.virtual_operator.Operator`, such as follows_image and seed. Raises BadPlan if the plan does not fit the scene or a needle cannot be
    simulated, and Error if the scene cannot be used."""
    loaded = Scene.load(scene)
    loaded["needles"] = max(len(plan.needles), int(loaded["needles"]))
    sim = Sim(Model(loaded))
    field = sim.displacements()
    for needle, poses in Operator(plan=plan, **operator).moves(sim, STEP):
        # a dropped seed stays in the needle until the needle is drawn back
        before = sim.displacements() if sim.pending_seeds(needle) else None
        try:
            sim.run(poses, STEP, needle)
        except Error as error:
            raise BadPlan(f"{plan.path}: needle {plan.needles[needle].title if needle < len(plan.needles) else needle}: {error}: if bone is in its way or close to it, choose "
                          "another hole") from error
        if before is not None:
            field = before
    return Carried(seeds_of(sim), seeds_of(sim, now=True), [(seed.needle, seed.strand) for seed in sim.seeds()], field, sim.time)


def recorded(scene: str | PathLike[str], log: str | PathLike[str]) -> Carried:
    """Returns the outcome of an implant carried out by hand, from a recording of the server's messages on TROCAR_SEEDS and TROCAR_DEFORMATION. Raises BadPlan if
    the recording cannot be used, and Error if the scene cannot."""
    model, name = Model(Scene.load(scene), mesh_only=True), fspath(log)
    seeds: messages.Seeds | None = None
    left: dict[tuple[int, int, bytes], tuple[int, int, Array | None]] = {}    # for each seed: tick and time (us) of its first message, and the first frame since
    began, servers, frame_tick, frame = 0, set(), -1, None
    for number, (channel, data) in enumerate(events(Path(log), BadPlan)):
        if channel not in ("TROCAR_SEEDS", "TROCAR_DEFORMATION"):
            continue
        try:
            if not messages.is_of_channel(channel, data):
                raise ValueError
            message = messages.read_seeds(data) if channel == "TROCAR_SEEDS" else messages.read_deformation(data)
        except ValueError:
            raise BadPlan(f"{name}: event {number}: {channel}: a message of another type, or damaged: record it with this release") from None
        servers.add(message.server)
        if isinstance(message, messages.Seeds):
            seeds, began = message, began or message.utime
            new = message.tick, message.utime, frame if frame_tick >= message.tick else None
            left = {key: left.get(key, new) for key in ((n, s, rest.tobytes()) for n, s, rest in zip(message.needle.tolist(), message.strand.tolist(), message.rest))}
        elif len(message.displacement) != len(model.nodes):
            raise BadPlan(f"{name}: tissue of {len(message.displacement)} nodes, the scene has {len(model.nodes)}: give the scene of the recording")
        else:
            frame_tick, frame = message.tick, message.displacement
            left = {key: (tick, utime, frame if field is None and frame_tick >= tick else field) for key, (tick, utime, field) in left.items()}
    if seeds is None or not left:
        raise BadPlan(f"{name}: no seeds: record TROCAR_SEEDS and TROCAR_DEFORMATION until after the last seed has been left")
    if len(servers) > 1:
        raise BadPlan(f"{name}: messages of {len(servers)} servers: record an implant from its beginning to its end with one server")
    _, ended_at, field = max(left.values(), key=lambda entry: entry[0])
    if field is None:
        raise BadPlan(f"{name}: no message on TROCAR_DEFORMATION after the last seed was left: record this channel, too, and for a second longer")
    return Carried(seeds_of_message(seeds, model), seeds_of_message(seeds, model, now=True), list(zip(seeds.needle.tolist(), seeds.strand.tolist())), field,
                   1e-6 * (ended_at - began))


def _seeds_csv(done: Carried) -> str:
    """Returns the seeds as CSV in the format of trocar-replay --seeds."""
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["seed", "needle", "guide", "hole", "strand", *(f"{axis} [m]" for axis in "xyz"), *(f"along_{axis}" for axis in "xyz"), *(f"rest_{axis} [m]" for axis in "xyz"),
                   *(f"rest_along_{axis}" for axis in "xyz")])
    for rest, now, (needle, strand) in zip(done.seeds, done.now, done.needles):
        rows.writerow([rest.number, needle, rest.guide, rest.hole, strand, *(f"{v:.9g}" for v in (*now.position, *now.direction, *rest.position, *rest.direction))])
    return out.getvalue()


FIELD = ["displacement_x [m]", "displacement_y [m]", "displacement_z [m]"]


def _field_csv(field: Array) -> str:
    out = io.StringIO()
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(FIELD)
    rows.writerows([f"{v:.6g}" for v in node] for node in field)
    return out.getvalue()


def _read_field(path: str) -> Array:
    try:
        with open_input(path, newline="", encoding="utf-8") as file:
            head, *rows = list(csv.reader(file)) or [[]]
        field = np.array([[float(v) for v in row] for row in rows], float)
    except OSError as error:
        raise BadPlan(f"{path}: cannot be opened: {error.strerror}") from error
    except (ValueError, csv.Error) as error:
        raise BadPlan(f"{path}: not a table of displacements: {error}") from error
    if head != FIELD or field.ndim != 2 or not np.isfinite(field).all():
        raise BadPlan(f"{path}: not a table of finite displacements with the columns {', '.join(FIELD)}: write one with \"implant --displacements\"")
    return field


# ---- commands -----------------------------------------------------------------------------------------------------------------------------


def _organs(given: argparse.Namespace, model: Model) -> Any:
    organs = read_organs(given.structures, model, {role: getattr(given, role) for role in ROLES})
    for role in ROLES:
        if role not in organs:
            say(PROGRAM, f"{given.structures}: no {role}: it is neither spared nor evaluated")
    return organs


def _goals(given: argparse.Namespace) -> Sequence[Figure]:
    try:
        return with_limits(given.limit or ())
    except ValueError as error:
        raise BadPlan(f"--limit: {error}") from error


def _optimise(given: argparse.Namespace) -> int:
    scene = Scene.load(given.scene)
    model, bones = Model(scene, mesh_only=True), scene.impenetrable()
    source = seed_model(given.source, given.seed_table, "--source")
    prescription = given.prescription or PRESCRIPTIONS.get(source.name.partition(" ")[0])
    if prescription is None:
        raise BadPlan(f"--prescription is missing: only I-125 has a default, {PRESCRIPTIONS['I-125']:g} Gy")
    organs = _organs(given, model)
    goals = _goals(given)
    plan = make_plan(model, organs, source, given.strength, prescription, given.template, int(given.needles), bones, Weights.for_goals(goals))
    check(plan, model)
    write(plan, given.out, "Not for treatment. Made by trocar.brachy.dosimetry optimise")
    values = planned_state(plan, model, source, organs).figures
    print(f"{given.out}: {len(plan.needles)} needles, {sum(len(n.seeds) for n in plan.needles)} seeds of {given.strength:g} U")
    for figure in goals:
        if figure.name in values:
            met = figure.met(values[figure.name], prescription)
            print(f"  {figure.name:12} {figure.shown(values[figure.name]):>10}" + ("" if met is None else "   met" if met else "   not met"))
    return 1 if unmet(values, prescription, goals) else 0


def _implant(given: argparse.Namespace) -> int:
    plan = read(given.plan)
    if given.log and (given.operator or given.seed is not None):
        raise BadPlan("--log: without --operator and --seed, which are for the virtual operator")
    done = recorded(given.scene, given.log) if given.log else carry_out(given.scene, plan, follows_image=given.operator != "marks", seed=1 if given.seed is None else given.seed)
    save(Path(given.out), _seeds_csv(done))
    if given.displacements:
        save(Path(given.displacements), _field_csv(done.field))
    print(f"{given.out}: {len(done.seeds)} of {sum(len(n.seeds) for n in plan.needles)} seeds, {done.time:.0f} s{'' if given.log else ' of simulated time'}")
    return 0


def _swelling(given: argparse.Namespace) -> Swelling:
    try:
        return Swelling(given.swelling, None, given.half_life) if given.half_life is not None else Swelling(given.swelling, given.days)
    except ValueError as error:
        raise BadPlan(str(error)) from error


def _report(given: argparse.Namespace) -> int:
    from . import _dosimetry_report as report
    model, plan, swelling = Model(Scene.load(given.scene), mesh_only=True), read(given.plan), _swelling(given)
    source, organs = source_of(plan, given.seed_table), _organs(given, model)
    field = _read_field(given.displacements) if given.displacements else None
    done = evaluate(model, plan, organs, read_seeds(given.seeds, model), source, field, swelling, _goals(given))
    folder = Path(given.out)
    files = write_dicom(done, given.structures, folder, given.grid)
    for name, text in (("report.html", report.as_html(done, files)), ("report.json", report.as_json(done, files)), ("report.csv", report.as_csv(done)),
                       ("dvh.csv", report.histograms_csv(done))):
        save(folder / name, text)
    print(report.as_text(done))
    return 0


def _number(low: float, high: float) -> Any:
    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text}: write a number from {low:g} to {high:g}")
        return value
    return parse


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"python3 -m {PROGRAM}", description="Not for treatment. The dose of an implant in an RT Structure Set: planned, achieved, after swelling.",
                                     epilog="Exit status: 0, 1 if a plan misses a limit, 2 for bad input, 3 if something else failed, such as a missing package.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, run: Any, words: str) -> Any:
        added = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ". Not for treatment.")
        added.add_argument("--scene", required=True, help="scene made from the structure set by trocar-anatomy (required)", metavar="FILE")
        added.set_defaults(run=run)
        return added.add_argument

    def with_organs(add: Any) -> None:
        add("--structures", required=True, help="RT Structure Set with the organs (required)", metavar="FILE")
        for role, name in (("gland", "Prostate"), ("urethra", "Urethra"), ("rectum", "Rectum")):
            add(f"--{role}", help=f"name of its region of interest (default {name})", metavar="ROI")
        add("--limit", action="append", help='set a limit on a figure, such as "urethra D10 <= 1.3" (times the prescription); may be given several times', metavar="LIMIT")

    add = command("optimise", _optimise, "choose needles and seeds for a prescription, and write them as a plan")
    with_organs(add)
    add("--out", required=True, help="plan, a YAML file (required)", metavar="FILE")
    add("--source", default="I-125 6711", help="isotope and model of the seeds (default %(default)s)", metavar="SEED")
    add("--seed-table", help="TG-43 table of the seed, if it is not built in", metavar="FILE")
    add("--strength", type=_number(1e-3, 1000.0), default=0.45, help="air-kerma strength of a seed, U (default %(default)s)", metavar="U")
    add("--prescription", type=_number(1.0, 1000.0), help="Gy (default 145 for I-125)", metavar="GY")
    add("--template", help="guide of the scene (default: its only one)", metavar="NAME")
    add("--needles", type=_number(1, 32), default=25, help="maximum number of needles (default %(default)s)", metavar="COUNT")

    add = command("implant", _implant, "carry out a plan with a virtual operator, or take the seeds from a recording")
    add("--plan", required=True, help="plan, a YAML file (required)", metavar="FILE")
    add("--out", required=True, help="table of the seeds, in the format of trocar-replay --seeds (required)", metavar="FILE")
    add("--displacements", help="write the displacements of the mesh's nodes when the last seed was left", metavar="FILE")
    add("--operator", choices=("image", "marks"), help="what the operator follows (default image)")
    add("--seed", type=whole_number, help="seed of the operator's random errors (default 1)", metavar="NUMBER")
    add("--log", help="read the seeds from a recording of an implant by hand (lcm-logger or trocar-view --task), instead of simulating an operator", metavar="FILE")

    add = command("report", _report, "compute the doses, and write DICOM files and a report")
    with_organs(add)
    add("--plan", required=True, help="plan, a YAML file (required)", metavar="FILE")
    add("--seeds", required=True, help="seeds that were left in the tissue: table of implant, trocar-replay --seeds, or trocar.brachy.plan import (required)", metavar="FILE")
    add("--displacements", help="table that implant has written: also report the dose in the displaced tissue", metavar="FILE")
    add("--out", required=True, help="folder for report.html, report.json, report.csv, dvh.csv and the DICOM files (required)", metavar="FOLDER")
    add("--seed-table", help="TG-43 table of the seed, if it is not built in", metavar="FILE")
    add("--swelling", type=_number(1.0, 3.0), default=Swelling.ratio, help="volume of the gland after the implant, divided by that before (default %(default)s)", metavar="RATIO")
    add("--days", type=_number(0.1, 1000.0), default=Swelling.days, help="days after which a linear swelling has subsided (default %(default)g)", metavar="DAYS")
    add("--half-life", type=_number(0.1, 1000.0), help="half-life of the swelling in days, if it decays exponentially", metavar="DAYS")
    add("--grid", type=_number(0.5, 10.0), default=1.0, help="distance between the points of the RT Dose, mm (default %(default)g)", metavar="MM")
    return parser


def _run(given: argparse.Namespace) -> int:
    try:
        return int(given.run(given))
    except (BadPlan, Error) as error:
        say(PROGRAM, str(error))
        return 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program; returns its exit status."""
    given = _options().parse_args(arguments)
    return ended(PROGRAM, lambda: _run(given), fspath(given.out), "python3-yaml python3-pydicom python3-scipy python3-matplotlib")


if __name__ == "__main__":
    sys.exit(main())
