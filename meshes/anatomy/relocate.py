"""Moves individual nodes to improve the worst dihedral angles of a mesh. Gmsh's optimiser gets no further, because it does not move nodes on
surfaces."""
import itertools

import numpy as np

from .quality import GREATEST_ANGLE, LEAST_ANGLE

ROUNDS = 6
ENOUGH = 0.99           # leave nodes alone below this badness (dihedral angles of 10.04 to 159.3 degrees)
STEPS = np.array([0.3, 0.15, 0.07, 0.03])       # step lengths, as fractions of the mean edge length at a node
ON_SURFACE = 0.15       # move a node on a surface by at most this fraction of the mean edge length at the node, in total
LEAST_GAIN = 1e-3       # move a node only if this lowers the badness by at least this fraction
MOST_CHANGE = 2e-3      # once moving nodes on a region's surface has changed its volume by this fraction, move only inner nodes
DIRECTIONS = np.array([d for d in itertools.product((-1, 0, 1), repeat=3) if any(d)], float)
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
# corners of the faces, ordered so that the normals point either all outward or all inward, depending on the tetrahedron's orientation
FACES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])


def badness(corners):
    """Returns the badness (...) of tetrahedra with corners (..., 4, 3). It is above 1 if a dihedral angle is outside the paper's range, and infinite for a flat
    tetrahedron."""
    a, b, c = (corners[..., FACES[:, k], :] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = normal / length[..., None]
        cosines = np.stack([-(normal[..., i, :] * normal[..., j, :]).sum(axis=-1) for i, j in itertools.combinations(range(4), 2)], axis=-1)
        angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
        found = np.maximum(LEAST_ANGLE / angles.min(axis=-1), (180 - GREATEST_ANGLE) / (180 - angles.max(axis=-1)))
    return np.where(np.isfinite(found), found, np.inf)


def signed_volumes(corners):
    a, b, c, d = (corners[..., k, :] for k in range(4))
    return ((b - a) * np.cross(c - a, d - a)).sum(axis=-1) / 6


def relocated(mesh, still):
    """Returns the mesh's points after moving some of them. still: mask of points that must not move."""
    surface = np.zeros(len(mesh.points), bool)
    for shell in mesh.surfaces.values():
        surface[np.unique(shell.triangles)] = True
    points = moved(mesh, still, surface)
    before, after = (np.bincount(mesh.region, np.abs(signed_volumes(p[mesh.tets]))) for p in (mesh.points, points))
    return points if np.all(np.abs(after / before - 1) < MOST_CHANGE) else moved(mesh, still | surface, surface)


def moved(mesh, still, surface):
    points, tets = mesh.points.copy(), mesh.tets
    order = np.argsort(tets.ravel(), kind="stable")
    first = np.searchsorted(tets.ravel()[order], np.arange(len(points) + 1))
    for _ in range(ROUNDS):
        bad = badness(points[tets])
        gained = False
        for tet in np.argsort(-bad, kind="stable")[:np.count_nonzero(bad > ENOUGH)]:
            for node in tets[tet]:
                if still[node] or badness(points[tets[tet]]) <= ENOUGH:
                    continue
                star = order[first[node]:first[node + 1]] // 4
                place = better_place(points, tets[star], node, mesh.points[node] if surface[node] else None)
                if place is not None:
                    points[node], gained = place, True
        if not gained:
            break
    return points


def better_place(points, star, node, anchor):
    """Looks for a position of the node that improves the worst of the tetrahedra around it (`star`). Returns it, or None. anchor: a position that the node
    must stay close to, or None."""
    others = np.unique(star[star != node])
    edge = np.linalg.norm(points[others] - points[node], axis=1).mean()
    places = (points[node] + edge * STEPS[:, None, None] * DIRECTIONS).reshape(-1, 3)
    if anchor is not None:
        places = places[np.linalg.norm(places - anchor, axis=1) < ON_SURFACE * edge]
    corners = np.repeat(points[star][None], len(places) + 1, axis=0)
    corners[1:] = np.where((star == node)[None, :, :, None], places[:, None, None, :], corners[1:])
    worst = badness(corners).max(axis=1)
    volumes = signed_volumes(corners)
    worst[np.any(volumes * np.sign(volumes[0]) <= 0, axis=1)] = np.inf     # would turn a tetrahedron inside out
    best = int(np.argmin(worst))
    return places[best - 1] if best and worst[best] < (1 - LEAST_GAIN) * worst[0] else None
