#!/usr/bin/env python3
"""Checks an export of trocar-replay with nothing but the files: the tissue's residual K u - f, with K u assembled
here from strains, and the needle's balance of forces and moments.

usage: check_vtu.py PREFIX [LEAST_FORCE]   (N: the needle must exert at least this, or the check would be empty)
"""
import sys
import xml.etree.ElementTree as xml

import numpy as np


def arrays(path):
    """All data arrays of a VTU file by name; those with several components as rows."""
    found = {}
    for node in xml.parse(path).getroot().iter("DataArray"):
        values = np.array((node.text or "").split(), dtype=float)
        columns = int(node.get("NumberOfComponents", 1))
        found[node.get("Name")] = values.reshape(-1, columns) if columns > 1 else values
    return found


def internal_forces(points, tets, displacement, youngs_modulus, poisson_ratio):
    """Nodal forces of linear tetrahedra under a displacement: volume x stress x shape gradients."""
    corners = points[tets]
    edges = corners[:, 1:] - corners[:, :1]
    volume = np.linalg.det(edges) / 6
    assert (volume > 0).all(), "a tetrahedron is inverted"
    last = np.linalg.inv(edges).transpose(0, 2, 1)
    gradients = np.concatenate([-last.sum(axis=1, keepdims=True), last], axis=1)
    strain = np.einsum("eia,eib->eab", displacement[tets], gradients)
    strain = (strain + strain.transpose(0, 2, 1)) / 2
    shear = (youngs_modulus / (2 * (1 + poisson_ratio)))[:, None, None]
    lame = (youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio)))[:, None, None]
    stress = 2 * shear * strain + lame * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    shares = np.einsum("e,eab,eib->eia", volume, stress, gradients)
    forces = np.zeros_like(displacement)
    np.add.at(forces, tets, shares)
    return forces, volume.sum()


def check_tissue(path, least_force):
    a = arrays(path)
    tets = a["connectivity"].astype(int).reshape(-1, 4)
    forces, volume = internal_forces(a["Points"], tets, a["displacement"], a["youngs_modulus"], a["poisson_ratio"])
    applied, held = a["applied_force"], a["fixed"] == 1
    scale = np.abs(applied).max()
    assert scale >= least_force, f"{path}: largest nodal force {scale:g} N: nothing is checked"
    assert held.any(), f"{path}: no node is fixed"
    residual = np.abs((forces - applied)[~held]).max() / scale
    support = np.abs(forces[held].sum(axis=0) + applied.sum(axis=0)).max() / scale
    print(f"{path}: {len(a['Points'])} nodes, {volume * 1e6:.1f} cm3, residual {residual:.1e}, supports {support:.1e}")
    assert residual < 1e-9, f"{path}: residual {residual:g}"
    assert support < 1e-8, f"{path}: supports do not carry the load: {support:g}"
    return applied.sum(axis=0)


def check_needle(path):
    a = arrays(path)
    force, points = a["force"], a["Points"]
    base = a["base_position"][0]
    moment = np.cross(points - base, force).sum(axis=0)
    scale = np.abs(force).max()
    off_force = np.abs(force.sum(axis=0) - a["base_force"][0]).max() / scale
    off_moment = np.abs(moment - a["base_torque"][0]).max() / (scale * np.ptp(a["arc_length"]))
    print(f"{path}: {len(points)} points, force balance {off_force:.1e}, moment balance {off_moment:.1e}")
    assert (np.diff(a["arc_length"]) >= 0).all(), f"{path}: arc length goes back"
    assert off_force < 1e-6 and off_moment < 1e-6, f"{path}: not in balance"
    return force.sum(axis=0)


def main():
    prefix = sys.argv[1]
    least_force = float(sys.argv[2]) if len(sys.argv) > 2 else 0.01
    on_tissue = check_tissue(f"{prefix}-tissue.vtu", least_force)
    on_needle = check_needle(f"{prefix}-needle.vtu")
    off = np.abs(on_tissue + on_needle).max() / np.abs(on_needle).max()
    print(f"{prefix}: action and reaction differ by {off:.1e}")
    assert off < 1e-9, f"{prefix}: action is not reaction: {off:g}"


if __name__ == "__main__":
    main()
