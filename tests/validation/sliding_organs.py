#!/usr/bin/python3
"""Uses CalculiX to measure how the motion of the gland in meshes/pelvis.msh changes if organs slide without friction along the surrounding fat instead of being
bonded to it. Uses none of trocar's code.

The elements are quadratic tetrahedra (C3D10) with the moduli of meshes/pelvis.yaml. A needle's friction is represented by a force spread evenly along its
track in the gland and pointing towards the head. There are two tracks, one near the middle and one 20 mm to the side.

Fascia may lie anywhere between two extremes: bonded surfaces, and surfaces that slide but stay in contact (with the same displacement along the normal on
both sides). At the rim of a surface, where a third region begins, both sides stay joined. Two other changes are computed for comparison. The simplest model
of sliding lowers the shear modulus of the layer of fat elements on the gland and keeps their bulk modulus. And the modulus of all fat is set to the ends of
its published range. The model is linear, so relative changes do not depend on the force. Displacements are given for 1 N.

usage: sliding_organs.py OUTPUT.csv     takes some minutes; needs Debian's calculix-ccx, python3-gmsh, python3-numpy and python3-yaml
"""
import csv
import sys
from pathlib import Path

import numpy as np
import yaml

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "verification"), str(HERE.parent / "verification/tissue")]
import tissue_model as tm  # noqa: E402

MESHES = HERE.parents[1] / "meshes"
GLAND = "prostate", "transition_zone", "urethra"
ORGANS = {"gland": GLAND, "back of the gland": GLAND, "rectum": ("rectum",), "bladder": ("bladder",)}
BEHIND = "back of the gland"       # the part of the gland's surface that faces the rectum: its normal is within 45 degrees of the -y axis
AROUND = "fat"
TRACKS = {"middle": (0.005, 0.0), "side": (0.02, 0.0)}   # m, x and y of each track
STEP = 0.5e-3                     # m, between points along a track
FACES = ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))


def materials():
    """Returns the moduli and Poisson's ratios of the scene by region."""
    scene = yaml.safe_load((MESHES / "pelvis.yaml").read_text())
    return {region["name"]: (float(region["youngs_modulus"]), float(region["poisson_ratio"])) for region in scene["regions"]}


def softened(material, factor):
    """Returns a material with the same bulk modulus and a fraction of the shear modulus."""
    (e, nu), mu = material, factor * tm.lame(material)[1]
    bulk = e / 3 / (1 - 2 * nu)
    return 9 * bulk * mu / (3 * bulk + mu), (3 * bulk - 2 * mu) / (6 * bulk + 2 * mu)


class Pelvis:
    """The mesh with mid-side nodes. `region` is the name of each element's region."""

    def __init__(self):
        self.model = tm.read_mesh(MESHES / "pelvis.msh")
        self.middle = tm.Quadratic(self.model)
        self.region = np.empty(len(self.model.tets), object)
        for name, members in self.model.regions.items():
            self.region[members] = name
        scene = yaml.safe_load((MESHES / "pelvis.yaml").read_text())
        held = np.concatenate([self.model.surfaces[name] for name in scene["fixed"]])
        self.fixed = np.unique(np.concatenate([held, self.middle.middles(held)]))
        gland = np.unique(self.model.tets[np.isin(self.region, GLAND[:1])])
        self.gland, height = gland, self.model.nodes[gland, 2]
        self.base = height > np.quantile(height, 0.85)   # as in validate_implant.py
        self.loads = [self.friction(place) for place in TRACKS.values()]

    def friction(self, place):
        """Returns nodal forces, 1 N in total, along the part of the track that lies in the gland."""
        inside, heights = np.isin(self.region, GLAND), self.model.nodes[self.gland, 2]
        g, _ = tm.gradients(self.model)
        total = np.zeros_like(self.middle.nodes)
        for z in np.arange(heights.min(), heights.max(), STEP):
            weights = np.einsum("tax,tx->ta", g, np.array([*place, z]) - self.model.nodes[self.model.tets[:, 0]])
            weights[:, 0] += 1
            tet = np.argmax(weights.min(1))
            if inside[tet]:
                total[self.middle.tets[tet], 2] += tm.quadratic(weights[tet][None], tm.EDGES)[0]
        return total / total.sum()

    def motion(self, displacements):
        """Returns the displacement of the gland's base along the needle (m) and the gland's rotation (rad), for small displacements."""
        moved, rest = displacements[self.gland], self.model.nodes[self.gland]
        arm = rest - rest.mean(0)
        inertia = np.einsum("ni,nj->ij", arm, arm)
        turn = np.linalg.solve(np.trace(inertia) * np.eye(3) - inertia, np.cross(arm, moved - moved.mean(0)).sum(0))
        return moved[self.base, 2].mean(), np.linalg.norm(turn)

    # ---- sliding ----

    def interface(self, organ):
        """Returns the faces (k, 3) at which an organ slides along the fat, their area vectors (k, 3) (m^2, pointing into the fat), and the nodes of the faces
        that do not slide."""
        corners = np.concatenate([self.model.tets[:, face] for face in FACES])
        owner = np.tile(np.arange(len(self.model.tets)), 4)
        inside = np.isin(self.region[owner], ORGANS[organ])
        fat = {tuple(sorted(face)) for face in corners[self.region[owner] == AROUND].tolist()}
        chosen = [i for i in np.flatnonzero(inside) if tuple(sorted(corners[i].tolist())) in fat]
        faces, x = corners[chosen], self.model.nodes[corners[chosen]]
        area = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        outward = x.mean(1) - self.model.nodes[self.model.tets[owner[chosen]]].mean(1)
        area *= np.sign(np.einsum("fi,fi->f", area, outward))[:, None]
        slides = -area[:, 1] > np.sqrt(0.5) * np.linalg.norm(area, axis=1) if organ == BEHIND else np.ones(len(faces), bool)
        return faces[slides], area[slides], np.unique(self.with_middles(faces[~slides]))

    def with_middles(self, faces):
        return np.concatenate([faces, self.middle.middles(faces)], 1) if len(faces) else np.empty((0, 6), int)

    def split(self, organs):
        """Gives the fat nodes of its own on the organs' surfaces. Returns the nodes, the tetrahedra, and for each new node a tuple (node of the organ, new
        node, unit normal)."""
        regions_at = [set() for _ in self.middle.nodes]
        for name, corners in zip(self.region, self.middle.tets.tolist()):
            for node in corners:
                regions_at[node].add(name)
        nodes, tets, pairs = list(self.middle.nodes), self.middle.tets.copy(), []
        number = {}
        for organ in organs:
            faces, area, joined = self.interface(organ)
            all_of = self.with_middles(faces)
            normals = np.zeros_like(self.middle.nodes)
            np.add.at(normals, all_of.ravel(), np.repeat(area, 6, axis=0))
            for node in np.setdiff1d(all_of, joined).tolist():
                if AROUND not in regions_at[node] or not regions_at[node] - {AROUND} <= set(ORGANS[organ]):
                    continue   # on the rim
                number[node] = len(nodes)
                pairs.append((node, len(nodes), normals[node] / np.linalg.norm(normals[node])))
                nodes.append(self.middle.nodes[node])
        for t in np.flatnonzero(self.region == AROUND):
            tets[t] = [number.get(node, node) for node in tets[t].tolist()]
        return np.array(nodes), tets, pairs

    def layer(self, organs):
        """Returns the fat elements that share a node with these organs."""
        touched = np.unique(self.model.tets[np.isin(self.region, [name for organ in organs for name in ORGANS[organ]])])
        return np.flatnonzero((self.region == AROUND) & np.isin(self.model.tets, touched).any(1))

    def thickness(self, organs):
        """Returns the mean thickness (m) of the layer on these organs: its volume divided by their area."""
        area = sum(np.linalg.norm(self.interface(organ)[1], axis=1).sum() for organ in organs)
        return tm.gradients(self.model)[1][self.layer(organs)].sum() / area

    # ---- solution ----

    def solve(self, material, sliding=(), soft=(), factor=1.0):
        """Returns the displacements under each load, for the given sliding organs, or for a soft layer of fat on the organs `soft`."""
        nodes, tets, pairs = self.split(sliding)
        regions, material = dict(self.model.regions), dict(material)
        if soft:
            regions["layer"] = self.layer(soft)
            regions[AROUND] = np.setdiff1d(regions[AROUND], regions["layer"])
            material["layer"] = softened(material[AROUND], factor)
        loads = [np.concatenate([load, np.zeros((len(nodes) - len(load), 3))]) for load in self.loads]
        text = tm.run_calculix(tm.deck(nodes, tets, "C3D10", regions, material, tm.tied_normals(pairs), self.fixed, loads))
        return tm.read_displacements(text, len(nodes))


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if sys.argv[1:] == ["--help"] else 2
    pelvis, given = Pelvis(), materials()
    fat = lambda e: {**given, AROUND: (e, given[AROUND][1])}
    cases = {"bonded": {}, "gland slides": {"sliding": ["gland"]}, "back of the gland slides": {"sliding": [BEHIND]}, "rectum slides": {"sliding": ["rectum"]}, "bladder slides": {"sliding": ["bladder"]},
             "gland, rectum, bladder slide": {"sliding": ["gland", "rectum", "bladder"]},
             **{f"layer on the gland, shear modulus / {1 / factor:g}": {"soft": ["gland"], "factor": factor} for factor in (0.3, 0.1, 0.01)},
             "all fat 3 kPa": {"material": fat(3e3)}, "all fat 7 kPa": {"material": fat(7e3)}}
    print(f"layer on the gland: {1e3 * pelvis.thickness(['gland']):.1f} mm thick")
    with open(sys.argv[1], "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(["interface", "track", "shift of the base, mm/N", "change", "rotation, degrees/N", "change"])
        first = None
        for name, case in cases.items():
            found = [pelvis.motion(u) for u in pelvis.solve(case.pop("material", given), **case)]
            first = first or found
            for track, (shift, turn), (bonded_shift, bonded_turn) in zip(TRACKS, found, first):
                out.writerow([name, track, f"{1e3 * shift:.3f}", f"{shift / bonded_shift - 1:+.1%}", f"{np.degrees(turn):.3f}", f"{turn / bonded_turn - 1:+.1%}"])
                file.flush()
            print(name, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
