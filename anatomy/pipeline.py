"""From what a user names to what is meshed."""
import dataclasses
import re
import unicodedata

import numpy as np

from . import contours, field, loft, meshing, shells
from .contours import Unusable

SKIN_DEPTH = 35.0       # mm from the skin to the gland
MARGIN = 25.0           # mm of tissue around the gland
BONE_MARGIN = 8.0       # mm around bones
EDGE = 5.0              # mm from the box's faces at which other regions are cut off
GAP = 0.5               # size of an element: regions keep this distance from each other
RESERVED = ("surrounding", "skin", "fixed", "capsule", "bone")    # names that a mesh has anyway
LONGEST_NAME = 40       # characters; a mesh allows 63, with what is appended
SLENDER = 1.5           # radii of a thin region: its triangles are not longer


@dataclasses.dataclass
class Organ:
    """One region."""
    roi: str                     # as the user calls it
    name: str                    # as mesh and scene do
    bone: bool
    points: np.ndarray           # (n, 3) of the outlines or the surface, as they came; DICOM mm
    shape: field.Field = None    # DICOM mm
    stack: contours.Stack = None
    volume: float = 0.0          # mm^3
    notes: list = dataclasses.field(default_factory=list)

    def note(self, text):
        if f"{self.roi}: {text}" not in self.notes:
            self.notes.append(f"{self.roi}: {text}")


def region_names(rois):
    """ROI -> name in mesh and scene: small Latin letters, figures and underscores, numbered where it would be another one's."""
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
    return Organ(roi, name, bone, np.vstack([np.reshape(ring, (-1, 3)) for ring in rings]), None, stack, stack.volume(),
                 [f"{roi}: {note}" for note in stack.notes])


def organ_of_surface(roi, name, bone, surface):
    shell = shells.from_vtk(surface)
    if shell.volume() < 100:
        raise Unusable(roi, f"the surface encloses {shell.volume():.3g} mm^3: are its coordinates in mm? (--unit)")
    return Organ(roi, name, bone, shell.points, field.of_surface(surface), None, shell.volume())


def smooth_surfaces(organ):
    """Loft where there is one, else through the field."""
    if organ.shape is None:
        lofted = loft.of_stack(organ.stack)
        if lofted:
            return [lofted]
        organ.shape = field.of_stack(organ.stack)
    return organ.shape.surfaces()


def box_around(gland, others):
    """Low and high corner, DICOM mm. The skin is the low z."""
    low, high = gland.points.min(axis=0) - MARGIN, gland.points.max(axis=0) + MARGIN
    low[2] = gland.points[:, 2].min() - SKIN_DEPTH
    for bone in others:
        inner, outer = bone.points.min(axis=0) - BONE_MARGIN, bone.points.max(axis=0) + BONE_MARGIN
        low[:2] = np.minimum(low[:2], inner[:2])
        high = np.maximum(high, outer)
    return low, high


def trimmed(organ, surfaces, before, low, high, gap):
    """The organ's surfaces cut off at the box and kept away from those before it, and whether that changed anything."""
    inside = all(np.all(s.points > low + EDGE) and np.all(s.points < high - EDGE) for s in surfaces)
    near = [other for other in before if any(np.abs(shells.distances(other, s.points)).min() < gap for s in surfaces)]
    if inside and not near:
        return surfaces, False
    shape = organ.shape or field.of_stack(organ.stack)
    if not inside:
        shape = shape.inside_box(low + EDGE, high - EDGE)
    for other in near:
        shape = shape.apart_from(other, gap)
    return shape.surfaces(), True


def origin_under(gland):
    """DICOM mm: below the gland's middle, on the skin."""
    middle = gland.centre()
    return np.array([middle[0], middle[1], gland.points[:, 2].min() - SKIN_DEPTH])


def world(points, origin):
    """Metres; x to the patient's right, y forward, z into the body from the skin."""
    return (points - origin) * [-1e-3, -1e-3, 1e-3]


def domain_of(organs, nodes, corridor):
    """The gland first. Returns the domain and region name -> volume of its outlines, m^3, of regions that were not cut."""
    surfaces = [smooth_surfaces(organ) for organ in organs]
    for organ, found in zip(organs, surfaces):
        if not found:
            raise Unusable(organ.roi, "it is too thin to be resolved")
    gland = surfaces[0][0]
    low, high = box_around(gland, [s for organ, found in zip(organs, surfaces) if organ.bone for s in found])
    gap = GAP * meshing.first_size(high - low, nodes)
    origin = origin_under(gland)
    bodies, before, outlined = [], [], {}
    for organ, found in zip(organs, surfaces):
        kept, cut = trimmed(organ, found, before, low, high, gap)
        before += kept
        if not kept:
            raise Unusable(organ.roi, f"nothing is left of it {gap:.1f} mm from the other regions: raise --nodes, or leave it out")
        if cut:
            organ.note(f"cut off {EDGE:g} mm from the edge of the mesh and {gap:.1f} mm from other regions' surfaces")
        else:
            outlined[organ.name] = organ.volume * 1e-9
        share = 1 if cut else organ.volume / sum(shell.volume() for shell in kept)
        surface = "bone" if organ.bone else "capsule" if organ is organs[0] else organ.name + "_wall"
        for shell in kept:
            thin = SLENDER * 2 * shell.volume() / shell.area()
            placed = shells.Shell(world(shell.points, origin), shell.triangles)
            bodies.append(meshing.Body(organ.name, surface, placed, share * shell.volume() * 1e-9, thin * 1e-3, organ.bone))
    corners = world(np.array([low, high]), origin)
    reach = float(np.ptp(gland.points, axis=0).max()) / 2 * 1e-3
    domain = meshing.Domain(bodies, corners.min(axis=0), corners.max(axis=0), world(gland.centre(), origin), reach, origin, corridor)
    for body, parent in zip(bodies, domain.parents()):  # what lies inside is not part of it
        if parent is not None and bodies[parent].name in outlined:
            outlined[bodies[parent].name] -= body.volume
    return domain, outlined


def mesh_of(organs, nodes, corridor, path):
    """Writes the mesh; returns it, its domain and the outlines' volumes. A loft that cannot be meshed gives way to a field."""
    while True:
        domain, outlined = domain_of(organs, nodes, corridor)
        try:
            return meshing.generate(domain, nodes, path), domain, outlined
        except meshing.Failure as failure:
            give_way([organ for organ in organs if organ.name in failure.names], failure, domain.origin)


def give_way(organs, failure, origin):
    """Fields from now on for those of the organs that were lofted."""
    where = ""
    if failure.z is not None:
        z = origin[2] + 1e3 * failure.z
        heights = [s.z for organ in organs if organ.stack for s in organ.stack.slices] or [z]
        where = f" at z = {min(heights, key=lambda height: abs(height - z)):g} mm"
    lofted = [organ for organ in organs if organ.shape is None]
    if not lofted:
        raise Unusable('" and "'.join(organ.roi for organ in organs), f"{failure}{where}: try another --nodes, or fewer regions")
    for organ in lofted:
        organ.shape = field.of_stack(organ.stack)
        organ.note(f"as a loft, {failure}{where}: interpolated between slices instead")


def distances_to_outlines(organs, domain, mesh, outlined):
    """Region name -> distances (mm) of the points that came from its surface in the mesh, if it was not cut."""
    surface = {body.name: mesh.surfaces[body.surface] for body in domain.bodies}
    return {organ.name: 1e3 * np.abs(shells.distances(surface[organ.name], world(organ.points, domain.origin)))
            for organ in organs if organ.name in outlined}
