#!/usr/bin/python3
"""Checks scenes made from crowded label maps. The library must load every scene, a needle is inserted, and every part must keep its volume or be reported by
name.

The maps are random: an organ with lesions in it, another organ that touches it, satellites, bones that touch or lie up to 3 mm apart, and a body around some
of them (meshes/anatomy/trials/label_stress.py). Volumes are counted from voxels and from tetrahedra, without the program's own tables; the needle is pushed
along the scene's path to its target. An insertion into the material of liver shows whether its surface is punctured at a displacement that was measured in
bovine liver.
"""
import math
import os
import sys
import tempfile

from rows import REPOSITORY, SKIPPED, Rows

sys.path.insert(0, str(REPOSITORY / "meshes"))
try:
    from anatomy import binding, materials, session
    from anatomy.trials import label_stress, material_check
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(SKIPPED)

MAPS, FEW = 200, 1
# N/mm^2 and N/mm, coefficients of the published force on bovine liver as a function of the needle's displacement, as in validate_liver.py
BOVINE = 0.0061, 0.0480
DENT = 0.2                  # tolerance, as a fraction of that displacement: the 35 mm of other tissue in front of the region also deform


def maps(rows):
    folder, worst, failed, count = tempfile.TemporaryDirectory(), 0.0, 0, FEW if rows.short_form else MAPS
    label_stress.hurry()
    with folder as place:
        for number in range(count):
            line, good, loss = label_stress.crowded_row(number, place, os.path.abspath(rows.build))
            print(*line, sep=", ", flush=True)
            worst, failed = max(worst, abs(loss)), failed + (not good)
    rows.add(f"of {count} random label maps: not meshed, not loaded, or not pierced", "", failed, 0, failed, 0, "", "absolute")
    rows.error("largest change of a part's volume without a remark", "voxels", worst, label_stress.PART_LIMIT, "of the part")


def liver(rows):
    binding.trocar(os.path.abspath(rows.build))
    with tempfile.TemporaryDirectory() as folder:
        path = material_check.make(folder)
        dent, force, _ = material_check.measure(path, materials.TABLE["liver"].material)
    wall = materials.TABLE["liver"].material.wall
    published = (math.sqrt(BOVINE[1] ** 2 + 4 * BOVINE[0] * wall) - BOVINE[1]) / (2 * BOVINE[0])
    rows.compare("dent of liver when its surface gives way", "bovine liver, Okamura et al. 2004", dent, published, DENT, "mm",
                 f"at the {wall:g} N of the surface; {force:.2f} N on the hand")


def every_material(rows):
    """Tests whether a needle can enter a region of each material."""
    with tempfile.TemporaryDirectory() as folder:
        path, failed = material_check.make(folder), []
        for name, entry in materials.TABLE.items():
            line, good = material_check.row(path, name, entry)
            print(*line, sep=", ", flush=True)
            failed += [] if good else [name]
    rows.add(f"of {len(materials.TABLE)} materials: not entered", "", len(failed), 0, len(failed), 0, "", ": ".join(["absolute", *failed]))


def main():
    rows = Rows.from_arguments(__doc__, "Anatomy: random label maps")
    session.start()
    maps(rows)
    liver(rows)
    if not rows.short_form:
        every_material(rows)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
