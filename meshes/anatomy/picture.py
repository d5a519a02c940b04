"""Outlines as read (grey) and as interpreted (blue), one panel per slice."""
import math

import numpy as np

from . import quality  # sets matplotlib up
from .quality import plt

PANELS = 60     # at most


def panel(axis, title, rings, polygons):
    for ring in rings:
        axis.plot(*np.vstack([ring, ring[:1]])[:, :2].T, color="0.6", linewidth=0.8, marker=".", markersize=2)
    for polygon in polygons:
        for ring in (polygon.exterior, *polygon.interiors):
            axis.plot(*np.array(ring.coords).T, color="#0072B2", linewidth=1)
    axis.set_title(title, fontsize=6)
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.tick_params(labelsize=5)


def sheet(panels, path):
    more = len(panels) - PANELS
    panels = panels[:PANELS]
    columns = min(6, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure, axes = plt.subplots(rows, columns, figsize=(1.9 * columns, 2.0 * rows), squeeze=False, layout="constrained")
    for axis in axes.flat[len(panels):]:
        axis.axis("off")
    for axis, contents in zip(axes.flat, panels):
        panel(axis, *contents)
    if more > 0:
        figure.suptitle(f"and {more} more", fontsize=8)
    figure.savefig(path, metadata={"Date": None, "Title": "Outlines"})
    plt.close(figure)


def draw(stacks, rings, path):
    """`rings`: ROI name -> its rings."""
    panels = []
    for stack in stacks:
        for z, outline in sorted([(s.z, s.outline) for s in stack.slices] + [(z, None) for z in stack.left_out], key=lambda pair: pair[0]):
            here = [ring for ring in rings[stack.name] if len(ring) and abs(np.median(ring[:, 2]) - z) < 0.2]
            title = f"{stack.name}, z = {z:g} mm"
            panels.append((title, here, outline.geoms) if outline else (f"{title}\nleft out: encloses too little", here, []))
    sheet(panels, path)


def draw_problem(error, path):
    if error.rings:
        sheet([(str(error)[:60], [ring for ring in error.rings if len(ring)], [])], path)
