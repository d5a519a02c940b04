"""The quantities that a study can record, either over the whole motion or at one instant."""
from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Callable, NamedTuple

import numpy as np
import numpy.typing as npt

from .. import Event, Model, Scene, Sim
from .._locate import locate
from ..motion import axis_of, multiply
from ..brachy.plan import Plan

Array = npt.NDArray[np.float64]


@dataclass
class Recording:
    """The data collected so far in a run."""

    sim: Sim
    scene: Scene
    dt: float                        # s
    plan: Plan | None
    poses: list[Array] = field(default_factory=list)         # arrays of shape (n, 7)
    outputs: list[npt.NDArray[Any]] = field(default_factory=list)  # (n,) each
    moves: Any = None                # the motion in this simulation, as returned by its `moves`
    _field: Array | None = None

    def all(self, name: str) -> npt.NDArray[Any]:
        """Returns one output field for all ticks so far."""
        return np.concatenate([part[name] for part in self.outputs])

    def path(self) -> Array:
        return np.concatenate(self.poses)

    def moved(self) -> None:
        self._field = None

    def displacements(self) -> Array:
        if self._field is None:
            self._field = self.sim.displacements()
        return self._field


class Quantity(NamedTuple):
    """A quantity that a study can record. parts: names of its components, ("",) if it is a single number. instant: true if it is taken at one time, false
    if over the whole motion. option: the key that it needs besides `at`: "membrane", "region" or "target" (a point)."""

    unit: str
    parts: tuple[str, ...]
    instant: bool
    option: str
    measure: Callable[[Recording, Any], list[float]]
    doc: str
    of_plan: bool = False
    of_operator: bool = False


def _against_pushing(r: Recording) -> Array:
    return -np.sum(r.all("force") * axis_of(r.path()), axis=1)


def _peak_force(r: Recording, _: Any) -> list[float]:
    return [float(_against_pushing(r).max())]


def _peak_lateral_force(r: Recording, _: Any) -> list[float]:
    axis, force = axis_of(r.path()), r.all("force")
    return [float(np.linalg.norm(force - np.sum(force * axis, axis=1)[:, None] * axis, axis=1).max())]


def _work(r: Recording, _: Any) -> list[float]:
    """Integrates the work done by the hand with the trapezoidal rule. While the hand moves from one needle to the next, it feels no force."""
    poses, force, torque = r.path(), r.all("force"), r.all("torque")
    turned = multiply(poses[1:, 3:], poses[:-1, 3:] * np.array([1.0, -1.0, -1.0, -1.0]))
    angle = 2.0 * turned[:, 1:] * np.sign(turned[:, :1])    # small-angle approximation
    return [-0.5 * float(np.sum((force[1:] + force[:-1]) * np.diff(poses[:, :3], axis=0)) + np.sum((torque[1:] + torque[:-1]) * angle))]


def _at_puncture(r: Recording, membrane: str) -> int | None:
    """Returns the tick in which the membrane was first punctured, or None."""
    index = r.scene.names("membranes").index(membrane)
    ticks = np.flatnonzero((r.all("events") & int(Event.PUNCTURED) != 0) & (r.all("membrane") == index))
    return int(ticks[0]) if len(ticks) else None


def _puncture_force(r: Recording, membrane: str) -> list[float]:
    tick = _at_puncture(r, membrane)
    return [float("nan") if tick is None else float(_against_pushing(r)[: tick + 1].max())]


def _puncture_depth(r: Recording, membrane: str) -> list[float]:
    tick = _at_puncture(r, membrane)
    return [float("nan") if tick is None else float(r.all("depth")[tick])]


def _tip_error(r: Recording, _: Any) -> list[float]:
    pose = r.poses[-1][-1]
    straight = pose[:3] + r.sim.model.needle_length * axis_of(pose)
    return [float(np.linalg.norm(r.sim.centreline()[-1] - straight))]


def _target_error(r: Recording, target: Array) -> list[float]:
    return [float(np.linalg.norm(r.sim.centreline()[-1] - displaced(r.sim.model, target, r.displacements())))]


def displaced(model: Model, point: npt.ArrayLike, displacements: Array) -> Array:
    """Returns the current position (3,) m of the material point whose rest position (m) is `point`. Raises ValueError if it is outside the tissue."""
    (tet,), (weights,) = locate(model, [point])
    if tet < 0:
        raise ValueError("not in the tissue at rest")
    return np.asarray(point) + weights @ displacements[model.tets[tet]]


def _shift(r: Recording, region: str) -> list[float]:
    """Returns the mean displacement vector of the region's nodes as x, y, z, and its length (m)."""
    model = r.sim.model
    nodes = np.unique(model.tets_of(region))
    mean = r.displacements()[nodes].mean(axis=0)
    return [*mean.tolist(), float(np.linalg.norm(mean))]


def _seed_error(r: Recording, _: Any) -> list[float]:
    from ..brachy import plan as plans
    model = r.sim.model
    rows = [row for row in plans.compare(r.plan, model, plans.seeds_of(r.sim)) if row.offset is not None]
    distances = [1e-3 * float(np.linalg.norm(row.offset)) for row in rows]    # offsets are in mm
    return [float(np.mean(distances)), max(distances)] if distances else [float("nan")] * 2


SEED_PARTS = ("total", "tissue", "image", "splay", "remainder")


def _seed_parts(r: Recording, _: Any) -> list[float]:
    """Returns the mean magnitudes (m) of each part of the misplacement, along and across the needle."""
    errors = r.moves.errors()
    mean = lambda values: float(np.mean(values)) if errors else float("nan")
    return [number for part in SEED_PARTS for number in (mean([abs(e.along(part)) for e in errors]), mean([e.across(part) for e in errors]))]


def _buckled(_: Recording, __: Any) -> list[float]:
    return [0.0]


QUANTITIES = {
    "peak_force": Quantity("N", ("",), False, "", _peak_force, "largest force opposing insertion, along the needle's axis"),
    "peak_lateral_force": Quantity("N", ("",), False, "", _peak_lateral_force, "largest force across the needle's axis"),
    "work": Quantity("J", ("",), False, "", _work, "work of the hand"),
    "greatest_depth": Quantity("m", ("",), False, "", lambda r, _: [float(r.all("depth").max())], "longest track in the tissue"),
    "puncture_force": Quantity("N", ("",), False, "membrane", _puncture_force, "largest force opposing insertion until this membrane is punctured"),
    "puncture_depth": Quantity("m", ("",), False, "membrane", _puncture_depth, "length of the track when this membrane is punctured"),
    "buckled": Quantity("s", ("",), False, "", _buckled, "always 0: a needle that buckles still bears force"),
    "force": Quantity("N", ("",), True, "", lambda r, _: [float(-r.outputs[-1]["force"][-1] @ axis_of(r.poses[-1][-1]))],
                      "force opposing insertion, along the needle's axis"),
    "depth": Quantity("m", ("",), True, "", lambda r, _: [float(r.outputs[-1]["depth"][-1])], "length of the track"),
    "tip": Quantity("m", ("x", "y", "z"), True, "", lambda r, _: r.sim.centreline()[-1].tolist(), "position of the tip"),
    "tip_error": Quantity("m", ("",), True, "", _tip_error, "distance from the tip to where a rigid needle's tip would be"),
    "target_error": Quantity("m", ("",), True, "target", _target_error, "distance from the tip to this point of the tissue, which moves with it"),
    "shift": Quantity("m", ("x", "y", "z", "length"), True, "region", _shift, "mean displacement of the nodes of this region and its parts"),
    "needle_energy": Quantity("J", ("",), True, "", lambda r, _: [r.sim.needle_energy()], "elastic energy of the bent needle"),
    "seed_error": Quantity("m", ("mean", "worst"), True, "", _seed_error, "distance of the seeds, in the tissue at rest, from their planned positions", True),
    "seed_parts": Quantity("m", tuple(f"{part}_{way}" for part in SEED_PARTS for way in ("along", "across")), False, "", _seed_parts,
                           "mean magnitude of the parts of the seeds' misplacement, along and across the needle: tissue, image, splay and remainder", True, True),
}
