"""Shapes of known volume for the tests of meshes/anatomy/. Importing this module also puts the sources on sys.path."""
import math
import os
import sys

import numpy as np

SOURCE = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.path.insert(0, os.path.join(SOURCE, "meshes"))


def ellipse(a, b, z, count=60, centre=(0.0, 0.0)):
    angle = 2 * math.pi * np.arange(count) / count
    return np.column_stack([centre[0] + a * np.cos(angle), centre[1] + b * np.sin(angle), np.full(count, z)])


def ellipsoid(a, b, c, spacing):
    """Returns rings (mm) at odd multiples of spacing / 2 from the middle."""
    heights = (np.arange(-50, 50) + 0.5) * spacing
    return [ellipse(a * math.sqrt(1 - (z / c) ** 2), b * math.sqrt(1 - (z / c) ** 2), z) for z in heights if abs(z) < 0.99 * c]


def ellipsoid_volume(a, b, c):
    return 4 / 3 * math.pi * a * b * c


def trousers(spacing=4.0):
    """Returns one outline on each upper slice and two on each lower slice."""
    rings = []
    for z in np.arange(0, 41, spacing):
        if z >= 24:
            rings.append(ellipse(16, 8, z))
        else:
            rings += [ellipse(7, 7, z, centre=(side * 9, 0)) for side in (-1, 1)]
    return rings
