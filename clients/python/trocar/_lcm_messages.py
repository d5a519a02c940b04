"""Reads messages of the server, as recorded in a log, without LCM."""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# LCM fingerprints of the message types on each channel; tests/python/test_training.py compares them with lcmtypes/trocar.lcm.
FINGERPRINTS = {"TROCAR_WRENCH": 0x3f878a766c95d360, "TROCAR_DEFORMATION": 0xb6c802e121a810f4, "TROCAR_TRACKS": 0xff4a2e4077a7cf58, "TROCAR_SEEDS": 0x22281f3a8fc50383,
                "TROCAR_CONTACTS": 0xcdae9db269781a73, "TROCAR_PROBE_WRENCH": 0xf4f87507d019b939}


def is_of_channel(channel: str, data: bytes) -> bool:
    """Whether a message has the type of its channel, in this release."""
    return int.from_bytes(data[:8], "big") == FINGERPRINTS[channel]


class Message:
    """Reads the numbers in a message one after another. The methods raise ValueError if the message is too short."""

    def __init__(self, data: bytes):
        self._data, self._at = data, 8    # after the fingerprint

    def take(self, kind: str, *shape: int) -> npt.NDArray[np.generic]:
        """Reads an array."""
        count = int(np.prod(shape, dtype=np.int64))
        if count < 0:
            raise ValueError
        found = np.frombuffer(self._data, ">" + kind, count, self._at).reshape(shape)
        self._at += found.nbytes
        return found

    def end(self) -> None:
        """Raises ValueError unless everything has been read."""
        if self._at != len(self._data):
            raise ValueError


class Deformation(NamedTuple):
    """A deformation_t."""

    server: int
    tick: int
    displacement: Array    # (nodes, 3) m


class Seeds(NamedTuple):
    """A seeds_t, for seeds k."""

    server: int
    tick: int
    utime: int                          # us
    position: Array                     # (k, 3) m, centres in the displaced tissue
    direction: Array                    # (k, 3) unit vectors to the distal ends, in the displaced tissue
    rest: Array                         # (k, 3) m, centres in the tissue at rest
    rest_direction: Array               # (k, 3)
    needle: npt.NDArray[np.int64]       # (k,)
    guide: npt.NDArray[np.int64]        # (k,) -1: none
    hole: npt.NDArray[np.int64]         # (k,) column + columns * row; -1: none
    strand: npt.NDArray[np.int64]       # (k,) place of the seed in its strand, 0 for the distal one


NO_SEEDS = Seeds(0, 0, 0, *[np.zeros((0, 3))] * 4, *[np.zeros(0, np.int64)] * 4)


def read_deformation(data: bytes) -> Deformation:
    """Raises ValueError if the message is damaged."""
    message = Message(data)
    _, server, tick = message.take("i8", 3).tolist()
    displacement = message.take("f4", int(message.take("i4", 1)[0]), 3).astype(np.float64)
    message.end()
    return Deformation(server, tick, displacement)


def read_seeds(data: bytes) -> Seeds:
    """Raises ValueError if the message is damaged."""
    message = Message(data)
    utime, server, tick = message.take("i8", 3).tolist()
    message.take("f8", 2)
    message.take("i2", int(message.take("i4", 1)[0]))
    count = int(message.take("i4", 1)[0])
    places = [message.take("f4", count, 3).astype(np.float64) for _ in range(4)]
    indices = [message.take("i2", count).astype(np.int64) for _ in range(4)]
    message.end()
    return Seeds(server, tick, utime, *places, *indices)
