"""Organs, represented as in a treatment planning system by the voxels inside their contours from an RT Structure Set."""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .. import Model
from ._obstacles import BadContours, Embedding, _inside, read_all_contours
from .plan import BadPlan, Frame

Array = npt.NDArray[np.float64]

__all__ = ["Displaced", "Organ", "read_organs", "voxels"]

ROLES = ("gland", "urethra", "rectum")
DEFAULTS = {"gland": "Prostate", "urethra": "Urethra", "rectum": "Rectum"}
SPACING = 1.0      # mm, maximum voxel size
SAME = 0.01        # mm, contours whose heights differ by no more than this are on the same slice


@dataclass
class Organ:
    """An organ of the patient, at rest."""

    role: str                # gland, urethra or rectum
    name: str                # name of the region of interest
    outlines: list[Array]    # (n, 3) mm each, in patient coordinates
    points: Array            # (n, 3) m, centres of its voxels, in mesh coordinates
    voxel: float             # m^3, volume of a voxel

    @property
    def volume(self) -> float:
        """The volume in m^3."""
        return self.voxel * len(self.points)

    def select(self, keep: npt.NDArray[np.bool_]) -> Organ:
        """Returns the part of the organ made up of the voxels in the mask."""
        return Organ(self.role, self.name, self.outlines, self.points[keep], self.voxel)


def voxels(outlines: list[Array], spacing: float = SPACING) -> tuple[Array, float]:
    """Voxelises contours on axial slices. Returns the voxel centres (n, 3) mm and the volume (mm^3) of a voxel. As in planimetry, each contour extends
    halfway to the neighbouring slices, and by half a slice spacing beyond the first and last ones. A contour inside another on the same slice is a hole."""
    heights = np.array([outline[:, 2].mean() for outline in outlines])
    slices: list[float] = []
    for height in np.sort(heights):
        if not slices or height > slices[-1] + SAME:
            slices.append(float(height))
    pitch = float(np.diff(slices).min()) if len(slices) > 1 else spacing
    layers = max(math.ceil(pitch / spacing - 1e-9), 1)
    step = pitch / layers
    low, high = np.min([o.min(axis=0) for o in outlines], axis=0), np.max([o.max(axis=0) for o in outlines], axis=0)
    grid = np.stack(np.meshgrid(*(np.arange(a + 0.5 * spacing, b + spacing, spacing) for a, b in zip(low[:2], high[:2])), indexing="ij"), -1).reshape(-1, 2)
    flat = []
    for height in slices:
        inside = np.zeros(len(grid), bool)
        for outline in (o for o, z in zip(outlines, heights) if abs(z - height) <= SAME):
            inside ^= _inside(outline[:, :2], grid)
        flat.append(grid[inside])
    levels = np.arange(slices[0] - 0.5 * pitch + 0.5 * step, slices[-1] + 0.5 * pitch, step)
    nearest = np.abs(levels[:, None] - slices).argmin(axis=1)
    return np.concatenate([np.column_stack([flat[k], np.full(len(flat[k]), level)]) for level, k in zip(levels, nearest)]), spacing * spacing * step


def read_organs(path: str, model: Model, names: dict[str, str | None]) -> dict[str, Organ]:
    """Reads the organs from an RT Structure Set. names: for each role, the name of the region of interest, case-insensitive; None means the role's usual
    name, if the file has it. Raises BadPlan if the gland or a named organ is missing, or has contours that are not on axial slices."""
    try:
        rois = read_all_contours(path)
    except BadContours as error:
        raise BadPlan(str(error)) from error
    frame, found = Frame(model), {}
    if not frame.is_patient:
        raise BadPlan(f"{path}: the scene has no patient_to_mesh, which outlines need: trocar-anatomy writes it")
    for role in ROLES:
        wanted = names.get(role) or DEFAULTS[role]
        name = next((roi for roi in rois if roi.casefold() == wanted.casefold()), None)
        if name is None and (names.get(role) or role == "gland"):
            raise BadPlan(f"{path}: no region of interest \"{wanted}\" for the {role}: name it with --{role}; there are {', '.join(rois) or 'none'}")
        if name is None:
            continue
        outlines = [outline for outline in rois[name] if len(outline) >= 3]
        if not outlines or any(np.ptp(outline[:, 2]) > SAME for outline in outlines) or not all(np.isfinite(outline).all() for outline in outlines):
            raise BadPlan(f"{path}: {name}: {'no closed outline' if not outlines else 'an outline is not in a plane z = const'}: export axial outlines")
        centres, volume = voxels(outlines)
        if not len(centres):
            raise BadPlan(f"{path}: {name}: smaller than a voxel of {SPACING:g} mm")
        found[role] = Organ(role, name, outlines, frame.to_mesh(centres), 1e-9 * volume)
    if "urethra" in found:    # keep only the prostatic urethra
        points, gland = found["urethra"].points, found["gland"].points
        inside = ((points >= gland.min(axis=0)) & (points <= gland.max(axis=0))).all(axis=1)
        if inside.any():
            found["urethra"] = found["urethra"].select(inside)
    return found


class Displaced:
    """Maps points and seeds to tissue displaced by nodal displacements (nodes, 3) m."""

    def __init__(self, model: Model, field: Array) -> None:
        self._embedding, self._field = Embedding(model), field

    def points(self, points: Array) -> Array:
        """Returns the displaced positions (n, 3) m of points at rest."""
        nodes, weights = self._embedding.locate(points)
        return points + np.einsum("nk,nki->ni", weights, self._field[nodes])

    def seeds(self, seeds: list[tuple[Array, Array]], length: float) -> list[tuple[Array, Array]]:
        """Returns the positions and directions of seeds of this length (m) in the displaced tissue. Each end of a seed moves with the tissue."""
        ends = self.points(np.reshape([[p - 0.5 * length * d, p + 0.5 * length * d] for p, d in seeds], (-1, 3))).reshape(-1, 2, 3)
        return [(0.5 * (a + b), (b - a) / np.linalg.norm(b - a)) for a, b in ends]
