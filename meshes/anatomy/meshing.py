"""Meshes the domain with Gmsh: coarsens the organs' surfaces, adds the box around them, fills it with tetrahedra, and searches for the element size that
gives the desired number of nodes. Each attempt runs in its own process with a time limit."""
import dataclasses
import math
import os
import shutil
import tempfile

import gmsh
import numpy as np

from . import limits, quality, relocate, session
from .shapes import label_image, labels
from .shapes.label_image import OUTSIDE
from .shapes.contours import Unusable
from .shapes.loft import mesh_shell
from .session import current_mesh
from .shapes.shells import Shell, crossings, decimated, distances

GROWTH = 4.0            # element size at the corners of the box, relative to that in the gland
CORRIDOR = 0.5          # element size in the corridor, relative to that in the gland
MOST_GROWTH = 1.09      # enlarge a coarse surface by at most this factor to restore its volume
FINEST_SURFACE = 2500   # decimate surfaces to this many triangles before remeshing them
TRIES = 16
MOST_WORK = 20000       # end the search after this many nodes in all attempts; a time limit would give different meshes on different machines
LARGE_WORK = 4          # until an attempt comes close to the desired number of nodes, allow this many times that number, if it is more than MOST_WORK
MOST_MISSED = 0.02      # of a region's surface: accept a mesh in which a larger fraction is missing only if there is no other
REFUSED_MISSED = 0.10   # of a region's surface: reject a mesh in which a larger fraction is missing
FAILURES = 3            # stop trying other element sizes after this many Gmsh failures
# the same limit if the best mesh so far has far too many nodes, so that elements would have to be larger still
FAR_FAILURES = 2
JITTER = 0.025          # changing the element size by this fraction gives a different mesh with about the same number of nodes
SMOOTH = 5000           # above this many nodes, assume that their number depends smoothly on the element size
CLOSE = 0.04            # among meshes this close to the desired number of nodes, relatively, choose the one with the best angles
OFF = 0.10              # report a relative deviation from the desired number of nodes larger than this
MOST_OFF = 2.0          # reject a mesh whose number of nodes is off by more than this factor
# No more than this fraction of a mesh's nodes can lie on the surfaces of its thin regions, because elements grow only gradually with distance from them
# (0.33 to 0.47 in practice).
ON_THIN = 0.48
WORST = 4.0             # reject a mesh with more badness than this (see quality.Mesh): dihedral angles below 2.5 or above 174.9 degrees
CUT = 1.5               # voxels: a triangle closer than this to a face of the block may be part of a cut (see FACING)
BORDER = 2.5            # voxels: tolerance at the image's border, where smoothing moves the surface inward
FACING = 0.7            # a triangle near a border is part of a cut if the cosine of the angle between their normals is above this
LEAST_CUT = 0.02        # if a smaller fraction of the skin's triangles is part of a cut, assume that the patient lies on their back
LYING = 10e-3           # m: fix a patient who lies on their back up to this height
INSIDE = 0.3            # a region counts as inside the gland if its surface is deeper in it than this fraction of the element size


class Failure(Exception):
    """Raised if Gmsh fails. names: regions whose surfaces are to blame; z: height of the fault, m, or None."""

    def __init__(self, problem, names, z=None):
        super().__init__(problem, names, z)     # pass on all arguments, because the exception is pickled to be sent between processes
        self.names, self.z = names, z

    def __str__(self):
        return self.args[0]


class Thin(Failure):
    """Raised if regions are too thin to be meshed with any element size. enough: a number of nodes that would suffice, if known."""

    def __init__(self, problem, names, enough=None):
        super().__init__(problem, names)
        self.args, self.enough = (problem, names, enough), enough


@dataclasses.dataclass
class Body:
    """A region, or a part of a region."""
    name: str               # name of the region
    surface: str            # name of the physical group of its surface
    shell: object           # its surface, finely triangulated, m, world frame
    volume: float           # volume that it must have in the mesh, m^3
    longest: float          # maximum edge length of the triangles on its surface, m
    hollow: bool = False    # true for bone, which has no tetrahedra inside


@dataclasses.dataclass
class Region:
    """A region that may touch other regions."""
    name: str
    surface: str
    shells: list             # closed surfaces of its parts, in the world frame, m
    sizes: list              # volumes of its parts, m^3; None (unknown) for a part that is only partly in the block
    hollow: bool = False     # true for bone, which has no tetrahedra inside
    layer: object = None     # layer of the label map that the region comes from, if any; regions in the same layer do not overlap

    def volumes(self):
        """Returns the volume that each part must have in the mesh, m^3, or None if any will do."""
        return [None] * len(self.sizes) if self.hollow else self.sizes


@dataclasses.dataclass
class Domain:
    """What to mesh: a box with the skin on one face, unless `skin` is true. It contains either `bodies` that do not touch or `regions` that may."""
    bodies: list
    low: np.ndarray
    high: np.ndarray
    middle: np.ndarray       # centre of the gland
    reach: float             # m: half the gland's longest side
    origin: np.ndarray       # origin of the mesh frame in DICOM mm
    corridor: tuple = None   # x, y and radius of the corridor, m
    regions: list = None     # regions in order of priority
    gland: str = ""
    path: tuple = None       # entry point and target of the needle, m
    plate: np.ndarray = None    # a point on the template's entry face, m
    tube: float = None       # m, elements are smaller within this radius around the needle's path
    skin: bool = False       # true if the last region is the body around all others; then there is no box, and the outside is air
    border: object = None    # faces where the image cuts off the body (voxels.Border)
    crop: tuple = None       # low and high corners of the box to crop regions to
    front: str = "z-"        # the face of the box that is the skin
    quiet: tuple = ()        # names of surfaces without a group of their own
    image: tuple = None      # image of the regions, its pieces, and the fractions of the parts that are lost: see label_image.image_for
    needed: list = None      # for each region, roughly how many nodes its surface needs where it is thin

    def parts(self):
        """Returns a list of (owner, index within the owner) of all parts of the regions, or of all bodies. A position in this list is a part's number."""
        if self.regions:
            return [(region, n) for region in self.regions for n in range(len(region.shells))]
        return [(body, 0) for body in self.bodies]

    def parents(self):
        """For each body, returns the index of the smallest body around it, or None."""
        found = []
        for body in self.bodies:
            around = [i for i, other in enumerate(self.bodies) if other is not body and other.shell.volume() > body.shell.volume()
                      and np.median(distances(other.shell, body.shell.points[::50])) < 0]
            found.append(min(around, key=lambda i: self.bodies[i].shell.volume(), default=None))
        return found


def size_formula(domain, fine):
    """Returns a Gmsh size formula: `fine` in the gland, growing by the factor GROWTH towards the corners of the box, and smaller in the corridor."""
    away = "Sqrt({})".format("+".join(f"({axis}-({c:.9g}))^2" for axis, c in zip("xyz", domain.middle)))
    span = math.dist(domain.middle, domain.low) - domain.reach
    growth = f"{fine:.9g}*(1+{GROWTH - 1:g}*Max(0,({away}-{domain.reach:.9g})/{span:.9g}))"
    if domain.corridor:
        x, y, radius = domain.corridor
        from_axis = f"(x-({x:.9g}))^2+(y-({y:.9g}))^2"
    elif domain.tube:
        radius, (entry, target) = domain.tube, domain.path
        (u, v, w), at = (target - entry) / math.dist(entry, target), [f"({axis}-({c:.9g}))" for axis, c in zip("xyz", entry)]
        from_axis = "+".join(f"({a:.9g}*{at[k]}-({b:.9g})*{at[j]})^2" for a, k, b, j in ((v, 2, w, 1), (w, 0, u, 2), (u, 1, v, 0)))
    else:
        return growth
    aside = f"Max(0,Sqrt({from_axis})-{radius:.9g})"
    return f"Min({growth},{CORRIDOR * fine:.9g}+0.7*{aside})"


def set_sizes(formula):
    tag = gmsh.model.mesh.field.add("MathEval")
    gmsh.model.mesh.field.setString(tag, "F", formula)
    gmsh.model.mesh.field.setAsBackgroundMesh(tag)


def add_discrete(shell):
    """Adds a triangulated surface to Gmsh's current model. Returns its tag."""
    tag = gmsh.model.addDiscreteEntity(2)
    gmsh.model.mesh.addNodes(2, tag, [], shell.points.ravel())
    numbers = gmsh.model.mesh.getNodes(2, tag)[0]
    gmsh.model.mesh.addElementsByType(tag, 2, [], numbers[shell.triangles].ravel())
    return tag


def coarse(body, formula):
    """Remeshes a body's surface with triangles of the desired size, or smaller ones if these would cut off its ends. Then enlarges the surface to the body's
    volume, because flat facets enclose less."""
    longest = body.longest
    while True:
        try:
            shell = remeshed(body.shell, f"Min({longest:.9g},{formula})")
        except Exception as error:  # Gmsh has no more specific exception class
            raise failure_of([body], [body.shell], error) from error
        growth = (body.volume / shell.volume()) ** (1 / 3)
        if growth < MOST_GROWTH or longest < body.longest / 4:
            return shell.scaled(growth)
        longest *= 0.85


def failure_of(bodies, shells, error):
    """Finds out why these surfaces cannot be meshed, for example because they cross, and returns a Failure that says so."""
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
    """Adds the box to the model; returns its plane faces as {name: tag}."""
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


def face_name(axis, side):
    return "xyz"[axis] + ("-" if side < 0 else "+")


def fixed_faces(front):
    """Returns the faces of the box to fix if `front` is the skin: the opposite face, and the back, because patients lie on it. If the back is the skin, the
    face toward the head is fixed instead."""
    opposite = front[0] + ("+" if front[1] == "-" else "-")
    return sorted({opposite, "z+" if front == "y-" else "y-"}, reverse=True)


def build(domain, fine):
    """Meshes the domain in Gmsh's current model, with named groups. Returns which piece (or body) each Gmsh volume is, {tag: number}, and what fraction of
    each piece's surface is missing."""
    formula = size_formula(domain, fine)
    if domain.regions:
        pieces = domain.image[1]
        found, missed = labels.shared_surfaces(*domain.image, [region.shells for region in domain.regions],
                                               [volume for region in domain.regions for volume in region.volumes()], fine)
        check_found(domain, found, missed)
        region = [domain.regions[k] if k != OUTSIDE else None for k in pieces.regions] + [None]     # the last element is for OUTSIDE
        owner = [region[piece] for piece in found.cells]
        missed = [share if region[piece] else 0.0 for piece, share in enumerate(missed)]
        patches, points, cells = patches_of_complex(domain, found, owner, fine), found.points, list(found.cells)
        owners = domain.regions
        surfaces = [found.surface({piece for piece, k in enumerate(pieces.regions) if k == number}) for number in range(len(owners))]
    else:
        surfaces, missed = [coarse(body, formula) for body in domain.bodies], [0.0] * len(domain.bodies)
        points, patches = patches_of_bodies(domain, surfaces)
        owners, owner, cells = domain.bodies, domain.bodies, list(range(len(domain.bodies)))
    try:
        volumes = fill(domain, points, patches, [(each.name, each.hollow) if each else ("surrounding", False) for each in owner], formula)
    except Exception as error:  # Gmsh has no more specific exception class
        raise failure_of(owners, surfaces, error) from error
    return {tag: cells[k] for k, tag in volumes.items()}, missed


def check_found(domain, found, missed):
    """Raises Thin if too little is left of any region."""
    pieces, names = domain.image[1], [region.name for region in domain.regions]
    left = {pieces.regions[piece] for piece in found.cells if piece != OUTSIDE}
    gone = [name for k, name in enumerate(names) if k not in left]
    if gone:
        raise Thin("nothing is left of it: it lies inside other regions or is too thin", gone)
    weight, thin = pieces.voxels() ** (2 / 3), {}       # the weight scales like a surface area
    for k, name in enumerate(names[:-1] if domain.skin else names):
        mine = [piece for piece, number in enumerate(pieces.regions) if number == k]
        share = float(np.average([missed[piece] for piece in mine], weights=weight[mine]))
        if share > REFUSED_MISSED:
            thin[name] = share
    if thin:
        most = max(thin.values())
        raise Thin(f"{100 * most:.0f} % of its surface would be missing in the mesh: it is too thin for this number of nodes", sorted(thin, key=thin.get, reverse=True))


@dataclasses.dataclass
class Patch:
    """A surface between two cells."""
    name: str                # name of its physical group
    triangles: np.ndarray    # indices into the points of all patches
    sides: tuple             # cells, or OUTSIDE


def patches_of_bodies(domain, shells):
    first = np.cumsum([0] + [len(shell.points) for shell in shells])
    outside = [OUTSIDE if parent is None else parent for parent in domain.parents()]
    return np.vstack([shell.points for shell in shells]), [
        Patch(body.surface, shell.triangles + at, (k, around))
        for k, (body, shell, at, around) in enumerate(zip(domain.bodies, shells, first, outside))]


def patches_of_complex(domain, found, owner, fine):
    """Splits a complex into patches. A patch between two regions is named after the bone if one of them is, else after the gland, else after the region drawn
    on top, except that the surface of a region inside the gland is named after that region. owner: each cell's region, or None."""
    gland = next(region for region in domain.regions if region.name == domain.gland)
    order = {region.name: k for k, region in enumerate(domain.regions)}
    sides = np.sort(found.sides, axis=1)
    patches = []
    for pair in np.unique(sides, axis=0):
        triangles = found.triangles[np.all(sides == pair, axis=1)]
        between = sorted({owner[side].name for side in pair if side != OUTSIDE and owner[side]}, key=order.get)
        between = [domain.regions[order[name]] for name in between]
        if domain.skin and OUTSIDE in pair:
            patches += outer_patches(domain, found, triangles, pair, between[0].surface)
            continue
        if domain.skin and len(between) > 1:
            between = [region for region in between if region is not domain.regions[-1]]
        names = [region.surface for region in between]
        if "bone" in names:
            name = "bone"
        elif gland.surface in names and len(names) > 1:
            middles = found.points[triangles].mean(axis=1)
            depth = np.median(np.min([distances(shell, middles) for shell in gland.shells], axis=0))
            name = gland.surface if depth > -INSIDE * fine else next(n for n in names if n != gland.surface)
        else:
            name = names[0]
        patches.append(Patch(name, triangles, tuple(int(side) for side in pair)))
    return patches


def outer_patches(domain, found, triangles, pair, name):
    """Returns the patches between a cell and the air. Triangles on the faces of the block, or where the image cuts off the body, go into a fixed patch."""
    middles, sides = found.points[triangles].mean(axis=1), tuple(int(side) for side in pair)
    a, b, c = (found.points[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = CUT * domain.image[0].step
    cut = np.any((np.minimum(np.abs(middles - domain.low), np.abs(middles - domain.high)) < near) & (np.abs(normals) > FACING), axis=1)
    if domain.border:
        facing = normals @ domain.border.normals.T > FACING
        cut |= np.any(facing & (domain.border.offsets - middles @ domain.border.normals.T < BORDER * domain.image[0].step), axis=1)
    if name == "skin" and np.count_nonzero(cut) < LEAST_CUT * len(cut):     # nothing else holds the body, so assume that the patient lies on their back
        cut |= middles[:, 1] < middles[:, 1].min() + LYING
    return [Patch(called, triangles[mine], sides) for called, mine in (("fixed", cut), (name, ~cut)) if mine.any()]


def add_patches(points, patches):
    """Adds the patches to Gmsh's current model as surfaces with shared points. Returns their tags."""
    tags = [gmsh.model.addDiscreteEntity(2) for _ in patches]
    added = np.zeros(len(points), bool)
    for tag, patch in zip(tags, patches):
        mine = np.unique(patch.triangles)
        mine = mine[~added[mine]]
        added[mine] = True
        gmsh.model.mesh.addNodes(2, tag, mine + 1, points[mine].ravel())
    for tag, patch in zip(tags, patches):
        gmsh.model.mesh.addElementsByType(tag, 2, [], patch.triangles.ravel() + 1)
    return tags


def fill(domain, points, patches, cells, formula):
    """Fills the cells, (name, whether hollow), and the space around them with tetrahedra. Returns {cell: tag of its Gmsh volume}."""
    gmsh.model.add("tissue")

    def tissue(side):
        return not domain.skin if side == OUTSIDE else not cells[side][1]
    patches = [patch for patch in patches if any(map(tissue, patch.sides))]     # leave out patches that border on no tissue, such as those between two bones
    surfaces = add_patches(points, patches)
    faces = {} if domain.skin else add_box(domain.low, domain.high)
    geo = gmsh.model.geo

    def around(cell):
        return [tag for tag, patch in zip(surfaces, patches) if cell in patch.sides]
    made = {k: geo.addVolume([geo.addSurfaceLoop(around(k))]) for k, (_, hollow) in enumerate(cells) if not hollow}
    volumes = [(cells[k][0], tag) for k, tag in made.items()]
    if faces:
        volumes.append(("surrounding", geo.addVolume([geo.addSurfaceLoop([*faces.values(), *around(OUTSIDE)])])))
    geo.synchronize()
    name_groups(volumes, [(patch.name, tag) for tag, patch in zip(surfaces, patches) if patch.name not in domain.quiet], faces, domain.front)
    set_sizes(formula)
    gmsh.model.mesh.generate(3)
    if any(len(gmsh.model.mesh.getElementsByType(4, volume)[0]) == 0 for _, volume in volumes):
        raise RuntimeError("a region stayed empty")
    for _ in range(3):
        gmsh.model.mesh.optimize("")
        gmsh.model.mesh.optimize("Relocate3D")
    return made


def name_groups(volumes, surfaces, faces, front):
    """Creates Gmsh's physical groups. volumes, surfaces: pairs (name, tag); faces: name -> tag of each face of the box; front: the face that is the skin."""
    groups = {}
    for name, tag in volumes:
        groups.setdefault((3, name), []).append(tag)
    if faces:
        groups[2, "skin"] = [faces[front]]
    for name, tag in surfaces:
        groups.setdefault((2, name), []).append(tag)
    if faces:
        groups[2, "fixed"] = [faces[name] for name in fixed_faces(front)]
    for number, ((dimension, name), tags) in enumerate(groups.items(), 1):
        gmsh.model.addPhysicalGroup(dimension, tags, number)
        gmsh.model.setPhysicalName(dimension, number, name)


def first_size(extent, nodes):
    """Estimates the element size in the gland that gives this many nodes in a box of this extent, in the unit of the extent."""
    return 0.8 * (float(np.prod(extent)) / nodes) ** (1 / 3)


@dataclasses.dataclass
class Attempt:
    """A mesh, and how well it represents each piece (or body)."""
    mesh: quality.Mesh
    missed: list = dataclasses.field(default_factory=list)      # for each piece, the fraction of its surface missing from the mesh
    held: list = dataclasses.field(default_factory=list)        # for each piece, its volume in the mesh, m^3

    def rank(self, nodes):
        """Sort key for attempts, best first. The criteria, in order: usable angles, no missing surface, a number of nodes close to the desired one, and then
        either better angles (if close) or a closer number of nodes."""
        off, badness = abs(len(self.mesh.points) / nodes - 1), self.mesh.badness()
        return badness > WORST, max(self.missed, default=0) > MOST_MISSED, off > CLOSE, badness if off <= CLOSE else off


def attempt(domain, fine, path):
    """Makes one attempt. Runs in a separate process."""
    session.start()
    volumes, missed = build(domain, fine)
    mesh, tags = current_mesh()
    if domain.regions:
        move_nodes(mesh, relocate.relocated(mesh, held_points(domain, mesh)))
    torn = mesh.torn()
    if torn:
        raise Failure(f"Gmsh's tetrahedra do not keep to the surface {torn[0]}", sorted({owner.name for owner in domain.regions or domain.bodies}))
    gmsh.write(path)
    each, held = mesh.volumes(), np.zeros(len(missed))
    for tag, piece in volumes.items():
        if piece != OUTSIDE:
            held[piece] += each[tags == tag].sum()
    return Attempt(mesh, missed, held.tolist())


def held_points(domain, mesh):
    """Returns the mask of points that must not move, because they are on faces of the block, which must stay flat."""
    if not domain.skin:
        near = 1e-6 * math.dist(domain.low, domain.high)
        return np.any((mesh.points < domain.low + near) | (mesh.points > domain.high - near), axis=1)
    held = np.zeros(len(mesh.points), bool)
    if "fixed" in mesh.surfaces:
        held[np.unique(mesh.surfaces["fixed"].triangles)] = True
    return held


def move_nodes(mesh, points):
    """Moves nodes both in Gmsh's current model and in `mesh`, which was made from it."""
    tags = gmsh.model.mesh.getNodes()[0]
    for n in np.flatnonzero(np.any(points != mesh.points, axis=1)):
        gmsh.model.mesh.setNode(tags[n], points[n], [])
    mesh.points[:] = points      # the surfaces of the mesh share these points


def prepare(domain, nodes):
    """Draws the image of regions that share surfaces. Raises Thin if any are too thin for the image or need too many nodes; the check takes only seconds, so
    it is worth doing before meshing."""
    if not domain.regions:
        return
    names = [region.name for region in domain.regions]
    fine = first_size(domain.high - domain.low, nodes)
    image, pieces, lost, needed = limits.run(f"image of {limits.few(names)}", drawn, domain, fine)
    parts = domain.parts()
    lost = {(part, winner): share for (part, winner), share in lost.items()
            if winner == OUTSIDE or parts[part][0].layer is None or parts[part][0].layer != domain.regions[winner].layer}
    domain.image = image, pieces, lost
    gone = [name for k, name in enumerate(names) if k not in pieces.regions]
    if gone:
        raise Thin("nothing is left of it: it lies inside other regions or is too thin", gone)
    domain.needed = needed
    if sum(needed) > ON_THIN * MOST_OFF * nodes:
        count = sum(needed) / ON_THIN
        raise too_thin(domain, nodes, count, f"thin regions need about {sum(needed):.0f} nodes on their surfaces alone, and {count:.0f} in all, more than twice --nodes {nodes}")


def too_thin(domain, nodes, count, problem):
    """Returns a Thin error that names the regions to leave out so that a mesh with this many nodes becomes possible: those that need the most nodes, but not
    the body around them, and the gland only if there are no others."""
    names, left, thin = [region.name for region in domain.regions], count, []
    for k in sorted(range(len(names) - domain.skin), key=lambda k: -domain.needed[k]):
        if left > MOST_OFF * nodes and domain.needed[k] > 0 and names[k] != domain.gland:
            thin.append(names[k])
            left -= count * domain.needed[k] / sum(domain.needed)
    return Thin(problem, thin or [domain.gland], 100 * math.ceil(count / 100))


def drawn(domain, fine):
    """Draws the image of the domain's regions. Returns it with its pieces, the lost fractions of the parts, and the number of nodes that each region needs
    where it is thin."""
    image, pieces, lost = label_image.image_for([region.shells for region in domain.regions], fine, (domain.low, domain.high) if domain.skin else domain.crop, domain.skin)
    shells = [shell for region in domain.regions for shell in region.shells]
    needed = np.zeros(len(domain.regions))
    for piece, count in enumerate(labels.nodes_of_thin(pieces, shells, image.step, fine)):
        if pieces.regions[piece] != OUTSIDE:
            needed[pieces.regions[piece]] += count
    return image, pieces, lost, needed.tolist()


def generate(domain, nodes, path):
    """Meshes the domain with several element sizes. Writes the mesh that has about this many nodes and the best angles, and returns it as an Attempt."""
    with tempfile.TemporaryDirectory() as folder:
        best = os.path.join(folder, "best.msh")
        made = search(domain, nodes, best)
        if not 1 / MOST_OFF <= len(made.mesh.points) / nodes <= MOST_OFF:
            raise too_far_off(domain, nodes, made.mesh)
        if made.mesh.badness() > WORST:
            angles = made.mesh.dihedral_angles()
            raise Unusable('" and "'.join(sorted({owner.name for owner in domain.regions or domain.bodies})),
                           f"dihedral angles of {angles.min():.2f} to {angles.max():.2f} degrees are the best that was reached: "
                           "outside the range usable for forces; raise --nodes, or leave out the thinnest region")
        shutil.copyfile(best, path)
    return made


def search(domain, nodes, path):
    """Returns the best attempt, and writes its mesh."""
    fine = first_size(domain.high - domain.low, nodes)
    limit = min(FAILURES, TRIES)
    best, best_rank, close_size, failures, work, tries = None, (), None, 0, 0, []
    every = sorted({owner.name for owner in domain.regions or domain.bodies})
    for number in range(TRIES):
        near = best and abs(len(best.mesh.points) / nodes - 1) <= OFF
        if best and not best_rank[1] and work > (MOST_WORK if near else max(MOST_WORK, LARGE_WORK * nodes)):
            break
        try:
            try:
                made = limits.run(f"mesh of {limits.few(every)}", attempt, domain, fine, path + ".try.msh")
            except limits.Crashed as error:
                raise Failure(str(error), every) from error
        except Failure as failure:
            failures += 1
            if best is None and (failures == limit or isinstance(failure, Thin)):
                raise
            if failures == limit and best_rank[1] or failures >= FAR_FAILURES and best and len(best.mesh.points) > MOST_OFF * nodes:
                break
            fine *= 0.98
            continue
        mesh = made.mesh
        rank = made.rank(nodes)
        if best is None or rank < best_rank:
            best, best_rank = made, rank
            os.replace(path + ".try.msh", path)
        count = len(mesh.points)
        work += count
        # where regions share surfaces, most nodes are on these, so their number scales more like area than volume
        centre = fine * (count / nodes) ** (1 / 2 if domain.regions else 1 / 3)
        if rank[1]:      # part of a surface is missing: a last resort
            failures += 1
            if failures == limit and best_rank[1]:
                break
            fine = min(0.98 * fine, centre)
            continue
        off = abs(count / nodes - 1)
        if rank <= (False, False, False, 1.0) or too_many_at_any_size(tries, fine, count, nodes):
            break
        tries.append((fine, count))
        if off > CLOSE:
            fine = nodes > SMOOTH and size_between(tries, nodes) or centre
        else:  # try sizes around this one
            close_size = close_size or centre
            fine = close_size * (1 + JITTER * (0.618 * number % 1 - 0.5))
    return best


def too_many_at_any_size(tries, fine, count, nodes):
    """Whether there are far too many nodes and larger elements did not help, because the surfaces of thin regions need so many."""
    return count > MOST_OFF * nodes and any(size < fine and MOST_OFF * nodes < fewer <= count for size, fewer in tries)


def size_between(tries, nodes):
    """Interpolates the element size for this many nodes from attempts (size, nodes). Returns None unless there are attempts with more nodes and with fewer."""
    more, fewer = [t for t in tries if t[1] > nodes], [t for t in tries if t[1] < nodes]
    if not more or not fewer:
        return None
    (fine, most), (coarse, least) = min(more, key=lambda t: t[1]), max(fewer, key=lambda t: t[1])
    return fine * (coarse / fine) ** (math.log(most / nodes) / math.log(most / least))


def remarks_on_number(mesh, nodes):
    """Returns remarks for the report if the number of nodes is not close to the desired one."""
    count = len(mesh.points)
    if abs(count / nodes - 1) <= OFF:
        return []
    name, most = most_on_surface(mesh)
    return [f"the mesh has {count} nodes instead of {nodes}, the closest that was found" + (f": the surface of {name} alone has {most}" if count > nodes else "")]


def too_far_off(domain, nodes, mesh):
    count, (name, most) = len(mesh.points), most_on_surface(mesh)
    if count > nodes and domain.needed and sum(domain.needed) > 0:
        return too_thin(domain, nodes, count, f"no mesh has {nodes} nodes; the closest has {count}, because of thin regions")
    return Unusable(name, f"no mesh has {nodes} nodes; the closest has {count}"
                    + (f": its surface alone has {most}: raise --nodes, or leave it out" if count > nodes else ""))


def most_on_surface(mesh):
    """Finds the region (or "bone") with the most nodes on its surface. Returns its name and that number."""
    surfaces = {name: mesh.boundary(name) for name in mesh.regions if name != "surrounding"}
    if "bone" in mesh.surfaces:
        surfaces["bone"] = mesh.surfaces["bone"]
    return max(((name, len(np.unique(surface.triangles))) for name, surface in surfaces.items()), key=lambda pair: pair[1])
