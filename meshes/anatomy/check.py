"""Loads the finished scene with the library that will run it, so that the program does not report success for a scene that doesn't work."""
import sys

from . import binding, limits
from .shapes.contours import Unusable

WHOLE = 10000               # nodes: for larger meshes, skip the inverse, which would take minutes to compute


def load(path, nodes):
    """Raises Unusable if the library cannot build a model from the scene. If the library is missing, only prints a message."""
    try:
        trocar = binding.trocar()
    except ImportError as error:
        print(f"anatomy: the scene was not tested: {error}: install python3-trocar, or in a checkout build the library with scripts/build demo", file=sys.stderr)
        return
    said = limits.run("loading the scene", refused, trocar, path, nodes > WHOLE)
    if said:
        raise Unusable("scene", f"the library rejects the scene: {said}")


def refused(trocar, path, mesh_only):
    """Returns the error message with which the library rejects a scene, or "" if it accepts it."""
    try:
        trocar.Model(trocar.Scene.load(path), mesh_only=mesh_only)
    except trocar.Error as error:
        if error.status == "no memory":
            raise MemoryError(str(error)) from error
        return str(error)
    return ""
