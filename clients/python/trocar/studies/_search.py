"""Searches for an insertion that brings the tip to its target in the displaced tissue."""
from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Callable, Collection, Iterator, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model
from ..brachy import plan as plans
from ..brachy._obstacles import Embedding
from ._problem import Problem
from ._rehearsal import Aim, Outcome, Rehearsal, Target, depth_of
from ..motion import exponential, multiply, rotate, towards
from ..brachy.plan import Turn

Array = npt.NDArray[np.float64]

UNIT = 1e-4          # m, unit of errors and of violations of clearances in the search
STAY = 0.02          # weight of the distance from the start, so that of all insertions that reach the target, the search finds one close to the start
FAILED = 2e-2        # m, error assigned to an insertion that cannot be simulated
GRID = 13            # for a rigid needle, try this many entry points along each side of the area
NEIGHBOURS = 4       # start searches from this many holes, closest first
ROLLS = (0.0, 0.5 * math.pi, math.pi, -0.5 * math.pi)    # rad, initial rolls to try for an area until one leads to the target
LAST = 2e-3          # m: a turn closer to the target than this is left out
# Finite-difference steps are this much longer for derivatives over samples. With shorter steps, the differences would drown in the roughness of the
# errors.
LONGER = 4.0
ROUNDING = 1e-5      # m, tolerance for rounding errors in a clearance
MARGIN = 2e-5        # m, added to the desired clearance so that the needle still has that clearance when the plan is carried out
SPARE = 2e-3         # m: the search ignores obstacles whose clearance exceeds the desired one by more than this
TOO_NEAR = 10.0      # weight of violations of clearances relative to the worst-case error
NOMINAL_STEPS = 25    # maximum number of steps in the nominal search, which uses the scene's own parameter values
ENOUGH_NOMINAL = 0.02    # in UNITs: the nominal search ends when the next step should gain less than this
NO_ERROR = 0.1       # in UNITs: errors below this are good enough
BENDING = ("roll", "turn")    # variables that change how the bevel bends the needle; for these, the rigid-needle approximation fails
JUMP = 3.0           # in UNITs: a step that misses its prediction by more than this means that the tip has jumped, so it is not used to update the slopes
PASSES = 2           # the worst-case search starts this many times with new slopes
STEPS = 12           # maximum number of steps in the worst-case search
RADIUS = 0.4         # initial trust-region radius in the worst-case search
SMALLEST = 0.02      # smallest step in the worst-case search
ENOUGH = 0.05        # in UNITs: the worst-case search ends when the next step should gain less than this


class Variable(NamedTuple):
    name: str
    scale: float    # change in the variable that counts as 1 in the search
    low: float
    high: float
    step: float     # finite-difference step


class Freedom:
    """The free variables of an insertion, scaled and collected in a vector x for the search."""

    def __init__(self, problem: Problem, start: Aim, depth: float, skin: float):
        """depth, skin: depths of the target and of the skin, in m from the start."""
        self.variables: list[Variable] = []
        self._start, self._problem = start, problem
        area, values = problem.area, []
        frame = towards(start.direction if area is None else area.direction)
        self._across = np.array([rotate(frame, [1.0, 0.0, 0.0]), rotate(frame, [0.0, 1.0, 0.0])])
        if area is not None:
            lengths = np.linalg.norm(area.edges, axis=1)
            self._edges = area.edges / lengths[:, None]
            self.variables += [Variable("entry", 5e-3, 0.0, length, 0.3e-3) for length in lengths]
            values += list(self._edges @ (start.point - area.origin))
            if problem.tilt:
                self.variables += [Variable("tilt", 0.05, -problem.tilt, problem.tilt, 4e-3)] * 2
                values += list(np.arctan(self._across @ start.direction / (start.direction @ area.direction)))
        if problem.roll is None:
            self.variables.append(Variable("roll", 1.0, start.roll - 2.0 * math.pi, start.roll + 2.0 * math.pi, 0.1))
            values.append(start.roll)
        if problem.turn:
            low = max(skin, 1e-3)    # in a plan, the depth of a turn must be positive
            high = max(depth, low) + 5e-3
            self.variables.append(Variable("turn", 2e-2, low, high, 2e-3))
            values.append(start.turn.depth if start.turn else high)
        self.scale = np.array([v.scale for v in self.variables])
        self.low = np.array([v.low for v in self.variables]) / self.scale
        self.high = np.array([v.high for v in self.variables]) / self.scale
        self.steps = np.array([v.step for v in self.variables]) / self.scale
        self.start = np.clip(np.array(values) / self.scale, self.low, self.high) if values else np.zeros(0)

    def aim(self, x: Array) -> Aim:
        values, aim, at = x * self.scale, self._start, 0
        if self._problem.area is not None:
            aim = aim._replace(point=self._problem.area.origin + values[:2] @ self._edges)
            at = 2
            if self._problem.tilt:
                direction = self._problem.area.direction + np.tan(values[2:4]) @ self._across
                aim, at = aim._replace(direction=direction / np.linalg.norm(direction)), 4
        if self._problem.roll is None:
            aim, at = aim._replace(roll=float(values[at])), at + 1
        if self._problem.turn:
            aim = aim._replace(turn=Turn(float(values[at]), math.pi))
        return aim

    def at_limits(self, x: Array) -> list[str]:
        near = (x - self.low < 1e-3) | (self.high - x < 1e-3)
        return list(dict.fromkeys(v.name for v, there in zip(self.variables, near) if there and v.name != "turn"))

    def stepped(self, x: Array, i: int, times: float = 1.0) -> tuple[Array, float]:
        """Returns x with component i moved by `times` finite-difference steps, backwards if that would exceed the upper limit; and the signed change."""
        step = times * self.steps[i] * (1.0 if x[i] + times * self.steps[i] <= self.high[i] else -1.0)
        other = x.copy()
        other[i] += step
        return other, step


    def carried(self, x: Array, other: Array, outcome: Outcome) -> Outcome:
        """Approximates the outcome at `other` by moving the needle rigidly from its position at x; the tissue is left as it is."""
        here, there = self.aim(x), self.aim(other)
        frame = lambda aim: multiply(towards(aim.direction), exponential([0.0, 0.0, aim.roll]))
        local = rotate(frame(here) * [1.0, -1.0, -1.0, -1.0], outcome.shaft - here.point)
        return outcome._replace(shaft=there.point + rotate(frame(there), local))


@dataclass
class Found:
    """An insertion found by the search."""

    aim: Aim
    depth: float
    error: float          # m: the nominal, mean or worst-case error, depending on the objective
    missing: float        # m, total shortfall in clearance: 0 if all clearances are kept; inf if the insertion cannot be simulated
    limits: list[str]     # names of the variables that are at their limits
    x: Array
    freedom: Freedom

    def reaches(self, tolerance: float) -> bool:
        return self.error <= tolerance and self.missing <= ROUNDING

    def rank(self) -> tuple[float, float]:
        return (round(max(self.missing - ROUNDING, 0.0), 5), self.error)


class Case:
    """A target in one or more models: the nominal model and those of the samples."""

    def __init__(self, problem: Problem, models: Sequence[Model], point: Array):
        self.problem, self.models = problem, models
        self.rehearsals = [Rehearsal(model, problem.hand) for model in models[:1]]
        self.target, self.embedding = Target(point, models[0]), Embedding(models[0])
        self.radius = 0.5 * float(problem.scene()["needle.outer_diameter"])

    def all_rehearsals(self) -> list[Rehearsal]:
        """Returns the rehearsals for all models: the scene's own values first, then the samples."""
        if len(self.rehearsals) < len(self.models):
            self.rehearsals += [Rehearsal(model, self.problem.hand) for model in self.models[1:]]
        return self.rehearsals

    def runs(self) -> int:
        return sum(rehearsal.runs for rehearsal in self.rehearsals)

    def clearances(self, outcome: Outcome, exact: bool = False) -> list[float]:
        """Returns the needle's distance (m) from each obstacle in the displaced tissue. Where the needle is well clear of an obstacle, this may be a lower
        bound unless `exact` is true."""
        return [o.distance(outcome.shaft, self.radius, self.embedding, outcome.field, math.inf if exact else o.clearance + SPARE) for o in self.problem.obstacles]

    def missing(self, clearances: Sequence[float]) -> Array:
        """Returns by how much (obstacles,), in m, each clearance falls short."""
        return np.array([max(o.clearance + MARGIN - there, 0.0) for o, there in zip(self.problem.obstacles, clearances)])

    # ---- a rigid needle in tissue at rest ---------------------------------------------------------------------------------------------------

    def straight_missing(self, aim: Aim) -> float:
        line = np.stack([aim.point, aim.point + depth_of(aim, self.target) * aim.direction])
        return float(sum(max(o.clearance - o.distance(line, self.radius), 0.0) for o in self.problem.obstacles))

    def unplanned(self) -> Aim:
        """Returns the aim without any planning: straight ahead from the hole, or the point of the area, that faces the target."""
        problem, point = self.problem, self.target.point
        if problem.area is None:
            return self.hole_aims()[0][1]
        area = problem.area
        normal = np.cross(*area.edges)
        foot = point - ((point - area.origin) @ normal) / (area.direction @ normal) * area.direction
        lengths = np.linalg.norm(area.edges, axis=1)
        place = np.clip((area.edges / lengths[:, None]) @ (foot - area.origin), 0.0, lengths)
        return Aim(area.origin + place @ (area.edges / lengths[:, None]), area.direction, problem.roll or 0.0)

    def hole_aims(self) -> list[tuple[str, Aim]]:
        """Returns straight aims through the holes, sorted by how far each hole's axis is from the target, closest first."""
        model, point = self.models[0], self.target.point
        guide = next(guide for guide in model.guides if guide.name == self.problem.template)
        found = []
        for hole in self.problem.holes:
            face = plans.hole_axis(guide, hole)
            off = point - face
            found.append((float(np.linalg.norm(off - (off @ guide.normal) * guide.normal)), hole, Aim(face, guide.normal, self.problem.roll or 0.0)))
        found.sort(key=lambda entry: (round(entry[0], 9), entry[1]))
        return [(hole, aim) for _, hole, aim in found]

    def rigid(self) -> tuple[str, Aim]:
        """Plans for a rigid needle in tissue at rest: returns the straight line to the target that keeps all clearances with the least tilt or, if there is
        none, the line with the smallest total shortfall. For a template, the line goes through the closest hole that keeps the clearances. For an area, the
        hole is ""."""
        problem, point = self.problem, self.target.point
        if problem.area is None:
            ranked = [(round(self.straight_missing(aim), 6), i, hole, aim) for i, (hole, aim) in enumerate(self.hole_aims()[:4 * NEIGHBOURS])]
            return min(ranked)[2:]
        area, plain = problem.area, self.unplanned()
        edge = np.linspace(0.0, 1.0, GRID)
        points = [plain.point, *(area.origin + s * area.edges[0] + t * area.edges[1] for s in edge for t in edge)] if problem.tilt else [plain.point]
        frame = towards(area.direction)
        across = np.array([rotate(frame, [1.0, 0.0, 0.0]), rotate(frame, [0.0, 1.0, 0.0])])
        tried = []
        for start in points:
            direction = (point - start) / np.linalg.norm(point - start)
            if direction @ area.direction <= 0.0:
                continue
            tilts = np.arctan(across @ direction / (direction @ area.direction))
            beyond = np.clip(tilts, -problem.tilt, problem.tilt)
            if np.abs(beyond - tilts).max() > 1e-9 and start is not plain.point:
                continue
            direction = area.direction + np.tan(beyond) @ across
            tried.append((float(beyond @ beyond), plain._replace(point=start, direction=direction / np.linalg.norm(direction))))
        tried = tried or [(0.0, plain)]    # fallback if no point of the area has the target ahead of it
        tried.sort(key=lambda entry: entry[0])
        best: tuple[float, Aim] | None = None
        for _, aim in tried:    # aims are sorted by tilt, so take the first that keeps the clearances
            missing = self.straight_missing(aim)
            if best is None or missing < best[0]:
                best = (missing, aim)
            if missing == 0.0:
                break
        return "", best[1]

    # ---- nominal parameters ---------------------------------------------------------------------------------------------------------------

    def search(self, freedom: Freedom) -> Found:
        """Minimises the squared errors and clearance shortfalls with a Gauss-Newton trust-region method. The Jacobian starts out as that of a rigid needle
        and is improved with each insertion tried (Broyden, Mathematics of Computation 19, 1965, 577-593). Finite differences are used only if that gets
        stuck before the target is reached."""
        from scipy.optimize import lsq_linear
        further, obstacles = 0.0, len(self.problem.obstacles)

        def evaluate(x: Array) -> tuple[Array, Outcome | None]:
            """Returns the error vector (3) and the clearance shortfalls, in UNITs."""
            nonlocal further
            try:
                outcome = self.rehearsals[0].best(freedom.aim(x), self.target, further)
            except Error as error:
                if error.status in ("no memory", "system"):
                    raise
                return np.full(3 + obstacles, FAILED / UNIT), None
            further = outcome.depth - depth_of(freedom.aim(x), self.target)
            return np.concatenate([outcome.error, self.missing(self.clearances(outcome))]) / UNIT, outcome

        def differentiate(x: Array, values: Array, names: Collection[str]) -> None:
            """Recomputes the slopes with respect to the named variables by finite differences."""
            for i, variable in enumerate(freedom.variables):
                if variable.name in names:
                    other, step = freedom.stepped(x, i)
                    slopes[:, i] = (evaluate(other)[0] - values) / step

        def rigid(x: Array, outcome: Outcome) -> Array:
            """Returns the slopes of errors and shortfalls, on the assumption that the needle keeps its shape."""
            slopes, missing = np.zeros((3 + obstacles, len(x))), self.missing(self.clearances(outcome))
            for i in range(len(x)):
                other, step = freedom.stepped(x, i)
                aim, moved = freedom.aim(other), freedom.carried(x, other, outcome)
                error = moved.shaft[-1] - outcome.shaft[-1]
                slopes[:3, i] = (error - (error @ aim.direction) * aim.direction) / UNIT / step
                if missing.any():
                    slopes[3:, i] = np.where(missing > 0.0, (self.missing(self.clearances(moved)) - missing) / UNIT / step, 0.0)
            return slopes

        every = {variable.name for variable in freedom.variables}
        total = lambda values, x: float(np.linalg.norm(np.concatenate([values, STAY * (x - freedom.start)])))
        x, radius = freedom.start, 1.0
        values, outcome = evaluate(x)
        slopes = np.zeros((3 + obstacles, len(x))) if outcome is None else rigid(x, outcome)
        exact = outcome is None
        differentiate(x, values, every if exact else ["turn"])
        for _ in range(NOMINAL_STEPS if len(x) else 0):
            matrix = np.concatenate([slopes, STAY * np.eye(len(x))])
            wanted = -np.concatenate([values, STAY * (x - freedom.start)])
            low, high = np.maximum(freedom.low - x, -radius), np.minimum(freedom.high - x, radius)
            bounds = np.minimum(low, -1e-9), np.maximum(high, 1e-9)    # lsq_linear requires them to differ
            step = np.clip(lsq_linear(matrix, wanted, bounds, method="bvls").x, low, high)
            gain = total(values, x) - float(np.linalg.norm(matrix @ step - wanted))
            if gain < ENOUGH_NOMINAL or radius < SMALLEST:
                if exact or np.linalg.norm(values) < NO_ERROR:
                    break
                radius, exact = max(radius, 0.25), True
                differentiate(x, values, every)
                continue
            there, result = evaluate(x + step)
            ratio = (total(values, x) - total(there, x + step)) / gain
            if result is not None:
                slopes[:3] += np.outer(there[:3] - values[:3] - slopes[:3] @ step, step) / (step @ step)
            if ratio < 0.25:
                radius = 0.4 * float(np.abs(step).max())
            elif ratio > 0.75:
                radius *= 2.0
            if ratio > 0.05:
                x, values, outcome, exact = x + step, there, result, False
                if outcome is not None:
                    slopes[3:] = rigid(x, outcome)[3:]
        aim = freedom.aim(x)
        if outcome is None:
            return Found(aim, depth_of(aim, self.target), FAILED, math.inf, freedom.at_limits(x), x, freedom)
        if aim.turn and aim.turn.depth > outcome.depth - LAST:
            aim = aim._replace(turn=None)
        return Found(aim, outcome.depth, outcome.distance, UNIT * float(values[3:].sum()), freedom.at_limits(x), x, freedom)

    def _skin(self, aim: Aim) -> float:
        entry = self.models[0].entry(aim.point - self.problem.hand.outside * aim.direction, self.target.point)
        return 0.0 if entry is None else max(float((entry - aim.point) @ aim.direction), 0.0)

    def _start(self, aim: Aim) -> tuple[Aim, float, float]:
        return aim, depth_of(aim, self.target), self._skin(aim)

    def towards_target(self, aim: Aim) -> Aim:
        """Completes an aim through a hole: chooses the roll with which the bevel bends the needle towards the target, and a turn to stop the bending."""
        problem = self.problem
        if not problem.bevelled or problem.roll is not None and not problem.turn:
            return aim
        frame = towards(aim.direction)
        x, y = rotate(frame, [1.0, 0.0, 0.0]), rotate(frame, [0.0, 1.0, 0.0])
        off = self.target.point - aim.point
        if problem.roll is None:
            aim = aim._replace(roll=math.atan2(off @ x, -(off @ y)))    # the bevel face is towards local +y, and the needle bends away from it
        if not problem.turn:
            return aim
        side = math.sin(aim.roll) * x - math.cos(aim.roll) * y
        outcome = self.rehearsals[0].best(aim, self.target)
        bent = float((outcome.shaft[-1] - aim.point) @ side)
        depth, skin = outcome.depth, self._skin(aim)
        share = float(np.clip(0.5 * (1.0 + (off @ side) / max(bent, 1e-6)), 0.0, 1.0))
        return aim if share > 0.98 else aim._replace(turn=Turn(skin + share * (depth - skin), math.pi))

    def starts(self) -> Iterator[tuple[str, Aim]]:
        """Yields starting points for the search: holes ("" for an area) and aims."""
        problem = self.problem
        if problem.area is None:
            near = self.hole_aims()
            clear = [entry for entry in near[:4 * NEIGHBOURS] if self.straight_missing(entry[1]) < 2e-3] or near
            for hole, aim in clear[:NEIGHBOURS]:
                yield hole, self.towards_target(aim)
            return
        _, rigid = self.rigid()
        skin, depth = self._skin(rigid), depth_of(rigid, self.target)
        turn = Turn(0.5 * (skin + depth), math.pi) if problem.turn else None    # a turn at this depth cancels most of the bevel's effect
        for roll in [rigid.roll] if problem.roll is not None else ROLLS:
            yield "", rigid._replace(roll=roll, turn=turn)

    def plan(self) -> tuple[tuple[str, Found], tuple[str, Found]]:
        """Returns two plans, each a hole and an insertion: the nominal plan, and the best plan for the problem's objective. Tries one starting point after
        another until the target is reached."""
        problem, nominal, best = self.problem, None, None
        for hole, aim in self.starts():
            found = self.search(Freedom(problem, *self._start(aim)))
            if nominal is None or found.rank() < nominal[1].rank():
                nominal = hole, found
            elif found.missing > ROUNDING or found.error > nominal[1].error + problem.tolerance:
                continue
            if problem.objective != "nominal" and len(self.models) > 1:
                found = self.robust(found)
            if best is None or found.rank() < best[1].rank():
                best = hole, found
            if found.reaches(problem.tolerance):
                break
        return nominal, best

    # ---- samples --------------------------------------------------------------------------------------------------------------------------

    def robust(self, nominal: Found) -> Found:
        """Minimises the mean square error, or the worst-case error, over the samples, starting from the nominal plan."""
        from scipy.optimize import least_squares
        problem, freedom = self.problem, nominal.freedom
        rehearsals, obstacles, n = self.all_rehearsals(), len(problem.obstacles), len(nominal.x) + 1
        every = [*(variable.name for variable in freedom.variables), "depth"]    # the last component of z is the depth in mm
        kept: dict[bytes, tuple[Array, Array]] = {}
        outcomes: dict[bytes, tuple[Outcome | None, Array]] = {}    # nominal outcome, and the clearances

        def evaluate(z: Array, most: float = math.inf, order: Sequence[int] = range(len(rehearsals))) -> tuple[Array, Array]:
            """Returns the errors (samples, 3), and actual minus desired clearances (samples, obstacles), in UNITs. Simulates the samples in the given order
            and stops once an error exceeds `most`; rows that were not simulated are NaN."""
            key = z.tobytes()
            if key not in kept:
                aim = freedom.aim(z[:-1])
                errors, free = np.full((len(rehearsals), 3), np.nan), np.full((len(rehearsals), obstacles), np.nan)
                outcomes[key] = None, np.zeros(obstacles)
                for i in order:
                    rehearsal = rehearsals[i]
                    try:
                        outcome = rehearsal.at(aim, 1e-3 * z[-1], self.target)
                        clearances = self.clearances(outcome)
                        errors[i], free[i] = outcome.error / UNIT, [(there - o.clearance - MARGIN) / UNIT for o, there in zip(problem.obstacles, clearances)]
                        if i == 0:
                            outcomes[key] = outcome, np.array(clearances)
                    except Error as error:
                        if error.status in ("no memory", "system"):
                            raise
                        errors[i], free[i] = FAILED / UNIT, -FAILED / UNIT
                    if np.linalg.norm(errors[i]) > most:
                        return errors, free
                kept[key] = errors, free
            return kept[key]

        def slopes(z: Array, names: Sequence[str]) -> tuple[Array, Array]:
            """Returns the derivatives of `evaluate`, with the variables along the last axis: by finite differences for the named variables, and otherwise on
            the assumption that the needle keeps its shape."""
            (errors, free), x = evaluate(z), z[:-1]
            errors_, free_ = np.zeros((*errors.shape, n)), np.zeros((*free.shape, n))
            outcome, clearances = outcomes[z.tobytes()]
            errors_[:, :, -1] = 1e-3 * freedom.aim(x).direction / UNIT
            for i, name in enumerate(every):
                (there, step) = freedom.stepped(x, i, LONGER if name in names else 1.0) if i < n - 1 else (x, 0.2)
                if name in names:
                    other = evaluate(np.append(there, z[-1] + (step if i == n - 1 else 0.0)))
                    errors_[:, :, i], free_[:, :, i] = (other[0] - errors) / step, (other[1] - free) / step
                elif i < n - 1 and outcome is not None:
                    moved = freedom.carried(x, there, outcome)
                    errors_[:, :, i] = (moved.shaft[-1] - outcome.shaft[-1]) / UNIT / step
                    free_[:, :, i] = (np.array(self.clearances(moved)) - clearances) / UNIT / step
            return errors_, free_

        start = np.append(nominal.x, 1e3 * nominal.depth)
        inner = np.clip(start, np.append(freedom.low + 1e-6, -np.inf), np.append(freedom.high - 1e-6, np.inf))
        low, high = np.append(freedom.low, start[-1] - 10.0), np.append(freedom.high, start[-1] + 10.0)
        share = 1.0 / math.sqrt(len(rehearsals))

        def residual(z: Array) -> Array:
            errors, free = evaluate(z)
            return np.concatenate([share * errors.ravel(), np.minimum(free, 0.0).ravel(), STAY * (z - start)])

        def jacobian(z: Array) -> Array:
            (_, free), (errors_, free_) = evaluate(z), slopes(z, every)
            return np.concatenate([share * errors_.reshape(-1, n), np.where(free < 0.0, 1.0, 0.0).reshape(-1, 1) * free_.reshape(-1, n), STAY * np.eye(n)])

        if problem.objective == "worst":
            self._worst(inner, low, high, evaluate, slopes)
        else:
            least_squares(residual, inner, jacobian, bounds=(low, high), x_scale=1.0, xtol=1e-4, ftol=1e-5, gtol=1e-6, max_nfev=12)

        mean_square = lambda errors: math.sqrt(np.mean(np.sum(errors ** 2, axis=1)))
        measure = mean_square if problem.objective == "mean" else (lambda errors: np.linalg.norm(errors, axis=1).max())
        short = lambda free: float(np.maximum(-free, 0.0).max(initial=0.0))
        inside = [np.frombuffer(key) for key in kept if np.all(np.frombuffer(key) >= low - 1e-12) and np.all(np.frombuffer(key) <= high + 1e-12)]
        z = min(inside, key=lambda z: (round(max(short(evaluate(z)[1]) - ROUNDING / UNIT, 0.0), 1), measure(evaluate(z)[0])))
        errors, free = evaluate(z)
        aim = freedom.aim(z[:-1])
        if aim.turn and aim.turn.depth > 1e-3 * z[-1] - LAST:
            aim = aim._replace(turn=None)
        return Found(aim, 1e-3 * float(z[-1]), UNIT * float(measure(errors)), UNIT * short(free), freedom.at_limits(z[:-1]), z[:-1], freedom)

    def _worst(self, start: Array, low: Array, high: Array, evaluate: Callable, slopes: Callable) -> None:
        """Minimises the worst-case error by a trust-region method whose steps are optimal for the linearised errors and clearances (Madsen, Journal of the
        Institute of Mathematics and its Applications 16, 1975, 321-328; here with SciPy's SLSQP). As in `search`, the slopes of the errors are updated from
        the points tried. The result is not returned: `evaluate` records every point that was simulated in all samples."""
        def merit(values: tuple[Array, Array]) -> float:
            return float(np.linalg.norm(values[0], axis=1).max() + TOO_NEAR * np.maximum(-values[1], 0.0).max(initial=0.0))

        z, passes, radius = start, 0, 0.0
        for _ in range(PASSES * STEPS):
            errors, free = here = evaluate(z)
            if radius < SMALLEST:
                if passes == PASSES:
                    break
                (errors_, free_), radius, passes = slopes(z, BENDING), RADIUS, passes + 1
            step, predicted = _linear_step(errors, free.ravel(), errors_, free_.reshape(free.size, len(z)), np.maximum(low - z, -radius), np.minimum(high - z, radius))
            gain = merit(here) - predicted
            if gain < ENOUGH:
                radius = 0.0
                continue
            # Simulate the likely worst sample first: if the step is too long for that one, the others need not be simulated.
            there = evaluate(z + step, merit(here), np.argsort(-np.linalg.norm(errors + errors_ @ step, axis=1), kind="stable"))
            missed = there[0] - errors - errors_ @ step
            known = np.isfinite(missed[:, 0])
            missed[~known] = missed[known].mean(axis=0)
            if np.abs(missed).max() < JUMP:
                errors_ = errors_ + missed[:, :, None] * step / (step @ step)
            ratio = (merit(here) - merit(there)) / gain if known.all() else -1.0
            if ratio > 0.75:
                radius *= 2.0
            elif ratio < 0.25:
                radius = 0.4 * min(radius, float(np.abs(step).max()))
            if ratio > 0.05:
                z = z + step
                free_ = slopes(z, ())[1]


def _linear_step(errors: Array, free: Array, errors_: Array, free_: Array, low: Array, high: Array) -> tuple[Array, float]:
    """For the linearised problem, finds the step between `low` and `high` that minimises the largest error plus the weighted largest shortfall. errors
    (samples, 3) and free (m,) are the current values, errors_ (samples, 3, n) and free_ (m, n) their slopes. Returns the step and the minimum."""
    from scipy.optimize import minimize
    n, m = len(low), len(free)

    def constraints(y: Array) -> Array:    # y is the step, followed by the bounds on the errors and on the shortfalls
        there = errors + errors_ @ y[:n]
        return np.concatenate([y[n] - np.sqrt(np.sum(there ** 2, axis=1) + 1e-4), free + free_ @ y[:n] + y[n + 1]])

    def gradients(y: Array) -> Array:
        there = errors + errors_ @ y[:n]
        of_errors = -np.einsum("si,sin->sn", there, errors_) / np.sqrt(np.sum(there ** 2, axis=1) + 1e-4)[:, None]
        return np.block([[of_errors, np.ones((len(errors), 1)), np.zeros((len(errors), 1))], [free_, np.zeros((m, 1)), np.ones((m, 1))]])

    first = np.concatenate([np.zeros(n), [np.linalg.norm(errors, axis=1).max() + 0.01, np.maximum(-free, 0.0).max(initial=0.0)]])
    weights = np.concatenate([np.zeros(n), [1.0, TOO_NEAR]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)    # SLSQP exceeds the limits by rounding errors and warns about it
        found = minimize(lambda y: weights @ y, first, jac=lambda y: weights, method="SLSQP", bounds=[*zip(low, high), (0.0, None), (0.0, None)],
                         constraints={"type": "ineq", "fun": constraints, "jac": gradients}, options={"maxiter": 100, "ftol": 1e-5})
    step = np.clip(found.x[:n], low, high)
    value = np.linalg.norm(errors + errors_ @ step, axis=1).max() + TOO_NEAR * np.maximum(-(free + free_ @ step), 0.0).max(initial=0.0)
    return step, float(value)
