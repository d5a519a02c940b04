"""A label image of regions: draws it from their surfaces, removes gaps and sheets that are too thin for the mesh, and divides it into connected components
("pieces").

A region consists of parts, each with its own surface. Cleaning the image may merge or break parts, so `Pieces` records how much of each part each piece
contains.
"""
import collections
import dataclasses

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from . import field, shells

MOST_VOXELS = 4e6
VOXELS_PER_EDGE = 6.0       # edge length of the surface triangles, in voxels
VOXELS_PER_RADIUS = 2.5     # voxels in the radius of the thinnest part
FLATNESS = 0.3              # a facet may be this far from its surface, as a fraction of the thinnest part's radius
CLOSE_VOXELS = 3.0          # close gaps between regions narrower than this, because the facets on either side would cross
CLEAR = 2.9                 # voxels, minimum distance between pieces that do not touch
REACH = 20                  # voxels, how far around a region or cluster to look for neighbours
MOST_THIN = 0.10            # if more than this fraction of a region is thin, keep its thin places
LEAST_VOID = 2.0            # voxels: fill a void if the largest ball that fits into it has a smaller radius than this
FINE = 100                  # voxels along the longest side of a self-intersecting surface
OUTSIDE = -1                # used instead of a region's index for the tissue around all regions


@dataclasses.dataclass
class Image:
    """Labels on a grid: 0 is no region, k + 1 is region k."""
    low: np.ndarray      # (3,) centre of the first voxel
    step: float
    labels: np.ndarray   # (z, y, x) uint16
    sources: np.ndarray  # (z, y, x) uint16: 1 + number of the part drawn in each voxel; 0 for none
    owners: np.ndarray   # (parts + 1,) indexed like `sources`: label of the part's region; 0 for none

    def sources_in(self, mask, label, window=...):
        """Returns `sources` for the voxels in a mask whose part belongs to the label's region, and 0 elsewhere."""
        sources = self.sources[window]
        return np.where(mask & (self.owners[sources] == label), sources, 0)

    def volume(self, label):
        return float(np.count_nonzero(self.labels == label)) * self.step ** 3


@dataclasses.dataclass
class Pieces:
    """The connected components of an image's labels, as they will be meshed."""
    numbers: np.ndarray      # (z, y, x) uint16: 1 + number of the piece; 0 for none
    regions: list            # region of each piece, or OUTSIDE for a void in the surrounding tissue
    held: dict               # (part, piece): number of voxels that the part and the piece share

    def voxels(self):
        return np.bincount(self.numbers.ravel(), minlength=len(self.regions) + 1)[1:]


def box_of(mask, margin):
    """Returns the slices of a mask's bounding box with a margin in voxels, or None if the mask is empty."""
    found = []
    for axis in range(3):
        at = np.flatnonzero(mask.any(axis=tuple(a for a in range(3) if a != axis)))
        if not len(at):
            return None
        found.append(slice(max(0, at[0] - margin), at[-1] + margin + 1))
    return tuple(found)


def image_data(values):
    source = vtk.vtkImageData()
    source.SetDimensions(*values.shape[::-1])
    source.GetPointData().SetScalars(numpy_to_vtk(values.ravel(), deep=True))
    return source


def pairs_in(first, second):
    """Returns the distinct pairs of corresponding elements in two arrays of non-negative integers, in ascending order, and how often each occurs. This is
    twenty times as fast as np.unique on rows."""
    width = int(second.max(initial=0)) + 1
    keys, often = np.unique(first.astype(np.int64) * width + second, return_counts=True)
    return np.column_stack([keys // width, keys % width]), often


def distance_to(mask, step):
    """Returns the distance from each voxel to the nearest voxel in a mask."""
    squared = vtk.vtkImageEuclideanDistance()
    squared.SetInputData(image_data(np.where(mask, 0, 1).astype(np.uint8)))
    squared.SetMaximumDistance(1e9)
    squared.Update()
    return step * np.sqrt(vtk_to_numpy(squared.GetOutput().GetPointData().GetScalars()).reshape(mask.shape))


def connected_in(mask):
    """Returns the connected components of a mask, numbered from 1, and their voxel counts, largest first. Voxels are connected if they share a face."""
    connectivity = vtk.vtkImageConnectivityFilter()
    connectivity.SetInputData(image_data(mask.astype(np.uint8)))
    connectivity.SetScalarRange(1, 1)
    connectivity.SetLabelScalarTypeToInt()
    connectivity.SetLabelModeToSizeRank()
    connectivity.Update()
    numbers = vtk_to_numpy(connectivity.GetOutput().GetPointData().GetScalars()).reshape(mask.shape)
    return numbers, np.bincount(numbers.ravel())[1:]


# ---- drawing ---------------------------------------------------------------------------------------------------------------------------

def drawn(shell, low, step, shape):
    """Rasterises a closed surface. Returns the mask (z, y, x) of the voxels inside, and the slices that it covers in an image of this shape; None, None if the
    surface is outside the image. step: voxel size, one number or one for each axis."""
    step = np.broadcast_to(step, 3)
    first = np.maximum(0, np.floor((shell.points.min(axis=0) - low) / step).astype(int) - 1)
    last = np.minimum(np.array(shape[::-1]) - 1, np.ceil((shell.points.max(axis=0) - low) / step).astype(int) + 1)
    if np.any(last < first):
        return None, None
    stencil = vtk.vtkPolyDataToImageStencil()
    stencil.SetInputData(shells.to_vtk(shell))
    stencil.SetOutputOrigin(*low)
    stencil.SetOutputSpacing(*step)
    stencil.SetOutputWholeExtent(first[0], last[0], first[1], last[1], first[2], last[2])
    inside = vtk.vtkImageStencilToImage()
    inside.SetInputConnection(stencil.GetOutputPort())
    inside.SetInsideValue(1)
    inside.SetOutsideValue(0)
    inside.SetOutputScalarTypeToUnsignedChar()
    inside.Update()
    mask = vtk_to_numpy(inside.GetOutput().GetPointData().GetScalars()).reshape((last - first + 1)[::-1]) > 0
    return mask, tuple(slice(a, b + 1) for a, b in zip(first[::-1], last[::-1]))


def winding(shell, low, step, size):
    """Returns the winding number of a surface around each voxel of a grid (z, y, x). It is 0 outside, even if parts overlap or are inverted."""
    points = (shell.points - low) / step + [1.23e-5, 2.34e-5, 0]    # shift, so that no vertex is on the line through a column of voxels
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
    """Returns the outer surfaces of the volume enclosed by a surface that may cross itself."""
    step = float(np.ptp(shell.points, axis=0).max()) / FINE
    low = shell.points.min(axis=0) - 3 * step
    size = np.ceil((shell.points.max(axis=0) + 3 * step - low) / step).astype(int) + 1
    inside = winding(shell, low, step, size) != 0
    found = field.Field(low, step, np.where(inside, -0.5, 0.5) * step).surfaces()
    growth = (np.count_nonzero(inside) * step ** 3 / sum(s.volume() for s in found)) ** (1 / 3)
    return [s.scaled(growth) for s in found]


def thinness(found):
    """Returns the radius of a long cylinder that has the same volume-to-surface ratio as these surfaces together."""
    return 2 * sum(shell.volume() for shell in found) / sum(shell.area() for shell in found)


def thinnest(regions):
    """Returns the thinness of the thinnest part."""
    return min(thinness([part]) for region in regions for part in region)


def image_of(regions, edge, box=None, body=False):
    """Draws the regions (lists of the parts' surfaces), the first on top; label k + 1 is region k. Nothing is drawn outside `box` (low, high). body: true if
    the last region is much larger than the box. Also returns what each part loses: {(part, winner): fraction of the part}, where `winner` is the region that
    takes it, or OUTSIDE for what lies outside the box. Parts are numbered across all regions."""
    thin = thinnest(regions[:-1] if body and len(regions) > 1 else regions)
    points = np.vstack([shell.points for region in regions for shell in region])
    if body:
        points = np.vstack([shell.points for region in regions[:-1] for shell in region] + [np.clip(shell.points, *box) for shell in regions[-1]])
    step = min(edge / VOXELS_PER_EDGE, thin / VOXELS_PER_RADIUS)
    extent = np.ptp(points, axis=0)
    step = max(step, (float(np.prod(extent + 6 * step)) / MOST_VOXELS) ** (1 / 3))
    low = points.min(axis=0) - 3.5 * step      # shift, so that voxel planes do not coincide with flat faces of regions
    size = np.ceil((points.max(axis=0) + 3 * step - low) / step).astype(int) + 1
    image = Image(low, step, np.zeros(size[::-1], np.uint16), np.zeros(size[::-1], np.uint16),
                  np.array([0, *(k + 1 for k, region in enumerate(regions) for _ in region)]))
    beyond = np.zeros(image.labels.shape, bool)
    if box:
        axes = [low[a] + step * np.arange(size[a]) for a in range(3)]
        out = [(axis < box[0][a]) | (axis > box[1][a]) for a, axis in enumerate(axes)]
        beyond = out[2][:, None, None] | out[1][:, None] | out[0]
    lost, part = {}, -1
    for k, region in enumerate(regions):
        for shell in region:
            part += 1
            mask, window = drawn(shell, low, step, image.labels.shape)
            if mask is None:
                lost[part, OUTSIDE] = 1.0
                continue
            labels, sources, out = image.labels[window], image.sources[window], beyond[window]
            whole = max(1, np.count_nonzero(mask))
            for winner, count in collections.Counter(labels[mask & ~out].tolist()).items():
                if winner not in (0, k + 1):
                    lost[part, winner - 1] = count / whole
            if np.any(mask & out):
                lost[part, OUTSIDE] = np.count_nonzero(mask & out) / whole
            mine = mask & ~out & (labels == 0)
            labels[mine], sources[mine] = k + 1, part + 1
    return image, lost


# ---- cleaning -------------------------------------------------------------------------------------------------------------------------------

def close_gaps(image, count, gap):
    """Fills gaps narrower than `gap` between two regions with the nearer region. Adds only the voxels that a morphological closing of their union by half the
    gap adds, so that the regions do not grow outward where they meet."""
    if count < 2:
        return
    nearest = [np.full(image.labels.shape, np.inf, np.float32) for _ in range(2)]
    owner = np.zeros(image.labels.shape, np.uint16)
    for label in range(1, count + 1):
        mask = image.labels == label
        window = box_of(mask, int(np.ceil(gap / image.step)) + 3)
        if not window:
            continue
        distance = distance_to(mask[window], image.step).astype(np.float32)
        first, second, mine = nearest[0][window], nearest[1][window], owner[window]
        nearer = distance < first
        second[:] = np.where(nearer, first, np.minimum(second, distance))
        first[:] = np.where(nearer, distance, first)
        mine[nearer] = label
    filled = distance_to(nearest[0] > gap / 2, image.step) > gap / 2
    closed = (image.labels == 0) & filled & (nearest[0] + nearest[1] <= gap + 2 * image.step)
    image.labels[closed] = owner[closed]


def splinters(numbers, sources):
    """Returns a mask (n + 1,), indexed by component number (0 is none), of the connected components that contain less than SPLINTER of each of their sources
    (see Image)."""
    count = numbers.max(initial=0) + 1
    pairs, held = pairs_in(numbers[numbers > 0], sources[numbers > 0])
    pairs, held = pairs[pairs[:, 1] > 0], held[pairs[:, 1] > 0]
    whole = np.bincount(pairs[:, 1], held)
    found = np.ones(count, bool)
    found[pairs[held > shells.SPLINTER * whole[pairs[:, 1]], 0]] = False
    found[0] = False
    return found


def reassign(image, count, left):
    """Gives these voxels the nearest other label, or none if an unlabelled voxel is nearer."""
    if not left.any():
        return
    image.labels[left] = 0
    nearest, owner = distance_to((image.labels == 0) & ~left, image.step)[left], np.zeros(np.count_nonzero(left), np.uint16)
    order = np.zeros(left.shape, np.int64)
    order[left] = np.arange(len(owner))
    for label in range(1, count + 1):
        mask = image.labels == label
        window = box_of(mask, REACH)
        if not window or not left[window].any():
            continue
        here = order[window][left[window]]
        distance = distance_to(mask[window], image.step)[left[window]]
        nearer = distance < nearest[here]
        nearest[here[nearer]], owner[here[nearer]] = distance[nearer], label
    image.labels[left] = owner


def drop_thin(image, count, radius):
    """Gives sheets and spurs that are too thin for a ball of this radius, and splinters, the nearest other label, because they would become flat tetrahedra.
    They arise where contours of regions nearly coincide. Exceptions: regions that are thin everywhere, walls of voids, and thin places without which a part
    would break or vanish, unless they are next to another region."""
    radius = max(radius, image.step)
    left = np.zeros(image.labels.shape, bool)
    for label in range(1, count + 1):
        whole = image.labels == label
        window = box_of(whole, int(np.ceil(3 * radius / image.step)) + 2)
        if not window:
            continue
        mask, labels = whole[window], image.labels[window]
        sources = image.sources_in(mask, label, window)
        core = distance_to(~mask, image.step) > radius * (1 + 1e-6)
        opened = mask & (distance_to(core, image.step) <= radius * (1 + 1e-6)) if core.any() else mask
        if np.count_nonzero(opened) < (1 - MOST_THIN) * np.count_nonzero(mask):
            opened = mask
        else:
            opened = opened | holding(image, labels, mask, opened, sources, radius)
        numbers, _ = connected_in(opened)
        left[window] |= mask & (~opened | splinters(numbers, sources)[numbers])
    left &= ~walls(image, left)
    reassign(image, count, left)


def walls(image, left):
    """Returns those of the voxels `left` that separate voids in the surrounding tissue: connected groups that touch more than one void."""
    voids, sizes = connected_in(image.labels == 0)
    if len(sizes) < 2 or not left.any():
        return np.zeros(left.shape, bool)
    groups, _ = connected_in(left)
    touching = np.zeros((groups.max() + 1, len(sizes) + 1), bool)
    for axis in range(3):
        for one, other in ((slice(None, -1), slice(1, None)), (slice(1, None), slice(None, -1))):
            beside = [slice(None)] * 3
            beside[axis] = one
            group, beside[axis] = groups[tuple(beside)], other
            touching[group, voids[tuple(beside)]] = True
    found = touching[:, 1:].sum(axis=1) > 1
    found[0] = False
    return found[groups]


def holding(image, labels, mask, opened, sources, radius):
    """Returns the thin places that must be kept so that a morphological opening does not break or remove a part of a region, except those next to other
    regions."""
    whole, _ = connected_in(mask)
    numbers, _ = connected_in(opened)
    large = ~splinters(numbers, sources)
    large[0] = False
    pairs, _ = pairs_in(whole[mask], (numbers * large[numbers])[mask])
    found = np.bincount(pairs[pairs[:, 1] > 0, 0], minlength=whole.max(initial=0) + 1)
    broken = (found != 1) & ~splinters(whole, sources)
    broken[0] = False
    thin = mask & ~opened & broken[whole]
    others = (labels > 0) & ~mask
    if thin.any() and others.any():
        thin &= distance_to(others, image.step) > 2 * radius
    return thin


def surrounded(numbers, number):
    """Returns the section of an image of numbered clusters around cluster `number`, with a margin of REACH voxels."""
    return numbers[box_of(numbers == number, REACH)]


def clear(numbers, count):
    """Removes voxels that are too close to a larger cluster. Clusters are numbered from the largest to the smallest."""
    for number in range(2, count + 1):
        nearby = surrounded(numbers, number)
        larger = (nearby > 0) & (nearby < number)
        if larger.any():
            nearby[(nearby == number) & (distance_to(larger, 1.0) < CLEAR)] = 0


def separate(image):
    """Removes voxels until clusters of regions that do not touch each other are at least CLEAR voxels apart."""
    numbers, sizes = connected_in(image.labels > 0)
    clear(numbers, len(sizes))
    image.labels[numbers == 0] = 0


def pieces_of(image, count):
    """Removes splinters from the image, and returns its connected components."""
    left = np.zeros(image.labels.shape, bool)
    for label in range(1, count + 1):
        mask = image.labels == label
        window = box_of(mask, 1)
        if window:
            numbers, _ = connected_in(mask[window])
            left[window] |= splinters(numbers, image.sources_in(mask[window], label, window))[numbers]
    image.labels[left] = 0
    found, regions = np.zeros(image.labels.shape, np.uint16), []
    for label in range(1, count + 1):
        mask = image.labels == label
        window = box_of(mask, 1)
        if not window:
            continue
        numbers, sizes = connected_in(mask[window])
        found[window] += np.where(numbers > 0, numbers + len(regions), 0).astype(np.uint16)
        regions += [label - 1] * len(sizes)
    add_voids(found, regions)
    both = (found > 0) & (image.sources > 0) & (image.owners[image.sources] == image.labels)      # a void contains no parts
    pairs, held = pairs_in(image.sources[both], found[both])
    return Pieces(found, regions, {(int(part) - 1, int(piece) - 1): int(n) for (part, piece), n in zip(pairs, held)})


def add_voids(numbers, regions):
    """Turns voids enclosed by pieces into pieces of their own, without a region. Small voids are merged into the piece around them."""
    voids, sizes = connected_in(numbers == 0)
    outer = voids[0, 0, 0]
    for void in range(1, len(sizes) + 1):
        if void == outer:
            continue
        mask = voids == void
        window = box_of(mask, 1)
        mask = mask[window]
        if distance_to(~mask, 1.0).max() < LEAST_VOID:
            around = numbers[window][(distance_to(mask, 1.0) < 1.5) & ~mask]
            numbers[window][mask] = np.bincount(around[around > 0]).argmax()
        else:
            regions.append(OUTSIDE)
            numbers[window][mask] = len(regions)


def image_for(regions, edge, box=None, body=False):
    """Draws and cleans an image of regions (lists of the parts' surfaces, in order of priority), without gaps or sheets too thin for triangles with about this
    edge length. Returns the image, its pieces, and the lost fractions of the parts (see image_of)."""
    image, lost = image_of(regions, edge, box, body)
    thin = FLATNESS * thinnest(regions[:-1] if body and len(regions) > 1 else regions)
    drop_thin(image, len(regions), thin)
    close_gaps(image, len(regions), max(2 * thin, CLOSE_VOXELS * image.step))
    separate(image)
    return image, pieces_of(image, len(regions)), lost
