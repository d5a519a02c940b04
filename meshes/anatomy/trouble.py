"""What can be wrong with a file, and packages that only some files need."""
import importlib


class BadFile(Exception):
    """The text names the file and, if possible, the place in it."""


class Empty(BadFile):
    """A label map without a label."""


def needed(module, package, path):
    """A module that only this kind of file needs."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise BadFile(f"{path}: reading it needs Python's {module}: apt install {package} ({error})") from error
