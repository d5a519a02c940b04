"""Meshes the domain with Gmsh: coarse surfaces of the organs, the box around them, the tetrahedra in between, and the search for the element
size that gives the desired number of nodes. Each attempt runs in a separate process with a time limit."""
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

GROWTH = 4.0            # ratio of the element size at the corners of the box to that in the gland
CORRIDOR = 0.5          # ratio of the element size in the corridor to that in the gland
MOST_GROWTH = 1.09      # largest factor by which a coarse surface is enlarged to restore its volume
FINEST_SURFACE = 2500   # number of triangles to which a surface is decimated before it is remeshed
TRIES = 16
MOST_WORK = 20000       # total number of nodes in all attempts after which the search ends; a time limit would give different meshes on different machines
LARGE_WORK = 4          # multiple of the desired number of nodes that replaces MOST_WORK, if larger, until an attempt comes close to the desired number
MOST_MISSED = 0.02      # fraction of a region's surface: a mesh in which a larger fraction is missing is accepted only if there is no other mesh
REFUSED_MISSED = 0.10   # fraction of a region's surface: a mesh in which a larger fraction is missing is refused
FAILURES = 3            # number of Gmsh failures after which no other element sizes are tried
# number of Gmsh failures after which the search ends if the best mesh has far too many nodes, so that elements would have to be larger still
FAR_FAILURES = 2
JITTER = 0.025          # relative change in the element size that gives a different mesh with about the same number of nodes
SMOOTH = 5000           # if more nodes than this are desired, their number is assumed to depend smoothly on the element size
CLOSE = 0.04            # fraction of the desired number of nodes: among meshes within this range, the one with the best angles is chosen
OFF = 0.10              # fraction of the desired number of nodes: if the mesh is farther off, the report mentions it
MOST_OFF = 2.0          # a mesh whose number of nodes differs from the desired number by more than this factor is refused
# largest fraction of a mesh's nodes that can lie on the surfaces of its thin regions, because tetrahedra grow only gradually with the distance from
# these surfaces (measured: 0.33 to 0.47)
ON_THIN = 0.48
WORST = 4.0             # largest badness (see quality.Mesh): a mesh with dihedral angles below 2.5 or above 174.9 degrees is refused
CUT = 1.5               # voxels: a triangle closer than this to a face of the block may be part of a cut (see FACING)
BORDER = 2.5            # voxels: tolerance at the image's border, where smoothing has moved the surface inward
FACING = 0.7            # cosine of the angle between the normals of a triangle and a nearby border: above this, the triangle is part of a cut
LEAST_CUT = 0.02        # fraction of the skin's triangles: if fewer than this are part of a cut, the body is assumed to lie on its back
LYING = 10e-3           # m: if the body lies on its back, it is fixed up to this height
INSIDE = 0.3            # fraction of the element size: a region whose surface lies deeper than this in the gland is considered to be inside it


class Failure(Exception):
    """Raised if Gmsh fails. `names`: regions whose surfaces are the cause; `z`: height of the fault, m, or None."""

    def __init__(self, problem, names, z=None):
        super().__init__(problem, names, z)     # pass on all arguments, because the exception is pickled when it is sent between processes
        self.names, self.z = names, z

    def __str__(self):
        return self.args[0]


class Thin(Failure):
    """Raised if regions are too thin and elements of another size would not help. `enough`: a sufficient number of nodes, if known."""

    def __init__(self, problem, names, enough=None):
        super().__init__(problem, names)
        self.args, self.enough = (problem, names, enough), enough


@dataclasses.dataclass
class Body:
    """A region, or a part of a region."""
    name: str               # name of the region
    surface: str            # name of its surface's physical group
    shell: object           # its finely triangulated surface, m, world frame
    volume: float           # volume that it must have in the mesh, m^3
    longest: float          # longest edge that the triangles of its surface may have, m
    hollow: bool = False    # true for bone, which has no tetrahedra inside


@dataclasses.dataclass
class Region:
    """A region that may touch other regions."""
    name: str
    surface: str
    shells: list             # closed surfaces of its parts, in the world frame, m
    sizes: list              # volumes of its parts, m^3; None for a part that lies only partly in the block, so that its volume is unknown
    hollow: bool = False     # true for bone, which has no tetrahedra inside
    layer: object = None     # layer of the label map from which the region comes, if any; regions of the same layer do not overlap

    def volumes(self):
        """Returns the volume that each part must have in the mesh, m^3; None if it is not prescribed."""
        return [None] * len(self.sizes) if self.hollow else self.sizes


@dataclasses.dataclass
class Domain:
    """The domain to be meshed, which is a box with the skin on one face unless `skin` is true. It contains either `bodies` that do not touch, or `regions`
    that may touch."""
    bodies: list
    low: np.ndarray
    high: np.ndarray
    middle: np.ndarray       # centre of the gland
    reach: float             # m: half the gland's longest side
    origin: np.ndarray       # origin of the mesh's frame in DICOM mm
    corridor: tuple = None   # x, y and radius of the corridor, m
    regions: list = None     # regions in order of priority
    gland: str = ""
    path: tuple = None       # entry point and target of the needle, m
    plate: np.ndarray = None    # a point on the face of the template through which needles enter, m
    tube: float = None       # m, radius around the needle's path within which elements are smaller
    skin: bool = False       # true if the last region is the body that surrounds the others; in that case there is no box, and the outside is air
    border: object = None    # faces where the image cuts off the body (voxels.Border)
    crop: tuple = None       # low and high corner of the box outside which regions are cut off
    front: str = "z-"        # the face of the box that represents the skin
    quiet: tuple = ()        # names of surfaces that have no group of their own
    image: tuple = None      # image of the regions, its pieces, and the fractions of the parts that are lost: see label_image.image_for
    needed: list = None      # for each region, the approximate number of nodes needed on its surface where it is thin

    def parts(self):
        """Returns the parts of the regions, or the bodies, as a list of pairs (owner, number within the owner); parts are numbered by their positions in
        it."""
        if self.regions:
            return [(region, n) for region in self.regions for n in range(len(region.shells))]
        return [(body, 0) for body in self.bodies]

    def parents(self):
        """Returns for each body the index of the smallest body that surrounds it, or None."""
        found = []
        for body in self.bodies:
            around = [i for i, other in enumerate(self.bodies) if other is not body and other.shell.volume() > body.shell.volume()
                      and np.median(distances(other.shell, body.shell.points[::50])) < 0]
            found.append(min(around, key=lambda i: self.bodies[i].shell.volume(), default=None))
        return found


def size_formula(domain, fine):
    """Returns a formula for elements of size `fine` in the gland, growing by the factor GROWTH towards the corners of the box, and smaller in the corridor."""
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
    """Adds a surface with these triangles to Gmsh's current model; returns its tag."""
    tag = gmsh.model.addDiscreteEntity(2)
    gmsh.model.mesh.addNodes(2, tag, [], shell.points.ravel())
    numbers = gmsh.model.mesh.getNodes(2, tag)[0]
    gmsh.model.mesh.addElementsByType(tag, 2, [], numbers[shell.triangles].ravel())
    return tag


def coarse(body, formula):
    """Returns the surface of the body, meshed with triangles of the desired size, or smaller if triangles of that size would cut off the body's ends. The
    surface is enlarged to the body's volume, because flat facets enclose less."""
    longest = body.longest
    while True:
        try:
            shell = remeshed(body.shell, f"Min({longest:.9g},{formula})")
        except Exception as error:  # Gmsh raises no more specific class
            raise failure_of([body], [body.shell], error) from error
        growth = (body.volume / shell.volume()) ** (1 / 3)
        if growth < MOST_GROWTH or longest < body.longest / 4:
            return shell.scaled(growth)
        longest *= 0.85


def failure_of(bodies, shells, error):
    """Returns a Failure that explains why these surfaces cannot be meshed, for example because they cross."""
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
    """Returns the faces of the box that are fixed if `front` is the skin: the opposite face, and the patient's back, on which the patient lies. If the back
    is the skin, the face toward the head is fixed instead of it."""
    opposite = front[0] + ("+" if front[1] == "-" else "-")
    return sorted({opposite, "z+" if front == "y-" else "y-"}, reverse=True)


def build(domain, fine):
    """Meshes the domain in Gmsh's current model, with named groups. Returns the piece (or body) in each of Gmsh's volumes, {tag: number}, and the missing
    fraction of each piece's surface."""
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
    except Exception as error:  # Gmsh raises no more specific class
        raise failure_of(owners, surfaces, error) from error
    return {tag: cells[k] for k, tag in volumes.items()}, missed


def check_found(domain, found, missed):
    """Raises Thin if too little of any region is left."""
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
    """Returns the patches. A patch between two regions is named after the bone, or else after the gland, or else after the region drawn on top; but the
    surface of a region inside the gland is named after that region. `owner`: the region of each cell, or None."""
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
    """Returns the patches between a cell and the air. Triangles on the faces of the block, and where the image cuts off the body, form a fixed patch."""
    middles, sides = found.points[triangles].mean(axis=1), tuple(int(side) for side in pair)
    a, b, c = (found.points[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    near = CUT * domain.image[0].step
    cut = np.any((np.minimum(np.abs(middles - domain.low), np.abs(middles - domain.high)) < near) & (np.abs(normals) > FACING), axis=1)
    if domain.border:
        facing = normals @ domain.border.normals.T > FACING
        cut |= np.any(facing & (domain.border.offsets - middles @ domain.border.normals.T < BORDER * domain.image[0].step), axis=1)
    if name == "skin" and np.count_nonzero(cut) < LEAST_CUT * len(cut):     # nothing else fixes the body, so assume that it lies on its back
        cut |= middles[:, 1] < middles[:, 1].min() + LYING
    return [Patch(called, triangles[mine], sides) for called, mine in (("fixed", cut), (name, ~cut)) if mine.any()]


def add_patches(points, patches):
    """Adds the patches to Gmsh's current model as surfaces that share points; returns their tags."""
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
    """Creates tetrahedra in the cells (name, whether hollow) and around them. Returns {cell: tag of its volume in Gmsh}."""
    gmsh.model.add("tissue")

    def tissue(side):
        return not domain.skin if side == OUTSIDE else not cells[side][1]
    patches = [patch for patch in patches if any(map(tissue, patch.sides))]     # the other patches, for example between two bones, are not part of the mesh
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
    """Creates Gmsh's physical groups. `volumes`, `surfaces`: pairs (name, tag). `faces`: name -> tag of each face of the box; `front`: the face that is the
    skin."""
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
    """Returns the element size in the gland for about this many nodes in a box of this extent, in the same unit."""
    return 0.8 * (float(np.prod(extent)) / nodes) ** (1 / 3)


@dataclasses.dataclass
class Attempt:
    """A mesh, with results for each piece (or body) of its regions."""
    mesh: quality.Mesh
    missed: list = dataclasses.field(default_factory=list)      # for each piece, the fraction of its surface that is missing from the mesh
    held: list = dataclasses.field(default_factory=list)        # for each piece, its volume in the mesh, m^3

    def rank(self, nodes):
        """Returns the rank of the attempt; a lower rank is better. Compares in this order: whether the angles are unusable, whether a surface is missing,
        whether the number of nodes is far from the desired one, and then either the angles or the number of nodes."""
        off, badness = abs(len(self.mesh.points) / nodes - 1), self.mesh.badness()
        return badness > WORST, max(self.missed, default=0) > MOST_MISSED, off > CLOSE, badness if off <= CLOSE else off


def attempt(domain, fine, path):
    """Makes one attempt; runs in a separate process."""
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
    """Returns the mask of the points on the faces of the block, which must remain flat."""
    if not domain.skin:
        near = 1e-6 * math.dist(domain.low, domain.high)
        return np.any((mesh.points < domain.low + near) | (mesh.points > domain.high - near), axis=1)
    held = np.zeros(len(mesh.points), bool)
    if "fixed" in mesh.surfaces:
        held[np.unique(mesh.surfaces["fixed"].triangles)] = True
    return held


def move_nodes(mesh, points):
    """Moves nodes in Gmsh's current model, and also in `mesh`, which was made from that model."""
    tags = gmsh.model.mesh.getNodes()[0]
    for n in np.flatnonzero(np.any(points != mesh.points, axis=1)):
        gmsh.model.mesh.setNode(tags[n], points[n], [])
    mesh.points[:] = points      # the surfaces of the mesh share these points


def prepare(domain, nodes):
    """Draws the image of regions that share surfaces, and raises Thin if some of them are too thin for the image or need too many nodes. This takes only
    seconds, and is therefore done before meshing is attempted."""
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
    """Returns a Thin error that names the regions without which a mesh of this many nodes would be possible: those that need the most nodes,
    excluding the body around them, and excluding the gland as long as there are others."""
    names, left, thin = [region.name for region in domain.regions], count, []
    for k in sorted(range(len(names) - domain.skin), key=lambda k: -domain.needed[k]):
        if left > MOST_OFF * nodes and domain.needed[k] > 0 and names[k] != domain.gland:
            thin.append(names[k])
            left -= count * domain.needed[k] / sum(domain.needed)
    return Thin(problem, thin or [domain.gland], 100 * math.ceil(count / 100))


def drawn(domain, fine):
    """Returns the image of the domain's regions, its pieces, the fractions of the parts that are lost, and the number of nodes that each region needs where
    it is thin."""
    image, pieces, lost = label_image.image_for([region.shells for region in domain.regions], fine, (domain.low, domain.high) if domain.skin else domain.crop, domain.skin)
    shells = [shell for region in domain.regions for shell in region.shells]
    needed = np.zeros(len(domain.regions))
    for piece, count in enumerate(labels.nodes_of_thin(pieces, shells, image.step, fine)):
        if pieces.regions[piece] != OUTSIDE:
            needed[pieces.regions[piece]] += count
    return image, pieces, lost, needed.tolist()


def generate(domain, nodes, path):
    """Meshes the domain with several element sizes, and writes the mesh of about this many nodes with the best angles. Returns it as an Attempt."""
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
        # many of the nodes lie on surfaces that regions share, so that their number scales more like the area than like the volume
        centre = fine * (count / nodes) ** (1 / 2 if domain.regions else 1 / 3)
        if rank[1]:      # part of a surface is missing, so this mesh is used only if no other attempt succeeds
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
    """Returns whether the number of nodes is far too large and larger elements have not reduced it, because the surfaces of thin regions need so many
    nodes."""
    return count > MOST_OFF * nodes and any(size < fine and MOST_OFF * nodes < fewer <= count for size, fewer in tries)


def size_between(tries, nodes):
    """Interpolates the element size for this many nodes between attempts (size, nodes) with more nodes and with fewer; returns None unless there are both."""
    more, fewer = [t for t in tries if t[1] > nodes], [t for t in tries if t[1] < nodes]
    if not more or not fewer:
        return None
    (fine, most), (coarse, least) = min(more, key=lambda t: t[1]), max(fewer, key=lambda t: t[1])
    return fine * (coarse / fine) ** (math.log(most / nodes) / math.log(most / least))


def remarks_on_number(mesh, nodes):
    """Returns remarks for the report if the mesh does not have about the desired number of nodes."""
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
    """Returns the name of the region (or the bones) with the most nodes on its surface, and the number of these nodes."""
    surfaces = {name: mesh.boundary(name) for name in mesh.regions if name != "surrounding"}
    if "bone" in mesh.surfaces:
        surfaces["bone"] = mesh.surfaces["bone"]
    return max(((name, len(np.unique(surface.triangles))) for name, surface in surfaces.items()), key=lambda pair: pair[1])
