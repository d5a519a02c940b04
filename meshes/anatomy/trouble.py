"""Exceptions for bad files, and imports of packages that only some files need."""
import importlib


class BadFile(Exception):
    """Raised if a file cannot be used. The message names the file and, if possible, the position in it."""


class Empty(BadFile):
    """Raised if a label map contains no labels."""


def needed(module, package, path):
    """Imports a module that only one kind of file needs, and returns it."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadFile(f"{path}: reading it needs Python's {module}: apt install {package} ({error})") from error
