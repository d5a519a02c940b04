"""Scores a recorded run. This is the only implementation, used by both trocar-score and trocar-view."""
from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Iterator, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import brachy
from .._locate import distance, locate
from ..brachy import plan as plans
from ..brachy.evaluation import source_of
from ._measures import MEASURES
from ._recording import Recording, Sighting
from ._task import Criterion, Target, Task

Array = npt.NDArray[np.float64]

ENTERED = 2e-3     # m, at this depth a needle counts as having entered the tissue; anything less is just a touch of the skin
TURN = 5e-3        # m, a redirection means drawing the needle back by at least this much and then advancing it by at least as much
TAKEN = 5e-3       # m: a track that is already longer than this when it appears belongs to a needle that was resting in the tissue
DEEPEST = 5e-4     # m, a needle counts as being at its deepest within this distance of its greatest depth
SAMPLE = 1e-3      # m, spacing along a path at which to look up the region
TOUCH = 5e-4       # m, a needle has touched a surface if its path comes this close to it
RECTUM = 2e-6      # m^3, volume for the rectum's D2cc

__all__ = ["MEASURES", "Histogram", "Judgement", "Result", "score"]


class Judgement(NamedTuple):
    """The result of applying a criterion to a run."""

    criterion: Criterion
    value: float | None
    met: bool


class Reached(NamedTuple):
    """How close a needle came to a target."""

    target: Target
    error: float | None      # m; None if no needle entered the tissue
    tip: Array | None        # (3,) m, the target's position at rest plus the vector from the displaced target to the tip


class Histogram(NamedTuple):
    """Dose-volume histograms of an organ, as planned and as achieved."""

    role: str
    planned: brachy.DVH
    achieved: brachy.DVH


@dataclass
class Extremes:
    """Detects redirections: tracks a needle's greatest depth (m) and, once it has been drawn back by TURN, its smallest depth since then."""

    high: float = 0.0
    low: float | None = None

    def turned(self, depth: float) -> bool:
        """Takes the next depth. Returns True if it completes a redirection."""
        if self.low is None:
            self.high = max(self.high, depth)
            self.low = depth if depth <= self.high - TURN else None
            return False
        self.low = min(self.low, depth)
        if depth < self.low + TURN:
            return False
        self.high, self.low = depth, None
        return True


@dataclass
class Result:
    """The score of a run. Values are in SI units, Gy or fractions, or None if they cannot be determined."""

    task: Task
    began: int                        # time of the first wrench, us since the epoch
    measures: dict[str, float | None]
    reached: list[Reached]
    seeds: list[plans.Misplacement]
    organs: dict[str, float]          # for each region that needles entered, the total path length inside it, m
    touched: list[str]                # surfaces to be avoided that needles touched
    judgements: list[Judgement]
    paths: list[Array]                # (n, 3) m each, in the tissue at rest
    forces: tuple[Array, Array]       # (n,) s after the first contact, and (n,) N
    histograms: list[Histogram]
    lost: int                         # wrenches missing from the recording: see Recording
    ticks: int

    @property
    def passed(self) -> bool:
        """Whether all criteria are met."""
        return all(judgement.met for judgement in self.judgements)


def score(task: Task, log: str | PathLike[str]) -> Result:
    """Scores a run. The log must contain the channels TROCAR_WRENCH, TROCAR_DEFORMATION, TROCAR_CONTACTS, TROCAR_TRACKS and TROCAR_SEEDS, and
    TROCAR_PROBE_WRENCH if the scene has a probe. Raises BadRecording."""
    model = task.model
    gland = task.tets_of("gland")
    nodes = np.unique(gland if len(gland) else model.tets)
    recording = Recording(log, model, nodes, np.reshape([target.position for target in task.targets], (-1, 3)))
    reached = [_reached(target, i, recording) for i, target in enumerate(task.targets)]
    organs, touched = _organs(task, recording.paths), _touched(task, recording.paths)
    forces, counts = _forces(recording), _passes(recording)
    measures: dict[str, float | None] = {
        **counts, "path": float(sum(np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in recording.paths)),
        "time": float(forces[0][-1]) if len(forces[0]) else None, "force": float(forces[1].max()) if len(forces[1]) else None,
        "displacement": recording.displacement}
    if task.targets:
        measures["tip_error"] = None if any(r.error is None for r in reached) else max(r.error for r in reached)
    if task.avoid:
        measures["organs_touched"] = sum(name in organs or name in touched for name in task.avoid)
    if recording.probe_force is not None:
        measures["probe_force"] = recording.probe_force
    seeds = plans.compare(task.plan, model, plans.seeds_of_message(recording.seeds, model)) if task.plan else []
    measures.update(_misplacement(seeds) if task.plan else {})
    histograms = _histograms(task, recording)
    measures.update(_doses(task, histograms))
    measures = {name: measures[name] for name in MEASURES if name in measures}
    judgements = [Judgement(c, measures.get(c.measure), c.met(measures.get(c.measure))) for c in task.criteria]
    return Result(task, int(recording.wrenches["utime"][0]), measures, reached, seeds, organs, touched, judgements, recording.paths, forces, histograms, recording.lost,
                  recording.ticks)


# ---- needles ------------------------------------------------------------------------------------------------------------------------------


def _reached(target: Target, number: int, recording: Recording) -> Reached:
    """Returns how close a needle came to a target, as seen in an image: the smallest distance in the frames in which the needle was at its deepest. A needle
    that passes through the target and goes on does not reach it."""
    best: Array | None = None
    for needle in sorted({sighting.needle for sighting in recording.sightings}):
        for visit in _visits([sighting for sighting in recording.sightings if sighting.needle == needle]):
            deepest = max(sighting.depth for sighting in visit)
            for offset in (sighting.offsets[number] for sighting in visit if sighting.depth >= deepest - DEEPEST):
                if best is None or np.linalg.norm(offset) < np.linalg.norm(best):
                    best = offset
    return Reached(target, None, None) if best is None else Reached(target, float(np.linalg.norm(best)), target.position + best)


def _visits(sightings: Sequence[Sighting]) -> list[list[Sighting]]:
    """Splits the sightings of a needle into those of its visits to the tissue."""
    visits: list[list[Sighting]] = [[]]
    for sighting in sightings:
        if sighting.depth >= ENTERED:
            visits[-1].append(sighting)
        elif visits[-1]:
            visits.append([])
    return [visit for visit in visits if visit]


def _segments(paths: Sequence[Array], step: float) -> Iterator[tuple[Array, Array, int]]:
    """Yields, for each segment of the paths, its start, the vector to its end, and the number of parts, at most `step` (m) long, to divide it into."""
    for path in paths:
        for start, end in zip(path[:-1], path[1:]):
            yield start, end - start, max(int(np.ceil(np.linalg.norm(end - start) / step)), 1)


def _organs(task: Task, paths: Sequence[Array]) -> dict[str, float]:
    """Returns, for each region that the paths enter, their total length (m) inside it."""
    found: dict[str, float] = {}
    for start, way, count in _segments(paths, SAMPLE):
        tets = locate(task.model, start + np.outer((np.arange(count) + 0.5) / count, way))[0]
        for region in task.model.tet_regions[tets[tets >= 0]]:
            name = task.model.groups[region]
            found[name] = found.get(name, 0.0) + float(np.linalg.norm(way)) / count
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def _touched(task: Task, paths: Sequence[Array]) -> list[str]:
    """Returns those surfaces to be avoided that a path touches. A needle that bone has stopped touches its surface."""
    points = [np.zeros((0, 3)), *(path[:1] for path in paths)]
    points += [start + np.outer(np.arange(1, count + 1) / count, way) for start, way, count in _segments(paths, TOUCH)]
    sampled, found = np.concatenate(points), []
    for name in (name for name in task.avoid if name in task.surfaces):
        triangles = task.model.nodes[task.model.surface(name)]
        low, high = triangles.min(axis=(0, 1)) - TOUCH, triangles.max(axis=(0, 1)) + TOUCH
        near = sampled[((sampled >= low) & (sampled <= high)).all(axis=1)]
        if len(near) and distance(near, triangles).min() <= TOUCH:
            found.append(name)
    return found


def _forces(recording: Recording) -> tuple[Array, Array]:
    """Returns the time (s after the first contact) and the force on the hand (N) for each tick in which a held needle is in the tissue."""
    w = recording.wrenches
    held = w[(w["session"] != 0) & (w["depth"] > 0.0)]
    held = held[np.argsort(held["tick"], kind="stable")]
    if not len(held):
        return np.zeros(0), np.zeros(0)
    return 1e-6 * (held["utime"] - held["utime"][0]).astype(np.float64), np.linalg.norm(held["raw_force"].astype(np.float64), axis=1)


def _stretches(depths: Array) -> list[Array]:
    """Splits a needle's depths wherever they are 0, which means that the needle is outside the tissue or not held."""
    inside = np.flatnonzero(depths > 0.0)
    return [depths[part] for part in np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1) if len(part)]


def _passes(recording: Recording) -> dict[str, float]:
    """Counts the entries and redirections of all needles from their track lengths. In the messages, the length is 0 while nobody holds the needle, and jumps
    to the depth at which the needle rested when somebody picks it up again."""
    passes = redirections = 0
    for needle in np.unique(recording.wrenches["needle"]):
        entered, extremes = False, Extremes()
        for depths in _stretches(recording.wrenches["depth"][recording.wrenches["needle"] == needle].astype(np.float64)):
            if depths.max() < ENTERED:
                continue
            if depths[0] < TAKEN or not entered:
                passes, entered, extremes = passes + 1, True, Extremes()
            redirections += sum(extremes.turned(depth) for depth in depths.tolist())
    return {"passes": passes, "redirections": redirections}


# ---- seeds and dose -----------------------------------------------------------------------------------------------------------------------


def _misplacement(rows: Sequence[plans.Misplacement]) -> dict[str, float | None]:
    errors = [1e-3 * float(np.linalg.norm(row.offset)) for row in rows if row.offset is not None]
    return {"seed_error": float(np.mean(errors)) if errors else None, "seed_error_largest": max(errors) if errors else None,
            "seeds_missing": sum(row.placed is None for row in rows), "seeds_extra": sum(row.planned is None for row in rows)}


def _within(points: Array, others: Array) -> Array:
    """Returns the points that lie in the bounding box of `others`. Used to select the prostatic urethra."""
    return points[((points >= others.min(axis=0)) & (points <= others.max(axis=0))).all(axis=1)]


def _histograms(task: Task, recording: Recording) -> list[Histogram]:
    """Computes the dose-volume histograms of the task's organs in the tissue at rest. Empty if the plan has no source or prescription."""
    plan = task.plan
    if not plan or not plan.source or not plan.prescription:
        return []
    source = source_of(plan)
    planned, found = plans.planned_seeds(plan, task.model), []
    placed = list(zip(recording.seeds.rest, recording.seeds.rest_direction))
    voxels = {role: [brachy.Structure.from_region(task.model, name) for name in names] for role, names in task.organs.items()}
    for role, parts in voxels.items():
        points, voxel, made = np.concatenate([part.points for part in parts]), parts[0].voxel, []
        if role == "urethra" and "gland" in voxels:
            points = _within(points, np.concatenate([part.points for part in voxels["gland"]]))
        for seeds in ([(s.position, s.direction) for s in planned], placed):
            dose = brachy.Dose.at(source, points)
            for position, direction in seeds:
                dose.add(position, direction, plan.source.strength)
            made.append(brachy.DVH(dose.values, voxel))
        found.append(Histogram(role, *made))
    return found


def _doses(task: Task, histograms: Sequence[Histogram]) -> dict[str, float]:
    found: dict[str, float] = {}
    for role, _, dvh in histograms:
        if role == "gland":
            found.update(D90=dvh.dose(0.9), V100=dvh.volume(task.plan.prescription), V150=dvh.volume(1.5 * task.plan.prescription))
        elif role == "rectum":
            found["rectum_D2cc"] = dvh.dose(min(RECTUM / (dvh.voxel * len(dvh.doses)), 1.0))
        else:
            found["urethra_D10"] = dvh.dose(0.1)
    return found
