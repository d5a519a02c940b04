"""Chooses the needle's path from the skin to the first region, avoiding bones."""
import dataclasses

import numpy as np
import vtk

from .shapes import shells
from .shapes.contours import Unusable

AHEAD = 1e-3            # m, distance between tip and skin before the insertion
NEEDLE = 0.2            # m, needle length in the scene, unless the target is too deep for it
LONGER, LONGEST = 0.05, 0.5     # m: for a deeper target, round the length up to a multiple of LONGER; more than LONGEST is an error
SAMPLES = 14            # samples along each side of a region's bounding box in the search for its deepest point
CANDIDATES = 400        # maximum number of entry points to try, nearest first
CLEARANCES = 4.0, 2.0, 0.0      # mm, clearances from obstacles, tried in this order
ALONG = 2.0             # mm, spacing of the points along a path at which to measure the clearance
FROM_CUT = 5.0          # mm: needles do not enter closer than this to a plane where the image cuts off the body
ASIDE = 3.0             # mm: use a region's centre as the target if it is at least this far from the region's surface and from regions to avoid
MOVED = 1.0             # mm: report an entry point that had to be moved farther than this
HOLES, HOLE_SPACING = 13, 5.0       # number of holes along each side of a template, and the distance between them in mm
THICKNESS = 20.0        # mm, thickness of a template
BEHIND = 5.0            # mm, gap between a template and the skin face of a box


@dataclasses.dataclass
class Path:
    """The needle's path, in DICOM coordinates, mm."""
    entry: np.ndarray        # on the skin
    target: np.ndarray
    notes: list = dataclasses.field(default_factory=list)


@dataclasses.dataclass
class Template:
    """A plate with HOLES x HOLES holes. Positions are in DICOM coordinates, mm."""
    origin: np.ndarray       # centre of the hole pattern, on the face through which needles enter
    normal: np.ndarray       # unit vector; needles pass in this direction

    def along(self):
        """Returns the direction in which columns are counted: from the patient's right (the operator's left) to left, as nearly as the plate's orientation
        permits."""
        left = np.array([1.0, 0, 0]) if abs(self.normal[0]) < 0.9 else np.array([0, 1.0, 0])
        left -= (left @ self.normal) * self.normal
        return left / np.linalg.norm(left)

    def rows_along(self):
        """Returns the direction in which rows are counted: from the patient's back to front."""
        return np.cross(self.along(), self.normal)

    def holes(self):
        """Returns the positions (n, 3) of the holes on the face where needles enter."""
        steps = HOLE_SPACING * (np.arange(HOLES) - (HOLES - 1) / 2)
        u, v = np.meshgrid(steps, steps)
        return self.origin + u.reshape(-1, 1) * self.along() + v.reshape(-1, 1) * self.rows_along()


def locator_of(shell):
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(shells.to_vtk(shell))
    locator.BuildLocator()
    return locator


def first_hit(shell, start, end):
    """Returns the point where a segment first meets a surface, or None."""
    return hit_in(locator_of(shell), start, end)


def hit_in(locator, start, end):
    share, point, local, sub = vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0)
    edge = 1e-6 * np.linalg.norm(end - start)     # tolerance, so that a segment cannot slip between two triangles
    met = locator.IntersectWithLine(list(map(float, start)), list(map(float, end)), edge, share, point, local, sub)
    return np.array(point) if met else None


class Obstacles:
    """Surfaces that a needle must not touch."""

    def __init__(self, found):
        self.found = [(shell, locator_of(shell), shell.points.min(axis=0), shell.points.max(axis=0)) for shell in found]

    def lets_pass(self, start, end, clearance):
        """Whether a needle from start to end keeps this clearance (mm) from all obstacles."""
        places = start + np.linspace(0, 1, 2 + int(np.linalg.norm(end - start) / ALONG))[:, None] * (end - start)
        low, high = places.min(axis=0) - clearance, places.max(axis=0) + clearance
        for shell, locator, least, greatest in self.found:
            if np.any(least > high) or np.any(greatest < low):
                continue
            if hit_in(locator, start, end) is not None or clearance and np.abs(shells.distances(shell, places)).min() < clearance:
                return False
        return True


def middle_of(surfaces, spared=()):
    """Picks a target in a region's largest part: its centre if that is at least ASIDE from the part's surface and from regions to avoid, otherwise the point
    farthest from all these surfaces. The part's surface includes those of cavities, such as lesions with a label of their own."""
    largest = max(surfaces, key=lambda shell: shell.volume())
    centre = largest.centre()
    low, high = largest.points.min(axis=0), largest.points.max(axis=0)
    beside = [shell for shell in spared if np.all(shell.points.min(axis=0) < high) and np.all(shell.points.max(axis=0) > low)]

    def room(points):
        """Returns the distance (mm) from each point to the nearest surface; negative outside the part or inside a region to avoid."""
        return np.min([-shells.distances(largest, points), *(shells.distances(shell, points) for shell in beside)], axis=0)
    if room(centre[None])[0] > ASIDE:
        return centre
    grid = np.stack(np.meshgrid(*(np.linspace(a, b, SAMPLES) for a, b in zip(low, high))), axis=-1).reshape(-1, 3)
    places = np.vstack([centre, grid])
    return places[np.argmax(room(places))]


def nearest_free(target, places, bones, spared=()):
    """From the skin points `places`, picks the one nearest the target whose straight path misses all bone and, if possible, the surfaces `spared`, with the
    largest clearance that works. Returns that point and whether its path crosses a spared surface, or None if there is no such point. spared: closed
    surfaces that do not contain the target."""
    order = np.argsort(np.linalg.norm(places - target, axis=1), kind="stable")
    order = order[::1 + len(order) // CANDIDATES]
    for others in (spared, ()) if spared else ((),):
        obstacles = Obstacles([*bones, *others])
        for clearance in CLEARANCES:
            for k in order:
                if obstacles.lets_pass(places[k], target, clearance):
                    return places[k], bool(spared) and not others
    return None


def note_of(through):
    return ["every path leads through regions that a needle should avoid: choose one with --entry and --target"] if through else []


def through_skin(target, skin, bones, spared=(), cut=None):
    """Returns the path from the nearest suitable point on the skin. Skin, bones and spared regions are closed surfaces. cut: function that returns the
    distances (mm) of points (n, 3) from the planes where the image cuts off the body, because those are not skin."""
    places = np.vstack([shell.points for shell in skin])
    if cut:
        places = places[cut(places) > FROM_CUT]
        if not len(places):
            raise Unusable("needle", "the image cuts off the body on all sides, so that it has no skin: leave --skin out")
    found = nearest_free(target, places[::1 + len(places) // 20000], bones, spared)
    if found is None:
        raise Unusable("needle", "bones block every path from the skin: choose one with --entry and --target")
    return Path(found[0], target, note_of(found[1]))


def through_template(template, target, bones):
    """Chooses the nearest template hole whose path misses all bone. Returns the point on that path BEHIND mm beyond the template, and the point on it nearest
    to the target."""
    holes = template.holes()
    ahead = (target - holes) @ template.normal
    least = THICKNESS + BEHIND
    if ahead.max() < least:
        raise Unusable("needle", f"the template's holes do not lead to the target: it is {ahead.max():.0f} mm beyond the face where needles enter: turn --template")
    targets = holes + ahead[:, None] * template.normal
    obstacles = Obstacles(bones)
    order = np.argsort(np.linalg.norm(targets - target, axis=1), kind="stable")
    chosen = next((k for k in order if obstacles.lets_pass(holes[k], targets[k], 0.0)), order[0])
    aside = np.linalg.norm(targets[chosen] - target)
    if aside > HOLES * HOLE_SPACING:
        raise Unusable("needle", f"the template's nearest hole passes the target {aside:.0f} mm aside: move --template")
    return holes[chosen] + least * template.normal, targets[chosen]


def on_skin(skin, entry, target):
    """Returns the point where the path from a template hole first meets the skin."""
    way = (target - entry) / np.linalg.norm(target - entry)
    met = [point for point in (first_hit(shell, entry - (BEHIND - 1e-3) * way, target) for shell in skin) if point is not None]
    if not met:
        raise Unusable("needle", "the path through the template does not meet the skin: it starts in the body, or leads past it: move --template")
    return min(met, key=lambda point: (point - entry) @ way)


def through_face(target, low, high, bones, face, spared=()):
    """Finds the path through one face of a box that misses all bone and is as nearly perpendicular to the face as possible. face: axis, and side (-1 low,
    1 high). Returns the path and whether it crosses spared regions, or None if there is no such path."""
    axis, side = face
    aside = [a for a in range(3) if a != axis]
    grid = np.meshgrid(*(np.linspace(low[a] + 5, high[a] - 5, 15) for a in aside))
    places = np.empty((1 + grid[0].size, 3))
    places[0] = target
    places[1:, aside] = np.column_stack([each.ravel() for each in grid])
    places[:, axis] = (low if side < 0 else high)[axis]
    found = nearest_free(target, places, bones, spared)
    return None if found is None else (Path(found[0], target, note_of(found[1])), found[1])


def orientation(direction):
    """Returns the unit quaternion (w, x, y, z) of the smallest rotation that takes +z to this direction."""
    x, y, z = direction
    if z < -1 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + z, -y, x, 0.0])
    return q / np.linalg.norm(q)


@dataclasses.dataclass
class Start:
    """Initial pose and length of the needle in the mesh frame, m."""
    position: np.ndarray     # position of the needle's base
    orientation: np.ndarray  # w, x, y, z
    entry: np.ndarray        # entry point on the skin of the mesh
    depth: float             # how far a scripted motion must push the needle for its tip to reach the target
    remark: str = ""
    length: float = NEEDLE   # length of the needle
    misses: bool = False     # true if the needle misses the region, or if bone is in its way


def needle_for(skin, target, plate=None):
    """Returns how far a scripted motion must push the needle, and the needle length that keeps its base in front of the template, both in m. plate: a point on
    the template's entry face, or None."""
    deep, way = np.linalg.norm(target - skin), (target - skin) / np.linalg.norm(target - skin)
    push = AHEAD + deep
    ahead = max(0.0, (skin - plate) @ way) if plate is not None else 0.0
    length = max(NEEDLE, LONGER * np.ceil((push + ahead) / LONGER - 1e-9))
    if length > LONGEST:
        before = f", that is {1e3 * ahead:.0f} mm beyond the template" if ahead else ""
        raise Unusable("needle", f"its target is {1e3 * deep:.0f} mm below the skin{before}, and no needle is longer than {1e3 * LONGEST:g} mm: "
                       f"move {'--template' if ahead else '--entry'} or --target")
    return push, length


def start_in(mesh, entry, target, gland, plate=None):
    """Returns the Start from which the needle goes straight through `entry` to `target` (m). gland: name of the first region; plate: see needle_for."""
    way = (target - entry) / np.linalg.norm(target - entry)
    skin = first_hit(mesh.surfaces["skin"], entry - 0.3 * way, target)
    every = [first_hit(shell, entry - 0.3 * way, target) for name, shell in mesh.surfaces.items() if name not in ("skin",)]
    before = [point for point in every if point is not None and (skin is None or (point - skin) @ way < -1e-6)]
    if skin is None or before:
        raise Unusable("needle", "the line from --entry to --target does not meet the mesh's skin first: move the entry, raise --margin, "
                       "or take the patient's own skin with --skin")
    push, length = needle_for(skin, target, plate)
    met = first_hit(mesh.boundary(gland), skin, skin + push * way)
    depth = f"meets {gland} {1e3 * np.linalg.norm(met - skin):.0f} mm below the skin" if met is not None else f"does not meet {gland}"
    bone = first_hit(mesh.surfaces["bone"], skin, target) if "bone" in mesh.surfaces else None
    if bone is not None:
        depth += f"; bone is in its way after {1e3 * np.linalg.norm(bone - skin):.0f} mm: choose the path with --entry and --target"
    return Start(skin - (length + AHEAD) * way, orientation(way), skin, push, depth, length, met is None or bone is not None)


def check_template(template, skin):
    """Raises Unusable if the skin is in front of the template or inside it. skin: the point where the needle enters the skin, DICOM mm."""
    ahead = (skin - template.origin) @ template.normal
    if ahead < THICKNESS:
        raise Unusable("needle", f"the skin is {ahead:.0f} mm beyond the face of the template where needles enter, which is {THICKNESS:g} mm thick: move --template back")
