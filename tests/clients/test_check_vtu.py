#!/usr/bin/python3
"""Tests check_vtu.py on a case solved by hand: it must accept the solution and reject every damaged copy. A block of two materials, fixed at z = 0, has the
displacement u = a(z) with a constant slope in each layer and a traction that is continuous between the layers. All other sides carry the traction of that
stress.
"""
import contextlib
import io
import itertools
import os
import tempfile
import unittest

import numpy as np

import check_vtu

SIZE = np.array([0.02, 0.03, 0.04])       # m
CELLS = 2                                 # cells along each axis; the layers meet at half the height
LAYERS = ((20e3, 0.3), (50e3, 0.45))      # Pa, Poisson's ratio
MEMBRANE = (400.0, 0.3)                   # stiffness (N/m) and Poisson's ratio of the membrane on the side x = 0


def lame(youngs_modulus, poisson_ratio):
    return (youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio)),
            youngs_modulus / (2 * (1 + poisson_ratio)))


def slopes():
    """Returns du/dz (x, y, z) of each layer such that the shear stresses and the normal stress along z are continuous."""
    (lambda_0, mu_0), (lambda_1, mu_1) = (lame(*layer) for layer in LAYERS)
    first = np.array([0.02, -0.01, 0.015])
    shear, normal = mu_0 / mu_1, (lambda_0 + 2 * mu_0) / (lambda_1 + 2 * mu_1)
    return first, first * [shear, shear, normal]


def stress(layer):
    gradient = np.zeros((3, 3))
    gradient[:, 2] = slopes()[layer]
    lambda_, mu = lame(*LAYERS[layer])
    return lambda_ * np.trace(gradient) * np.eye(3) + mu * (gradient + gradient.T)


def block():
    """Returns the points, the Kuhn tetrahedra and each tetrahedron's layer."""
    side = CELLS + 1
    points = np.array([[i, j, k] for k in range(side) for j in range(side) for i in range(side)]) / CELLS * SIZE
    tets, layer = [], []
    for k, j, i in itertools.product(range(CELLS), repeat=3):
        for order in itertools.permutations(range(3)):
            at, corners = [i, j, k], []
            for axis in (*order, None):
                corners.append(at[0] + side * (at[1] + side * at[2]))
                if axis is not None:
                    at[axis] += 1
            a, b, c, d = points[corners]
            if np.dot(b - a, np.cross(c - a, d - a)) < 0:
                corners[2], corners[3] = corners[3], corners[2]
            tets.append(corners)
            layer.append(0 if k < CELLS // 2 else 1)
    return points, np.array(tets), np.array(layer)


def tractions(points, tets, layer):
    """Returns the nodal forces that the stress exerts on all outer faces except those at z = 0."""
    forces, centre = np.zeros_like(points), SIZE / 2
    for tet, number in zip(tets, layer):
        for face in itertools.combinations(tet, 3):
            a, b, c = points[list(face)]
            outer = [axis for axis in range(3) if a[axis] == b[axis] == c[axis] and a[axis] in (0, SIZE[axis])]
            if not outer or (outer == [2] and a[2] == 0):
                continue
            area = np.cross(b - a, c - a) / 2
            area *= np.sign(np.dot(area, a - centre))
            forces[list(face)] += stress(number) @ area / 3
    return forces


def solved_case():
    """Returns all arrays of both files."""
    points, tets, layer = block()
    low, high = np.minimum(points[:, 2:], SIZE[2] / 2), np.maximum(points[:, 2:] - SIZE[2] / 2, 0)
    applied, fixed = tractions(points, tets, layer), points[:, 2] == 0
    applied[fixed] = 0
    line = np.array([[0.01, 0.01, -0.05], [0.011, 0.01, 0.0], [0.012, 0.012, 0.03]])
    force = np.array([[0, 0, 0], [0.1, -0.2, 0.3], [0, 0, 0]])
    force[2] = -applied.sum(axis=0) - force[1]
    return {
        "points": points, "tets": tets, "displacement": low * slopes()[0] + high * slopes()[1], "applied_force": applied,
        "fixed": fixed.astype(float), "region": layer, "youngs_modulus": np.array(LAYERS)[layer, 0],
        "poisson_ratio": np.array(LAYERS)[layer, 1], "line": line, "force": force, "arc_length": np.array([0, 0.05, 0.08]),
        "base_position": line[:1], "base_force": force.sum(axis=0, keepdims=True),
        "base_torque": np.cross(line - line[0], force).sum(axis=0, keepdims=True)}


def membrane_case():
    """Returns the solved case with a membrane on the side x = 0. In its plane it has the layers' strain, and therefore a constant stress in each layer. Its
    forces per length load the sides y = 0, y = SIZE and z = SIZE, and the interface."""
    case = solved_case()
    points, tets, stiffness, nu = case["points"], case["tets"], *MEMBRANE
    triangles = np.array([face for tet in tets for face in itertools.combinations(tet, 3) if np.all(points[list(face), 0] == 0)])
    case["triangles"], case["applied_force"] = triangles, case["applied_force"].copy()
    for a, b in {tuple(sorted(edge)) for face in triangles.tolist() for edge in itertools.combinations(face, 2)}:
        for c in (c for face in triangles.tolist() if a in face and b in face for c in face if c not in (a, b)):
            slope = slopes()[int(points[[a, b, c], 2].mean() > SIZE[2] / 2)]
            n = stiffness / (1 - nu ** 2) * np.array([[nu * slope[2], (1 - nu) / 2 * slope[1]], [(1 - nu) / 2 * slope[1], slope[2]]])  # y, z
            along = points[b, 1:] - points[a, 1:]
            across = np.array([along[1], -along[0]])
            across *= np.sign(across @ (points[a, 1:] - points[c, 1:]))
            for node in (a, b):
                if not case["fixed"][node]:
                    case["applied_force"][node, 1:] += n @ across / 2
    case["force"][2] += -case["applied_force"].sum(axis=0) - case["force"].sum(axis=0)
    case["base_force"] = case["force"].sum(axis=0, keepdims=True)
    case["base_torque"] = np.cross(case["line"] - case["line"][0], case["force"]).sum(axis=0, keepdims=True)
    return case


def data_array(name, values):
    values = np.asarray(values)
    components = values.shape[1] if values.ndim > 1 else 1
    text = " ".join(repr(float(v)) for v in values.flat)
    return f'<DataArray type="Float64" Name="{name}" NumberOfComponents="{components}" format="ascii">{text}</DataArray>'


def write_vtu(path, points, cells, cell_type, point_data, cell_data, field):
    def section(tag, arrays):
        return f"<{tag}>" + "".join(data_array(name, values) for name, values in arrays.items()) + f"</{tag}>"
    offsets = np.cumsum([len(cell) for cell in cells])
    with open(path, "w", encoding="ascii") as file:
        file.write('<?xml version="1.0"?><VTKFile type="UnstructuredGrid"><UnstructuredGrid>' + section("FieldData", field)
                   + f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">' + section("PointData", point_data)
                   + section("CellData", cell_data) + section("Points", {"Points": points})
                   + section("Cells", {"connectivity": np.concatenate(cells), "offsets": offsets,
                                       "types": np.full(len(cells), cell_type)})
                   + "</Piece></UnstructuredGrid></VTKFile>")


def write_case(case, prefix):
    def pick(*names):
        return {name: case[name] for name in names}
    write_vtu(prefix + "-tissue.vtu", case["points"], case["tets"], 10, pick("displacement", "applied_force", "fixed"),
              pick("region", "youngs_modulus", "poisson_ratio", *(["volumetric_patch"] if "volumetric_patch" in case else [])), {})
    write_vtu(prefix + "-needle.vtu", case["line"], [range(len(case["line"]))], 4, pick("force", "arc_length"), {},
              pick("base_position", "base_force", "base_torque"))


def write_membranes(case, prefix):
    count = len(case["triangles"])
    write_vtu(prefix + "-membranes.vtu", case["points"], case["triangles"], 5, {"displacement": case["displacement"]},
              {"stiffness": np.full(count, MEMBRANE[0]), "poisson_ratio": np.full(count, MEMBRANE[1])}, {})


class CheckVtu(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)
        self.prefix = os.path.join(self.directory.name, "case")

    def verdict(self, case, **options):
        write_case(case, self.prefix)
        if "triangles" in case:
            write_membranes(case, self.prefix)
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            good = check_vtu.check(self.prefix, **options)
        return good, printed.getvalue()

    def test_the_solution_is_accepted(self):
        good, printed = self.verdict(solved_case(), volume=float(np.prod(SIZE)))
        self.assertTrue(good, printed)

    def test_each_spoilt_value_is_refused_in_its_row(self):
        free = np.argmax(solved_case()["points"][:, 2])
        spoils = {
            "displacement of fixed nodes": lambda c: c["displacement"].__setitem__((0, 0), 1e-12),
            "K u - f": lambda c: c["displacement"].__setitem__((free, 1), c["displacement"][free, 1] + 1e-9),
            "K u - f on free nodes": lambda c: c["youngs_modulus"].__setitem__(0, 20001.0),
            "K u - f on free": lambda c: c["poisson_ratio"].__setitem__(40, 0.4501),
            "least volume": lambda c: c["tets"].__setitem__(3, c["tets"][3][[1, 0, 2, 3]]),
            "tetrahedra on one face": lambda c: c["tets"].__setitem__(3, c["tets"][4]),
            "fixed nodes": lambda c: c["fixed"].__imul__(0),
            "base force": lambda c: c["base_force"].__imul__(1 + 1e-5),
            "base torque": lambda c: c["base_torque"].__imul__(1 + 1e-4),
            "arc length": lambda c: c["arc_length"].__setitem__(1, 0.09),
            "action + reaction": lambda c: c["force"].__setitem__((2, 0), c["force"][2, 0] * (1 + 1e-7)),
        }
        for row, spoil in spoils.items():
            with self.subTest(row):
                case = solved_case()
                spoil(case)
                good, printed = self.verdict(case)
                self.assertFalse(good)
                self.assertTrue(any(line.startswith("FAIL") and row in line for line in printed.splitlines()), printed)

    def test_a_wrong_volume_is_refused(self):
        self.assertFalse(self.verdict(solved_case(), volume=float(np.prod(SIZE)) * 1.001)[0])

    def test_a_case_without_load_is_accepted_only_on_demand(self):
        case = solved_case()
        for name in ("displacement", "applied_force", "force", "base_force", "base_torque"):
            case[name] = case[name] * 0
        self.assertFalse(self.verdict(case)[0])
        self.assertTrue(self.verdict(case, unloaded=True)[0])

    def test_strain_is_averaged_over_the_patches(self):
        case = solved_case()
        case["volumetric_patch"] = np.arange(len(case["tets"])) // 6  # each Kuhn cube lies in one layer and has a uniform strain
        self.assertTrue(self.verdict(case)[0])
        case["volumetric_patch"][:] = 0  # across the layers
        self.assertFalse(self.verdict(case)[0])

    def test_membranes_carry_their_part(self):
        good, printed = self.verdict(membrane_case())
        self.assertTrue(good, printed)
        case = membrane_case()
        case["triangles"] = case["triangles"][1:]
        self.assertFalse(self.verdict(case)[0])

    def test_not_a_number_is_refused(self):
        case = solved_case()
        case["applied_force"][-1, 0] = np.nan
        self.assertFalse(self.verdict(case)[0])


if __name__ == "__main__":
    unittest.main()
