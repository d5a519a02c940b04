"""Motions of a needle's base: the scripts of trocar-device, straight insertions and tables of poses.

Playing a motion resets the needle and yields arrays of poses (steps, 7). Step the simulation through each array, for example with `Sim.run`,
before you ask for the next:

    >>> from trocar import motion
    >>> for poses in motion.script("insert").play(sim, 0.001):
    ...     sim.run(poses, 0.001)
"""
from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from typing import Iterable, Iterator, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from . import Sim
from ._files import open_input

__all__ = ["Adjustment", "BadMotion", "Script", "Straight", "Table", "SCRIPTS", "START", "axis_of", "script"]

START = np.array([0.005, 0.003, -0.201, 1.0, 0.0, 0.0, 0.0])  # default of trocar-device: puts the tip of a 200 mm needle 1 mm in front of the skin

Array = npt.NDArray[np.float64]


class BadMotion(Exception):
    """Raised if a table of poses or a plan cannot be used. The message gives the file and line and says how to fix it."""


class Leg(NamedTuple):
    """One leg of a motion: a minimum-jerk movement between two times (s), in which the base moves by `shift` (m) and turns by `turn` (rad, a rotation
    vector), both in the frame that the needle has at the start. Legs may overlap."""

    start: float
    end: float
    shift: tuple[float, float, float]
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)


DEPTH = 0.066  # m, depth to which the scripts insert the needle
_HALF_TURN = (0.0, 0.0, math.pi)
SCRIPTS: dict[str, tuple[float, tuple[Leg, ...]]] = {  # duration (s) and legs of each script, same as in clients/shared/motion.c
    "figure8": (2.4, (Leg(0.0, 1.3, (0, 0, 0.066)), Leg(1.3, 1.6, (0, 0.010, 0)), Leg(1.4, 2.1, (0, 0, -0.066)), Leg(2.4, 2.7, (0, -0.010, 0)))),
    "hold": (2.0, ()),
    "insert": (3.0, (Leg(0.0, 1.3, (0, 0, 0.066)), Leg(1.6, 2.9, (0, 0, -0.066)))),
    "sweep": (5.0, (Leg(0.0, 1.3, (0, 0, 0.066)), Leg(1.5, 2.0, (0.005, 0.005, 0)), Leg(2.0, 2.4, (-0.010, 0, 0)), Leg(2.4, 2.8, (0, -0.010, 0)),
                    Leg(2.8, 3.2, (0.010, 0, 0)), Leg(3.2, 3.6, (-0.005, 0.005, 0)), Leg(3.7, 4.9, (0, 0, -0.066)))),
    "roll": (4.0, (Leg(0.0, 0.7, (0, 0, 0.034)), Leg(0.8, 1.4, (0, 0, 0), _HALF_TURN), Leg(1.5, 2.1, (0, 0, 0.032)),
                   Leg(2.2, 2.8, (0, 0, 0), (0.0, 0.0, -math.pi)), Leg(2.9, 3.9, (0, 0, -0.066)))),
    "again": (5.4, (Leg(0.0, 1.2, (0, 0, 0.066)), Leg(1.3, 2.4, (0, 0, -0.066)), Leg(2.5, 2.9, (-0.008, 0, 0)), Leg(3.0, 4.2, (0, 0, 0.066)),
                    Leg(4.3, 5.4, (0, 0, -0.066)), Leg(5.4, 5.8, (0.008, 0, 0)))),
}


# ---- quaternions w x y z, in the last axis -------------------------------------------------------------------------------------------


def multiply(a: npt.ArrayLike, b: npt.ArrayLike) -> Array:
    """Returns the quaternion product a b: rotation b, then rotation a."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    w = a[..., 0] * b[..., 0] - np.sum(a[..., 1:] * b[..., 1:], axis=-1)
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w[..., None], v], axis=-1)


def rotate(q: npt.ArrayLike, vector: npt.ArrayLike) -> Array:
    q, vector = np.asarray(q, np.float64), np.asarray(vector, np.float64)
    across = 2.0 * np.cross(q[..., 1:], vector)
    return vector + q[..., :1] * across + np.cross(q[..., 1:], across)


def exponential(turn: npt.ArrayLike) -> Array:
    """Converts a rotation vector (rad) to a quaternion."""
    turn = np.asarray(turn, np.float64)
    angle = np.linalg.norm(turn, axis=-1, keepdims=True)
    return np.concatenate([np.cos(0.5 * angle), 0.5 * np.sinc(angle / (2.0 * np.pi)) * turn], axis=-1)


def axis_of(pose: npt.ArrayLike) -> Array:
    """Returns the unit vectors (..., 3) from base to tip for poses (..., 7)."""
    return rotate(np.asarray(pose, np.float64)[..., 3:], np.array([0.0, 0.0, 1.0]))


def towards(direction: npt.ArrayLike) -> Array:
    """Returns the quaternion of the shortest rotation that takes +z to this unit vector. For -z, where it is ambiguous, rotates about x."""
    direction = np.asarray(direction, np.float64)
    half = np.array([1.0 + direction[2], -direction[1], direction[0], 0.0])
    return half / np.linalg.norm(half) if half[0] > 1e-12 else np.array([0.0, 1.0, 0.0, 0.0])


# ---- motions ----------------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Adjustment:
    """Changes to apply to a whole motion: tilts (rad) about x and y at the tip's initial position, translations x, y and z (m) along the needle's
    initial axes, and a roll of the bevel (rad)."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    roll: float = 0.0

    def apply(self, poses: Array, length: float) -> Array:
        """Returns the adjusted poses (n, 7) of a needle of this length (m). The first pose must be the start of the motion."""
        if self == Adjustment():
            return poses
        base, frame = poses[0, :3], poses[0, 3:]
        tip = base + length * axis_of(poses[0])
        conjugate = frame * np.array([1.0, -1.0, -1.0, -1.0])
        turn = multiply(frame, multiply(exponential([self.tilt_x, self.tilt_y, 0.0]), conjugate))
        moved = np.empty_like(poses)
        moved[:, :3] = tip + rotate(turn, poses[:, :3] - tip) + rotate(frame, [self.x, self.y, self.z])
        moved[:, 3:] = multiply(multiply(turn, poses[:, 3:]), exponential([0.0, 0.0, self.roll]))
        return moved


@dataclass(frozen=True)
class _Motion:
    start: Array | None = None                # (7,) pose of the base; None: the scene's needle.start if it has one, else START
    adjustment: Adjustment = Adjustment()

    adjustable = ("x", "y", "z", "tilt_x", "tilt_y", "roll")

    def adjusted(self, **by: float) -> _Motion:
        """Returns a copy with new values for some of the parameters listed in `adjustable`."""
        own = {name: by.pop(name) for name in list(by) if name not in Adjustment.__dataclass_fields__}
        return replace(self, adjustment=replace(self.adjustment, **by), **own)

    def duration(self) -> float | None:
        """Duration in s, or None if it isn't known until the motion has been played."""
        raise NotImplementedError

    def _start_of(self, sim: Sim) -> Array:
        if self.start is not None:
            return self.start
        given = sim.model.start
        return START if given is None else given

    def poses(self, start: Array, dt: float) -> Array:
        """Returns the poses (n, 7) at times 0, dt, 2 dt and so on."""
        raise NotImplementedError

    def play(self, sim: Sim, dt: float) -> Iterator[Array]:
        poses = np.ascontiguousarray(self.adjustment.apply(self.poses(self._start_of(sim), dt), sim.model.needle_length))
        sim.reset(poses[0])
        yield poses

    def moves(self, sim: Sim, dt: float) -> Iterable[tuple[int, Array]]:
        """Like `play`, but works for motions of several needles too: yields pairs of a needle index and poses for that needle."""
        return ((0, poses) for poses in self.play(sim, dt))


def minimum_jerk(x: Array) -> Array:
    """Returns the fraction of a minimum-jerk stroke completed after the fraction x of its duration (Flash and Hogan 1985)."""
    return x * x * x * (10.0 + x * (-15.0 + 6.0 * x))


def _ticks(duration: float, dt: float) -> int:
    return int(math.floor(duration / dt + 0.5)) + 1


@dataclass(frozen=True)
class Script(_Motion):
    """One of the scripts of trocar-device."""

    legs: tuple[Leg, ...] = ()
    seconds: float = 0.0
    speed: float = 1.0        # the motion is this many times faster than the script
    depth: float = DEPTH      # m, insertion depth; a deeper insertion takes proportionally longer

    adjustable = (*_Motion.adjustable, "depth", "speed")

    def duration(self) -> float:
        return self.seconds * self.depth / DEPTH / self.speed

    def to_depth(self, depth: float) -> Script:
        """Returns the script with a different insertion depth (m) but the same speed along the needle, as trocar-device does for a scene with
        needle.start.depth. All times scale with the depth, so the sideways legs and turns of a deeper script are slower."""
        return replace(self, depth=depth)

    def poses(self, start: Array, dt: float) -> Array:
        count = _ticks(self.duration(), dt)
        factor = self.depth / DEPTH
        t = self.speed * dt * np.arange(count) / factor
        poses = np.tile(start, (count, 1))
        for leg in self.legs:
            x = np.clip((t - leg.start) / (leg.end - leg.start), 0.0, 1.0)
            part = minimum_jerk(x)[:, None]
            poses[:, :3] += part * rotate(start[3:], [*leg.shift[:2], factor * leg.shift[2]])
            if any(leg.turn):
                poses[:, 3:] = multiply(poses[:, 3:], exponential(part * np.asarray(leg.turn)))
        return poses


def script(name: str, speed: float = 1.0, start: npt.ArrayLike | None = None) -> Script:
    """Returns a script by its name in SCRIPTS. Raises KeyError if there is no such script."""
    seconds, legs = SCRIPTS[name]
    return Script(start=None if start is None else np.asarray(start, np.float64), legs=legs, seconds=seconds, speed=speed)


@dataclass(frozen=True)
class Straight(_Motion):
    """A straight insertion: advances the base by `depth` (m) at `speed` (m/s), holds it for `hold` (s) and, if `back` is true, retracts it."""

    depth: float = 0.05
    speed: float = 0.05
    hold: float = 0.0
    back: bool = False

    adjustable = (*_Motion.adjustable, "depth", "speed")

    def duration(self) -> float:
        return (2 if self.back else 1) * self.depth / self.speed + self.hold

    def poses(self, start: Array, dt: float) -> Array:
        t = dt * np.arange(_ticks(self.duration(), dt))
        way = np.minimum(self.speed * t, self.depth)
        if self.back:
            way = np.minimum(way, np.maximum(self.speed * (self.duration() - t), 0.0))
        poses = np.tile(start, (len(t), 1))
        poses[:, :3] += way[:, None] * axis_of(start)
        return poses


_COLUMNS = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class Table(_Motion):
    """Poses at given times, read from a CSV file, with linear interpolation in between."""

    times: Array = field(default_factory=lambda: np.zeros(0))      # (n,) s, times counted from 0
    given: Array = field(default_factory=lambda: np.zeros((0, 7)))

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Table:
        """Reads a CSV file with the columns t (s), x, y, z (m), qw, qx, qy, qz. Raises BadMotion."""
        name, rows = fspath(path), []
        try:
            with open_input(path, newline="", encoding="utf-8") as file:
                for line, cells in enumerate(csv.reader(file), 1):
                    if line == 1:
                        if tuple(cell.split("[")[0].strip() for cell in cells) != _COLUMNS:
                            raise BadMotion(f"{name}:1: write the columns {','.join(_COLUMNS)}")
                        continue
                    try:
                        row = [float(cell) for cell in cells]
                    except ValueError:
                        row = []
                    if len(row) != 8 or not all(map(math.isfinite, row)):
                        raise BadMotion(f"{name}:{line}: write eight numbers: {','.join(_COLUMNS)}")
                    if abs(np.linalg.norm(row[4:]) - 1.0) > 1e-3:
                        raise BadMotion(f"{name}:{line}: the quaternion has length {np.linalg.norm(row[4:]):.4g}: write one of length 1")
                    if rows and row[0] <= rows[-1][0]:
                        raise BadMotion(f"{name}:{line}: time {row[0]:g} s is not after {rows[-1][0]:g} s: sort the rows by time")
                    rows.append(row)
        except OSError as error:
            raise BadMotion(f"{name}: cannot be opened: {error.strerror}") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise BadMotion(f"{name}: not a CSV file: {error}") from error
        if len(rows) < 2:
            raise BadMotion(f"{name}: {len(rows)} poses: write at least two")
        table = np.array(rows)
        for i in range(1, len(table)):    # q and -q are the same orientation: pick the sign closer to the previous quaternion, so that interpolation takes the short way
            if table[i, 4:] @ table[i - 1, 4:] < 0.0:
                table[i, 4:] *= -1.0
        return cls(times=table[:, 0] - table[0, 0], given=table[:, 1:])

    def duration(self) -> float:
        return float(self.times[-1])

    def poses(self, start: Array, dt: float) -> Array:
        t = dt * np.arange(_ticks(self.duration(), dt))
        poses = np.stack([np.interp(t, self.times, column) for column in self.given.T], axis=1)
        poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
        return poses
