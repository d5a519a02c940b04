"""A synthetic patient: contours of the prostate, urethra, rectum, bladder and pubic arch, defined by a few lengths.

Nothing here was measured on a person. The lengths are within the ranges published for men with prostate cancer (15 to 120 ml
glands, width : height : length about 1.35 : 1 : 1.15). The shapes are made up: a gland that is narrower at the apex than at the
base, flattened and dented by the rectum behind it, and an arch of two rami that meet in the symphysis.
"""
import dataclasses
import math

import contourpy
import numpy as np


@dataclasses.dataclass
class Gland:
    volume: float = 34e3        # mm^3
    width: float = 1.35         # width relative to the height
    length: float = 1.15        # length relative to the height
    apex: float = 0.25          # narrowing toward the apex; 0 gives a symmetric gland
    dent: float = 0.18          # depth of the rectum's indentation, as a fraction of the half height
    tilt: float = 0.10          # backward tilt of the axis toward the base
    lean: float = 0.0           # sideways tilt of the axis, like `tilt`
    lobes: float = 0.0          # fraction by which the right side is enlarged and the left side reduced
    arch_gap: float = 7.0       # mm, distance between the gland's front and the symphysis
    arch_angle: float = 84.0    # deg, angle between the rami
    half: tuple = None          # mm: half width, half height, half length, computed from the others

    def __post_init__(self):
        shape = Section(self, (self.width, 1.0, self.length))
        relative = sum(shape.area(z) for z in np.linspace(-self.length, self.length, 201)) * 2 * self.length / 200
        height = (self.volume / relative) ** (1 / 3)
        self.half = (self.width * height, height, self.length * height)


class Section:
    """The gland's outlines at height z above its centre; half axes in any unit."""
    EXPONENT = 2.2              # exponent of the superellipse; 2 is an ellipse

    def __init__(self, gland, half):
        self.gland, self.half = gland, half

    def outline(self, z, count=90):
        gland, (a, b, c) = self.gland, self.half
        s = z / c
        if abs(s) >= 1:
            return np.zeros((0, 2))
        radius = math.sqrt(1 - s * s) * (1 + gland.apex * 0.5 * (s - 0.2))
        angle = 2 * math.pi * np.arange(count) / count
        cosine, sine = np.cos(angle), np.sin(angle)
        r = (np.abs(cosine / a) ** self.EXPONENT + np.abs(sine / b) ** self.EXPONENT) ** (-1 / self.EXPONENT) * radius
        r = r * (1 - gland.lobes * cosine) * (1 - gland.dent * np.exp(-((angle - math.pi / 2) / 0.5) ** 2))
        return np.column_stack([r * cosine + gland.lean * z, r * sine + gland.tilt * z])

    def area(self, z):
        ring = self.outline(z)
        x, y = ring.T if len(ring) else (np.zeros(1), np.zeros(1))
        return 0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def arch_depth(gland, x, y, z):
    """Returns the signed distance from the pubic arch, mm, negative inside. The arch consists of two rami, 14 mm thick, from the symphysis."""
    top = np.array([0.0, -(gland.half[1] + gland.arch_gap + 7), -gland.half[2] + 6])
    opening = math.radians(gland.arch_angle / 2)
    way = 42 * np.array([math.sin(opening), math.cos(opening), -0.5])
    depth = np.inf
    for side in (1, -1):
        axis = way * [side, 1, 1]
        offset = np.stack([x - top[0], y - top[1], z - top[2]], axis=-1)
        along = np.clip(offset @ axis / (axis @ axis), 0, 1)
        depth = np.minimum(depth, np.linalg.norm(offset - along[..., None] * axis, axis=-1) - 7.0)
    return depth


def arch_outlines(gland, z):
    x, y = np.linspace(-60, 60, 121), np.linspace(-70, 50, 121)
    values = arch_depth(gland, *np.meshgrid(x, y), np.full((121, 121), z))
    return [line for line in contourpy.contour_generator(x, y, values).lines(0.0) if len(line) > 8]


def circle(x, y, radius, count=48):
    angle = 2 * math.pi * np.arange(count) / count
    return np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle)])


def outlines(gland, spacing=5.0, offset=0.5):
    """Returns ROI name -> list of (n, 3) rings, mm, DICOM patient coordinates with the gland's centre at the origin;
    slices at multiples of `spacing`, shifted by the fraction `offset` of it."""
    a, b, c = gland.half
    section = Section(gland, gland.half)
    rois = {"Prostate": [], "Urethra": [], "Rectum": [], "Bladder": [], "Pubic arch": []}

    def add(roi, z, ring):
        if len(ring):
            rois[roi].append(np.column_stack([ring, np.full(len(ring), z)]))
    count = int(80 / spacing)
    for z in (np.arange(-count, count + 1) + offset) * spacing:
        if section.area(z) > 20:
            add("Prostate", z, section.outline(z))
        if abs(z) < c + 8:
            add("Urethra", z, circle(gland.lean * z, gland.tilt * z - 0.1 * b + 0.004 * z * z, 3.0, 24))
            add("Rectum", z, circle(0, b * (1 - gland.dent) + 14.5 + max(gland.tilt, 0) * c + 0.004 * z * z, 11.0))
        top = z - (c + 14)
        if abs(top) < 17:
            add("Bladder", z, circle(0, -6 + gland.tilt * c, 1.6 * math.sqrt(18 ** 2 - top ** 2)))
        for ring in arch_outlines(gland, z):
            add("Pubic arch", z, ring)
    return rois


def random_gland(random):
    """Returns a random gland for the stress test: 15 to 120 ml, asymmetric."""
    return Gland(volume=1e3 * math.exp(random.uniform(math.log(15), math.log(120))), width=random.uniform(1.1, 1.6),
                 length=random.uniform(0.9, 1.4), apex=random.uniform(0.0, 0.6), dent=random.uniform(0.0, 0.3),
                 tilt=random.uniform(-0.1, 0.3), lean=random.uniform(-0.12, 0.12), lobes=random.uniform(-0.12, 0.12),
                 arch_angle=random.uniform(70, 95), arch_gap=random.uniform(4, 10))


def spoil(rings, random, noise):
    """Adds typical defects to contours: noise (mm) that varies over about 5 mm along the contour, different starting points, directions and numbers of points,
    repeated closing points, spikes, missing slices and duplicate contours."""
    spoilt = []
    last = len(rings) - 1
    for i, ring in enumerate(rings):
        if 0 < i < last and random.uniform() < 0.08:
            continue
        count = int(random.integers(14, 90))
        at = np.sort(random.choice(len(ring), min(count, len(ring)), replace=False))
        points = ring[at].copy()
        centre = points.mean(axis=0)
        angle = np.arctan2(*(points - centre)[:, 1::-1].T)
        wobble = sum(random.normal() * np.cos(k * angle + random.uniform(0, 6.3)) for k in range(1, 12)) / math.sqrt(5.5)
        outward = (points - centre)[:, :2] / np.linalg.norm((points - centre)[:, :2], axis=1, keepdims=True)
        points[:, :2] += noise * (wobble[:, None] * outward + 0.3 * random.normal(size=(len(points), 2)))
        if random.uniform() < 0.15:
            k = int(random.integers(1, len(points)))
            spike = points[k] + [*(random.uniform(4, 9) * outward[k]), 0]
            points = np.insert(points, k, [points[k], spike], axis=0)
        points = np.roll(points, int(random.integers(len(points))), axis=0)
        if random.uniform() < 0.5:
            points = points[::-1]
        if random.uniform() < 0.5:
            points = np.vstack([points, points[:1]])
        spoilt.append(points)
        if random.uniform() < 0.05:
            spoilt.append(points.copy())
    return spoilt
