#!/usr/bin/python3
"""Tests needles that cross a surface on which the tissue slides, in meshes/pelvis.yaml with a gland that slides in the fat around it.

usage: test_sliding.py BUILD_DIR SOURCE_DIR
"""
import os
import sys
import unittest
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True
import numpy as np

import trocar
from trocar.brachy import plan as plans

DT, SPEED = 2e-3, 0.08     # s, m/s
START, DEPTH = -0.005, 0.085    # m, depth of the tip behind the template's face
HOLES = "F4", "D4", "J4"
FAULTS = trocar.Event.LATE | trocar.Event.FULL | trocar.Event.UNSTABLE | trocar.Event.INEXACT | trocar.Event.MISSED_GUIDE | trocar.Event.OUTSIDE_MODEL


def model_with(**sliding):
    """Returns a model of the pelvis. With `sliding`, these keys of the capsule, which slides on fat."""
    scene = trocar.Scene.load(SOURCE / "meshes/pelvis.yaml")
    scene["inverse"] = "sparse"
    if sliding:
        scene["sliding[capsule].beside"] = "fat"
    for key, value in sliding.items():
        scene[f"sliding[capsule].{key}"] = value
    return trocar.Model(scene)


def poses(model, hole, depths):
    plan = plans.read(SOURCE / "docs/examples/implant-plan.yaml")
    face = plans.hole_axis(plans.guide_of(plan, model), hole)
    made = np.tile([*face[:2], 0, 1, 0, 0, 0], (len(depths), 1))
    made[:, 2] = face[2] + depths - model.needle_length
    return made


def push(sim, hole, needle=0):
    """Inserts a needle. Returns the outputs."""
    way = poses(sim.model, hole, np.arange(START, DEPTH, SPEED * DT))
    sim.reset(way[0], needle)
    return sim.run(way, DT, needle)


def base_shift(sim):
    """Returns the displacement of the gland's base along the needles (m)."""
    nodes = np.unique(sim.model.tets_of("prostate"))
    depth = sim.model.nodes[nodes, 2]
    return sim.displacements()[nodes[depth > np.quantile(depth, 0.85)], 2].mean()


class Sliding(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.bonded, cls.sliding = model_with(), model_with(shear_stiffness=0)

    def test_only_nodes_between_gland_and_fat_are_doubled(self):
        added = len(self.sliding.nodes) - len(self.bonded.nodes)
        gland, fat = (np.unique(self.sliding.tets_of(name)) for name in ("prostate", "fat"))
        shared_before = np.intersect1d(*(np.unique(self.bonded.tets_of(name)) for name in ("prostate", "fat")))
        rim = np.intersect1d(gland, fat)
        self.assertEqual(added, len(shared_before) - len(rim))
        self.assertGreater(added, 100)
        others = np.unique(np.concatenate([self.bonded.tets_of(name).ravel() for name in ("bladder", "pelvic_floor", "urethra", "seminal_vesicles")]))
        self.assertTrue(np.isin(rim, others).all())

    def test_a_stiff_connection_is_as_good_as_a_bond(self):
        tied = model_with(normal_stiffness=1e11, shear_stiffness=1e11)
        sims = [trocar.Sim(model) for model in (self.bonded, tied)]
        forces = [push(sim, "J4")["force"] for sim in sims]
        self.assertLess(np.abs(forces[1] - forces[0]).max(), 0.01 * np.abs(forces[0]).max())
        shifts = [base_shift(sim) for sim in sims]
        self.assertAlmostEqual(shifts[1] / shifts[0], 1, delta=0.01)

    def test_no_tick_fails_while_needles_cross_the_surface_both_ways(self):
        sim = trocar.Sim(self.sliding)
        for needle, hole in enumerate(HOLES):
            with self.subTest(hole=hole):
                there = push(sim, hole, needle)
                back = sim.run(poses(self.sliding, hole, np.arange(DEPTH, START, -SPEED * DT)), DT, needle)
                for out in (there, back):
                    self.assertFalse((out["events"] & FAULTS).any())
                    self.assertTrue(np.isfinite(out["force"]).all())
                self.assertGreater(-there["force"][there["depth"] > 0.01, 2].min(), 1)
                self.assertLess(np.abs(back["force"][-1]).max(), 1e-6)
                push(sim, hole, needle)
                sim.leave(needle)
        self.assertTrue(np.isfinite(sim.displacements()).all())

    def test_the_gland_moves_farther_if_it_slides(self):
        """tests/validation/sliding_organs.py computes 45 to 92 % with CalculiX for the same force; here, less friction follows a gland that yields."""
        for hole in ("F4", "J4"):
            shifts = []
            for model in (self.bonded, self.sliding):
                sim = trocar.Sim(model)
                push(sim, hole)
                shifts.append(base_shift(sim))
            print(f"{hole}: base {1e3 * shifts[0]:.2f} mm bonded, {1e3 * shifts[1]:.2f} mm sliding")
            self.assertGreater(shifts[1], 1.2 * shifts[0])

    def test_the_track_continues_in_the_tissue_that_lies_at_the_tip(self):
        """Where the needle crosses the surface, the track ends in the fat and continues in the gland. The two ends are apart in the tissue at rest, and at the
        same place in the displaced tissue."""
        model, sim = self.sliding, trocar.Sim(self.sliding)
        way = poses(model, "J4", np.arange(START, DEPTH, SPEED * DT))
        sim.reset(way[0])
        for pose in way:
            before = sim.displacements() if sim.tracks() and sim.tracks()[-1].points[-1, 2] > 0.035 else None
            if sim.run(pose[None], DT)["events"][0] & trocar.Event.PUNCTURED:
                field = before      # what the tip knew of the tissue when it crossed the capsule
            if len(sim.tracks()) > 1:
                break
        left, entered = (track.points[at] for track, at in zip(sim.tracks(), (-1, 0)))
        ends = [self.displaced(left, field, "fat"), self.displaced(entered, field, "prostate")]
        print(f"the track continues {1e3 * np.linalg.norm(entered - left):.2f} mm away at rest, {1e3 * np.linalg.norm(ends[1] - ends[0]):.2f} mm away in the displaced tissue")
        self.assertGreater(np.linalg.norm(entered - left), 1e-3)
        self.assertLess(np.linalg.norm(ends[1] - ends[0]), 0.15 * np.linalg.norm(entered - left))

    def displaced(self, point, field, region):
        """Returns where a point of a region is in the displaced tissue."""
        tets = self.sliding.tets_of(region)
        corners = self.sliding.nodes[tets].transpose(0, 2, 1)
        weights = np.linalg.solve(np.concatenate([corners, np.ones((len(corners), 1, 4))], axis=1), np.append(point, 1)[None, :, None])[:, :, 0]
        tet = weights.min(1).argmax()
        return point + weights[tet] @ field[tets[tet]]

    def test_a_strand_of_seeds_may_lie_across_the_surface(self):
        spacing = self.sliding.seed_size.length + 8e-3
        sim = trocar.Sim(self.sliding)
        self.assertGreater(push(sim, "F4")["depth"][-1], 0.05)
        sim.drop_seeds(4, spacing)
        sim.run(poses(self.sliding, "F4", np.arange(DEPTH, START, -SPEED * DT)), DT)
        seeds = sim.seeds()
        self.assertEqual(len(seeds), 4)
        depths = [seed.position[2] for seed in seeds]
        self.assertTrue((np.diff(depths) < 0).all())
        self.assertAlmostEqual(depths[0] - depths[-1], 3 * spacing, delta=3e-3)

    def test_scenes_that_cannot_slide_are_refused(self):
        for keys, words in (({"sliding[capsule].beside": "nowhere"}, "no region \"nowhere\""), ({"sliding[nothing].shear_stiffness": 0}, "no surface \"nothing\""),
                            ({"sliding[skin].beside": "fat"}, "no face of \"skin\"")):
            scene = trocar.Scene.load(SOURCE / "meshes/pelvis.yaml")
            for key, value in keys.items():
                scene[key] = value
            with self.assertRaisesRegex(trocar.Error, words):
                trocar.Model(scene)

    def test_a_model_that_slides_elsewhere_cannot_be_derived(self):
        scene = trocar.Scene.load(SOURCE / "meshes/pelvis.yaml")
        scene["inverse"] = "sparse"
        scene["sliding[capsule].beside"] = "fat"
        scene["sliding[capsule].shear_stiffness"] = 1e6
        with self.assertRaisesRegex(trocar.Error, "sliding: differs"):
            self.sliding.derive(scene)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
