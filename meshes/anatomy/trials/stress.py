"""Runs random synthetic patients through the pipeline. Prints a table as CSV, and fails if any patient fails.

usage: python3 -m anatomy.trials.stress [FIRST [COUNT]]     number of the first patient, and how many; default 0 50
"""
import sys
import tempfile

import numpy as np

from .. import organ, pipeline
from ..shapes import shells
from . import patient, tables

VOLUME_LIMIT = 0.03                     # largest error allowed in a volume, as a fraction of the contours' volume as read
MEAN_LIMIT, GREATEST_LIMIT = 1.0, 6.0   # mm, mean and greatest distance of the surface from the original contours; spoil() moves them by up to 10 mm


def make(number):
    """Generates patient `number`, reproducibly. Returns the gland, its slice spacing (mm), the prostate's rings without and with defects, and the arch's
    rings."""
    random = np.random.default_rng(number)
    gland = patient.random_gland(random)
    spacing = random.uniform(3, 7)
    rois = patient.outlines(gland, spacing, random.uniform(0, 1))
    return gland, spacing, rois["Prostate"], patient.spoil(rois["Prostate"], random, 0.6), rois["Pubic arch"]


def planimetry(rings):
    """Returns the volume enclosed by rings as read, one per slice, by the shoelace formula, mm^3. Duplicates count once."""
    areas = {}
    for x, y, z in (ring.T for ring in rings):
        areas[z[0]] = abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    heights = np.array(sorted(areas))
    each = np.array([areas[z] for z in heights])
    return np.trapz(each, heights) + (each[0] + each[-1]) / 2 * np.median(np.diff(heights))


def run(number, folder):
    """Returns a row of the table, and whether the patient is within the limits."""
    gland, spacing, truth, outlines, arch = make(number)
    organs = [organ.of_rings("Prostate", "prostate", False, outlines), organ.of_rings("Pubic arch", "pubic_arch", True, arch)]
    mesh, domain, _, _ = pipeline.mesh_of(organs, 570, None, f"{folder}/{number}.msh")
    angles, volume = mesh.dihedral_angles(), planimetry(outlines) * 1e-9
    change = mesh.region_volume("prostate") / volume - 1
    off = 1e3 * np.abs(shells.distances(mesh.surfaces["capsule"], pipeline.world(np.vstack(truth), domain.origin)))
    good = (abs(len(mesh.points) / 570 - 1) <= 0.1 and mesh.badness() <= 1 and abs(change) <= VOLUME_LIMIT
            and off.mean() <= MEAN_LIMIT and off.max() <= GREATEST_LIMIT)
    return (number, f"{gland.volume * 1e-3:.1f}", f"{spacing:.1f}", len(organs[0].notes), f"{volume * 1e6:.1f}", f"{100 * change:+.2f}", f"{off.mean():.2f}",
            f"{off.max():.1f}", len(mesh.points), len(mesh.tets), f"{angles.min():.2f}", f"{angles.max():.2f}", mesh.valence().max(), "yes" if good else "no"), good


def main():
    first, count = (int(v) for v in (sys.argv[1:] + ["0", "50"][len(sys.argv) - 1:]))
    tables.row("patient", "true_ml", "slices_mm", "gaps_and_blanks", "outlines_ml", "mesh_percent", "mean_distance_mm", "greatest_distance_mm", "nodes",
               "tetrahedra", "least_angle_deg", "greatest_angle_deg", "valence", "good")
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(first, first + count):
            row, good = run(number, folder)
            tables.row(*row)
            bad += not good
    print(f"{count - bad} of {count} within the limits", file=sys.stderr)
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
