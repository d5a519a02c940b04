"""A tissue for the checks in Python: its mesh, consistent nodal loads, and its displacements computed with the core or with CalculiX.

Arrays: nodes (n, 3), m; tets (t, 4); forces (n, 3), N; displacements (n, 3), m. A material is a pair (E in Pa, nu).
"""
import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from rows import SKIPPED  # noqa: E402

try:
    import gmsh
except ImportError:
    print("needs Debian's python3-gmsh")
    sys.exit(SKIPPED)
if not shutil.which("ccx"):
    print("needs Debian's calculix-ccx")
    sys.exit(SKIPPED)

TETRAHEDRON, TRIANGLE = 4, 2  # Gmsh's element types
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))  # edges of a tetrahedron, in the order of a C3D10's mid-side nodes


@dataclass
class Model:
    path: Path      # of the mesh file, for the core
    nodes: np.ndarray
    tets: np.ndarray
    regions: dict   # name of each region -> indices of its tetrahedra
    surfaces: dict  # name of each surface -> its triangles (k, 3)


# ---- meshes ----

def start_gmsh():
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)


def finish_mesh(path, size, volumes, surfaces, optimize=False):
    """Meshes the shape with elements of this size, writes the file and reads it. Groups are given as name -> tags of entities; a name without tags gets no
    group."""
    for dimension, groups, first in ((3, volumes, 1), (2, surfaces, 8)):
        for number, (name, tags) in enumerate(groups.items(), first):
            if tags:
                gmsh.model.addPhysicalGroup(dimension, tags, number)
                gmsh.model.setPhysicalName(dimension, number, name)
    for option in ("MeshSizeMin", "MeshSizeMax"):
        gmsh.option.setNumber("Mesh." + option, size)
    gmsh.model.mesh.generate(3)
    if optimize:
        gmsh.model.mesh.optimize("")
    gmsh.write(str(path))
    gmsh.finalize()
    return read_mesh(path)


def faces_at(height):
    """Returns the tags of those faces of the shape whose centre is at this height."""
    return [tag for _, tag in gmsh.model.getEntities(2) if abs(gmsh.model.occ.getCenterOfMass(2, tag)[2] - height) < 1e-9]


def elements(dimension, kind, name_of):
    """Yields the name of each physical group of this dimension and its elements' node tags."""
    for dim, group in gmsh.model.getPhysicalGroups(dimension):
        tags = [gmsh.model.mesh.getElementsByType(kind, entity)[1]
                for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, group)]
        yield name_of(dim, group), np.concatenate(tags).astype(int).reshape(-1, dimension + 1)


def read_mesh(path):
    """Reads a mesh file into the core's node order: ascending tags, without unused nodes."""
    start_gmsh()
    gmsh.open(str(path))
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    position = dict(zip(tags.tolist(), coordinates.reshape(-1, 3)))
    regions = dict(elements(3, TETRAHEDRON, gmsh.model.getPhysicalName))
    surfaces = dict(elements(2, TRIANGLE, gmsh.model.getPhysicalName))
    gmsh.finalize()

    used = np.unique(np.concatenate([tets.ravel() for tets in regions.values()]))
    nodes = np.array([position[tag] for tag in used.tolist()])
    tets = np.searchsorted(used, np.concatenate(list(regions.values())))
    ends = np.cumsum([0] + [len(tets) for tets in regions.values()])
    regions = {name: np.arange(ends[i], ends[i + 1]) for i, name in enumerate(regions)}
    surfaces = {name: np.searchsorted(used, triangles) for name, triangles in surfaces.items()}
    volumes = np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]])
    tets[volumes < 0] = tets[volumes < 0][:, [0, 1, 3, 2]]
    return Model(Path(path), nodes, tets, regions, surfaces)


# ---- elements ----

def tet_rule(n=3):
    """Returns Gauss points (as barycentric coordinates) on a tetrahedron and their weights, which add up to 1/6: a conical product of n^3 points, exact up to
    degree 2 n - 3 (Stroud 1971)."""
    x, w = np.polynomial.legendre.leggauss(n)
    x, w = (x + 1) / 2, w / 2
    a, b, c = np.meshgrid(x, x, x, indexing="ij")
    weight = np.einsum("i,j,k->ijk", w, w, w) * (1 - a) ** 2 * (1 - b)
    p, q, r = a, (1 - a) * b, (1 - a) * (1 - b) * c
    return np.stack([1 - p - q - r, p, q, r], -1).reshape(-1, 4), weight.ravel()


def triangle_rule(n=6):
    """Returns Gauss points and weights on a triangle. These weights add up to 1/2."""
    x, w = np.polynomial.legendre.leggauss(n)
    x, w = (x + 1) / 2, w / 2
    a, b = np.meshgrid(x, x, indexing="ij")
    p, q = a, (1 - a) * b
    return np.stack([1 - p - q, p, q], -1).reshape(-1, 3), (np.outer(w, w) * (1 - a)).ravel()


def quadratic(weights, edges):
    """Returns the shape functions of corners and mid-side nodes from those of the corners."""
    corners = weights * (2 * weights - 1)
    return np.concatenate([corners, np.stack([4 * weights[:, i] * weights[:, j] for i, j in edges], -1)], -1)


def gradients(model):
    """Returns the gradients of the linear shape functions (t, 4, 3), 1/m, and the volumes (t), m^3."""
    x = model.nodes[model.tets]
    jacobian = x[:, 1:] - x[:, :1]
    inner = np.linalg.inv(jacobian).transpose(0, 2, 1)
    return np.concatenate([-inner.sum(1, keepdims=True), inner], 1), np.linalg.det(jacobian) / 6


def lame(material):
    e, nu = material
    return e * nu / (1 + nu) / (1 - 2 * nu), e / 2 / (1 + nu)


class Quadratic:
    """A model's mid-side nodes, numbered after the corner nodes."""

    def __init__(self, model):
        pairs = np.sort(np.concatenate([model.tets[:, edge] for edge in EDGES]), axis=1)
        self.pairs, index = np.unique(pairs, axis=0, return_inverse=True)
        n = len(model.nodes)
        self.nodes = np.concatenate([model.nodes, model.nodes[self.pairs].mean(1)])
        self.tets = np.concatenate([model.tets, n + index.reshape(6, -1).T], axis=1)

    def middles(self, triangles):
        """Returns the mid-side nodes of the triangles' edges 01, 12 and 20, shape (k, 3)."""
        n = len(self.nodes) - len(self.pairs)
        ends = np.sort(np.stack([triangles[:, e] for e in ((0, 1), (1, 2), (2, 0))], 1), axis=2)
        key = self.pairs[:, 0] * n + self.pairs[:, 1]
        return n + np.searchsorted(key, ends[..., 0] * n + ends[..., 1])


# ---- loads: consistent nodal forces (n, 3) ----

def assemble(count, elements, forces):
    """Adds forces of shape (elements, nodes of an element, 3) to the nodes."""
    total = np.zeros((count, 3))
    np.add.at(total, elements.ravel(), forces.reshape(-1, 3))
    return total


def body_load(model, density, order=1, middle=None):
    """Returns the nodal forces of a body force density(x) -> (..., 3), N/m^3. Elements are quadratic if `middle`, a Quadratic, is given."""
    points, weights = tet_rule(4)
    shape = points if order == 1 else quadratic(points, EDGES)
    volume6 = np.linalg.det(model.nodes[model.tets[:, 1:]] - model.nodes[model.tets[:, :1]])
    f = density(np.einsum("qa,tax->tqx", points, model.nodes[model.tets]))
    forces = np.einsum("q,t,qa,tqx->tax", weights, volume6, shape, f)
    nodes, tets = (model.nodes, model.tets) if order == 1 else (middle.nodes, middle.tets)
    return assemble(len(nodes), tets, forces)


def surface_load(model, triangles, traction, order=1, middle=None):
    """Returns the nodal forces of a traction(x) -> (..., 3), N/m^2, on these triangles."""
    points, weights = triangle_rule()
    shape = points if order == 1 else quadratic(points, ((0, 1), (1, 2), (2, 0)))
    x = model.nodes[triangles]
    area2 = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
    forces = np.einsum("q,t,qa,tqx->tax", weights, area2, shape, traction(np.einsum("qa,tax->tqx", points, x)))
    if order == 1:
        return assemble(len(model.nodes), triangles, forces)
    return assemble(len(middle.nodes), np.concatenate([triangles, middle.middles(triangles)], 1), forces)


def point_load(model, points, force):
    """Distributes the same force (3) at each point (k, 3) to the corners of the tetrahedron that contains it."""
    g, _ = gradients(model)
    total = np.zeros_like(model.nodes)
    for x in points:
        weights = np.einsum("tax,tx->ta", g, x - model.nodes[model.tets[:, 0]])
        weights[:, 0] += 1
        tet = np.argmax(weights.min(1))
        total[model.tets[tet]] += np.outer(weights[tet], force)
    return total


# ---- solutions: displacements (cases, n, 3) ----

def solve_core(rows, model, materials, fixed, cases, strain="patch", membranes=None, sliding=()):
    """Solves with trocar's core. `materials` is keyed by region name, `fixed` has names of groups, and `cases` has nodal forces. `strain` is the set over which
    volumetric strain is averaged: "patch", "node" or "element". `membranes` is keyed by surface name: (stiffness in N/m, nu). `sliding`: a surface, the region
    on one side, and the normal and shear stiffness (N/m^3); the nodes added there come last in the result."""
    lines = [f"strain {strain}"] + ([f"sliding {sliding[0]} {sliding[1]} {sliding[2]!r} {sliding[3]!r}"] if sliding else [])
    lines += [f"membrane {name} {stiffness!r} {nu!r}" for name, (stiffness, nu) in (membranes or {}).items()]
    lines += [f"material {name} {e!r} {nu!r}" for name, (e, nu) in materials.items()] + [f"fixed {name}" for name in fixed]
    for force in cases:
        loaded = np.flatnonzero(np.any(force != 0, axis=1))
        lines += ["case"] + [f"load {i} {force[i, 0]:.17g} {force[i, 1]:.17g} {force[i, 2]:.17g}" for i in loaded]
    program = rows.build / "tests" / "verification" / "solve_tissue"
    done = subprocess.run([program, model.path], input="\n".join(lines) + "\n", capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"solve_tissue: status {done.returncode}: {done.stderr}")
    values = np.array(done.stdout.split(), float).reshape(1 + len(cases), -1, 3)
    if not np.array_equal(values[0][:len(model.nodes)], model.nodes):
        sys.exit(f"{model.path}: solve_tissue orders the nodes differently from tissue_model.py")
    return values[1:]


MEMBRANE_THICKNESS = 1e-5  # m: CalculiX expands membranes to solids this thick, which must be thin beside the elements, but at 1e-7 digits are lost


def membrane_deck(model, membranes, middle=None):
    """Returns the membranes of CalculiX's input deck: M3D3, or M3D6 if `middle`, a Quadratic, is given."""
    number, kind = len(model.tets), "M3D6" if middle else "M3D3"
    for name, (stiffness, nu) in membranes.items():
        triangles = model.surfaces[name]
        nodes = np.concatenate([triangles, middle.middles(triangles)], 1) if middle else triangles
        yield f"*ELEMENT, TYPE={kind}, ELSET={name}"
        yield from (",".join(map(str, [number + i] + row)) for i, row in enumerate((nodes + 1).tolist(), 1))
        yield f"*MATERIAL, NAME={name}\n*ELASTIC\n{stiffness / MEMBRANE_THICKNESS:.13e},{nu:.13e}"
        yield f"*MEMBRANE SECTION, ELSET={name}, MATERIAL={name}\n{MEMBRANE_THICKNESS}"
        number += len(triangles)


def deck(nodes, tets, kind, regions, materials, membranes, fixed, cases):
    """Returns CalculiX's input deck, including the lines of `membranes`. CalculiX reads at most twenty characters per number."""
    yield "*NODE, NSET=ALL"
    yield from (f"{i},{x:.13e},{y:.13e},{z:.13e}" for i, (x, y, z) in enumerate(nodes.tolist(), 1))
    for name, members in regions.items():
        yield f"*ELEMENT, TYPE={kind}, ELSET={name}"
        yield from (",".join(map(str, [t + 1] + (tets[t] + 1).tolist())) for t in members.tolist())
        e, nu = materials[name]
        yield f"*MATERIAL, NAME={name}\n*ELASTIC\n{e:.13e},{nu:.13e}"
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={name}"
    yield from membranes
    yield "*BOUNDARY"
    yield from (f"{i + 1},1,3" for i in fixed)
    for force in cases:
        yield "*STEP\n*STATIC\n*CLOAD, OP=NEW"
        for axis in range(3):
            yield from (f"{i + 1},{axis + 1},{force[i, axis]:.13e}" for i in np.flatnonzero(force[:, axis]))
        yield "*NODE PRINT, NSET=ALL\nU\n*END STEP"


def tied_normals(pairs):
    """Returns the lines of CalculiX's input deck that give pairs of nodes the same displacement along a normal; a pair is (node, node, unit normal)."""
    for one, other, normal in pairs:
        order = np.argsort(-np.abs(normal))      # CalculiX eliminates an equation's first displacement
        terms = [f"{node + 1},{axis + 1},{sign * normal[axis]:.12e}" for node, sign in ((other, 1), (one, -1)) for axis in order]
        yield from ("*EQUATION", "6", ",".join(terms[:4]), ",".join(terms[4:]))


def run_calculix(lines):
    """Returns the .dat file that CalculiX writes for an input deck."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "model.inp").write_text("\n".join(lines) + "\n")
        done = subprocess.run(["ccx", "model"], cwd=folder, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
        if done.returncode or "*ERROR" in done.stdout:
            sys.exit(f"ccx: status {done.returncode}: {done.stdout[-2000:]}{done.stderr}")
        return Path(folder, "model.dat").read_text()


def read_displacements(text, count):
    """Returns the displacements of all steps in a .dat file."""
    steps = []
    for line in text.splitlines():
        if line.lstrip().startswith("displacements"):
            steps.append(np.full((count, 3), np.nan))
        elif steps and line.strip():
            number, *u = line.split()
            steps[-1][int(number) - 1] = [float(v) for v in u]
    return np.array(steps)


def solve_calculix(model, materials, fixed, cases, middle=None, membranes=None):
    """Solves with CalculiX, using C3D4 and M3D3, or C3D10 and M3D6 if `middle`, a Quadratic, is given. CalculiX prints seven digits."""
    triangles = np.concatenate([model.surfaces[name] for name in fixed])
    held, nodes, tets, kind = triangles, model.nodes, model.tets, "C3D4"
    if middle:
        held, nodes, tets, kind = np.concatenate([triangles, middle.middles(triangles)]), middle.nodes, middle.tets, "C3D10"
    lines = deck(nodes, tets, kind, model.regions, materials, membrane_deck(model, membranes or {}, middle), np.unique(held), cases)
    return read_displacements(run_calculix(lines), len(nodes))
