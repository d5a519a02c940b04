"""Makes a plan: chooses template holes, and the seeds for the needle in each hole, so that the gland gets the prescribed dose and other organs are
spared.

Candidate seed positions lie on the hole axes, in planes 5 mm apart. A greedy search adds one seed at a time, always the one that lowers the cost most,
until no seed lowers it further. Then it goes through the seeds and moves each to its best position, or removes it, until that no longer lowers the
cost. The cost is the sum of penalties for overdose and underdose at sample points in the organs, plus a penalty for each needle. The search is
deterministic.

    >>> plan = make_plan(model, organs, source, strength=0.45, prescription=145)
"""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .. import Guide, Model
from .._locate import locate
from ._dose import Dose, Source
from ._goals import FIGURES, Figure
from ._obstacles import surface_points
from .organs import Organ
from .plan import BadPlan, Needle, Plan, hole_axis, hole_name
from .plan import Source as PlanSource

Array = npt.NDArray[np.float64]

__all__ = ["Weights", "make_plan"]

PLANES = 5e-3         # m, distance between seed planes: more than a seed's length, so that seeds cannot overlap
BESIDE = 1e-3         # m, a seed's centre may be at most this far from the nearest gland voxel
CLEAR = 3e-3          # m, needle axes stay this far from urethra and rectum voxels: half a voxel, the needle's radius and a margin
FROM_BONE = 3e-3      # m, needle axes stay this far from bone, to allow for the needle's radius, 1 mm of splay at the gland and tissue motion
SAMPLES = 1500        # maximum number of points per organ in the search
PATH = 2e-3           # m, spacing of the points at which a needle axis is tested for bone
LEAST_GAIN = 5e-4     # an exchange must lower the cost, which is of order 1, by at least this much
SWEEPS = 30           # maximum number of passes over all seeds; in practice fewer than ten are needed


@dataclass(frozen=True)
class Weights:
    """Weights and dose levels in the cost. Levels are fractions of the prescription; deviations are averaged over the organ's points. The values were tuned
    on the synthetic patient and the pelvis and only steer the search: a plan is judged by the limits in the report, not by its cost."""

    under: float = 30.0        # for gland points below `aim`
    aim: float = 1.15
    over: float = 0.5          # for gland points above `high`
    high: float = 1.5
    urethra: float = 5.0       # for urethra points above `spare`
    spare: float = 1.4
    rectum: float = 5.0        # for rectum points above `wall`, averaged over 2 cm^3
    wall: float = 0.8
    needle: float = 0.02       # for each needle

    @classmethod
    def for_goals(cls, goals: Sequence[Figure]) -> Weights:
        """Returns weights whose dose levels lie as far from the lower limit of D90 (`aim` and `high`), and from the upper limits of the urethra's D10 and the rectum's
        D2cc, as the default levels do from the default limits."""
        def shift(name: str, side: str) -> float:
            usual, limit = (next(getattr(figure, side) for figure in figures if figure.name == name) for figures in (FIGURES, goals))
            return 0.0 if limit is None else float(limit - usual)
        return cls(aim=cls.aim + shift("D90", "least"), high=cls.high + shift("D90", "least"), spare=cls.spare + shift("urethra D10", "most"), wall=cls.wall + shift("rectum D2cc", "most"))


@dataclass
class _Candidate:
    """A candidate position for a seed."""

    hole: str
    depth: float      # m, depth of its centre behind the template's face
    position: Array   # (3,) m


def _sample(points: Array, most: int) -> Array:
    """Returns at most `most` of the points, picked at even intervals."""
    return points[::max(-(-len(points) // most), 1)]


def _free(inside: npt.NDArray[np.bool_], way: Array, ends: npt.NDArray[np.bool_], depths: Array, half: float) -> npt.NDArray[np.bool_]:
    """For each of the depths (k,) m on a needle axis, returns whether a seed of this half-length centred there is in the tissue and can be reached without
    crossing bone. Bone shows up as a hole in the mesh. inside: whether the points at the ascending depths `way` are in the tissue; ends (2, k): whether the
    seeds' ends are."""
    if not inside.any():
        return np.zeros(len(depths), bool)
    first = int(np.argmax(inside))
    blocked = np.flatnonzero(~inside[first:])
    end = way[first + blocked[0]] if len(blocked) else np.inf
    return ends.all(axis=0) & (depths + half < end) & (depths - half > way[first])


def _candidates(model: Model, guide: Guide, organs: Mapping[str, Organ], bones: Sequence[str]) -> list[_Candidate]:
    from scipy.spatial import cKDTree
    gland, half = organs["gland"].points, 0.5 * model.seed_size.length
    along = (gland - guide.origin) @ guide.normal
    low, high = along.min() - BESIDE, along.max() + BESIDE
    count = max(int((high - low) / PLANES), 1)
    depths = 0.5 * (low + high) + PLANES * (np.arange(count) - 0.5 * (count - 1))
    trees = {role: cKDTree(organ.points) for role, organ in organs.items()}
    trees |= {f"surface {name}": cKDTree(surface_points(model, name, 1e-3)) for name in bones}
    keep_clear = [(tree, FROM_BONE if role not in organs else CLEAR) for role, tree in trees.items() if role != "gland"]
    way, seeds = np.arange(0.0, depths[-1] + half, PATH), depths + half < model.needle_length
    holes, near = [], []
    for hole in (hole_name(column, row) for column in range(guide.columns) for row in range(guide.rows)):
        face = hole_axis(guide, hole)
        beside = seeds & (trees["gland"].query(face + depths[:, None] * guide.normal)[0] <= BESIDE)
        line = face + way[way < depths[beside].max(initial=0.0) + half][:, None] * guide.normal
        if beside.any() and all(tree.query(line)[0].min() >= clearance for tree, clearance in keep_clear):
            holes.append((hole, face))
            near.append(beside)
    # one call for all points, because each call preprocesses the whole mesh
    along = np.concatenate([way, depths - half, depths + half])
    points = [face + along[:, None] * guide.normal for _, face in holes]
    inside = (locate(model, np.concatenate(points))[0] >= 0).reshape(len(holes), -1) if holes else []
    found = []
    for (hole, face), beside, there in zip(holes, near, inside):
        free = beside & _free(there[:len(way)], way, there[len(way):].reshape(2, -1), depths, half)
        found += [_Candidate(hole, float(depths[i]), face + depths[i] * guide.normal) for i in np.flatnonzero(free)]
    return found


class _Search:
    """State of the search: the dose of every candidate at the organs' points, as a fraction of the prescription, and the candidates chosen so far."""

    def __init__(self, candidates: list[_Candidate], organs: Mapping[str, Organ], doses: dict[str, Array], weights: Weights) -> None:
        self.doses, self.weights = doses, weights
        names = sorted({candidate.hole for candidate in candidates})
        self.hole = np.array([names.index(candidate.hole) for candidate in candidates])
        self.chosen = np.zeros(len(candidates), bool)
        self.used = np.zeros(len(names), int)
        self.total = {role: np.zeros(dose.shape[1], np.float32) for role, dose in doses.items()}
        self.wall_points = 2e-6 / organs["rectum"].volume * doses["rectum"].shape[1] if "rectum" in doses else 1.0    # number of points in 2 cm^3

    def cost(self, role: str, dose: Array) -> Array:
        """Returns the cost (...) of giving an organ the doses (..., points)."""
        w = self.weights
        if role == "gland":
            return w.under * np.maximum(w.aim - dose, 0.0).mean(axis=-1) + w.over * np.maximum(dose - w.high, 0.0).mean(axis=-1)
        if role == "urethra":
            return w.urethra * np.maximum(dose - w.spare, 0.0).mean(axis=-1)
        return w.rectum * np.maximum(dose - w.wall, 0.0).sum(axis=-1) / self.wall_points

    def now(self) -> float:
        return float(sum(self.cost(role, total) for role, total in self.total.items())) + self.weights.needle * float((self.used > 0).sum())

    def with_each(self, most_needles: int) -> Array:
        """Returns what the cost would be after adding each candidate: (candidates,). It is infinite if the candidate is already chosen or would need more
        than `most_needles` needles."""
        cost = sum(self.cost(role, total + self.doses[role]) for role, total in self.total.items())
        needles = (self.used > 0).sum() + (self.used[self.hole] == 0)
        return np.where(self.chosen | (needles > most_needles), np.inf, cost + self.weights.needle * needles)

    def put(self, i: int, times: int = 1) -> None:
        """Adds candidate i, or removes it if `times` is -1."""
        self.chosen[i] = times > 0
        self.used[self.hole[i]] += times
        for role in self.total:
            self.total[role] = self.total[role] + times * self.doses[role][i]

    def run(self, most_needles: int) -> None:
        while True:
            costs = self.with_each(most_needles)
            best = int(costs.argmin())
            if not costs[best] < self.now() - LEAST_GAIN:
                break
            self.put(best)
        for _ in range(SWEEPS):
            changed = False
            for i in np.flatnonzero(self.chosen):
                before = self.now()
                self.put(i, -1)
                without, costs = self.now(), self.with_each(most_needles)
                best = int(costs.argmin())
                if min(without, costs[best]) < before - LEAST_GAIN:
                    changed = True
                    if costs[best] < without:
                        self.put(best)
                else:
                    self.put(i)
            if not changed:
                break


def _doses(source: Source, candidates: list[_Candidate], axis: Array, strength: float, points: Array, prescription: float) -> Array:
    """Returns the dose (candidates, points) that each candidate alone gives the points, as a fraction of the prescription."""
    dose, rows = Dose.at(source, points), []
    for candidate in candidates:
        seed = dose.add(candidate.position, axis, strength)
        rows.append((dose.values / prescription).astype(np.float32))
        dose.remove(seed)
    return np.array(rows)


def make_plan(model: Model, organs: Mapping[str, Organ], source: Source, strength: float, prescription: float, template: str | None = None, most_needles: int = 25,
              bones: Sequence[str] = (), weights: Weights = Weights()) -> Plan:
    """Makes a plan with seeds of `strength` U for a prescription in Gy. template: name of the guide to use; may be omitted if the scene has only one.
    most_needles: maximum number of holes used. bones: mesh surfaces that needles keep clear of. Raises BadPlan if there is no such template, or if no
    hole leads to the gland."""
    guides = {guide.name: guide for guide in model.guides}
    if template not in guides and (template or len(guides) != 1):
        raise BadPlan(f"the scene has {'the guides ' + ', '.join(guides) if guides else 'no template'}: "
                      + ("choose one with --template" if guides else "make it with trocar-anatomy --template"))
    guide = guides[template] if template else next(iter(guides.values()))
    candidates = _candidates(model, guide, organs, bones)
    if not candidates:
        raise BadPlan(f"template {guide.name}: no hole leads to the gland without bone, urethra or rectum in its way: move the template")
    doses = {role: _doses(source, candidates, guide.normal, strength, _sample(organ.points, SAMPLES), prescription) for role, organ in organs.items()}
    search = _Search(candidates, organs, doses, weights)
    search.run(most_needles)
    half = 0.5 * model.seed_size.length
    needles: dict[str, list[float]] = {}
    for i in np.flatnonzero(search.chosen):
        needles.setdefault(candidates[i].hole, []).append(candidates[i].depth)
    isotope, _, name = source.name.partition(" ")
    plan = Plan(guide.name, guide.columns, guide.rows, guide.spacing, source=PlanSource(isotope, name, strength), prescription=prescription)
    for hole, depths in needles.items():
        tip = round(max(depths) + half, 7)
        plan.needles.append(Needle(hole, tip, sorted(round(tip - depth, 7) for depth in depths)))
    if not plan.needles:
        raise BadPlan(f"no seed of {strength:g} U improves the dose: check strength and prescription")
    return plan
