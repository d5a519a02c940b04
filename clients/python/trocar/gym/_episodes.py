"""Runs the episodes of a task in parallel, one in each row of a batch: motion, observations, rewards and termination.

Single and vector environments share this code, so a row of a vector environment behaves exactly like a single environment with the same seed.
"""
from __future__ import annotations

from typing import Any, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Batch, Event, Sim
from .. import motion
from ._task import Array, Episode, Task

DT = 1e-3                  # s, length of a tick
MM = 1e3                   # mm per m
WITHDRAWAL = 0.015         # m, how far to draw the needle back after dropping a seed, so that the seed comes free of it
HIT_COST = 20.0            # mm, subtracted from the reward when the needle touches the obstacle
LENGTH_LIMIT, FORCE_LIMIT = 500.0, 100.0     # mm and N, limits of the observation space

OBSERVATIONS = {           # name: (number of values, limit)
    "target": (3, LENGTH_LIMIT), "force": (3, FORCE_LIMIT), "depth": (1, LENGTH_LIMIT),
    "obstacle": (3, LENGTH_LIMIT), "radius": (1, LENGTH_LIMIT), "displacement": (1, LENGTH_LIMIT)}
OBSERVED = {"reach": ("target", "force", "depth"), "avoid": ("target", "force", "depth", "obstacle", "radius"),
            "implant": ("target", "force", "depth", "displacement")}
ACTIONS = {"reach": ("speed", "roll"), "avoid": ("speed", "roll"), "implant": ("speed", "roll", "release")}

Mask = npt.NDArray[np.bool_]


class Step(NamedTuple):
    """The result of a step, for all rows. Rows that were not stepped get reward 0 and are not terminated."""

    reward: Array      # (count,) mm
    terminated: Mask   # (count,)
    info: dict[str, npt.NDArray[Any]]    # see Episodes.info


def limits(task: str) -> npt.NDArray[np.float32]:
    """Returns the bound on the absolute value of each entry of an observation."""
    return np.concatenate([np.full(*OBSERVATIONS[name]) for name in OBSERVED[task]]).astype(np.float32)


class Episodes:
    """The episodes running in the rows of a batch. The first index of every array is the row."""

    def __init__(self, task: Task, count: int, threads: int):
        self.task, self.ticks = task, max(1, round(task.interval / DT))
        self.batch = Batch(task._stiffnesses[0].model, count, threads, outputs=("force", "depth", "tip", "events"))
        self.axis, start = task.axes[2], task.start[3:]
        self._turned = motion.multiply(start, [0.0, 0.0, 0.0, 1.0])
        self.needle_length = task._stiffnesses[0].model.needle_length
        self.seed_length = float(task.scene["seeds.length"])    # m
        self.needle_radius = 0.5 * float(task.scene["needle.outer_diameter"])    # m
        self.episodes: dict[int, Episode] = {}    # by row
        self.radius = np.zeros(count)             # m, radius of the obstacle
        self.travel, self.roll = np.zeros(count), np.zeros(count)    # m and rad, how far the base has moved along the needle and rolled since the start
        self.tip, self.force, self.depth = np.zeros((count, 7)), np.zeros((count, 3)), np.zeros(count)
        self.target, self.obstacle = np.zeros((count, 3)), np.zeros((count, 3))    # m, positions in the displaced tissue
        self.displacement = np.zeros(count)    # m, mean displacement of the nodes of the target's region
        self.error = np.zeros(count)           # m, distance from the target to the tip or, in the implant task, to the seed
        self.hit, self.released, self.unstable = (np.zeros(count, bool) for _ in range(3))

    def begin(self, mask: Mask, randoms: Sequence[np.random.Generator]) -> None:
        """Starts new random episodes in the rows selected by the mask, each drawn with the row's own generator."""
        rows = [int(row) for row in np.flatnonzero(mask)]
        for row in rows:
            episode = self.task.draw(randoms[row])
            if self.batch[row].model is not episode.model:
                self.batch.set_model(row, episode.model)
            self.episodes[row], self.radius[row] = episode, episode.radius
        self.batch.reset(self.task.start, mask)
        for state in (self.travel, self.roll, self.force, self.depth, self.hit, self.released, self.unstable):
            state[mask] = 0
        self.tip[mask] = [*(self.task.start[:3] + self.needle_length * self.axis), *self.task.start[3:]]
        for row in rows:
            self._look_at_tissue(row, np.zeros_like(self.episodes[row].model.nodes))
        self._measure(mask)

    def step(self, actions: npt.ArrayLike, mask: Mask) -> Step:
        """Applies the actions (count, number of actions), clipped to [-1, 1], in the rows selected by the mask."""
        given = np.clip(np.asarray(actions, np.float64), -1.0, 1.0)
        before = self.error.copy()
        out = self.batch.run(self._poses(given), DT, mask)
        self.tip[mask], self.force[mask], self.depth[mask] = (out[name][mask, -1] for name in ("tip", "force", "depth"))
        self.unstable[mask] = (np.bitwise_or.reduce(out["events"][mask], axis=1) & Event.UNSTABLE) != 0
        for row in np.flatnonzero(mask):
            sim = self.batch[int(row)]
            self._look_at_tissue(int(row), sim.displacements())
            if self.radius[row] > 0.0:
                self.hit[row] = _distance(sim.centreline(), self.obstacle[row]) < self.radius[row] + self.needle_radius
        self._measure(mask)
        terminated = self.hit | self.unstable
        reward = np.where(mask, MM * (before - self.error) - HIT_COST * self.hit, 0.0)
        if self.task.name == "implant":
            reward -= np.where(mask, self.task.displacement_cost * self.ticks * DT * MM * self.displacement, 0.0)
            releasing = mask & (given[:, 2] > 0.0) & (self.depth > 0.0)
            reached = self.error.copy()
            self._release(releasing)
            reward += MM * (reached - self.error)
            terminated |= self.released
        else:
            terminated |= self._ahead() <= 0.0
        return Step(reward, terminated & mask, self.info())

    def observe(self) -> npt.NDArray[np.float32]:
        """Returns the observations (count, values), in mm and N: positions in the tip's frame and forces in the base's frame."""
        tip, base, position = _axes(self.tip[:, 3:]), _axes(self._orientation(self.roll)), self.tip[:, :3]
        within = lambda axes, vectors: np.einsum("nij,nj->ni", axes, vectors)
        values = {"target": MM * within(tip, self.target - position), "force": within(base, self.force), "depth": MM * self.depth[:, None],
                  "obstacle": MM * within(tip, self.obstacle - position), "displacement": MM * self.displacement[:, None],
                  "radius": MM * self.radius[:, None]}
        observed = np.concatenate([values[name] for name in OBSERVED[self.task.name]], axis=1)
        limit = limits(self.task.name)
        return np.clip(observed, -limit, limit).astype(np.float32)

    def info(self) -> dict[str, npt.NDArray[Any]]:
        """Returns `error` (m), `displacement` (m), `hit` (whether the needle has hit the obstacle) and `is_success`. An episode succeeds if the error is
        within tolerance, the obstacle was not hit, the simulation stayed stable and, in the implant task, the seed has been released."""
        success = (self.error <= self.task.tolerance) & ~self.hit & ~self.unstable
        if self.task.name == "implant":
            success &= self.released
        return {"error": self.error.copy(), "displacement": self.displacement.copy(), "hit": self.hit.copy(), "is_success": success}

    def sim(self, row: int) -> Sim:
        return self.batch[row]

    def _orientation(self, roll: Array) -> Array:
        """Returns the orientations (..., 4) of the base, as quaternions, after rolling it by the angles `roll` (...)."""
        return np.cos(0.5 * roll)[..., None] * self.task.start[3:] + np.sin(0.5 * roll)[..., None] * self._turned

    def _poses(self, actions: Array) -> Array:
        """Returns the base poses (count, ticks, 7) during these actions, and updates `travel` and `roll` to their end. A base cannot move back past its
        start."""
        times = DT * np.arange(1, self.ticks + 1)
        travel = np.clip(self.travel[:, None] + times * self.task.speed * actions[:, :1], 0.0, self.needle_length)
        roll = self.roll[:, None] + times * self.task.roll_rate * actions[:, 1:2]
        self.travel, self.roll = travel[:, -1].copy(), roll[:, -1].copy()
        return self._bases(travel, roll)

    def _bases(self, travel: Array, roll: Array) -> Array:
        """Returns the base poses (count, ticks, 7) after moving along the needle by `travel` (m) and rolling by `roll` (rad), both (count, ticks)."""
        return np.concatenate([self.task.start[:3] + travel[:, :, None] * self.axis, self._orientation(roll)], axis=2)

    def _look_at_tissue(self, row: int, field: Array) -> None:
        """Updates the positions of target and obstacle, and the mean displacement, for tissue displaced by `field` (nodes, 3) m."""
        episode = self.episodes[row]
        self.target[row] = episode.target + episode.target_weights @ field[episode.target_nodes]
        self.obstacle[row] = episode.obstacle + episode.obstacle_weights @ field[episode.obstacle_nodes]
        self.displacement[row] = np.linalg.norm(field[episode.region_nodes], axis=1).mean()

    def _measure(self, mask: Mask) -> None:
        """Updates `error` in the rows selected by the mask."""
        point = self.tip[:, :3]
        if self.task.name == "implant":    # the distal end of a released seed is at the tip; `point` is the seed's centre
            point = point - 0.5 * self.seed_length * _axes(self.tip[:, 3:])[:, 2]
        self.error[mask] = np.linalg.norm(self.target - point, axis=1)[mask]

    def _ahead(self) -> Array:
        """Returns how far (count,), in m, each tip has to go to its target along the needle's initial axis; negative if it is past the target."""
        return (self.target - self.tip[:, :3]) @ self.axis

    def _release(self, mask: Mask) -> None:
        """Drops a seed at the tip, draws the needle back, and takes the error from the seed's position in the tissue at rest."""
        if not mask.any():
            return
        for row in np.flatnonzero(mask):
            self.batch[int(row)].drop_seeds(1)
        back = self.task.speed * DT * np.arange(1, round(WITHDRAWAL / self.task.speed / DT) + 1)
        self.batch.run(self._bases(self.travel[:, None] - back, np.repeat(self.roll[:, None], len(back), axis=1)), DT, mask)
        for row in np.flatnonzero(mask):
            self.released[row] = True
            self.error[row] = np.linalg.norm(self.batch[int(row)].seeds()[-1].position - self.episodes[int(row)].target)


def _axes(quaternions: Array) -> Array:
    """Returns the axes (count, 3, 3) of the frames given by quaternions (count, 4), one unit vector per row."""
    w, x, y, z = quaternions.T
    return np.stack([np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1),
                     np.stack([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)], axis=1),
                     np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], axis=1)], axis=1)


def _distance(line: Array, point: Array) -> float:
    """Returns the distance from a point (3,) to a polyline (n, 3)."""
    start, along = line[:-1], np.diff(line, axis=0)
    share = np.clip(np.einsum("ni,ni->n", point - start, along) / np.einsum("ni,ni->n", along, along), 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())
