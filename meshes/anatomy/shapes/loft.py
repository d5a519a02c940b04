"""Makes a smooth surface through an organ's contours: an OpenCASCADE loft, triangulated by Gmsh."""
import gmsh
import numpy as np

from .. import limits, session
from . import contours
from .shells import Shell, oriented

POINTS, HARMONICS = 24, 6     # points and harmonics in a contour's spline; higher harmonics are taken for tremor of the hand that drew it
QUARTERS = 4                  # splines per section; a single closed spline would give a periodic face, which is hard to mesh
END = 0.8                     # size of the end section, half a slice thickness beyond the last slice, relative to that slice
ERROR = 0.05                  # a loft whose volume is off by more than this fraction has folded onto itself
FINE = 1 / 24                 # edge of a triangle, relative to the organ's longest side


def wire(points, z):
    occ = gmsh.model.occ
    tags = [occ.addPoint(x, y, z) for x, y in points]
    tags.append(tags[0])
    step = POINTS // QUARTERS
    return occ.addWire([occ.addSpline(tags[k:k + step + 1]) for k in range(0, POINTS, step)])


def sections(stack):
    """Returns (points, z) of the sections, from bottom to top."""
    outlines = [(contours.smooth_outline(s.outline.geoms[0], POINTS, HARMONICS), s.z) for s in stack.slices]

    def end(outline, z):
        centre = outline.mean(axis=0)
        return centre + END * (outline - centre), z
    return [end(outlines[0][0], outlines[0][1] - stack.spacing / 2), *outlines,
            end(outlines[-1][0], outlines[-1][1] + stack.spacing / 2)]


def is_closed(shell):
    edges = np.sort(np.concatenate([shell.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    return len(shell.triangles) > 0 and np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)


def triangulate(stack):
    occ = gmsh.model.occ
    occ.addThruSections([wire(*section) for section in sections(stack)], makeSolid=True, makeRuled=False, maxDegree=3)
    occ.synchronize()
    low, high = np.array(gmsh.model.getBoundingBox(-1, -1)).reshape(2, 3)
    for option in ("MeshSizeMin", "MeshSizeMax"):
        gmsh.option.setNumber("Mesh." + option, FINE * (high - low).max())
    gmsh.model.mesh.generate(2)
    return mesh_shell()


def mesh_shell():
    """Returns the triangles of Gmsh's current model."""
    tags, flat, _ = gmsh.model.mesh.getNodes()
    at = np.zeros(int(tags.max()) + 1, int)
    at[tags] = np.arange(len(tags))
    corners = at[gmsh.model.mesh.getElementsByType(2)[1]].reshape(-1, 3)
    used, numbers = np.unique(corners, return_inverse=True)
    return oriented(Shell(flat.reshape(-1, 3)[used], numbers.reshape(-1, 3)))


def of_stack(stack):
    """Returns the closed surface, or None if the contours branch or the loft folds; use `field` in that case."""
    if not stack.is_tube():
        return None
    try:
        shell = limits.run(f"loft of {stack.name}", lofted, stack)
    except limits.TooLong:      # no fallback here, because the result must not depend on the machine's speed
        raise
    except Exception:  # Gmsh raises no more specific class
        return None
    sound = is_closed(shell) and abs(shell.volume() / stack.volume() - 1) < ERROR
    return shell if sound else None


def lofted(stack):
    """Makes the loft; runs in a separate process."""
    session.start()
    gmsh.model.add("loft")
    return triangulate(stack)
