#!/usr/bin/python3
"""Makes labels and a mesh of a male pelvis with Gmsh (Debian: python3-numpy, and for the mesh python3-gmsh, python3-vtk9).

The shapes are simple, with the sizes of an adult's organs; PARAMETERS.md gives the source of each size. Nothing was measured on a patient, and nothing is
random: the same options give the same files. OUTPUT.msh is the mesh, in metres. OUTPUT.seg.nrrd holds the same regions as a label map in patient
coordinates, for scripts/anatomy and 3D Slicer.

Frame (mm): x points to the patient's right, y to the front and z from the perineum (z = 0) to the head. The template's middle hole is at x = y = 0.
"""
import argparse
import math

import numpy as np

from anatomy.trials.nrrd import write_nrrd

SIDE, BACK, FRONT = 60.0, -80.0, 60.0      # half the distance between the bony side walls; y of the sacrum; y of the front face
ABOVE = 25.0                     # thickness of the tissue above the bladder
SKIN = 6.0                       # thickness of the skin and the tissue bonded to it
MIDDLE, HALF = (0.0, 0.0, 55.0), (24.0, 17.0, 20.0)                # centre and half axes of the gland
RECTUM = (0.0, -32.5), 7.0, 4.0  # axis, radius of the content, thickness of the wall
WITH_PROBE = (0.0, -35.5), 10.5, 3.5
NECK = 70.5                      # z of the bladder's lowest point
# for each bladder filling (ml): half axes of the content, wall thickness, and y of the centre
BLADDER = {60: ((30.0, 24.0, 20.0), 4.5, 8.0), 150: ((36.0, 30.0, 33.2), 3.5, 14.0), 300: ((39.0, 30.0, 61.3), 3.0, 14.0)}
SEAM = 1.0                       # rad; rotates the seams of adjacent round surfaces apart, because seams close together would force small elements
HOLLOW = "pubis", "lumen"        # regions without tissue
GLAND = "prostate", "transition_zone"      # parts of the gland; its capsule has holes for the urethra
WALLS = "bladder", "rectum"      # regions whose outer surface is a named group


# ---- shapes: each is a set of points, for labels, and a solid of Gmsh's geometry kernel --------------------------------------------------

class Ellipsoid:
    """An ellipsoid. lean: angle by which its z axis leans to the right, rad."""

    def __init__(self, centre, half, lean=0.0):
        self.centre, self.half, self.lean = centre, half, lean

    def contains(self, x, y, z):
        x, y, z = (value - middle for value, middle in zip((x, y, z), self.centre))
        c, s = math.cos(self.lean), math.sin(self.lean)
        return sum((value / half) ** 2 for value, half in zip((c * x - s * z, y, s * x + c * z), self.half)) < 1

    def solids(self, occ):
        made = [(3, occ.addSphere(*self.centre, 1.0))]
        occ.rotate(made, *self.centre, 0, 0, 1, SEAM)
        occ.dilate(made, *self.centre, *self.half)
        occ.rotate(made, *self.centre, 0, 1, 0, self.lean)
        return made


class Gland:
    """An ellipsoid with a blunt base. At a distance t from the centre (as a fraction of the half length), the width is the maximum width times
    sqrt(1 - t^3) on the base side and sqrt(1 - t^2) on the apex side."""

    @staticmethod
    def section(t):
        return np.sqrt(np.clip(1 - np.where(t > 0, np.abs(t) ** 3, t ** 2), 0, 1))

    def contains(self, x, y, z):
        x, y, t = ((value - middle) / half for value, middle, half in zip((x, y, z), MIDDLE, HALF))
        return (np.abs(t) < 1) & (x ** 2 + y ** 2 < self.section(t) ** 2)

    def solids(self, occ):
        angle = np.linspace(0, math.pi, 25)      # 0 at the apex, pi at the base
        t = -np.cos(angle)
        ring = [occ.addPoint(radius, 0, height) for radius, height in zip(self.section(t), t)]
        face = occ.addPlaneSurface([occ.addCurveLoop([occ.addBSpline(ring), occ.addLine(ring[-1], ring[0])])])
        made = [pair for pair in occ.revolve([(2, face)], 0, 0, 0, 0, 0, 1, 2 * math.pi) if pair[0] == 3]
        occ.rotate(made, 0, 0, 0, 0, 0, 1, 2 * SEAM)
        occ.dilate(made, 0, 0, 0, *HALF)
        occ.translate(made, *MIDDLE)
        return made


class Cylinder:
    def __init__(self, start, end, radius):
        self.start, self.way, self.radius = np.array(start, float), np.subtract(end, start), radius

    def contains(self, x, y, z):
        offset = [value - start for value, start in zip((x, y, z), self.start)]
        along = sum(o * w for o, w in zip(offset, self.way)) / (self.way @ self.way)
        return (along > 0) & (along < 1) & (sum((o - along * w) ** 2 for o, w in zip(offset, self.way)) < self.radius ** 2)

    def solids(self, occ):
        return [(3, occ.addCylinder(*self.start, *self.way, self.radius))]


class Tube:
    """A tube of constant radius along a Bezier curve."""

    def __init__(self, points, radius):
        self.points, self.radius = np.array(points, float), radius

    def curve(self, t):
        degree = len(self.points) - 1
        return sum(math.comb(degree, k) * np.multiply.outer(t ** k * (1 - t) ** (degree - k), point) for k, point in enumerate(self.points))

    def contains(self, x, y, z):
        found, joints = np.zeros(np.broadcast_shapes(x.shape, y.shape, z.shape), bool), self.curve(np.linspace(0, 1, 41))
        for start, end in zip(joints, joints[1:]):
            found |= Cylinder(start, end, self.radius).contains(x, y, z)
        return found

    def solids(self, occ):
        path = occ.addWire([occ.addBezier([occ.addPoint(*point) for point in self.points])])
        first, way = self.points[0], self.points[1] - self.points[0]
        disk = [(2, occ.addDisk(0, 0, 0, self.radius, self.radius))]
        occ.rotate(disk, 0, 0, 0, *np.cross([0, 0, 1], way), math.acos(way[2] / np.linalg.norm(way)))
        occ.translate(disk, *first)
        return [pair for pair in occ.addPipe(disk, path) if pair[0] == 3]


class Box:
    def __init__(self, low, high):
        self.low, self.high = low, high

    def contains(self, x, y, z):
        inside = True
        for value, low, high in zip((x, y, z), self.low, self.high):
            inside = inside & (value > low) & (value < high)
        return inside

    def solids(self, occ):
        return [(3, occ.addBox(*self.low, *np.subtract(self.high, self.low)))]


class Prism:
    """A prism between two heights whose base is a convex polygon (x, y)."""

    def __init__(self, corners, low, high):
        self.corners, self.low, self.high = corners, low, high

    def contains(self, x, y, z):
        inside = (z > self.low) & (z < self.high)
        for (ax, ay), (bx, by) in zip(self.corners, self.corners[1:] + self.corners[:1]):
            inside = inside & ((bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0)
        return inside

    def solids(self, occ):
        points = [occ.addPoint(x, y, self.low) for x, y in self.corners]
        face = occ.addPlaneSurface([occ.addCurveLoop([occ.addLine(a, b) for a, b in zip(points, points[1:] + points[:1])])])
        return [pair for pair in occ.extrude([(2, face)], 0, 0, self.high - self.low) if pair[0] == 3]


class Funnel:
    """An elliptical cone around the axis x = 0, y = `middle`, with half axes `narrow` at height `low` and `wide` at height `high`."""

    def __init__(self, middle, low, narrow, high, wide):
        self.middle, self.low, self.narrow, self.high, self.wide = middle, low, narrow, high, wide

    def contains(self, x, y, z):
        t = (z - self.low) / (self.high - self.low)
        a, b = (n + t * (w - n) for n, w in zip(self.narrow, self.wide))
        return (t > 0) & (t < 1) & ((x / a) ** 2 + ((y - self.middle) / b) ** 2 < 1)

    def solids(self, occ):
        def ring(z, half):      # Gmsh requires the longer half axis first
            loop = occ.addEllipse(0, 0, 0, half[1], half[0])
            occ.rotate([(1, loop)], 0, 0, 0, 0, 0, 1, math.pi / 2)
            occ.translate([(1, loop)], 0, self.middle, z)
            return occ.addWire([loop])
        return [pair for pair in occ.addThruSections([ring(self.low, self.narrow), ring(self.high, self.wide)], makeRuled=True) if pair[0] == 3]


class Region:
    """The union of `shapes`, minus `removed` and minus all regions before it in the list. thin: the region's thickness, if elements must be that small.
    beside: names of earlier regions that straddle its border; they are cut out first, because otherwise the surfaces would split each other."""

    def __init__(self, name, shapes, removed=(), thin=None, beside=()):
        self.name, self.shapes, self.removed, self.thin, self.beside = name, list(shapes), list(removed), thin, list(beside)

    def contains(self, x, y, z):
        inside = np.any(np.broadcast_arrays(*(shape.contains(x, y, z) for shape in self.shapes)), axis=0)
        for shape in self.removed:
            inside = inside & ~shape.contains(x, y, z)
        return inside


def right_and_left(make, start, end, *more):
    """Returns a shape on the right and its mirror image on the left."""
    mirror = np.array([-1, 1, 1])
    return [make(start, end, *more), make(mirror * start, mirror * end, *more)]


def sides(low, high):
    """Returns a box on the right and its mirror image on the left."""
    return [Box(low, high), Box((-high[0], *low[1:]), (-low[0], *high[1:]))]


def block(filling):
    """Returns the low and high corners of the block of tissue."""
    half, wall, _ = BLADDER[filling]
    return (-SIDE, BACK, 0.0), (SIDE, FRONT, NECK + 2 * (half[2] + wall) + ABOVE)


def regions(filling=60, probe=False):
    """Returns the regions in order of priority: where regions overlap, the earlier one wins."""
    half, wall, front = BLADDER[filling]
    centre = 0.0, front, NECK + wall + half[2]
    axis, radius, thick = WITH_PROBE if probe else RECTUM
    low, high = block(filling)
    bottom, top = (-1.0, 100.0) if probe else (14.0, 122.0)      # z of the lumen's ends
    narrow = 21.0 if probe else 17.0        # the probe pushes the levator aside
    inner = Funnel(-12.0, 25.0, (narrow, 46.0), 60.0, (33.0, 56.0))
    outer = Funnel(-12.0, 25.0, (narrow + 6.0, 52.0), 60.0, (39.0, 62.0))
    urogenital = [(-6, 29), (-34, -4), (-32, -18), (32, -18), (34, -4), (6, 29)]
    return [
        Region("pubis", [Ellipsoid((0, 39, 50), (20, 10, 20)), *right_and_left(Cylinder, (8, 38, 58), (72, 34, 84), 8.0),
                         *right_and_left(Cylinder, (8, 38, 40), (50, -4, 19), 6.5)]),
        Region("lumen" if probe else "rectal_content", [Cylinder((*axis, bottom), (*axis, top), radius)]),
        Region("urine", [Ellipsoid(centre, half)]),
        Region("urethra", [Tube([(0, 3, 84), (0, -2, 52), (0, 0, 28), (0, 4, 9.5)], 4.0)], thin=2.2, beside=["urine"]),
        Region("transition_zone", [Ellipsoid((0, 2, 56), (15, 10, 14))], thin=3.6, beside=["urethra"]),
        Region("prostate", [Gland()], beside=["urethra"]),
        Region("seminal_vesicles", [Ellipsoid((side * 17, -18.5, 82), (5.0, 4.0, 17.0), side * 1.0) for side in (1, -1)], thin=2.0),
        Region("bladder", [Ellipsoid(centre, [a + wall for a in half])], thin=wall, beside=["urethra", "prostate"]),
        Region("rectum", [Cylinder((*axis, SKIN), (*axis, top + 6.0), radius + thick)], thin=thick),
        Region("levator_ani", [outer, *sides((26, -40, 54), (43, 18, 60))], [inner, Box((-SIDE, 26, 0), (SIDE, FRONT, 100))], thin=6.0),
        Region("pelvic_floor", [Prism(urogenital, 14.0, 25.0), Cylinder((*axis, SKIN), (*axis, 21.0), radius + thick + 5.0)], beside=["urethra"]),
        Region("obturator_internus", sides((43, -50, 36), (SIDE, 20, 100))),
        Region("fat", [Box((*low[:2], SKIN), high)]),
        Region("perineum", [Box(low, (*high[:2], SKIN))]),
    ]


# ---- labels --------------------------------------------------------------------------------------------------------------------------------

def labels(found, low, high, step):
    """Rasterises the regions. Returns labels (k, j, i), which are 1 + the index of the region or 0 for none, and the voxel positions along each axis."""
    axes = [np.arange(a + step / 2, b, step) for a, b in zip(low, high)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij", sparse=True)
    label = np.zeros((len(axes[2]), len(axes[1]), len(axes[0])), np.uint8)
    for number, region in enumerate(found, 1):
        label[(label == 0) & region.contains(x, y, z)] = number
    return label, axes


def write_labels(path, names, label, axes, step):
    """Writes a 3D Slicer segmentation. This converts to patient coordinates, which point to the left, back and head."""
    place = np.diag([step, step, step, 1.0])
    place[:3, 3] = -axes[0][-1], -axes[1][-1], axes[2][0]
    write_nrrd(path, label[:, ::-1, ::-1], place, dict(enumerate(names, 1)))


# ---- mesh -----------------------------------------------------------------------------------------------------------------------------------

def build(gmsh, found):
    """Builds the geometry in Gmsh's current model. Returns the region name of each volume, {tag: name}."""
    occ, solids = gmsh.model.occ, {}
    for region in found:
        made = [pair for shape in region.shapes for pair in shape.solids(occ)]
        if len(region.shapes) > 1:
            made = occ.fuse(made[:1], made[1:])[0]
        if region.removed:
            made = occ.cut(made, [pair for shape in region.removed for pair in shape.solids(occ)])[0]
        if region.beside:
            made = occ.cut(made, [pair for name in region.beside for pair in solids[name]], removeTool=False)[0]
        solids[region.name] = made
    inputs = [(name, pair) for name, made in solids.items() for pair in made]
    pieces = occ.fragment([pair for _, pair in inputs], [])[1]
    owner = {}
    for (name, _), made in reversed(list(zip(inputs, pieces))):
        owner.update({pair: name for pair in made})      # higher-priority regions come later and overwrite the others
    hollow = [pair for pair, name in owner.items() if name in HOLLOW]
    occ.remove(hollow, recursive=True)
    occ.synchronize()
    return {tag: name for (dimension, tag), name in owner.items() if name not in HOLLOW}


def name_groups(gmsh, volumes, names, low, high):
    """Creates named groups for regions and surfaces. A surface between two regions belongs to the one with higher priority."""
    groups, order = {}, list(names)
    for tag, name in volumes.items():
        groups.setdefault((3, name), []).append(tag)
    ends = {(axis, round(end)): "fixed" for corner in (low, high) for axis, end in enumerate(corner)} | {(2, round(low[2])): "skin"}
    for _, tag in gmsh.model.getEntities(2):
        beside = [volumes[volume] for volume in gmsh.model.getAdjacencies(2, tag)[0]]
        if len(beside) == 1:
            box = gmsh.model.getBoundingBox(2, tag)
            flat = [ends.get((axis, round(box[axis]))) for axis in range(3) if abs(box[axis + 3] - box[axis]) < 1e-3]
            groups.setdefault((2, next(filter(None, flat), "lumen" if beside[0] == "rectum" else "bone")), []).append(tag)
        elif len(set(beside)) == 2:
            top, below = sorted(beside, key=order.index)
            if top in GLAND and below not in GLAND:
                groups.setdefault((2, "capsule"), []).append(tag)
            elif top in WALLS:
                groups.setdefault((2, top + "_wall"), []).append(tag)
    for number, ((dimension, name), tags) in enumerate(sorted(groups.items(), key=lambda item: -item[0][0]), 1):
        gmsh.model.addPhysicalGroup(dimension, tags, number)
        gmsh.model.setPhysicalName(dimension, number, name)


def sizes(gmsh, volumes, found, high):
    """Returns a factory for Gmsh size callbacks. The element size is `fine` in the gland and grows to `ratio` times that at the corners of the block, but
    never exceeds `sheet` times the thickness of a thin region."""
    thin = {region.name: region.thin for region in found}
    limit = {}
    for dimension, tag in gmsh.model.getEntities():
        if dimension >= 2:
            beside = [tag] if dimension == 3 else gmsh.model.getAdjacencies(2, tag)[0]
            limit[dimension, tag] = min([thin[volumes[volume]] for volume in beside if thin[volumes[volume]]], default=math.inf)
    for _, tag in gmsh.model.getEntities(1):
        limit[1, tag] = min([limit[2, face] for face in gmsh.model.getAdjacencies(1, tag)[0]], default=math.inf)
    reach, corner = max(HALF), math.dist(MIDDLE, (SIDE, FRONT, high[2]))

    def size(fine, ratio, sheet):
        def at(dimension, tag, x, y, z, *_):
            away = max(0.0, math.dist((x, y, z), MIDDLE) - reach)
            growth = fine * (1 + (ratio - 1) * away / (corner - reach))
            return min(growth, sheet * limit.get((dimension, tag), math.inf))
        return at
    return size


def generate(gmsh, low, high):
    """Generates the mesh, then moves nodes of flat tetrahedra to improve their angles."""
    from anatomy import relocate, session
    from anatomy.shapes.shells import Shell
    gmsh.model.mesh.clear()
    gmsh.model.mesh.generate(3)
    for _ in range(3):
        gmsh.model.mesh.optimize("")
        gmsh.model.mesh.optimize("Relocate3D")
    mesh, _ = session.current_mesh()
    tags = gmsh.model.mesh.getNodes()[0]
    at = np.zeros(int(tags.max()) + 1, int)
    at[tags] = np.arange(len(tags))
    mesh.surfaces["all"] = Shell(mesh.points, at[gmsh.model.mesh.getElementsByType(2)[1]].reshape(-1, 3))
    still = np.any((mesh.points < np.array(low) + 1e-3) | (mesh.points > np.array(high) - 1e-3), axis=1)
    for tag, point, old in zip(tags, relocate.relocated(mesh, still), mesh.points):
        if np.any(point != old):
            gmsh.model.mesh.setNode(tag, point, [])
    return mesh


def write_mesh(path, found, low, high, given):
    import gmsh      # imported here, because labels need only NumPy
    from anatomy import session
    session.start()
    gmsh.model.add("pelvis")
    volumes = build(gmsh, found)
    name_groups(gmsh, volumes, [region.name for region in found], low, high)
    size = sizes(gmsh, volumes, found, high)
    gmsh.model.mesh.setSizeCallback(size(given.fine, given.ratio, given.sheet))
    mesh = generate(gmsh, low, high)
    print(f"{path}: {len(np.unique(mesh.tets))} nodes, {len(mesh.tets)} tetrahedra")
    gmsh.option.setNumber("Mesh.ScalingFactor", 1e-3)
    gmsh.write(path)
    gmsh.finalize()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("output", help="prefix of the files: OUTPUT.seg.nrrd and OUTPUT.msh")
    parser.add_argument("--filling", type=int, choices=BLADDER, default=60, help="ml in the bladder (default 60)")
    parser.add_argument("--probe", action="store_true", help="open the rectum for an ultrasound probe of 10 mm radius")
    parser.add_argument("--fine", type=float, default=7.2, metavar="MM", help="size of the elements in the gland (default 7.2)")
    parser.add_argument("--ratio", type=float, default=4.0, help="size of the elements at the corners, relative to those in the gland (default 4)")
    parser.add_argument("--sheet", type=float, default=1.9, help="size of the elements in thin regions, relative to their thickness (default 1.9)")
    parser.add_argument("--step", type=float, default=1.0, metavar="MM", help="size of the voxels (default 1)")
    parser.add_argument("--labels-only", action="store_true", help="do not make a mesh")
    given = parser.parse_args()
    found, (low, high) = regions(given.filling, given.probe), block(given.filling)
    write_labels(given.output + ".seg.nrrd", [region.name for region in found], *labels(found, low, high, given.step), given.step)
    if not given.labels_only:
        write_mesh(given.output + ".msh", found, low, high, given)


if __name__ == "__main__":
    main()
