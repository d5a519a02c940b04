"""From what a user names to what is meshed."""
import dataclasses
import os
import re

import numpy as np

from . import contours, field, loft, meshing, shells
from .contours import Unusable

SKIN_DEPTH = 35.0       # mm from the skin to the gland
MARGIN = 25.0           # mm of tissue around the gland
BONE_MARGIN = 8.0       # mm around bones
EDGE = 5.0              # mm from the box's faces at which other regions are cut off
GAP = 0.5               # size of an element: regions keep this distance from each other
SLENDER = 1.5           # radii of a thin region: its triangles are not longer


@dataclasses.dataclass
class Organ:
    """One region as the user named it."""
    name: str
    bone: bool
    shape: field.Field = None    # DICOM mm
    stack: contours.Stack = None
    volume: float = 0.0          # mm^3
    notes: list = dataclasses.field(default_factory=list)


def region_name(text):
    return re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_") or "region"


def organ_of_rings(name, bone, rings):
    stack = contours.build_stack(name, rings)
    return Organ(region_name(name), bone, None, stack, stack.volume(), [f"{name}: {note}" for note in stack.notes])


def organ_of_surface(name, bone, surface):
    organ = Organ(region_name(name), bone, field.of_surface(surface))
    organ.volume = shells.from_vtk(surface).volume()
    if organ.volume < 100:
        raise Unusable(name, f"the surface encloses {organ.volume:.3g} mm^3: are its coordinates in mm? (--unit)")
    return organ


def smooth_surfaces(organ):
    """Loft where there is one, else through the field."""
    lofted = loft.of_stack(organ.stack) if organ.stack else None
    if lofted:
        return [lofted]
    if organ.shape is None:
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


def world(shell, gland):
    """Metres; x to the patient's right, y forward, z into the body from the skin; the gland's middle at x = y = 0."""
    middle = gland.centre()
    origin = np.array([middle[0], middle[1], gland.points[:, 2].min() - SKIN_DEPTH])
    return shells.Shell((shell.points - origin) * [-1e-3, -1e-3, 1e-3], shell.triangles)


def domain_of(organs, nodes, corridor):
    """The gland first. Returns the domain and region name -> volume of its outlines, m^3, of regions that were not cut."""
    surfaces = [smooth_surfaces(organ) for organ in organs]
    for organ, found in zip(organs, surfaces):
        if not found:
            raise Unusable(organ.name, "it is too thin to be resolved")
    gland = surfaces[0][0]
    low, high = box_around(gland, [s for organ, found in zip(organs, surfaces) if organ.bone for s in found])
    gap = GAP * meshing.first_size(high - low, nodes)
    bodies, before, outlined = [], [], {}
    for organ, found in zip(organs, surfaces):
        kept, cut = trimmed(organ, found, before, low, high, gap)
        before += kept
        if not kept:
            raise Unusable(organ.name, f"nothing is left of it {gap:.1f} mm from the other regions: raise --nodes, or leave it out")
        if cut:
            organ.notes.append(f"{organ.name}: cut off {EDGE:g} mm from the edge of the mesh and {gap:.1f} mm from other regions' surfaces")
        else:
            outlined[organ.name] = organ.volume * 1e-9
        share = 1 if cut else organ.volume / sum(shell.volume() for shell in kept)
        surface = "bone" if organ.bone else "capsule" if organ is organs[0] else organ.name + "_wall"
        for shell in kept:
            thin = SLENDER * 2 * shell.volume() / shell.area()
            bodies.append(meshing.Body(organ.name, surface, world(shell, gland), share * shell.volume() * 1e-9, thin * 1e-3, organ.bone))
    corners = world(shells.Shell(np.array([low, high]), None), gland).points
    middle = world(gland, gland)
    reach = float(np.ptp(middle.points, axis=0).max()) / 2
    domain = meshing.Domain(bodies, corners.min(axis=0), corners.max(axis=0), middle.centre(), reach, corridor)
    for body, parent in zip(bodies, domain.parents()):  # what lies inside is not part of it
        if parent is not None and bodies[parent].name in outlined:
            outlined[bodies[parent].name] -= body.volume
    return domain, outlined
