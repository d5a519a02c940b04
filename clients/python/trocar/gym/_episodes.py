"""Episodes of a task that run side by side, one in each row of a batch: motion, observations, rewards and termination.

The single and the vector environment both use this class, so a row of a vector environment behaves exactly like a single environment with the same
seed.
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
WITHDRAWAL = 0.015         # m, distance by which the needle is drawn back from a released seed, which then lies free in the tissue
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
    """The result of a step for all rows. Rows that were not stepped have a reward of 0 and are not terminated."""

    reward: Array      # (count,) mm
    terminated: Mask   # (count,)
    info: dict[str, npt.NDArray[Any]]    # see Episodes.info


def limits(task: str) -> npt.NDArray[np.float32]:
    """Returns the largest absolute value of each entry of an observation."""
    return np.concatenate([np.full(*OBSERVATIONS[name]) for name in OBSERVED[task]]).astype(np.float32)


class Episodes:
    """Rows of a batch, each with its own episode. The first index of each array is the row of the batch."""

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
        self.travel, self.roll = np.zeros(count), np.zeros(count)    # m and rad, motion of the base since the start: along the needle, and roll
        self.tip, self.force, self.depth = np.zeros((count, 7)), np.zeros((count, 3)), np.zeros(count)
        self.target, self.obstacle = np.zeros((count, 3)), np.zeros((count, 3))    # m, positions in the displaced tissue
        self.displacement = np.zeros(count)    # m, mean over the nodes of the target's region
        self.error = np.zeros(count)           # m, distance from the target to the tip or, in the task implant, to the seed
        self.hit, self.released, self.unstable = (np.zeros(count, bool) for _ in range(3))

    def begin(self, mask: Mask, randoms: Sequence[np.random.Generator]) -> None:
        """Starts new episodes in the rows of the mask, drawn at random with the generators of these rows."""
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
        """Applies the actions (count, number of actions), clipped to [-1, 1], in the rows of the mask."""
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
        """Returns the observations (count, values) in mm and N. Positions are in the tip's frame, and forces in the base's frame."""
        tip, base, position = _axes(self.tip[:, 3:]), _axes(self._orientation(self.roll)), self.tip[:, :3]
        within = lambda axes, vectors: np.einsum("nij,nj->ni", axes, vectors)
        values = {"target": MM * within(tip, self.target - position), "force": within(base, self.force), "depth": MM * self.depth[:, None],
                  "obstacle": MM * within(tip, self.obstacle - position), "displacement": MM * self.displacement[:, None],
                  "radius": MM * self.radius[:, None]}
        observed = np.concatenate([values[name] for name in OBSERVED[self.task.name]], axis=1)
        limit = limits(self.task.name)
        return np.clip(observed, -limit, limit).astype(np.float32)

    def info(self) -> dict[str, npt.NDArray[Any]]:
        """Returns `error` (m), `displacement` (m), `hit` (true if the needle has hit the obstacle) and `is_success` (true if the error is within the
        tolerance, the needle has hit nothing and is stable, and in the task implant the seed has been released)."""
        success = (self.error <= self.task.tolerance) & ~self.hit & ~self.unstable
        if self.task.name == "implant":
            success &= self.released
        return {"error": self.error.copy(), "displacement": self.displacement.copy(), "hit": self.hit.copy(), "is_success": success}

    def sim(self, row: int) -> Sim:
        return self.batch[row]

    def _orientation(self, roll: Array) -> Array:
        """Returns the quaternions (..., 4) of bases that have been rolled by angles (...)."""
        return np.cos(0.5 * roll)[..., None] * self.task.start[3:] + np.sin(0.5 * roll)[..., None] * self._turned

    def _poses(self, actions: Array) -> Array:
        """Returns the poses (count, ticks, 7) of the bases during these actions, and advances `travel` and `roll` to the last of them. A base cannot
        move back beyond its start."""
        times = DT * np.arange(1, self.ticks + 1)
        travel = np.clip(self.travel[:, None] + times * self.task.speed * actions[:, :1], 0.0, self.needle_length)
        roll = self.roll[:, None] + times * self.task.roll_rate * actions[:, 1:2]
        self.travel, self.roll = travel[:, -1].copy(), roll[:, -1].copy()
        return self._bases(travel, roll)

    def _bases(self, travel: Array, roll: Array) -> Array:
        """Returns the poses (count, ticks, 7) of bases that have been moved along the needle by `travel` (m) and rolled by `roll` (rad), each (count,
        ticks)."""
        return np.concatenate([self.task.start[:3] + travel[:, :, None] * self.axis, self._orientation(roll)], axis=2)

    def _look_at_tissue(self, row: int, field: Array) -> None:
        """Computes the positions of target and obstacle, and the mean displacement, in tissue displaced by `field`, (nodes, 3) m."""
        episode = self.episodes[row]
        self.target[row] = episode.target + episode.target_weights @ field[episode.target_nodes]
        self.obstacle[row] = episode.obstacle + episode.obstacle_weights @ field[episode.obstacle_nodes]
        self.displacement[row] = np.linalg.norm(field[episode.region_nodes], axis=1).mean()

    def _measure(self, mask: Mask) -> None:
        """Computes the errors in the rows of the mask."""
        point = self.tip[:, :3]
        if self.task.name == "implant":    # the distal end of a released seed is at the tip; `point` is the seed's centre
            point = point - 0.5 * self.seed_length * _axes(self.tip[:, 3:])[:, 2]
        self.error[mask] = np.linalg.norm(self.target - point, axis=1)[mask]

    def _ahead(self) -> Array:
        """Returns the distances (count,) m from the tips to the targets, along the needle's axis before the insertion; negative beyond the target."""
        return (self.target - self.tip[:, :3]) @ self.axis

    def _release(self, mask: Mask) -> None:
        """Releases a seed at the tip, draws the needle back, and computes the error from the seed's position in the tissue at rest."""
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
    """Returns the axes (count, 3, 3) of the frames given by quaternions (count, 4), as unit vectors in the rows."""
    w, x, y, z = quaternions.T
    return np.stack([np.stack([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1),
                     np.stack([2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)], axis=1),
                     np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z], axis=1)], axis=1)


def _distance(line: Array, point: Array) -> float:
    """Returns the distance of a point (3,) from a polyline (n, 3)."""
    start, along = line[:-1], np.diff(line, axis=0)
    share = np.clip(np.einsum("ni,ni->n", point - start, along) / np.einsum("ni,ni->n", along, along), 0.0, 1.0)
    return float(np.linalg.norm(start + share[:, None] * along - point, axis=1).min())
