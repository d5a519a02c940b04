"""Contours on parallel slices: checks and repairs them, and converts them to polygons.

Coordinates are DICOM patient coordinates in mm: x points to the patient's left, y backward and z toward the head.
"""
import dataclasses
import functools
import itertools
import math
import statistics

import numpy as np
from shapely.geometry import MultiPolygon, Polygon
from shapely.validation import make_valid

SAME_SLICE = 0.1      # mm: contours whose z differs by less than this are on the same slice
OUT_OF_PLANE = 0.5    # mm, the points of a contour may differ in z by at most this
SPIKE = 0.5           # mm: parts narrower than twice this are taken for drawing errors
SPECK = 3.0           # mm^2: contours smaller than this are taken for drawing errors
INSIDE = 0.98         # a contour is a hole if at least this fraction of it lies inside another one
HOLE = 0.8            # but if it covers more than this fraction of the other one, it is the same contour drawn again
DOUBLED = 0.02        # contours that differ by less than this fraction of their area are copies of each other
MOST_OPEN = 0.1       # at most this fraction of the contours may be open
# A contour's points are out of order if they enclose less than this fraction of the area that they enclose when sorted by angle.
SCRAMBLED = 0.8


class Rings(list):
    """The rings of a region, as read from a structure set."""

    def __init__(self, rings=(), exclusive=False, left_open=()):
        super().__init__(rings)
        self.exclusive = exclusive           # true if overlaps follow the even-odd rule (DICOM's CLOSEDPLANAR_XOR)
        self.left_open = list(left_open)     # outlines that are not closed (OPEN_PLANAR) and enclose nothing


class Unusable(Exception):
    """Raised for input that cannot be meshed. The message names the region and the slice; --picture draws `rings`."""

    def __init__(self, roi, problem, z=None, rings=()):
        super().__init__(roi, problem, z, rings)    # pass on all arguments, because the exception is sent between processes
        self.rings = [np.asarray(ring, float) for ring in rings]

    def __str__(self):
        roi, problem, z, _ = self.args
        return f"region \"{roi}\"" + (f", slice z = {z:g} mm" if z is not None else "") + f": {problem}"


@dataclasses.dataclass
class Slice:
    z: float
    outline: MultiPolygon      # a valid geometry, with holes where outlines lie inside each other


@dataclasses.dataclass
class Stack:
    """The outlines of one organ, in ascending order of z; at least two slices."""
    name: str
    slices: list
    notes: list = dataclasses.field(default_factory=list)      # remarks about outlines that were left out
    left_out: list = dataclasses.field(default_factory=list)   # z of the slices that were left out

    @property
    def spacing(self):
        """Slice thickness, mm: the median distance between slices, because missing slices do not affect it."""
        return statistics.median(upper.z - lower.z for lower, upper in itertools.pairwise(self.slices))

    def volume(self):
        """Volume by planimetry, mm^3: the trapezoidal rule between slices, plus half a slice thickness beyond the first and last ones."""
        between = sum((lower.outline.area + upper.outline.area) / 2 * (upper.z - lower.z)
                      for lower, upper in itertools.pairwise(self.slices))
        return between + (self.slices[0].outline.area + self.slices[-1].outline.area) / 2 * self.spacing

    def is_tube(self):
        """Returns whether every slice has one outline without a hole."""
        return all(len(s.outline.geoms) == 1 and not s.outline.geoms[0].interiors for s in self.slices)


def polygons(shape):
    """Returns the polygons in a geometry returned by shapely, without points or lines."""
    if shape.geom_type == "Polygon":
        return [shape] if not shape.is_empty else []
    return [p for part in getattr(shape, "geoms", []) for p in polygons(part)]


def in_order_of_angle(points):
    middle = points.mean(axis=0)
    return points[np.argsort(np.arctan2(*(points - middle).T[::-1]), kind="stable")]


def clean_ring(points):
    """Returns the area inside a closed contour, regardless of its direction and starting point, or None if it is too small."""
    points = points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))]
    if len(points) > 1 and np.array_equal(points[0], points[-1]):
        points = points[:-1]
    if len(points) < 3:
        return None
    area = Polygon(points)
    if not area.is_valid:
        area = make_valid(area)
        ordered = Polygon(in_order_of_angle(points))
        if area.area < SCRAMBLED * ordered.area and ordered.is_valid:
            area = ordered
    area = area.buffer(-SPIKE).buffer(SPIKE)
    return MultiPolygon(polygons(area)) if area.area >= SPECK else None


def merge(areas):
    """Returns the area that all contours on a slice enclose, and whether any overlap. A much smaller contour inside another is a hole; other overlapping
    contours are united."""
    outer, inner, overlap = [], [], False
    for area in sorted(areas, key=lambda a: -a.area):
        apart, near = ([p for p in outer if p.intersects(area) == meets] for meets in (False, True))
        around = MultiPolygon(near)
        shared = around.intersection(area).area
        if shared >= INSIDE * area.area and area.area < HOLE * around.area:
            inner.append(area)
        elif around.symmetric_difference(area).area >= DOUBLED * area.area:
            overlap |= shared > SPECK
            outer = apart + polygons(around.union(area) if near else area)
    outer = MultiPolygon(outer)
    if inner:
        holes, overlap_inside = merge(inner)
        outer, overlap = outer.difference(holes), overlap or overlap_inside
    return large_enough(outer), overlap


def exclusive_or(areas):
    return large_enough(functools.reduce(lambda a, b: a.symmetric_difference(b), areas, MultiPolygon())), False


def large_enough(shape):
    return MultiPolygon([p for p in polygons(shape) if p.area >= SPECK])


def open_slices(roi, rings):
    """Returns a list with a remark if some contours are not closed. Raises Unusable if there are too many of them."""
    open_ = sorted(float(np.median(ring[:, 2])) for ring in getattr(rings, "left_open", []) if len(ring))
    if not open_:
        return []
    share, heights = len(open_) / (len(open_) + len(rings)), ", ".join(f"{z:g}" for z in open_)
    problem = f"{len(open_)} of {len(open_) + len(rings)} outlines ({100 * share:.0f} %) are open (OPEN_PLANAR) and enclose nothing, at z = {heights} mm"
    if share > MOST_OPEN:
        raise Unusable(roi, f"{problem}: close them", rings=rings.left_open)
    return [f"{problem}: left out, interpolated from neighbouring slices"]


def islands_left_out(z, rings):
    """Returns a list with a remark if some contours on a slice are left out while others are used."""
    if not rings:
        return []
    places = ", ".join(f"({x:.0f}, {y:.0f})" for x, y in (ring.mean(axis=0) + 0.0 for ring in rings))
    many = len(rings) > 1
    return [f"slice z = {z:g} mm: {len(rings)} outline{'s' * many} at {places} mm left out: {'each encloses' if many else 'it encloses'} less than {SPECK:g} mm^2, "
            f"or is thinner than {2 * SPIKE:g} mm"]


def build_stack(roi, rings):
    """Builds an organ's stack. rings: arrays of points (x, y, z), with slices in any order."""
    flat = []
    for ring in rings:
        ring = np.asarray(ring, float).reshape(-1, 3)
        if len(ring) == 0:
            continue
        if not np.all(np.isfinite(ring)):
            raise Unusable(roi, "a coordinate is not a number", rings=[ring])
        z = float(np.median(ring[:, 2]))
        if np.ptp(ring[:, 2]) > OUT_OF_PLANE:
            raise Unusable(roi, f"the outline is not in a plane z = const (its z spans {np.ptp(ring[:, 2]):.1f} mm): "
                           "export axial slices", z, [ring])
        flat.append((z, ring[:, :2]))
    flat.sort(key=lambda item: item[0])
    left_open = open_slices(roi, rings)
    combine = exclusive_or if getattr(rings, "exclusive", False) else merge
    slices, notes, left_out = [], [], []
    while flat:
        z = flat[0][0]
        here = [ring for height, ring in flat if height - z <= SAME_SLICE]
        flat = flat[len(here):]
        areas = [clean_ring(ring) for ring in here]
        outline, overlap = combine([area for area in areas if area is not None])
        if overlap:
            notes.append(f"slice z = {z:g} mm: outlines overlap: united")
        if outline.is_empty:
            notes.append(f"slice z = {z:g} mm left out: its outline encloses less than {SPECK:g} mm^2")
            left_out.append(z)
        else:
            slices.append(Slice(z, outline))
            notes += islands_left_out(z, [ring for ring, area in zip(here, areas) if area is None and len(ring) > 2])
    if len(slices) < 2:
        raise Unusable(roi, f"{len(slices)} usable slice{'s' * (len(slices) != 1)}: at least two are needed"
                       + "".join(f"; {note}" for note in notes), rings=rings)
    stack = Stack(roi, slices, notes + left_open, left_out)
    stack.notes += [f"no slice between z = {lower.z:g} and {upper.z:g} mm: interpolated"
                    for lower, upper in itertools.pairwise(slices) if upper.z - lower.z > 1.5 * stack.spacing]
    return stack


def even_points(polygon, count):
    """Returns `count` equally spaced points along the outer ring, counter-clockwise, starting in the +y direction from the centroid."""
    ring = np.array(polygon.exterior.coords)[:-1]
    if not polygon.exterior.is_ccw:
        ring = ring[::-1]
    closed = np.vstack([ring, ring[:1]])
    along = np.append(0, np.cumsum(np.hypot(*np.diff(closed, axis=0).T)))
    at = np.arange(count * 8) / (count * 8) * along[-1]
    dense = np.column_stack([np.interp(at, along, closed[:, axis]) for axis in (0, 1)])
    centre = np.array(polygon.centroid.coords[0])
    angle = np.arctan2(dense[:, 0] - centre[0], dense[:, 1] - centre[1])
    start = int(np.argmin(np.abs(angle)))
    return np.roll(dense, -start, axis=0)[::8]


def smooth_outline(polygon, count, harmonics):
    """Smooths a polygon by keeping only its first Fourier descriptors, and scales the result to the polygon's area."""
    points = even_points(polygon, 4 * count)
    spectrum = np.fft.fft(points[:, 0] + 1j * points[:, 1])
    frequency = np.fft.fftfreq(len(points), 1 / len(points))
    spectrum[np.abs(frequency) > harmonics] = 0
    curve = np.fft.ifft(spectrum)[::4]
    area = abs(0.5 * np.sum((curve.conj() * np.roll(curve, -1)).imag))
    curve = curve.mean() + (curve - curve.mean()) * math.sqrt(polygon.area / area)
    return np.column_stack([curve.real, curve.imag])
