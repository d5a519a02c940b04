"""Simulates insertions for planning, to find out where the tip ends up and how the tissue is displaced. What several insertions have in common is
simulated only once: they continue from a saved state."""
from __future__ import annotations

import math
from collections import OrderedDict
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .. import Model, Sim
from .._locate import locate
from ..brachy.implant import Implant
from ..motion import exponential, multiply, towards
from ..brachy.plan import Turn

Array = npt.NDArray[np.float64]

BACK = 4e-3        # m, save the state this far short of the desired depth, so that insertions to other depths can continue from it
BEFORE_TURN = 6e-3    # m, save the state this far short of a turn, so that insertions with other turns can continue from it
STATES = 6         # maximum number of saved states
ROUNDS = 8         # maximum number of iterations in the depth search
EXACT = 2e-6       # m, tolerance of the depth search
FARTHEST = 6e-3    # m, largest step in the depth search


class Aim(NamedTuple):
    """Everything that defines an insertion except its depth."""

    point: Array        # (3,) m, point from which depths are measured
    direction: Array    # (3,) unit vector
    roll: float = 0.0   # rad
    turn: Turn | None = None


class Outcome(NamedTuple):
    """The end of an insertion: the needle at rest at its final depth, and the displaced tissue."""

    depth: float
    error: Array        # (3,) m, vector from the displaced target to the tip
    shaft: Array        # (joints, 3) m, positions of the needle's joints from base to tip
    field: Array        # (nodes, 3) m, displacements of the mesh's nodes

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.error))


class Target:
    """A material point of the tissue, given by its position at rest."""

    def __init__(self, point: npt.ArrayLike, model: Model):
        """Raises ValueError if the point is outside the tissue."""
        self.point = np.asarray(point, np.float64)
        (tet,), (self._weights,) = locate(model, [self.point])
        if tet < 0:
            raise ValueError("not in the tissue at rest")
        self._nodes = model.tets[tet]

    def displaced(self, field: Array) -> Array:
        return self.point + self._weights @ field[self._nodes]


def depth_of(aim: Aim, target: Target) -> float:
    """Returns the depth (m) at which a rigid needle's tip would be closest to the target in tissue at rest."""
    return float((target.point - aim.point) @ aim.direction)


class Rehearsal:
    """Simulates insertions in one model."""

    def __init__(self, model: Model, hand: Implant):
        self.model, self._hand, self._sim, self._dt = model, hand, Sim(model), 1.0 / model.rate_hz
        self._step = hand.speed * self._dt
        self._saved: OrderedDict[bytes, tuple[int, bytes]] = OrderedDict()
        self.runs = 0         # number of insertions simulated so far
        self.ticks = 0        # number of ticks simulated so far

    # Each leg (before and after the turn) consists of full steps from its start and a shorter last step. States are saved only after full steps, so that
    # results do not depend on which saved states happen to be available.

    def _run(self, poses: Array) -> None:
        self._sim.run(poses, self._dt)
        self.ticks += len(poses)

    def _poses(self, aim: Aim, depths: Array, roll: Array | float) -> Array:
        turned = multiply(towards(aim.direction), exponential(np.multiply.outer(np.broadcast_to(roll, depths.shape), [0.0, 0.0, 1.0])))
        return np.concatenate([aim.point + (depths[:, None] - self.model.needle_length) * aim.direction, turned], axis=1)

    def _steps(self, start: float, depth: float) -> int:
        return max(math.floor((depth - start) / self._step + 1e-9), 0)

    def _leg(self, aim: Aim) -> tuple[bytes, float, float]:
        """Describes the last leg of an insertion: the key of its saved state, its start depth (m) and its roll (rad)."""
        numbers = np.array([*aim.point, *aim.direction, aim.roll, *(aim.turn or ())])
        return numbers.tobytes(), aim.turn.depth if aim.turn else -self._hand.outside, aim.roll + (aim.turn.by if aim.turn else 0.0)

    def _begin(self, aim: Aim) -> None:
        """Moves the needle to the start of the last leg."""
        if aim.turn is None:
            self._sim.reset(self._poses(aim, np.array([-self._hand.outside]), aim.roll)[0])
            return
        self._reach(aim._replace(turn=None), aim.turn.depth, BEFORE_TURN)
        count = max(math.ceil(abs(aim.turn.by) / (self._hand.turning * self._dt)), 1)
        self._run(self._poses(aim, np.full(count, aim.turn.depth), aim.roll + np.linspace(0.0, aim.turn.by, count + 1)[1:]))

    def _reach(self, aim: Aim, depth: float, back: float) -> None:
        """Moves the needle along the last leg to `depth` (m), saving the state `back` (m) short of it."""
        leg, start, roll = self._leg(aim)
        wanted, early = self._steps(start, depth), self._steps(start, depth - back)
        there = self._saved.get(leg)
        if there and there[0] <= wanted:
            self._saved.move_to_end(leg)
            self._sim.restore(there[1])
            done = there[0]
        else:
            self._begin(aim)
            done = 0
            if early > 0:
                self._run(self._poses(aim, start + self._step * np.arange(1, early + 1), roll))
                done = early
            self._saved[leg] = (done, self._sim.save())
            self._saved.move_to_end(leg)
            while len(self._saved) > STATES:
                self._saved.popitem(last=False)
        depths = start + self._step * np.arange(done + 1, wanted + 1)
        if depth - (start + self._step * wanted) > 1e-9:
            depths = np.append(depths, depth)
        if len(depths):
            self._run(self._poses(aim, depths, roll))

    def at(self, aim: Aim, depth: float, target: Target) -> Outcome:
        """Simulates the insertion to this depth (m). Raises Error."""
        if aim.turn and aim.turn.depth >= depth:
            aim = aim._replace(turn=None)
        self._reach(aim, depth, BACK)
        rest = round(self._hand.settle / self._dt)
        if rest:
            self._run(np.repeat(self._poses(aim, np.array([depth]), self._leg(aim)[2]), rest, axis=0))
        self.runs += 1
        field, shaft = self._sim.displacements(), self._sim.centreline()
        return Outcome(depth, shaft[-1] - target.displaced(field), shaft, field)

    def best(self, aim: Aim, target: Target, further: float = 0.0) -> Outcome:
        """Finds the depth at which the tip is level with the target, neither short of it nor past it, by the secant method, and returns the outcome there. If
        there is no such depth, for example because bone is in the way, returns the best outcome found. further: initial guess of how much deeper (m) this is
        than for a rigid needle. Raises Error."""
        most = self.model.needle_length - 1e-3
        depth = float(np.clip(depth_of(aim, target) + further, 1e-3, most))
        found: list[tuple[float, float, Outcome]] = []
        for _ in range(ROUNDS):
            outcome = self.at(aim, depth, target)
            along = float(outcome.error @ aim.direction)
            found.append((depth, along, outcome))
            if abs(along) < EXACT:
                break
            slope = 1.0
            if len(found) > 1 and found[-1][0] != found[-2][0]:
                slope = (along - found[-2][1]) / (depth - found[-2][0])
            nearest = float(np.clip(depth - np.clip(along / max(slope, 0.2), -FARTHEST, FARTHEST), 1e-3, most))
            if nearest == depth:
                break
            depth = nearest
        return min(found, key=lambda entry: abs(entry[1]))[2]


def carried_out(model: Model, plan: object, needle: object, hand: Implant, target: Target) -> Outcome:
    """Returns the outcome for a needle of a plan in a new simulation, with the needle moved exactly as when a plan is carried out. Raises Error."""
    from dataclasses import replace
    sim, dt = Sim(model), 1.0 / model.rate_hz
    for poses in replace(hand, plan=plan).insert(sim, needle, dt):
        sim.run(poses, dt)
    field, shaft = sim.displacements(), sim.centreline()
    return Outcome(needle.depth, shaft[-1] - target.displaced(field), shaft, field)
