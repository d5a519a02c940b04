"""Renders an episode: two perpendicular sections of the tissue through the needle's initial axis, with needle, target and obstacle projected onto
them."""
from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ._episodes import Episodes
from ._task import Array

HEIGHT, WIDTH = 240, 400           # pixels, size of each section
FRONT, BEYOND = 0.010, 0.020       # m, lengths shown in front of the skin and beyond the deepest target
WHITE, BORDER, NEEDLE, TARGET, OBSTACLE = ((255, 255, 255), (138, 146, 155), (36, 41, 47), (0, 127, 95), (213, 94, 0))
FAINT = 0.5                        # fraction of white mixed into the target and obstacle discs

Picture = npt.NDArray[np.uint8]


def draw(episodes: Episodes, row: int) -> Picture:
    """Returns an image (HEIGHT, 2 WIDTH, 3) of a row. The needle points right. Its y axis points up in the left section, its x axis in the right one."""
    task, sim, episode = episodes.task, episodes.sim(row), episodes.episodes.get(row)
    if episode is None:
        raise ValueError("no episode has begun: call reset first")
    place = lambda points: (np.atleast_2d(points) - task.entry) @ task.axes.T    # coordinates along the needle's axes, from its entry point
    borders = place(episode.model.nodes + sim.displacements())[episode.borders]
    needle = place(sim.centreline())
    scale = WIDTH / (FRONT + task.target["depth"][1] + BEYOND)    # pixels per m
    views = []
    for up, across in ((1, 0), (0, 1)):
        view = np.full((HEIGHT, WIDTH, 3), WHITE, np.uint8)
        pixels = lambda points: np.stack([scale * (points[..., 2] + FRONT), 0.5 * HEIGHT - scale * points[..., up]], axis=-1)
        if episode.radius > 0.0:
            _disc(view, pixels(place(episodes.obstacle[row]))[0], scale * episode.radius, OBSTACLE)
        _disc(view, pixels(place(episodes.target[row]))[0], scale * task.tolerance, TARGET)
        _lines(view, pixels(_section(borders, across)), 0, BORDER)
        _lines(view, pixels(np.stack([needle[:-1], needle[1:]], axis=1)), 1, NEEDLE)
        views.append(view)
    return np.concatenate(views, axis=1)


def _section(triangles: Array, axis: int) -> Array:
    """Intersects triangles (n, 3, 3) with the plane where coordinate `axis` is 0. Returns segments (m, 2, 3)."""
    side = triangles[:, :, axis] > 0.0
    cut = triangles[side.any(axis=1) & ~side.all(axis=1)]
    side = cut[:, :, axis] > 0.0
    alone = np.where(side.sum(axis=1) == 1, side.argmax(axis=1), (~side).argmax(axis=1))    # the corner with no other on its side of the plane
    rows = np.arange(len(cut))
    corner = cut[rows, alone]
    ends = []
    for step in (1, 2):
        other = cut[rows, (alone + step) % 3]
        share = corner[:, axis] / (corner[:, axis] - other[:, axis])
        ends.append(corner + share[:, None] * (other - corner))
    return np.stack(ends, axis=1)


def _lines(view: Picture, segments: Array, radius: int, colour: tuple[int, int, int]) -> None:
    """Draws segments (n, 2, 2), given in pixels, as lines 2 radius + 1 pixels wide."""
    longest = np.abs(np.diff(segments, axis=1)).max(initial=0.0)
    share = np.linspace(0.0, 1.0, int(longest) + 2)[:, None, None]
    points = np.rint(segments[:, 0] + share * (segments[:, 1] - segments[:, 0])).astype(int).reshape(-1, 2)
    for shift in np.ndindex(2 * radius + 1, 2 * radius + 1):
        column, line = (points + np.array(shift) - radius).T
        inside = (column >= 0) & (column < view.shape[1]) & (line >= 0) & (line < view.shape[0])
        view[line[inside], column[inside]] = colour


def _disc(view: Picture, centre: Array, radius: float, colour: tuple[int, int, int]) -> None:
    """Draws a disc in a faint version of the colour and marks its centre. Positions and lengths are in pixels."""
    lines, columns = np.mgrid[:view.shape[0], :view.shape[1]]
    distance = np.hypot(columns - centre[0], lines - centre[1])
    view[distance <= radius] = (FAINT * np.array(WHITE) + (1.0 - FAINT) * np.array(colour)).astype(np.uint8)
    view[distance <= 1.5] = colour
