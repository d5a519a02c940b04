"""Reads DICOM files by pydicom, which takes a file that ends too early for a shorter one.

Also `trocar._dicom` in the Python package.
"""
from __future__ import annotations

import io
import os
import zlib
from os import PathLike

import pydicom


class _File(io.BytesIO):
    """A file's content. `beyond`: how often more was read than there is."""

    beyond = 0
    ends_between = False    # the last of these reads began at the end

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size:
            self.beyond += 1
            self.ends_between = not data
        return data


def read(path: str | PathLike[str]) -> pydicom.Dataset:
    """The data set of a file. EOFError, which names the file, if it ends within an element; OSError if it cannot be opened; else what pydicom raises.

    pydicom looks for another element at the end of a complete file, once, and finds nothing. Any other read beyond the end was for something that the file
    announces. Elements of the highest level that a file lacks because it ends between two of them are not noticed.
    """
    if os.path.exists(path) and not os.path.isfile(path):    # a FIFO would wait for ever
        raise OSError(0, "not a regular file", path)
    with open(path, "rb") as source:
        file = _File(source.read())
    try:
        data = pydicom.dcmread(file)
    except zlib.error as error:    # in a deflated transfer syntax
        raise EOFError(f"{path}: its compressed content ends too early, or is damaged: {error}") from error
    except Exception as error:    # whatever half an element makes pydicom raise
        if file.beyond and file.getbuffer()[128:132] == b"DICM":
            raise EOFError(_words(path, file)) from error
        if isinstance(error, OSError):    # pydicom's, about the content: the file itself has been read
            raise ValueError(str(error)) from error
        raise
    if file.beyond > 1 or (file.beyond and not file.ends_between):
        raise EOFError(_words(path, file))
    return data


def _words(path: str | PathLike[str], file: _File) -> str:
    return f"{path}: ends too early, within an element, after {file.getbuffer().nbytes} bytes: copy or export it again"
