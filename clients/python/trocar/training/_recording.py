"""Reads from a recorded run the messages needed to score it."""
from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .. import Model
from .._lcm_log import events
from .._locate import locate

Array = npt.NDArray[np.float64]

CHANNELS = ("TROCAR_WRENCH", "TROCAR_DEFORMATION", "TROCAR_TRACKS", "TROCAR_SEEDS", "TROCAR_CONTACTS")
# LCM fingerprints of the message types; tests/python/test_training.py compares them with lcmtypes/trocar.lcm.
FINGERPRINTS = dict(zip(CHANNELS, (0x3f878a766c95d360, 0xb6c802e121a810f4, 0xff4a2e4077a7cf58, 0x22281f3a8fc50383, 0xcdae9db269781a73)))
_WRENCH = np.dtype([(name, ">i8") for name in ("fingerprint", "utime", "tick", "session", "pose_seq", "pose_utime")]
                   + [(name, ">f8", 3) for name in ("force", "torque", "raw_force", "raw_torque")] + [("depth", ">f8")]
                   + [(name, ">i4") for name in ("contacts", "events", "membrane", "flags")] + [("server", ">i8"), ("needle", ">i4")])


class BadRecording(Exception):
    """Raised if a recording cannot be used. The message names the file and says how to fix it."""


@dataclass
class Seeds:
    """The seeds at the end of the run, from the last message on TROCAR_SEEDS."""

    rest: Array = field(default_factory=lambda: np.zeros((0, 3)))         # (k, 3) m, centres in the tissue at rest
    direction: Array = field(default_factory=lambda: np.zeros((0, 3)))    # (k, 3) unit vectors to the distal ends, in the tissue at rest
    guide: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))    # (k,) -1: none
    hole: npt.NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))     # (k,) column + columns * row; -1: none


class Sighting(NamedTuple):
    """A needle and the tissue at one instant, as an image would show them."""

    needle: int
    depth: float                                # m, length of the needle's track
    offsets: Array                              # (k, 3) m, vectors from the watched points in the displaced tissue to the tip


class _Message:
    """Reads the numbers in a message one after another."""

    def __init__(self, data: bytes, at: int = 8):
        self._data, self._at = data, at

    def take(self, kind: str, *shape: int) -> npt.NDArray[np.generic]:
        """Reads an array; raises ValueError if the message is too short."""
        count = int(np.prod(shape, dtype=np.int64))
        if count < 0:
            raise ValueError
        found = np.frombuffer(self._data, ">" + kind, count, self._at).reshape(shape)
        self._at += found.nbytes
        return found

    def ended(self) -> bool:
        return self._at == len(self._data)


class Recording:
    """What a log says about a run. Uses only messages from the server, so that logs of the same run by different recorders give the same result.

    wrenches: structured array, in log order; paths: the tracks (n, 3) m that needles cut, in the tissue at rest; seeds: the seeds at the end;
    displacement: largest displacement (m) of the chosen nodes in any frame; sightings: one for each held needle in each frame."""

    def __init__(self, path: str | PathLike[str], model: Model, nodes: npt.NDArray[np.intp], watched: Array):
        """nodes: indices of the nodes whose displacement counts; watched (k, 3) m: the points that sightings refer to, in the tissue at rest. Raises
        BadRecording."""
        self.path, self._node_count, self._nodes, self._watched = fspath(path), len(model.nodes), nodes, watched
        tets, self._weights = locate(model, watched)
        self._corners = model.tets[tets]
        self.sightings: list[Sighting] = []
        self._depths: dict[int, float] = {}
        self._tips: dict[int, tuple[int, Array]] = {}    # for each needle: tick, and tip position (3,) m
        self.paths: list[Array] = []
        self.seeds = Seeds()
        self.displacement = 0.0
        self.frames = 0
        self._servers: set[int] = set()
        self._tracks: dict[int, list[Array]] = {}
        wrenches: list[bytes] = []
        readers = {"TROCAR_DEFORMATION": self._read_frame, "TROCAR_TRACKS": self._read_tracks, "TROCAR_SEEDS": self._read_seeds, "TROCAR_CONTACTS": self._read_contacts}
        for number, (channel, data) in enumerate(events(Path(path), BadRecording)):
            if channel not in FINGERPRINTS:
                continue
            try:
                if int.from_bytes(data[:8], "big") != FINGERPRINTS[channel]:
                    raise ValueError
                if channel == "TROCAR_WRENCH":
                    if len(data) != _WRENCH.itemsize:
                        raise ValueError
                    wrenches.append(data)
                    self._note_depth(np.frombuffer(data, _WRENCH)[0])
                else:
                    readers[channel](_Message(data))
            except ValueError:
                raise BadRecording(f"{path}: event {number}: {channel}: a message of another type, or damaged: record it with this release") from None
        self.wrenches = np.frombuffer(b"".join(wrenches), _WRENCH)
        self.paths += [track for tracks in self._tracks.values() for track in tracks]
        self._check()

    def _check(self) -> None:
        if not len(self.wrenches):
            raise BadRecording(f"{self.path}: no message on TROCAR_WRENCH: record the server's messages, as described in docs/training/tasks.md")
        if not self.frames:
            raise BadRecording(f"{self.path}: no message on TROCAR_DEFORMATION: record the server's messages, as described in docs/training/tasks.md")
        servers = self._servers | set(self.wrenches["server"].tolist())
        if len(servers) > 1:
            raise BadRecording(f"{self.path}: messages of {len(servers)} servers: record a run from its beginning to its end with one server")
        if not np.isfinite(self.wrenches["raw_force"]).all() or not np.isfinite(self.wrenches["depth"]).all():
            raise BadRecording(f"{self.path}: a wrench is not finite: record it with this release")

    def _note_depth(self, wrench: np.void) -> None:
        self._depths[int(wrench["needle"])] = float(wrench["depth"]) if wrench["session"] != 0 else 0.0

    def _read_contacts(self, message: _Message) -> None:
        _, server, tick, _ = message.take("i8", 4)
        self._servers.add(int(server))
        message.take("f8", 5)
        needle, count = message.take("i4", 2).tolist()
        joints = message.take("f8", count, 3).astype(np.float64)
        if count < 1:
            raise ValueError
        self._tips[needle] = int(tick), joints[-1]

    def _read_frame(self, message: _Message) -> None:
        _, server, tick = message.take("i8", 3)
        self._servers.add(int(server))
        count = int(message.take("i4", 1)[0])
        if count != self._node_count:
            raise BadRecording(f"{self.path}: tissue of {count} nodes, the task's scene has {self._node_count}: give the task of the recording")
        moved = message.take("f4", count, 3).astype(np.float64)
        if not message.ended():
            raise ValueError
        self.frames += 1
        self.displacement = max(self.displacement, float(np.linalg.norm(moved[self._nodes], axis=1).max()))
        places = self._watched + np.einsum("ki,kij->kj", self._weights, moved[self._corners])
        self.sightings += [Sighting(needle, self._depths.get(needle, 0.0), tip - places) for needle, (then, tip) in sorted(self._tips.items()) if then == tick]

    def _read_tracks(self, message: _Message) -> None:
        _, server, _ = message.take("i8", 3)
        self._servers.add(int(server))
        needle, count = message.take("i4", 2).tolist()
        points = message.take("f4", count, 3).astype(np.float64)
        message.take("i4", count)
        track = message.take("i2", count)
        message.take("i1", count)
        if not message.ended():
            raise ValueError
        if count == 0:    # the needle was reset, but its earlier tracks still count
            self.paths += self._tracks.pop(needle, [])
        else:
            self._tracks[needle] = [points[track == number] for number in np.unique(track)]

    def _read_seeds(self, message: _Message) -> None:
        _, server, _ = message.take("i8", 3)
        self._servers.add(int(server))
        message.take("f8", 2)
        message.take("i2", int(message.take("i4", 1)[0]))
        count = int(message.take("i4", 1)[0])
        _, _, rest, direction = (message.take("f4", count, 3).astype(np.float64) for _ in range(4))
        _, guide, hole, _ = (message.take("i2", count).astype(np.int64) for _ in range(4))
        if not message.ended():
            raise ValueError
        self.seeds = Seeds(rest, direction, guide, hole)
