#!/usr/bin/python3
"""Uses CalculiX to compute the force on a rigid disc that is bonded to a Yeoh material and pressed into its surface, for
tests/unit/insertion/test_stiffening.c.

The elements are axisymmetric and quadratic (CAX8) and graded towards the disc's rim; displacements are large. The block has a radius and a height of 60 mm
and is fixed at its bottom; E = 20 kPa, nu = 0.45; the disc's radius is 0.635 mm. The increments end where the elements at the rim become too distorted, at 2
to 3.5 radii.

usage: pressed_disc.py STIFFENING [DEPTH]     STIFFENING: C20 / C10 (0: neo-Hookean); DEPTH: m, by default 4e-3
"""
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

RADIUS, WIDTH, HEIGHT, E, NU = 0.635e-3, 0.06, 0.06, 20e3, 0.45
RIM, GROWTH, STEPS = 0.3, 1.25, 20   # RIM: size of the first element relative to the radius; GROWTH: ratio of successive element sizes


def graded(start, end, first):
    """Returns points from `start` to `end`, the first spacing being `first` and the following ones growing."""
    steps = first * GROWTH ** np.arange(200)
    ends = np.concatenate([[0.0], np.cumsum(steps)])
    ends = ends[:np.searchsorted(ends, end - start) + 1]
    return start + ends * (end - start) / ends[-1]


def mesh():
    inner, outer = RADIUS - graded(0.0, RADIUS, RIM * RADIUS)[::-1], graded(RADIUS, WIDTH, RIM * RADIUS)
    x, z = np.concatenate([inner, outer[1:]]), -graded(0.0, HEIGHT, RIM * RADIUS)
    number, nodes = {}, []

    def node(i, j):
        if (i, j) not in number:
            nodes.append([0.5 * (line[k // 2] + line[(k + 1) // 2]) for line, k in ((x, i), (z, j))])
            number[i, j] = len(nodes)
        return number[i, j]

    ring = ((0, 2), (2, 2), (2, 0), (0, 0), (1, 2), (2, 1), (1, 0), (0, 1))
    elements = [[node(2 * a + i, 2 * b + j) for i, j in ring] for a in range(len(x) - 1) for b in range(len(z) - 1)]
    sets = {"DISC": [k for (i, j), k in number.items() if j == 0 and nodes[k - 1][0] < RADIUS * (1 + 1e-9)],
            "FIXED": [k for (_, j), k in number.items() if j == 2 * (len(z) - 1)], "AXIS": [k for (i, _), k in number.items() if i == 0]}
    return nodes, elements, sets


def deck(stiffening, depth):
    nodes, elements, sets = mesh()
    mu, bulk = E / 2 / (1 + NU), E / 3 / (1 - 2 * NU)
    law = (f"YEOH\n{mu / 2:.8g}, {stiffening * mu / 2:.8g}, 0., {2 / bulk:.8g}, 1e10, 1e10" if stiffening else f"NEO HOOKE\n{mu / 2:.8g}, {2 / bulk:.8g}")
    return ("*NODE, NSET=ALL\n" + "".join(f"{k}, {r:.12g}, {z:.12g}, 0.\n" for k, (r, z) in enumerate(nodes, 1)) + "*ELEMENT, TYPE=CAX8, ELSET=TISSUE\n"
            + "".join(f"{k}, {', '.join(map(str, e))}\n" for k, e in enumerate(elements, 1))
            + "".join(f"*NSET, NSET={name}\n" + ",\n".join(map(str, members)) + "\n" for name, members in sets.items())
            + f"*MATERIAL, NAME=TISSUE\n*HYPERELASTIC, {law}\n*SOLID SECTION, ELSET=TISSUE, MATERIAL=TISSUE\n*STEP, NLGEOM, INC=400\n*STATIC\n"
            + f"{1 / STEPS}, 1., 1e-5, {1 / STEPS}\n*BOUNDARY\nFIXED, 1, 2\nAXIS, 1, 1\nDISC, 1, 1\nDISC, 2, 2, {-depth}\n"
            + "*NODE PRINT, NSET=DISC, TOTALS=ONLY\nRF\n*END STEP\n")


def main():
    if len(sys.argv) not in (2, 3) or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    depth = float(sys.argv[2]) if len(sys.argv) == 3 else 4e-3
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "disc.inp").write_text(deck(float(sys.argv[1]), depth))
        subprocess.run(["nice", "ccx", "-i", "disc"], cwd=folder, capture_output=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        text = (Path(folder) / "disc.dat").read_text()
    for time, force in re.findall(r"total force.*and time\s+(\S+)\s*\n\s*\n\s*\S+\s+(\S+)", text):
        print(f"{1e3 * depth * float(time):.3f} mm {-180 * float(force):.6f} N")  # CalculiX solves a sector of 2 degrees
    return 0


if __name__ == "__main__":
    sys.exit(main())
