"""Reads DICOM files with pydicom, but detects truncated files, which pydicom by itself would read as if they were complete.

The build copies this module into the Python package, as `trocar.brachy._dicom`.
"""
from __future__ import annotations

import io
import os
import zlib
from os import PathLike

import pydicom


class _File(io.BytesIO):
    """Contents of a file. beyond: number of reads that asked for more bytes than were left."""

    beyond = 0
    ends_between = False    # true if the last such read began at the end of the file

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            self.beyond += 1
            self.ends_between = not data
        return data


def read(path: str | PathLike[str]) -> pydicom.Dataset:
    """Returns the data set of a file. Raises EOFError, with the file name, if the file ends in the middle of an element; OSError if it cannot be opened; and
    otherwise pydicom's exceptions.

    At the end of a complete file, pydicom tries once to read another element and finds nothing. Any other read past the end means that an element is
    incomplete. Truncation exactly between two top-level elements goes unnoticed.
    """
    if os.path.exists(path) and not os.path.isfile(path):    # opening a FIFO would block forever
        raise OSError(0, "not a regular file", path)
    with open(path, "rb") as source:
        file = _File(source.read())
    try:
        data = pydicom.dcmread(file)
    except zlib.error as error:    # raised for damaged data in a deflated transfer syntax
        raise EOFError(f"{path}: its compressed content ends too early, or is damaged: {error}") from error
    except Exception as error:    # pydicom may raise anything for an incomplete element
        if file.beyond and file.getbuffer()[128:132] == b"DICM":
            raise EOFError(_words(path, file)) from error
        if isinstance(error, OSError):    # comes from pydicom and is about the contents; the file itself was read
            raise ValueError(str(error)) from error
        raise
    if file.beyond > 1 or (file.beyond and not file.ends_between):
        raise EOFError(_words(path, file))
    return data


def _words(path: str | PathLike[str], file: _File) -> str:
    return f"{path}: ends too early, within an element, after {file.getbuffer().nbytes} bytes: copy or export it again"
