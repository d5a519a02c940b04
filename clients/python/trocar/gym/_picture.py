"""Pictures of an episode: the tissue's nodes near the needle, the needle, target and obstacle, seen along two axes across the needle."""
from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .. import motion
from ._episodes import Episodes
from ._task import Array

HEIGHT, WIDTH, MARGIN = 240, 320, 8     # pixels, of each of the two views
BEHIND, SLAB = 0.01, 0.006              # m: length shown in front of the tissue; distance of the nodes shown from the needle's plane
WHITE, TISSUE, NEEDLE, TARGET, OBSTACLE = ((255, 255, 255), (176, 184, 192), (36, 41, 47), (0, 127, 95), (213, 94, 0))

Picture = npt.NDArray[np.uint8]


def draw(episodes: Episodes, row: int) -> Picture:
    """Returns the picture (HEIGHT, 2 WIDTH, 3) of a row; the needle points to the right. Left: seen from the side; right: from above."""
    task, sim, episode = episodes.task, episodes.sim(row), episodes.episodes[row]
    if episode is None:
        raise ValueError("no episode has begun: call reset first")
    x, y, z = task.axes()
    place = lambda points: (np.atleast_2d(points) - task.entry) @ np.stack([x, y, z]).T    # from the entry, along the needle's axes
    nodes = place(episode.model.nodes + sim.displacements())
    needle = place(sim.centreline())
    length, half = nodes[:, 2].max(), np.abs(nodes[:, :2]).max()
    scale = min((WIDTH - 2 * MARGIN) / (length + BEHIND), (HEIGHT - 2 * MARGIN) / (2.0 * half))    # pixels in a metre
    views = []
    for across, depth in ((1, 0), (0, 1)):
        view = np.full((HEIGHT, WIDTH, 3), WHITE, np.uint8)
        pixels = lambda points: np.stack([MARGIN + scale * (points[:, 2] + BEHIND), 0.5 * HEIGHT - scale * points[:, across]], axis=1)
        for point in pixels(nodes[np.abs(nodes[:, depth]) < SLAB]):
            _disc(view, point, 1.0, TISSUE)
        if episode.radius > 0.0:
            _disc(view, pixels(place(episodes.obstacle[row]))[0], scale * episode.radius, OBSTACLE)
        _disc(view, pixels(place(episodes.target[row]))[0], max(2.5, scale * task.tolerance), TARGET)
        _line(view, pixels(needle), 0.8, NEEDLE)
        views.append(view)
    return np.concatenate(views, axis=1)


def _disc(view: Picture, centre: Array, radius: float, colour: tuple[int, int, int]) -> None:
    """Fills the pixels whose distance from the centre (x, y) is at most the radius, in pixels."""
    low, high = np.floor(centre - radius).astype(int), np.ceil(centre + radius).astype(int) + 1
    left, top = np.maximum(low, 0)
    right, bottom = np.minimum(high, (view.shape[1], view.shape[0]))
    if left >= right or top >= bottom:
        return
    rows, columns = np.mgrid[top:bottom, left:right]
    view[top:bottom, left:right][np.hypot(columns - centre[0], rows - centre[1]) <= radius] = colour


def _line(view: Picture, points: Array, radius: float, colour: tuple[int, int, int]) -> None:
    """Draws a line (n, 2) as a row of discs."""
    for start, end in zip(points[:-1], points[1:]):
        for share in np.linspace(0.0, 1.0, int(np.hypot(*(end - start))) + 2):
            _disc(view, start + share * (end - start), radius, colour)
