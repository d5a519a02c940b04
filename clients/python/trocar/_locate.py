"""Finds the tetrahedra of a model's mesh that contain points, and the distance of points from its surfaces."""
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from . import Model

Array = npt.NDArray[np.float64]


def weight_gradients(corners: Array) -> Array:
    """Returns the gradients (k, 3, 3), in 1/m, of the barycentric coordinates 1 to 3 of tetrahedra with these corners (k, 4, 3). The 3 x 3 inverse is
    written out because OpenBLAS uses several threads even for systems this small, and on a busy machine they can wait seconds for each other."""
    a, b, c = (corners[:, 1:] - corners[:, :1]).transpose(1, 0, 2)
    normals = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    return normals / np.einsum("ti,ti->t", a, normals[:, 0])[:, None, None]


def locate(model: Model, points: npt.ArrayLike) -> tuple[npt.NDArray[np.intp], Array]:
    """Finds the tetrahedra that contain points (k, 3), in m, in the tissue at rest. Returns their indices (k,), -1 for points outside the tissue, and
    the points' barycentric coordinates (k, 4)."""
    corners = model.nodes[model.tets]
    gradients = weight_gradients(corners)
    tets, weights = [], []
    for point in np.asarray(points, np.float64):
        inner = np.einsum("tij,tj->ti", gradients, point - corners[:, 0])
        every = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
        best = int(every.min(axis=1).argmax())
        tets.append(best if every[best].min() > -1e-9 else -1)
        weights.append(every[best])
    return np.array(tets, np.intp), np.reshape(weights, (-1, 4))


def distance(points: npt.ArrayLike, triangles: Array) -> Array:
    """Returns the distance (k,), in m, of each point (k, 3) from the nearest of the triangles (m, 3 corners, 3)."""
    sides = np.roll(triangles, -1, axis=1) - triangles
    normals = np.cross(sides[:, 0], sides[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    inwards = np.cross(normals[:, None], sides)
    found = []
    for point in np.asarray(points, np.float64):
        offsets = point - triangles
        above = (np.einsum("tsi,tsi->ts", inwards, offsets) >= 0.0).all(axis=1)    # the foot of the perpendicular lies in the triangle
        along = np.clip(np.einsum("tsi,tsi->ts", sides, offsets) / np.einsum("tsi,tsi->ts", sides, sides), 0.0, 1.0)
        to_sides = np.linalg.norm(offsets - along[:, :, None] * sides, axis=2).min(axis=1)
        found.append(np.where(above, np.abs(np.einsum("ti,ti->t", normals, offsets[:, 0])), to_sides).min())
    return np.array(found, np.float64)
