"""Turns the regions that the user named into a domain to mesh."""
import dataclasses
import itertools
import os

import numpy as np

from . import approach, limits, losses, materials, meshing
from .shapes import field, loft, shells
from .shapes.contours import Unusable
from .organ import Organ, in_ml

SKIN_DEPTH = 35.0       # mm, distance from the skin to the gland
MARGIN = 25.0           # mm, thickness of the tissue around the gland
OTHERS_MARGIN = 8.0     # mm, thickness of the tissue around bones and other regions
EDGE = 5.0              # mm, distance from the faces of the box at which --crop cuts off regions
GAP = 0.5               # gap to keep between regions that do not touch, as a fraction of the element size
TOUCH = 1.0             # mm: regions closer to each other than this share a surface
LOSS = 0.03             # regions also share a surface if keeping the gap would cost one of them more than this fraction of its volume
FEET = 2, -1            # axis and side of the face of a box that points toward the feet
FACES = FEET, (1, -1), (0, -1), (0, 1), (2, 1), (1, 1)      # faces to try as the skin, in this order, until one has no bone in the needle's path
SLENDER = 1.5           # maximum edge length of triangles on a thin region, as a multiple of its radius


@dataclasses.dataclass
class Plan:
    """What the user asked for, apart from the regions. Lengths are in mm, positions in DICOM coordinates."""
    margin: float = MARGIN
    entry: np.ndarray = None     # point where the needle should go through the skin
    target: np.ndarray = None    # point that the needle's tip should reach
    tube: float = None           # elements are smaller within this radius around the needle's path
    skin: Organ = None           # the body, whose surface is the skin; None for a box
    template: approach.Template = None      # template; the needle goes through one of its holes
    skip_small: bool = False     # true to leave out regions that are too small or too thin for the mesh


def outlines_touch(organ, other):
    """Whether the contours of two organs come closer than TOUCH on any slice."""
    reach = (organ.stack.spacing + other.stack.spacing) / 4
    return any(abs(a.z - b.z) < reach and a.outline.boundary.distance(b.outline.boundary) < TOUCH
               for a in organ.stack.slices for b in other.stack.slices)


def smooth_surfaces(organ):
    """Returns smooth surfaces of the organ: those it has already, else a loft if possible, else the zero level set of its signed distance field."""
    if organ.shells:
        return organ.shells
    if organ.shape is None and not organ.share:    # a label image does not need a loft
        organ.loft = organ.loft or loft.of_stack(organ.stack)
        if organ.loft:
            return [organ.loft]
    if organ.shape is None:
        organ.shape = field.of_stack(organ.stack)
    return organ.shape.surfaces()


def skin_surfaces(organ):
    """Returns the surfaces of the body, without cavities."""
    return shells.outermost(smooth_surfaces(organ))


def box_around(gland, bones, others, margin=MARGIN, face=FEET):
    """Returns the low and high corners of the box, DICOM mm. gland, bones, others: lists of shells; margin: thickness of the tissue around the gland; face:
    axis and side (-1 low, 1 high) of the skin."""
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


def path_and_block(surfaces, bones, others, plan, spared=()):
    """Returns the needle's path, the corners of the block of tissue, and the face of the block that is the skin, all in DICOM mm. surfaces: the gland's;
    spared: those of regions that the needle should avoid if possible."""
    target = approach.middle_of(surfaces, spared) if plan.target is None else plan.target
    spared = [shell for shell in spared if shells.distances(shell, target[None])[0] > 0]
    entry = plan.entry
    if plan.template:
        entry, target = approach.through_template(plan.template, target, bones)
    if plan.skin:
        if plan.template:
            entry = approach.on_skin(plan.skin.shells, entry, target)
        path = approach.through_skin(target, plan.skin.shells, bones, spared, plan.skin.cut) if entry is None else approach.Path(entry, target)
        points = np.vstack([shell.points for shell in [*surfaces, *bones, *others]])
        ends = np.array([path.entry, target])
        return path, np.minimum(points.min(axis=0), ends.min(axis=0)) - plan.margin, np.maximum(points.max(axis=0), ends.max(axis=0)) + plan.margin, FEET
    if entry is None:
        return path_through_box(target, plan.margin, (surfaces, bones, others), spared)
    return path_through_face(entry, target, plan.margin, (surfaces, bones, others))


def path_through_box(target, margin, found, spared):
    """Returns the needle's path, the corners of the box, and its skin face, which is the first one in FACES with no bones, and preferably no spared regions,
    in the needle's way. found: the tuple (surfaces, bones, others)."""
    second = None
    for face in FACES:
        low, high = box_around(*found, margin, face)
        path = approach.through_face(target, low, high, found[1], face, spared)
        if path and not path[1]:
            return path[0], low, high, face
        second = second or path and (path[0], low, high, face)
    low, high = box_around(*found, margin)
    return second or (approach.Path(np.append(target[:2], low[2]), target), low, high, FEET)      # bone is in the way, as the report will say


def path_through_face(entry, target, margin, found):
    """Returns the needle's path, the corners of the box, and its skin face, which contains `entry` and is as nearly perpendicular to the path as possible.
    found: the tuple (surfaces, bones, others)."""
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
    return approach.Path(entry, target), low, high, (axis, side)


def kept_apart(organ, surfaces, before, gap):
    """Trims an organ's surfaces to keep the distance `gap` from those of earlier organs. Returns None if the surfaces touch or too much of the organ would be
    lost."""
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
    """Returns the origin of the mesh frame, DICOM mm: the point on the skin face of the box in front of the gland's centre."""
    points = np.vstack([shell.points for shell in gland])
    origin, (axis, side) = (points.min(axis=0) + points.max(axis=0)) / 2, face
    origin[axis] = (low if side < 0 else high)[axis]
    return origin


def world(points, origin):
    """Converts DICOM mm to metres in the mesh frame, where x points to the patient's right, y forward and z to the head."""
    return (points - origin) * [-1e-3, -1e-3, 1e-3]


def patient(points, origin):
    """Converts points from the mesh frame to DICOM mm."""
    return points * [-1e3, -1e3, 1e3] + origin


def surface_name(organ, organs):
    """Returns the name of an organ's surface: "bone" for bones, "capsule" if the first region is a prostate, otherwise NAME_wall."""
    return "bone" if organ.bone else "capsule" if organ is organs[0] and materials.known(organ.roi, organ.kind) == "prostate" else organ.name + "_wall"


def patient_to_mesh(origin):
    """Returns the transform (4, 4) from DICOM mm to metres in the mesh frame."""
    matrix = np.diag([-1e-3, -1e-3, 1e-3, 1.0])
    matrix[:3, 3] = world(np.zeros(3), origin)
    return matrix


TRANSFORM = "patient_to_mesh"    # in the comments of a mesh, this keyword precedes the sixteen numbers of the transform


def write_transform(path, matrix):
    """Appends a transform (4, 4) to a mesh file in a $Comments section, which Gmsh ignores."""
    with open(path, "a", encoding="ascii") as file:
        file.write(f"$Comments\nfrom DICOM's patient coordinates, mm, to those of this mesh, m, row by row:\n{TRANSFORM}\n")
        file.write("".join(" ".join(f"{value + 0.0:.9g}" for value in row) + "\n" for row in matrix) + "$EndComments\n")


def domain_of(organs, nodes, corridor, crop=False, plan=None):
    """Returns the domain, gland first, and a dict of region name -> volume that the region must have in the mesh, m^3. crop: make the box just large enough
    for the gland and the bones, not for all regions."""
    plan = plan or Plan()
    if any(a.stack and b.stack and outlines_touch(a, b) for a, b in itertools.combinations(organs, 2)):
        for organ in organs:
            organ.share = True
    surfaces = [smooth_surfaces(organ) for organ in organs]
    for organ, found in zip(organs, surfaces):
        if not found:
            raise Unusable(organ.roi, "it is too thin to be resolved")
    bones, others = ([s for organ, found in zip(organs[1:], surfaces[1:]) if organ.bone == bone for s in found] for bone in (True, False))
    spared = [s for organ, found in zip(organs[1:], surfaces[1:]) if not organ.bone and materials.is_spared(organ.roi, organ.kind) for s in found]
    path, low, high, face = path_and_block(surfaces[0], bones, [] if crop else others, plan, spared)
    organs[0].notes += [f"needle: {note}" for note in path.notes if f"needle: {note}" not in organs[0].notes]
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
        domain.regions = [meshing.Region(organ.name, surface_name(organ, organs), [placed(s) for s in found], [v * 1e-9 for v in organ.volumes_of(found)],
                                         organ.bone, organ.layer)
                          for organ, found in sorted(zip(organs, surfaces), key=lambda pair: priority(pair[0], organs[0]))]
        if plan.skin:
            domain.skin, domain.border = True, plan.skin.cut and plan.skin.cut.seen_from(origin)
            domain.regions.append(meshing.Region("surrounding", "skin", [placed(s) for s in plan.skin.shells], [None] * len(plan.skin.shells)))
        return domain, outlined
    for organ, kept in zip(organs, apart):
        share = organ.volume / sum(shell.volume() for shell in surfaces[organs.index(organ)])
        outlined[organ.name] = share * sum(shell.volume() for shell in kept) * 1e-9
        for shell in kept:
            thin = SLENDER * 2 * shell.volume() / shell.area()
            domain.bodies.append(meshing.Body(organ.name, surface_name(organ, organs), placed(shell), share * shell.volume() * 1e-9, thin * 1e-3, organ.bone))
    for body, parent in zip(domain.bodies, domain.parents()):  # a body's volume excludes the bodies that it encloses
        if parent is not None:
            outlined[domain.bodies[parent].name] -= body.volume
    return domain, outlined


def priority(organ, gland):
    """Sort key for priority in overlaps: smaller regions first, but with bones between the regions no larger than the gland and the rest."""
    if organ.bone:
        return 1, organ.volume
    return (0 if organ.volume <= gland.volume else 2), organ.volume


def apart_surfaces(organs, surfaces, gap):
    """Returns each organ's surfaces, kept apart from those of earlier organs, or None if the organs must share surfaces where they meet."""
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
    """Calls domain_of in a child process. Also returns the organs, because changes to them in the child do not reach the caller's objects."""
    return (organs, *domain_of(organs, *arguments))


def mesh_of(organs, nodes, corridor, path, crop=False, plan=None, quiet=()):
    """Writes the mesh. Returns it, its domain, the contours' volumes, and a losses.Row for each part. If a loft cannot be meshed, tries a distance field
    instead, and then surfaces from a label image. Organs that are left out are removed from the list `organs`. quiet: names of surfaces to leave without a
    group."""
    plan = plan or Plan()
    while True:
        made, domain, outlined = limits.run(f"surfaces of {limits.few(organ.roi for organ in organs)}", shaped, organs, nodes, corridor, crop, plan)
        for organ, finished in zip(organs, made):
            vars(organ).update(vars(finished))
        domain.quiet = quiet
        if not domain.skin:      # the needle's path begins on the skin face of the box, so its length can be checked before meshing
            approach.needle_for(*domain.path, domain.plate)
        try:
            meshing.prepare(domain, nodes)
            made = meshing.generate(domain, nodes, path)
        except meshing.Thin as failure:
            leave_out(organs, failure, nodes, plan.skip_small)
            continue
        except meshing.Failure as failure:
            give_way([organ for organ in organs if organ.name in failure.names], failure, domain)
            continue
        rows = losses.rows_of(domain, made)
        losses.note(organs, domain, rows, outlined, plan.skip_small)
        losses.note_missed(organs, domain, made)
        try:
            losses.check_volumes(organs, made.mesh, outlined)
            losses.check_bones(organs, distances_to_outlines(organs, domain, made.mesh, outlined))
        except Unusable:
            os.remove(path)
            raise
        write_transform(path, patient_to_mesh(domain.origin))
        return made.mesh, domain, outlined, rows


def leave_out(organs, failure, nodes, skip):
    """Removes regions that are too thin from the list if `skip` is set; otherwise raises an error that names them all."""
    thin = [organ for organ in organs if organ.name in failure.names]
    named = ", ".join(f"{organ.roi} ({in_ml(organ.volume)})" for organ in thin)
    if organs[0] in thin or not thin or not skip:
        more = f"to {failure.enough}" if failure.enough else f"above {nodes}"
        raise Unusable('" and "'.join(organ.roi for organ in thin), f"{failure}: raise --nodes {more}, or leave out what is too small, with --skip-small: {named}")
    organs[:] = [organ for organ in organs if organ not in thin]
    organs[0].note(f"beside it are left out, because {failure}: {named}")


def give_way(organs, failure, domain):
    """Falls back to more robust surfaces: from lofts to distance fields or, if there are no lofts, from fields to a label image for all organs."""
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
    """Returns region name -> distances (mm) from the input points to the region's surface in the mesh, for regions that lose less than MOST_LOSS to other
    regions and outside the box. Where a bone touches another bone or the end of the mesh, there is no tissue and so no surface; points there are left
    out."""
    found, whole = {}, mesh.boundary()
    for organ in organs:
        if outlined[organ.name] > (1 - losses.MOST_LOSS) * organ.volume * 1e-9:
            points = world(organ.points, domain.origin)
            off = 1e3 * np.abs(shells.distances(mesh.surfaces["bone"] if organ.bone else mesh.boundary(organ.name), points))
            far = np.flatnonzero(off > losses.MISSING) if organ.bone else []
            if len(far):
                off = np.delete(off, far[shells.distances(whole, points[far]) > 0])
            if len(off):
                found[organ.name] = off
    return found
