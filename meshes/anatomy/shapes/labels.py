"""Turns regions that touch or contain each other into one complex of surfaces, in which two regions share a single surface where they meet.

The input is a label image of the regions (label_image.py). CGAL extracts the surfaces between its pieces, one cluster at a time (clusters.py). Then the
points are moved to restore the volume of each piece.
"""
import collections
import dataclasses

import numpy as np
import pygalmesh

from . import clusters, shells
from .clusters import AROUND
from .label_image import FLATNESS, OUTSIDE, box_of, distance_to, thinness
from .shells import Shell, connected

FLATNESS_OF_EDGE = 0.1      # always allow a facet to be at least this far from its surface, as a fraction of the triangle edge length
THIN = 1.5                  # size of the tetrahedra in a piece that is thinner than a triangle's edge, as a multiple of the piece's radius
GRAIN = 0.75                # maximum size of the tetrahedra in a piece, as a fraction of the radius of its largest ball
SLOPE = 0.5                 # how fast the size of tetrahedra grows with distance from a piece that was missed
PER_SIZE = 1.3              # triangle edge length, as a multiple of the size of the small tetrahedra next to it
EQUILATERAL = 0.866         # surface area per node for equilateral triangles, as a multiple of the squared edge length
MM = 1e3                    # CGAL gets mm, because coordinates in its file have only six decimals
SMALL = 0.8                 # a piece whose tetrahedra are smaller than this fraction of a triangle edge gets a layer of equally small ones around it
REFINEMENTS = 6             # maximum number of attempts for thin pieces
MARGIN = 0.5                # margin of a section around its pieces, as a fraction of the triangle edge length
JOININGS = 3                # maximum number of passes that join clusters with intersecting surfaces
FINER = 0.85                # factor on the element size from one attempt to the next
MOST_MISSING = 0.01         # largest fraction of a piece's surface that may be missing
MOST_PLACES = 4000          # check a piece's surface for gaps at about this many points at most
FACET_ANGLE = 25.0          # deg; CGAL's surface refinement is guaranteed to terminate for values up to 30
CIRCUMRADIUS = 0.6          # limit on a triangle's circumradius, as a fraction of the edge length; an equilateral triangle has 0.577
CORRECTIONS = 8             # number of Newton steps toward the prescribed volumes; three usually suffice
UNFOLDINGS = 6              # number of attempts to restore the volumes without making surfaces intersect


@dataclasses.dataclass
class Complex:
    """Triangles between cells; a cell is a connected component of a piece, or a void enclosed by pieces."""
    points: np.ndarray       # (n, 3)
    triangles: np.ndarray    # (m, 3), with normals that point from the first to the second cell
    sides: np.ndarray        # (m, 2) the cells on either side: index into `cells`, or OUTSIDE
    cells: list              # number of each cell's piece, or OUTSIDE for a void

    def among(self, pieces):
        """Returns a mask of the cells that belong to these pieces, with an extra element at the end for OUTSIDE."""
        return np.append(np.isin(self.cells, list(pieces)) & (np.array(self.cells) != OUTSIDE), False)

    def volume_gradient(self, pieces):
        """Returns the total volume of these pieces, and its derivative with respect to the points."""
        gradient, volume = np.zeros_like(self.points), 0.0
        mine = self.among(pieces)
        sign = mine[self.sides[:, 0]].astype(float) - mine[self.sides[:, 1]]
        used = sign != 0
        a, b, c = (self.points[self.triangles[used, k]] for k in range(3))
        middle = self.points.mean(axis=0)
        volume = (sign[used] * np.einsum("ij,ij->i", a - middle, np.cross(b - middle, c - middle))).sum() / 6
        normal = sign[used, None] * np.cross(b - a, c - a) / 6
        for k in range(3):
            np.add.at(gradient, self.triangles[used, k], normal)
        return volume, gradient

    def volume(self, pieces):
        return self.volume_gradient(pieces)[0]

    def areas(self):
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2

    def surface(self, pieces):
        """Returns the triangles around all cells of these pieces, with outward normals."""
        mine = self.among(pieces)
        first, second = mine[self.sides[:, 0]], mine[self.sides[:, 1]]
        return Shell(self.points, np.vstack([self.triangles[first & ~second], self.triangles[second & ~first][:, ::-1]]))


@dataclasses.dataclass
class Section:
    """The section of the image that contains a cluster."""
    low: np.ndarray          # (3,) centre of the first voxel
    step: float
    numbers: np.ndarray      # (z, y, x): 1 + the index of a piece in `pieces`; 0 around the pieces
    pieces: list             # numbers of the pieces in the image
    radii: list              # their thinness, m
    balls: list              # radii of the largest balls in the pieces, m


@dataclasses.dataclass
class Sizes:
    """Upper limits of the circumradii of CGAL's tetrahedra, m."""
    edge: float              # everywhere
    within: list             # in each piece
    seeded: set              # pieces that were missed; tetrahedra in other pieces are small near these and grow with distance


def cgal_labels(section, sizes):
    """Returns an image for CGAL, with labels from 1 on; and each label's piece (OUTSIDE for the surroundings) and tetrahedron size."""
    numbers, edge, step = section.numbers.astype(np.int64), sizes.edge, section.step
    bound = np.full(numbers.shape, edge, np.float32)
    layer = np.zeros(numbers.shape, np.int64)
    for piece, size in enumerate(sizes.within):
        seeded = piece in sizes.seeded
        if size >= (edge if seeded else SMALL * edge):
            continue
        mask = numbers == piece + 1
        window = box_of(mask, int(np.ceil((edge / SLOPE if seeded else size) / step)) + 1)
        distance = distance_to(mask[window], step)
        if seeded:
            bound[window] = np.minimum(bound[window], size + SLOPE * distance)
        else:
            layer[window][(numbers[window] == 0) & (distance < size)] = piece + 1
    level = np.ceil(np.log2(edge / bound) - 1e-6).astype(np.int64)
    level[np.isin(numbers, [piece + 1 for piece in sizes.seeded])] = 0
    width, depth = len(sizes.within) + 1, int(level.max()) + 1
    keys, labels = np.unique((numbers * width + layer) * depth + level, return_inverse=True)
    held, layers, levels = keys // depth // width - 1, keys // depth % width - 1, keys % depth
    radii = [min([edge / 2.0 ** steps, *(sizes.within[k] for k in (piece, beside) if k >= 0)]) for piece, beside, steps in zip(held, layers, levels)]
    return (labels.reshape(numbers.shape) + 1).astype(np.uint16), held, radii


def meshed(section, flatness, sizes):
    """Meshes a section with CGAL. Returns points, tetrahedra, and for each tetrahedron 1 + the number of its piece, or 0. Only the surfaces between pieces
    are used later."""
    labels, held, radii = cgal_labels(section, sizes)
    labels = np.pad(labels[1:-1, 1:-1, 1:-1], 1)      # CGAL needs an empty border around the labels
    step = MM * section.step
    made = pygalmesh.generate_from_array(
        # no perturb or exude, because their results depend on the clock
        np.ascontiguousarray(labels.transpose(2, 1, 0)), (step,) * 3, perturb=False, exude=False,
        min_facet_angle=FACET_ANGLE, max_radius_surface_delaunay_ball=MM * CIRCUMRADIUS * sizes.edge, max_facet_distance=MM * flatness,
        max_cell_circumradius={"default": MM * sizes.edge, **{label: MM * float(radius) for label, radius in enumerate(radii, 1)}}, verbose=False, seed=1)
    points, tets, numbers = np.asarray(made.points, float), made.cells_dict["tetra"], made.cell_data_dict["medit:ref"]["tetra"]
    middles = np.rint(centres_of(points[tets]) / step).astype(int)
    i, j, k = np.clip(middles, 0, np.array(labels.shape[::-1]) - 1).T    # in a small image, a few centres may be outside
    label, found = labels[k, j, i], np.zeros(len(tets), int)
    for number in np.unique(numbers):    # CGAL renumbers the labels
        mine = numbers == number
        votes = np.bincount(label[mine], minlength=2)[1:]
        if votes.any():
            found[mine] = held[np.argmax(votes)] + 1
    return points / MM + section.low, tets, found


def centres_of(corners):
    """Returns the circumcentres of tetrahedra (n, 4, 3), or the centroid if a tetrahedron is flat."""
    edges = corners[:, 1:] - corners[:, :1]
    flat = np.abs(np.linalg.det(edges)) < 1e-9 * np.linalg.norm(edges, axis=2).prod(axis=1)
    edges[flat] = np.eye(3)
    found = corners[:, 0] + np.linalg.solve(edges, (edges ** 2).sum(axis=2)[..., None] / 2)[..., 0]
    found[flat] = corners[flat].mean(axis=1)
    return found


def neighbours(tets):
    """Returns all faces, and the tetrahedra on the two sides of each (OUTSIDE if there is none)."""
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
    """Returns the labels of the tetrahedra (0 is none) after relabelling splinters: cells smaller than SPLINTER of the largest cell with the same label get
    the label that borders most of their surface."""
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
    """Returns the complex of labelled tetrahedra, with one cell for each connected component of a label."""
    labels = without_splinters(points, tets, labels)
    tets, labels = tets[labels > 0], labels[labels > 0]
    if not len(tets):
        return Complex(points[:0], tets[:, :3], tets[:, :2], [])
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
    """Adds to a complex a cell for each void that regions enclose. A void may touch the outer surface at a point."""
    open_ = np.flatnonzero(found.sides[:, 1] == OUTSIDE)
    corners = found.triangles[open_]
    edges = np.sort(np.concatenate([corners[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    order = np.lexsort(edges.T)
    same = np.all(edges[order[1:]] == edges[order[:-1]], axis=1)
    part = connected(len(corners), np.column_stack([order[1:][same], order[:-1][same]]) % len(corners))
    sides, cells = found.sides.copy(), list(found.cells)
    for root in np.unique(part):
        mine = part == root
        if Shell(found.points, corners[mine]).signed_volume() < 0:     # the normals of these triangles point into the void
            sides[open_[mine], 1] = len(cells)
            cells.append(OUTSIDE)
    return dataclasses.replace(found, sides=sides, cells=cells)


def corrected(made, volumes):
    """Moves the points as little as possible to give groups of pieces the volumes in [(pieces, volume)]. Where that would make surfaces cross, as in a narrow
    channel, points are held in place and the others move more."""
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
        for _ in range(number):     # also hold their neighbours: one more layer in each attempt
            held[made.triangles[held[made.triangles].any(axis=1)]] = True
        free[held] = 0
    return result


def with_volumes(made, volumes, free):
    """Moves a complex's points by Newton steps toward these volumes. free: weight (n,) of each point; a point with weight 0 stays."""
    wanted = np.array([volume for _, volume in volumes])
    weight = np.zeros(len(made.points))
    for k in range(3):
        np.add.at(weight, made.triangles[:, k], made.areas() / 3)
    for _ in range(CORRECTIONS):
        held, gradients = zip(*(made.volume_gradient(pieces) for pieces, _ in volumes))
        missing = wanted - held
        if np.abs(missing / wanted).max() < 1e-6:
            break
        rows = np.array([g.ravel() for g in gradients])
        light = rows * np.repeat(free / weight, 3)
        move = np.linalg.lstsq(rows @ light.T, missing, rcond=1e-9)[0] @ light
        made = dataclasses.replace(made, points=made.points + move.reshape(-1, 3))
    return made


def missing(section, piece, found, tolerance):
    """Returns the fraction of a piece's boundary that is farther than `tolerance` from the extracted surface."""
    if piece not in found.cells:
        return 1.0
    mine = section.numbers == piece + 1
    window = box_of(mine, 1)
    mine = mine[window]
    inner = mine.copy()
    for axis in range(3):
        inner &= np.roll(mine, 1, axis) & np.roll(mine, -1, axis)
    places = np.argwhere(mine & ~inner)[:, ::-1] + [window[axis].start for axis in (2, 1, 0)]
    places = places[::1 + len(places) // MOST_PLACES]
    return float(np.mean(np.abs(shells.distances(found.surface([piece]), section.low + section.step * places)) > tolerance))


def section_of(image, numbers, cluster, edge, radii, balls):
    """Cuts out a cluster's section of the image. Anything attached to the cluster's outside counts as outside, and anything attached to one of its pieces
    counts as part of that piece. radii, balls: for all pieces of the image."""
    place = np.zeros(int(numbers.max()) + 1, np.uint16)
    for number, stands in cluster.stands.items():
        place[number] = 0 if stands == cluster.outer else 1 + cluster.inner.index(stands)
    mine = place[numbers]
    margin = int(np.ceil(MARGIN * edge / image.step)) + 2      # the margin keeps triangle corners off the border of the section
    tight = box_of(mine > 0, 0)
    pieces = [number - 1 for number in cluster.inner]
    low = image.low + image.step * (np.array([each.start for each in tight])[::-1] - margin)
    return Section(low, image.step, np.pad(mine[tight], margin), pieces, [radii[piece] for piece in pieces], [balls[piece] for piece in pieces])


def size_in(radius, ball, edge):
    """Returns the size of the tetrahedra in a piece, given its thinness `radius` and the radius `ball` of its largest ball."""
    return min(THIN * radius if radius < edge / 2 else radius, GRAIN * ball if ball < edge else edge, edge)


def nodes_of_thin(pieces, shells_of_parts, step, edge):
    """Estimates how many nodes the surface of each piece needs, if its tetrahedra must be smaller than a triangle edge; 0 for other pieces."""
    balls = largest_balls(pieces, step)
    radii = thinness_of(pieces, shells_of_parts, balls)
    volumes = pieces.voxels() * step ** 3
    sizes = [size_in(radius, ball, edge) for radius, ball in zip(radii, balls)]
    return [2 * volume / radius / (EQUILATERAL * (PER_SIZE * size) ** 2) if size < edge else 0.0 for volume, radius, size in zip(volumes, radii, sizes)]


def surfaces_in(section, edge, flatness):
    """Returns the complex of a section's pieces, and the missing fraction of each piece's surface. CGAL follows a surface from the first points that it finds
    and misses places thinner than its elements, so elements in and around such pieces are made smaller until nothing is missing."""
    sizes = Sizes(edge, [size_in(radius, ball, edge) for radius, ball in zip(section.radii, section.balls)], set())
    for _ in range(REFINEMENTS):
        found = complex_of(*meshed(section, flatness, sizes))
        lost = [missing(section, piece, found, max(min(radius, edge / 2), 1.5 * section.step)) for piece, radius in enumerate(section.radii)]
        often = collections.Counter(found.cells)
        poor = [piece for piece in range(len(lost)) if lost[piece] > MOST_MISSING or often[piece] != 1]
        if not poor:
            break
        for piece in poor:
            sizes.within[piece] *= FINER
            if piece not in found.cells:
                sizes.seeded.add(piece)
    return found, lost


def largest_balls(pieces, step):
    """Returns the radius of the largest ball in each piece, m."""
    found = []
    for piece in range(len(pieces.regions)):
        mask = pieces.numbers == piece + 1
        found.append(float(distance_to(~mask[box_of(mask, 1)], step).max()))
    return found


def thinness_of(pieces, shells_of_parts, balls):
    """Returns the thinness of each piece, from the surfaces of the parts that it contains or, for a void, the radius of its largest ball."""
    held = collections.defaultdict(list)
    for part, piece in pieces.held:
        held[piece].append(shells_of_parts[part])
    return [thinness(held[piece]) if held[piece] else balls[piece] for piece in range(len(pieces.regions))]


def surfaces_of_clusters(image, pieces, edge, radii, balls):
    """Returns the complex of all pieces, and the missing fraction of each piece's surface. Clusters whose surfaces turn out to cross are joined and extracted
    again."""
    graph = clusters.neighbours_in(pieces.numbers)
    every, flatness, made = clusters.clusters_of(graph), max(FLATNESS * min(radii), FLATNESS_OF_EDGE * edge), {}
    for _ in range(JOININGS):
        for cluster in every:
            key = frozenset(cluster.edges)
            if key not in made:
                section = section_of(image, pieces.numbers, cluster, edge, radii, balls)
                made[key] = (*surfaces_in(section, edge, flatness), section.pieces)
        found, missed, owner = glued(every, [made[frozenset(cluster.edges)] for cluster in every], len(pieces.regions))
        pairs = {tuple(sorted((owner[edge_[0]], owner[triangle[0]]))) for _, edge_, triangle in shells.crossing_pairs(Shell(found.points, found.triangles))}
        pairs = {pair for pair in pairs if pair[0] != pair[1]}
        if not pairs:
            break
        every = clusters.joined(graph, every, pairs)
    return found, missed


def glued(every, made, count):
    """Merges the clusters' complexes into one. Also returns the missing fraction of each piece's surface, and which cluster each point comes from."""
    points, triangles, sides, cells, missed, owner = [np.zeros((0, 3))], [np.zeros((0, 3), int)], [np.zeros((0, 2), int)], [], [1.0] * count, []
    total = 0
    for k, (cluster, (found, lost, pieces)) in enumerate(zip(every, made)):
        for piece, share in zip(pieces, lost):
            missed[piece] = share
        outer = outer_cell(cluster, found, cells, points, triangles, sides)
        first = len(cells)
        cells += [pieces[piece] if piece != OUTSIDE else cluster.outer - 1 for piece in found.cells]       # a void is part of the piece around the cluster
        sides.append(np.where(found.sides == OUTSIDE, outer, found.sides + first))
        triangles.append(found.triangles + total)
        points.append(found.points)
        owner += [k] * len(found.points)
        total += len(found.points)
    return Complex(np.vstack(points), np.vstack(triangles), np.vstack(sides), cells), missed, np.array(owner, int)


def outer_cell(cluster, found, cells, points, triangles, sides):
    """Returns the cell around a cluster: the cell of the surrounding piece that contains the cluster's points."""
    around = [k for k, piece in enumerate(cells) if piece == cluster.outer - 1] if cluster.outer != AROUND else []
    if len(around) < 2 or not len(found.points):
        return around[0] if around else OUTSIDE
    whole = Complex(np.vstack(points), np.vstack(triangles), np.vstack(sides), list(range(len(cells))))
    inside = [np.mean(shells.distances(whole.surface([k]), found.points) < 0) for k in around]
    return around[int(np.argmax(inside))]


def groups_of(pieces):
    """Groups parts and pieces that overlap, directly or through others, because parts may break into pieces or merge. Returns a list of (set of parts, set of
    pieces)."""
    groups = []
    for part, piece in pieces.held:
        mine = [group for group in groups if part in group[0] or piece in group[1]]
        groups = [group for group in groups if not any(group is each for each in mine)]
        groups.append((set().union({part}, *(group[0] for group in mine)), set().union({piece}, *(group[1] for group in mine))))
    return sorted(groups, key=lambda group: min(group[0]))


def wanted_volumes(pieces, found, volumes, lost, step):
    """Returns the volume that each extracted piece must have, [([piece], volume)]. volumes: volumes of the parts, None if not to be restored. Voids keep the
    volume of their voxels, of size `step`. lost: see image_of."""
    voxels = pieces.voxels()
    wanted = [([piece], voxels[piece] * step ** 3) for piece, region in enumerate(pieces.regions) if region == OUTSIDE and piece in found.cells]
    for parts, members in groups_of(pieces):
        if any(volumes[part] is None for part in parts):
            continue
        whole = sum(volumes[part] * (1 - sum(share for (loser, _), share in lost.items() if loser == part)) for part in parts)
        all_voxels = sum(voxels[piece] for piece in members)
        wanted += [([piece], whole * voxels[piece] / all_voxels) for piece in sorted(members) if piece in found.cells]
    return wanted


def shared_surfaces(image, pieces, lost, regions, volumes, edge):
    """Returns the complex of the regions' pieces, with triangles of about this edge length, and the missing fraction of each piece's surface. image, pieces,
    lost: from image_for; regions: lists of the parts' surfaces; volumes: for the parts of all regions, None for bone, where only the surface matters and the
    volume is not restored."""
    balls = largest_balls(pieces, image.step)
    radii = thinness_of(pieces, [shell for region in regions for shell in region], balls)
    found, missed = surfaces_of_clusters(image, pieces, edge, radii, balls)
    return corrected(found, wanted_volumes(pieces, found, volumes, lost, image.step)), missed
