"""Exceptions for bad files, and imports of packages that only some files need."""
import importlib


class BadFile(Exception):
    """Raised if a file cannot be used. The text names the file and, if possible, the position in it."""


class Empty(BadFile):
    """Raised if a label map contains no labels."""


def needed(module, package, path):
    """Imports and returns a module that is needed only for one kind of file."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadFile(f"{path}: reading it needs Python's {module}: apt install {package} ({error})") from error
