"""Random synthetic patients through the pipeline: prints a Markdown table and fails where one does.

usage: python3 -m anatomy.stress [FIRST [COUNT]]     numbers of the patients; default 0 50
"""
import sys
import tempfile

import numpy as np

from . import contours, meshing, patient, pipeline

VOLUME_LIMIT = 0.03      # of the outlines' own volume


def make(number):
    """Gland, spacing (mm), rings of prostate and arch; the same number gives the same patient."""
    random = np.random.default_rng(number)
    gland = patient.random_gland(random)
    spacing = random.uniform(3, 7)
    rois = patient.outlines(gland, spacing, random.uniform(0, 1))
    return gland, spacing, patient.spoil(rois["Prostate"], random, 0.6), rois["Pubic arch"]


def run(number, folder):
    """A row of the table, and whether it is good."""
    gland, spacing, outlines, arch = make(number)
    organs = [pipeline.organ_of_rings("Prostate", False, outlines), pipeline.organ_of_rings("Pubic arch", True, arch)]
    domain, outlined = pipeline.domain_of(organs, 570, None)
    mesh = meshing.generate(domain, 570, f"{folder}/{number}.msh")
    angles, off = mesh.dihedral_angles(), mesh.region_volume("prostate") / outlined["prostate"] - 1
    good = abs(len(mesh.points) / 570 - 1) <= 0.1 and mesh.badness() <= 1 and abs(off) <= VOLUME_LIMIT
    return (f"| {number} | {gland.volume * 1e-3:.1f} | {spacing:.1f} | {len(organs[0].notes)} | {outlined['prostate'] * 1e6:.1f} | {100 * off:+.2f} "
            f"| {len(mesh.points)} | {len(mesh.tets)} | {angles.min():.2f} | {angles.max():.2f} | {mesh.valence().max()} | {'yes' if good else 'NO'} |"), good


def main():
    first, count = (int(v) for v in (sys.argv[1:] + ["0", "50"][len(sys.argv) - 1:]))
    meshing.quiet()
    print("| patient | true ml | slices, mm | gaps and blanks | outlines, ml | mesh, % | nodes | tetrahedra | least angle | greatest | valence | good |")
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, first + count):
            row, good = run(number, folder)
            print(row, flush=True)
            bad += not good
    print(f"\n{count - bad} of {count} within the limits")
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
