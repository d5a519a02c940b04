#!/usr/bin/python3
"""Compares tissue whose membranes have in-plane stiffness with exact solutions and with CalculiX's membrane elements.

Patch test: in a block whose sides are membranes, the field u = d z has constant stress, also in the membranes, whose forces per length load the block's
edges. Every mesh must reproduce it. Stretching: with the same Poisson's ratio in block and membranes, the stresses of both are uniaxial, and the stiffness
is E A / L plus stiffness x perimeter / L. CalculiX: on the same mesh, C3D4 with M3D3 elements must give the same displacements; C3D10 with M3D6 elements
give those that trocar's must approach as the mesh becomes finer. A needle through a stiff skin: the forces on a rigid needle, which include the local
compliance, are compared with those of a needle whose surface is resolved (resolved_needle.json), where tissue and membrane are bonded to the needle.
"""
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / folder) for folder in (".", "references")]
import needle_meshes  # noqa: E402
import tissue_model as tm  # noqa: E402
from rows import REPOSITORY, Rows  # noqa: E402

EXACT, SAME = 1e-10, 1e-6
CLOSE = {"short": 0.1, "full": 0.05}  # linear elements of 7 and 4 mm under a traction over 12 mm; errors fall as the square of the size
SIDES = (0.06, 0.05, 0.06)            # m
TISSUE, STIFFNESS = 20e3, 300.0       # Pa, N/m: a membrane as stiff as 15 mm of tissue
SEVEN = "relative to the field's norm; CalculiX prints 7 digits"


def block(path, size):
    """Creates a block of two regions. The face z = 0 is fixed. The other faces are surfaces (x0: x = 0), as is the tilted interface."""
    tm.start_gmsh()
    occ = tm.gmsh.model.occ
    whole = occ.addBox(0, 0, 0, *SIDES)
    plane = occ.addRectangle(-0.1, -0.1, 0.03, 0.3, 0.3)
    occ.rotate([(2, plane)], 0.03, 0.025, 0.03, 1, 0.5, 0, 0.15)
    pieces, _ = occ.fragment([(3, whole)], [(2, plane)])
    occ.remove([piece for piece in pieces if piece[0] == 2], recursive=True)
    occ.synchronize()
    volumes = sorted((tag for _, tag in tm.gmsh.model.getEntities(3)), key=lambda tag: occ.getCenterOfMass(3, tag)[2])
    of = [{face for _, face in tm.gmsh.model.getBoundary([(3, tag)], oriented=False)} for tag in volumes]
    at = lambda axis, place: [tag for _, tag in tm.gmsh.model.getEntities(2) if abs(occ.getCenterOfMass(2, tag)[axis] - place) < 1e-9]
    sides = {f"{'xy'[axis]}{end}": at(axis, end * SIDES[axis]) for axis in (0, 1) for end in (0, 1)}
    return tm.finish_mesh(path, size, dict(zip(("bottom", "top"), ([tag] for tag in volumes))),
                          {"fixed": at(2, 0), "skin": at(2, SIDES[2]), "between": sorted(of[0] & of[1]), **sides})


# ---- exact solutions ----

def edges_of(model, name):
    """Returns the boundary edges of a plane surface (k, 2), their lengths, their outward normals in the plane, and the plane's normal."""
    triangles = model.surfaces[name]
    edges = np.sort(np.concatenate([triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))]), 1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    edges, middle = edges[count == 1], model.nodes[triangles].mean((0, 1))
    plane = np.eye(3)["xyz".index(name[0])]
    along = model.nodes[edges[:, 1]] - model.nodes[edges[:, 0]]
    length = np.linalg.norm(along, axis=1)
    normals = np.cross(along / length[:, None], plane)
    normals *= np.sign(np.einsum("ei,ei->e", normals, model.nodes[edges].mean(1) - middle))[:, None]
    return edges, length, normals, plane


def edge_load(model, name, membrane, gradient):
    """Returns the nodal forces of the constant membrane stress under the displacement gradient."""
    stiffness, nu = membrane
    edges, length, normals, plane = edges_of(model, name)
    flat = np.eye(3) - np.outer(plane, plane)
    strain = flat @ (gradient + gradient.T) @ flat / 2
    stress = stiffness / (1 - nu ** 2) * ((1 - nu) * strain + nu * np.trace(strain) * flat)
    force = length[:, None] * (normals @ stress) / 2
    return tm.assemble(len(model.nodes), edges, np.repeat(force[:, None], 2, axis=1))


def outward(model, triangles):
    x = model.nodes[triangles]
    area = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    return area * np.sign(np.einsum("ti,ti->t", area, x.mean(1) - np.array(SIDES) / 2))[:, None]


def face_load(model, gradient, nu):
    """Returns the nodal forces of the constant tissue stress under the displacement gradient."""
    triangles = np.concatenate([model.surfaces[name] for name in ("skin", "x0", "x1", "y0", "y1")])
    lam, mu = tm.lame((TISSUE, nu))
    strain = (gradient + gradient.T) / 2
    force = outward(model, triangles) @ (2 * mu * strain + lam * np.trace(strain) * np.eye(3)) / 3
    return tm.assemble(len(model.nodes), triangles, np.repeat(force[:, None], 3, axis=1))


def patch_test(rows, model):
    rows.section = "Membranes: patch test"
    fields = dict(zip(("shear in x", "shear in y", "stretch in z"), 0.02 * np.eye(3)))
    for nu, strain in ((0.0, "patch"), (0.3, "patch"), (0.45, "patch"), (0.45, "node"), (0.45, "element")):
        membranes = {name: (STIFFNESS * (1 + i), nu) for i, name in enumerate(("x0", "x1", "y0", "y1"))}
        gradients = [np.outer(d, [0, 0, 1]) for d in fields.values()]
        cases = [face_load(model, g, 0.3) + sum(edge_load(model, name, membrane, g) for name, membrane in membranes.items()) for g in gradients]
        found = tm.solve_core(rows, model, dict.fromkeys(model.regions, (TISSUE, 0.3)), ["fixed"], cases, strain, membranes)
        for (name, d), u in zip(fields.items(), found):
            exact = np.outer(model.nodes[:, 2], d)
            rows.error(f"{name}, nu of the membranes {nu}, strain by {strain}", "u = d z, every node", np.abs(u - exact).max() / np.abs(exact).max(), EXACT)


def stretching(rows, model):
    """Stretches the block with its sides free. nu is 0, because the fixed end cannot contract. The force is proportional to E A + stiffness x perimeter."""
    rows.section = "Membranes: stretched block"
    names, area, perimeter = ("x0", "x1", "y0", "y1"), SIDES[0] * SIDES[1], 2 * (SIDES[0] + SIDES[1])
    for stiffness in (0.0, 0.1 * STIFFNESS, STIFFNESS, 10 * STIFFNESS):
        whole = TISSUE * area + stiffness * perimeter
        gradient = np.outer([0, 0, 1], [0, 0, 1]) / whole   # of 1 N
        load = face_load(model, gradient, 0.0) + sum(edge_load(model, name, (stiffness, 0.0), gradient) for name in names)
        u = tm.solve_core(rows, model, dict.fromkeys(model.regions, (TISSUE, 0.0)), ["fixed"], [load], membranes={name: (stiffness, 0.0) for name in names})[0]
        rows.compare(f"elongation under 1 N, membranes of {stiffness:g} N/m", "L / (E A + stiffness x perimeter)", u[model.surfaces["skin"], 2].mean(),
                     SIDES[2] / whole, EXACT, "m")


# ---- CalculiX ----

def load_cases(model):
    """Returns forces on six nodes, and on all nodes."""
    random = np.random.default_rng(11)
    few, all_over = np.zeros_like(model.nodes), random.normal(size=model.nodes.shape)
    few[random.choice(len(model.nodes), 6, replace=False)] = random.normal(size=(6, 3))
    return [few, all_over]


def compare_linear(rows, name, model, materials, membranes):
    cases = load_cases(model)
    ours = tm.solve_core(rows, model, materials, ["fixed"], cases, "element", membranes)
    theirs = tm.solve_calculix(model, materials, ["fixed"], cases, membranes=membranes)
    for load, u, reference in zip(("six nodes loaded", "all nodes loaded"), ours, theirs):
        rows.error(f"{name}, {load}", "CalculiX, C3D4 and M3D3", np.linalg.norm(u - reference) / np.linalg.norm(reference), SAME, SEVEN)


def bump(x):
    """Returns a traction (N/m^2) that pulls the middle of the top sideways and presses it down."""
    size = np.exp(-((x[..., 0] - 0.03) ** 2 + (x[..., 1] - 0.025) ** 2) / 0.012 ** 2)
    return size[..., None] * np.array([500.0, 0.0, -100.0])


def compare_quadratic(rows, model):
    """Compares the core's displacements, with volumetric strain averaged as by default, with those of quadratic elements on the same mesh."""
    middle, materials = tm.Quadratic(model), {"bottom": (15e3, 0.45), "top": (30e3, 0.45)}
    membranes = {"skin": (STIFFNESS, 0.45), "between": (STIFFNESS, 0.3)}
    load, fine = (tm.surface_load(model, model.surfaces["skin"], bump, order, middle) for order in (1, 2))
    for given, name in (({}, "without membranes"), (membranes, "skin and interface of 300 N/m")):
        u = tm.solve_core(rows, model, materials, ["fixed"], [load], membranes=given)[0]
        reference = tm.solve_calculix(model, materials, ["fixed"], [fine], middle, given)[0]
        top, corners = np.unique(model.surfaces["skin"]), reference[:len(model.nodes)]
        rows.error(f"traction on the skin, {name}, {len(model.nodes)} nodes", "CalculiX, C3D10 and M3D6, same mesh",
                   np.linalg.norm((u - corners)[top]) / np.linalg.norm(corners[top]), CLOSE["short" if rows.short_form else "full"], "displacements of the skin, relative to their norm")
        yield np.abs(corners[top]).max()


# ---- a needle through the skin ----

NEEDLE_LIMIT = 0.05                   # largest permitted error, the same as for needles without a membrane (verify_resolution.py)
NEEDLE_NOTE = "tip 20 mm below the skin; without a membrane, the reference's mesh is 0.9 % too stiff sideways and 0.5 % axially"
SIZES = {"short": (0.0125,), "full": (0.0155, 0.0125, 0.0078, 0.0053)}   # m, element sizes


def through_the_skin(rows):
    rows.section = "Membranes: needle through a stiff skin, force for 1 mm"
    cases = {name: case for name, case in json.loads((REPOSITORY / "tests/verification/references/resolved_needle.json").read_text())["cases"].items() if "skin" in case}
    for size in SIZES["short" if rows.short_form else "full"]:
        mesh = rows.folder / "needle-through-skin.msh"
        needle_meshes.block(mesh, size)
        for case in cases.values():
            command = [rows.build / "tests/verification/rigid_needle", mesh, case["radius"], case["poisson_ratio"], *case["axis"], case["tip"],
                       case["youngs_modulus_above"], case["youngs_modulus_below"], "skin", *case["skin"]]
            printed = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True).stdout.split()
            for direction, value in (("sideways", printed[5]), ("axial", printed[6])):
                rows.compare(f"skin of {case['skin'][0]:g} N/m, {direction}, {printed[0]} nodes", "needle's surface resolved, CalculiX C3D10 and M3D6",
                             float(value), case["force"][direction], NEEDLE_LIMIT, "N", NEEDLE_NOTE)


def main():
    rows = Rows.from_arguments(__doc__, "Membranes")
    model = block(rows.folder / "membranes.msh", 0.012 if rows.short_form else 0.007)
    patch_test(rows, model)
    stretching(rows, model)
    rows.section = "Membranes: against CalculiX"
    two = {"bottom": (15e3, 0.3), "top": (30e3, 0.45)}
    compare_linear(rows, f"block of {len(model.nodes)} nodes, skin of 300 N/m", model, two, {"skin": (STIFFNESS, 0.3)})
    compare_linear(rows, "the same, interface of 3000 N/m", model, two, {"between": (10 * STIFFNESS, 0.45)})
    compare_linear(rows, "the same, skin of 30 and interface of 300 N/m", model, two, {"skin": (0.1 * STIFFNESS, 0.45), "between": (STIFFNESS, 0.0)})
    prostate = tm.read_mesh(REPOSITORY / "meshes" / "prostate-570.msh")
    compare_linear(rows, "prostate, curved capsule of 300 and skin of 100 N/m", prostate, {"prostate": (60e3, 0.45), "surrounding": (30e3, 0.45)},
                   {"capsule": (STIFFNESS, 0.45), "skin": (100.0, 0.45)})
    free, held = compare_quadratic(rows, block(rows.folder / "membranes-fine.msh", 0.007 if rows.short_form else 0.004))
    rows.measured("largest displacement of the skin with both membranes, relative to that without", "CalculiX, C3D10 and M3D6", held / free, None, 0.0)
    through_the_skin(rows)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
