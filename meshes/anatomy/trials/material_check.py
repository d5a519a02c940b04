"""Simulates an insertion into each material in materials.py, and measures how far the region is dented before the needle enters, the force at that moment, and
the largest force on the way to the centre. Prints docs/results/anatomy/materials.csv, and fails if a needle does not enter.

usage: python3 -m anatomy.trials.material_check BUILD_DIR [NAME...]
"""
import csv
import dataclasses
import os
import sys
import tempfile

import numpy as np

from .. import binding, materials
from . import insertion, label_stress, nrrd, torso

SPACING = (2.0, 2.0, 2.0)           # mm
HALF = 45.0, 40.0, 25.0             # mm, half axes of the region; its centre is 25 mm below its surface
DEEP = 35.0                         # mm, thickness of materials.SURROUNDING between the skin and the region
NODES = 900
REGION, WALL = "liver", "liver_wall"     # with this name, the region's surface becomes a membrane
MOST_DENT = 25.0                    # mm: a needle that dents the region by more than this pushes it away rather than entering it
COLUMNS = ("material", "modulus, kPa", "stiffening", "puncture force of its surface, N", "dent, mm", "force at the puncture, N", "largest force, N",
           "distance of the tip from the centre, mm", "displacement of the centre, mm", "entered", "published force on a needle")
LINEAR = "(liver, linear, as by shear waves)"     # shown only for comparison


def make(folder):
    """Makes a scene with one region under a flat skin; returns its path."""
    grid = torso.Grid(SPACING, (-70, -60, -50), (70, 60, 50))
    path = os.path.join(folder, "region.seg.nrrd")
    nrrd.write_nrrd(path, grid.ellipsoid((0, 0, 0), HALF).astype(np.uint8), grid.place, {1: REGION})
    label_stress.make(path, "--nodes", NODES, "--output", os.path.join(folder, "out"))
    return os.path.join(folder, "out.yaml")


def assign(scene, material):
    """Sets the region's material and the force at which its surface is punctured."""
    for key, value in (("youngs_modulus", material.modulus), ("poisson_ratio", material.poisson), ("stiffening", material.stiffening), ("cutting_force", material.cutting),
                       ("cutting_viscosity", material.viscosity), ("friction.static", material.static), ("friction.kinetic", material.kinetic),
                       ("friction.viscous", material.viscous)):
        scene[f"regions[{REGION}].{key}"] = value
    scene[f"membranes[{WALL}].puncture_force"] = material.wall or 0.0


def measure(path, material):
    """Simulates an insertion. Returns the region's dent (mm) and the force on the hand (N) when the region's surface is punctured, both NaN if it never is; and
    the Insertion."""
    found = insertion.push(path, change=lambda scene: assign(scene, material))
    walls = [(1e3 * travel - DEEP, force) for membrane, travel, force in found.punctures if membrane == WALL]
    return *(walls[0] if walls else (np.nan, np.nan)), found


def row(path, name, entry):
    """Returns a row of the table, and whether the needle enters the region."""
    material = entry.material
    dent, force, found = measure(path, material)
    good = found.region == REGION and not found.failed and dent <= MOST_DENT
    wall = "" if material.wall is None else f"{material.wall:g}"
    gave = ("never", "") if np.isnan(dent) else (f"{dent:.1f}", f"{force:.2f}")
    return (name, f"{1e-3 * material.modulus:g}", f"{material.stiffening:g}", wall, *gave, f"{found.peak:.2f}", f"{1e3 * found.off_target:.1f}",
            f"{1e3 * found.shift:.1f}", "yes" if good else "no", entry.force or "none found"), good


def main():
    binding.trocar(os.path.abspath(sys.argv[1]))
    liver = materials.TABLE["liver"]
    shear_waves = dataclasses.replace(liver, material=dataclasses.replace(liver.material, modulus=4.5e3, stiffening=0.0))
    entries = {**materials.TABLE, "surrounding": materials.SURROUNDING, "any other": materials.OTHER, LINEAR: shear_waves}
    chosen, bad = sys.argv[2:] or list(entries), 0
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(COLUMNS)
    with tempfile.TemporaryDirectory() as folder:
        path = make(folder)
        for name in chosen:
            line, good = row(path, name, entries[name])
            table.writerow(line)
            sys.stdout.flush()
            bad += not good and name != LINEAR
    sys.exit(bad > 0)


if __name__ == "__main__":
    main()
