"""Gmsh: coarse surfaces of the organs, the box around them, tetrahedra between, and the search for the number of nodes."""
import collections
import dataclasses
import math
import os
import shutil
import tempfile

import gmsh
import numpy as np

from . import quality, session
from .contours import Unusable
from .loft import mesh_shell
from .shells import Shell, crossings, decimated, distances

GROWTH = 4.0            # size of the elements at the box's corners over that in the gland
CORRIDOR = 0.5          # and in the corridor
MOST_GROWTH = 1.09      # by which a coarse surface is blown up to hold its volume again
FINEST_SURFACE = 2500   # triangles that are enough for a surface to be remeshed
TRIES = 16
FAILURES = 3            # of Gmsh, after which nothing is expected of other sizes of element
JITTER = 0.025          # of the element's size, to come by other meshes of the same number of nodes
CLOSE = 0.04            # of the wanted number of nodes: among such meshes the one with the best angles is taken
OFF = 0.10              # of the wanted number of nodes: a mesh that is further off is none


class Failure(Exception):
    """Gmsh made no mesh. `names`: regions whose surfaces are the reason; `z`: m, where, or None."""

    def __init__(self, problem, names, z=None):
        super().__init__(problem)
        self.names, self.z = names, z


@dataclasses.dataclass
class Body:
    """One region, or a part of one."""
    name: str               # of the region
    surface: str            # name of its surface's group
    shell: object           # fine, m, world frame
    volume: float           # that its mesh is to have, m^3
    longest: float          # m: longer triangles would not follow its shape
    hollow: bool = False    # bone: no tetrahedra inside


@dataclasses.dataclass
class Domain:
    """What is meshed: bodies that do not touch, in a box with the skin in front (z = 0)."""
    bodies: list
    low: np.ndarray
    high: np.ndarray
    middle: np.ndarray       # of the gland
    reach: float             # m: half the gland's longest side
    origin: np.ndarray       # DICOM mm: where the mesh has its origin
    corridor: tuple = None   # x, y, radius, m

    def parents(self):
        """Index of the smallest body around each body, or None."""
        found = []
        for body in self.bodies:
            around = [i for i, other in enumerate(self.bodies) if other is not body and other.shell.volume() > body.shell.volume()
                      and np.median(distances(other.shell, body.shell.points[::50])) < 0]
            found.append(min(around, key=lambda i: self.bodies[i].shell.volume(), default=None))
        return found


def size_formula(domain, fine):
    """Elements of size `fine` in the gland, growing to GROWTH times it at the corners of the box, smaller in the corridor."""
    away = "Sqrt({})".format("+".join(f"({axis}-({c:.9g}))^2" for axis, c in zip("xyz", domain.middle)))
    span = math.dist(domain.middle, domain.low) - domain.reach
    growth = f"{fine:.9g}*(1+{GROWTH - 1:g}*Max(0,({away}-{domain.reach:.9g})/{span:.9g}))"
    if not domain.corridor:
        return growth
    x, y, radius = domain.corridor
    aside = f"Max(0,Sqrt((x-({x:.9g}))^2+(y-({y:.9g}))^2)-{radius:.9g})"
    return f"Min({growth},{CORRIDOR * fine:.9g}+0.7*{aside})"


def set_sizes(formula):
    tag = gmsh.model.mesh.field.add("MathEval")
    gmsh.model.mesh.field.setString(tag, "F", formula)
    gmsh.model.mesh.field.setAsBackgroundMesh(tag)


def add_discrete(shell):
    """Tag of a surface of the current model with these triangles."""
    tag = gmsh.model.addDiscreteEntity(2)
    gmsh.model.mesh.addNodes(2, tag, [], shell.points.ravel())
    numbers = gmsh.model.mesh.getNodes(2, tag)[0]
    gmsh.model.mesh.addElementsByType(tag, 2, [], numbers[shell.triangles].ravel())
    return tag


def coarse(body, formula):
    """The body's surface with triangles of the wanted size, or smaller ones if those would cut its ends off; it holds the
    body's volume again, which facets cut short."""
    longest = body.longest
    while True:
        try:
            shell = remeshed(body.shell, f"Min({longest:.9g},{formula})")
        except Exception as error:  # Gmsh's own has no other class
            raise failure_of([body], [body.shell], error) from error
        growth = (body.volume / shell.volume()) ** (1 / 3)
        if growth < MOST_GROWTH or longest < body.longest / 4:
            return shell.scaled(growth)
        longest *= 0.85


def failure_of(bodies, shells, error):
    """Why these surfaces cannot be meshed: where they cross, if they do."""
    for point, *crossed in crossings(shells):
        return Failure("its surface crosses itself" if crossed[0] == crossed[1] else "their surfaces cross",
                       sorted({bodies[k].name for k in crossed}), point[2])
    return Failure(f"Gmsh cannot mesh it: {error}", sorted({body.name for body in bodies}))


def remeshed(shell, formula):
    gmsh.model.add("surface")
    add_discrete(decimated(shell, FINEST_SURFACE))
    gmsh.model.mesh.classifySurfaces(math.pi, True, True, math.pi)
    gmsh.model.mesh.createGeometry()
    set_sizes(formula)
    gmsh.model.mesh.generate(2)
    remeshed_shell = mesh_shell()
    gmsh.model.remove()
    return remeshed_shell


def add_box(low, high):
    """Plane faces {name: tag} of the box."""
    geo = gmsh.model.geo
    corner = {(i, j, k): geo.addPoint(*(high[a] if side else low[a] for a, side in enumerate((i, j, k))))
              for i in (0, 1) for j in (0, 1) for k in (0, 1)}
    lines = {}

    def line(a, b):
        if (b, a) in lines:
            return -lines[b, a]
        if (a, b) not in lines:
            lines[a, b] = geo.addLine(corner[a], corner[b])
        return lines[a, b]
    faces = {}
    for axis in range(3):
        for side in (0, 1):
            around = [(0, 0), (1, 0), (1, 1), (0, 1)][::1 if side else -1]
            points = [tuple(np.insert(pair, axis, side).tolist()) for pair in around]
            loop = geo.addCurveLoop([line(points[n], points[(n + 1) % 4]) for n in range(4)])
            faces["xyz"[axis] + "-+"[side]] = geo.addPlaneSurface([loop])
    return faces


def build(domain, fine):
    """Meshes the domain as Gmsh's current model, with its named groups; returns the bodies' coarse surfaces."""
    formula = size_formula(domain, fine)
    shells = [coarse(body, formula) for body in domain.bodies]
    try:
        fill(domain, shells, formula)
    except Exception as error:  # Gmsh's own has no other class
        raise failure_of(domain.bodies, shells, error) from error
    return shells


def fill(domain, shells, formula):
    """Tetrahedra inside and around the surfaces."""
    gmsh.model.add("tissue")
    surfaces = [add_discrete(shell) for shell in shells]
    faces = add_box(domain.low, domain.high)
    geo = gmsh.model.geo
    loops = [geo.addSurfaceLoop([tag]) for tag in surfaces]
    parents = domain.parents()

    def holes(parent):
        return [loop for loop, around in zip(loops, parents) if around == parent]
    volumes = {i: geo.addVolume([loop, *holes(i)]) for i, loop in enumerate(loops) if not domain.bodies[i].hollow}
    volumes["surrounding"] = geo.addVolume([geo.addSurfaceLoop(list(faces.values())), *holes(None)])
    geo.synchronize()
    name_groups(domain, volumes, surfaces, faces)
    set_sizes(formula)
    gmsh.model.mesh.generate(3)
    if any(len(gmsh.model.mesh.getElementsByType(4, volume)[0]) == 0 for volume in volumes.values()):
        raise RuntimeError("a region stayed empty")
    for _ in range(3):
        gmsh.model.mesh.optimize("")
        gmsh.model.mesh.optimize("Relocate3D")


def name_groups(domain, volumes, surfaces, faces):
    """`volumes`: by index of the body, and around all of them."""
    groups = {}
    for i, volume in volumes.items():
        groups.setdefault((3, i if i == "surrounding" else domain.bodies[i].name), []).append(volume)
    groups[2, "skin"] = [faces["z-"]]
    for body, surface in zip(domain.bodies, surfaces):
        groups.setdefault((2, body.surface), []).append(surface)
    groups[2, "fixed"] = [faces["z+"], faces["y-"]]
    for number, ((dimension, name), tags) in enumerate(groups.items(), 1):
        gmsh.model.addPhysicalGroup(dimension, tags, number)
        gmsh.model.setPhysicalName(dimension, number, name)


def current_mesh():
    tags, flat, _ = gmsh.model.mesh.getNodes()
    at = np.zeros(int(tags.max()) + 1, int)
    at[tags] = np.arange(len(tags))
    regions, tets, region = [], [], []
    for _, group in gmsh.model.getPhysicalGroups(3):
        for volume in gmsh.model.getEntitiesForPhysicalGroup(3, group):
            corners = at[gmsh.model.mesh.getElementsByType(4, volume)[1]].reshape(-1, 4)
            tets.append(corners)
            region.append(np.full(len(corners), len(regions)))
        regions.append(gmsh.model.getPhysicalName(3, group))
    points = flat.reshape(-1, 3)
    surfaces = {gmsh.model.getPhysicalName(2, group): Shell(points, np.concatenate(
        [at[gmsh.model.mesh.getElementsByType(2, surface)[1]].reshape(-1, 3) for surface in gmsh.model.getEntitiesForPhysicalGroup(2, group)]))
        for _, group in gmsh.model.getPhysicalGroups(2)}
    return quality.Mesh(points, np.concatenate(tets), np.concatenate(region), regions, surfaces)


def first_size(extent, nodes):
    """Of the elements in the gland, for about so many nodes in a box of this extent; in its unit."""
    return 0.8 * (float(np.prod(extent)) / nodes) ** (1 / 3)


def generate(domain, nodes, path):
    """Writes the mesh of about so many nodes with the best angles that a few sizes of element give; returns it."""
    with tempfile.TemporaryDirectory() as folder:
        best = os.path.join(folder, "best.msh")
        mesh, shells = search(domain, nodes, best)
        if abs(len(mesh.points) / nodes - 1) > OFF:
            raise too_far_off(nodes, len(mesh.points), domain.bodies, shells)
        shutil.copyfile(best, path)
    return mesh


def search(domain, nodes, path):
    """The best mesh, also written, and its surfaces."""
    fine = first_size(domain.high - domain.low, nodes)
    best, best_rank, close_size, failures = None, (2, math.inf), None, 0
    for attempt in range(TRIES):
        try:
            shells = build(domain, fine)
        except Failure:
            session.restart()
            failures += 1
            if best is None and failures == FAILURES:
                raise
            fine *= 0.98
            continue
        mesh = current_mesh()
        count = len(mesh.points)
        off = abs(count / nodes - 1)
        rank = (0, mesh.badness()) if off <= CLOSE else (1, off)
        if rank < best_rank:
            best, best_rank = (mesh, shells), rank
            gmsh.write(path)
        gmsh.model.remove()
        if rank[0] == 0 and rank[1] <= 1:
            break
        centre = fine * (count / nodes) ** (1 / 3)
        if off > CLOSE:
            fine = centre
        else:  # look around it
            close_size = close_size or centre
            fine = close_size * (1 + JITTER * (0.618 * attempt % 1 - 0.5))
    return best


def too_far_off(nodes, count, bodies, shells):
    taken = collections.Counter()
    for body, shell in zip(bodies, shells):
        taken[body.name] += len(shell.points)
    name, most = taken.most_common(1)[0]
    return Unusable(name, f"the nearest to {nodes} nodes that is reached is {count}"
                    + (f": its surface alone has {most}: raise --nodes, or leave it out" if count > nodes else ""))
