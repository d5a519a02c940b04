"""Draws regions slice by slice: as read (grey) and as interpreted (blue)."""
import math

import numpy as np
import vtk

from . import quality  # sets matplotlib up
from .shapes import shells
from .quality import plt

PANELS = 60     # at most
LEVELS = 12     # maximum number of slices through a region that was read from labels or a surface
NEAR = 0.03     # a slice shows the input points closer to it than this fraction of the region's height


def panel(axis, title, rings, lines):
    """Draws one slice. rings: the contours as read, arrays (n, 2) or wider, drawn closed; lines: the contours as interpreted."""
    for ring in rings:
        if ring.ndim == 2 and len(ring):
            axis.plot(*np.vstack([ring, ring[:1]])[:, :2].T, color="0.6", linewidth=0.8, marker=".", markersize=2)
    for line in lines:
        axis.plot(*line.T, color="#0072B2", linewidth=1)
    axis.set_title(title, fontsize=6)
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.tick_params(labelsize=5)


def sheet(panels, path):
    """Draws a sheet of panels. panels: tuples (title, rings, lines) or (title, rings, lines, points)."""
    more = len(panels) - PANELS
    panels = panels[:PANELS]
    columns = min(6, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(1.9 * columns, 2.0 * rows), squeeze=False, layout="constrained")
    for axis in axes.flat[len(panels):]:
        axis.axis("off")
    for axis, (title, rings, lines, *points) in zip(axes.flat, panels):
        for each in points:
            axis.plot(*each.T, linestyle="", color="0.6", marker=".", markersize=2)
        panel(axis, title, rings, lines)
    if more > 0:
        figure.suptitle(f"and {more} more", fontsize=8)
    figure.savefig(path, metadata={"Date": None, "Title": "Outlines"})
    plt.close(figure)


def draw(organs, regions, path):
    """Draws all regions. organs: all organs, including the body; regions: as in sources.Sources."""
    panels, levels = [], min(LEVELS, max(1, PANELS // len(organs)))     # few enough slices for all regions to fit
    for organ in organs:
        panels += panels_of_stack(organ.stack, regions[organ.roi]) if organ.stack else panels_of_shells(organ, levels)
    sheet(panels, path)


def panels_of_stack(stack, rings):
    panels = []
    for z, outline in sorted([(s.z, s.outline) for s in stack.slices] + [(z, None) for z in stack.left_out], key=lambda pair: pair[0]):
        here = [ring for ring in rings if len(ring) and abs(np.median(ring[:, 2]) - z) < 0.2]
        title = f"{stack.name}, z = {z:g} mm"
        lines = [np.array(ring.coords) for polygon in outline.geoms for ring in (polygon.exterior, *polygon.interiors)] if outline else []
        panels.append((title if outline else f"{title}\nleft out: encloses too little", here, lines))
    return panels


def panels_of_shells(organ, levels):
    """Returns panels of axial slices through closed surfaces, with the input points near each slice: on voxel faces for labels, or on the surface in the
    file."""
    low, high = (bound(np.vstack([shell.points for shell in organ.shells])[:, 2]) for bound in (np.min, np.max))
    height, panels = high - low, []
    for z in low + height * (np.arange(levels) + 0.5) / levels:
        near = organ.points[np.abs(organ.points[:, 2] - z) < NEAR * height]
        panels.append((f"{organ.roi}, z = {z:.1f} mm", [], [line for shell in organ.shells for line in section(shell, z)], near[:, :2]))
    return panels


def section(shell, z):
    """Returns the lines (n, 2) along which a surface intersects a plane of constant z."""
    plane = vtk.vtkPlane()
    plane.SetOrigin(0, 0, z)
    plane.SetNormal(0, 0, 1)
    lines = shells.pipe(shells.to_vtk(shell), shells.configured(vtk.vtkCutter(), CutFunction=plane), vtk.vtkStripper())
    return [np.array([lines.GetPoint(lines.GetCell(k).GetPointId(n))[:2] for n in range(lines.GetCell(k).GetNumberOfPoints())])
            for k in range(lines.GetNumberOfCells())]


def draw_problem(error, path):
    if error.rings:
        sheet([(str(error)[:60], [ring for ring in error.rings if len(ring)], [])], path)
