"""Dose of an implant of I-125 seeds in a spherical gland of 20 mm radius, in its shape at rest and with the seeds displaced.

python3 dose.py
"""
import numpy as np
from trocar import brachy


def sphere(radius, rings=24, sides=48):
    """Returns the nodes (m) and triangles of a closed surface."""
    polar, around = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(sides) / sides
    nodes = [[0, 0, 1]] + [[np.sin(p) * np.cos(a), np.sin(p) * np.sin(a), np.cos(p)] for p in polar for a in around] + [[0, 0, -1]]
    at = lambda ring, side: 1 + ring * sides + side % sides
    last = len(nodes) - 1
    triangles = [t for k in range(sides) for t in ((0, at(0, k), at(0, k + 1)), (last, at(rings - 2, k + 1), at(rings - 2, k)))]
    triangles += [t for i in range(rings - 2) for k in range(sides)
                  for t in ((at(i, k), at(i + 1, k), at(i + 1, k + 1)), (at(i, k), at(i + 1, k + 1), at(i, k + 1)))]
    return radius * np.array(nodes), triangles


# Returns seeds in twelve needles along z on a circle with a radius of 15 mm, and in five needles on a circle of 7 mm; the seeds are 10 mm apart where the gland
# has room for them.
needles = [[r * np.cos(a), r * np.sin(a)] for r, n in ((0.015, 12), (0.007, 5)) for a in 2 * np.pi * np.arange(n) / n]
seeds = [[x, y, z] for x, y in needles for z in np.arange(-0.02, 0.021, 0.01) if x * x + y * y + z * z < 0.0185**2]

gland = brachy.Structure.from_surface(*sphere(0.02), spacing=1e-3)
dose = brachy.Dose.at(brachy.Source("I-125 6711"), gland.points)
ids = [dose.add(seed, [0, 0, 1], 0.55) for seed in seeds]
print("%d seeds, %.1f cm^3" % (dose.seeds, 1e6 * gland.voxel * len(gland.points)))


def report(title):
    figures = brachy.DVH(dose.values, gland.voxel).summary(prescription=145)
    print("%s: D90 %.0f Gy, V100 %.1f %%, V150 %.0f %%, V200 %.0f %%" % (title, figures["d90"], 100 * figures["v100"], 100 * figures["v150"], 100 * figures["v200"]))


report("as planned")
for seed, place in zip(ids, seeds):
    dose.move(seed, np.add(place, [0, 0, 0.005]), [0, 0, 1], 0.55)
report("all seeds 5 mm too deep")
