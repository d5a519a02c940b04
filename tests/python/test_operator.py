#!/usr/bin/python3
"""Tests the virtual operator in simulations: the misplacement left in stiff tissue, the parts of a misplacement, repeated runs, and studies.

usage: test_operator.py BUILD_DIR SOURCE_DIR
"""
import os
import sys
import tempfile
import unittest
from dataclasses import replace
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True
import numpy as np

import trocar
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator
from trocar.studies import _definition as definition, _runs as runs

SCENE = SOURCE / "meshes/implant.yaml"
DT = 1e-3
PLAN = plans.read(SOURCE / "docs/examples/implant-plan.yaml")
PERFECT = dict(image_error=0.0, splay=0.0, speed_spread=0.0)


def only(*holes, seeds=2):
    """Returns the plan with only the needles in these holes and only each needle's first seeds."""
    return replace(PLAN, needles=[replace(needle, seeds=needle.seeds[:seeds]) for needle in PLAN.needles if needle.hole in holes])


def stiff_scene():
    """Returns the scene with tissue a thousand times as stiff and a tenth of the cutting force and friction, so that it does not move. The template's holes are
    wide, so that needles can tilt in them."""
    scene = trocar.Scene.load(SCENE)
    for name in scene.names("regions"):
        scene[f"regions[{name}].youngs_modulus"] = 1e3 * scene[f"regions[{name}].youngs_modulus"]
        for key in ("cutting_force", "friction.static", "friction.kinetic"):
            scene[f"regions[{name}].{key}"] = 0.1 * scene[f"regions[{name}].{key}"]
    scene["guides[template].hole_diameter"] = 3e-3
    return scene


SOFT = trocar.Model(trocar.Scene.load(SCENE))


def carry_out(model, plan, **options):
    """Returns the errors of the seeds, and the simulation."""
    sim = trocar.Sim(model)
    work = Operator(plan=plan, **options).moves(sim, DT)
    for needle, poses in work:
        sim.run(poses, DT, needle)
    return work.errors(), sim


class Rigid(unittest.TestCase):
    """In tissue that does not move, seeds are misplaced by exactly the operator's errors, which are drawn at random."""

    @classmethod
    def setUpClass(cls):
        cls.model = trocar.Model(stiff_scene())

    def test_errors_are_those_drawn(self):
        errors, _ = carry_out(self.model, only("E3", "H4"), follows_image=True, seed=3)
        self.assertEqual(len(errors), 4)
        for error in errors:
            self.assertGreater(error.across("splay"), 0.1e-3)
            self.assertGreater(abs(error.along("image")), 0.05e-3)
            self.assertAlmostEqual(error.along("total"), error.along("image"), delta=0.1e-3)
            self.assertLess(np.linalg.norm(error.total - error.image - error.splay), 0.15e-3)
            self.assertLess(np.linalg.norm(error.tissue), 0.05e-3)

    def test_without_errors_seeds_are_in_their_places(self):
        for follows in (False, True):
            errors, _ = carry_out(self.model, only("E3"), follows_image=follows, **(PERFECT if follows else {}))
            for error in errors:
                self.assertLess(np.linalg.norm(error.total), 0.1e-3)


    def test_a_strand_has_the_errors_of_its_first_seed(self):
        errors, _ = carry_out(self.model, only("E3", "F4", seeds=4), follows_image=True, strands=True, seed=3)
        self.assertEqual([(error.hole, error.number) for error in errors], [(hole, number) for hole in ("E3", "F4") for number in (1, 2, 3, 4)])
        for error in errors:
            self.assertAlmostEqual(error.along("total"), error.along("image"), delta=0.1e-3)
            self.assertLess(np.linalg.norm(error.total - error.image - error.splay), 0.15e-3)


class Soft(unittest.TestCase):
    def test_seeds_of_a_strand_keep_their_distances(self):
        """The first three seeds of hole E3 are 10 mm apart and dropped together; the last one follows 5 mm behind. Loose seeds are brought to their own places."""
        for strands in (True, False):
            _, sim = carry_out(SOFT, only("E3", "F3", seeds=4), follows_image=True, strands=strands, **PERFECT)
            seeds = [seed for seed in sim.seeds() if seed.needle == 0]
            self.assertEqual([seed.strand for seed in seeds], [0, 1, 2, 0] if strands else [0, 0, 0, 0])
            apart = [np.linalg.norm(a.position - b.position) for a, b in zip(seeds, seeds[1:])]
            if strands:
                np.testing.assert_allclose(apart[:2], 0.01, atol=0.05e-3)    # along the track, which is almost straight
                self.assertAlmostEqual(apart[2], 0.005, delta=2e-3)
            else:
                self.assertGreater(np.abs(np.array(apart[:2]) - 0.01).max(), 0.05e-3)

    def test_the_image_is_followed(self):
        """An error-free operator who follows the image misplaces a seed by less than the tolerance of an approach, 0.3 mm, plus the tissue's motion while the
        needle is drawn back. For one who reads the marks, the misplacement includes all of the tissue's motion. It is the same misplacement as found by
        comparing seeds and plan."""
        plan = only("E3", "F3")
        followed, sim = carry_out(SOFT, plan, follows_image=True, **PERFECT)
        marks, _ = carry_out(SOFT, plan)
        along = lambda errors: np.mean([abs(error.along("tissue")) for error in errors])
        self.assertLess(along(followed), 0.3e-3)
        self.assertGreater(along(marks), 2 * along(followed))
        for error, row in zip(sorted(followed, key=lambda e: (e.hole, e.number)), plans.compare(plan, SOFT, plans.seeds_of(sim))):
            self.assertEqual((error.hole, error.number), (row.hole, row.planned.number))
            self.assertAlmostEqual(1e3 * error.along("total"), row.along, delta=1e-6)
            self.assertAlmostEqual(1e3 * error.across("total"), row.across, delta=1e-6)

    def test_the_same_seed_gives_the_same_result(self):
        plan = only("E3", seeds=1)
        first, again, other = (carry_out(SOFT, plan, follows_image=True, seed=seed)[0] for seed in (4, 4, 5))
        np.testing.assert_array_equal(first[0].total, again[0].total)
        self.assertGreater(np.linalg.norm(first[0].total - other[0].total), 0.05e-3)

    def test_stabilising_needles_rest_first(self):
        plan, order = only("E3", seeds=1), []
        sim = trocar.Sim(SOFT)
        for needle, poses in Operator(plan=plan, stabilise=["C4", "K4"]).moves(sim, DT):
            order += [needle] if order[-1:] != [needle] else []
            sim.run(poses, DT, needle)
        self.assertEqual(order, [1, 2, 0, 1, 2])
        self.assertEqual([seed.needle for seed in sim.seeds()], [0])
        for holes, words in ((["E3"], "taken"), (["Z9"], "no hole Z9"), (["C4", "C4.0"], "taken")):
            with self.assertRaisesRegex(plans.BadPlan, words):
                Operator(plan=plan, stabilise=holes).needles()

    def test_needles_that_turn_are_refused(self):
        plan = only("E3")
        plan.needles[0].turn = plans.Turn(0.05, 3.0)
        with self.assertRaisesRegex(plans.BadPlan, "does not turn"):
            Operator(plan=plan).moves(trocar.Sim(SOFT), DT)


STUDY = """
scene: SCENE
motion: {plan: plan.yaml, operator: image, image_error: 1e-3, stabilise: [C4]}
samples: {method: grid}
parameters:
  motion.seed: {values: [2, 3]}
record: [seed_error, seed_parts]
"""


class Studies(unittest.TestCase):
    def read(self, text):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            plans.write(only("E3", seeds=1), folder / "plan.yaml")
            (folder / "study.yaml").write_text(text.replace("SCENE", str(SCENE)))
            return definition.read(folder / "study.yaml")

    def test_a_run_is_that_of_the_operator(self):
        study = self.read(STUDY)
        self.assertEqual(study.motion.stabilise, ("C4",))
        columns = study.result_columns()
        self.assertEqual(columns[:2], ["seed_error.mean [m]", "seed_error.worst [m]"])
        self.assertEqual(len(columns), 12)
        row = dict(zip(columns, runs.run(study, np.array([3.0]), SOFT, study._scene)))
        (error,), _ = carry_out(SOFT, only("E3", seeds=1), follows_image=True, seed=3, image_error=1e-3, stabilise=["C4"])
        self.assertAlmostEqual(row["seed_parts.image_along [m]"], abs(error.along("image")), delta=1e-12)
        self.assertAlmostEqual(row["seed_parts.total_across [m]"], error.across("total"), delta=1e-12)
        self.assertAlmostEqual(row["seed_error.mean [m]"], np.linalg.norm(error.total), delta=1e-9)

    def test_a_study_can_have_strands(self):
        self.assertFalse(self.read(STUDY).motion.strands)
        self.assertTrue(self.read(STUDY.replace("operator: image,", "operator: image, strands: true,")).motion.strands)
        with self.assertRaisesRegex(definition.BadStudy, "motion.strands: write true or false"):
            self.read(STUDY.replace("operator: image,", "operator: image, strands: yes,"))

    def test_refusals(self):
        for old, new, words in (("operator: image, ", "", "motion.image_error: only with operator"), ("image,", "photograph,", "expected marks or image"),
                                ("image, image_error: 1e-3, stabilise: [C4]", "marks, speed: 0.1", None)):
            if words:
                with self.assertRaisesRegex(definition.BadStudy, words):
                    self.read(STUDY.replace(old, new))
            else:
                self.assertEqual(self.read(STUDY.replace(old, new)).motion.speed, 0.1)
        with self.assertRaisesRegex(definition.BadStudy, "only where the motion has an operator"):
            self.read(STUDY.replace(", operator: image, image_error: 1e-3, stabilise: [C4]", "").replace("motion.seed: {values: [2, 3]}", "motion.speed: {values: [0.1]}"))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
