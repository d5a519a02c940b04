"""The motion that carries out an implant plan. `trocar.motion` explains what a motion is."""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Iterator

import numpy as np

from .. import Sim
from ..motion import Array, _Motion, exponential, multiply, towards
from . import plan as plans

__all__ = ["Implant"]


@dataclass(frozen=True)
class Implant(_Motion):
    """Carries out an implant plan one needle at a time: inserts the needle at `speed` (m/s), turns it if the plan says so, drops its seeds while
    withdrawing it, and removes it."""

    plan: plans.Plan | None = None
    speed: float = 0.08
    settle: float = 0.05      # s, pause before dropping a seed, or at full depth if the needle has no seeds
    outside: float = 0.02     # m, each needle starts and ends this far outside the template face or entry point
    turning: float = 2.0 * math.pi    # rad/s, how fast the needle is turned

    adjustable = ("speed", "roll")

    def duration(self) -> None:
        return None

    def _pose(self, axis: tuple[Array, Array], depths: Array, roll: float | Array, length: float) -> Array:
        """Returns poses (n, 7) that put the tip at depths (n,) m along an axis (a point and a direction), with the needle rolled by `roll` (rad)."""
        point, direction = axis
        turned = multiply(towards(direction), exponential(np.multiply.outer(np.broadcast_to(roll, depths.shape), [0.0, 0.0, 1.0])))
        return np.concatenate([point + (depths[:, None] - length) * direction, turned], axis=1)

    def _go(self, axis: tuple[Array, Array], start: float, end: float, roll: float, length: float, dt: float) -> Array:
        """Returns poses that move the tip from depth `start` to depth `end` (m), not including the first."""
        steps = max(math.ceil(abs(end - start) / (self.speed * dt)), 1)
        return self._pose(axis, np.linspace(start, end, steps + 1)[1:], roll, length)

    def insert(self, sim: Sim, needle: plans.Needle, dt: float) -> Iterator[Array]:
        """Resets the needle outside the tissue and yields the poses that insert it, until it rests at its planned depth."""
        axis, length = plans.needle_axis(self.plan, needle, sim.model), sim.model.needle_length
        roll, at = needle.roll + self.adjustment.roll, -self.outside
        sim.reset(self._go(axis, at, at, roll, length, dt)[0])
        if needle.turn:
            yield self._go(axis, at, needle.turn.depth, roll, length, dt)
            at = needle.turn.depth
            steps = max(math.ceil(abs(needle.turn.by) / (self.turning * dt)), 1)
            yield self._pose(axis, np.full(steps, at), roll + np.linspace(0.0, needle.turn.by, steps + 1)[1:], length)
            roll += needle.turn.by
        yield self._go(axis, at, needle.depth, roll, length, dt)
        yield np.tile(self._go(axis, needle.depth, needle.depth, roll, length, dt), (round(self.settle / dt), 1))

    def play(self, sim: Sim, dt: float) -> Iterator[Array]:
        plan, half, length = self.plan, 0.5 * sim.model.seed_size.length, sim.model.needle_length
        plans.check(plan, sim.model)
        for needle in plan.needles:
            axis = plans.needle_axis(plan, needle, sim.model)
            roll = needle.roll + self.adjustment.roll + (needle.turn.by if needle.turn else 0.0)
            go = lambda start, end: self._go(axis, start, end, roll, length, dt)
            yield from self.insert(sim, needle, dt)
            tip = needle.depth
            for behind in needle.seeds:
                target = needle.depth - (behind - half)    # tip depth at which to drop the seed
                if target != tip:
                    yield go(tip, target)
                    yield np.tile(go(target, target), (round(self.settle / dt), 1))
                sim.drop_seeds()
                tip = target
                while sim.pending_seeds():    # draw the needle back until the seed is in the tissue
                    yield go(tip, tip - 0.5e-3)
                    tip -= 0.5e-3
            yield go(tip, -self.outside)
