#!/usr/bin/python3
"""Computes the numbers in test_resolved_radius.c: on a whole mesh, what the end of a line adds that the resolved radius of an infinite line does not account
for.

The mesh of the block is Kuhn's, with cubes of 12 x 12 x 12.5 mm; the volumetric strain is averaged at nodes. The load is that part of a line force which
lies beyond a given distance ahead of a point, up to 30 mm; the boundary of the block moves according to Kelvin's solution, summed over steps of the line.
The program prints the displacement of the point minus that of a cylinder of the resolved radius, as the logarithm of a radius, averaged over a period of the
mesh and both transverse directions. It uses no code of the simulator, needs python3-scipy, and takes a minute.
"""
import math

import numpy as np
from scipy.sparse.linalg import splu

from kuhn_block import KuhnBlock

CUBES, CUBE = (10, 10, 8), (0.012, 0.012, 0.0125)
POISSON, LAME = 0.45, 9.0               # LAME: for a shear modulus of 1
LINE = (3 - 4 * POISSON) / (8 * math.pi * (1 - POISSON))
STEP, REACH = 0.00025, 0.030            # m
SIZE = (math.sqrt(2) * math.prod(CUBE)) ** (1 / 3)
PLACES = (((0, 0), 0.150), ((0.0031, -0.0027), 0.464))  # x and y, and the line's resolved radius divided by SIZE


class Block(KuhnBlock):
    def __init__(self):
        super().__init__(CUBES)
        self.matrix = self.stiffness(1.0, LAME, self.by_node())
        self.free = np.repeat(~self.outer, 3)
        self.factor = splu(self.matrix[self.free][:, self.free])

    def moved(self, at, line, axis):
        """Returns the displacement along an axis at a point, under a unit force per length along that axis at the points on the line."""
        force, moved = np.eye(3)[axis], np.zeros((len(self.nodes), 3))
        moved[self.outer] = sum(STEP * kelvin(point, force, self.nodes[self.outer]) for point in line)
        moved, load = moved.ravel(), np.zeros(3 * len(self.nodes))
        load[axis::3] = self.interpolation(line).T @ np.full(len(line), STEP)
        moved[self.free] = self.factor.solve((load - self.matrix @ moved)[self.free])
        return (self.interpolation(at[None]) @ moved[axis::3])[0]


def kelvin(source, force, at):
    apart = at - source
    distance = np.linalg.norm(apart, axis=-1, keepdims=True)
    return ((3 - 4 * POISSON) * force + apart * (apart @ force)[..., None] / distance ** 2) / (16 * math.pi * (1 - POISSON) * distance)


def cylinder_moved(ahead, radius):
    angle, step = np.arange(8) * math.pi / 4, 1e-5
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
    return step * sum(kelvin(np.array([0, 0, z]), np.eye(3)[0], ring)[:, 0].mean() for z in np.arange(ahead + step / 2, REACH, step))


def main():
    block = Block()
    for (x, y), radius in PLACES:
        for ahead in (0.0, 0.003, 0.006):
            more = []
            for height in 0.0375 + CUBE[2] * (np.arange(10) + 0.5) / 10:
                at, way = np.array([x, y, height]), np.arange(ahead + STEP / 2, REACH, STEP)
                line = at - way[:, None] * np.array([0, 0, 1])
                more += [(block.moved(at, line, axis) - cylinder_moved(ahead, radius * SIZE)) / LINE for axis in (0, 1)]
            print(f"({1e3 * x:g}, {1e3 * y:g}) mm, ending {1e3 * ahead:g} mm ahead: {np.mean(more):.3f}", flush=True)


if __name__ == "__main__":
    main()
