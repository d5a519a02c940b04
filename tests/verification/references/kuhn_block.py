"""Linear tetrahedra with averaged volumetric strain, in the Kuhn mesh of the block in needle_meshes.py. Uses none of the simulator's code."""
import numpy as np
import scipy.sparse as sparse

import needle_meshes as nm


class KuhnBlock:
    def __init__(self, cubes):
        """`cubes`: number of cubes along x, y and z."""
        self.nodes, self.tets = nm.structured("Kuhn", cubes)
        corners = self.nodes[self.tets]
        self.inverse = np.linalg.inv(np.concatenate([np.ones((len(self.tets), 4, 1)), corners], axis=2))
        self.low, self.high = corners.min(axis=1) - 1e-9, corners.max(axis=1) + 1e-9
        self.outer = (np.abs(self.nodes[:, :2]).max(axis=1) > nm.HALF_WIDTH - 1e-9) | (np.abs(self.nodes[:, 2] / nm.HEIGHT - 0.5) > 0.5 - 1e-9)

    def by_cube(self):
        """Returns a matrix with the weights of the elements (columns) in each cube (rows)."""
        cube = np.arange(len(self.tets)) // 6
        return sparse.csr_matrix((np.ones(len(cube)), (cube, np.arange(len(cube)))))

    def by_node(self):
        """Returns a matrix with the weights of the elements (columns) around each node (rows). Each node gets a quarter of an element."""
        return sparse.csr_matrix((np.full(4 * len(self.tets), 0.25), (self.tets.ravel(), np.repeat(np.arange(len(self.tets)), 4))))

    def stiffness(self, shear, lame, averages):
        """Returns the stiffness matrix for a volumetric strain averaged by the rows of `averages`, which comes from by_cube() or by_node()."""
        gradient, volume = self.inverse[:, 1:].transpose(0, 2, 1), np.abs(nm.volumes(self.nodes, self.tets))
        dofs, size = (3 * self.tets[:, :, None] + np.arange(3)).reshape(-1, 12), 3 * len(self.nodes)
        blocks = np.einsum("tai,tbi->tab", gradient, gradient)[:, :, None, :, None] * np.eye(3)[None, None, :, None, :]
        blocks = shear * volume[:, None, None] * (blocks + np.einsum("taj,tbi->taibj", gradient, gradient)).reshape(-1, 12, 12)
        deviatoric = sparse.coo_matrix((blocks.ravel(), (np.repeat(dofs, 12, axis=1).ravel(), np.tile(dofs, (1, 12)).ravel())), (size, size))
        elements = np.repeat(np.arange(len(self.tets)), 12)
        flux = averages @ sparse.csr_matrix(((gradient * volume[:, None, None]).ravel(), (elements, dofs.ravel())), (len(self.tets), size))
        return (deviatoric.tocsr() + lame * flux.T @ sparse.diags(1 / (averages @ volume)) @ flux).tocsc()

    def interpolation(self, points):
        """Returns a matrix whose rows interpolate nodal values at the points."""
        rows = sparse.lil_matrix((len(points), len(self.nodes)))
        for i, point in enumerate(points):
            near = np.flatnonzero(((point >= self.low) & (point <= self.high)).all(axis=1))
            weights = self.inverse[near].transpose(0, 2, 1) @ np.append(1.0, point)
            inside = np.argmax(weights.min(axis=1))
            rows[i, self.tets[near[inside]]] = weights[inside]
        return rows.tocsr()
