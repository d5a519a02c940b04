"""Regions that touch or contain each other, as one complex of surfaces: the boundary between two regions is one shared surface.

The regions' surfaces are drawn into a label image, small gaps are closed, and CGAL extracts the surfaces between labels. A correction then
moves the shared points to restore the regions' volumes.
"""
import collections
import dataclasses

import numpy as np
import pygalmesh
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from . import field, shells
from .shells import Shell

MOST_VOXELS = 4e6
VOXELS_PER_EDGE = 6.0       # edge length of the surface triangles
VOXELS_PER_RADIUS = 2.5     # of the thinnest region
FLATNESS = 0.3              # of the thinnest region's radius: largest distance of a facet from its surface
FLATNESS_OF_EDGE = 0.1      # of the edge of a triangle: lower bound of that distance
CLOSE_VOXELS = 3.0          # smaller gaps between regions are closed, because the facets on both sides would cross
CLEAR = 2.9                 # least number of voxels between parts that do not touch
AROUND = 255                # CGAL's label for the surroundings: its tetrahedra there detect thin parts
THIN = 1.5                  # radii: size of the tetrahedra in a region thinner than the edge of a triangle
SMALL = 0.8                 # of the edge of a triangle: smaller tetrahedra get a layer of this size around them
REFINEMENTS = 6             # attempts at thin regions
MARGIN = 0.5                # of the edge of a triangle: from the regions to the image's border
FINER = 0.85                # ratio of their sizes between attempts
MOST_MISSING = 0.01         # of a region's surface
MOST_PLACES = 4000          # of a region's surface that are checked for this
REACH = 20                  # voxels around a cluster that are searched for the next one
FACET_ANGLE = 25.0          # deg: CGAL's surface refinement ends for up to 30
CIRCUMRADIUS = 0.6          # of the edge of a triangle: equilateral ones have 0.577
CORRECTIONS = 8             # Newton steps towards the volumes; three are enough as a rule
UNFOLDINGS = 6              # attempts at volumes without crossing surfaces
MOST_THIN = 0.10            # of a region: if more than that is thin, it keeps its thin parts
FINE = 100                  # voxels along a surface that crosses itself
OUTSIDE = -1                # of the cells: the tissue around


@dataclasses.dataclass
class Complex:
    """Triangles between cells; a cell is a connected part of a region, or a void enclosed by regions."""
    points: np.ndarray       # (n, 3)
    triangles: np.ndarray    # (m, 3), normals from the first to the second cell
    sides: np.ndarray        # (m, 2) the cells on either side: index into `cells`, or OUTSIDE
    cells: list              # number of each cell's region

    def volume_gradient(self, region):
        """Volume of all cells of a region, and its derivative with respect to the points."""
        gradient, volume = np.zeros_like(self.points), 0.0
        mine = np.append(np.array(self.cells) == region, False)     # the last is OUTSIDE
        sign = mine[self.sides[:, 0]].astype(float) - mine[self.sides[:, 1]]
        used = sign != 0
        a, b, c = (self.points[self.triangles[used, k]] for k in range(3))
        middle = self.points.mean(axis=0)
        volume = (sign[used] * np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle))).sum() / 6
        normal = sign[used, None] * np.cross(b - a, c - a) / 6
        for k in range(3):
            np.add.at(gradient, self.triangles[used, k], normal)
        return volume, gradient

    def volume(self, region):
        return self.volume_gradient(region)[0]

    def areas(self):
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def surface(self, region):
        """The triangles around all cells of a region, normals outward."""
        mine = np.append(np.array(self.cells) == region, False)
        first, second = mine[self.sides[:, 0]], mine[self.sides[:, 1]]
        return Shell(self.points, np.vstack([self.triangles[first & ~second], self.triangles[second & ~first][:, ::-1]]))


@dataclasses.dataclass
class Image:
    """Labels on a grid: 0 is no region."""
    low: np.ndarray      # (3,) centre of the first voxel
    step: float
    labels: np.ndarray   # (z, y, x) uint8

    def volume(self, label):
        return float(np.count_nonzero(self.labels == label)) * self.step ** 3


def drawn(shell, image):
    """Mask of the voxels enclosed by a closed surface."""
    size = image.labels.shape[::-1]
    stencil = vtk.vtkPolyDataToImageStencil()
    stencil.SetInputData(shells.to_vtk(shell))
    stencil.SetOutputOrigin(*image.low)
    stencil.SetOutputSpacing(image.step, image.step, image.step)
    stencil.SetOutputWholeExtent(0, size[0] - 1, 0, size[1] - 1, 0, size[2] - 1)
    inside = vtk.vtkImageStencilToImage()
    inside.SetInputConnection(stencil.GetOutputPort())
    inside.SetInsideValue(1)
    inside.SetOutsideValue(0)
    inside.SetOutputScalarTypeToUnsignedChar()
    inside.Update()
    return vtk_to_numpy(inside.GetOutput().GetPointData().GetScalars()).reshape(image.labels.shape) > 0


def winding(shell, low, step, size):
    """Winding number of a surface around each voxel of a grid (z, y, x): 0 is outside, even if parts overlap or are inverted."""
    points = (shell.points - low) / step + [1.23e-5, 2.34e-5, 0]    # so that no vertex lies on a column's line
    steps = np.zeros((size[0], size[1], size[2] + 1), np.int32)
    a, b, c = (points[shell.triangles[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    twice = ab[:, 0] * ac[:, 1] - ac[:, 0] * ab[:, 1]
    first = np.ceil(np.minimum(np.minimum(a, b), c)[:, :2]).astype(int)
    last = np.floor(np.maximum(np.maximum(a, b), c)[:, :2]).astype(int)
    for t in np.flatnonzero((twice != 0) & np.all(first <= last, axis=1)):
        x, y = (np.arange(first[t, k], last[t, k] + 1) - a[t, k] for k in (0, 1))
        x, y = x[:, None], y[None]
        u, v = (x * ac[t, 1] - ac[t, 0] * y) / twice[t], (ab[t, 0] * y - x * ab[t, 1]) / twice[t]
        i, j = np.nonzero((u >= 0) & (v >= 0) & (u + v < 1))
        height = np.ceil(a[t, 2] + u[i, j] * ab[t, 2] + v[i, j] * ac[t, 2]).astype(int)
        steps[first[t, 0] + i, first[t, 1] + j, height] += -1 if twice[t] > 0 else 1
    return np.cumsum(steps[:, :, :-1], axis=2).transpose(2, 1, 0)


def all_inside(shell):
    """Surfaces of everything enclosed by a surface that may cross itself."""
    step = float(np.ptp(shell.points, axis=0).max()) / FINE
    low = shell.points.min(axis=0) - 3 * step
    size = np.ceil((shell.points.max(axis=0) + 3 * step - low) / step).astype(int) + 1
    inside = winding(shell, low, step, size) != 0
    found = field.Field(low, step, np.where(inside, -0.5, 0.5) * step).surfaces()
    growth = (np.count_nonzero(inside) * step ** 3 / sum(s.volume() for s in found)) ** (1 / 3)
    return [s.scaled(growth) for s in found]


def distance_to(mask, step):
    """Distance of each voxel to the nearest one of a mask."""
    source = vtk.vtkImageData()
    source.SetDimensions(*mask.shape[::-1])
    source.GetPointData().SetScalars(numpy_to_vtk(np.where(mask, 0, 1).astype(np.uint8).ravel(), deep=True))
    squared = vtk.vtkImageEuclideanDistance()
    squared.SetInputData(source)
    squared.SetMaximumDistance(1e9)
    squared.Update()
    return step * np.sqrt(vtk_to_numpy(squared.GetOutput().GetPointData().GetScalars()).reshape(mask.shape))


def image_of(regions, edge, box=None, body=False):
    """The regions (lists of shells) drawn in their order of priority, the first on top; label k + 1 is region k. Nothing is drawn outside
    of `box` (low, high). `body`: the last region is much larger than that. Returned with the share of each region that is lost to others and to the box (as number -1): {(loser, winner):
    share}."""
    thin = thinnest(regions)
    points = np.vstack([shell.points for region in regions for shell in region])
    if body:
        points = np.vstack([shell.points for region in regions[:-1] for shell in region] + [np.clip(shell.points, *box) for shell in regions[-1]])
    step = min(edge / VOXELS_PER_EDGE, thin / VOXELS_PER_RADIUS)
    extent = np.ptp(points, axis=0)
    step = max(step, (float(np.prod(extent + 6 * step)) / MOST_VOXELS) ** (1 / 3))
    low = points.min(axis=0) - 3.5 * step      # so that planes of voxels do not coincide with flat faces of regions
    size = np.ceil((points.max(axis=0) + 3 * step - low) / step).astype(int) + 1
    image = Image(low, step, np.zeros(size[::-1], np.uint8))
    beyond = np.zeros(image.labels.shape, bool)
    if box:
        axes = [low[a] + step * np.arange(size[a]) for a in range(3)]
        out = [(axis < box[0][a]) | (axis > box[1][a]) for a, axis in enumerate(axes)]
        beyond = out[2][:, None, None] | out[1][:, None] | out[0]
    lost = {}
    for k, region in enumerate(regions):
        mine = np.any([drawn(shell, image) for shell in region], axis=0)
        whole = max(1, np.count_nonzero(mine))
        for winner, count in collections.Counter(image.labels[mine & ~beyond].tolist()).items():
            if winner:
                lost[k, winner - 1] = count / whole
        if np.any(mine & beyond):
            lost[k, OUTSIDE] = np.count_nonzero(mine & beyond) / whole
        image.labels[mine & ~beyond & (image.labels == 0)] = k + 1
    return image, lost


def close_gaps(image, count, gap):
    """Fills gaps narrower than `gap` between two regions with the nearer region: the voxels added by a closing of both together (dilation,
    then erosion by half the gap), so that nothing grows outward where they meet."""
    if count < 2:
        return
    nearest = [np.full(image.labels.shape, np.inf, np.float32) for _ in range(2)]
    owner = np.zeros(image.labels.shape, np.uint8)
    for label in range(1, count + 1):
        distance = distance_to(image.labels == label, image.step).astype(np.float32)
        nearer = distance < nearest[0]
        nearest[1] = np.where(nearer, nearest[0], np.minimum(nearest[1], distance))
        nearest[0] = np.where(nearer, distance, nearest[0])
        owner[nearer] = label
    filled = distance_to(nearest[0] > gap / 2, image.step) > gap / 2
    closed = (image.labels == 0) & filled & (nearest[0] + nearest[1] <= gap + 2 * image.step)
    image.labels[closed] = owner[closed]


def drop_thin(image, count, radius):
    """Reassigns sheets and spurs of regions that are thinner than a ball of this radius, and splinters, to the nearest other label; they would
    become flat tetrahedra. They arise where regions' outlines nearly coincide. A region that is thin everywhere is kept, and so is a part
    that would break or vanish, except sheets beside other regions."""
    radius = max(radius, image.step)
    kept = [image.labels == 0]
    for label in range(1, count + 1):
        mask = image.labels == label
        core = distance_to(~mask, image.step) > radius * (1 + 1e-6)
        opened = mask & (distance_to(core, image.step) <= radius * (1 + 1e-6)) if core.any() else mask
        if np.count_nonzero(opened) < (1 - MOST_THIN) * np.count_nonzero(mask):
            opened = mask
        else:
            opened = opened | holding(image, label, mask, opened, radius)
        numbers, sizes = parts_of(opened)
        large = np.append(False, sizes > shells.SPLINTER * sizes.max(initial=0))
        kept.append(large[numbers])
    left = (image.labels > 0) & ~np.any(kept, axis=0)
    if left.any():
        distances = np.array([distance_to(mask, image.step)[left] if mask.any() else np.full(np.count_nonzero(left), np.inf) for mask in kept])
        image.labels[left] = np.argmin(distances, axis=0)


def holding(image, label, mask, opened, radius):
    """Thin places in parts of a region that an opening would break or remove, except those beside other regions."""
    whole, sizes = parts_of(mask)
    numbers, pieces = parts_of(opened)
    large = np.append(False, pieces > shells.SPLINTER * sizes[0])
    pairs = np.unique(np.column_stack([whole[mask], (numbers * large[numbers])[mask]]), axis=0)
    found = np.bincount(pairs[pairs[:, 1] > 0, 0], minlength=len(sizes) + 1)
    broken = np.append(False, (found[1:] != 1) & (sizes > shells.SPLINTER * sizes[0]))
    thin = mask & ~opened & broken[whole]
    others = (image.labels > 0) & ~mask
    if thin.any() and others.any():
        thin &= distance_to(others, image.step) > 2 * radius
    return thin


def thinnest(regions):
    """Radius of a cylinder with the thinnest region's ratio of volume to surface."""
    return min(2 * sum(s.volume() for s in region) / sum(s.area() for s in region) for region in regions)


def meshed(image, edge, flatness, sizes):
    """CGAL's tetrahedra in an image: points, tetrahedra, their labels. Only the surfaces between labels are used. `sizes`: label -> radius of
    the spheres around tetrahedra in it, and near it if that is smaller than elsewhere."""
    labels, radius = np.where(image.labels == 0, AROUND, image.labels), {AROUND: edge, "default": edge}
    for label, size in sizes.items():
        radius[label] = size
        if size < SMALL * edge:
            labels[(image.labels == 0) & (distance_to(image.labels == label, image.step) < size)] = AROUND - label
            radius[AROUND - label] = size
    labels = np.pad(labels[1:-1, 1:-1, 1:-1].astype(np.uint8), 1)      # CGAL needs an empty border
    made = pygalmesh.generate_from_array(
        np.ascontiguousarray(labels.transpose(2, 1, 0)), (image.step,) * 3, perturb=False, exude=False,    # these depend on the clock
        min_facet_angle=FACET_ANGLE, max_radius_surface_delaunay_ball=CIRCUMRADIUS * edge, max_facet_distance=flatness,
        max_cell_circumradius={label: float(size) for label, size in radius.items()}, verbose=False, seed=1)
    points, tets, numbers = np.asarray(made.points, float), made.cells_dict["tetra"], made.cell_data_dict["medit:ref"]["tetra"]
    middles = np.rint(points[tets].mean(axis=1) / image.step).astype(int)
    i, j, k = np.clip(middles, 0, np.array(labels.shape[::-1]) - 1).T    # a few may lie beyond a small image
    label, found = labels[k, j, i], np.zeros(len(tets), int)
    for number in np.unique(numbers):    # CGAL renumbers the labels
        mine = numbers == number
        found[mine] = np.argmax(np.bincount(label[mine], minlength=2)[1:]) + 1
    found[found > max(sizes)] = 0
    return points + image.low, tets, found


def connected(count, pairs):
    """For each of `count` numbers the smallest one connected to it by pairs (k, 2)."""
    root = np.arange(count)
    while True:
        before = root.copy()
        least = np.minimum(root[pairs[:, 0]], root[pairs[:, 1]])
        order = np.argsort(-least, kind="stable")
        root[pairs[order].ravel()] = np.repeat(least[order], 2)    # the last assignment wins: the smallest number
        root = root[root]
        if np.array_equal(root, before):
            return root


def neighbours(tets):
    """All faces, and the tetrahedra on both sides of each, or OUTSIDE."""
    faces = np.sort(np.concatenate([tets[:, sorted({0, 1, 2, 3} - {k})] for k in range(4)]), axis=1)
    owner = np.tile(np.arange(len(tets)), 4)
    order = np.lexsort(faces.T)
    faces, owner = faces[order], owner[order]
    second = np.append(False, np.all(faces[1:] == faces[:-1], axis=1))
    first = ~second
    left, right = owner[first], np.full(np.count_nonzero(first), OUTSIDE)
    right[np.cumsum(first)[second] - 1] = owner[second]
    return faces[first], left, right


def without_splinters(points, tets, labels):
    """Labels of the tetrahedra; cells smaller than SPLINTER of their region's largest get the label that surrounds most of their surface;
    0 is none."""
    corners, left, right = neighbours(tets)
    a, b, c = (points[corners[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    a, b, c, d = (points[tets[:, k]] for k in range(4))
    size = np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a)))
    labels, inner = labels.copy(), right != OUTSIDE
    while True:
        same = inner & (labels[left] == labels[right]) & (labels[left] > 0)
        roots, cell = np.unique(connected(len(tets), np.column_stack([left[same], right[same]])), return_inverse=True)
        volume, label = np.bincount(cell, size), labels[roots]
        largest = np.zeros(labels.max() + 1)
        np.maximum.at(largest, label, volume)
        small = np.flatnonzero((volume < shells.SPLINTER * largest[label]) & (label > 0))
        if not len(small):
            return labels
        smallest = small[np.argmin(volume[small])]
        around = np.zeros(len(largest))
        for one, other in ((left, right), (right, left)):
            mine = ~same & (one != OUTSIDE) & (cell[one] == smallest)
            np.add.at(around, np.where(other[mine] == OUTSIDE, 0, labels[other[mine]]), area[mine])
        labels[cell == smallest] = np.argmax(around)


def complex_of(points, tets, labels):
    """The surfaces of labels, cells numbered by connected parts."""
    labels = without_splinters(points, tets, labels)
    tets, labels = tets[labels > 0], labels[labels > 0]
    faces, left, right = neighbours(tets)
    inner = right != OUTSIDE
    same = inner & (labels[left] == labels[right])
    roots, number = np.unique(connected(len(tets), np.column_stack([left[same], right[same]])), return_inverse=True)
    sides = np.column_stack([number[left], np.where(inner, number[right], OUTSIDE)])[~same]
    corners, inside = faces[~same], tets[left][~same]
    a, b, c = (points[corners[:, k]] for k in range(3))
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a - points[inside].mean(axis=1)) > 0
    corners = np.where(outward[:, None], corners, corners[:, ::-1])
    used, numbers = np.unique(corners, return_inverse=True)
    return with_voids(Complex(points[used], numbers.reshape(-1, 3), sides, [int(labels[root]) - 1 for root in roots]))


def with_voids(found):
    """The same with a cell for each void enclosed by regions, which may touch the outer surface at a point."""
    open_ = np.flatnonzero(found.sides[:, 1] == OUTSIDE)
    corners = found.triangles[open_]
    edges = np.sort(np.concatenate([corners[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    order = np.lexsort(edges.T)
    same = np.all(edges[order[1:]] == edges[order[:-1]], axis=1)
    part = connected(len(corners), np.column_stack([order[1:][same], order[:-1][same]]) % len(corners))
    sides, cells = found.sides.copy(), list(found.cells)
    for root in np.unique(part):
        mine = part == root
        if Shell(found.points, corners[mine]).signed_volume() < 0:     # its normals point into the void
            sides[open_[mine], 1] = len(cells)
            cells.append(OUTSIDE)
    return dataclasses.replace(found, sides=sides, cells=cells)


def corrected(made, volumes):
    """Moves the points as little as possible to give the regions these volumes: {region: volume}. Where that makes surfaces cross, as in a narrow
    channel, the points stay, and the others are moved more."""
    if not volumes:
        return made
    free = np.ones(len(made.points))
    for number in range(UNFOLDINGS):
        result = with_volumes(made, volumes, free)
        pairs = list(shells.crossing_pairs(Shell(result.points, result.triangles)))
        if not pairs:
            break
        held = np.zeros(len(free), bool)
        held[np.concatenate([corners for _, *both in pairs for corners in both])] = True
        for _ in range(number):     # and their neighbours
            held[made.triangles[held[made.triangles].any(axis=1)]] = True
        free[held] = 0
    return result


def with_volumes(made, volumes, free):
    """`free`: weight (n,) of each point, 0: it stays."""
    wanted = np.array([volumes[k] for k in sorted(volumes)])
    weight = np.zeros(len(made.points))
    for k in range(3):
        np.add.at(weight, made.triangles[:, k], made.areas() / 3)
    for _ in range(CORRECTIONS):
        held, gradients = zip(*(made.volume_gradient(k) for k in sorted(volumes)))
        missing = wanted - held
        if np.abs(missing / wanted).max() < 1e-6:
            break
        rows = np.array([g.ravel() for g in gradients])
        light = rows * np.repeat(free / weight, 3)
        move = np.linalg.lstsq(rows @ light.T, missing, rcond=1e-9)[0] @ light
        made = dataclasses.replace(made, points=made.points + move.reshape(-1, 3))
    return made


def parts_of(mask):
    """Connected parts of a mask, numbered from 1, and their numbers of voxels, largest first."""
    source = vtk.vtkImageData()
    source.SetDimensions(*mask.shape[::-1])
    source.GetPointData().SetScalars(numpy_to_vtk(mask.astype(np.uint8).ravel(), deep=True))
    connectivity = vtk.vtkImageConnectivityFilter()
    connectivity.SetInputData(source)
    connectivity.SetScalarRange(1, 1)
    connectivity.SetLabelScalarTypeToInt()
    connectivity.SetLabelModeToSizeRank()
    connectivity.Update()
    numbers = vtk_to_numpy(connectivity.GetOutput().GetPointData().GetScalars()).reshape(mask.shape)
    return numbers, np.bincount(numbers.ravel())[1:]


def surrounded(numbers, number):
    """Section of an image of numbered parts: this part and REACH voxels around it."""
    within = np.argwhere(numbers == number)
    return numbers[tuple(slice(max(0, a - REACH), b + REACH + 1) for a, b in zip(within.min(axis=0), within.max(axis=0)))]


def clear(numbers, count):
    """Removes voxels that are too close to larger parts; parts are numbered by size."""
    for number in range(2, count + 1):
        nearby = surrounded(numbers, number)
        larger = (nearby > 0) & (nearby < number)
        if larger.any():
            nearby[(nearby == number) & (distance_to(larger, 1.0) < CLEAR)] = 0


def separate(image):
    """Removes splinters, and separates parts that do not touch by CLEAR voxels."""
    numbers, sizes = parts_of(image.labels > 0)
    whole = np.bincount(image.labels.ravel(), minlength=256)
    large = [np.any(np.bincount(image.labels[numbers == number], minlength=256)[1:] > shells.SPLINTER * whole[1:]) for number in range(1, len(sizes) + 1)]
    numbers = np.append(0, np.cumsum(large) * large)[numbers]    # without splinters
    clear(numbers, sum(large))
    image.labels[numbers == 0] = 0


def missing(image, label, found, tolerance):
    """Share of a label's boundary that is further than `tolerance` from its extracted surface."""
    if label - 1 not in found.cells:
        return 1.0
    mine = image.labels == label
    inner = mine.copy()
    for axis in range(3):
        inner &= np.roll(mine, 1, axis) & np.roll(mine, -1, axis)
    places = np.argwhere(mine & ~inner)[:, ::-1]
    places = places[::1 + len(places) // MOST_PLACES]
    return float(np.mean(np.abs(shells.distances(found.surface(label - 1), image.low + image.step * places)) > tolerance))


def with_margin(image, margin):
    """The image padded by this much label 0 on all sides."""
    voxels = int(np.ceil(margin / image.step))
    return Image(image.low - voxels * image.step, image.step, np.pad(image.labels, voxels))


def surfaces_in(image, edge, radii):
    """The complex of an image. `radii`: label -> thinness of its region. CGAL follows a surface from the first points found on it, and misses
    parts that are thinner than its elements; elements in and around such regions are made smaller until nothing is missing."""
    parts = {label: np.count_nonzero(sizes > shells.SPLINTER * sizes[0]) for label in radii for _, sizes in [parts_of(image.labels == label)]}
    sizes = {label: min(THIN * radius if radius < edge / 2 else radius, edge) for label, radius in radii.items()}
    flatness = max(FLATNESS * min(radii.values()), FLATNESS_OF_EDGE * edge)
    image = with_margin(image, MARGIN * edge)     # otherwise triangles of the regions have corners on the image's border
    for _ in range(REFINEMENTS):
        found = complex_of(*meshed(image, edge, flatness, sizes))
        lost = {label: missing(image, label, found, max(min(radius, edge / 2), 1.5 * image.step)) for label, radius in radii.items()}
        poor = [label for label in radii if lost[label] > MOST_MISSING or found.cells.count(label - 1) < parts[label]]
        if not poor:
            break
        for label in poor:
            sizes[label] *= FINER
    return found, lost


def image_for(regions, edge, box=None, body=False):
    """Image of regions (lists of closed shells, in order of priority), without gaps and sheets that are too thin for triangles of
    about this edge. Returned with the shares of the regions that are lost: see image_of."""
    image, lost = image_of(regions, edge, box, body)
    thin = FLATNESS * thinnest(regions)
    drop_thin(image, len(regions), thin)
    close_gaps(image, len(regions), max(2 * thin, CLOSE_VOXELS * image.step))
    separate(image)
    return image, lost


def shared_surfaces(image, lost, regions, volumes, edge):
    """Complex of the regions of these volumes, with triangles of about this edge, and the missing share of each one's surface.
    `image`, `lost`: from image_for. A volume of None is not restored: for bones only the surface matters."""
    kept = {k: volume * (1 - sum(share for (loser, _), share in lost.items() if loser == k)) for k, volume in enumerate(volumes) if volume}
    inside = [int(label) for label in np.unique(image.labels) if label]
    found, missed = surfaces_in(image, edge, {label: thinnest([regions[label - 1]]) for label in inside})
    return corrected(found, {k: volume for k, volume in kept.items() if k in found.cells}), {label - 1: share for label, share in missed.items()}
