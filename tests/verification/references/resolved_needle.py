#!/usr/bin/python3
"""Computes the forces on a rigid needle whose surface is resolved by the mesh: the reference for the mesh-independence checks.

A needle of radius r, bonded to a block of tissue, is represented by a cylindrical hole with a flat end, all nodes of which are moved by 1 mm, sideways or along
the axis, without rotation. The reactions are the required forces. The discs, which are end faces moved on their own, calibrate the compliance under a cutting
force. No code of trocar is used: meshes are created by Gmsh and numpy and solved by CalculiX with quadratic tetrahedra (C3D10). See README.md next to this
file.

The mesh is an extruded plane triangulation: polar rings around the needle's axis, refined towards its rim, are joined to Gmsh's triangles, which extend to the
block's sides. Its layers are thin at the needle's ends and long in between, which an unstructured mesh cannot achieve. For an oblique needle, this mesh is
deformed. Lengths are in m, forces in N, moduli in Pa.
"""
import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gmsh
import numpy as np

HALF_WIDTH, HEIGHT = 0.060, 0.100  # the block: |x|, |y| <= HALF_WIDTH; z = 0 is fixed, z = HEIGHT is the skin
RINGS_RADIUS = 0.006  # m, radius at which the polar rings end; less than the distance from any needle to a side of the block
SOFT, STIFF, CONTRAST = 20e3, 60e3, 1000.0
MOVE = 1e-3
BALANCE = 1e-4  # largest permitted imbalance of the reactions, relative to their magnitude; CalculiX prints seven digits

# `rim`: size of the first element at the needle's rim, in radii. `slope`: growth of the element size with distance from the rim; `far_slope`: growth with
# distance from the rings. `sectors`: elements around the needle. `largest`: element size far from the needle. Discs have a finer rim: where the bonded end
# meets the free wall of the hole (a clamped-free corner of 270 degrees, Williams 1952), displacements vary with the power 0.28 of the distance at nu = 0.45, so
# the error in the forces varies as rim^0.56.
MESHES = {
    "coarse": {"needle": {"rim": 0.24, "slope": 1.0, "far_slope": 0.5, "sectors": 8, "largest": 0.018},
               "disc": {"rim": 0.006, "slope": 0.7, "far_slope": 0.6, "sectors": 8, "largest": 0.025}},
    "standard": {"needle": {"rim": 0.16, "slope": 0.75, "far_slope": 0.375, "sectors": 10, "largest": 0.015},
                 "disc": {"rim": 0.003, "slope": 0.6, "far_slope": 0.6, "sectors": 8, "largest": 0.025}},
    "fine": {"needle": {"rim": 0.08, "slope": 0.55, "far_slope": 0.275, "sectors": 12, "largest": 0.012},
             "disc": {"rim": 0.001, "slope": 0.5, "far_slope": 0.6, "sectors": 10, "largest": 0.025}},
}
# Lengths over which the mesh below an oblique needle's tip turns back to the vertical.
BEND, TILT = 0.008, 0.020
ABOUT = (
    "Total force needed to move a rigid needle, or the disc at its end, by 1 mm in tissue that is bonded to it. "
    "Lengths in m, forces in N, moduli in Pa. Block |x|, |y| <= 0.06, 0 <= z <= 0.1; z = 0 is held, all else is free. "
    "'axis': x, y of the tip; the needle reaches from the skin (z = 0.1) down to z = 'tip'. 'angle': between needle and skin in "
    "degrees, going in along +x, or at 'azimuth' degrees from there toward +y; straight down where there is none. The modulus is "
    "'youngs_modulus_below' under z = 'interface'. 'skin': stiffness (N/m) and Poisson's ratio of a membrane on the skin, bonded to the needle. needle: the whole hole moves, without rotation: sideways (+x, "
    "or, of an oblique needle, at right angles to it in its vertical plane), across (of an oblique needle, horizontal), axial (outwards). "
    "disc: only the hole's end face moves, along -z without moving sideways, the rest of the hole is free of traction. "
    "'force' is along the motion, on the finest mesh solved; 'standard_above_fine' and 'coarse_above_standard' are "
    "relative differences of two meshes. Displacement elements are too stiff, so that the exact force lies below."
)


def case(tip, radius=0.635e-3, nu=0.45, axis=(0.0031, -0.0027), below=SOFT, above=SOFT, disc=False):
    """Returns a needle from the skin down to z = tip. `above` and `below` are the moduli above and below z = 50 mm. With `disc`, only the end face is moved."""
    return {"kind": "disc" if disc else "needle", "radius": radius, "poisson_ratio": nu, "axis": list(axis), "tip": tip,
            "youngs_modulus_above": above, "youngs_modulus_below": below, "interface": HEIGHT / 2}


def oblique(angle, azimuth=0, middle=(0.0, -0.0027), length=0.060):
    """Returns a needle of which `length` is inside the tissue, half of it on either side of x, y = middle."""
    across, down = 0.5 * length * math.cos(math.radians(angle)), length * math.sin(math.radians(angle))
    way = (math.cos(math.radians(azimuth)), math.sin(math.radians(azimuth)))
    return {**case(HEIGHT - down, axis=(middle[0] + across * way[0], middle[1] + across * way[1])), "angle": angle, "azimuth": azimuth}


def directions(one):
    """Returns unit vectors: along the needle into the tissue; perpendicular to the needle in the plane that contains z; and horizontal."""
    if "angle" not in one:
        return np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    angle, azimuth = math.radians(one["angle"]), math.radians(one["azimuth"])
    forward, side = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return math.cos(angle) * forward - math.sin(angle) * up, math.sin(angle) * forward + math.cos(angle) * up, side


def loads(one):
    """Returns the displacement of the moved nodes in each load case. A disc is pressed in the direction of insertion."""
    inwards, sideways, across = directions(one)
    if one["kind"] == "disc":
        return {"axial": MOVE * inwards}
    cases = {"sideways": MOVE * sideways, "axial": -MOVE * inwards}
    return {**cases, "across": MOVE * across} if "angle" in one else cases


def all_cases():
    """Returns the cases as a dict, by name."""
    radii = (0.35e-3, 0.635e-3, 0.9e-3)
    cases = {f"depth_r{1e3 * r:g}_nu{nu:g}": case(0.020, r, nu) for r in radii for nu in (0.3, 0.45, 0.49, 0.499)}
    cases["skin"] = case(0.080)
    cases["shallow"] = case(0.090)
    cases["side"] = case(0.020, axis=(0.050, -0.0027))
    cases["bottom"] = case(0.005)
    cases |= {f"membrane_{stiffness}": {**case(0.080), "skin": [stiffness, 0.45]} for stiffness in (30, 300)}
    cases["layers"] = case(0.020, below=STIFF)
    cases["stiff_ahead"] = case(0.055, below=CONTRAST * SOFT)
    cases["stiff_below"] = case(0.020, below=CONTRAST * SOFT)
    cases["stiff_above"] = case(0.020, above=CONTRAST * SOFT)
    cases |= {f"oblique_{angle}": oblique(angle) for angle in (60, 45, 30)}
    cases["body_diagonal"] = oblique(math.degrees(math.asin(3 ** -0.5)), 45, (0.0, 0.0))  # of a cube
    cases |= {f"tip_disc_r{1e3 * r:g}": case(0.020, r, disc=True) for r in radii}
    cases["skin_disc"] = case(HEIGHT, disc=True)
    return cases


CASES = all_cases()


def graded(low, high, fine_at, first, mesh):
    """Returns points from low to high whose spacing is `first` at the points `fine_at` and increases away from them."""
    near = np.geomspace(0.01 * first, high - low, 2001)
    s = np.concatenate([np.linspace(low, high, 2001), *(p + sign * near for p in fine_at for sign in (-1, 1))])
    s = np.unique(np.clip(s, low, high))
    distance = np.min([np.abs(s - p) for p in fine_at], axis=0)
    size = np.minimum(first + mesh["slope"] * distance, mesh["largest"])
    elements = np.concatenate([[0.0], np.cumsum(np.diff(s) / (0.5 * (size[1:] + size[:-1])))])
    count = max(1, round(elements[-1]))
    return np.interp(np.linspace(0.0, elements[-1], count + 1), elements, s)


# ---- the plane triangulation -----------------------------------------------------------------------------------------

def polar_rings(radius, first, mesh):
    """Returns the vertices (n x 2, relative to the axis) and triangles of the disc with RINGS_RADIUS. One of its rings lies exactly at the rim."""
    inside = graded(0.0, radius, [radius], first, mesh)[1:]
    outside = graded(radius, RINGS_RADIUS, [radius], first, mesh)[1:]
    rings, sectors = np.concatenate([inside, outside]), mesh["sectors"]
    angles = 2 * np.pi * np.arange(sectors) / sectors
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate([[[0.0, 0.0]], *(rho * circle for rho in rings)])
    here, after = np.arange(sectors), (np.arange(sectors) + 1) % sectors
    triangles = [np.stack([np.zeros(sectors, int), 1 + here, 1 + after], axis=1)]
    for ring in range(1, len(rings)):
        inner, outer = 1 + (ring - 1) * sectors, 1 + ring * sectors
        triangles.append(np.stack([inner + here, outer + here, outer + after], axis=1))
        triangles.append(np.stack([inner + here, outer + after, inner + after], axis=1))
    return vertices, np.concatenate(triangles)


def surroundings(axis, boundary, mesh):
    """Returns Gmsh's triangles between the polygon `boundary` (n x 2, relative to the axis) and the sides of the block."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    geo, edge = gmsh.model.geo, np.linalg.norm(boundary[1] - boundary[0])
    corners = HALF_WIDTH * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) - axis
    loops = []
    for points in (corners, boundary):
        tags = [geo.addPoint(x, y, 0.0) for x, y in points]
        lines = [geo.addLine(a, b) for a, b in zip(tags, tags[1:] + tags[:1])]
        loops.append(geo.addCurveLoop(lines))
    for line in lines:  # the polygon's lines must not be split
        geo.mesh.setTransfiniteCurve(line, 2)
    geo.addPlaneSurface(loops)
    geo.synchronize()
    field = gmsh.model.mesh.field.add("MathEval")
    growth = f"{edge} + {mesh['far_slope']} * (sqrt(x*x + y*y) - {RINGS_RADIUS})"
    gmsh.model.mesh.field.setString(field, "F", growth)
    gmsh.model.mesh.field.setAsBackgroundMesh(field)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMax", mesh["largest"])
    gmsh.model.mesh.generate(2)
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    triangles = np.array(gmsh.model.mesh.getElementsByType(2)[1]).reshape(-1, 3)
    gmsh.finalize()
    row = np.zeros(int(max(tags)) + 1, int)
    row[tags.astype(int)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3)[:, :2], row[triangles.astype(int)]


def plane_triangulation(axis, radius, first, mesh):
    """Returns the vertices, relative to the axis, and the triangles of the block's whole cross-section, which conform at the outermost ring."""
    vertices, triangles = polar_rings(radius, first, mesh)
    ring = np.arange(len(vertices) - mesh["sectors"], len(vertices))
    outer_vertices, outer_triangles = surroundings(np.array(axis), vertices[ring], mesh)
    distance = np.linalg.norm(outer_vertices[:, None] - vertices[None, ring], axis=2)
    shared = distance.min(axis=1) < 1e-9
    if shared.sum() != len(ring):
        sys.exit("resolved_needle: Gmsh divided the outermost ring; the two parts of the mesh don't fit")
    number = np.where(shared, ring[distance.argmin(axis=1)], len(vertices) + np.cumsum(~shared) - 1)
    return np.concatenate([vertices, outer_vertices[~shared]]), np.concatenate([triangles, number[outer_triangles]])


def midpoints(a, b):
    """Returns the midpoints of the edges from a to b (n x 2). Within the rings they lie on the arc, so that the needle is round."""
    middle, radius_a, radius_b = 0.5 * (a + b), np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1)
    within = (np.maximum(radius_a, radius_b) < RINGS_RADIUS * (1 - 1e-9)) & (np.minimum(radius_a, radius_b) > 1e-9)
    mean = 0.5 * (radius_a + radius_b)[within]
    middle[within] *= (mean / np.linalg.norm(middle[within], axis=1))[:, None]
    return middle


# ---- extrusion to quadratic tetrahedra -------------------------------------------------------------------------------

def layers(one, first, mesh):
    """Returns the heights of the faces between layers, with thin layers at the tip, at the skin and where the material changes."""
    stops, fine_at = [0.0, one["tip"], HEIGHT], [one["tip"]]
    if one["kind"] == "needle":
        fine_at.append(HEIGHT)
    if one["youngs_modulus_below"] != one["youngs_modulus_above"]:
        stops.append(one["interface"])
        fine_at.append(one["interface"])
    stops = sorted(set(stops))
    parts = [graded(low, high, fine_at, first, mesh) for low, high in zip(stops, stops[1:])]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


class Edges:
    """Numbers the edges of a triangulation. Vertices keep their numbers, and edges follow."""

    def __init__(self, vertices, triangles):
        pairs = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [0, 2]]]), axis=1)
        self.stride = len(vertices)
        self.pairs = np.unique(pairs, axis=0)
        self.keys = self.pairs[:, 0] * self.stride + self.pairs[:, 1]

    def middle(self, a, b):
        """Returns the plane node half-way between the vertices a and b, which may be the same."""
        edge = self.stride + np.searchsorted(self.keys, np.minimum(a, b) * self.stride + np.maximum(a, b))
        return np.where(a == b, a, edge)


def extrude(vertices, triangles, heights):
    """Extrudes each triangle through each layer and cuts the prism into three C3D10 tetrahedra.

    Returns nodes (n x 3) and elements ((layers x 3 x triangles) x 10). A node is a plane node (vertex or midpoint of an edge) at a level (face or middle of a
    layer): number = level * plane nodes + plane node. The corners of a prism are taken in ascending order, so that neighbours divide their common face along
    the same diagonal.
    """
    edges = Edges(vertices, triangles)
    plane = np.concatenate([vertices, midpoints(vertices[edges.pairs[:, 0]], vertices[edges.pairs[:, 1]])])
    levels = np.interp(np.arange(2 * len(heights) - 1) / 2, np.arange(len(heights)), heights)
    nodes = np.concatenate([np.tile(plane, (len(levels), 1)), np.repeat(levels, len(plane))[:, None]], axis=1)

    corner = np.sort(triangles, axis=1)
    prism_splits = (((0, 0), (1, 0), (2, 0), (2, 2)), ((0, 0), (1, 0), (1, 2), (2, 2)), ((0, 0), (0, 2), (1, 2), (2, 2)))
    pairs = ((0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # node order of a C3D10
    tets = []
    for split in prism_splits:
        ends = [(corner[:, vertex], level) for vertex, level in split]
        tets.append(np.stack([(ends[i][1] + ends[j][1]) // 2 * len(plane) + edges.middle(ends[i][0], ends[j][0])
                              for i, j in pairs], axis=1))
    first_layer = right_handed(nodes, np.stack(tets, axis=1).reshape(-1, 10))
    rise = 2 * len(plane) * np.arange(len(heights) - 1)
    return nodes, first_layer[None] + rise[:, None, None]


def right_handed(nodes, tets):
    """Returns the same elements, with mirrored ones renumbered so that every volume is positive."""
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    mirrored = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[mirrored] = tets[mirrored][:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    return tets


# ---- oblique needles -------------------------------------------------------------------------------------------------

def oblique_axis(one, z):
    """For the height z of the undeformed mesh, returns how far forward of the tip the deformed mesh's axis lies, and the vector (forward, up) into which a unit
    forward vector is turned there.

    Each face of a layer remains plane. It is perpendicular to the needle at the tip, so that the end is flat, and horizontal at the skin and at the bottom.
    Because points move along the needle, the hole remains a circular cylinder."""
    angle, height = math.radians(one["angle"]), one["tip"]
    slope, within, below = 1.0 / math.tan(angle), z >= height, np.clip(z / height, 0.0, 1.0)
    centre = np.where(within, -slope * (z - height), slope * BEND * (1 - below ** (height / BEND)))
    up, tilt = np.where(within, (z - height) / (HEIGHT - height), 0.0), below ** (height / TILT)
    forward = np.where(within, math.sin(angle) + up * slope * math.cos(angle), 1 - tilt * (1 - math.sin(angle)))
    return centre, forward, np.where(within, (1 - up) * math.cos(angle), tilt * math.cos(angle))


def middle_of(one):
    """Returns x and y of the point half-way between skin and tip."""
    back = 0.5 * (HEIGHT - one["tip"]) / math.tan(math.radians(one["angle"]))
    return np.array(one["axis"]) - back * directions(one)[0][:2] / math.cos(math.radians(one["angle"]))


EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))  # edges of a C3D10, in the order of its nodes 4 to 9


def straighten(nodes, elements, far):
    """Moves the mid-side node of each edge that has an end in `far` to the midpoint between the ends."""
    for i, edge in enumerate(EDGES, 4):
        ends, middle = elements[:, edge], elements[:, i]
        chosen = far[ends].any(axis=1)
        nodes[middle[chosen]] = nodes[ends[chosen]].mean(axis=1)


def least_jacobian(nodes, elements):
    """Returns each element's smallest Jacobian determinant over its integration points."""
    inner, outer = (5 + 3 * 5 ** 0.5) / 20, (5 - 5 ** 0.5) / 20
    gradients = np.concatenate([-np.ones((1, 3)), np.eye(3)])  # gradients of the barycentric coordinates
    least = np.full(len(elements), np.inf)
    for point in outer + (inner - outer) * np.eye(4):
        shape = np.concatenate([(4 * point[:, None] - 1) * gradients, [4 * (point[a] * gradients[b] + point[b] * gradients[a]) for a, b in EDGES]])
        least = np.minimum(least, np.linalg.det(np.einsum("enx,nk->exk", nodes[elements], shape)))
    return least


def deform(one, nodes, elements):
    """Returns the nodes of a straight needle's mesh, with x and y relative to its axis, moved so that the needle is oblique. The rings move with the needle,
    the block's sides do not. Elements outside the rings keep straight edges, as do those that would otherwise fold."""
    middle, side = middle_of(one), directions(one)[2]
    forward = np.array([side[1], -side[0]])
    x, y, z = nodes.T
    share = np.max([sign * nodes[:, i] / (HALF_WIDTH - sign * middle[i]) for i in (0, 1) for sign in (-1, 1)], axis=0)
    weight = np.clip((1 - share) / (1 - RINGS_RADIUS / (HALF_WIDTH - np.abs(middle).max())), 0.0, 1.0)
    centre, ahead, up = oblique_axis(one, z)
    turned = weight ** 3 * (nodes[:, :2] @ forward)  # the rotation decays faster than the shift, so that elements do not fold
    shift = weight * (centre + (one["axis"] - middle) @ forward) + turned * (ahead - 1)
    moved = np.column_stack([nodes[:, :2] + middle + shift[:, None] * forward, z + turned * up])
    distance = np.hypot(x, y)
    straighten(moved, elements, distance > RINGS_RADIUS * (1 + 1e-9))
    folded = least_jacobian(moved, elements) <= 0.0
    straighten(moved, elements[folded], distance > one["radius"] * (1 + 1e-9))
    if least_jacobian(moved, elements).min() <= 0.0:
        sys.exit("resolved_needle: the deformed mesh has folded elements")
    return moved


# ---- the block with its needle ---------------------------------------------------------------------------------------

def block_with_needle(one, mesh):
    """Returns nodes (n x 3), elements (m x 10), the heights of their layers (m), and the fixed and moved nodes."""
    first = mesh["rim"] * one["radius"]
    place = middle_of(one) if "angle" in one else one["axis"]
    vertices, triangles = plane_triangulation(place, one["radius"], first, mesh)
    heights = layers(one, -directions(one)[0][2] * first, mesh)
    nodes, elements = extrude(vertices, triangles, heights)

    within = np.linalg.norm(vertices, axis=1)[triangles].max(axis=1) < one["radius"] * (1 + 1e-6)
    middle = np.repeat(0.5 * (heights[1:] + heights[:-1])[:, None], 3 * len(triangles), axis=1)
    tissue = ~((middle > one["tip"]) & np.repeat(within, 3))
    elements, middle = elements[tissue], middle[tissue]

    used, elements = np.unique(elements, return_inverse=True)
    nodes, elements = nodes[used], elements.reshape(-1, 10)
    moved = (np.linalg.norm(nodes[:, :2], axis=1) < one["radius"] * (1 + 1e-6)) & (nodes[:, 2] > one["tip"] - 1e-9)
    if one["kind"] == "disc":
        moved &= nodes[:, 2] < one["tip"] + 1e-9
    fixed = np.flatnonzero(nodes[:, 2] < 1e-9)
    if "angle" in one:
        nodes = deform(one, nodes, elements)
    else:
        nodes[:, :2] += one["axis"]
    return nodes, elements, middle, fixed, np.flatnonzero(moved)


# ---- the problem for CalculiX ----------------------------------------------------------------------------------------

def numbered(table):
    """Formats the lines of a table, numbered from one. CalculiX reads at most 20 characters per number."""
    return "".join(f"{i}, {', '.join(f'{value:.12g}' for value in row)}\n" for i, row in enumerate(table.tolist(), 1))


def a_set(keyword, name, members):
    """Formats a set of nodes or elements. `members` are numbered from zero."""
    return f"*{keyword}, {keyword}={name}\n" + "".join(f"{i + 1}\n" for i in members)


def material(name, modulus, nu, elements):
    return (a_set("ELSET", name, elements) + f"*MATERIAL, NAME={name}\n*ELASTIC\n{modulus!r}, {nu!r}\n"
            f"*SOLID SECTION, ELSET={name}, MATERIAL={name}\n")


FACES_OF_C3D10 = ((0, 1, 2, 4, 5, 6), (0, 1, 3, 4, 8, 7), (1, 2, 3, 5, 9, 8), (0, 2, 3, 6, 9, 7))  # corners, then the nodes between them
THICKNESS = 1e-6  # m: CalculiX expands membranes to solids, which must be thin beside the elements at the needle's rim


def membrane(skin, nodes, elements):
    """Formats membrane elements on the skin, which are bonded to the needle as the tissue is. `skin`: stiffness (N/m) and Poisson's ratio."""
    faces = np.concatenate([elements[:, list(face)] for face in FACES_OF_C3D10])
    faces = faces[nodes[faces][..., 2].min(axis=1) > HEIGHT - 1e-9] + 1
    rows = "".join(f"{i}, {', '.join(map(str, row))}\n" for i, row in enumerate(faces.tolist(), len(elements) + 1))
    return (f"*ELEMENT, TYPE=M3D6, ELSET=SKIN\n{rows}*MATERIAL, NAME=SKIN\n*ELASTIC\n{skin[0] / THICKNESS!r}, {skin[1]!r}\n"
            f"*MEMBRANE SECTION, ELSET=SKIN, MATERIAL=SKIN\n{THICKNESS!r}\n")


def static_step(move):
    """Formats one load case. Its boundary conditions replace those of the previous step."""
    motion = "".join(f"MOVED, {axis}, {axis}, {distance!r}\n" for axis, distance in enumerate(move.tolist(), 1))
    return (f"*STEP\n*STATIC, SOLVER=SPOOLES\n*BOUNDARY, OP=NEW\nFIXED, 1, 3\n{motion}"
            "*NODE PRINT, NSET=MOVED, TOTALS=ONLY\nRF\n*NODE PRINT, NSET=FIXED, TOTALS=ONLY\nRF\n*END STEP\n")


def input_deck(one, nodes, elements, middle, fixed, moved):
    stiff = (middle < one["interface"]) & (one["youngs_modulus_below"] != one["youngs_modulus_above"])
    deck = "*NODE, NSET=ALL\n" + numbered(nodes) + "*ELEMENT, TYPE=C3D10\n" + numbered(elements + 1)
    deck += a_set("NSET", "FIXED", fixed) + a_set("NSET", "MOVED", moved)
    deck += material("ABOVE", one["youngs_modulus_above"], one["poisson_ratio"], np.flatnonzero(~stiff))
    if stiff.any():
        deck += material("BELOW", one["youngs_modulus_below"], one["poisson_ratio"], np.flatnonzero(stiff))
    if "skin" in one:
        deck += membrane(one["skin"], nodes, elements)
    return deck + "".join(static_step(move) for move in loads(one).values())


def reactions(text, names, skin):
    """Reads CalculiX's .dat file and returns, for each load case, the sums of the forces on the moved nodes and on the fixed face. With a membrane (`skin`),
    the first are set to minus the second, because CalculiX does not print the forces of the solids into which it expands membranes."""
    sums = re.findall(r"total force.*for set (\w+) and time.*\n\s*\n\s*(\S+)\s+(\S+)\s+(\S+)", text)
    if [name for name, *_ in sums] != ["MOVED", "FIXED"] * len(names):
        sys.exit("resolved_needle: CalculiX printed no reactions; keep its files with --keep and run it by hand")
    forces = np.array([xyz for _, *xyz in sums], float).reshape(-1, 2, 3)
    if skin:
        forces[:, 0] = -forces[:, 1]
    for needle, face in forces:
        if np.linalg.norm(needle + face) > BALANCE * np.linalg.norm(needle):
            sys.exit(f"resolved_needle: the reactions {needle} and {face} don't balance")
    return {name: {"needle_force": needle.tolist(), "fixed_face_force": face.tolist()}
            for name, (needle, face) in zip(names, forces)}


def solve(one, mesh, folder):
    """Returns the size of the mesh and the reactions for one case on one mesh. CalculiX works in `folder`."""
    nodes, elements, middle, fixed, moved = block_with_needle(one, mesh)
    (folder / "needle.inp").write_text(input_deck(one, nodes, elements, middle, fixed, moved))
    (folder / "needle.dat").unlink(missing_ok=True)
    ccx = subprocess.run(["nice", "ccx", "-i", "needle"], cwd=folder, capture_output=True, text=True,
                         env={**os.environ, "OMP_NUM_THREADS": "1"})
    if ccx.returncode or not (folder / "needle.dat").exists():
        sys.exit(f"resolved_needle: ccx failed:\n{ccx.stdout[-2000:]}{ccx.stderr}")
    return {"nodes": len(nodes), "elements": len(elements),
            **reactions((folder / "needle.dat").read_text(), list(loads(one)), "skin" in one)}


# ---- the table -------------------------------------------------------------------------------------------------------

def summarise(entry):
    """Adds the force along each motion on the finest mesh solved, and each mesh's deviation from the next finer one."""
    force = {mesh: {name: float(np.dot(entry["meshes"][mesh][name]["needle_force"], move)) / MOVE
                    for name, move in loads(entry).items()} for mesh in MESHES if mesh in entry["meshes"]}
    solved = list(force)  # from coarse to fine
    entry["force"] = force[solved[-1]]
    for mesh, finer in zip(solved, solved[1:]):
        entry[f"{mesh}_above_{finer}"] = {name: force[mesh][name] / value - 1 for name, value in force[finer].items()}


def solver_version():
    words = subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout.split()
    return f"CalculiX ccx {words[-1].rstrip('.')}, C3D10, SPOOLES"


def write(path, solved):
    """Writes the table in the order of the cases, with each vector on one line."""
    table = {"about": ABOUT, "solver": solver_version(), "mesh_settings": MESHES,
             "cases": {name: solved[name] for name in CASES if name in solved}}
    text = re.sub(r"\[\s+([^][]*?)\s+\]", lambda m: "[" + re.sub(r"\s+", " ", m[1]) + "]", json.dumps(table, indent=1))
    path.write_text(text + "\n")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help="cases to solve (default: all)")
    parser.add_argument("--mesh", choices=MESHES, default="standard", help="mesh to use (default: %(default)s)")
    parser.add_argument("--output", type=Path, default=Path(__file__).with_suffix(".json"),
                        help="table to add the results to (default: the one next to this script)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep CalculiX's files of the last run in DIR")
    parser.add_argument("--version", action="version", version="resolved_needle 1")
    chosen = parser.parse_args()
    unknown = set(chosen.cases) - set(CASES)
    if unknown:
        parser.error(f"no case named {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
    return chosen


def main():
    chosen = arguments()
    table = json.loads(chosen.output.read_text()) if chosen.output.exists() else {"cases": {}}
    solved = table["cases"]
    for name in chosen.cases or CASES:
        start = time.monotonic()
        entry = solved[name] = {**CASES[name], "meshes": solved.get(name, {}).get("meshes", {})}
        with tempfile.TemporaryDirectory() as scratch:
            folder = chosen.keep or Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            result = entry["meshes"][chosen.mesh] = solve(entry, MESHES[chosen.mesh][entry["kind"]], folder)
        summarise(entry)
        write(chosen.output, solved)
        force = ", ".join(f"{load} {value:.5f} N" for load, value in entry["force"].items())
        print(f"{name}: {result['nodes']} nodes, {time.monotonic() - start:.0f} s; best {force}", flush=True)


if __name__ == "__main__":
    main()
