"""Closed triangulated surfaces, and operations on them with VTK."""
import dataclasses

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

vtk.vtkSMPTools.SetBackend("Sequential")   # VTK's threads do not exist in the processes forked by `limits`

OFFSETS = 4       # maximum number of iterations when offsetting a surface to a given volume
SPLINTER = 0.01   # remove parts smaller than this fraction of the largest part


@dataclasses.dataclass
class Shell:
    points: np.ndarray       # (n, 3)
    triangles: np.ndarray    # (m, 3)

    def _normals(self):
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return np.cross(b - a, c - a) / 2

    def area(self):
        return float(np.linalg.norm(self._normals(), axis=1).sum())

    def cones(self, apex):
        """Returns the total signed volume of the tetrahedra between a point and the triangles."""
        return float(np.einsum("ij,ij->", self._normals(), self.points[self.triangles[:, 0]] - apex)) / 3

    def signed_volume(self):
        """Returns the enclosed volume, negative if the normals point inward."""
        return self.cones(self.points[0])

    def about_middle(self):
        """Returns the volume between the mean of the points and the triangles. For an open surface, the cones over its holes are missing from it."""
        return abs(self.cones(self.points.mean(axis=0)))

    def volume(self):
        return abs(self.signed_volume())

    def facing_outward(self):
        """Returns the surface with outward normals, reversing all triangles if necessary."""
        return self if self.signed_volume() > 0 else Shell(self.points, self.triangles[:, ::-1])

    def holding(self, volume):
        """Offsets the surface along its normals, by the same distance everywhere, so that it encloses this volume."""
        points = self.points
        for _ in range(OFFSETS):
            moved = Shell(points, self.triangles)
            missing, area = volume - moved.signed_volume(), moved.area()
            if abs(missing) < 1e-3 * volume:
                break
            normals = np.zeros_like(points)
            for k in range(3):
                np.add.at(normals, self.triangles[:, k], moved._normals())
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            points = points + missing / area * normals / np.where(length > 0, length, 1)
        return Shell(points, self.triangles)

    def centre(self):
        return (self.points.min(axis=0) + self.points.max(axis=0)) / 2

    def edges(self):
        """Returns the edges (k, 2) as pairs of point indices, without duplicates."""
        return np.unique(np.sort(np.concatenate([self.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1), axis=0)

    def scaled(self, factor):
        """Returns the surface scaled about its centre."""
        return Shell(self.centre() + factor * (self.points - self.centre()), self.triangles)


def configured(filter_, **settings):
    for name, value in settings.items():
        getattr(filter_, "Set" + name)(value)
    return filter_


def pipe(source, *filters):
    """Runs a chain of VTK filters and returns its output."""
    for each in filters:
        each.SetInputData(source)
        each.Update()
        source = each.GetOutput()
    return source


def to_vtk(shell):
    surface, points, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(shell.points), deep=True))
    table = np.column_stack([np.full(len(shell.triangles), 3), shell.triangles]).astype(np.int64)
    cells.SetCells(len(table), numpy_to_vtkIdTypeArray(table.ravel(), deep=True))
    surface.SetPoints(points)
    surface.SetPolys(cells)
    return surface


def from_vtk(surface):
    return Shell(vtk_to_numpy(surface.GetPoints().GetData()).astype(float), vtk_to_numpy(surface.GetPolys().GetData()).reshape(-1, 4)[:, 1:])


def all_parts(shell):
    """Returns the connected components, largest first."""
    pick = configured(vtk.vtkPolyDataConnectivityFilter(), ExtractionMode=vtk.VTK_EXTRACT_SPECIFIED_REGIONS)
    source = to_vtk(shell)
    pick.SetInputData(source)
    pick.Update()
    found = []
    for region in range(pick.GetNumberOfExtractedRegions()):
        pick.InitializeSpecifiedRegionList()
        pick.AddSpecifiedRegion(region)
        pick.Update()
        found.append(oriented(from_vtk(pipe(pick.GetOutput(), vtk.vtkCleanPolyData()))))
    return sorted(found, key=lambda part: -part.volume())


def parts(shell):
    """Returns the connected components that are not splinters, largest first."""
    found = all_parts(shell)
    return [part for part in found if part.volume() > SPLINTER * found[0].volume()]


def outermost(found):
    """Returns the closed surfaces that are not inside a larger one, that is, without the surfaces of cavities."""
    ordered, kept = sorted((part for shell in found for part in all_parts(shell)), key=lambda part: -part.volume()), []
    for part in ordered:
        if part.volume() > SPLINTER * ordered[0].volume() and not any(distances(other, part.points[:1])[0] < 0 for other in kept):
            kept.append(part)
    return kept


def solids(found):
    """Combines connected surfaces with outward normals into one surface per solid: its outer surface plus those of its cavities, reversed so that their normals
    point into the cavities."""
    ordered, around = sorted(found, key=lambda part: -part.volume()), []
    for n, part in enumerate(ordered):
        around.append([k for k in range(n) if is_within(part, ordered[k])])
    made = {n: [part] for n, part in enumerate(ordered) if len(around[n]) % 2 == 0}
    for n, part in enumerate(ordered):
        if len(around[n]) % 2:
            made[around[n][-1]].append(Shell(part.points, part.triangles[:, ::-1]))     # goes to the smallest solid around it
    return [joined(parts_) for parts_ in made.values()]


def is_within(part, other):
    if np.any(part.points.min(axis=0) <= other.points.min(axis=0)) or np.any(part.points.max(axis=0) >= other.points.max(axis=0)):
        return False
    return bool(np.all(distances(other, part.points) < 0))


def joined(found):
    first = np.cumsum([0] + [len(shell.points) for shell in found])
    return Shell(np.vstack([shell.points for shell in found]), np.vstack([shell.triangles + at for shell, at in zip(found, first)]))


def oriented(shell):
    """Orients all triangles of a connected surface outward. Relative orientations that are already consistent are kept, because where four triangles meet at an
    edge, as between two voxels that share only an edge, they alone tell which triangles belong together."""
    made = shell if triangles_agree(shell) else sheets_turned(shell)
    return made if made.signed_volume() > 0 else Shell(made.points, made.triangles[:, ::-1])


def triangles_agree(shell):
    """Whether the triangles are consistently oriented: each edge is traversed equally often in both directions."""
    ends = np.concatenate([shell.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
    _, edge = np.unique(np.sort(ends, axis=1) @ [len(shell.points), 1], return_inverse=True)
    return not np.any(np.bincount(edge.reshape(-1), np.where(ends[:, 0] < ends[:, 1], 1, -1)))


def sheets_turned(shell):
    """Orients the triangles of each sheet consistently, and each sheet outward."""
    normals = configured(vtk.vtkPolyDataNormals(), Consistency=True, NonManifoldTraversal=False, Splitting=False, ComputePointNormals=False,
                         ComputeCellNormals=True)     # VTK does nothing unless asked for some kind of normals
    alike = from_vtk(pipe(to_vtk(shell), normals))
    sheet, triangles, middle = sheets_of(alike)[0], alike.triangles.copy(), alike.points.mean(axis=0)
    for each in np.unique(sheet):
        if Shell(alike.points, triangles[sheet == each]).cones(middle) < 0:
            triangles[sheet == each] = triangles[sheet == each][:, ::-1]
    return Shell(alike.points, triangles)


def decimated(shell, triangles):
    """Decimates a surface to at most about this many triangles, keeping its volume."""
    if len(shell.triangles) <= triangles:
        return shell
    return from_vtk(pipe(to_vtk(shell), configured(vtk.vtkQuadricDecimation(), TargetReduction=1 - triangles / len(shell.triangles),
                                                   VolumePreservation=True)))


def mended(surface):
    """Repairs a surface from a file: keeps only triangles, merges points, fills holes and orients normals outward. Returns the surface and remarks."""
    holes = configured(vtk.vtkFillHolesFilter(), HoleSize=0.2 * surface.GetLength())
    triangles = configured(vtk.vtkTriangleFilter(), PassLines=False, PassVerts=False)
    merged = pipe(surface, triangles, configured(vtk.vtkCleanPolyData(), Tolerance=1e-5))
    whole, fins = without_fins(from_vtk(merged))
    dropped = surface.GetNumberOfPolys() - merged.GetNumberOfPolys()
    merged = to_vtk(whole) if fins else merged
    closed = all_parts(from_vtk(pipe(merged, holes, triangles.NewInstance())))
    result, notes, torn = to_vtk(joined(solids(closed))), [], open_edges(merged)
    if fins:
        notes.append(f"{fins} facets that stick out and enclose nothing were dropped")
    if torn and not open_edges(result):
        before, after = from_vtk(merged).about_middle(), from_vtk(result).volume()
        notes.append(f"holes of {torn} edges in all were closed, which changes its volume by {100 * (after / before - 1):+.2f} %")
    if dropped > 0:
        notes.append(f"{dropped} facets without an area were dropped")
    branching = edges_of(merged, "NonManifoldEdges")
    if branching:
        notes.append(f"more than two facets meet at {branching} edges: the volume is everything that the surface encloses")
    return result, notes


def sheets_of(shell):
    """Divides a surface into sheets, which are connected across edges where exactly two triangles meet. Returns each triangle's sheet and edges, and how many
    triangles meet at each edge."""
    edges = np.sort(np.concatenate([shell.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), axis=1)
    _, edge, often = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(3, -1).T       # of each triangle
    order = np.argsort(edge.T.ravel(), kind="stable")
    owner = np.tile(np.arange(len(edge)), 3)[order]
    sorted_edges = edge.T.ravel()[order]
    pairs = np.flatnonzero((sorted_edges[1:] == sorted_edges[:-1]) & (often[sorted_edges[1:]] == 2))
    return connected(len(edge), np.column_stack([owner[pairs], owner[pairs + 1]])), edge, often


def without_fins(shell):
    """Removes fins: sheets with a free border that are attached to the rest along edges where more than two triangles meet. Returns the surface and the number
    of triangles removed."""
    sheet, edge, often = sheets_of(shell)
    if not np.any(often > 2):
        return shell, 0
    area = np.bincount(sheet, np.linalg.norm(shell._normals(), axis=1), len(edge))
    open_, hanging = (np.isin(sheet, sheet[(condition[edge]).any(axis=1)]) for condition in (often == 1, often > 2))
    fin = open_ & hanging & (area[sheet] < area.max())
    return Shell(shell.points, shell.triangles[~fin]), int(np.count_nonzero(fin))


def connected(count, pairs):
    """For each number below `count`, returns the smallest number that the pairs (k, 2) connect it to."""
    root = np.arange(count)
    while True:
        before = root.copy()
        least = np.minimum(root[pairs[:, 0]], root[pairs[:, 1]])
        order = np.argsort(-least, kind="stable")
        root[pairs[order].ravel()] = np.repeat(least[order], 2)    # of several values assigned to one element, the last wins, and it is the smallest
        root = root[root]
        if np.array_equal(root, before):
            return root


def edges_of(surface, kind):
    """Counts the edges of this type."""
    edges = configured(vtk.vtkFeatureEdges(), BoundaryEdges=False, FeatureEdges=False, ManifoldEdges=False, NonManifoldEdges=False)
    return pipe(surface, configured(edges, **{kind: True})).GetNumberOfCells()


def open_edges(surface):
    return edges_of(surface, "BoundaryEdges")


def crossings(shells):
    """Yields (point, i, j) wherever an edge of shell i passes through a triangle of shell j that contains neither of its ends."""
    owner = np.repeat(np.arange(len(shells)), [len(shell.points) for shell in shells])   # index of the shell to which each point belongs
    for point, edge, triangle in crossing_pairs(joined(shells)):
        yield point, owner[edge[0]], owner[triangle[0]]


def crossing_pairs(whole):
    """Yields (point, edge, triangle) wherever an edge of the surface passes through one of its triangles that contains neither end of the edge (Moeller and
    Trumbore 1997). Edges and triangles are given by their corners. Candidates come from VTK's locator."""
    locator, near, surface = vtk.vtkStaticCellLocator(), vtk.vtkIdList(), to_vtk(whole)
    locator.SetDataSet(surface)
    locator.BuildLocator()
    edges = whole.edges()
    margin = 1e-9 * np.ptp(whole.points, axis=0).max()
    boxes = np.sort(whole.points[edges], axis=1) + np.array([[-margin], [margin]])
    counts, triangles = np.zeros(len(edges), int), []
    for k, box in enumerate(boxes.transpose(0, 2, 1).reshape(-1, 6).tolist()):
        locator.FindCellsWithinBounds(box, near)
        counts[k] = near.GetNumberOfIds()
        triangles += map(near.GetId, range(counts[k]))
    edges, triangles = np.repeat(edges, counts, axis=0), np.array(triangles, int)
    same = np.unique(whole.points, axis=0, return_inverse=True)[1].reshape(-1)    # shells may have points in common
    apart = ~np.any(same[whole.triangles[triangles]][:, :, None] == same[edges][:, None, :], axis=(1, 2))
    edges, triangles = edges[apart], triangles[apart]
    corner, b, c = (whole.points[whole.triangles[triangles, k]] for k in range(3))
    ab, ac = b - corner, c - corner
    start, way = whole.points[edges[:, 0]], whole.points[edges[:, 1]] - whole.points[edges[:, 0]]
    across, offset = np.cross(way, ac), start - corner
    over = np.cross(offset, ab)
    with np.errstate(divide="ignore", invalid="ignore"):
        along, u, v = np.array([(ac * over).sum(axis=1), (offset * across).sum(axis=1), (over * way).sum(axis=1)]) / (ab * across).sum(axis=1)
        through = np.flatnonzero((along > 0) & (along < 1) & (u > 0) & (v > 0) & (u + v < 1))
    for k in through:
        yield start[k] + along[k] * way[k], edges[k], whole.triangles[triangles[k]]


def distances(shell, points):
    """Returns the signed distances from points (n, 3) to a closed shell, negative inside."""
    distance = vtk.vtkImplicitPolyDataDistance()
    distance.SetInput(to_vtk(shell))
    values = vtk.vtkDoubleArray()
    distance.FunctionValue(numpy_to_vtk(np.ascontiguousarray(points, float), deep=True), values)
    return vtk_to_numpy(values).copy()
