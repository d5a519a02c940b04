"""Where the needle goes in: from the skin toward the first region, past the bones."""
import dataclasses

import numpy as np
import vtk

from . import shells
from .contours import Unusable

AHEAD = 1e-3            # m from the tip to the skin before the insertion
NEEDLE = 0.2            # m, length of the scene's needle, unless the target is deeper:
LONGER, LONGEST = 0.05, 0.5     # then it has the next multiple of this, up to that
PUSH = 0.066            # m that the scripts of trocar-device insert the needle unless the scene says more
BEYOND = 0.010          # m past the target: tissue gives way before the tip
SAMPLES = 14            # along each side of a region's box, to find its deepest point
CANDIDATES = 400        # entries that are tried, nearest first
FAR = 1e3               # mm: longer than any path
HOLES, HOLE_SPACING = 13, 5.0       # of a template, along each side; mm
THICKNESS = 20.0        # mm, of a template
BEHIND = 5.0            # mm from a template to the skin of a box


@dataclasses.dataclass
class Path:
    """DICOM mm."""
    entry: np.ndarray        # on the skin
    target: np.ndarray
    chosen: bool             # by the user

    def direction(self):
        way = self.target - self.entry
        return way / np.linalg.norm(way)


@dataclasses.dataclass
class Template:
    """A plate with HOLES x HOLES holes. DICOM mm."""
    origin: np.ndarray       # the middle of the holes, on the face where needles enter
    normal: np.ndarray       # unit; needles pass in this direction

    def along(self):
        """Columns are counted to the patient's right, as far as the plate's direction lets them."""
        right = np.array([-1.0, 0, 0]) if abs(self.normal[0]) < 0.9 else np.array([0, -1.0, 0])
        right -= (right @ self.normal) * self.normal
        return right / np.linalg.norm(right)

    def holes(self):
        """(n, 3) on the front face."""
        steps = HOLE_SPACING * (np.arange(HOLES) - (HOLES - 1) / 2)
        u, v = np.meshgrid(steps, steps)
        return self.origin + u.reshape(-1, 1) * self.along() + v.reshape(-1, 1) * np.cross(self.normal, self.along())


def locator_of(shell):
    locator = vtk.vtkStaticCellLocator()
    locator.SetDataSet(shells.to_vtk(shell))
    locator.BuildLocator()
    return locator


def first_hit(shell, start, end):
    """Point where a segment first meets a surface, or None."""
    return hit_in(locator_of(shell), start, end)


def hit_in(locator, start, end):
    share, point, local, sub = vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0)
    edge = 1e-6 * np.linalg.norm(end - start)     # a tolerance, or segments slip through between two triangles
    met = locator.IntersectWithLine(list(map(float, start)), list(map(float, end)), edge, share, point, local, sub)
    return np.array(point) if met else None


def middle_of(surfaces):
    """The centre of a region's largest part if it is inside, else its deepest point."""
    largest = max(surfaces, key=lambda shell: shell.volume())
    centre = largest.centre()
    if shells.distances(largest, centre[None])[0] < 0:
        return centre
    low, high = largest.points.min(axis=0), largest.points.max(axis=0)
    grid = np.stack(np.meshgrid(*(np.linspace(a, b, SAMPLES) for a, b in zip(low, high))), axis=-1).reshape(-1, 3)
    return grid[np.argmin(shells.distances(largest, grid))]


def is_free(locators, start, end):
    return all(hit_in(locator, start, end) is None for locator in locators)


def nearest_free(target, places, bones):
    """The nearest of some places on the skin from which the way to the target meets no bone, or None."""
    order = np.argsort(np.linalg.norm(places - target, axis=1))
    locators = [locator_of(bone) for bone in bones]
    for k in order[::1 + len(order) // CANDIDATES]:
        if is_free(locators, places[k], target):
            return places[k]
    return None


def through_skin(target, skin, bones):
    """The path from the nearest place of the skin. Skin, bones: closed surfaces."""
    places = np.vstack([shell.points for shell in skin])
    entry = nearest_free(target, places[::1 + len(places) // 20000], bones)
    if entry is None:
        raise Unusable("needle", "bones are in the way from everywhere on the skin: say where it goes in, with --entry and --target")
    return Path(entry, target, False)


def through_template(template, target, bones):
    """Where the needle leaves a template for the skin, and the point of its way nearest to the target. Of the holes whose way there meets no bone, the nearest."""
    holes = template.holes()
    ahead = (target - holes) @ template.normal
    least = THICKNESS + BEHIND
    if ahead.max() < least:
        raise Unusable("needle", f"the template's holes do not lead to the target: it is {ahead.max():.0f} mm beyond the face where needles enter: turn --template")
    targets = holes + ahead[:, None] * template.normal
    locators = [locator_of(bone) for bone in bones]
    order = np.argsort(np.linalg.norm(targets - target, axis=1), kind="stable")
    chosen = next((k for k in order if is_free(locators, holes[k], targets[k])), order[0])
    aside = np.linalg.norm(targets[chosen] - target)
    if aside > HOLES * HOLE_SPACING:
        raise Unusable("needle", f"the template's nearest hole passes the target {aside:.0f} mm aside: move --template")
    return holes[chosen] + least * template.normal, targets[chosen]


def on_skin(skin, entry, target):
    """Where the way from before a template's hole first meets the skin."""
    way = (target - entry) / np.linalg.norm(target - entry)
    met = [point for point in (first_hit(shell, entry - (BEHIND - 1e-3) * way, target) for shell in skin) if point is not None]
    if not met:
        raise Unusable("needle", "the way through the template does not meet the skin: it starts in the body, or leads past it: move --template")
    return min(met, key=lambda point: (point - entry) @ way)


def through_face(target, low, high, bones, face):
    """The path through a face of a box (axis, and side: -1 low, 1 high) on which no bone is in the way: straight, or with the least tilt; or None."""
    axis, side = face
    aside = [a for a in range(3) if a != axis]
    grid = np.meshgrid(*(np.linspace(low[a] + 5, high[a] - 5, 15) for a in aside))
    places = np.empty((1 + grid[0].size, 3))
    places[0] = target
    places[1:, aside] = np.column_stack([each.ravel() for each in grid])
    places[:, axis] = (low if side < 0 else high)[axis]
    entry = nearest_free(target, places, bones)
    return None if entry is None else Path(entry, target, False)


def orientation(direction):
    """Unit quaternion w, x, y, z that turns +z into this direction, by the least angle."""
    x, y, z = direction
    if z < -1 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + z, -y, x, 0.0])
    return q / np.linalg.norm(q)


@dataclasses.dataclass
class Start:
    """Of the needle in the mesh's frame, m."""
    position: np.ndarray     # of the base
    orientation: np.ndarray  # w, x, y, z
    entry: np.ndarray        # on the mesh's skin
    remark: str
    depth: float = PUSH      # that a scripted motion must push the needle to come to the target
    length: float = NEEDLE   # of the needle
    misses: bool = False     # the region, or bone is in the way


def needle_for(skin, target, plate=None):
    """How deep a scripted motion must push the needle, and its length, so that its base stays before the template. All m. `plate`: a point of
    the template's face where needles enter, or None."""
    deep, way = np.linalg.norm(target - skin), (target - skin) / np.linalg.norm(target - skin)
    push = max(PUSH, AHEAD + deep + BEYOND)
    ahead = max(0.0, (skin - plate) @ way) if plate is not None else 0.0
    length = max(NEEDLE, LONGER * np.ceil((push + ahead) / LONGER - 1e-9))
    if length > LONGEST:
        before = f", that is {1e3 * ahead:.0f} mm beyond the template" if ahead else ""
        raise Unusable("needle", f"its target is {1e3 * deep:.0f} mm below the skin{before}, and no needle is longer than {1e3 * LONGEST:g} mm: "
                       f"move {'--template' if ahead else '--entry'} or --target")
    return push, length


def start_in(mesh, entry, target, gland, plate=None):
    """The pose from which the needle goes straight through `entry` to `target` (m); `gland`: name of the first region; `plate`: see needle_for."""
    way = (target - entry) / np.linalg.norm(target - entry)
    skin = first_hit(mesh.surfaces["skin"], entry - 0.3 * way, target)
    every = [first_hit(shell, entry - 0.3 * way, target) for name, shell in mesh.surfaces.items() if name not in ("skin",)]
    before = [point for point in every if point is not None and (skin is None or (point - skin) @ way < -1e-6)]
    if skin is None or before:
        raise Unusable("needle", "the line from --entry to --target does not come through the mesh's skin first: move the entry, raise --margin, "
                       "or take the patient's own skin with --skin")
    push, length = needle_for(skin, target, plate)
    met = first_hit(mesh.boundary(gland), skin, skin + push * way)
    depth = f"meets {gland} {1e3 * np.linalg.norm(met - skin):.0f} mm below the skin" if met is not None else f"does not meet {gland}"
    bone = first_hit(mesh.surfaces["bone"], skin, target) if "bone" in mesh.surfaces else None
    if bone is not None:
        depth += f"; bone is in its way after {1e3 * np.linalg.norm(bone - skin):.0f} mm: choose the way with --entry and --target"
    return Start(skin - (length + AHEAD) * way, orientation(way), skin, depth, push, length, met is None or bone is not None)


def check_template(template, skin):
    """`skin`: where the needle enters it, DICOM mm."""
    ahead = (skin - template.origin) @ template.normal
    if ahead < THICKNESS:
        raise Unusable("needle", f"the skin is {ahead:.0f} mm beyond the face of the template where needles enter, which is {THICKNESS:g} mm thick: move --template back")
