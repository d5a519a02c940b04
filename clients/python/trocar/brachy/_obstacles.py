"""Obstacles that a planned needle must avoid: mesh surfaces and regions, and contours from the patient's images. Each is represented by points that move
with the tissue."""
from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from typing import Callable

import numpy as np
import numpy.typing as npt

from .. import Model
from .._files import open_input
from .._locate import weight_gradients

Array = npt.NDArray[np.float64]

NEAR = 24    # to find the tetrahedron that contains a point, try this many whose centres are closest


class Embedding:
    """Attaches points to the mesh at rest so that they can move with the tissue. A point outside the tissue moves with the closest node."""

    def __init__(self, model: Model):
        from scipy.spatial import cKDTree
        corners = model.nodes[model.tets]
        self._tets, self._first = model.tets, corners[:, 0]
        self._gradients = weight_gradients(corners)
        self._centres, self._nodes = cKDTree(corners.mean(axis=1)), cKDTree(model.nodes)

    def locate(self, points: Array) -> tuple[npt.NDArray[np.int32], Array]:
        """For points (n, 3) m, returns the nodes (n, 4) of the tetrahedron that contains each point, and the barycentric weights (n, 4)."""
        near = self._centres.query(points, min(NEAR, len(self._tets)))[1].reshape(len(points), -1)
        inner = np.einsum("nkij,nkj->nki", self._gradients[near], points[:, None] - self._first[near])
        weights = np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)
        best = weights.min(axis=2).argmax(axis=1)
        rows = np.arange(len(points))
        nodes, weights = self._tets[near[rows, best]], weights[rows, best]
        # Allow slight extrapolation for a point just outside the tissue, or in a flat element whose centre is not among the closest.
        outside = weights.min(axis=1) < -0.05
        nodes[outside], weights[outside] = self._nodes.query(points[outside])[1][:, None], 0.25
        return nodes, weights


@dataclass
class Obstacle:
    """An obstacle, given by points in the tissue at rest."""

    name: str
    clearance: float    # m, desired distance from the needle's surface
    points: Array       # (n, 3) m

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree
        self._tree = cKDTree(self.points)
        self._low, self._high = self.points.min(axis=0), self.points.max(axis=0)

    def distance(self, shaft: Array, radius: float, embedding: Embedding | None = None, field: Array | None = None, enough: float = math.inf) -> float:
        """Returns the distance (m) between the obstacle and the surface of a needle with this centreline (n, 3) and radius (m). It is negative if the
        needle cuts through the obstacle's points. The tissue is at rest, or displaced by `field` (nodes, 3) m. To save time, distances known to exceed
        `enough` (m) may be replaced with a lower bound."""
        line = _refined(shaft, 0.5e-3)
        apart = np.maximum(self._low - line, line - self._high).max(axis=1)    # distance from each needle point to the obstacle's bounding box
        moved = 0.0 if field is None else float(np.linalg.norm(field, axis=1).max())
        if apart.min() - moved - radius > enough:
            return float(apart.min()) - moved - radius
        apart_first = np.argsort(apart, kind="stable")
        nearest = float(self._tree.query(line[apart_first[:32]])[0].min())
        line = line[apart <= nearest + 2.0 * moved]    # no other needle point can be the closest
        nearest = min(nearest, float(self._tree.query(line, distance_upper_bound=nearest)[0].min()))
        if field is None:
            return nearest - radius
        if nearest - moved - radius > enough:
            return nearest - moved - radius
        from scipy.spatial import cKDTree
        # A point that could be the closest in the displaced tissue is at most this far away at rest. The margin covers rounding errors.
        reach = (nearest + 2.0 * moved) * (1.0 + 1e-9)
        close = np.unique(np.concatenate(self._tree.query_ball_point(line, reach)).astype(int))
        points = self.points[close]
        nodes, weights = embedding.locate(points)
        points = points + np.einsum("nk,nki->ni", weights, field[nodes])
        return float(cKDTree(points).query(line)[0].min()) - radius


def _refined(line: Array, spacing: float) -> Array:
    """Adds points to a polyline until neighbours are at most `spacing` (m) apart."""
    parts = [np.linspace(a, b, max(math.ceil(np.linalg.norm(b - a) / spacing), 1), endpoint=False) for a, b in zip(line[:-1], line[1:])]
    return np.concatenate([*parts, line[-1:]])


def spacing_of(clearance: float) -> float:
    """Returns how densely (m) to sample an obstacle so that distances are accurate to an eighth of the clearance."""
    return float(np.clip(0.5 * clearance, 0.25e-3, 1e-3))


def _simplex_points(corners: Array, spacing: float, most: float) -> Array:
    """Fills triangles or tetrahedra with corners (n, 3 or 4, 3) with points at most `spacing` apart. Raises ValueError if that takes more than `most`
    points, counting a point once for every element that shares it."""
    found, count = [], corners.shape[1]
    edges = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3).max(axis=(1, 2))
    parts = np.maximum(np.ceil(edges / spacing).astype(int), 1)
    needed = float(np.prod([parts + 1.0 + i for i in range(count - 1)], axis=0).sum()) / math.factorial(count - 1)
    if needed > most:
        raise ValueError(f"it would be {needed:.2g} points, {1e3 * spacing:g} mm apart")
    for n in np.unique(parts):
        grid = np.stack(np.meshgrid(*[np.arange(n + 1)] * (count - 1), indexing="ij"), -1).reshape(-1, count - 1)
        grid = grid[grid.sum(axis=1) <= n] / n
        weights = np.concatenate([1.0 - grid.sum(axis=1, keepdims=True), grid], axis=1)
        found.append(np.einsum("wk,nki->nwi", weights, corners[parts == n]).reshape(-1, 3))
    return np.unique(np.round(np.concatenate(found), 9), axis=0) if found else np.empty((0, 3))


def surface_points(model: Model, name: str, spacing: float, most: float = math.inf) -> Array:
    return _simplex_points(model.nodes[model.surface(name)], spacing, most)


def region_points(model: Model, name: str, spacing: float, most: float = math.inf) -> Array:
    return _simplex_points(model.nodes[model.tets_of(name)], spacing, most)


# ---- contours ---------------------------------------------------------------------------------------------------------------------------


class BadContours(Exception):
    """Raised if contours cannot be used. The message gives the file and line and says how to fix it."""


def read_contours(path: str, roi: str) -> list[Array]:
    """Reads the contours (n, 3) of a region of interest, in mm in patient coordinates, from a CSV table (roi, outline, x_mm, y_mm, z_mm) or an RT
    Structure Set."""
    outlines = read_all_contours(path)
    if roi not in outlines:
        raise BadContours(f"{path}: no region of interest \"{roi}\": there are {', '.join(outlines) or 'none'}")
    return outlines[roi]


def read_all_contours(path: str) -> dict[str, list[Array]]:
    """Like `read_contours`, but reads all regions of interest and returns their contours by name."""
    return _read_table(path) if path.endswith(".csv") else _read_structures(path)


def _read_table(path: str) -> dict[str, list[Array]]:
    found: dict[str, dict[str, list[list[float]]]] = {}
    try:
        with open_input(path, newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadContours(f"{path}: cannot be read: {error}") from error
    if not rows or [cell.strip() for cell in rows[0]] != ["roi", "outline", "x_mm", "y_mm", "z_mm"]:
        raise BadContours(f"{path}:1: not a table of outlines: write the columns roi,outline,x_mm,y_mm,z_mm")
    for line, row in enumerate(rows[1:], 2):
        try:
            roi, outline, *point = row
            point = [float(value) for value in point]
        except ValueError:
            point = []
        if len(point) != 3 or not all(map(math.isfinite, point)):
            raise BadContours(f"{path}:{line}: write a name, an outline and three numbers")
        found.setdefault(roi, {}).setdefault(outline, []).append(point)
    return {roi: [np.array(points) for points in outlines.values()] for roi, outlines in found.items()}


def _read_structures(path: str) -> dict[str, list[Array]]:
    try:
        from . import _dicom
        data = _dicom.read(path)
        names = {item.ROINumber: str(item.ROIName) for item in data.StructureSetROISequence}
        return {names[item.ReferencedROINumber]: [np.array(c.ContourData, np.float64).reshape(-1, 3) for c in item.get("ContourSequence", [])]
                for item in data.ROIContourSequence}
    except ImportError as missing:
        raise BadContours(f"{path}: DICOM files need Debian's python3-pydicom: {missing}") from missing
    except EOFError as error:
        raise BadContours(str(error)) from error
    except OSError as error:
        raise BadContours(f"{path}: cannot be opened: {error.strerror}") from error
    except Exception as error:  # noqa: BLE001    a damaged file can make pydicom raise almost anything
        raise BadContours(f"{path}: not an RT Structure Set: {error}") from error


def _inside(polygon: Array, points: Array) -> npt.NDArray[np.bool_]:
    """Tests which points lie inside a plane polygon, by the even-odd rule."""
    odd = np.zeros(len(points), bool)
    for (x1, y1), (x2, y2) in zip(polygon, np.roll(polygon, -1, axis=0)):
        crosses = (y1 > points[:, 1]) != (y2 > points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            odd ^= crosses & (points[:, 0] < (x2 - x1) * (points[:, 1] - y1) / (y2 - y1) + x1)
    return odd


def contour_points(outlines: list[Array], to_mesh: Callable[[Array], Array], spacing: float) -> Array:
    """Fills contours on axial slices with points at most `spacing` (m) apart. As in planimetry, each contour extends by half a slice spacing to either
    side."""
    step = 1e3 * spacing
    heights = np.unique(np.round([outline[:, 2].mean() for outline in outlines], 3))
    pitch = float(np.diff(heights).min()) if len(heights) > 1 else step
    layers = max(math.ceil(pitch / step), 1)
    found = []
    for outline in outlines:
        low, high = outline[:, :2].min(axis=0), outline[:, :2].max(axis=0)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + step, step) for a, b in zip(low, high)), indexing="ij"), -1).reshape(-1, 2)
        flat = np.concatenate([grid[_inside(outline[:, :2], grid)], _refined(np.concatenate([outline, outline[:1]]), step)[:, :2]])
        for offset in (np.arange(layers) + 0.5) / layers - 0.5:
            found.append(np.column_stack([flat, np.full(len(flat), outline[:, 2].mean() + offset * pitch)]))
    return to_mesh(np.concatenate(found))
