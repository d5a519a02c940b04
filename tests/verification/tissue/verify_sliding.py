#!/usr/bin/python3
"""Compares tissue that slides on a surface with CalculiX, where equations tie the normal displacements of the two sides.

Both programs use the same mesh with C3D4 elements, and the same unit normals, means over the faces at a node. trocar's two sides are held together by springs,
whose stiffness is varied: the stiffer they are, the closer the displacements must be.
"""
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parents[1] / folder) for folder in (".", "references", "tissue")]
import tissue_model as tm  # noqa: E402
import verify_membranes  # noqa: E402
import yaml  # noqa: E402
from rows import REPOSITORY, Rows  # noqa: E402

USUAL, STIFF = 1e9, 1e12              # N/m^3: the default of sliding[].normal_stiffness, and springs without effect
CLOSE, SAME = 1e-3, 1e-5              # limits of the relative error with them; CalculiX prints seven digits
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))


def places_in_file(model):
    """Returns the position in the mesh file of each tetrahedron, which is its number in the core."""
    tm.start_gmsh()
    tm.gmsh.open(str(model.path))
    tags, nodes = tm.gmsh.model.mesh.getElementsByType(tm.TETRAHEDRON)
    tm.gmsh.finalize()
    corners = np.sort(np.searchsorted(np.unique(nodes), nodes).reshape(-1, 4), axis=1)
    tag_of = {tuple(four): tag for tag, four in zip(tags.tolist(), corners.tolist())}
    return np.argsort(np.argsort([tag_of[tuple(four)] for four in np.sort(model.tets, axis=1).tolist()]))


class Split:
    """A mesh whose region `beside` has nodes of its own on a surface, except at the rim, where other regions touch it."""

    def __init__(self, model, surface, beside):
        self.model, tets = model, model.tets.copy()
        region = np.empty(len(tets), object)
        for name, members in model.regions.items():
            region[members] = name
        on_surface = {tuple(sorted(triangle)) for triangle in model.surfaces[surface].tolist()}
        normals, touching = np.zeros_like(model.nodes), [set() for _ in model.nodes]
        for name, corners in zip(region, tets.tolist()):
            for node in corners:
                touching[node].add(name)
        faces = {}
        for t, corners in enumerate(tets.tolist()):
            for face in FACES:
                faces.setdefault(tuple(sorted(corners[c] for c in face)), []).append(t)
        organs = set()
        for face, owners in faces.items():
            if face in on_surface and len(owners) == 2 and (region[owners] == beside).sum() == 1:
                inner, outer = sorted(owners, key=lambda t: region[t] == beside)
                a, b, c = model.nodes[list(face)]
                area = 0.5 * np.cross(b - a, c - a)
                area *= np.sign(area @ (model.nodes[tets[outer]].mean(0) - model.nodes[tets[inner]].mean(0)))
                normals[list(face)] += area
                organs.add(region[inner])
        # numbers are given in ascending order, as in mesh_let_slide; the side of the first tetrahedron keeps the node
        nodes = [n for n in np.flatnonzero(np.any(normals != 0, axis=1)) if touching[n] <= organs | {beside}]
        place, around = places_in_file(model), {n: np.flatnonzero(np.any(model.tets == n, axis=1)) for n in nodes}
        first = {n: tets_around[place[tets_around].argmin()] for n, tets_around in around.items()}
        self.pairs = []
        for copy, node in enumerate(nodes, len(model.nodes)):
            outer = region[first[node]] != beside     # the copy is on the outer side
            theirs = (region == beside) == outer
            tets[theirs] = np.where(model.tets[theirs] == node, copy, tets[theirs])
            self.pairs.append((node, copy, normals[node] / np.linalg.norm(normals[node])))
        self.tets, self.nodes = tets, np.concatenate([model.nodes, model.nodes[nodes]])

    def solve_calculix(self, materials, fixed, cases):
        held = set(np.concatenate([self.model.surfaces[name] for name in fixed]).ravel().tolist())
        free = [pair for pair in self.pairs if pair[0] not in held]
        held = np.array(sorted(held | {copy for node, copy, _ in self.pairs if node in held}))
        loads = [np.concatenate([load, np.zeros((len(self.nodes) - len(load), 3))]) for load in cases]
        text = tm.run_calculix(tm.deck(self.nodes, self.tets, "C3D4", self.model.regions, materials, tm.tied_normals(free), held, loads))
        return tm.read_displacements(text, len(self.nodes))


def compare(rows, name, model, materials, fixed, surface, beside):
    split, cases = Split(model, surface, beside), verify_membranes.load_cases(model)
    reference = split.solve_calculix(materials, fixed, cases)
    for stiffness, limit, words in ((USUAL, CLOSE, "usual springs"), (STIFF, SAME, "stiff springs")):
        ours = tm.solve_core(rows, model, materials, fixed, cases, "element", sliding=(surface, beside, stiffness, 0.0))
        for load, u, u0 in zip(("six nodes loaded", "all nodes loaded"), ours, reference):
            rows.error(f"{name}, {len(split.pairs)} pairs of nodes, {words}, {load}", "CalculiX, C3D4 and equations", np.linalg.norm(u - u0) / np.linalg.norm(u0), limit,
                       f"springs of {stiffness:g} N/m^3; relative to the field's norm")
    bonded = tm.solve_core(rows, model, materials, fixed, cases[:1], "element")[0]
    rows.measured(f"{name}: how far sliding changes the displacements, six nodes loaded", "the same, bonded",
                  np.linalg.norm(ours[0][:len(bonded)] - bonded) / np.linalg.norm(bonded), None, 0.0)


def main():
    rows = Rows.from_arguments(__doc__, "Sliding surfaces: against CalculiX")
    block = verify_membranes.block(rows.folder / "sliding.msh", 0.012 if rows.short_form else 0.007)
    compare(rows, "block, tilted surface", block, {"bottom": (15e3, 0.3), "top": (30e3, 0.45)}, ["fixed", "x0"], "between", "top")
    scene = yaml.safe_load((REPOSITORY / "meshes/pelvis.yaml").read_text())
    materials = {region["name"]: (float(region["youngs_modulus"]), float(region["poisson_ratio"])) for region in scene["regions"]}
    compare(rows, "pelvis, gland in fat", tm.read_mesh(REPOSITORY / "meshes/pelvis.msh"), materials, ["fixed", "bone"], "capsule", "fat")
    return rows.end()


if __name__ == "__main__":
    sys.exit(main())
