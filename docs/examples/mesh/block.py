"""A block of tetrahedra, for docs/python.md."""
import numpy as np


def block(nx, ny, nz, size):
    """Nodes and tetrahedra of a box, z from 0: six tetrahedra in each cell. `size` is in metres."""
    side = [np.linspace(-size[0] / 2, size[0] / 2, nx + 1), np.linspace(-size[1] / 2, size[1] / 2, ny + 1), np.linspace(0, size[2], nz + 1)]
    nodes = np.stack(np.meshgrid(*side, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(nodes)).reshape(nx + 1, ny + 1, nz + 1)
    tets = []
    for first, second, third in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        corner, corners = np.zeros(3, int), []
        for axis in (None, first, second, third):
            if axis is not None:
                corner[axis] = 1
            corners.append(index[corner[0]:corner[0] + nx, corner[1]:corner[1] + ny, corner[2]:corner[2] + nz].ravel())
        tets.append(np.stack(corners, axis=1))
    return nodes, np.concatenate(tets)


def faces_at(nodes, tets, z):
    """Triangles of tetrahedra that lie in the plane z."""
    faces = np.concatenate([tets[:, [0, 1, 2]], tets[:, [0, 1, 3]], tets[:, [0, 2, 3]], tets[:, [1, 2, 3]]])
    return faces[np.all(np.abs(nodes[faces][:, :, 2] - z) < 1e-9, axis=1)]
