"""Errors of files, and packages that only some files need."""
import importlib


class BadFile(Exception):
    """A file is bad. The text names the file and, if possible, the position in it."""


class Empty(BadFile):
    """A label map contains no label."""


def needed(module, package, path):
    """Imports a module that only this kind of file needs."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadFile(f"{path}: reading it needs Python's {module}: apt install {package} ({error})") from error
