"""Finds the entry, direction, depth and roll with which the needle tip, or a plan's seeds, reach their targets in the displaced tissue.

A planning problem is a YAML file:

    scene: prostate.yaml                # relative to this file
    set: {needle.bevel_slope: 0.05}     # scene keys to change; optional
    coordinates: patient                # coordinates of targets and entry: patient (mm) or mesh (m, the default)
    targets:
      - {name: base left, at: [12, 5, 10]}    # position in the tissue at rest
    entry: {x: [-25, 25], y: [-30, 20], z: -55, tilt: 0.2}    # a rectangle, and the maximum tilt (rad); or {template: NAME, holes: [C3, D4]}
    roll: free                          # or an angle, rad
    turn: true                          # the needle may be given half a turn during the insertion
    tolerance: 0.3e-3                   # m
    avoid:
      - {surface: bone, clearance: 2e-3}      # a mesh surface; or region: NAME
      - {contours: patient.csv, roi: Urethra, clearance: 1e-3}
    uncertainty:
      objective: worst                  # worst case over the samples; or mean; or nominal, for the scene's own values only
      samples: {method: sobol, count: 8, seed: 1}
      parameters:
        regions[prostate].youngs_modulus: {uniform: [42e3, 78e3]}

With `plan: FILE` instead of targets, entry and their options, the aim is for the plan's seeds to end up at their planned positions.

Command line:

    trocar-plan run | check | carry-out ...    --help says more; also python3 -m trocar.studies.planner
"""
from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Callable, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model, __version__
from ..brachy import plan as plans
from ._definition import BadStudy
from .._files import replacing
from .._locate import locate
from ._problem import IN_FRONT, BadProblem, Problem, read
from .._program import FAILED, ended, say
from ._rehearsal import Aim, Outcome, carried_out, depth_of
from ._runs import Pool, model_of
from ._search import ROUNDING, Case, Found
from ..brachy.plan import BadPlan, Needle, Plan, Turn

__all__ = ["BadProblem", "Expected", "Problem", "Result", "SeedResult", "carry_out", "models_of", "plan", "plan_seeds", "plan_target", "read"]

Array = npt.NDArray[np.float64]

NOTHING = float("nan")
MADE_BY = "# Made by trocar-plan"    # first line of any plan.yaml that this program writes


class Expected(NamedTuple):
    """The errors (m) to expect from an insertion, found by simulating it again exactly as a plan is carried out. NaN if it cannot be simulated."""

    error: float              # distance from the displaced target to the tip, for the scene's own values
    mean: float               # mean over the scene's own values and the samples
    worst: float              # worst case over the scene's own values and the samples
    offset: list[float]       # (3) vector from the displaced target to the tip
    clearance: float | None   # smallest value of distance minus desired clearance, over all obstacles and samples; None if there are no obstacles
    nearest: str              # name of the obstacle for which it is smallest
    shaft: list[list[float]]  # (joints, 3) positions of the needle's joints from base to tip
    why: str = ""             # why the first sample that fails cannot be simulated


@dataclass
class Result:
    """The result of planning for one target."""

    name: str
    target: list[float]       # (3) m, position of the target at rest
    needle: Needle
    expected: Expected
    unplanned: Expected       # without planning: straight at the rest position of the target, through the closest hole or from the point that faces the target
    rigid: Expected           # with a plan for a rigid needle: along the straight line to the rest position of the target that keeps all clearances
    nominal: Expected         # with a plan for the scene's own values only; equals `expected` if that is the objective
    reached: bool             # true if the error is within tolerance and all clearances are kept
    why: str                  # why the target was not reached
    runs: int                 # number of insertions simulated in the search
    seconds: float = 0.0      # s, CPU time of the search and of carrying out the plan


@dataclass
class SeedResult:
    """The result of planning for one needle and its seeds."""

    needle: Needle
    # (samples, seeds) m, how far each seed ends up from its planned position with the original plan; the first row is for the scene's own values;
    # NaN if not simulated
    before: list[list[float]]
    after: list[list[float]]     # the same, with the new plan
    reached: bool
    why: str
    runs: int
    seconds: float = 0.0


# ---- models ---------------------------------------------------------------------------------------------------------------------------------


def models_of(problem: Problem) -> list[Model]:
    """Builds the models: first the scene's own, then those of the samples. Raises Error."""
    base = Model(problem.scene())
    return [base, *(model_of(problem.study, values, base, False)[0] for values in problem.samples())]


# ---- tips -----------------------------------------------------------------------------------------------------------------------------------


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _rounded(needle: Needle) -> Needle:
    """Rounds a needle's numbers as they are when written to a file."""
    number = lambda value: float(f"{value:.9g}")
    return replace(needle, depth=number(needle.depth), roll=number(needle.roll), turn=needle.turn and Turn(*map(number, needle.turn)),
                   entry=needle.entry and tuple(map(number, needle.entry)), direction=tuple(map(number, needle.direction)))


def _needle_of(name: str, hole: str, aim: Aim, depth: float) -> Needle:
    roll = float(np.remainder(aim.roll + np.pi, 2.0 * np.pi) - np.pi)
    entry, direction = (None, (0.0, 0.0, 1.0)) if hole else (tuple(aim.point.tolist()), tuple(aim.direction.tolist()))
    return _rounded(Needle(hole, depth, [], 0, name, roll, aim.turn, entry, direction))


def _frame_of(problem: Problem, model: Model) -> Plan:
    """Returns a plan without needles for this problem."""
    guide = next((guide for guide in model.guides if guide.name == problem.template), None)
    return Plan(guide.name, guide.columns, guide.rows, guide.spacing) if guide else Plan("", 0, 0, 0.0)


def carry_out(problem: Problem, models: Sequence[Model], needle: Needle, target: npt.ArrayLike) -> Expected:
    """Simulates a needle meant for the point `target` (3,) m of the tissue at rest, in each of the models (as from `models_of`), and returns the errors."""
    case, frame = Case(problem, models, np.asarray(target, np.float64)), _frame_of(problem, models[0])
    outcomes: list[Outcome | None] = []
    why = ""
    for model in models:
        try:
            outcomes.append(carried_out(model, frame, needle, problem.hand, case.target))
        except Error as error:
            if error.status in ("no memory", "system"):
                raise
            outcomes.append(None)
            why = why or _one_line(error)
    distances = np.array([NOTHING if outcome is None else outcome.distance for outcome in outcomes])
    clear = [(there - o.clearance, o.name) for outcome in outcomes if outcome for o, there in zip(problem.obstacles, case.clearances(outcome, exact=True))]
    least = min(clear) if clear else (None, "")
    first = outcomes[0]
    return Expected(float(distances[0]), float(distances.mean()), float(distances.max()), first.error.tolist() if first else [NOTHING] * 3, least[0], least[1],
                    first.shaft.tolist() if first else [], why)


def _why(problem: Problem, found: Found, expected: Expected) -> str:
    """Explains what prevents the needle from reaching its target."""
    if expected.clearance is not None and expected.clearance < -ROUNDING:
        return f"{1e3 * -expected.clearance:.2f} mm too near to {expected.nearest}"
    if not np.isfinite(expected.worst):
        return f"cannot be simulated{' in every sample' if len(problem.study.parameters) else ''}: {expected.why}"
    reasons = [f"the {name} is at its limit" for name in found.limits]
    if problem.template:
        reasons.append("no hole is nearer" if not problem.bevelled else "the bevel does not bend the needle that far")
    if len(problem.study.parameters) and expected.error <= problem.tolerance:
        reasons = ["the samples differ by more than the tolerance"]
    return ", ".join(reasons) or "no better insertion was found"


def plan_target(problem: Problem, models: Sequence[Model], name: str, point: npt.ArrayLike) -> Result:
    """Plans for one target at `point` (3,) m in the tissue at rest. models: as from `models_of`."""
    begin = time.process_time()
    case = Case(problem, models, np.asarray(point, np.float64))
    (nominal_hole, nominal), (hole, best) = case.plan()
    expect = lambda aim, depth, hole_: carry_out(problem, models, _needle_of(name, hole_, aim, depth), point)
    needle = _needle_of(name, hole, best.aim, best.depth)
    expected = carry_out(problem, models, needle, point)
    seconds = time.process_time() - begin
    measured = {"nominal": expected.error, "mean": expected.mean, "worst": expected.worst}[problem.objective if len(models) > 1 else "nominal"]
    reached = bool(measured <= problem.tolerance and (expected.clearance is None or expected.clearance >= -ROUNDING))
    plain, (rigid_hole, rigid) = case.unplanned(), case.rigid()
    return Result(name, np.asarray(point).tolist(), needle, expected,
                  expect(plain, depth_of(plain, case.target), case.hole_aims()[0][0] if problem.template else ""),
                  expect(rigid, depth_of(rigid, case.target), rigid_hole),
                  expected if best is nominal else expect(nominal.aim, nominal.depth, nominal_hole), reached, "" if reached else _why(problem, best, expected),
                  case.runs(), seconds)


# ---- seeds ----------------------------------------------------------------------------------------------------------------------------------

SEED_ROUNDS = 10
SEED_EXACT = 2e-5    # m


def _placed(problem: Problem, model: Model, given: Needle, needle: Needle) -> Array:
    """Simulates `needle` in place of the plan's needle `given`. Returns how far (seeds, 3), in m, its seeds end up from the positions planned in `given`, in
    the tissue at rest. Raises BadPlan, Error."""
    from .. import Sim
    sim, dt = Sim(model), 1.0 / model.rate_hz
    for poses in replace(problem.hand, plan=replace(problem.plan, needles=[needle])).play(sim, dt):
        sim.run(poses, dt)
    wanted = plans.planned_seeds(replace(problem.plan, needles=[given]), model)
    placed = plans.seeds_of(sim)    # in the order in which they were left, distal seed first
    return np.array([there.position - here.position for there, here in zip(placed, wanted)])


def plan_seeds(problem: Problem, models: Sequence[Model], given: Needle) -> SeedResult:
    """Finds the depths at which to drop the seeds of one needle of the problem's plan so that they end up at their planned positions. models: as from
    `models_of`."""
    begin, runs = time.process_time(), 0
    half, axis = 0.5 * models[0].seed_size.length, plans.needle_axis(problem.plan, given, models[0])[1]
    samples = models if problem.objective != "nominal" else models[:1]
    wanted = np.array([given.depth - behind for behind in given.seeds])    # desired depths of the seeds' centres
    aimed, needle, best, why = wanted.copy(), given, None, ""
    # smallest depths tried that were too deep, and greatest depths tried that were too shallow
    deep, shallow = np.full(len(wanted), np.inf), np.full(len(wanted), -np.inf)
    for _ in range(SEED_ROUNDS):
        try:
            off = np.array([_placed(problem, model, given, needle) for model in samples])
        except (BadPlan, Error) as error:
            if isinstance(error, Error) and error.status in ("no memory", "system"):
                raise
            why = _one_line(error)
            break
        runs += len(samples)
        distances = np.linalg.norm(off, axis=2)
        measured = float(distances.max() if problem.objective == "worst" else np.sqrt(np.mean(distances ** 2)))
        if best is None or measured < best[0]:
            best = measured, needle, off[0]
        along = off @ axis
        change = 0.5 * (along.max(axis=0) + along.min(axis=0)) if problem.objective == "worst" else along.mean(axis=0)
        if np.abs(change).max() < SEED_EXACT:
            break
        deep, shallow = np.where(change > 0.0, np.minimum(deep, aimed), deep), np.where(change < 0.0, np.maximum(shallow, aimed), shallow)
        nearest = aimed - change
        # If the seed's final position jumps as a function of depth, for example behind a capsule, this finds the nearer side of the jump.
        between = 0.5 * (deep + shallow)
        aimed = np.where((nearest < deep) & (nearest > shallow) | ~np.isfinite(between), nearest, between)
        for i in range(1, len(aimed)):    # keep the seeds from overlapping
            aimed[i] = min(aimed[i], aimed[i - 1] - 2.0 * half - 1e-6)
        tip = aimed[0] + half
        needle = _rounded(replace(given, depth=float(tip), seeds=[round(float(tip - centre), 9) for centre in aimed]))
    chosen = best[1] if best else given
    failed: list[str] = []

    def measure(needle_: Needle) -> list[list[float]]:
        rows = []
        for model in models:
            try:
                rows.append(np.linalg.norm(_placed(problem, model, given, needle_), axis=1).tolist())
            except (BadPlan, Error) as error:
                if isinstance(error, Error) and error.status in ("no memory", "system"):
                    raise
                failed.append(_one_line(error))
                rows.append([NOTHING] * len(wanted))
        return rows

    before, after = measure(given), measure(chosen)
    over = np.array(after[:len(samples)])
    reached = bool(over.max() <= problem.tolerance)
    if not np.isfinite(after).all():
        why = f"cannot be simulated: {failed[-1]}"
    if not reached and not why:
        offset = best[2]
        aside = np.linalg.norm(offset - np.outer(offset @ axis, axis), axis=1).max()
        why = ("the samples differ by more than the tolerance" if over[0].max() <= problem.tolerance else "the needle bends aside" if aside > problem.tolerance
               else "a seed's position jumps with the depth")
    return SeedResult(chosen, before, after, reached, "" if reached else why, runs, time.process_time() - begin)


# ---- all of a problem -----------------------------------------------------------------------------------------------------------------------


def plan(problem: Problem, models: Sequence[Model] | None = None, workers: int = 1, only: Sequence[str] = (),
         progress: Callable[[int, int], None] = lambda done, of: None, lost: Callable[[str], None] | None = None) -> list[Result] | list[SeedResult]:
    """Plans for all targets, for the targets named in `only`, or for all needles of a plan, in order. workers: number of processes; it does not affect the
    results. progress(done, of) reports progress. If a search dies without a result, for example because memory runs out, `lost` is called with a
    description and the other results are returned. Raises Error if `lost` is not given in such a case, or if there are no results at all."""
    models = models_of(problem) if models is None else models
    jobs: list[Callable[[], Result | SeedResult]]
    if problem.plan:
        needles = [needle for needle in problem.plan.needles if needle.seeds and (not only or needle.title in only)]
        names = [f"needle {needle.title}" for needle in needles]
        jobs = [lambda needle=needle: plan_seeds(problem, models, needle) for needle in needles]
    else:
        targets = [(name, point) for name, point in problem.targets if not only or name in only]
        names = [f"target \"{name}\"" for name, _ in targets]
        jobs = [lambda name=name, point=point: plan_target(problem, models, name, point) for name, point in targets]
    found: list[Any] = [None] * len(jobs)
    without: list[str] = []

    def finished(index: int, outcome: Any, why: str) -> None:
        if outcome is None:
            without.append(f"{names[index]}: {why}: ended without a result, for lack of memory or because of a defect")
        else:
            found[index] = _restored(outcome)
        progress(sum(result is not None for result in found), len(jobs))

    def work(job: Callable[[], Result | SeedResult]) -> Callable[[], Any]:
        return lambda: _stored(job())

    progress(0, len(jobs))
    pool = Pool(workers, finished, "trocar-plan")
    try:
        for index, job in enumerate(jobs):
            pool.start(index, work(job))
        pool.join()
    finally:
        pool.kill()
    if without and (lost is None or len(without) == len(jobs)):
        raise Error(without[0], "system")
    for words in without:
        lost(words)
    return [result for result in found if result is not None]


def _stored(result: Result | SeedResult) -> dict[str, Any]:
    """Converts a result to plain objects that can be sent through a pipe."""
    from dataclasses import asdict
    kept = asdict(result)
    kept["needle"]["turn"] = result.needle.turn and list(result.needle.turn)
    for key, value in kept.items():
        if isinstance(value, Expected):
            kept[key] = list(value)
    return kept


def _restored(kept: dict[str, Any]) -> Result | SeedResult:
    needle = kept["needle"]
    for key in ("entry", "direction"):
        needle[key] = needle[key] and tuple(needle[key])
    needle["turn"] = needle["turn"] and Turn(*needle["turn"])
    kept["needle"] = Needle(**needle)
    if "before" in kept:
        return SeedResult(**kept)
    return Result(**{**kept, **{key: Expected(*kept[key]) for key in ("expected", "unplanned", "rigid", "nominal")}})


def whole(problem: Problem, model: Model, results: Sequence[Result] | Sequence[SeedResult]) -> Plan:
    """Combines the results into one plan."""
    if problem.plan:
        changed = {result.needle.hole: result.needle for result in results}
        return replace(problem.plan, needles=[changed.get(needle.hole, needle) for needle in problem.plan.needles])
    return replace(_frame_of(problem, model), needles=[result.needle for result in results])


# ---- the program ----------------------------------------------------------------------------------------------------------------------------

_say = partial(say, "trocar-plan")


def _chosen(problem: Problem, only: Sequence[str]) -> None:
    names = [needle.title for needle in problem.plan.needles if needle.seeds] if problem.plan else [name for name, _ in problem.targets]
    for name in only:
        if name not in names:
            raise BadProblem(f"{problem.path}: --only {name}: there is no such {'needle' if problem.plan else 'target'}: there are {', '.join(names)}")


def _keep_input(problem: Problem, out: Path) -> None:
    """Protects the user's files: raises BadProblem if the folder's plan.yaml was not written by this program, or is the problem's own plan."""
    path = out / "plan.yaml"
    if not path.exists():
        return
    ours = path.is_file() and path.read_text(encoding="utf-8", errors="replace").startswith(MADE_BY)
    if not ours or problem.plan and path.samefile(problem.plan.path):
        raise BadProblem(f"{path}: it would be overwritten: choose another folder with --out")


def _prepare(out: Path) -> None:
    """Creates the folder and checks that it is writable. Raises BadProblem if not."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=out):
            pass
    except OSError as error:
        why = "not a folder" if isinstance(error, (FileExistsError, NotADirectoryError)) else f"cannot be written: {error.strerror or error}"
        raise BadProblem(f"{out}: {why}: choose another folder with --out") from error


def _run(given: argparse.Namespace) -> int:
    import scipy.optimize    # noqa: F401    report missing packages before the search rather than after it
    import scipy.spatial    # noqa: F401
    if not given.no_plots:
        import matplotlib    # noqa: F401
    from . import _planning_report as report
    from .._program import Progress
    problem = read(given.problem)
    _chosen(problem, given.only)
    out = Path(given.out)
    _keep_input(problem, out)
    models = models_of(problem)
    _prepare(out)
    lost: list[str] = []
    results = plan(problem, models, given.workers or len(os.sched_getaffinity(0)), given.only,
                   Progress(given.quiet, "trocar-plan", "needles" if problem.plan else "targets"), lost.append)
    for words in lost:
        _say(f"{words}; {'plan.yaml keeps it unchanged' if problem.plan else 'plan.yaml omits it'}")
    found = whole(problem, models[0], results)
    with replacing(out / "plan.yaml") as temporary:
        plans.write(found, temporary, f"{MADE_BY.removeprefix('# ')} {__version__} from {Path(problem.path).name}. It is carried out at {problem.hand.speed:g} m/s, "
                    f"with a rest of {problem.hand.settle:g} s.")
    text, files = report.write(problem, models[0], results, out, not given.no_plots)
    print(text, end="")
    print(", ".join(str(path) for path in (out / "plan.yaml", *files)))
    return 0 if not lost and all(result.reached for result in results) else 1


def _check(given: argparse.Namespace) -> int:
    problem = read(given.problem)
    if problem.plan:
        print(f"{problem.path}: {len(problem.plan.needles)} needles, {sum(len(needle.seeds) for needle in problem.plan.needles)} seeds", end="")
    else:
        where = f"{len(problem.holes)} holes" if problem.template else f"an area, tilted by up to {problem.tilt:g} rad"
        steering = [*(["roll"] if problem.roll is None else []), *(["half a turn"] if problem.turn else [])]
        print(f"{problem.path}: {len(problem.targets)} targets; entry through {where}; {', '.join(['depth', *steering[:-1]])}{' and ' + steering[-1] + ' are' if steering else ' is'} free; avoids "
              f"{', '.join(o.name for o in problem.obstacles) or 'nothing'}", end="")
    print(f"; {len(problem.samples())} samples of {len(problem.study.parameters)} parameters, for the {problem.objective} one" if problem.study.parameters else "")
    return 0


def _check_plan(problem: Problem, found: Plan) -> None:
    """Raises BadPlan if any needle of a plan for the problem's targets cannot be carried out."""
    model, points = Model(problem.scene(), mesh_only=True), dict(problem.targets)
    for needle in found.needles:
        if needle.name not in points:
            raise BadPlan(f"{found.path}:{needle.line}: needle {needle.title}: no target in {problem.path} has its name: there are {', '.join(points)}")
    plans.planned_seeds(found, model)
    for needle in found.needles:
        if needle.entry is not None and locate(model, [np.array(needle.entry) - IN_FRONT * np.array(needle.direction)])[0][0] >= 0:
            raise BadPlan(f"{found.path}:{needle.line}: needle {needle.title}: its entry is in the tissue: write one on the skin or in front of it, in metres")


def _carry_out(given: argparse.Namespace) -> int:
    from . import _planning_report as report
    problem, found = read(given.problem), plans.read(given.plan)
    if problem.plan:
        raise BadProblem(f"{problem.path}: carry-out is for targets; compare the seeds of a plan with python3 -m trocar.brachy.plan compare")
    _check_plan(problem, found)
    models, points = models_of(problem), dict(problem.targets)
    rows = [(needle, carry_out(problem, models, needle, points[needle.name])) for needle in found.needles]
    print(report.carried(problem, rows), end="")
    for needle, expected in rows:
        if expected.why:
            _say(f"{found.path}:{needle.line}: needle {needle.title}: cannot be simulated: {expected.why}")
    return 1 if any(expected.why for _, expected in rows) else 0


def _options() -> argparse.ArgumentParser:
    from .._program import whole_number
    parser = argparse.ArgumentParser(prog="trocar-plan", description="Plans insertions, described by a file: entry, direction, depth and roll with which the tip, or "
                                     "a plan's seeds, end where they should in the displaced tissue.",
                                     epilog="Exit status: 0, 1 if a target is not reached within its tolerance, 2 for bad input, 3 if something else failed, such as memory or a "
                                     "missing package.")
    parser.add_argument("--version", action="version", version=f"trocar-plan {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, call: Any, words: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        added.add_argument("problem", help="problem, a YAML file", metavar="PROBLEM")
        added.set_defaults(call=call)
        return added

    added = command("run", _run, "find the plan, and write it with its expected errors")
    added.add_argument("--out", default="planning", help="folder of the results (default: planning)", metavar="FOLDER")
    added.add_argument("--workers", type=whole_number, help="targets at a time (default: one for each processor)", metavar="N")
    added.add_argument("--only", action="append", default=[], help="only this target, or the needle with this name, or in this hole if it has none; may be repeated", metavar="NAME")
    added.add_argument("--no-plots", action="store_true", help="write no pictures")
    added.add_argument("--quiet", action="store_true", help="print no progress")
    command("check", _check, "check the problem, and print which variables are free")
    added = command("carry-out", _carry_out, "carry out a plan in fresh simulations, and list its errors")
    added.add_argument("plan", help="plan, a YAML file whose needles have the names of targets", metavar="PLAN")
    return parser


def _call(given: argparse.Namespace) -> int:
    try:
        return given.call(given)
    except (BadStudy, BadPlan, Error) as error:
        _say(str(error))
        return FAILED if isinstance(error, Error) and error.status in ("no memory", "system") else 2
    except MemoryError:
        _say("not enough memory: plan fewer samples, or a coarser mesh")
        return FAILED


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program; returns its exit status."""
    given = _options().parse_args(arguments)
    return ended("trocar-plan", lambda: _call(given), given.problem, "python3-yaml python3-scipy python3-matplotlib")


if __name__ == "__main__":
    from trocar.studies import planner as _imported  # classes in __main__ would differ from those that other modules import

    sys.exit(_imported.main())
