"""Reads from a recorded run the messages needed to score it."""
from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .. import Model
from .._lcm_log import events
from .._locate import locate
from .._lcm_messages import FINGERPRINTS, NO_SEEDS, Message, is_of_channel, read_deformation, read_seeds

Array = npt.NDArray[np.float64]

_WRENCH = np.dtype([(name, ">i8") for name in ("fingerprint", "utime", "tick", "session", "pose_seq", "pose_utime")]
                   + [(name, ">f8", 3) for name in ("force", "torque", "raw_force", "raw_torque")] + [("depth", ">f8")]
                   + [(name, ">i4") for name in ("contacts", "events", "membrane", "flags")] + [("server", ">i8"), ("needle", ">i4")])


class BadRecording(Exception):
    """Raised if a recording cannot be used. The message names the file and says how to fix it."""


class Sighting(NamedTuple):
    """A needle and the tissue at one instant, as an image would show them."""

    needle: int
    depth: float                                # m, length of the needle's track
    offsets: Array                              # (k, 3) m, vectors from the watched points in the displaced tissue to the tip


class Recording:
    """What a log says about a run. Uses only messages from the server, so that logs of the same run by different recorders give the same result.

    wrenches: structured array, in log order; paths: the tracks (n, 3) m that needles cut, in the tissue at rest; seeds: the seeds at the end;
    displacement: largest displacement (m) of the chosen nodes in any frame; sightings: one for each held needle in each frame; probe_force: largest force (N) on
    the probe, None if there is none; lost: how many wrenches of needle 0, which the server sends in each tick, are missing between the first and the last;
    ticks: the number of these ticks."""

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
        self.seeds = NO_SEEDS
        self.displacement = 0.0
        self.probe_force: float | None = None
        self.frames = 0
        self._servers: set[int] = set()
        self._tracks: dict[int, list[Array]] = {}
        wrenches: list[bytes] = []
        readers = {"TROCAR_DEFORMATION": self._read_frame, "TROCAR_TRACKS": self._read_tracks, "TROCAR_SEEDS": self._read_seeds, "TROCAR_CONTACTS": self._read_contacts,
                   "TROCAR_PROBE_WRENCH": self._read_probe}
        for number, (channel, data) in enumerate(events(Path(path), BadRecording)):
            if channel not in FINGERPRINTS:
                continue
            try:
                if not is_of_channel(channel, data):
                    raise ValueError
                if channel == "TROCAR_WRENCH":
                    if len(data) != _WRENCH.itemsize:
                        raise ValueError
                    wrenches.append(data)
                    self._note_depth(np.frombuffer(data, _WRENCH)[0])
                else:
                    readers[channel](data)
            except ValueError:
                raise BadRecording(f"{path}: event {number}: {channel}: a message of another type, or damaged: record it with this release") from None
        self.wrenches = np.frombuffer(b"".join(wrenches), _WRENCH)
        self.paths += [track for tracks in self._tracks.values() for track in tracks]
        self._check()
        heard = np.unique(self.wrenches["tick"][self.wrenches["needle"] == 0])
        self.ticks = int(heard[-1] - heard[0]) + 1 if len(heard) else 0
        self.lost = self.ticks - len(heard)

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

    def _read_probe(self, data: bytes) -> None:
        message = Message(data)
        self._servers.add(int(message.take("i8", 5)[1]))
        message.take("f8", 7)
        force = message.take("f8", 3).astype(np.float64)
        message.take("f8", 3)
        message.take("i4", 1)
        message.end()
        if not np.isfinite(force).all():
            raise ValueError
        self.probe_force = max(self.probe_force or 0.0, float(np.linalg.norm(force)))

    def _read_contacts(self, data: bytes) -> None:
        message = Message(data)
        _, server, tick, _ = message.take("i8", 4)
        self._servers.add(int(server))
        message.take("f8", 5)
        needle, count = message.take("i4", 2).tolist()
        joints = message.take("f8", count, 3).astype(np.float64)
        if count < 1:
            raise ValueError
        self._tips[needle] = int(tick), joints[-1]

    def _read_frame(self, data: bytes) -> None:
        server, tick, moved = read_deformation(data)
        self._servers.add(server)
        if len(moved) != self._node_count:
            raise BadRecording(f"{self.path}: tissue of {len(moved)} nodes, the task's scene has {self._node_count}: give the task of the recording")
        self.frames += 1
        self.displacement = max(self.displacement, float(np.linalg.norm(moved[self._nodes], axis=1).max()))
        places = self._watched + np.einsum("ki,kij->kj", self._weights, moved[self._corners])
        self.sightings += [Sighting(needle, self._depths.get(needle, 0.0), tip - places) for needle, (then, tip) in sorted(self._tips.items()) if then == tick]

    def _read_tracks(self, data: bytes) -> None:
        message = Message(data)
        self._servers.add(int(message.take("i8", 3)[1]))
        needle, count = message.take("i4", 2).tolist()
        points = message.take("f4", count, 3).astype(np.float64)
        message.take("i4", count)
        track = message.take("i2", count)
        message.take("i1", count)
        message.end()
        if count == 0:    # the needle was reset, but its earlier tracks still count
            self.paths += self._tracks.pop(needle, [])
        else:
            self._tracks[needle] = [points[track == number] for number in np.unique(track)]

    def _read_seeds(self, data: bytes) -> None:
        self.seeds = read_seeds(data)
        self._servers.add(self.seeds.server)
