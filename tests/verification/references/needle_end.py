#!/usr/bin/python3
"""Shows why a needle along edges of a mesh is too stiff sideways if the resolved radius is measured only with an infinite line.
usage: needle_end.py [CUBES_PER_10_MM]

A rigid needle, 60 mm long and inclined by 45 degrees in Kuhn's mesh of the block, is represented by segments of 1 mm on linear tetrahedra (volumetric strain
averaged over each cube), each in series with a local compliance. No code of the simulator is used. One needle lies along edges, another within elements. For
each, prints the resolved radius of an infinite line, the sideways force for a motion by 1 mm, and the shares of the force near the tip. Then the needle
along edges is given a local compliance that accounts for the end of the line, so that equal forces on all segments move them as far as within elements.
Prints the ratio of this compliance to that of the infinite line, for every 5 mm from the skin, and the force. Needs python3-scipy. Takes seconds, or a few
minutes for cubes of 5 mm.
"""
import math
import sys

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import splu

import needle_meshes as nm
from kuhn_block import KuhnBlock

RADIUS, POISSON, YOUNG = 0.000635, 0.45, 20000.0
SHEAR = YOUNG / 2 / (1 + POISSON)
LAME = 2 * SHEAR * POISSON / (1 - 2 * POISSON)
LINE = (3 - 4 * POISSON) / (8 * math.pi * SHEAR * (1 - POISSON))
SEGMENT, SEGMENTS = 0.001, 60
ALONG, ACROSS = np.array([-1.0, 0.0, -1.0]) / math.sqrt(2), np.array([0.0, 1.0, 0.0])
SIDEWAYS = np.cross(ACROSS, ALONG)


class Block(KuhnBlock):
    def __init__(self, cubes):
        super().__init__((12 * cubes, 12 * cubes, 10 * cubes))
        self.matrix = self.stiffness(SHEAR, LAME, self.by_cube())

    def sideways_at(self, points):
        """Returns a matrix whose rows interpolate the sideways displacement at points from nodal values."""
        return sparse.kron(self.interpolation(points), SIDEWAYS.reshape(1, 3)).tocsc()

    def solve(self, free, right):
        return splu(self.matrix[free][:, free]).solve(right)

    def resolved_radius(self, entry):
        """Returns the resolved radius of an infinite line through the block: the radius at which the displacement equals the exact solution's."""
        depth = np.arange(-300, 300) * SEGMENT
        points = entry + depth[:, None] * ALONG
        inside = (np.abs(points[:, :2]).max(axis=1) < nm.HALF_WIDTH) & (points[:, 2] > 0) & (points[:, 2] < nm.HEIGHT)
        rows = self.sideways_at(points[inside])
        x, y = (self.nodes - entry) @ SIDEWAYS, (self.nodes - entry) @ ACROSS
        square, c = np.maximum(x * x + y * y, 1e-12), LINE / (3 - 4 * POISSON)
        exact = (-0.5 * LINE * np.log(square) + c * (x * x / square - 0.5))[:, None] * SIDEWAYS + (c * x * y / square)[:, None] * ACROSS
        free, moved = np.repeat(~self.outer, 3), np.where(self.outer[:, None], exact, 0).ravel()
        moved[free] = self.solve(free, (rows.T @ np.full(rows.shape[0], SEGMENT) - self.matrix @ moved)[free])
        along = rows @ moved
        return math.exp(-along[len(along) // 6 : -(len(along) // 6)].mean() / LINE)

    def compliance(self, entry):
        """Returns the part of the segments' compliance that is due to the mesh."""
        free = np.repeat(self.nodes[:, 2] > 1e-9, 3)
        rows = self.sideways_at(entry + (np.arange(SEGMENTS) + 0.5)[:, None] * SEGMENT * ALONG)[:, free]
        return rows @ self.solve(free, rows.T.toarray())


def forces(compliance):
    return np.linalg.solve(compliance, np.full(SEGMENTS, 1e-3))


def main():
    cubes = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    block, known = Block(cubes), {}
    for name, beside in (("along edges", (0.0, 0.0, 0.0)), ("within elements", (0.0026 / cubes, 0.0042 / cubes, 0.0))):
        entry = np.array([0.02, 0.0, nm.HEIGHT]) + beside
        radius, mesh = block.resolved_radius(entry), block.compliance(entry)
        local = LINE * math.log(radius / RADIUS) / SEGMENT
        each = forces(mesh + local * np.eye(SEGMENTS))
        known[name] = mesh, local
        print(f"{name}: R = {1e3 * radius:.2f} mm, {each.sum():.4f} N, of it {100 * each[-10:].sum() / each.sum():.0f} % on the last 10 mm")
    (edge, local), (other, other_local) = known["along edges"], known["within elements"]
    ends = other.sum(axis=1) + other_local - edge.sum(axis=1)
    print("with the line's end: ", *(f"{ratio:.2f}" for ratio in (ends / local).reshape(-1, 5).mean(axis=1)), f", {forces(edge + np.diag(ends)).sum():.4f} N")


if __name__ == "__main__":
    main()
