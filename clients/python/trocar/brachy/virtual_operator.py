"""A virtual operator who carries out an implant plan: inserts and leaves all needles, then takes each again, drops its seeds while drawing it back, and pulls it
out. The library (trocar/operator.h) decides what the operator does, for this module and for `trocar-device --plan`; this module carries it out in a
simulation.

    >>> work = Operator(plan=plan, follows_image=True, seed=7).moves(sim, 0.001)
    >>> for needle, poses in work:
    ...     sim.run(poses, 0.001, needle)
    >>> for error in work.errors():
    ...     print(error.hole, error.number, 1e3 * error.along("total"))
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterator, NamedTuple, Sequence

import numpy as np

from .. import Sim
from .._library import _check, ffi, lib
from ..motion import Array, _Motion, exponential, minimum_jerk, multiply, towards
from . import plan as plans

__all__ = ["Implantation", "Operator", "SeedError"]


class SeedError(NamedTuple):
    """The misplacement of a seed in the tissue at rest, split into parts by cause. All vectors are (3,) m in mesh coordinates."""

    needle: int
    hole: str
    number: int        # number of the seed in its needle, 1 for the distal seed
    planned: Array     # planned centre
    axis: Array        # unit vector along the planned needle
    total: Array
    tissue: Array      # part due to displacement of the tissue that the operator did not correct
    image: Array       # part due to the image error
    splay: Array       # part due to the tilt of the needle

    @property
    def remainder(self) -> Array:
        """The part that the other parts do not explain."""
        return self.total - self.tissue - self.image - self.splay

    def along(self, part: str) -> float:
        """Returns the component of a part along the needle, m; positive if the seed is too deep."""
        return float(getattr(self, part) @ self.axis)

    def across(self, part: str) -> float:
        """Returns the magnitude of a part's component across the needle, m."""
        return float(np.linalg.norm(getattr(self, part) - self.along(part) * self.axis))


@dataclass(frozen=True)
class Operator(_Motion):
    """Carries out a plan. By default, the operator reads depths from the needle's marks at the template, and makes no errors. An operator who follows the image
    moves the tip to where an image of the displaced tissue shows each planned position. Errors and speeds are then as published, unless they are given."""

    plan: plans.Plan | None = None
    follows_image: bool = False
    stabilise: Sequence[str] = ()        # holes of needles without seeds, which are inserted first and removed last
    seed: float = 1                      # seed of the random numbers; a whole number
    speed: float | None = None           # m/s, mean speed of the hand's strokes
    image_error: float | None = None     # m, standard deviation of the image error along the needle, drawn once for each needle
    splay: float | None = None           # rad, standard deviation of the tilt about each axis across the needle
    speed_spread: float | None = None    # standard deviation of the logarithm of the needles' speeds
    settle: float = 0.3                  # s, rest before a needle that was taken up is moved

    adjustable = ("speed", "seed", "image_error", "splay", "speed_spread")

    def duration(self) -> None:
        return None

    def options(self) -> Any:
        chosen = ffi.new("trocar_operator_options *", lib.trocar_default_operator_options(self.follows_image))
        chosen.seed = int(self.seed)
        for name in ("speed", "image_error", "splay", "speed_spread"):
            if getattr(self, name) is not None:
                setattr(chosen, name, getattr(self, name))
        return chosen

    def needles(self) -> list[plans.Needle]:
        """Returns the needles of the plan, followed by the stabilising needles, which are as deep as the deepest needle of the plan. Raises BadPlan for a
        hole that does not exist or is taken."""
        deepest, needles = max(needle.depth for needle in self.plan.needles), list(self.plan.needles)
        for hole in self.stabilise:
            at = plans.hole_number(hole)
            if at is None or at[0] >= self.plan.columns or at[1] >= self.plan.rows:
                raise plans.BadPlan(f"{self.plan.path}: stabilise: the plan's template has no hole {hole}")
            if any(needle.hole == plans.hole_name(*at) for needle in needles):
                raise plans.BadPlan(f"{self.plan.path}: stabilise: hole {hole} is taken by another needle")
            needles.append(plans.Needle(plans.hole_name(*at), deepest, []))
        return needles

    def moves(self, sim: Sim, dt: float) -> Implantation:
        return Implantation(self, sim, dt)


class Implantation:
    """An operator at work in a simulation. Iterating yields (needle, poses) with poses (n, 7), one for every `dt` seconds; the caller steps the simulation
    through them before asking for the next. In between, needles are reset, left and taken, and seeds are dropped."""

    def __init__(self, operator: Operator, sim: Sim, dt: float) -> None:
        plans.check(operator.plan, sim.model)
        self.sim, self.dt, self.settle, self.plan = sim, dt, operator.settle, operator.plan
        self.needles = operator.needles()
        self._tips: list[Any] = []    # keeps alive the arrays that the library reads
        given = ffi.new("trocar_operator_needle[]", [self._needle(operator.plan, needle) for needle in self.needles])
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_operator **")
        _check(lib.trocar_operator_create(sim.model._handle, given, len(given), operator.options(), handle, why), why)
        self._handle = ffi.gc(handle[0], lib.trocar_operator_free)

    def _needle(self, plan: plans.Plan, needle: plans.Needle) -> dict[str, Any]:
        if needle.turn:
            raise plans.BadPlan(f"{plan.path}:{needle.line}: needle {needle.title}: a virtual operator does not turn needles during the insertion: remove \"turn\"")
        model = self.sim.model
        point, direction = plans.needle_axis(plan, needle, model)
        orientation = multiply(towards(direction), exponential([0.0, 0.0, needle.roll]))
        tips = ffi.new("double[]", [needle.depth - behind + 0.5 * model.seed_size.length for behind in needle.seeds] or [0.0])
        self._tips.append(tips)
        guide = [guide.name for guide in model.guides].index(plan.template) if needle.hole else -1
        return {"entry": {"position": point.tolist(), "orientation": orientation.tolist()}, "depth": needle.depth, "seeds": tips,
                "seed_count": len(needle.seeds), "guide": guide}

    def _base(self, needle: int, depth: float) -> Array:
        base = lib.trocar_operator_base(self._handle, needle, depth)
        return np.array([*base.position, *base.orientation])

    def _stroke(self, needle: int, start: float, end: float, duration: float, pause: float) -> Array:
        """Returns the poses that move the tip from one depth to another (m) with minimum jerk, followed by a rest; excludes the first pose."""
        steps = math.ceil(duration / self.dt - 1e-9)
        depths = start + (end - start) * minimum_jerk(np.linspace(0.0, 1.0, steps + 1)[1:])
        straight = np.concatenate([depths, np.full(round(pause / self.dt), end)])
        ends = self._base(needle, 0.0), self._base(needle, 1.0)
        poses = np.tile(ends[0], (len(straight), 1))
        poses[:, :3] += np.outer(straight, ends[1][:3] - ends[0][:3])
        return poses

    def _take(self, needle: int) -> float:
        self.sim.take(needle)
        base = self.sim.base(needle).tolist()
        return float(lib.trocar_operator_depth(self._handle, needle, ffi.new("trocar_pose *", {"position": base[:3], "orientation": base[3:]})))

    def __iter__(self) -> Iterator[tuple[int, Array]]:
        sim, depth, why = self.sim, 0.0, ffi.new("trocar_error *")
        sight, action = ffi.new("trocar_operator_sight *"), ffi.new("trocar_operator_action *")
        while True:
            field = sim.displacements()
            sight.depth, sight.displacements = depth, ffi.from_buffer("double[]", field)
            _check(lib.trocar_operator_next(self._handle, sight, action, why), why)
            needle, sight.refused = action.needle, 0
            if action.act == lib.TROCAR_OPERATOR_FINISHED:
                return
            if action.act == lib.TROCAR_OPERATOR_START:
                depth = action.depth
                sim.reset(self._base(needle, depth), needle)
            elif action.act == lib.TROCAR_OPERATOR_MOVE:
                poses = self._stroke(needle, depth, action.depth, action.duration, action.pause)
                depth = action.depth
                if len(poses):
                    yield needle, poses
            elif action.act == lib.TROCAR_OPERATOR_LEAVE:
                sim.leave(needle)
            elif action.act == lib.TROCAR_OPERATOR_TAKE:
                depth = self._take(needle)
                yield needle, self._stroke(needle, depth, depth, 0.0, self.settle)
            elif sim.pending_seeds(needle):
                sight.refused = 1
            else:
                sim.drop_seeds(needle=needle)

    def errors(self) -> list[SeedError]:
        """Returns the misplacement of the seeds that are in the tissue, in the order in which they were dropped."""
        found = ffi.new("trocar_operator_seed[]", lib.TROCAR_MAX_SEEDS)
        count = lib.trocar_operator_seeds(self._handle, found, lib.TROCAR_MAX_SEEDS)
        placed: dict[int, list[Array]] = {}
        for seed in self.sim.seeds():
            placed.setdefault(seed.needle, []).append(seed.position)
        errors, three = [], lambda vector: np.array(list(vector))
        for seed in found[0:count]:
            if placed.get(seed.needle):
                needle = self.needles[seed.needle]
                axis = plans.needle_axis(self.plan, needle, self.sim.model)[1]
                errors.append(SeedError(seed.needle, needle.hole, seed.number + 1, three(seed.planned), axis, placed[seed.needle].pop(0) - three(seed.planned),
                                        three(seed.tissue), three(seed.image), three(seed.splay)))
        return errors
