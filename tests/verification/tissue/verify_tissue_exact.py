#!/usr/bin/python3
"""Compares the tissue with exact solutions: constant strain on an irregular mesh, and two manufactured trigonometric fields.

The first field, u = a sin(pi x/L) sin(pi y/L) sin(pi z/L), is zero on the cube's faces, which are all fixed; its body force is applied
consistently. Linear elements should converge with order 2 in the displacement and 1 in the energy norm (Strang and Fix 1973), for every
nu below 0.5. The order is that of the finest pair of meshes. Patches of elements are irregular, so that the error scatters by 7 % from mesh to mesh, and the
order of a pair by 0.15. With strain by patch, the order is therefore fitted to the errors on all meshes with 8 to 32 elements along an edge, in steps of 2.

The second field, curl (0, 0, sin^2 sin^2 sin^2), is divergence-free, so its load does not depend on lambda. At nu = 0.499, it shows locking: with strain by
element, 76 % of the displacement is missing on the mesh with 16 elements along an edge. Volumetric strain by patch is the default; strain by element is the
standard linear tetrahedron.
"""
import itertools
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import tissue_model as tm  # noqa: E402
from rows import Rows  # noqa: E402

SIDE = 0.1                            # m
CURL_AMPLITUDE = 1e-5                 # m^2
LOCKING_NU = 0.499
AMPLITUDE = np.array([1, -0.7, 0.4]) * 1e-3  # m
STRAINS = ("patch", "node", "element")  # the sets over which volumetric strain is averaged
YOUNGS_MODULUS = 20e3                 # Pa
ORDER_LIMIT = 0.05                    # permitted relative error in the observed order of convergence


def cube(path, size, fixed_faces):
    """Creates an unstructured mesh with elements of this size. `fixed_faces` decides from a face's centre whether the face is fixed."""
    tm.start_gmsh()
    occ = tm.gmsh.model.occ
    block = occ.addBox(0, 0, 0, SIDE, SIDE, SIDE)
    occ.synchronize()
    faces = {tag: occ.getCenterOfMass(2, tag) for _, tag in tm.gmsh.model.getEntities(2)}
    fixed = [tag for tag, centre in faces.items() if fixed_faces(centre)]
    return tm.finish_mesh(path, size, {"tissue": [block]}, {"fixed": fixed, "free": [tag for tag in faces if tag not in fixed]}, optimize=True)


# ---- patch test ----

def normals(model, triangles):
    """Returns the unit outward normals of triangles on the cube's surface."""
    x = model.nodes[triangles]
    n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    n *= np.sign(np.einsum("ti,ti->t", n, x.mean(1) - SIDE / 2))[:, None]
    return n / np.linalg.norm(n, axis=1)[:, None]


def stress_of(d, nu):
    """Returns the stress of the field u = d z."""
    lam, mu = tm.lame((YOUNGS_MODULUS, nu))
    strain = (np.outer(d, [0, 0, 1]) + np.outer([0, 0, 1], d)) / 2
    return 2 * mu * strain + lam * np.trace(strain) * np.eye(3)


def constant_traction(traction):
    """Returns a traction function that is a constant vector on each triangle."""
    return lambda x: np.broadcast_to(traction[:, None], x.shape)


def patch_test(rows):
    """u = d z vanishes on the fixed face, and its constant stress loads the other faces. Any mesh must reproduce it exactly."""
    rows.section = "Tissue: patch test"
    model = cube(rows.folder / "patch.msh", SIDE / 6, lambda centre: centre[2] < 1e-9)
    triangles = model.surfaces["free"]
    n = normals(model, triangles)
    fields = dict(zip(("shear in x", "shear in y", "stretch in z"), 0.02 * np.eye(3)))
    for nu, strain in itertools.product((0.3, 0.45, 0.499), STRAINS):
        cases = [tm.surface_load(model, triangles, constant_traction(n @ stress_of(d, nu))) for d in fields.values()]
        found = tm.solve_core(rows, model, {"tissue": (YOUNGS_MODULUS, nu)}, ["fixed"], cases, strain)
        for (name, d), u in zip(fields.items(), found):
            exact = np.outer(model.nodes[:, 2], d)
            error = np.abs(u - exact).max() / np.abs(exact).max()
            rows.error(f"{name}, nu = {nu}, strain by {strain}", "u = d z, every node", error, 1e-10)


# ---- manufactured solutions ----

@dataclass
class Solution:
    displacement: Callable  # function of x (..., 3), all in metres
    gradient: Callable      # function of x that returns du_i / dx_j
    body_force: Callable    # function of the material that returns a function of x, N/m^3


def field(x):
    s, c = np.sin(np.pi * x / SIDE), np.cos(np.pi * x / SIDE)
    return s, c, s.prod(-1)


def exact(x):
    return field(x)[2][..., None] * AMPLITUDE


def exact_gradient(x):
    """du_i / dx_j."""
    s, c, _ = field(x)
    k = np.pi / SIDE
    slope = k * np.stack([c[..., 0] * s[..., 1] * s[..., 2], s[..., 0] * c[..., 1] * s[..., 2],
                          s[..., 0] * s[..., 1] * c[..., 2]], -1)
    return AMPLITUDE[:, None] * slope[..., None, :]


def body_force(material):
    """Returns -div sigma = -mu laplace u - (lambda + mu) grad div u."""
    lam, mu = tm.lame(material)

    def density(x):
        s, c, product = field(x)
        k2 = (np.pi / SIDE) ** 2
        hessian = np.empty(x.shape + (3,))
        for i in range(3):
            for j in range(3):
                other = 3 - i - j
                hessian[..., i, j] = -k2 * product if i == j else k2 * c[..., i] * c[..., j] * s[..., other]
        return 3 * mu * k2 * product[..., None] * AMPLITUDE - (lam + mu) * hessian @ AMPLITUDE
    return density


TRIGONOMETRIC = Solution(exact, exact_gradient, body_force)


def curl_factor(x, order):
    """Returns the derivative of this order of sin^2(pi x / L)."""
    k = 2 * np.pi / SIDE
    if order == 0:
        return (1 - np.cos(k * x)) / 2
    return k ** order / 2 * np.sin(k * x + (order - 1) * np.pi / 2)


def curl_part(x, orders):
    """Returns the derivative of these orders in x, y and z of phi = sin^2 sin^2 sin^2."""
    return np.prod([curl_factor(x[..., axis], order) for axis, order in enumerate(orders)], axis=0)


def curl_derivative(x, extra):
    """Returns the derivative of orders `extra` in x, y and z of u = curl (0, 0, phi)."""
    u = [curl_part(x, np.add((0, 1, 0), extra)), -curl_part(x, np.add((1, 0, 0), extra)), 0 * x[..., 0]]
    return CURL_AMPLITUDE * np.stack(u, -1)


def curl_force(material):
    """Returns the body force. Lambda has no effect, because div u is zero."""
    return lambda x: -tm.lame(material)[1] * sum(curl_derivative(x, 2 * orders) for orders in np.eye(3, dtype=int))


DIVERGENCE_FREE = Solution(lambda x: curl_derivative(x, (0, 0, 0)),
                           lambda x: np.stack([curl_derivative(x, orders) for orders in np.eye(3, dtype=int)], -1), curl_force)


def energy_density(material, gradient):
    lam, mu = tm.lame(material)
    strain = (gradient + np.swapaxes(gradient, -1, -2)) / 2
    return mu * np.einsum("...ij,...ij->...", strain, strain) + lam / 2 * np.einsum("...ii->...", strain) ** 2


def errors(model, material, u, solution=TRIGONOMETRIC):
    """Returns the relative errors in the L2 norm and in the energy norm."""
    points, weights = tm.tet_rule(4)
    g, volume = tm.gradients(model)
    x = np.einsum("qa,tax->tqx", points, model.nodes[model.tets])
    difference = np.einsum("qa,tax->tqx", points, u[model.tets]) - solution.displacement(x)
    strain_difference = np.einsum("tai,taj->tij", u[model.tets], g)[:, None] - solution.gradient(x)

    def integral(values):
        return np.einsum("q,t,tq->", 6 * weights, volume, values)
    l2 = integral((difference ** 2).sum(-1)) / integral((solution.displacement(x) ** 2).sum(-1))
    energy = integral(energy_density(material, strain_difference)) / integral(energy_density(material, solution.gradient(x)))
    return np.sqrt(l2), np.sqrt(energy)


def observed(rows, models, nu, strain, solution):
    """Returns the errors, shape (models, 2), and the orders of convergence in both norms (2), once for the finest pair and once fitted to all models."""
    material, found = (YOUNGS_MODULUS, nu), []
    for model in models:
        load = tm.body_load(model, solution.body_force(material))
        u = tm.solve_core(rows, model, {"tissue": material}, ["fixed"], [load], strain)[0]
        found.append(errors(model, material, u, solution))
    size = np.log([element_size(model) for model in models])
    found = np.array(found)
    return found, np.log(found[-2] / found[-1]) / (size[-2] - size[-1]), np.polyfit(size, np.log(found), 1)[0]


def element_size(model):
    return (SIDE ** 3 / len(model.tets)) ** (1 / 3)


def note(models, found):
    return "errors " + ", ".join(f"{e:.2g}" for e in found) + f" at {len(models[-1].nodes)} nodes and coarser"


def convergence(rows, models, nu, strain):
    found, pair, fitted = observed(rows, models, nu, strain, TRIGONOMETRIC)
    order = fitted if strain == "patch" else pair
    for column, (norm, expected) in enumerate((("L2 norm", 2), ("energy norm", 1))):
        short_by = 1 - order[column] / expected
        if strain == "element":
            error, reference = abs(short_by), "linear elements"
        else:  # theory only bounds this element's error from above, so it may converge faster
            error, reference = max(0.0, short_by), "at least linear elements"
        rows.add(f"order in the {norm}, nu = {nu}, strain by {strain}", reference, order[column], expected, error,
                 ORDER_LIMIT, note=note(models, found[:, column]))
        rows.curve("tissue-convergence", f"{norm}, nu = {nu}, strain by {strain}", 1e3 * np.array([element_size(m) for m in models]),
                   found[:, column], "element size: cube root of the mean volume (mm)", "relative error", logarithmic=True)


def locking(rows, models, strains):
    """Applies the load of the divergence-free field, which does not depend on lambda. An element that locks hardly moves as nu approaches 0.5."""
    rows.section = "Tissue: divergence-free field"
    for strain in strains:
        found, order, _ = observed(rows, models, LOCKING_NU, strain, DIVERGENCE_FREE)
        rows.add(f"order in the L2 norm, nu = {LOCKING_NU}, strain by {strain}", "at least linear elements that do not lock",
                 order[0], 2, max(0.0, 1 - order[0] / 2), ORDER_LIMIT, note=note(models, found[:, 0]))


def main():
    rows = Rows.from_arguments(__doc__, "")
    patch_test(rows)
    rows.section = "Tissue: manufactured solution"
    finest = 16 if rows.short_form else 32
    all_models = {n: cube(rows.folder / f"cube-{n}.msh", SIDE / n, lambda centre: True) for n in (4, *range(8, finest + 1, 2))}
    models = [all_models[n] for n in (4, 8, 16, 32) if n <= finest]
    averaged, plain_nu = (("patch",), (0.3,)) if rows.short_form else (("patch", "node"), (0.3, 0.45))
    for nu, strain in [(nu, "element") for nu in plain_nu] + [(0.45, strain) for strain in averaged]:
        convergence(rows, [all_models[n] for n in all_models if n >= 8] if strain == "patch" else models, nu, strain)
    locking(rows, models[1:], averaged)
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
