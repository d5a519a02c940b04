"""libtrocar.so through cffi: the declarations come from the header that the build copies into this folder."""
import os
import re
from pathlib import Path
from typing import Any

from cffi import FFI


def _declarations(header: str) -> str:
    """The header without comments, preprocessor lines and attributes, which cffi's parser does not support."""
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
    lib = ffi.dlopen(os.environ.get("TROCAR_LIBRARY", name))
    if lib.trocar_version() // 100 != 100 * number["MAJOR"] + number["MINOR"]:
        raise ImportError("%s is version %d, the module needs %d.%d" % (name, lib.trocar_version(), number["MAJOR"], number["MINOR"]))
    return ffi, lib


ffi, lib = _load()


class Error(Exception):
    """The library's message; `status` is "bad input", "no memory", "numeric" or "system"."""

    def __init__(self, text: str, status: str):
        super().__init__(text)
        self.status = status


Error.__module__ = "trocar"  # where it is imported from


_STATUS = ("ok", "bad input", "no memory", "numeric", "system")


def _check(status: int, why: Any) -> None:
    if status != lib.TROCAR_OK:
        raise Error(ffi.string(why.text).decode(errors="replace"), _STATUS[status])
