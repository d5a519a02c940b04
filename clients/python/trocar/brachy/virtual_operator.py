"""A virtual operator who carries out an implant plan. The operator inserts all needles and lets go of them, then takes hold of one needle after another, drops
its seeds while drawing it back, and pulls it out. The decisions are made in the library (trocar/operator.h), which `trocar-device --plan` also uses; this
module carries them out in a simulation.

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
    """A seed's misplacement in the tissue at rest, broken down by cause. All vectors are (3,) m in mesh coordinates."""

    needle: int
    hole: str
    number: int        # position of the seed in its needle, counted from 1 at the distal end
    planned: Array     # planned centre
    axis: Array        # unit vector along the planned needle
    total: Array
    tissue: Array      # part due to tissue displacement that the operator did not correct for
    image: Array       # part due to the image error
    splay: Array       # part due to the tilt of the needle

    @property
    def remainder(self) -> Array:
        """What is left after subtracting the parts with a known cause."""
        return self.total - self.tissue - self.image - self.splay

    def along(self, part: str) -> float:
        """Returns a part's component along the needle, m; positive if it makes the seed too deep."""
        return float(getattr(self, part) @ self.axis)

    def across(self, part: str) -> float:
        """Returns the magnitude of a part's component perpendicular to the needle, m."""
        return float(np.linalg.norm(getattr(self, part) - self.along(part) * self.axis))


@dataclass(frozen=True)
class Operator(_Motion):
    """Carries out a plan. By default, the operator reads the depth from the marks on the needle at the template, with no reading error. An operator who follows
    the image moves the tip to where an image of the displaced tissue shows each planned position; errors and speeds then default to published values."""

    plan: plans.Plan | None = None
    follows_image: bool = False
    strands: bool = False                # the seeds of each needle are a strand: only the first one is brought to its place
    stabilise: Sequence[str] = ()        # holes of the stabilising needles, which carry no seeds, go in first and come out last
    seed: float = 1                      # seed of the random numbers; a whole number
    speed: float | None = None           # m/s, mean speed of the hand's strokes
    image_error: float | None = None     # m, standard deviation of the image error along the needle, drawn once per needle
    splay: float | None = None           # rad, standard deviation of the needle's tilt about each of two perpendicular axes
    speed_spread: float | None = None    # standard deviation of the logarithm of the needles' speeds
    settle: float = 0.3                  # s, pause between picking up a needle and moving it

    adjustable = ("speed", "seed", "image_error", "splay", "speed_spread")

    def duration(self) -> None:
        return None

    def options(self) -> Any:
        chosen = ffi.new("trocar_operator_options *", lib.trocar_default_operator_options(self.follows_image))
        chosen.seed, chosen.strands = int(self.seed), self.strands
        for name in ("speed", "image_error", "splay", "speed_spread"):
            if getattr(self, name) is not None:
                setattr(chosen, name, getattr(self, name))
        return chosen

    def needles(self) -> list[plans.Needle]:
        """Returns the plan's needles, then the stabilising needles, which go as deep as the deepest needle in the plan. Raises BadPlan if the hole of a
        stabilising needle does not exist or is already used."""
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
    """An operator at work in a simulation. Iteration yields (needle, poses) with poses (n, 7), one every `dt` seconds; step the simulation through them before
    you ask for the next. In between, the iterator resets needles, lets go of them, takes hold of them again and drops seeds."""

    def __init__(self, operator: Operator, sim: Sim, dt: float) -> None:
        plans.check(operator.plan, sim.model)
        self.sim, self.dt, self.settle, self.plan = sim, dt, operator.settle, operator.plan
        self.needles = operator.needles()
        self._tips: list[Any] = []    # keeps arrays alive while the library refers to them
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
        """Returns the poses of a minimum-jerk stroke from tip depth `start` to `end` (m), without the first pose, followed by a pause (s)."""
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
                sim.drop_seeds(action.seeds, action.spacing, needle)

    def errors(self) -> list[SeedError]:
        """Returns the errors of the seeds that are in the tissue, in the order in which they were dropped."""
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
