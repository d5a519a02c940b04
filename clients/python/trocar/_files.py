"""Opens files that a user has named, or that may have changed since a program wrote them."""
from __future__ import annotations

import os
import stat
from typing import IO, Any


def open_regular(path: str | os.PathLike[str], flags: int) -> int:
    """Like os.open(), but only for regular files: opening a FIFO would block until another process writes to it. Raises OSError."""
    descriptor = os.open(path, flags | os.O_NONBLOCK, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(0, "not a regular file", os.fspath(path))
    return descriptor


def open_input(path: str | os.PathLike[str], mode: str = "r", **options: Any) -> IO[Any]:
    """Like open(), but only for regular files. Raises OSError."""
    return open(path, mode, opener=open_regular, **options)
