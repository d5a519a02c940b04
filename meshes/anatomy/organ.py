"""The regions that the user named: their connected components, and what was repaired or left out."""
import dataclasses
import re
import unicodedata

import numpy as np

from . import materials
from .shapes import contours, field, label_image, shells
from .shapes.contours import Unusable

SHORT = 20.0            # mm: if the largest region is shorter than this, ask in the report whether the unit of length is right
SMALL = 100.0           # mm^3: if the largest region is smaller than this, the unit is probably wrong: reject it
LARGE = 2000.0          # mm: a region longer than this also suggests a wrong unit: reject it
LEAST = 1.0             # mm^3: reject regions smaller than this
SPECK_VOXELS = 8        # leave out parts of a label with fewer voxels than this
SPECK = SMALL           # mm^3: leave out a part smaller than this if it is also less than SPLINTER of the region's largest part
STEEP = 5.0             # edges longer than this many times the median belong to a spike or dent
FEW = 4                 # accept this many such edges; also, name up to this many parts individually in a remark
MOST_CHECKED = 40000    # decimate surfaces with more triangles than this before checking them for crossings
RESERVED = ("surrounding", "skin", "fixed", "capsule", "bone")    # names of groups that are not regions
LONGEST_NAME = 40       # characters, maximum length of a region's name; a mesh allows 63, including suffixes


@dataclasses.dataclass
class Organ:
    """A region. Lengths are in DICOM mm."""
    roi: str                     # the region's name in the user's file
    name: str                    # its name in the mesh and scene
    bone: bool
    points: np.ndarray           # (n, 3) points of the outlines or the surface, as read
    loft: shells.Shell = None
    shape: field.Field = None    # the region's signed distance field, used if there is no loft
    shells: list = None          # closed surfaces of its parts, made from labels or surfaces
    volumes: list = None         # volumes of these parts, mm^3
    stack: contours.Stack = None
    volume: float = 0.0          # mm^3, total volume of all parts
    notes: list = dataclasses.field(default_factory=list)
    share: bool = False          # true if its surfaces are made from a label image
    read: float = None           # mm^3, volume in the file, before repairs and omissions; None if it equals `volume`
    kind: str = ""               # the file's description of the region, used to choose its material
    layer: object = None         # layer of the label map from which it comes; labels of the same layer do not overlap
    cut: object = None           # faces where the image cuts off the region (voxels.Border)

    def note(self, text):
        if f"{self.roi}: {text}" not in self.notes:
            self.notes.append(f"{self.roi}: {text}")

    def volumes_of(self, surfaces):
        """Returns the volumes of the parts that these surfaces enclose, mm^3."""
        if self.volumes and len(self.volumes) == len(surfaces):
            return list(self.volumes)
        share = self.volume / sum(shell.volume() for shell in surfaces)
        return [share * shell.volume() for shell in surfaces]


def placed(point):
    return "(" + ", ".join(f"{value + 0.0:.0f}" for value in point) + ") mm"


def in_ml(volume):
    """Formats a volume (mm^3) in ml."""
    return f"{volume * 1e-3:.2g} ml" if volume < 1e3 else f"{volume * 1e-3:.1f} ml"


def note_left_out(organ, parts, reason):
    """Adds a remark about parts that were left out. parts: pairs (volume in mm^3, position)."""
    if not parts:
        return
    parts = sorted(parts, key=lambda part: -part[0])
    whole = organ.volume if organ.read is None else organ.read
    named = ", ".join(f"{in_ml(volume)} at {placed(place)}" for volume, place in parts[:FEW])
    rest = f" and {len(parts) - FEW} more" if len(parts) > FEW else ""
    total = sum(volume for volume, _ in parts)
    organ.note(f"{len(parts)} of its separate parts {'is' if len(parts) == 1 else 'are'} left out, {-100 * total / whole:+.2g} % of its volume, because {reason}: {named}{rest}")


def region_names(rois):
    """Makes up names for the mesh and scene. Returns ROI -> name. Names consist of lower-case Latin letters, digits and underscores, with a number appended
    if a name is already taken."""
    names, taken = {}, set(RESERVED)
    for roi in rois:
        plain = unicodedata.normalize("NFKD", roi.lower()).encode("ascii", "ignore").decode()
        name = stem = re.sub(r"[^a-z0-9]+", "_", plain).strip("_")[:LONGEST_NAME] or "region"
        number = 1
        while name in taken:
            number += 1
            name = f"{stem}_{number}"
        taken.add(name)
        names[roi] = name
    return names


# ---- regions by the kind of input -----------------------------------------------------------------------------------------------------

def of_rings(roi, name, bone, rings):
    stack = contours.build_stack(roi, rings)
    return Organ(roi, name, bone, np.vstack([np.reshape(ring, (-1, 3)) for ring in rings]), stack=stack, volume=stack.volume(),
                 notes=[f"{roi}: {note}" for note in stack.notes])


def of_surface(roi, name, bone, surface, notes=()):
    """Makes an organ from a surface. notes: remarks on how it was repaired."""
    organ = Organ(roi, name, bone, surface.points, shells=[surface], volume=surface.volume(), notes=[f"{roi}: {note}" for note in notes])
    note_long_edges(organ)
    mend_crossings(organ)
    solids = sorted(shells.solids([part for shell in organ.shells for part in shells.all_parts(shell)]), key=lambda shell: -shell.volume())
    share = organ.volume / sum(shell.volume() for shell in solids)
    take_parts(organ, [(share * shell.volume(), shell) for shell in solids], [])
    return organ


def of_label(roi, name, bone, label, kind="", layer=None):
    """Makes an organ from a label, given as a voxels.Outlined."""
    notes = [f"{roi}: {note}" for note in label.notes]
    if not label.shells:
        raise Unusable(roi, f"nothing is left of its {label.volume:.3g} mm^3 at the resolution of the image: leave it out")
    organ = Organ(roi, name, bone, label.points, volume=label.volume, notes=notes, read=label.volume, kind=kind, layer=layer, cut=label.border)
    take_parts(organ, list(zip(label.volumes, label.shells)), label.gone, SPECK_VOXELS * label.voxel)
    for volumes, place in label.joined:
        named, rest = ", ".join(map(in_ml, volumes[:FEW])), f" and {len(volumes) - FEW} more" if len(volumes) > FEW else ""
        organ.note(f"{len(volumes)} parts, of {named}{rest}, around {placed(place)}, touch along edges of voxels or nearly touch, and are one")
    return organ


def take_parts(organ, parts, gone, speck=0.0):
    """Keeps the parts (volume, surface) that are not specks, and remarks on the others. gone: (volume, position) of parts without a surface; speck: mm^3,
    smallest volume to keep beside larger parts."""
    largest = max(volume for volume, _ in parts)
    kept = [part for part in parts if part[0] == largest or part[0] >= speck and (part[0] >= SPECK or part[0] > shells.SPLINTER * largest)]
    dropped = [(volume, shell.centre()) for volume, shell in parts if not any(shell is each for _, each in kept)]
    count, left = len(parts) + len(gone), [*dropped, *gone]
    if count > 1 and not left:
        organ.note(f"has {count} separate parts")
    organ.read = organ.volume if organ.read is None else organ.read
    note_left_out(organ, left, f"of {count} they are the smallest, of less than {100 * shells.SPLINTER:g} % of the largest one or a few voxels")
    organ.volumes, organ.shells = (list(each) for each in zip(*kept))
    organ.volume -= sum(volume for volume, _ in left)


def note_long_edges(organ):
    surface = organ.shells[0]
    ends = surface.points[surface.edges()]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    long = length > STEEP * np.median(length)
    if np.count_nonzero(long) > FEW:
        organ.note(f"{np.count_nonzero(long)} edges are over {STEEP:g} times as long as usual, up to {length.max():.0f} mm, around {placed(ends[long].mean(axis=(0, 1)))}: "
                   f"was part of the surface displaced? It is used unchanged, {organ.volume * 1e-3:.1f} ml")


def mend_crossings(organ):
    """Replaces a surface that intersects itself with the surface of everything that it encloses."""
    surface = organ.shells[0]
    checked = shells.decimated(surface, MOST_CHECKED)
    places = [point for point, *_ in shells.crossings([checked])]
    if not places:
        return
    around = label_image.all_inside(surface)
    volume = sum(shell.volume() for shell in around)
    organ.note(f"its surface crosses itself at {len(places)} edges, first at {placed(places[0])}: replaced by the surface of everything that it encloses, {volume * 1e-3:.2f} ml "
               f"instead of {organ.volume * 1e-3:.2f} ml ({100 * (volume / organ.volume - 1):+.1f} %)")
    organ.shells, organ.volume, organ.read = around, volume, organ.volume


# ---- all regions together ----------------------------------------------------------------------------------------------------------

def check_sizes(organs, known):
    """Rejects regions whose unit of length is probably wrong, unless it is `known`. Judges by the largest region, because small ones next to it may be
    lesions."""
    for n, organ in enumerate(sorted(organs, key=lambda organ: -organ.volume)):
        size = np.ptp(organ.points, axis=0)
        measured = f"it measures {' x '.join(f'{side:.3g}' for side in size)} mm and has {organ.volume:.3g} mm^3"
        if not known and (size.max() > LARGE or n == 0 and organ.volume < SMALL):
            raise Unusable(organ.roi, f"{measured}: is the file's unit right? Give it with --unit")
        if organ.volume < LEAST:
            raise Unusable(organ.roi, f"{measured}: too small to be meshed: leave it out")
        if organ.volume < SMALL:
            organ.note(f"{measured}: few of the mesh's elements are in it")
        elif n == 0 and size.max() < SHORT and not known:
            organ.note(f"{measured}: is the file's unit right? Give it with --unit")


def merged(organs, most):
    """Merges organs with the same material until at most `most` soft ones are left, if possible, starting with the largest group. Never merges the first
    organ. Returns the remaining organs."""
    organs = list(organs)
    while sum(not organ.bone for organ in organs) > most:
        groups = {}
        for organ in organs[1:]:
            if not organ.bone:
                groups.setdefault(materials.row_of(organ.roi, organ.kind), []).append(organ)
        row, group = max(groups.items(), key=lambda item: len(item[1]), default=(None, []))
        if len(group) < 2:
            break
        organs = [organ for organ in organs if not any(organ is each for each in group)] + [merged_one(row, group)]
    return organs


def merged_one(row, group):
    names = {organ.name for organ in group}
    one = Organ(row, next(name for name in (row.replace(" ", "_"), row.replace(" ", "_") + "_regions") if name not in RESERVED and name not in names or name in names),
                False, np.vstack([organ.points for organ in group]), shells=[shell for organ in group for shell in organ.shells],
                volumes=[volume for organ in group for volume in organ.volumes], volume=sum(organ.volume for organ in group),
                read=sum(organ.read for organ in group), kind=group[0].kind, layer=group[0].layer, notes=[note for organ in group for note in organ.notes])
    one.note(f"is one region of {', '.join(organ.roi for organ in group)}, which have the same material: a mesh has at most 32 groups")
    return one
