"""Surfaces from signed distance fields, used where a loft fails, for defective surfaces, and to keep regions apart."""
import dataclasses

import numpy as np
import shapely.vectorized
import vtk
from vtk.util.numpy_support import numpy_to_vtk

from . import shells
from .shells import configured, from_vtk, parts, pipe

VOXELS = 48        # number of voxels along the longest side of an organ's bounding box
PASS_BAND = 0.1    # pass band (0 to 2) of the smoothing filter: removes waves shorter than about six voxels


@dataclasses.dataclass
class Field:
    low: np.ndarray      # (3,) position of the first grid point
    step: float
    values: np.ndarray   # (z, y, x) signed distance, negative inside the shape

    def points(self):
        """Returns the positions of the grid points, (z * y * x, 3)."""
        k, j, i = np.indices(self.values.shape)
        return self.low + self.step * np.stack([i, j, k], axis=-1).reshape(-1, 3)

    def holding(self, volume):
        """Offsets the field uniformly, by at most two grid steps, so that its surface encloses this volume."""
        def held(level):
            return float(np.clip(0.5 - (self.values - level) / self.step, 0, 1).sum()) * self.step ** 3
        low, high = -2 * self.step, 2 * self.step
        for _ in range(30):
            middle = (low + high) / 2
            low, high = (middle, high) if held(middle) < volume else (low, middle)
        return Field(self.low, self.step, self.values - high)

    def apart_from(self, shell, gap):
        """Returns the shape without whatever is closer than `gap` to the surface of another shape, on either side."""
        reach = np.abs(self.values) < 4 * max(gap, self.step)   # farther out, the other surface has no influence
        reach |= self.values < 0
        distance = np.full(self.values.size, np.inf)
        distance[reach.ravel()] = shells.distances(shell, self.points()[reach.ravel()])
        return Field(self.low, self.step, np.maximum(self.values, gap - np.abs(distance.reshape(self.values.shape))))

    def surfaces(self):
        """Returns smooth closed surfaces where the field is zero."""
        if self.values.min() >= 0:
            return []
        image = vtk.vtkImageData()
        image.SetOrigin(*self.low)
        image.SetSpacing(self.step, self.step, self.step)
        image.SetDimensions(*self.values.shape[::-1])
        image.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(self.values).ravel(), deep=True))
        zero = vtk.vtkFlyingEdges3D()
        zero.SetValue(0, 0.0)
        smooth = configured(vtk.vtkWindowedSincPolyDataFilter(), NumberOfIterations=30, PassBand=PASS_BAND, NonManifoldSmoothing=True,
                            NormalizeCoordinates=True)
        return parts(from_vtk(pipe(image, zero, smooth)))


def grid(low, high):
    """Returns the axes and the step of a grid that covers a box with a margin."""
    step = (high - low).max() / VOXELS
    low, high = low - 2.5 * step, high + 2.5 * step
    return [np.arange(a, b + step, step) for a, b in zip(low, high)], step


def distance_to_outline(outline, x, y):
    """Returns the signed distances from points on a slice to its contour, negative inside."""
    nearest = np.full(x.shape, np.inf)
    for polygon in outline.geoms:
        for ring in (polygon.exterior, *polygon.interiors):
            points = np.array(ring.coords)
            for a, b in zip(points, points[1:]):
                way = b - a
                along = np.clip(((x - a[0]) * way[0] + (y - a[1]) * way[1]) / (way @ way), 0, 1)
                nearest = np.minimum(nearest, (x - a[0] - along * way[0]) ** 2 + (y - a[1] - along * way[1]) ** 2)
    return np.where(shapely.vectorized.contains(outline, x, y), -1, 1) * np.sqrt(nearest)


def of_stack(stack):
    """Returns the Field of a stack by shape-based interpolation between slices (Raya and Udupa 1990), extended by half a slice thickness beyond the end
    slices."""
    bounds = np.array([s.outline.bounds for s in stack.slices])
    heights = np.array([s.z for s in stack.slices])
    axes, step = grid(np.array([*bounds[:, :2].min(axis=0), heights[0] - stack.spacing / 2]),
                      np.array([*bounds[:, 2:].max(axis=0), heights[-1] + stack.spacing / 2]))
    x, y = np.meshgrid(axes[0], axes[1])
    planes = np.array([distance_to_outline(s.outline, x, y) for s in stack.slices])
    values = np.empty((len(axes[2]), *x.shape))
    for k, z in enumerate(axes[2]):
        above = int(np.clip(np.searchsorted(heights, z), 1, len(heights) - 1))
        share = np.clip((z - heights[above - 1]) / (heights[above] - heights[above - 1]), 0, 1)
        beyond = max(heights[0] - z, z - heights[-1]) - stack.spacing / 2
        values[k] = np.maximum((1 - share) * planes[above - 1] + share * planes[above], beyond)
    return Field(np.array([axis[0] for axis in axes]), step, values).holding(stack.volume())
