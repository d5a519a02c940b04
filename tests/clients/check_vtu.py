#!/usr/bin/python3
"""Checks the balance of forces in PREFIX-tissue.vtu, PREFIX-membranes.vtu (if there is one) and PREFIX-needle.vtu, written by trocar-replay --vtu.

Shares no code with the simulator: the tissue's stiffness is assembled here, element by element, from B^T D B with the strain matrix B from the inverse of the
matrix of corner coordinates. Prints a table; exit status 0 if all checks pass, 1 if one
fails, 2 if a file cannot be read.
"""
import argparse
import os
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np

TETRAHEDRON = 10  # VTK's cell type


class Grid:
    """An ASCII VTU file with one piece, and its arrays by name."""

    def __init__(self, path):
        root = ElementTree.parse(path).getroot()
        if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid":
            raise ValueError(f"{path}: not a VTU file")
        self.field, piece = self.arrays(root.find(".//FieldData")), root.find(".//Piece")
        self.points = self.arrays(piece.find("Points"))
        self.points = next(iter(self.points.values()))
        self.point_data, self.cell_data = self.arrays(piece.find("PointData")), self.arrays(piece.find("CellData"))
        cells = self.arrays(piece.find("Cells"))
        self.connectivity, self.types = cells["connectivity"].astype(int), cells["types"].astype(int)
        counts = int(piece.get("NumberOfPoints")), int(piece.get("NumberOfCells"))
        if counts != (len(self.points), len(self.types)):
            raise ValueError(f"{path}: holds {len(self.points)} points and {len(self.types)} cells, announces {counts}")

    @staticmethod
    def arrays(parent):
        found = {}
        for array in parent.findall("DataArray") if parent is not None else ():
            if array.get("format") != "ascii":
                raise ValueError(f"array {array.get('Name')} is not ASCII")
            values = np.array((array.text or "").split(), dtype=float)
            components = int(array.get("NumberOfComponents", 1))
            found[array.get("Name")] = values.reshape(-1, components) if components > 1 else values
        return found


class Table:
    """Prints rows `what, value, limit` and records whether all values are within their limits."""

    def __init__(self):
        self.good = True

    def row(self, what, value, limit, holds):
        self.good = self.good and bool(holds)
        print(f"{'ok  ' if holds else 'FAIL'}  {what:<52} {value:>12.4g}   {limit}")

    def at_most(self, what, value, limit):
        self.row(what, value, f"<= {limit:g}", value <= limit)  # false for NaN

    def above(self, what, value, limit):
        self.row(what, value, f"> {limit:g}", value > limit)


def relative(error, scale):
    """Returns the norm of the error relative to the scale, or zero if both are zero."""
    error = np.max(np.abs(error), initial=0.0)
    return 0.0 if error == 0.0 else error / scale if scale > 0 else np.inf


def elasticity(youngs_modulus, poisson_ratio):
    """Returns the isotropic elasticity matrix D, shape (elements, 6, 6), for strains in the order xx yy zz xy yz zx (engineering shear)."""
    factor = youngs_modulus / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    d = np.zeros((len(youngs_modulus), 6, 6))
    d[:, :3, :3] = (factor * poisson_ratio)[:, None, None]
    for i in range(3):
        d[:, i, i] = factor * (1 - poisson_ratio)
        d[:, 3 + i, 3 + i] = factor * (1 - 2 * poisson_ratio) / 2
    return d


def strain_matrices(corners):
    """Returns B, shape (elements, 6, 12), and the signed volumes, computed from the inverse of the matrix with rows (1 x y z)."""
    rows = np.concatenate([np.ones(corners.shape[:2] + (1,)), corners], axis=2)
    gradients = np.linalg.inv(rows)[:, 1:, :]  # d N_corner / d x_axis, indexed [element, axis, corner]
    b = np.zeros((len(corners), 6, 12))
    for corner in range(4):
        x, y, z = (gradients[:, axis, corner] for axis in range(3))
        at = 3 * corner
        b[:, 0, at], b[:, 1, at + 1], b[:, 2, at + 2] = x, y, z
        b[:, 3, at], b[:, 3, at + 1] = y, x
        b[:, 4, at + 1], b[:, 4, at + 2] = z, y
        b[:, 5, at], b[:, 5, at + 2] = z, x
    return b, np.linalg.det(rows) / 6


def internal_forces(grid, tets):
    """Returns the internal forces K u at all points, and the volumes of the elements."""
    b, volumes = strain_matrices(grid.points[tets])
    d = elasticity(grid.cell_data["youngs_modulus"], grid.cell_data["poisson_ratio"])
    u = grid.point_data["displacement"][tets].reshape(-1, 12)
    strain = np.einsum("ekj,ej->ek", b, u)
    stress = np.einsum("ekl,el->ek", d, strain)
    if "volumetric_nodes" in grid.cell_data or "volumetric_patch" in grid.cell_data:
        modulus = d[:, 0, 1]  # lambda
        average = nodal_volumetric_stress if "volumetric_nodes" in grid.cell_data else patch_volumetric_stress
        pressure = average(grid, volumes, strain[:, :3].sum(axis=1), modulus)
        stress[:, :3] += (pressure - modulus * strain[:, :3].sum(axis=1))[:, None]
    local = np.einsum("eki,ek,e->ei", b, stress, volumes)
    forces = np.zeros_like(grid.points)
    np.add.at(forces, tets, local.reshape(-1, 4, 3))
    return forces, volumes


def membrane_forces(membranes, points):
    """Returns the internal nodal forces of triangles in plane stress, from N = C strain in axes lying in each triangle."""
    corners = membranes.connectivity.reshape(-1, 3)
    x, u = points[corners], membranes.point_data["displacement"][corners]
    first = x[:, 1] - x[:, 0]
    first /= np.linalg.norm(first, axis=1)[:, None]
    normal = np.cross(first, x[:, 2] - x[:, 0])
    axes = np.stack([first, np.cross(normal / np.linalg.norm(normal, axis=1)[:, None], first)], 1)  # (triangles, 2, 3)
    flat, moved = np.einsum("tik,tnk->tni", axes, x - x[:, :1]), np.einsum("tik,tnk->tni", axes, u)
    rows = np.concatenate([np.ones(flat.shape[:2] + (1,)), flat], axis=2)
    gradients, area = np.linalg.inv(rows)[:, 1:, :], np.abs(np.linalg.det(rows)) / 2
    strain = np.einsum("tjn,tni->tij", gradients, moved)
    strain = (strain + strain.transpose(0, 2, 1)) / 2
    nu = membranes.cell_data["poisson_ratio"]
    c = (membranes.cell_data["stiffness"] / (1 - nu ** 2))[:, None, None]
    force = c * ((1 - nu)[:, None, None] * strain + nu[:, None, None] * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(2))  # N/m
    local = np.einsum("t,tjn,tij,tik->tnk", area, gradients, force, axes)
    forces = np.zeros_like(points)
    np.add.at(forces, corners, local)
    return forces


def patch_volumetric_stress(grid, volumes, divergence, modulus):
    """Returns lambda div u, with div u averaged by volume over each patch of cells."""
    patch = grid.cell_data["volumetric_patch"].astype(int)
    return modulus * (np.bincount(patch, volumes * divergence) / np.bincount(patch, volumes))[patch]


def nodal_volumetric_stress(grid, volumes, divergence, modulus):
    """Returns lambda div u, with div u averaged by volume at each node, region by region, and then over each cell's four nodes."""
    nodes = grid.cell_data["volumetric_nodes"].astype(int) + len(grid.points) * grid.cell_data["region"].astype(int)[:, None]
    size = nodes.max() + 1
    volume, change = np.zeros(size), np.zeros(size)
    for corner in range(4):
        np.add.at(volume, nodes[:, corner], volumes)
        np.add.at(change, nodes[:, corner], volumes * divergence)
    mean = np.divide(change, volume, out=np.zeros(size), where=volume > 0)
    return modulus * mean[nodes].mean(axis=1)


def most_tets_on_a_face(tets):
    faces = np.sort(np.concatenate([tets[:, [0, 1, 2]], tets[:, [0, 1, 3]], tets[:, [0, 2, 3]], tets[:, [1, 2, 3]]]), axis=1)
    return np.unique(faces, axis=0, return_counts=True)[1].max()


def check_tissue(grid, table, volume, membranes=None):
    """Checks the tissue's residual, supports and mesh. Returns the sum of the forces that the needle exerts on it."""
    if np.any(grid.types != TETRAHEDRON):
        raise ValueError("the tissue has cells other than linear tetrahedra")
    tets = grid.connectivity.reshape(-1, 4)
    applied, displacement = grid.point_data["applied_force"], grid.point_data["displacement"]
    fixed = grid.point_data["fixed"] != 0
    forces, volumes = internal_forces(grid, tets)
    if membranes:
        count = len(membranes.points)
        table.at_most("membranes: nodes that are not those of the tissue, m", np.abs(membranes.points - grid.points[:count]).max(), 0)
        table.at_most("membranes: displacements that are not the tissue's, m", np.abs(membranes.point_data["displacement"] - displacement[:count]).max(), 0)
        forces += membrane_forces(membranes, grid.points)
    largest = np.max(np.linalg.norm(applied, axis=1))

    table.above("tissue: least volume of a tetrahedron, m^3", volumes.min(), 0)
    table.at_most("tissue: tetrahedra on one face", most_tets_on_a_face(tets), 2)
    if volume is not None:
        table.at_most("tissue: total volume, relative error", abs(volumes.sum() / volume - 1), 1e-9)
    table.above("tissue: fixed nodes", fixed.sum(), 0)
    table.at_most("tissue: displacement of fixed nodes, m", np.max(np.abs(displacement[fixed]), initial=0), 0)
    residual = (forces - applied)[~fixed]
    table.at_most("tissue: K u - f on free nodes, of the largest force", relative(residual, largest), 1e-9)
    return applied.sum(axis=0) - grid.field.get("tip_damping", np.zeros((1, 3))).reshape(3)


def check_needle(grid, table):
    """Checks the balance between the needle's forces and its base. Returns the sum of the forces exerted on the needle."""
    force, base = grid.point_data["force"], {name: grid.field[name].reshape(3) for name in
                                             ("base_position", "base_force", "base_torque")}
    arm = grid.points - base["base_position"]
    total, torque = force.sum(axis=0), np.cross(arm, force).sum(axis=0)
    size = np.linalg.norm(force, axis=1)
    table.at_most("needle: base force - sum of forces, relative",
                  relative(base["base_force"] - total, size.sum()), 1e-6)
    table.at_most("needle: base torque - sum of moments, relative",
                  relative(base["base_torque"] - torque, (size * np.linalg.norm(arm, axis=1)).sum()), 1e-6)
    table.at_most("needle: arc length runs backwards, m", max(0.0, -np.min(np.diff(grid.point_data["arc_length"]))), 0)
    return total, size.sum()


def check(prefix, volume=None, unloaded=False):
    """Prints the table for one pair of files. Returns whether all checks pass."""
    tissue, needle, table = Grid(prefix + "-tissue.vtu"), Grid(prefix + "-needle.vtu"), Table()
    membranes = Grid(prefix + "-membranes.vtu") if os.path.exists(prefix + "-membranes.vtu") else None
    on_tissue = check_tissue(tissue, table, volume, membranes)
    on_needle, scale = check_needle(needle, table)
    if not unloaded:
        table.above("needle: sum of the forces' sizes, N", scale, 0)
    table.at_most("both: action + reaction, relative", relative(on_tissue + on_needle, scale), 1e-9)
    return table.good


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("prefix", metavar="PREFIX", help="prefix of the two files' names")
    parser.add_argument("--volume", type=float, metavar="M3", help="nominal volume of the tissue, m^3")
    parser.add_argument("--unloaded", action="store_true", help="accept a needle without any force")
    options = parser.parse_args()
    try:
        return 0 if check(options.prefix, options.volume, options.unloaded) else 1
    except (OSError, ElementTree.ParseError, ValueError, KeyError, AttributeError, StopIteration) as error:
        print(f"{options.prefix}: cannot be checked: {error!r}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
