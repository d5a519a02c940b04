"""Reproduces with simple shapes problems that came up with real scans. Runs the program on each case as a user would.

usage: python3 -m anatomy.trials.cases [--program COMMAND] [--build FOLDER] [CASE...]     prints a Markdown table
"""
import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
import time

import numpy as np

from ..shapes import shells
from . import inputs, nrrd, torso

SPACING = (1.5, 1.5, 2.0)
ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))))


class Case:
    """The folder with a case's files."""

    def __init__(self, folder):
        self.folder = folder

    def path(self, name):
        return os.path.join(self.folder, name)

    def nrrd(self, labels, place, names=None, name="x.seg.nrrd"):
        nrrd.write_nrrd(self.path(name), labels, place, names)
        return self.path(name)


def block(half=(60, 60, 60), spacing=SPACING):
    return torso.Grid(spacing, -np.array(half, float), np.array(half, float))


def labelled(grid, *masks):
    """Draws the masks as labels 1, 2 and so on, later ones over earlier ones."""
    labels = np.zeros(grid.shape, np.uint8)
    for value, mask in enumerate(masks, 1):
        labels[np.broadcast_to(mask, grid.shape)] = value
    return labels


# ---- bones that touch -----------------------------------------------------------------------------------------------------------

def vertebrae(case, gap):
    """A muscle beside three vertebrae that are this many mm apart."""
    grid = block((70, 60, 75))
    high = 30.0
    masks = [grid.ellipsoid((0, -30, 0), (35, 18, 50))]
    for number in (-1, 0, 1):
        masks.append((np.hypot(grid.x / 20, (grid.y - 20) / 16) < 1) & (np.abs(grid.z - number * high) < (high - gap) / 2))
    file = case.nrrd(labelled(grid, *masks), grid.place, {1: "Psoas", 2: "L1", 3: "L2", 4: "L3"})
    return [file, "--roi", "Psoas", "--bone", "L1", "--bone", "L2", "--bone", "L3", "--nodes", "1500"]


def bones_that_touch(case):
    return vertebrae(case, 0)


def bones_2_mm_apart(case):
    return vertebrae(case, 2)


def bones_3_mm_apart(case):
    return vertebrae(case, 3)


# ---- small targets ----------------------------------------------------------------------------------------------------------------

def in_prostate(case, size, nodes, first="Lesion"):
    labels, place = inputs.pelvis((1.0, 1.0, 1.5), urethra=False)
    k, j, i = np.indices(labels.shape)
    x, y, z = (place[a, 3] + place[a, a] * n for a, n in enumerate((i, j, k)))
    labels[(x - 10) ** 2 + (y - 6) ** 2 + (z - 3) ** 2 < (size / 2) ** 2] = 7
    file = case.nrrd(labels, place, {1: "Prostate", 7: "Lesion"})
    return [file, "--roi", first, "--roi", {"Lesion": "Prostate", "Prostate": "Lesion"}[first], "--nodes", str(nodes)]


def lesion_of_8_mm_in_prostate(case):
    return in_prostate(case, 8, 1500)


def lesion_of_8_mm_in_prostate_5000(case):
    return in_prostate(case, 8, 5000)


def lesion_of_10_mm_in_prostate(case):
    return in_prostate(case, 10, 1500)


def lesion_after_prostate(case):
    return in_prostate(case, 10, 1500, "Prostate")


def in_liver(case, lesions, radius, nodes, spacing=(2.0, 2.0, 2.0), *more):
    labels, inside, _, place = torso.torso(spacing, lesions, radius)
    file = case.nrrd(np.where(inside, 2, labels == 5).astype(np.uint8), place, {1: "Liver", 2: "Metastases"})
    return [file, "--roi", "Metastases", "--roi", "Liver", "--nodes", str(nodes), *more]


def lesion_of_10_mm_in_liver(case):
    return in_liver(case, 1, 5, 2500)


def five_lesions_of_8_mm_in_liver(case):
    return in_liver(case, 5, 4, 2500, (1.5, 1.5, 1.5))


def twenty_lesions_of_8_mm_in_liver(case):
    return in_liver(case, 20, 4, 3000, (1.5, 1.5, 1.5))


def lesion_alone_beside_its_organ(case):
    """A lesion and its organ as surfaces in separate files. The small size of the lesion must not be mistaken for a different unit."""
    labels, inside, _, place = torso.torso((2.0, 2.0, 2.0), 1, 2.5)
    from ..shapes import voxels
    map_ = voxels.LabelMap([(labels == 5).astype(np.uint8), inside.astype(np.uint8)], place, {"liver": voxels.Segment(0, 1), "lesion": voxels.Segment(1, 1)})
    files = []
    for name, each in ((name, voxels.outlined(map_, [name])[name]) for name in map_.segments):
        files.append(case.path(name + ".stl"))
        inputs.write_surface(files[-1], shells.joined(each.shells))
    return [*files, "--roi", "lesion", "--roi", "liver", "--nodes", "2500"]


# ---- the whole body --------------------------------------------------------------------------------------------------------------------

def scan(case, spacing=(2.0, 2.0, 2.0), lesions=1, radius=8.0):
    """Writes the torso as TotalSegmentator's files: all labels, the body and the lesions."""
    labels, inside, body, place = torso.torso(spacing, lesions, radius)
    names = {value: torso.NAMES.get(value, f"class_{value}") for value in range(1, 118)}
    files = [case.path(name + ".nii.gz") for name in ("total", "body", "liver_lesions")]
    inputs.write_nifti(files[0], labels, place, names=names)
    inputs.write_nifti(files[1], body, place, names={1: torso.BODY, 2: "body_extremities"})
    inputs.write_nifti(files[2], inside, place, names={1: torso.LESIONS})
    return files


def all_labels(case):
    """Names every label of the torso on the command line, with ribs and vertebrae as bones, instead of using --all."""
    files = scan(case)
    bones = [name for name in torso.NAMES.values() if name.startswith(("rib", "vertebrae"))]
    soft = ["liver"] + [name for name in torso.NAMES.values() if name not in bones and name != "liver"]
    return [files[0], *sum((["--roi", name] for name in soft), []), *sum((["--bone", name] for name in bones), []), "--nodes", "3000"]


def names_of_totalsegmentator(case):
    return [scan(case, (3.0, 3.0, 3.0))[0], "--list"]


# ---- the skin ----------------------------------------------------------------------------------------------------------------------------

def cropped_scan(case, organ):
    """A scan of part of the body, in which the body extends to the border of the image on all sides except the front."""
    grid = torso.Grid((2.5, 2.5, 2.5), (-100, -90, -80), (100, 90, 80))
    labels = np.zeros(grid.shape, np.uint8)
    labels[np.broadcast_to(grid.y > -75 + 0.002 * grid.x ** 2, grid.shape)] = 1
    labels[np.broadcast_to(organ(grid), grid.shape)] = 2
    file = case.nrrd(labels, grid.place, {1: "Body", 2: "Organ"})
    return [file, "--roi", "Organ", "--skin", "Body", "--nodes", "1500"]


def liver_in_cropped_scan(case):
    return cropped_scan(case, lambda grid: grid.ellipsoid((-45, 0, 20), (48, 50, 45)))


def kidney_in_cropped_scan(case):
    return cropped_scan(case, lambda grid: grid.ellipsoid((55, 50, -10), (25, 24, 40)))


# ---- parts -----------------------------------------------------------------------------------------------------------------------------------

def satellites(case):
    """A tumour with satellites of 9 and 7 mm diameter."""
    grid = block((50, 50, 50), (1.0, 1.0, 1.0))
    tumour = grid.ellipsoid((0, 0, 0), (16, 14, 15)) | grid.ellipsoid((28, 0, 0), (4.5,) * 3) | grid.ellipsoid((-5, 27, 5), (3.5,) * 3)
    return [case.nrrd(labelled(grid, tumour), grid.place, {1: "Tumour"}), "--roi", "Tumour", "--nodes", "1500"]


def small_bowel(case):
    """Loops of bowel, plus a 0.43 ml piece 100 mm away, as left by a segmentation that cut off part of a loop."""
    grid = block((80, 60, 60), (1.5, 1.5, 1.5))
    loops = grid.rod((-60, 0, 0), (-10, 20, 0), 11) | grid.rod((-10, 20, 0), (-10, -30, 20), 11) | grid.ellipsoid((70, 0, 0), (4.7,) * 3)
    return [case.nrrd(labelled(grid, loops), grid.place, {1: "small_bowel"}), "--roi", "small_bowel", "--nodes", "1500"]


# ---- all cases -----------------------------------------------------------------------------------------------------------------------------------

CASES = [bones_that_touch, bones_2_mm_apart, bones_3_mm_apart, lesion_of_8_mm_in_prostate, lesion_of_8_mm_in_prostate_5000, lesion_of_10_mm_in_prostate,
         lesion_after_prostate, lesion_of_10_mm_in_liver, five_lesions_of_8_mm_in_liver, twenty_lesions_of_8_mm_in_liver, lesion_alone_beside_its_organ,
         all_labels, names_of_totalsegmentator, liver_in_cropped_scan, kidney_in_cropped_scan, satellites, small_bowel]


def run(command, folder, **more):
    """Runs a command. Returns its exit status, CPU time (s), peak memory (MB), output and elapsed time (s)."""
    began = time.monotonic()
    with open(os.path.join(folder, "said"), "w+", encoding="utf-8") as said:
        child = subprocess.Popen(command, stdout=said, stderr=said, cwd=folder, **more)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        return child.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, said.read(), time.monotonic() - began


def insertion(build, prefix, folder):
    """Runs the scripted insertion in a scene. Returns the end of trocar-replay's output (events with times, and the largest force), or an error message."""
    device, replay = (os.path.join(build, "clients", name) for name in ("trocar-device", "trocar-replay"))
    log, table = os.path.join(folder, "in.log"), os.path.join(folder, "in.csv")
    status, _, _, said, _ = run([device, "--script", "insert", "--scene", prefix + ".yaml", "--write-log", log], folder)
    if status == 0:
        status, _, _, said, _ = run([replay, "--scene", prefix + ".yaml", "--poses", log, "--csv", table], folder)
    if status:
        return "not loaded: " + said.strip().splitlines()[-1][:150]
    return re.sub(r"\s+", " ", said)[-300:]


def row(case, given):
    with tempfile.TemporaryDirectory() as folder:
        arguments = case(Case(folder))
        prefix = os.path.join(folder, "out")
        more = [] if "--list" in arguments else ["--output", prefix]
        status, seconds, megabytes, said, _ = run([*shlex.split(given.program), *arguments, *more], folder)
        lines = [line for line in said.replace(folder + "/", "").splitlines() if line.strip()]
        told = " / ".join(lines[-4:] if status == 0 else lines[-1:])[:600]
        result = insertion(given.build, prefix, folder) if status == 0 and more else ""
        if given.keep:
            print(said, file=sys.stderr)
    return f"| {case.__name__.replace('_', ' ')} | {status} | {seconds:.0f} | {megabytes:.0f} | {told} | {result} |"


def main():
    parser = argparse.ArgumentParser("anatomy.trials.cases")
    parser.add_argument("case", nargs="*")
    parser.add_argument("--program", default=os.path.join(ROOT, "scripts/anatomy"))
    parser.add_argument("--build", default=os.path.join(ROOT, "build"))
    parser.add_argument("--keep", action="store_true")
    given = parser.parse_args()
    print("| case | status | processor, s | memory, MB | last words | scripted push |\n|---|---|---|---|---|---|")
    for case in CASES:
        if not given.case or case.__name__ in given.case:
            print(row(case, given), flush=True)


if __name__ == "__main__":
    main()
