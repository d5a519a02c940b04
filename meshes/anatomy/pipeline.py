"""From the regions that a user names to the meshed domain."""
import dataclasses
import itertools
import os
import re
import unicodedata

import numpy as np

from . import approach, contours, field, labels, limits, loft, materials, meshing, shells
from .contours import Unusable

SKIN_DEPTH = 35.0       # mm from the skin to the gland
MARGIN = 25.0           # mm of tissue around the gland
OTHERS_MARGIN = 8.0     # mm around bones and other regions
EDGE = 5.0              # mm from the box's faces at which regions are cut off with --crop
GAP = 0.5               # of an element: regions that do not touch keep this distance from each other
TOUCH = 1.0             # mm: regions that come this close share a surface
LOSS = 0.03             # of a region's volume: if keeping the gap costs more, regions share a surface
MOST_LOSS = 0.10        # of a region's volume: meshes with a larger error are refused
TOLD = 0.01             # of a bone's surface: if more is missing, it is reported; more than MOST_LOSS is refused
MISSING = 5.0           # mm: a bone's point this far from the mesh's bone is missing
SHORT = 20.0            # mm: if the largest region is shorter, the unit may be another one,
SMALL = 100.0           # mm^3: and if that is smaller,
LARGE = 2000.0          # mm: or one is longer, it probably is
LEAST = 1.0             # mm^3: smaller regions are refused
STEEP = 5.0             # times the median edge: longer edges form a spike or a dent
FEW = 4                 # edges that may be longer
MOST_CHECKED = 40000    # triangles: larger surfaces are checked for crossings in a decimated copy
RESERVED = ("surrounding", "skin", "fixed", "capsule", "bone")    # names that every mesh uses
LONGEST_NAME = 40       # characters; a mesh allows 63, including suffixes
FEET = 2, -1            # axis and side of a box: its face toward the feet
FACES = FEET, (1, -1), (0, -1), (0, 1), (2, 1), (1, 1)      # in the order in which they are tried as the skin, on which no bone may be in the way
SLENDER = 1.5           # radii of a thin region: longest edge of its triangles


@dataclasses.dataclass
class Organ:
    """One region."""
    roi: str                     # the user's name
    name: str                    # name in mesh and scene
    bone: bool
    points: np.ndarray           # (n, 3) of the outlines or the surface as read; DICOM mm
    loft: shells.Shell = None    # DICOM mm
    shape: field.Field = None    # DICOM mm, if there is no loft
    shells: list = None          # closed surfaces, DICOM mm, from surface files
    stack: contours.Stack = None
    volume: float = 0.0          # mm^3
    notes: list = dataclasses.field(default_factory=list)
    share: bool = False          # its surfaces are made from a label image
    read: float = None           # mm^3, as the file has it, before anything was mended; None: as `volume`
    kind: str = ""               # what the file says it is, for its material

    def note(self, text):
        if f"{self.roi}: {text}" not in self.notes:
            self.notes.append(f"{self.roi}: {text}")


@dataclasses.dataclass
class Plan:
    """What the user wants beside the regions. DICOM mm."""
    margin: float = MARGIN
    entry: np.ndarray = None     # where the needle goes through the skin,
    target: np.ndarray = None    # and where to
    tube: float = None           # radius around the needle's path with smaller elements
    skin: Organ = None           # the body, whose surface is the skin; None: a box
    template: approach.Template = None      # the needle goes through one of its holes


def region_names(rois):
    """ROI -> name in mesh and scene: lower-case Latin letters, digits and underscores, numbered if already taken."""
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


def organ_of_rings(roi, name, bone, rings):
    stack = contours.build_stack(roi, rings)
    return Organ(roi, name, bone, np.vstack([np.reshape(ring, (-1, 3)) for ring in rings]), stack=stack, volume=stack.volume(),
                 notes=[f"{roi}: {note}" for note in stack.notes])


def organ_of_surface(roi, name, bone, surface, notes=()):
    """`notes`: repairs of it."""
    organ = Organ(roi, name, bone, surface.points, shells=[surface], volume=surface.volume(), notes=[f"{roi}: {note}" for note in notes])
    note_parts(organ)
    note_long_edges(organ)
    mend_crossings(organ)
    return organ


def organ_of_label(roi, name, bone, label, kind=""):
    """`label`: voxels.Outlined."""
    notes = [f"{roi}: {note}" for note in label.notes]
    if not label.shells:
        raise Unusable(roi, f"nothing is left of its {label.volume:.3g} mm^3 at the resolution of the other regions: leave it out")
    largest = max(shell.volume() for shell in label.shells)
    kept = [shell for shell in label.shells if shell.volume() > shells.SPLINTER * largest]
    organ = Organ(roi, name, bone, label.points, shells=kept, volume=label.volume, notes=notes, read=label.volume, kind=kind)
    dropped = sum(shell.volume() for shell in label.shells) - sum(shell.volume() for shell in kept)
    if len(label.shells) > 1:
        few = len(label.shells) - len(kept)
        organ.note(f"has {len(label.shells)} separate parts" + (f", of which {few} of less than {100 * shells.SPLINTER:g} % of the largest one's volume "
                   f"are left out, {-100 * dropped / label.volume:+.2f} %" if few else ""))
    organ.volume -= dropped
    return organ


def check_sizes(organs, unit=None):
    """Refuses regions in what is probably another unit, unless `unit` was given. The largest region tells: beside it, small ones may be lesions."""
    for n, organ in enumerate(sorted(organs, key=lambda organ: -organ.volume)):
        size = np.ptp(organ.points, axis=0)
        measured = f"it measures {' x '.join(f'{side:.3g}' for side in size)} mm and has {organ.volume:.3g} mm^3"
        if not unit and (size.max() > LARGE or n == 0 and organ.volume < SMALL):
            raise Unusable(organ.roi, f"{measured}: is the file's unit right? Give it with --unit")
        if organ.volume < LEAST:
            raise Unusable(organ.roi, f"{measured}: too small to be meshed: leave it out")
        if organ.volume < SMALL:
            organ.note(f"{measured}: few of the mesh's elements are in it")
        elif n == 0 and size.max() < SHORT and not unit:
            organ.note(f"{measured}: is the file's unit right? Give it with --unit")


def note_parts(organ):
    volumes = np.array([solid.volume() for solid in shells.solids(shells.all_parts(organ.shells[0]))])
    small = volumes < shells.SPLINTER * volumes.max()
    if len(volumes) > 1:
        organ.note(f"has {len(volumes)} separate parts" + (f", of which {np.count_nonzero(small)} of less than {100 * shells.SPLINTER:g} % of the "
                   f"largest one's volume may be left out ({100 * volumes[small].sum() / volumes.sum():.2f} % in all)" if small.any() else ""))


def note_long_edges(organ):
    surface = organ.shells[0]
    ends = surface.points[surface.edges()]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    long = length > STEEP * np.median(length)
    if np.count_nonzero(long) > FEW:
        place = ", ".join(f"{v:.0f}" for v in ends[long].mean(axis=(0, 1)))
        organ.note(f"{np.count_nonzero(long)} edges are over {STEEP:g} times as long as usual, up to {length.max():.0f} mm, around ({place}) mm: "
                   f"was part of the surface displaced? It is used unchanged, {organ.volume * 1e-3:.1f} ml")


def mend_crossings(organ):
    """Replaces a surface that crosses itself by the surface of everything that it encloses."""
    surface = organ.shells[0]
    checked = shells.decimated(surface, MOST_CHECKED)
    places = [point for point, *_ in shells.crossings([checked])]
    if not places:
        return
    around = labels.all_inside(surface)
    volume = sum(shell.volume() for shell in around)
    place = ", ".join(f"{v:.0f}" for v in places[0])
    organ.note(f"its surface crosses itself at {len(places)} edges, first at ({place}) mm: replaced by the surface of everything that it encloses, {volume * 1e-3:.2f} ml "
               f"instead of {organ.volume * 1e-3:.2f} ml ({100 * (volume / organ.volume - 1):+.1f} %)")
    organ.shells, organ.volume, organ.read = around, volume, organ.volume


def outlines_touch(organ, other):
    """Whether outlines of the two come closer than TOUCH to each other on a slice."""
    reach = (organ.stack.spacing + other.stack.spacing) / 4
    return any(abs(a.z - b.z) < reach and a.outline.boundary.distance(b.outline.boundary) < TOUCH
               for a in organ.stack.slices for b in other.stack.slices)


def smooth_surfaces(organ):
    """By a loft if possible, else by the field."""
    if organ.shells:
        return organ.shells
    if organ.shape is None and not organ.share:    # not needed for a label image
        organ.loft = organ.loft or loft.of_stack(organ.stack)
        if organ.loft:
            return [organ.loft]
    if organ.shape is None:
        organ.shape = field.of_stack(organ.stack)
    return organ.shape.surfaces()


def skin_surfaces(organ):
    """Of the body, without cavities."""
    return shells.outermost(smooth_surfaces(organ))


def box_around(gland, bones, others, margin=MARGIN, face=FEET):
    """Low and high corner, DICOM mm. `face`: axis and side (-1 low, 1 high) of the skin. Each: a list of shells. `margin`: around the gland."""
    def corners(found):
        points = np.vstack([shell.points for shell in found])
        return points.min(axis=0), points.max(axis=0)

    def beyond(usual, on_skin):
        low, high = np.full(3, usual), np.full(3, usual)
        (low if side < 0 else high)[axis] = on_skin
        return low, high
    axis, side = face
    inner, outer = corners(gland)
    below, above = beyond(margin, SKIN_DEPTH)
    low, high = inner - below, outer + above
    for found, at_skin in ((bones, EDGE), (others, OTHERS_MARGIN)):
        if found:
            inner, outer = corners(found)
            below, above = beyond(OTHERS_MARGIN, at_skin)
            low, high = np.minimum(low, inner - below), np.maximum(high, outer + above)
    return low, high


def path_and_block(surfaces, bones, others, plan):
    """The needle's path, the corners of the block of tissue, and the face of it that is the skin: all DICOM mm. surfaces: of the gland."""
    target = approach.middle_of(surfaces) if plan.target is None else plan.target
    entry = plan.entry
    if plan.template:
        entry, target = approach.through_template(plan.template, target, bones)
    if plan.skin:
        if plan.template:
            entry = approach.on_skin(plan.skin.shells, entry, target)
        path = approach.through_skin(target, plan.skin.shells, bones) if entry is None else approach.Path(entry, target, True)
        points = np.vstack([shell.points for shell in [*surfaces, *bones, *others]])
        ends = np.array([path.entry, target])
        return path, np.minimum(points.min(axis=0), ends.min(axis=0)) - plan.margin, np.maximum(points.max(axis=0), ends.max(axis=0)) + plan.margin, FEET
    if entry is None:
        return path_through_box(target, plan.margin, (surfaces, bones, others))
    return path_through_face(entry, target, plan.margin, (surfaces, bones, others))


def path_through_box(target, margin, found):
    """The box whose skin is the face toward the feet, or the first one without bones in the way. `found`: surfaces, bones and others."""
    for face in FACES:
        low, high = box_around(*found, margin, face)
        path = approach.through_face(target, low, high, found[1], face)
        if path:
            return path, low, high, face
    low, high = box_around(*found, margin)
    return approach.Path(np.append(target[:2], low[2]), target, False), low, high, FEET      # the report says that bone is in the way


def path_through_face(entry, target, margin, found):
    """The box whose skin is the face through `entry` that the needle meets most squarely. `found`: surfaces, bones and others."""
    way = target - entry
    axis = int(np.argmax(np.abs(way)))
    side = -int(np.sign(way[axis]))
    low, high = box_around(*found, margin, (axis, side))
    points = np.vstack([shell.points for shells_ in found for shell in shells_])[:, axis]
    skin = min(entry[axis], points.min() - EDGE) if side < 0 else max(entry[axis], points.max() + EDGE)
    (low if side < 0 else high)[axis] = skin
    entry = entry + (skin - entry[axis]) / way[axis] * way
    aside = np.arange(3) != axis
    low[aside], high[aside] = np.minimum(low, entry - OTHERS_MARGIN)[aside], np.maximum(high, entry + OTHERS_MARGIN)[aside]
    return approach.Path(entry, target, True), low, high, (axis, side)


def kept_apart(organ, surfaces, before, gap):
    """The organ's surfaces, kept away from earlier ones; None if these touch it, or if too much of it would be lost."""
    distances = [[shells.distances(other, s.points) for s in surfaces] for other in before]
    away = [min(np.abs(d).min() for d in each) for each in distances]
    if any(d < TOUCH for d in away):
        return None
    near = [other for other, d in zip(before, away) if d < gap]
    if not near:
        return surfaces
    shape = organ.shape or field.of_stack(organ.stack)
    for other in near:
        shape = shape.apart_from(other, gap)
    kept = shape.surfaces()
    held, left = (sum(shell.volume() for shell in found) for found in (surfaces, kept))
    if left < (1 - LOSS) * held:
        return None
    organ.note(f"kept {gap:.1f} mm from other regions' surfaces, which takes {100 * (1 - left / held):.1f} % of it")
    return kept


def origin_under(gland, low, high, face):
    """DICOM mm: on the skin, a face of the box, in front of the gland's middle."""
    points = np.vstack([shell.points for shell in gland])
    origin, (axis, side) = (points.min(axis=0) + points.max(axis=0)) / 2, face
    origin[axis] = (low if side < 0 else high)[axis]
    return origin


def world(points, origin):
    """Metres; x to the patient's right, y forward, z to the head."""
    return (points - origin) * [-1e-3, -1e-3, 1e-3]


def patient(points, origin):
    """DICOM mm, of points in the mesh's frame."""
    return points * [-1e3, -1e3, 1e3] + origin


def surface_name(organ, organs):
    """The first region's surface is a capsule if it is a prostate."""
    return "bone" if organ.bone else "capsule" if organ is organs[0] and materials.known(organ.roi, organ.kind) == "prostate" else organ.name + "_wall"


def patient_to_mesh(origin):
    """(4, 4), mm to m."""
    matrix = np.diag([-1e-3, -1e-3, 1e-3, 1.0])
    matrix[:3, 3] = world(np.zeros(3), origin)
    return matrix


TRANSFORM = "patient_to_mesh"    # in the comments of a mesh: sixteen numbers follow


def write_transform(path, matrix):
    """Appends a transform (4, 4) to a mesh, as comments, which Gmsh ignores."""
    with open(path, "a", encoding="ascii") as file:
        file.write(f"$Comments\nfrom DICOM's patient coordinates, mm, to those of this mesh, m, row by row:\n{TRANSFORM}\n")
        file.write("".join(" ".join(f"{value + 0.0:.9g}" for value in row) + "\n" for row in matrix) + "$EndComments\n")


def domain_of(organs, nodes, corridor, crop=False, plan=None):
    """The gland first. `crop`: the box holds the gland and the bones, not all regions. Returns the domain and region name -> volume of its
    outlines, m^3."""
    plan = plan or Plan()
    if any(a.stack and b.stack and outlines_touch(a, b) for a, b in itertools.combinations(organs, 2)):
        for organ in organs:
            organ.share = True
    surfaces = [smooth_surfaces(organ) for organ in organs]
    for organ, found in zip(organs, surfaces):
        if not found:
            raise Unusable(organ.roi, "it is too thin to be resolved")
    bones, others = ([s for organ, found in zip(organs[1:], surfaces[1:]) if organ.bone == bone for s in found] for bone in (True, False))
    path, low, high, face = path_and_block(surfaces[0], bones, [] if crop else others, plan)
    cut = crop and any(np.any(s.points < low + EDGE) or np.any(s.points > high - EDGE) for s in others)
    gap = GAP * meshing.first_size(high - low, nodes)
    origin = origin_under(surfaces[0], low, high, face) if not plan.skin else path.entry

    def placed(shell):
        return shells.Shell(world(shell.points, origin), shell.triangles)
    corners = world(np.array([low, high]), origin)
    points = np.vstack([shell.points for shell in surfaces[0]])
    reach = float(np.ptp(points, axis=0).max()) / 2 * 1e-3
    middle = world((points.min(axis=0) + points.max(axis=0)) / 2, origin)
    domain = meshing.Domain([], corners.min(axis=0), corners.max(axis=0), middle, reach, origin, corridor, gland=organs[0].name,
                            path=tuple(world(np.array([path.entry, path.target]), origin)), tube=plan.tube and plan.tube * 1e-3,
                            plate=world(plan.template.origin, origin) if plan.template else None,
                            front=meshing.face_name(face[0], face[1] * (-1 if face[0] < 2 else 1)))
    apart = not cut and not plan.skin and apart_surfaces(organs, surfaces, gap)
    outlined = {organ.name: organ.volume * 1e-9 for organ in organs}
    if not apart:
        edge = np.array([EDGE * 1e-3] * 3)
        domain.crop = (domain.low + edge, domain.high - edge) if cut else None
        domain.regions = [meshing.Region(organ.name, surface_name(organ, organs), [placed(s) for s in found], organ.volume * 1e-9, organ.bone)
                          for organ, found in sorted(zip(organs, surfaces), key=lambda pair: priority(pair[0], organs[0]))]
        if plan.skin:
            domain.skin = True
            domain.regions.append(meshing.Region("surrounding", "skin", [placed(s) for s in plan.skin.shells], None))
        return domain, outlined
    for organ, kept in zip(organs, apart):
        share = organ.volume / sum(shell.volume() for shell in surfaces[organs.index(organ)])
        outlined[organ.name] = share * sum(shell.volume() for shell in kept) * 1e-9
        for shell in kept:
            thin = SLENDER * 2 * shell.volume() / shell.area()
            domain.bodies.append(meshing.Body(organ.name, surface_name(organ, organs), placed(shell), share * shell.volume() * 1e-9, thin * 1e-3, organ.bone))
    for body, parent in zip(domain.bodies, domain.parents()):  # enclosed bodies are not part of it
        if parent is not None:
            outlined[domain.bodies[parent].name] -= body.volume
    return domain, outlined


def priority(organ, gland):
    """Order of priority in overlaps: smaller regions first; but bones come after regions not larger than the gland, and before others."""
    if organ.bone:
        return 1, organ.volume
    return (0 if organ.volume <= gland.volume else 2), organ.volume


def apart_surfaces(organs, surfaces, gap):
    """Surfaces of each organ, away from earlier ones; None if the organs must share surfaces where they meet."""
    if any(organ.share or organ.shells for organ in organs):
        return None
    before, apart = [], []
    for organ, found in zip(organs, surfaces):
        kept = kept_apart(organ, found, before, gap)
        if not kept:
            return None
        before += kept
        apart.append(kept)
    return apart


def shaped(organs, *arguments):
    """domain_of, and the organs with their surfaces, since it may run in another process."""
    return (organs, *domain_of(organs, *arguments))


def mesh_of(organs, nodes, corridor, path, crop=False, plan=None):
    """Writes the mesh; returns it, its domain and the outlines' volumes. A loft that cannot be meshed is replaced by a field, and that by
    surfaces from a label image."""
    while True:
        made, domain, outlined = limits.run(f"surfaces of {', '.join(organ.roi for organ in organs)}", shaped, organs, nodes, corridor, crop, plan)
        for organ, finished in zip(organs, made):
            vars(organ).update(vars(finished))
        if not domain.skin:      # of a box: the path begins on it
            approach.needle_for(*domain.path, domain.plate)
        try:
            made = meshing.generate(domain, nodes, path)
        except meshing.Failure as failure:
            give_way([organ for organ in organs if organ.name in failure.names], failure, domain)
            continue
        note_losses(organs, made.lost, outlined)
        note_missed(organs, made.missed)
        try:
            check_volumes(organs, made.mesh, outlined)
            check_bones(organs, distances_to_outlines(organs, domain, made.mesh, outlined))
        except Unusable:
            os.remove(path)
            raise
        write_transform(path, patient_to_mesh(domain.origin))
        return made.mesh, domain, outlined


def note_losses(organs, lost, outlined):
    called = {organ.name: organ for organ in organs}
    for (name, winner), share in lost.items():
        organ = called[name]
        outlined[name] -= share * organ.volume * 1e-9
        if winner is None:
            organ.note(f"{100 * share:.1f} % of it lie outside the mesh's box and are left out")
        elif share >= 5e-4:
            organ.note(f"{100 * share:.1f} % of it overlap {called[winner].roi} and are assigned to that")


def note_missed(organs, missed):
    for organ in organs:
        if missed.get(organ.name, 0) > meshing.MOST_MISSED:
            organ.note(f"{100 * missed[organ.name]:.0f} % of its surface is missing in the mesh, where it is too thin for this number of nodes: try more --nodes")


def check_volumes(organs, mesh, outlined):
    for organ in organs:
        if not organ.bone and abs(mesh.region_volume(organ.name) / outlined[organ.name] - 1) > MOST_LOSS:
            raise Unusable(organ.roi, f"the mesh holds {mesh.region_volume(organ.name) * 1e6:.2f} ml of {outlined[organ.name] * 1e6:.2f} ml "
                           f"({100 * (mesh.region_volume(organ.name) / outlined[organ.name] - 1):+.1f} %): raise --nodes, or leave it out")


def check_bones(organs, distances):
    """Bones are hollow in the mesh, so instead of their volume the missing share of their surface is checked."""
    for organ in organs:
        far = distances[organ.name] > MISSING if organ.bone and organ.name in distances else np.zeros(1, bool)
        text = (f"{100 * np.mean(far):.1f} % of its surface lie more than {MISSING:g} mm from the mesh's bone "
                f"(at most {distances[organ.name].max():.0f} mm)") if far.any() else ""
        if np.mean(far) > MOST_LOSS:
            raise Unusable(organ.roi, f"{text}: raise --nodes, or leave it out")
        if np.mean(far) > TOLD:
            organ.note(f"{text}: parts of it are missing; try more --nodes")


def give_way(organs, failure, domain):
    """Switches those of the organs that were lofted to fields; if there are none, all organs to surfaces from a label image."""
    where = ""
    if failure.z is not None:
        z = domain.origin[2] + 1e3 * failure.z
        heights = [s.z for organ in organs if organ.stack for s in organ.stack.slices] or [z]
        where = f" at z = {min(heights, key=lambda height: abs(height - z)):g} mm"
    lofted = [organ for organ in organs if organ.stack and organ.shape is None]
    if lofted:
        for organ in lofted:
            organ.shape = field.of_stack(organ.stack)
            organ.note(f"as a loft, {failure}{where}: interpolated between slices instead")
    elif not domain.regions:
        for organ in organs:
            organ.share = True
            organ.note(f"{failure}{where}: its surface is made from an image instead")
    else:
        raise Unusable('" and "'.join(organ.roi for organ in organs), f"{failure}{where}: try another --nodes, or fewer regions")


def distances_to_outlines(organs, domain, mesh, outlined):
    """Region name -> distances (mm) of the input points from its surface in the mesh, if nothing was cut off."""
    surface = {organ.name: mesh.surfaces["bone"] if organ.bone else mesh.boundary(organ.name) for organ in organs}
    return {organ.name: 1e3 * np.abs(shells.distances(surface[organ.name], world(organ.points, domain.origin)))
            for organ in organs if outlined[organ.name] > (1 - MOST_LOSS) * organ.volume * 1e-9}
