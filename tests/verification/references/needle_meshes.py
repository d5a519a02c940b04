"""Creates various meshes of the block in resolved_needle.py, for checking the force on a rigid needle.

The block measures 120 x 120 x 100 mm: |x|, |y| <= 60 mm; z = 0 is the surface `fixed`, and in Gmsh's meshes z = 100 mm is the surface `skin`. There is one region, "upper", or two, "lower" and "upper", separated by
a face at z = 50 mm.
"""
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from rows import REPOSITORY, SKIPPED  # noqa: E402

try:
    import gmsh
except ImportError:
    print("skipped: python3-gmsh is not installed")
    sys.exit(SKIPPED)

HALF_WIDTH, HEIGHT = 0.060, 0.100
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))  # the face opposite each corner


# ---- by Gmsh -----------------------------------------------------------------------------------------------------------

def set_field(expression):
    """Sets the element sizes by an expression in x, y and z only."""
    sizes = gmsh.model.mesh.field.add("MathEval")
    gmsh.model.mesh.field.setString(sizes, "F", expression)
    gmsh.model.mesh.field.setAsBackgroundMesh(sizes)
    for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber("Mesh." + option, 0)


def block(path, size, layered=False, field=None):
    """Creates an unstructured mesh of the block. `size` is the element size or, if `field` (an expression in x, y and z) is given, the largest one."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    heights = (0.05, 0.05) if layered else (0.1,)
    boxes = [(3, occ.addBox(-0.06, -0.06, sum(heights[:i]), 0.12, 0.12, height)) for i, height in enumerate(heights)]
    if layered:
        occ.fragment(boxes[:1], boxes[1:])
    occ.synchronize()
    for tag, name in zip((tag for _, tag in gmsh.model.getEntities(3)), ("lower", "upper")):
        gmsh.model.addPhysicalGroup(3, [tag], tag)
        gmsh.model.setPhysicalName(3, tag, name if layered else "upper")
    for number, name, height in ((9, "fixed", 0.0), (10, "skin", HEIGHT)):
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2) if abs(occ.getCenterOfMass(2, tag)[2] - height) < 1e-9], number)
        gmsh.model.setPhysicalName(2, number, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    if field:
        set_field(field)
    else:
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("")
    gmsh.write(str(path))
    gmsh.finalize()


def graded(path, at_skin, at_tip, axis, tip):
    """Meshes the block with element sizes that go from `at_skin` to `at_tip` in a geometric progression along the needle's line, and grow by 0.35 times the
    distance from it."""
    rate = np.log(at_tip / at_skin) / (tip - HEIGHT)
    block(path, 0.02, field=f"{at_skin}*exp({rate}*(z-{HEIGHT})) + 0.35*sqrt((x-{axis[0]})^2+(y+{-axis[1]})^2)")


def read(path):
    """Returns the nodes and tetrahedra of the mesh."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(path))
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    corners = np.array(gmsh.model.mesh.getElementsByType(4)[1]).reshape(-1, 4)
    gmsh.finalize()
    row = np.zeros(int(max(tags)) + 1, int)
    row[tags.astype(int)] = np.arange(len(tags))
    return coordinates.reshape(-1, 3), row[corners.astype(int)]


# ---- by numpy ----------------------------------------------------------------------------------------------------------

def msh(nodes, groups, elements):
    """Returns the text of a Gmsh file. `groups`: dimension, number and name of each group. `elements`: Gmsh's type, group and nodes of each element."""
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", str(len(groups)), *(f'{dim} {number} "{name}"' for dim, number, name in groups),
             "$EndPhysicalNames", "$Nodes", str(len(nodes)), *(f"{i} {x:.17g} {y:.17g} {z:.17g}" for i, (x, y, z) in enumerate(nodes.tolist(), 1)), "$EndNodes",
             "$Elements", str(len(elements)),
             *(f"{i} {kind} 2 {group} {group} {' '.join(str(1 + node) for node in corners)}" for i, (kind, group, corners) in enumerate(elements, 1)),
             "$EndElements", ""]
    return "\n".join(lines)


def write(path, nodes, tets, lower=None):
    """Writes the mesh. `lower` says for each tetrahedron whether it belongs to the region of that name."""
    tets = np.array(tets)
    mirrored = np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]]) < 0
    tets[mirrored] = tets[mirrored][:, [1, 0, 2, 3]]
    used, tets = np.unique(tets, return_inverse=True)
    nodes, tets = nodes[used], tets.reshape(-1, 4)
    floor = np.concatenate([tets[:, face] for face in FACES])
    floor = floor[np.abs(nodes[floor][..., 2]).max(axis=1) < 1e-9]
    region = np.where(lower, 2, 1) if lower is not None else np.ones(len(tets), int)
    elements = [(2, 9, face) for face in floor.tolist()] + [(4, group, tet) for group, tet in zip(region.tolist(), tets.tolist())]
    path.write_text(msh(nodes, ((3, 1, "upper"), (3, 2, "lower"), (2, 9, "fixed")), elements))


# A cell's corners are numbered 4 x + 2 y + z. Kuhn's division follows the six paths along edges from corner 0 to corner 7. The division into five has a regular
# tetrahedron and four corner tetrahedra, and is mirrored in every other cell.
KUHN = [(0, a, a | b, 7) for a in (1, 2, 4) for b in (1, 2, 4) if a != b]
FIVE = ([(0, 3, 5, 6), (1, 0, 3, 5), (2, 0, 3, 6), (4, 0, 5, 6), (7, 3, 5, 6)], [(1, 2, 4, 7), (0, 1, 2, 4), (3, 1, 2, 7), (5, 1, 4, 7), (6, 2, 4, 7)])


def structured(kind, cells, low=(-HALF_WIDTH, -HALF_WIDTH, 0.0), high=(HALF_WIDTH, HALF_WIDTH, HEIGHT)):
    """Returns nodes and tetrahedra of a grid of (nx, ny, nz) cells, each divided into six ("Kuhn") or five ("five") tetrahedra."""
    grid = np.meshgrid(*(np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells)), indexing="ij")
    nodes = np.stack([axis.ravel() for axis in grid], axis=1)
    cell = np.stack(np.meshgrid(*(np.arange(n) for n in cells), indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.array([(i >> 2, i >> 1 & 1, i & 1) for i in range(8)])
    number = np.ravel_multi_index(np.moveaxis(cell[:, None] + corner, -1, 0), [n + 1 for n in cells])
    if kind == "Kuhn":
        return nodes, number[:, KUHN].reshape(-1, 4)
    odd = cell.sum(axis=1) % 2 == 1
    return nodes, np.concatenate([number[odd == turned][:, FIVE[turned]].reshape(-1, 4) for turned in (0, 1)])


def volumes(nodes, tets):
    return np.linalg.det(nodes[tets[:, 1:]] - nodes[tets[:, :1]]) / 6


def with_slivers(nodes, tets, left, seed=3):
    """Moves every other node inside the block in a random direction until one of its tetrahedra is left with only the fraction `left` of its volume."""
    random, nodes = np.random.default_rng(seed), nodes.copy()
    volume = volumes(nodes, tets)
    tets = np.where((volume < 0)[:, None], tets[:, [1, 0, 2, 3]], tets)
    inside = np.flatnonzero((np.abs(nodes[:, :2]).max(axis=1) < HALF_WIDTH - 1e-9) & (nodes[:, 2] > 1e-9) & (nodes[:, 2] < HEIGHT - 1e-9))
    for node in random.permutation(inside)[: len(inside) // 2]:
        mine = tets[(tets == node).any(axis=1)]
        before, way = volumes(nodes, mine), random.normal(size=3)
        shifted = nodes.copy()
        shifted[node] += way
        slope = volumes(shifted, mine) - before
        nodes[node] += way * ((1 - left) * before[slope < 0] / -slope[slope < 0]).min()
    return nodes, tets


def least_angle(nodes, tets):
    """Returns the smallest dihedral angle of each tetrahedron, in degrees."""
    x = nodes[tets]
    normal = np.stack([np.cross(x[:, b] - x[:, a], x[:, c] - x[:, a]) for a, b, c in FACES], axis=1)
    normal /= np.linalg.norm(normal, axis=2)[..., None]
    cosine = -np.einsum("tid,tjd->tij", normal, normal)
    return np.degrees(np.arccos(np.clip(cosine[:, *np.triu_indices(4, 1)], -1, 1))).min(axis=1)


# ---- a patient's -------------------------------------------------------------------------------------------------------

def patient(folder, nodes):
    """Returns nodes and tetrahedra of the synthetic patient's prostate and surrounding tissue, meshed by scripts/anatomy without bones. The bounding box is
    stretched to fit the block, with the skin on top."""
    prefix = folder / f"patient-{nodes}"
    made = subprocess.run([REPOSITORY / "scripts/anatomy", REPOSITORY / "meshes/synthetic.dcm", "--roi", "Prostate", "--nodes", str(nodes), "--output", prefix],
                          capture_output=True, text=True)
    if made.returncode:
        sys.exit(f"scripts/anatomy: {made.stdout[-500:]}{made.stderr}")
    x, tets = read(f"{prefix}.msh")
    low, high = x.min(axis=0), x.max(axis=0)
    x = 2 * (x - low) / (high - low) - 1
    return np.stack([HALF_WIDTH * x[:, 0], HALF_WIDTH * x[:, 1], 0.5 * HEIGHT * (1 - x[:, 2])], axis=1), tets
