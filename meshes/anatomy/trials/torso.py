"""A synthetic upper abdomen with TotalSegmentator's labels: liver with lesions, its neighbours, ribs, spine, and the body around them. The shapes are simple,
with roughly the sizes of an adult's organs. Nothing was measured on a person."""
import numpy as np

NAMES = {1: "spleen", 2: "kidney_right", 3: "kidney_left", 4: "gallbladder", 5: "liver", 6: "stomach", 7: "pancreas", 11: "lung_lower_lobe_left",
         14: "lung_lower_lobe_right", 18: "small_bowel", 20: "colon", 31: "vertebrae_L1", 32: "vertebrae_T12", 33: "vertebrae_T11", 34: "vertebrae_T10",
         35: "vertebrae_T9", 52: "aorta", 63: "inferior_vena_cava", 86: "autochthon_left", 87: "autochthon_right",
         # labels of TotalSegmentator's task "total", version 2
         **{91 + k: f"rib_left_{k}" for k in (7, 8, 9, 10)}, **{103 + k: f"rib_right_{k}" for k in (7, 8, 9, 10)}}
BODY, LESIONS = "body_trunc", "liver_lesions"        # label names of the tasks "body" and "liver_lesions"
LOW, HIGH = np.array([-170.0, -115.0, -100.0]), np.array([170.0, 115.0, 100.0])      # mm, LPS, corners of the image
TRUNK = 155.0, 102.0                                 # mm, half axes of the body
WALL = 143.0, 90.0                                   # mm, half axes of the ellipse along which the ribs lie
LIVER = -62.0, -12.0, 5.0                            # mm, centre of the liver
SLOPE = 0.35                                         # slope of a rib, downward from back to front
LESION = np.array([-88.0, -18.0, 8.0])               # mm, centre of the first lesion


class Grid:
    """Positions of the voxels, mm."""

    def __init__(self, spacing, low=LOW, high=HIGH):
        axes = [np.arange(a, b, s) for a, b, s in zip(low, high, spacing)]
        self.z, self.y, self.x = np.meshgrid(*axes[::-1], indexing="ij", sparse=True)
        self.place = np.diag([*map(float, spacing), 1.0])
        self.place[:3, 3] = [axis[0] for axis in axes]
        self.shape = tuple(len(axis) for axis in axes[::-1])

    def ellipsoid(self, middle, half):
        return sum(((c - m) / h) ** 2 for c, m, h in zip((self.x, self.y, self.z), middle, half)) < 1

    def rod(self, start, end, radius):
        """Returns a cylinder with rounded ends."""
        way = np.subtract(end, start)
        offset = [c - s for c, s in zip((self.x, self.y, self.z), start)]
        along = np.clip(sum(o * w for o, w in zip(offset, way)) / (way @ way), 0, 1)
        return sum((o - along * w) ** 2 for o, w in zip(offset, way)) < radius ** 2


def rib(grid, side, top, radius=5.5):
    """Returns a rib, which runs from beside the spine around the flank to the front. side: -1 right, 1 left; top: height of the rib at the back."""
    a, b = WALL
    angle = np.arctan2(grid.y / b, side * grid.x / a)        # 0 at the flank, 90 degrees at the back
    offset = np.hypot(grid.x / a, grid.y / b) - 1
    height = grid.z - (top - SLOPE * (b - b * np.sin(angle)))
    wall = offset * (a * b) / np.hypot(a * np.sin(angle), b * np.cos(angle))
    return (wall ** 2 + (0.7 * height) ** 2 < radius ** 2) & (angle < 1.35) & (angle > -0.9)


def lesion_places(count):
    """Returns centres of lesions in the liver, mm, at least 16 mm apart: the first is LESION."""
    random, found = np.random.default_rng(7), [LESION]
    while len(found) < count:
        place = np.array(LIVER) + random.uniform(-1, 1, 3) * [62, 45, 48]
        inside = (((place - LIVER) / [66, 48, 50]) ** 2).sum() < 1
        if inside and min(np.linalg.norm(place - other) for other in found) > 16:
            found.append(place)
    return found


def torso(spacing=(3.0, 3.0, 3.0), lesions=1, radius=8.0):
    """Returns the labels (see NAMES) as an array (k, j, i), masks of the lesions and of the body, and the transform (4, 4) from voxels to mm, LPS. As in
    TotalSegmentator's files, the lesions are inside the liver, and its label includes their voxels."""
    g = Grid(spacing)
    body = (np.hypot(g.x / TRUNK[0], g.y / TRUNK[1]) < 1) & (g.z > -1e3)
    labels = np.zeros(g.shape, np.uint8)

    def put(name, mask):
        labels[np.broadcast_to(mask, g.shape) & body & (labels == 0)] = next(value for value, called in NAMES.items() if called == name)
    for number, name in enumerate(("T9", "T10", "T11", "T12", "L1")):
        top = 80 - 40 * number
        put("vertebrae_" + name, (np.hypot(g.x / 22, (g.y - 55) / 18) < 1) & (np.abs(g.z - top) < 18.5))
        put("vertebrae_" + name, g.rod([0, 60, top], [0, 88, top - 12], 5.0) | g.rod([-30, 75, top], [30, 75, top], 5.0))
    for k in (7, 8, 9, 10):
        for side, word in ((-1, "right"), (1, "left")):
            put(f"rib_{word}_{k}", rib(g, side, 88 - 27 * (k - 7)))
    liver = g.ellipsoid(LIVER, (72, 62, 58)) | g.ellipsoid((0, -35, 22), (55, 35, 30))
    put("gallbladder", g.ellipsoid((-48, -45, -44), (12, 22, 16)))
    put("kidney_right", g.ellipsoid((-62, 48, -52), (27, 26, 45)) & ~g.ellipsoid((-44, 44, -52), (12, 10, 14)))
    put("kidney_left", g.ellipsoid((62, 48, -42), (27, 26, 45)) & ~g.ellipsoid((44, 44, -42), (12, 10, 14)))
    put("inferior_vena_cava", g.rod([-22, 26, -100], [-22, 20, 100], 10.0))
    put("aorta", g.rod([12, 28, -100], [10, 28, 100], 10.0))
    put("liver", liver)
    put("spleen", g.ellipsoid((100, 30, 20), (28, 38, 48)))
    put("stomach", g.ellipsoid((58, -35, 15), (42, 36, 46)))
    put("pancreas", g.rod([-25, -8, -40], [60, 12, -18], 11.0))
    put("lung_lower_lobe_right", g.ellipsoid((-72, 15, 150), (62, 62, 98)))
    put("lung_lower_lobe_left", g.ellipsoid((72, 15, 150), (58, 62, 98)))
    for middle in ((0, -50, -75), (30, -55, -60), (55, -45, -85)):
        put("small_bowel", g.ellipsoid(middle, (26, 22, 18)))
    put("colon", g.rod([-95, 5, -100], [-92, -10, -62], 18.0) | g.rod([100, 10, -100], [98, 0, -50], 18.0))
    for x, word in ((-38, "right"), (38, "left")):
        put(f"autochthon_{word}", (np.hypot((g.x - x) / 24, (g.y - 78) / 14) < 1) & (g.z > -1e3))
    inside = np.zeros(g.shape, bool)
    for place in lesion_places(lesions):
        inside |= g.ellipsoid(place, [radius] * 3)
    return labels, inside & (labels == 5), np.broadcast_to(body, g.shape).copy(), g.place
