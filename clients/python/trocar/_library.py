"""Loads libtrocar.so through cffi, with the declarations from trocar.h, which the build copies into this folder."""
from __future__ import annotations

import logging
import os
import re
import threading
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Callable, Iterator

from cffi import FFI


def _declarations(header: str) -> str:
    """Strips comments, preprocessor lines and attributes from the header: cffi's parser does not support them."""
    text = re.sub(r"/\*.*?\*/", "", header, flags=re.S)
    text = re.sub(r'#ifdef __cplusplus\n.*?#endif', "", text, flags=re.S)
    text = re.sub(r"^#.*$", "", text, flags=re.M)
    return text.replace("TROCAR_API ", "")


def _load():
    ffi = FFI()
    header = Path(__file__).with_name("trocar.h").read_text()
    ffi.cdef(_declarations(header))
    number = {name: int(value) for name, value in re.findall(r"#define TROCAR_(MAJOR|MINOR|PATCH) (\d+)", header)}
    name = "libtrocar.so.%d.%d" % (number["MAJOR"], number["MINOR"])
    included = Path(__file__).with_name("libraries") / name    # in a wheel
    lib = ffi.dlopen(os.environ.get("TROCAR_LIBRARY", str(included) if included.exists() else name))
    if lib.trocar_version() // 100 != 100 * number["MAJOR"] + number["MINOR"]:
        raise ImportError("%s is version %d, the module needs %d.%d" % (name, lib.trocar_version(), number["MAJOR"], number["MINOR"]))
    return ffi, lib


ffi, lib = _load()


class Error(Exception):
    """An error reported by the library, with its message; `status` is "bad input", "no memory", "numeric", "system" or "cancelled"."""

    def __init__(self, text: str, status: str):
        super().__init__(text)
        self.status = status

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.status)


Error.__module__ = "trocar"  # the module from which users import the class


_STATUS = ("ok", "bad input", "no memory", "numeric", "system", "no real time", "cancelled")


def _check(status: int, why: Any) -> None:
    if status != lib.TROCAR_OK:
        raise Error(ffi.string(why.text).decode(errors="replace"), _STATUS[status])


@ffi.callback("void(int32_t, const char *, void *)")
def _write_log(level: int, message: Any, _: Any) -> None:
    """Implements trocar_log.write: passes the library's messages to the logger "trocar"."""
    logging.getLogger("trocar").log(logging.WARNING if level >= lib.TROCAR_LOG_WARNING else logging.INFO, "%s", ffi.string(message).decode(errors="replace"))


class _Turn:
    """A non-blocking reader-writer lock for a library object, because calls into the library release the GIL. A thread that does not get the lock gets
    an Error."""

    def __init__(self, what: str):
        self._what, self._lock = what, threading.Lock()
        self._readers, self._counting = 0, threading.Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise Error("this %s is in use: another thread or a callback is calling it at the same time; make one for each thread" % self._what, "bad input")

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextmanager
    def to_read(self) -> Iterator[None]:
        with self._counting:
            if self._readers == 0:
                self.__enter__()
            self._readers += 1
        try:
            yield
        finally:
            with self._counting:
                self._readers -= 1
                if self._readers == 0:
                    self._lock.release()


class _Watch:
    """Lets a long library call report its progress to `progress(what, fraction)`. The call is aborted if `progress` or a signal handler raises an
    exception, so Ctrl-C works."""

    def __init__(self, progress: Callable[[str, float], Any] | None):
        self._raised: BaseException | None = None
        self.told = ffi.NULL
        if progress is not None:
            tell = progress
            self.told = ffi.callback("void(const char *, double, void *)", lambda what, fraction, _: tell(ffi.string(what).decode(), fraction) and None,
                                     onerror=self._note)
        self.asked = ffi.callback("int(void *)", lambda _: int(self._raised is not None), error=1, onerror=self._note)
        self.pointer = ffi.new("trocar_watch *", {"progress": self.told, "cancelled": self.asked})

    def _note(self, _: type[BaseException], raised: BaseException, __: TracebackType | None) -> None:
        self._raised = self._raised or raised

    def check(self, status: int, why: Any) -> None:
        if self._raised is not None:
            raise self._raised
        _check(status, why)
