"""Reads LCM event logs without LCM."""
from __future__ import annotations

import mmap
import os
import struct
from pathlib import Path
from typing import Iterator

from ._files import open_input

_MAGIC = 0xEDA1DA01    # first bytes of each event in an LCM log
_HEAD = struct.Struct(">IqqII")


def events(path: Path, error: type[Exception]) -> Iterator[tuple[str, bytes]]:
    """Yields the channel and message of each event in an LCM log. Raises `error` if the file cannot be opened or is damaged; the message gives the byte
    offset of the damage."""
    try:
        file = open_input(path, "rb")
    except OSError as fault:
        raise error(f"{path}: cannot be opened: {fault.strerror}") from fault
    with file:
        if os.fstat(file.fileno()).st_size == 0:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            at = 0
            while at < len(data):
                if len(data) - at < _HEAD.size:
                    raise error(f"{path}: byte {at}: ends within an event: record it again, or cut it there")
                magic, _, _, name, size = _HEAD.unpack_from(data, at)
                body = at + _HEAD.size
                if magic != _MAGIC or body + name + size > len(data):
                    raise error(f"{path}: byte {at}: no complete event of an LCM log: is it a recording by lcm-logger or trocar-device --log?")
                yield data[body:body + name].decode("ascii", "replace"), data[body + name:body + name + size]
                at = body + name + size
