"""Finds the tetrahedra of a model's mesh that contain points."""
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from . import Model

Array = npt.NDArray[np.float64]


def locate(model: Model, points: npt.ArrayLike) -> tuple[npt.NDArray[np.intp], Array]:
    """Returns the tetrahedra (k,) that contain the points (k, 3) (m, at rest), or -1 for points outside the tissue, and the points' barycentric
    weights (k, 4)."""
    corners = model.nodes[model.tets]
    inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))
    tets, weights = [], []
    for point in np.asarray(points, np.float64):
        inner = np.einsum("tij,tj->ti", inverse, point - corners[:, 0])
        every = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
        best = int(every.min(axis=1).argmax())
        tets.append(best if every[best].min() > -1e-9 else -1)
        weights.append(every[best])
    return np.array(tets, np.intp), np.reshape(weights, (-1, 4))
