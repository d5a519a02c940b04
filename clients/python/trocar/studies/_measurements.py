"""Reads recorded insertions from CSV files or LCM logs: base poses, forces and positions of tracked points."""
from __future__ import annotations

import csv
from dataclasses import dataclass, field
from pathlib import Path
from typing import Sequence

import numpy as np
import numpy.typing as npt

from .._files import open_input
from .._lcm_log import events
from ..motion import BadMotion, Table

Array = npt.NDArray[np.float64]

LENGTHS = {"m": 1.0, "mm": 1e-3}
UNITS = {"force": "N", "torque": "N m", "position": "m"}
FORCES = ("fx", "fy", "fz", "tx", "ty", "tz")    # column names as in the CSV output of trocar-replay


class BadRecording(Exception):
    """Raised if a recording cannot be used. The message gives the file and line and says how to fix it."""


@dataclass(frozen=True)
class Channel:
    """A scalar measured over time, and its averages over equal intervals."""

    kind: str                 # "force", "torque" or "position"
    component: int            # 0, 1 or 2: x, y or z of the world frame
    point: str                # name of the tracked point; empty for forces and torques
    times: Array              # (n,) s after the first pose, increasing
    values: Array             # (n,) N, N m or m
    every: float              # s, length of an averaging interval
    # computed
    first: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))    # (b,) index of the first sample in each non-empty interval
    counts: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))   # (b,) number of samples in these intervals

    def __post_init__(self) -> None:
        index = np.floor(self.times / self.every + 1e-9).astype(np.intp)
        first = np.flatnonzero(np.diff(index, prepend=-1))
        object.__setattr__(self, "first", first)
        object.__setattr__(self, "counts", np.diff(first, append=len(index)))

    @property
    def name(self) -> str:
        return f"{self.point or self.kind} {'xyz'[self.component]}"

    def means(self, values: Array) -> Array:
        """Averages values (n,), one per sample, over the intervals: (b,)."""
        return np.add.reduceat(values, self.first) / self.counts

    def at(self) -> Array:
        """Returns the mean time of the samples in each interval, (b,) s."""
        return self.means(self.times)

    def spreads(self, sample: float, time: float) -> Array:
        """Returns the standard deviations (b,) of the means. sample: standard deviation of a single sample. time: standard deviation (s) of the offset
        between the clocks, which matters where the force changes quickly, as it does at puncture."""
        change = np.abs(np.diff(self.means(self.values)) / np.maximum(np.diff(self.at()), 1e-9)) if len(self.first) > 1 else np.zeros(0)
        slope = np.maximum(np.append(change, 0.0), np.insert(change, 0, 0.0))
        return np.sqrt(sample ** 2 / self.counts + (slope * time) ** 2)


@dataclass
class Recording:
    """A recorded insertion, which begins with the tissue at rest."""

    name: str                 # name of the file, for messages and plots
    motion: Table             # poses of the base
    channels: list[Channel]


# ---- CSV ------------------------------------------------------------------------------------------------------------------------------------


class _Csv:
    """A CSV file whose header gives column names and units, such as "fx [N]"."""

    def __init__(self, path: Path):
        self.path = path
        try:
            with open_input(path, newline="", encoding="utf-8-sig") as file:
                rows = list(csv.reader(file))
        except OSError as error:
            raise BadRecording(f"{path}: cannot be opened: {error.strerror}") from error
        except (UnicodeDecodeError, csv.Error) as error:
            raise BadRecording(f"{path}: not a CSV file: {error}") from error
        if len(rows) < 3:
            raise BadRecording(f"{path}: {max(len(rows) - 1, 0)} rows: write a line with the names of the columns, and at least two rows")
        self.columns = {cell.split("[")[0].strip(): (i, cell.partition("[")[2].strip(" ]")) for i, cell in enumerate(rows[0])}
        self.rows = rows[1:]

    def numbers(self, name: str, units: dict[str, float], gaps: bool = False) -> Array:
        """Returns a column in SI units. With `gaps`, empty cells are allowed and become NaN."""
        if name not in self.columns:
            raise BadRecording(f"{self.path}:1: no column \"{name} [{next(iter(units))}]\": there are {', '.join(self.columns)}")
        index, unit = self.columns[name]
        if unit not in units:
            raise BadRecording(f"{self.path}:1: column {name} [{unit}]: write the unit {' or '.join(units)} in brackets")
        values = np.full(len(self.rows), np.nan)
        for line, cells in enumerate(self.rows, 2):
            text = cells[index].strip() if index < len(cells) else ""
            try:
                values[line - 2] = float(text) if text or not gaps else np.nan
            except ValueError:
                raise BadRecording(f"{self.path}:{line}: column {name}: \"{text}\": write a number") from None
            if text and not np.isfinite(values[line - 2]):
                raise BadRecording(f"{self.path}:{line}: column {name}: {text}: write a finite number")
        return values * units[unit]

    def times(self) -> Array:
        times = self.numbers("t", {"s": 1.0, "ms": 1e-3})
        back = np.flatnonzero(np.diff(times) <= 0.0)
        if len(back):
            raise BadRecording(f"{self.path}:{back[0] + 3}: time {times[back[0] + 1]:g} s is not after {times[back[0]]:g} s: sort the rows by time")
        return times


def _channel(path: Path, kind: str, component: int, point: str, times: Array, values: Array, motion: Table, every: float) -> Channel:
    there = np.isfinite(values) & (times >= -1e-9) & (times <= motion.duration() + 1e-9)
    if there.sum() < 2:
        raise BadRecording(f"{path}: {kind} {'xyz'[component]}{' of ' + point if point else ''}: {there.sum()} samples between the first and the last pose (0 to "
                           f"{motion.duration():g} s): write times in s after the first pose")
    return Channel(kind, component, point, np.maximum(times[there], 0.0), values[there], every)


def read_forces(path: Path, motion: Table, every: float, kinds: Sequence[str]) -> list[Channel]:
    """Reads those of the columns fx, fy, fz [N] and tx, ty, tz [N m] that are in the file and whose kind is in `kinds`. Raises BadRecording."""
    table = _Csv(path)
    times, found = table.times(), []
    for i, name in enumerate(FORCES):
        kind = "force" if i < 3 else "torque"
        if name in table.columns and kind in kinds:
            found.append(_channel(path, kind, i % 3, "", times, table.numbers(name, {UNITS[kind]: 1.0}), motion, every))
    if not found:
        raise BadRecording(f"{path}:1: no column of {' or '.join(kinds)} among {', '.join(table.columns)}: write t [s], fx [N], fy [N], fz [N], as trocar-replay --csv does")
    return found


def read_points(path: Path, motion: Table, every: float, points: Sequence[str]) -> list[Channel]:
    """Reads the positions of tracked points from columns such as "apex_x [mm]". Cells may be empty. Raises BadRecording."""
    table = _Csv(path)
    times = table.times()
    return [_channel(path, "position", i, point, times, table.numbers(f"{point}_{axis}", LENGTHS, gaps=True), motion, every)
            for point in points if any(f"{point}_{axis}" in table.columns for axis in "xyz") for i, axis in enumerate("xyz")]


def read_poses(path: Path) -> Table:
    try:
        return Table.read(path)
    except BadMotion as error:
        raise BadRecording(str(error)) from error


# ---- LCM ------------------------------------------------------------------------------------------------------------------------------------


def read_log(path: Path, every: float, kinds: Sequence[str]) -> Recording:
    """Reads the poses of the first needle and session in the log, and the wrenches computed for them, as they were before limits and ramps. If the log
    contains no wrenches, the recording has no channels. Raises BadRecording."""
    from . import _messages
    poses: list[list[float]] = []
    wrenches: list[list[float]] = []
    owner = None
    for number, (channel, data) in enumerate(events(path, BadRecording)):
        if channel not in ("TROCAR_POSE", "TROCAR_WRENCH"):
            continue
        type_ = _messages._NEEDLE_POSE if channel == "TROCAR_POSE" else _messages._NEEDLE_WRENCH
        message = type_.decode(data)
        if message is None:
            raise BadRecording(f"{path}: event {number}: {channel}: a message of another type: record it with this release")
        owner = owner or (channel == "TROCAR_POSE" and (message["session"], message["needle"]))
        if (message["session"], message["needle"]) != owner:
            continue
        if channel == "TROCAR_POSE":
            row = [1e-6 * message["utime"], *message["position"], *message["orientation"]]
            if not np.all(np.isfinite(row)) or abs(np.linalg.norm(row[4:]) - 1.0) > 1e-3:
                raise BadRecording(f"{path}: event {number}: the pose is not finite, or its quaternion is not of length 1: record it again")
            if not poses or row[0] > poses[-1][0]:
                poses.append(row)
        elif message["pose_seq"] >= 0:
            row = [1e-6 * message["pose_utime"], *message["raw_force"], *message["raw_torque"]]
            if np.all(np.isfinite(row)) and (not wrenches or row[0] > wrenches[-1][0]):
                wrenches.append(row)
    if len(poses) < 2:
        raise BadRecording(f"{path}: {len(poses)} poses on TROCAR_POSE: record an insertion")
    table = np.array(poses)
    for i in range(1, len(table)):    # q and -q are the same orientation: pick the sign closer to the previous quaternion
        if table[i, 4:] @ table[i - 1, 4:] < 0.0:
            table[i, 4:] *= -1.0
    motion = Table(times=table[:, 0] - table[0, 0], given=table[:, 1:])
    channels: list[Channel] = []
    if wrenches:
        measured = np.array(wrenches)
        times = measured[:, 0] - table[0, 0]
        channels = [_channel(path, kind, i % 3, "", times, measured[:, 1 + i], motion, every)
                    for i in range(6) for kind in ["force" if i < 3 else "torque"] if kind in kinds]
    return Recording(path.name, motion, channels)
