"""Finds the Python package trocar, either in a build tree or among the installed packages."""
import glob
import os
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
BUILD = os.path.join(HERE, "../../build")
PREFIX = os.path.join(HERE, "../../../lib")     # lib folder when installed under a prefix that Python does not search


def trocar(build=None):
    """Imports the trocar module from the build folder `build` (default: the checkout's) if it is there, otherwise as installed. TROCAR_LIBRARY overrides the
    library. Raises ImportError if the module or its library is missing."""
    build = build or BUILD
    for package, *patterns in ((f"{build}/clients/python", f"{build}/core/libtrocar.so"),
                               (f"{PREFIX}/python3/dist-packages", f"{PREFIX}/*/libtrocar.so.*.*", f"{PREFIX}/libtrocar.so.*.*")):
        libraries = [path for pattern in patterns for path in sorted(glob.glob(pattern))]
        if libraries and os.path.isdir(f"{package}/trocar"):
            sys.path[:0] = [package] if package not in sys.path else []
            os.environ.setdefault("TROCAR_LIBRARY", libraries[0])
            break
    try:
        import trocar as module
    except OSError as error:    # raised if the library is missing
        raise ImportError(str(error)) from error
    return module
