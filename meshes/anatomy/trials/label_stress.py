"""Runs label maps, surfaces and volume meshes of every kind through the program. Prints tables as CSV, and fails if a result is outside the limits.

usage: python3 -m anatomy.trials.label_stress kinds [NODES [KIND...]]   the synthetic patient as every kind of file; default 570, all
       python3 -m anatomy.trials.label_stress random [FIRST [COUNT]]    COUNT random label maps, from number FIRST; default 0 200
       python3 -m anatomy.trials.label_stress crowded BUILD_DIR [FIRST [COUNT [SIZE [NODES]]]]   the same, with enclosed lesions, satellites and touching bones;
                                                                 each is loaded and pierced; SIZE scales the organs; default 0 200 0.6 900
       python3 -m anatomy.trials.label_stress forces BUILD_DIR [NODES]  the same insertion in one organ from outlines, labels and a surface
"""
import concurrent.futures
import contextlib
import io
import multiprocessing
import os
import resource
import subprocess
import sys
import tempfile

import numpy as np
import scipy.ndimage
import scipy.sparse.csgraph

from .. import __main__ as command, binding, limits, meshing, options, organ as organs_in, pipeline
from ..shapes import voxels
from . import inputs, insertion, nrrd, patient, shipped, tables
from ..shapes.contours import Unusable
from ..limits import Crashed, TooLong
from ..trouble import BadFile

VOLUME_LIMIT = 0.01                     # largest error allowed in a volume, as a fraction of the voxels' volume
LEAST_ANGLE, GREATEST_ANGLE = 10, 165   # deg
MEAN_LIMIT = 1.0                        # mm, mean distance from the faces of the voxels to the mesh
SPACING = (1.0, 1.0, 1.5)               # mm
RANDOM_TRIES = 3                        # maximum number of meshing attempts for a random map
GOOD_REFUSALS = (BadFile, Unusable, TooLong)


def used():
    """Returns the CPU time (s) and the peak memory (MB) of this process and its children."""
    kinds = [resource.getrusage(kind) for kind in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(kind.ru_utime + kind.ru_stime for kind in kinds), max(kind.ru_maxrss for kind in kinds) / 1024


def make(*arguments):
    """Runs the program with these arguments, discards its output, and returns the result of run()."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return command.run(options.parse([*(str(argument) for argument in arguments), "--quiet"]))


class Patient:
    """The synthetic patient, its true volumes, and its files in every format."""

    def __init__(self, folder):
        self.folder = folder
        self.labels, self.place = inputs.pelvis(SPACING)
        self.volumes = {name: np.count_nonzero(self.labels == value) * np.prod(SPACING) for value, name in inputs.NAMES.items()}

    def path(self, name):
        return os.path.join(self.folder, name)

    def solid(self):
        """Returns only the prostate and the arch, without the urethra."""
        labels, _ = inputs.pelvis(SPACING, False)
        return np.where((labels == 1) | (labels == 5), labels, 0).astype(np.uint8)

    def whole(self):
        """Returns the true volumes of the regions in solid(), mm^3."""
        return {"Prostate": np.count_nonzero(self.solid() == 1) * np.prod(SPACING)}

    def shells(self):
        map_ = voxels.LabelMap([self.solid()], self.place, {"Prostate": voxels.Segment(0, 1), "Pubic arch": voxels.Segment(0, 5)})
        return {name: each.shells[0] for name, each in voxels.outlined(map_, list(map_.segments)).items()}

    def surfaces(self, extension, frame="LPS", scale=1.0):
        paths = []
        for name, shell in self.shells().items():
            paths.append(self.path(name + extension))
            inputs.write_surface(paths[-1], type(shell)(shell.points * scale, shell.triangles), frame)
        return paths

    def inner_mesh(self):
        """Returns the mesh of touching labels, in mm, without the surrounding tissue."""
        self.nifti()
        _, mesh, domain, _ = make(self.path("pelvis.nii.gz"), "--names", self.names(), "--roi", "Prostate", "--roi", "Bladder", "--nodes", 1200,
                                  "--output", self.path("inner"))
        mesh.points = pipeline.patient(mesh.points, domain.origin)
        keep = mesh.region != mesh.regions.index("surrounding")
        mesh.tets, mesh.region = mesh.tets[keep], mesh.region[keep]
        return mesh

    def nifti(self, spacing=None, degrees=0.0):
        labels, place = (self.labels, self.place) if spacing is None else inputs.pelvis(spacing)
        inputs.write_nifti(self.path("pelvis.nii.gz"), labels, inputs.turned(place, degrees))
        return labels

    def names(self):
        with open(self.path("names.txt"), "w", encoding="utf-8") as file:
            file.write("\n".join(f"{value} {name}" for value, name in inputs.NAMES.items()))
        return self.path("names.txt")


TWO = ("--roi", "Prostate", "--bone", "Pubic arch")


def outlines(p):
    rois = patient.outlines(patient.Gland(), 2.5)
    shipped.write_rtstruct(p.path("rt.dcm"), rois)
    return [p.path("rt.dcm"), *TWO], {}


def nifti(p):
    p.nifti()
    return [p.path("pelvis.nii.gz"), "--names", p.names(), *TWO], p.volumes


def thick(p):
    labels = p.nifti((0.9, 0.9, 5.0), 7.0)
    return [p.path("pelvis.nii.gz"), "--names", p.names(), *TWO], {"Prostate": np.count_nonzero(labels == 1) * 0.9 * 0.9 * 5}


def folder(p):
    paths = []
    for value in (1, 4, 5):
        paths.append(p.path(("prostate", "", "", "urinary_bladder", "hip_left")[value - 1] + ".nii.gz"))
        inputs.write_nifti(paths[-1], p.labels == value, p.place)
    return [*paths, "--roi", "prostate", "--roi", "urinary_bladder", "--bone", "hip_left"], {
        "prostate": p.volumes["Prostate"], "urinary_bladder": p.volumes["Bladder"]}


def slicer(p):
    nrrd.write_nrrd(p.path("pelvis.seg.nrrd"), p.labels, p.place, inputs.NAMES, "right-anterior-superior")
    return [p.path("pelvis.seg.nrrd"), *TWO], p.volumes


def layers(p):
    whole = (p.solid() == 1).astype(np.uint8)
    nrrd.write_nrrd(p.path("two.seg.nrrd"), [whole, (p.labels == 2).astype(np.uint8)], p.place, {(0, 1): "Prostate", (1, 1): "Urethra"})
    return [p.path("two.seg.nrrd"), "--roi", "Prostate", "--roi", "Urethra"], {**p.whole(), "Urethra": p.volumes["Urethra"]}


def dicom(p):
    inputs.write_seg(p.path("seg.dcm"), p.labels, p.place, {value: inputs.NAMES[value] for value in (1, 4, 5)})
    return [p.path("seg.dcm"), "--roi", "Prostate", "--roi", "Bladder", "--bone", "Pubic arch"], p.volumes


def stl(p):
    return [*p.surfaces(".stl"), *TWO], p.whole()


def obj(p):
    return [*p.surfaces(".obj", "RAS", 0.1), "--unit", "cm", "--frame", "RAS", *TWO], p.whole()


def vtk(p):
    return [*p.surfaces(".vtk", "RAS"), *TWO], p.whole()


def vtp(p):
    return [*p.surfaces(".vtp"), *TWO], p.whole()


def cells(p):
    mesh = p.inner_mesh()
    inputs.write_cells(p.path("inner.vtu"), mesh)
    numbered = [str(1 + mesh.regions.index(name)) for name in ("prostate", "bladder")]
    return [p.path("inner.vtu"), "--roi", numbered[0], "--roi", numbered[1]], {
        n: mesh.region_volume(name) for n, name in zip(numbered, ("prostate", "bladder"))}


def gmsh(p):
    p.inner_mesh()
    return [p.path("inner.msh"), "--unit", "m", "--roi", "prostate", "--roi", "bladder"], {
        "prostate": p.volumes["Prostate"], "bladder": p.volumes["Bladder"]}


def body(p):
    slicer(p)
    return [p.path("pelvis.seg.nrrd"), *TWO, "--skin", "Body"], p.volumes


def five(p):
    nifti(p)
    return [p.path("pelvis.nii.gz"), "--names", p.names(), "--roi", "Prostate", "--roi", "Urethra", "--roi", "Rectum", "--roi", "Bladder",
            "--bone", "Pubic arch"], p.volumes


# Functions that write a kind of file, with a description and the minimum number of nodes. They return the program's arguments and the true volume of each
# region, mm^3.
KINDS = {outlines: ("RT Structure Set, slices of 2.5 mm", 0), nifti: ("NIfTI, 1 x 1 x 1.5 mm", 0), thick: ("NIfTI, 0.9 x 0.9 x 5 mm, turned by 7 degrees", 0),
         folder: ("NIfTI, one file for each organ, as TotalSegmentator's", 0), slicer: (".seg.nrrd, RAS, gzip", 0),
         layers: (".seg.nrrd with two labels that overlap", 1500), dicom: ("DICOM SEG, planes without label left out", 0), stl: ("STL", 0), obj: ("OBJ, cm, RAS", 0),
         vtk: ("VTK surface with SPACE=RAS", 0), vtp: ("VTP", 0), cells: (".vtu with labels of its cells", 0), gmsh: (".msh with groups, m", 0),
         body: ("the skin from the label Body", 900), five: ("five labels that touch", 1800)}


def kind_row(p, kind, nodes):
    arguments, truth = kind(p)
    prepared = used()[0]
    nodes = max(nodes, KINDS[kind][1])
    organs, mesh, domain, outlined = make(*arguments, "--nodes", nodes, "--output", p.path("out"))
    seconds, megabytes = used()[0] - prepared, used()[1]
    soft = [organ for organ in organs if not organ.bone]
    # fraction of each volume, as read, that is left after losses to other organs
    told = {organ.roi: outlined[organ.name] / (organ.volume * 1e-9) for organ in soft}
    change = max((mesh.region_volume(organ.name) * 1e9 / (truth.get(organ.roi, organ.volume) * told[organ.roi]) - 1 for organ in soft), key=abs)
    off = np.concatenate(list(pipeline.distances_to_outlines(organs, domain, mesh, outlined).values()))
    angles = mesh.dihedral_angles()
    good = (abs(change) <= VOLUME_LIMIT and off.mean() <= MEAN_LIMIT and LEAST_ANGLE <= angles.min() and angles.max() <= GREATEST_ANGLE
            and abs(len(mesh.points) / nodes - 1) <= 0.1)
    return (KINDS[kind][0], ", ".join(organ.roi for organ in organs), len(mesh.points), f"{100 * change:+.2f}", f"{off.mean():.2f}", f"{off.max():.1f}",
            f"{angles.min():.1f}", f"{angles.max():.1f}", f"{seconds:.0f}", f"{megabytes:.0f}", "yes" if good else "no"), good


def kinds(nodes=570, *chosen):
    tables.row("input", "regions", "nodes", "worst_volume_percent", "mean_distance_mm", "greatest_distance_mm", "least_angle_deg", "greatest_angle_deg",
               "processor_s", "memory_MB", "good")
    bad = 0
    with tempfile.TemporaryDirectory() as place:
        p = Patient(place)
        for kind in KINDS:
            if not chosen or kind.__name__ in chosen:
                try:
                    # one process per row, so that the memory measured is that of this row
                    with concurrent.futures.ProcessPoolExecutor(1, multiprocessing.get_context("fork")) as own:
                        row, good = own.submit(kind_row, p, kind, int(nodes)).result()
                except (*GOOD_REFUSALS, Crashed) as error:
                    row, good = (KINDS[kind][0], f"refused: {error}", *8 * [""], "no"), False
                tables.row(*row)
                bad += not good
    return bad


# ---- forces --------------------------------------------------------------------------------------------------------------------

FORCE_LIMIT = 0.03      # largest difference allowed between forces, as a fraction of the largest force


def forces(build, nodes=570):
    """Compares the forces of the same scripted insertion (trocar-device's `insert`) in meshes from different inputs. Returns 1 if they differ too much."""
    tables.row("input", "nodes", "prostate_ml", "peak_N", "peak_to_first_percent", "rms_difference_percent_of_peak")
    build, curves, volumes = os.path.abspath(build), [], []
    with tempfile.TemporaryDirectory() as place:
        p = Patient(place)
        shipped.write_rtstruct(p.path("rt.dcm"), patient.outlines(patient.Gland(), 2.5))
        nrrd.write_nrrd(p.path("labels.seg.nrrd"), p.solid(), p.place, {1: "Prostate"})
        made = p.surfaces(".stl")
        for name, path in (("RT Structure Set", p.path("rt.dcm")), ("label map", p.path("labels.seg.nrrd")), ("STL", made[0])):
            _, mesh, _, _ = make(path, "--roi", "Prostate", "--nodes", nodes, "--output", p.path("out"), "--entry=6,-2,-54", "--target=6,-2,0")
            subprocess.run([f"{build}/clients/trocar-device", "--script", "insert", "--scene", p.path("out.yaml"), "--write-log", p.path("in.log")], check=True)
            subprocess.run([f"{build}/clients/trocar-replay", "--scene", p.path("out.yaml"), "--poses", p.path("in.log"), "--csv", p.path("out.csv"), "--quiet"],
                           check=True)
            curves.append(np.genfromtxt(p.path("out.csv"), delimiter=",", skip_header=1, usecols=(1, 2, 3), encoding="utf-8"))
            volumes.append(mesh.region_volume("prostate") * 1e6)
            force, first = curves[-1], curves[0]
            largest = [np.linalg.norm(f, axis=1).max() for f in (force, first)]
            off = np.sqrt(((force - first) ** 2).sum(axis=1).mean()) / largest[1]
            tables.row(name, len(mesh.points), f"{volumes[-1]:.2f}", f"{largest[0]:.3f}", f"{100 * (largest[0] / largest[1] - 1):+.2f}", f"{100 * off:.2f}")
            if abs(largest[0] / largest[1] - 1) > FORCE_LIMIT or abs(volumes[-1] / volumes[0] - 1) > VOLUME_LIMIT:
                return 1
    return 0


# ---- random label maps -----------------------------------------------------------------------------------------------------------

def random_map(number):
    """Generates random map `number`. Returns labels (k, j, i), their transform, and the numbers of the soft labels and of the bones. The labels are blobs that
    touch, nest, branch, are thin or extend beyond the image."""
    random = np.random.default_rng(number)
    size = random.integers(24, 90, 3)
    spacing = random.choice([0.7, 1.0, 1.5, 2.5, 5.0], 3, p=[0.2, 0.3, 0.3, 0.1, 0.1])
    grid = np.stack(np.meshgrid(*(np.arange(n) * s for n, s in zip(size, spacing)), indexing="ij"), axis=-1)
    extent = size * spacing
    labels = np.zeros(size, np.uint8)
    count = int(random.integers(1, 6))
    for label in range(1, count + 1):
        centre = random.uniform(-0.05, 1.05, 3) * extent if random.uniform() < 0.3 else random.uniform(0.25, 0.75, 3) * extent
        for _ in range(int(random.integers(1, 4))):
            radii = random.uniform(0.02, 0.35, 3) * extent.min()
            if random.uniform() < 0.2:
                radii[random.integers(3)] = random.uniform(0.5, 1.5) * spacing.max()     # a sheet
            axes = np.linalg.qr(random.normal(size=(3, 3)))[0]
            blob = (((grid - centre) @ axes / radii) ** 2).sum(axis=-1) < 1
            if random.uniform() < 0.2:
                blob &= ((grid - centre) ** 2).sum(axis=-1) > (0.6 * radii.min()) ** 2      # a hollow
            labels[blob] = label
            centre = centre + random.normal(size=3) * radii      # the next part starts from this point
    if random.uniform() < 0.1:
        labels[random.uniform(size=labels.shape) < 0.002] = 1    # specks
    place = inputs.turned(np.diag([*spacing, 1.0]), random.uniform(-30, 30))
    place[:3, 3] = random.uniform(-200, 200, 3)
    found = [int(v) for v in np.unique(labels) if v]
    bones = [v for v in found[1:] if random.uniform() < 0.15]
    return labels.transpose(2, 1, 0).copy(), place, [v for v in found if v not in bones], bones


def random_row(number, folder_):
    """Returns a row of the table, and whether the result is good: a mesh with volumes within the limits, or an error message that names a cause."""
    labels, place, soft, bones = random_map(number)
    began = used()[0]
    path = os.path.join(folder_, f"{number}.nrrd")
    nrrd.write_nrrd(path, labels, place)
    chosen = [argument for kind, values in (("--roi", soft), ("--bone", bones)) for v in values for argument in (kind, str(v))]
    about = (number, " x ".join(map(str, labels.shape[::-1])), len(soft), len(bones))
    try:
        organs, mesh, _, outlined = make(path, *chosen, "--nodes", 1500, "--output", os.path.join(folder_, "out"))
    except GOOD_REFUSALS as error:
        return (*about, f"refused: {str(error).replace(path, 'file')}", "", "", "", "", f"{used()[0] - began:.0f}"), True
    except Exception as error:  # anything else is a bug in the program
        return (*about, f"failed: {type(error).__name__}: {error}", "", "", "", "", f"{used()[0] - began:.0f}"), False
    change = max((mesh.region_volume(organ.name) / outlined[organ.name] - 1 for organ in organs if not organ.bone), key=abs)
    angles = mesh.dihedral_angles()
    return (*about, "meshed", len(mesh.points), f"{100 * change:+.2f}", f"{angles.min():.1f}", f"{angles.max():.1f}",
            f"{used()[0] - began:.0f}"), abs(change) <= VOLUME_LIMIT


def hurry():
    """Makes the program accept the first mesh with no surface missing and at most twice the desired number of nodes, because random maps need neither good
    angles nor an exact number of nodes."""
    meshing.TRIES, meshing.MOST_WORK, meshing.OFF = RANDOM_TRIES, 0, meshing.MOST_OFF - 1


def random_maps(first=0, count=200):
    hurry()
    tables.row("map", "voxels", "regions", "bones", "result", "nodes", "worst_volume_percent", "least_angle_deg", "greatest_angle_deg", "processor_s")
    bad = 0
    with tempfile.TemporaryDirectory() as place:
        for number in range(int(first), int(first) + int(count)):
            row, good = random_row(number, place)
            tables.row(*row)
            bad += not good
    print(f"{int(count) - bad} of {count} meshed within 1 % of volume, or refused with a cause", file=sys.stderr)
    return bad


# ---- crowded label maps ----------------------------------------------------------------------------------------------------------

PART_LIMIT = 0.05       # the report must name every part that loses more than this fraction of its volume
SMALL, FEW = 0.6, 900   # organ size and number of nodes with which 200 maps take a quarter of an hour of CPU time
LESIONS, ORGAN, SECOND, BODY, FIRST_BONE = 1, 2, 3, 4, 5


def crowded_map(number, size=1.0):
    """Generates crowded map `number`: an organ with lesions, another organ that touches it, satellites of both, bones that touch or are up to 3 mm apart, and
    sometimes a body around everything. Returns labels (k, j, i), their transform, their names, and the program's arguments. size: scales everything but
    voxels, small parts and gaps."""
    random = np.random.default_rng(10000 + number)
    spacing = np.array([random.choice([1.0, 1.5, 2.0])] * 2 + [random.choice([1.0, 1.5, 2.0, 3.0])])
    half = size * np.array([75.0, 65.0, 60.0])
    axes = [np.arange(-h, h, s) for h, s in zip(half, spacing)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij", sparse=True)
    labels = np.zeros(tuple(len(axis) for axis in axes[::-1]), np.uint8)

    def ball(middle, radii):
        a, b, c = np.broadcast_to(radii, 3)
        return ((x - middle[0]) / a) ** 2 + ((y - middle[1]) / b) ** 2 + ((z - middle[2]) / c) ** 2 < 1
    bodied = random.uniform() < 0.3
    if bodied:
        labels[ball((0, 0, 0), size * np.array([72, 62, 90]))] = BODY
    middle, radii = size * (random.uniform(-8, 8, 3) + [-18, -5, 5]), size * random.uniform(22, 32, 3)
    organ = ball(middle, radii) | ball(middle + [0.7 * radii[0], 0, 0], 0.7 * radii)
    labels[organ] = ORGAN
    second = middle + [1.5 * radii[0] + 12 * size, size * random.uniform(-8, 8), size * random.uniform(-10, 10)]
    labels[ball(second, size * random.uniform(11, 17, 3)) & (labels != ORGAN)] = SECOND
    for label in (ORGAN, SECOND):
        for _ in range(int(random.integers(0, 3))):
            labels[ball(random.uniform(-0.7, 0.7, 3) * half, random.uniform(3, 6)) & ((labels == 0) | (labels == BODY))] = label
    for _ in range(int(random.integers(1, 13))):
        place, radius = middle + random.uniform(-0.75, 0.75, 3) * radii, random.uniform(3, 7)
        mask = ball(place, radius)
        if np.all(labels[mask] == ORGAN):
            labels[mask] = LESIONS
    bones = int(random.integers(0, 4))
    gap, high = random.choice([0.0, 1.0, 2.0, 3.0]), size * random.uniform(18, 26)
    for n in range(bones):
        height = -40 * size + n * high
        column = (np.hypot(x + 5 * size, y - 45 * size) < 11 * size) & (np.abs(z - height) < (high - gap) / 2) & ((labels == 0) | (labels == BODY))
        labels[column] = FIRST_BONE + n
    place = inputs.turned(np.diag([*spacing, 1.0]), random.uniform(-20, 20))
    place[:3, 3] += random.uniform(-200, 200, 3)
    names = {LESIONS: "Lesions", ORGAN: "Liver", SECOND: "Spleen", BODY: "Body", **{FIRST_BONE + n: f"Vertebra {n + 1}" for n in range(bones)}}
    names = {value: name for value, name in names.items() if np.any(labels == value)}
    first = "Lesions" if LESIONS in names and random.uniform() < 0.7 else "Liver"
    soft = [first] + [names[value] for value in (LESIONS, ORGAN, SECOND) if value in names and names[value] != first]
    arguments = sum((["--roi", name] for name in soft), []) + sum((["--bone", name] for name in names.values() if name.startswith("Vertebra")), [])
    return labels, place, names, arguments + (["--skin", "Body"] if bodied else [])


def parts_of_map(labels, place, value):
    """Numbers the connected components of a label; voxels are connected if they share a face. Returns the numbers (k, j, i) and the volumes, mm^3."""
    numbers, count = scipy.ndimage.label(labels == value)
    return numbers, np.bincount(numbers.ravel(), minlength=count + 1)[1:] * abs(np.linalg.det(place[:3, :3]))


def volumes_in_mesh(mesh, domain, name, numbers, place):
    """Returns the volume in the mesh of each part of a label, mm^3. If parts have merged, their volume counts for the largest one."""
    chosen = np.flatnonzero(mesh.region == mesh.regions.index(name))
    tets = mesh.tets[chosen]
    corners = np.sort(np.concatenate([tets[:, sorted({0, 1, 2, 3} - {k})] for k in range(4)]), axis=1)
    order = np.lexsort(corners.T)
    same = np.flatnonzero(np.all(corners[order[1:]] == corners[order[:-1]], axis=1))
    a, b = order[same] % len(tets), order[same + 1] % len(tets)
    count, component = scipy.sparse.csgraph.connected_components(scipy.sparse.coo_matrix((np.ones(len(a)), (a, b)), (len(tets),) * 2), False)
    middles = pipeline.patient(mesh.points[tets].mean(axis=1), domain.origin)
    voxels = np.rint((middles - place[:3, 3]) @ np.linalg.inv(place[:3, :3]).T).astype(int)
    voxels = np.clip(voxels, 0, np.array(numbers.shape[::-1]) - 1)
    held = numbers[voxels[:, 2], voxels[:, 1], voxels[:, 0]]
    volumes, found = mesh.volumes()[chosen] * 1e9, np.zeros(numbers.max() + 1)
    for each in range(count):
        mine = component == each
        votes = np.bincount(held[mine], volumes[mine], len(found))
        votes[0] = 0
        found[np.argmax(votes)] += volumes[mine].sum()
    return found[1:]


def losses_in(organs, mesh, domain, labels, place, names):
    """Returns the largest relative change in volume of any part that no remark names, and the number of parts. Remarks name parts by their volumes."""
    worst, count = 0.0, 0
    for organ in organs:
        if organ.bone:
            continue
        value = next(value for value, name in names.items() if name == organ.roi)
        numbers, true = parts_of_map(labels, place, value)
        held = volumes_in_mesh(mesh, domain, organ.name, numbers, place)
        notes = " ".join(organ.notes)
        for volume, got in zip(true, held):
            count += 1
            named = any(organs_in.in_ml(volume * (1 + slight)) in notes for slight in (-1e-9, 1e-9))     # ties may be rounded either way
            if abs(got / volume - 1) > abs(worst) and not named:
                worst = got / volume - 1
    return worst, count


def crowded_row(number, folder_, build, size=SMALL, nodes=FEW):
    """Returns a row of the table; whether the result is good, that is, the scene loads, the needle enters the first region, and parts change little in volume
    or are named in a remark; and the largest change that no remark names."""
    binding.trocar(build)
    labels, place, names, chosen = crowded_map(number, size)
    began, path = used()[0], os.path.join(folder_, f"{number}.seg.nrrd")
    nrrd.write_nrrd(path, labels, place, names)
    about = (number, len(names), "yes" if "--skin" in chosen else "no", f"{size:g}")
    try:
        organs, mesh, domain, _ = make(path, *chosen, "--nodes", nodes, "--output", os.path.join(folder_, "out"))
    except Exception as error:  # no map may be refused, so any exception is a fault
        return (*about, f"failed: {type(error).__name__}: {str(error).replace(path, 'file')}", *6 * [""], f"{used()[0] - began:.0f}", "no"), False, 0.0
    seconds = used()[0] - began
    worst, count = losses_in(organs, mesh, domain, labels, place, names)
    measured = (len(mesh.points), count, f"{100 * worst:+.1f}")
    try:
        pushed = limits.run("push", insertion.push, os.path.join(folder_, "out.yaml"), build)
    except Exception as error:  # either the library has raised an exception, or it took too long
        return (*about, f"not pushed: {error}", *measured, "", "", "", f"{seconds:.0f}", "no"), False, worst
    pierced = pushed.region == organs[0].name
    good = abs(worst) <= PART_LIMIT and pierced and not pushed.failed
    return (*about, pushed.failed or "meshed", *measured, f"{pushed.peak:.2f}", "yes" if pierced else pushed.region or "no tissue", f"{1e3 * pushed.off_target:.1f}",
            f"{seconds:.0f}", "yes" if good else "no"), good, worst


def crowded(build, first=0, count=200, size=SMALL, nodes=FEW):
    hurry()
    tables.row("map", "labels", "body", "size", "result", "nodes", "parts", "worst_unnamed_loss_percent", "peak_N", "pierced", "off_target_mm", "processor_s", "good")
    bad = 0
    with tempfile.TemporaryDirectory() as place:
        for number in range(int(first), int(first) + int(count)):
            row, good, _ = crowded_row(number, place, os.path.abspath(build), float(size), int(nodes))
            tables.row(*row)
            bad += not good
    print(f"{int(count) - bad} of {count} load, are pierced, and lose no part by more than 5 % without a remark", file=sys.stderr)
    return bad


def main():
    modes = {"kinds": kinds, "random": random_maps, "crowded": crowded, "forces": forces}
    if len(sys.argv) < 2 or sys.argv[1] not in modes:
        sys.exit(__doc__)
    sys.exit(modes[sys.argv[1]](*sys.argv[2:]) > 0)


if __name__ == "__main__":
    main()
