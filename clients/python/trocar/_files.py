"""Safe opening of files named by the user or possibly changed by other programs, and atomic replacement of files."""
from __future__ import annotations

import os
import stat
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Iterator


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


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yields the path of a temporary file beside `path`. Write to it in the `with` block; it replaces `path` when the block ends, unless the block
    raises. Readers see either the old file or the complete new one, even after a power failure."""
    temporary = path.with_name(f"{path.name}.{os.getpid()}")
    try:
        yield temporary
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
