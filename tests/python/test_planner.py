#!/usr/bin/python3
"""Tests planning: plans with entry points, rolls and turns; distances from obstacles, compared with formulas; insertions whose plan is known from geometry; the
planner's results, reproduced step by step; the robust plan in newly built samples; seeds; and invalid problems.

usage: test_planner.py BUILD_DIR SOURCE_DIR
"""
import contextlib
import dataclasses
import io
import os
import re
import sys
import tempfile
import unittest
from unittest import mock
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True

import numpy as np

import trocar
from trocar import motion
from trocar.studies import planner
from trocar.brachy import _plan_command as plan_command, plan as plans
from trocar.brachy.implant import Implant
from trocar.brachy._obstacles import Embedding, Obstacle, contour_points, surface_points
from trocar.studies._rehearsal import Aim, Rehearsal, Target
from trocar.studies._search import Case as Search
from trocar.studies._search import Freedom

SCENE = SOURCE / "meshes/figure8.yaml"
PROBLEM = """scene: SCENE
set: {needle.bevel_slope: 0.05}
targets:
  - {name: T1, at: [0.006, 0.004, 0.05]}
entry: {x: [-0.02, 0.02], y: [-0.02, 0.02], z: 0, tilt: 0.2}
"""
WITHOUT_FORCES = "set: {" + ", ".join(
    [f"\"regions[{region}].{key}\": 1e-6" for region in ("prostate", "surrounding")
     for key in ("cutting_force", "cutting_viscosity", "friction.static", "friction.kinetic", "friction.viscous")]
    + ["\"membranes[skin].puncture_force\": 1e-6", "\"membranes[capsule].puncture_force\": 1e-6"]) + "}"


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name)

    def write(self, text, name="problem.yaml"):
        (self.out / name).write_text(text.replace("SCENE", str(SCENE)))
        return self.out / name

    def main(self, *arguments):
        """Returns the program's (status, stdout, stderr)."""
        output, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = planner.main([str(argument) for argument in arguments])
        return status, output.getvalue(), errors.getvalue()

    def solved(self, text, **arguments):
        problem = planner.read(self.write(text))
        models = planner.models_of(problem)
        return problem, models, [planner.plan_target(problem, models, name, point) for name, point in problem.targets]


def moved(model, point, field):
    """Returns the present position (3,), in m, of a point of the tissue. Finds the tetrahedron that contains it by solving for its weights."""
    corners = model.nodes[model.tets]
    matrix = np.concatenate([corners.transpose(0, 2, 1), np.ones((len(corners), 1, 4))], axis=1)
    weights = np.linalg.solve(matrix, np.array([*point, 1.0])[None, :, None])[:, :, 0]
    tet = weights.min(axis=1).argmax()
    return np.asarray(point) + weights[tet] @ field[model.tets[tet]]


def turned(axis, angle):
    return np.array([np.cos(0.5 * angle), *(np.sin(0.5 * angle) * np.asarray(axis))])


def carried_out(model, needle, target, speed=0.08, settle=0.05, dt=1e-3):
    """Returns the vector (3,), in m, from the displaced target to the tip, after executing a plan step by step."""
    direction = np.array(needle.direction)
    cross = np.cross([0.0, 0.0, 1.0], direction)
    upright = turned(cross / np.linalg.norm(cross), np.arcsin(np.linalg.norm(cross))) if np.linalg.norm(cross) > 1e-12 else np.array([1.0, 0, 0, 0])
    sim, roll = trocar.Sim(model), needle.roll

    def pose(depth, angle):
        return np.array([*(np.array(needle.entry) + (depth - model.needle_length) * direction), *motion.multiply(upright, turned([0, 0, 1.0], angle))])

    sim.reset(pose(-0.02, roll))
    ways = [(-0.02, needle.turn.depth), (needle.turn.depth, needle.depth)] if needle.turn else [(-0.02, needle.depth)]
    for i, (start, end) in enumerate(ways):
        if i == 1:
            for part in np.linspace(0, 1, 501)[1:]:    # half a turn in 0.5 s
                sim.step(pose(start, roll + part * needle.turn.by), dt)
            roll += needle.turn.by
        for depth in np.arange(start, end, speed * dt)[1:]:
            sim.step(pose(depth, roll), dt)
    for _ in range(round(settle / dt)):
        sim.step(pose(needle.depth, roll), dt)
    return sim.centreline()[-1] - moved(model, target, sim.displacements())


class PlanFormat(Case):
    PLAN = """needles:
  - {name: "A 1", entry: [0.01, 0, -0.005], direction: [0, 0.3, 3], depth: 0.06, roll: -1.5, turn: {depth: 0.03, by: 3.14}}
  - {entry: [0, 0, 0], depth: 0.05}
"""

    def test_entries_rolls_and_turns_are_read_and_written(self):
        plan = plans.read(self.write(self.PLAN))
        self.assertEqual((plan.template, plan.needles[0].name, plan.needles[0].turn, plan.needles[0].roll), ("", "A 1", plans.Turn(0.03, 3.14), -1.5))
        np.testing.assert_allclose(plan.needles[0].direction, np.array([0, 0.1, 1]) / np.hypot(0.1, 1), atol=1e-12)
        plans.write(plan, self.out / "again.yaml")
        again = plans.read(self.out / "again.yaml")
        for one, other in zip(plan.needles, again.needles):
            np.testing.assert_allclose(one.direction, other.direction, atol=1e-9)
            self.assertEqual(dataclasses.replace(one, line=0, direction=()), dataclasses.replace(other, line=0, direction=()))

    def test_holes_with_roll_and_several_needles_without_seeds(self):
        text = "template: t\ncolumns: 3\nrows: 3\nspacing: 5e-3\nneedles:\n"
        plan = plans.read(self.write(text + "  - {hole: B1.5, depth: 0.05, seeds: [], roll: 1}\n  - {hole: B1.5, depth: 0.06, seeds: []}\n"))
        self.assertEqual([needle.roll for needle in plan.needles], [1.0, 0.0])
        plans.write(plan, self.out / "again.yaml")
        self.assertEqual([needle.roll for needle in plans.read(self.out / "again.yaml").needles], [1.0, 0.0])

    def test_a_table_that_would_lose_the_roll_is_refused(self):
        text = (SOURCE / "docs/examples/implant-plan.yaml").read_text().replace("{hole: E3, ", "{hole: E3, roll: 0.5, ")
        errors = io.StringIO()
        with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
            command = ["show", str(self.write(text, "plan.yaml")), "--scene", str(SOURCE / "meshes/implant.yaml")]
            self.assertEqual((plan_command.main(command), plan_command.main([*command, "--out", str(self.out / "plan.csv")])), (0, 2))
        self.assertRegex(errors.getvalue(), r"plan.yaml:\d+: needle E3: the table cannot express a roll")
        self.assertFalse((self.out / "plan.csv").exists())

    def test_bad_needles_are_refused(self):
        for old, new, words in (("entry: [0, 0, 0]", "hole: A1", ":1: missing key \"template\""), ("depth: 0.05}", "depth: 0.05, seeds: [1e-3]}", ":3: .*only of a needle in a hole"),
                                ("depth: 0.03", "depth: 0.07", ":2: .*turn.depth: 0.07 m is not before"), ("[0, 0.3, 3]", "[0, 0, 0]", ":2: .*direction: it has no length"),
                                ("entry: [0, 0, 0]", "name: x", ":3: .*write a hole or an entry|:1: missing key"), ("[0, 0, 0]", "[0, 0]", ":3: .*2 numbers: write 3")):
            self.assertEqual(self.PLAN.count(old), 1, old)
            with self.assertRaisesRegex(plans.BadPlan, words):
                plans.read(self.write(self.PLAN.replace(old, new)))

    def test_motion_rolls_turns_and_tilts(self):
        plan = plans.read(self.write(self.PLAN))
        sim = trocar.Sim(trocar.Model(trocar.Scene.load(SCENE)))
        length, needle, tips = sim.model.needle_length, plan.needles[0], []
        for poses in Implant(plan=plan, settle=0.003).insert(sim, needle, 1e-3):
            tips.append((poses[:, :3] + length * motion.axis_of(poses), motion.rotate(poses[:, 3:], [0.0, 1.0, 0.0])))
        line = np.array(needle.entry) + np.linspace(0, needle.depth, 7)[:, None] * needle.direction
        np.testing.assert_allclose(tips[-1][0][-1], line[-1], atol=1e-12)
        np.testing.assert_allclose(tips[0][0][-1], line[3], atol=1e-12)
        self.assertLess(np.ptp(tips[1][0], axis=0).max(), 1e-12)    # the needle stays in place while it turns
        for bevel, roll in ((tips[0][1][0], -1.5), (tips[-1][1][-1], 3.14 - 1.5)):
            np.testing.assert_allclose(bevel[0], -np.sin(roll), atol=5e-3)    # the bevel is rotated about z, apart from the effect of the tilt
        self.assertEqual(len(tips[-1][0]), 3)


class Obstacles(Case):
    def test_distance_from_a_cylinder_of_contours(self):
        angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
        outlines = [np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.full(60, z)]) for z in (0, 5, 10)]    # mm
        cylinder = Obstacle("c", 1e-3, contour_points(outlines, lambda points: 1e-3 * points, 0.5e-3))
        for shaft, expected in ((((0.015, -0.1, 0.005), (0.015, 0.1, 0.005)), 5e-3), (((0.002, -0.1, 0.006), (0.002, 0.1, 0.006)), 0.0),
                                (((-0.1, 0.0, 0.0155), (0.1, 0.0, 0.0155)), 3e-3)):
            self.assertAlmostEqual(cylinder.distance(np.array(shaft), 0.0), expected, delta=0.3e-3)
        self.assertAlmostEqual(cylinder.distance(np.array([[0.015, -0.1, 0.005], [0.015, 0.1, 0.005]]), 0.5e-3), 4.5e-3, delta=0.1e-3)

    def test_moves_with_the_tissue(self):
        model = trocar.Model(trocar.Scene.load(SCENE), mesh_only=True)
        capsule = Obstacle("capsule", 1e-3, surface_points(model, "capsule", 1e-3))
        scale = np.array([1.1, 0.95, 1.05])
        field, shaft = model.nodes * (scale - 1.0), np.array([[0.05, 0.03, -0.02], [0.045, 0.005, 0.09]])
        t = np.linspace(0, 1, 2001)[:, None]
        line = shaft[0] + t * (shaft[1] - shaft[0])
        brute = min(np.linalg.norm(capsule.points * scale - place, axis=1).min() for place in line)
        found = capsule.distance(shaft, 1e-3, Embedding(model), field)
        self.assertAlmostEqual(found, brute - 1e-3, delta=2e-5)
        self.assertLessEqual(capsule.distance(shaft, 1e-3, Embedding(model), field, enough=0.0), found + 1e-12)

    def test_in_tissue_that_does_not_move_it_is_as_at_rest(self):
        """With zero displacements, rounding errors in the search radius must not exclude the obstacle's point nearest to the needle."""
        model = trocar.Model(trocar.Scene.load(SCENE), mesh_only=True)
        embedding, still, random = Embedding(model), np.zeros_like(model.nodes), np.random.default_rng(1)
        for _ in range(300):
            obstacle = Obstacle("x", 2e-3, random.uniform(-0.03, 0.03, (200, 3)) + [0, 0, 0.03])
            start = random.uniform(-0.02, 0.02, 3)
            shaft = np.linspace(start, start + [0, 0, 0.1], 20)
            self.assertAlmostEqual(obstacle.distance(shaft, 5e-4, embedding, still), obstacle.distance(shaft, 5e-4), delta=1e-12)


class Geometry(Case):
    """Tissue without forces is not displaced, so the plan is a straight line."""

    def test_straight_through_the_area(self):
        text = PROBLEM.replace("set: {needle.bevel_slope: 0.05}", WITHOUT_FORCES)
        _, _, (result,) = self.solved(text)
        np.testing.assert_allclose(result.needle.entry, [0.006, 0.004, 0], atol=2e-5)
        self.assertAlmostEqual(result.needle.depth, 0.05, delta=2e-5)
        for expected in (result.expected, result.rigid, result.unplanned):
            self.assertLess(expected.error, 2e-5)
        self.assertTrue(result.reached)

    def test_tilted_from_a_narrow_area(self):
        text = PROBLEM.replace("set: {needle.bevel_slope: 0.05}", WITHOUT_FORCES).replace("[-0.02, 0.02], y", "[-0.004, -0.002], y")
        _, _, (result,) = self.solved(text)
        needle = result.needle
        end = np.array(needle.entry) + needle.depth * np.array(needle.direction)
        np.testing.assert_allclose(end, [0.006, 0.004, 0.05], atol=2e-5)
        self.assertTrue(-0.004 <= needle.entry[0] <= -0.002)
        self.assertAlmostEqual(np.arctan(needle.direction[0] / needle.direction[2]), np.arctan((0.006 - needle.entry[0]) / 0.05), delta=1e-3)
        self.assertAlmostEqual(result.unplanned.error, 8e-3, delta=1e-4)    # distance from a straight line that starts at the edge of the permitted area

    def test_tilt_that_does_not_suffice_is_told(self):
        text = PROBLEM.replace("set: {needle.bevel_slope: 0.05}", WITHOUT_FORCES).replace("[-0.02, 0.02], y", "[-0.004, -0.002], y").replace("tilt: 0.2", "tilt: 0.1")
        _, _, (result,) = self.solved(text)
        least = (0.008 - 0.05 * np.tan(0.1)) * np.cos(0.1)    # distance from the line with the largest tilt
        self.assertAlmostEqual(result.expected.error, least, delta=1e-4)
        self.assertFalse(result.reached)
        self.assertRegex(result.why, "entry is at its limit.*tilt is at its limit")

    def test_beside_bone_without_a_tilt(self):
        """Nodes in the bone are fixed, so the tissue there does not move at all."""
        text = "scene: " + str(SOURCE / "meshes/prostate.yaml") + """
set: {needle.bevel_slope: 0.05}
coordinates: patient
targets:
  - {name: apex, at: [-13, -8, -3]}
entry: {x: [-25, 25], y: [-10, 20], z: -55}
avoid:
  - {surface: bone, clearance: 2e-3}
"""
        for tilt in ("", ", tilt: 0"):
            status, output, errors = self.main("run", self.write(text.replace("z: -55", f"z: -55{tilt}")), "--out", self.out / "o")
            self.assertIn(status, (0, 1), errors)
            self.assertNotIn("ended without a result", errors)
            self.assertRegex(output, r"\| apex \|.*\+0.0 \+0.0")

    def test_around_an_obstacle(self):
        rows = ["roi,outline,x_mm,y_mm,z_mm"]
        for z in (5, 10, 15):    # a column in front of the target, 6 mm wide
            rows += [f"Rod,{z},{x},{y},{z}" for x, y in ((-9, -7), (-3, -7), (-3, -1), (-9, -1))]
        self.write("\n".join(rows) + "\n", "rod.csv")
        identity = "patient_to_mesh: [-1e-3,0,0,0, 0,-1e-3,0,0, 0,0,1e-3,0, 0,0,0,1]"
        scene = SCENE.read_text().replace("mesh: ", f"mesh: {SOURCE}/meshes/") + identity + "\n"
        self.write(scene, "scene.yaml")
        text = PROBLEM.replace("scene: SCENE", "scene: scene.yaml").replace("set: {needle.bevel_slope: 0.05}", WITHOUT_FORCES)
        problem, models, (result,) = self.solved(text + "avoid: [{contours: rod.csv, roi: Rod, clearance: 2e-3}]\n")
        self.assertTrue(result.reached, result.why)
        self.assertLess(result.unplanned.clearance, -2e-3)
        self.assertGreater(result.rigid.clearance, -1e-4)
        shaft = np.array(result.expected.shaft)
        inside = shaft[-1] + np.linspace(0, 1, 4001)[:, None] * (shaft[0] - shaft[-1])
        box = np.maximum(np.abs(inside - [0.006, 0.004, 0.010]) - [3e-3, 3e-3, 7.5e-3], 0.0)    # the region extends half a slice beyond the last slice
        self.assertGreater(np.linalg.norm(box, axis=1).min(), 2e-3 + 0.6e-3)    # clearance, plus the radius of the 18 G needle, 0.635 mm


class Promises(Case):
    def test_what_is_promised_is_what_happens(self):
        problem, models, (result,) = self.solved(PROBLEM + "turn: true\n")
        self.assertTrue(result.reached)
        self.assertGreater(result.unplanned.error, 1e-3)    # the bevel bends the needle sideways
        offset = carried_out(trocar.Model(problem.scene()), result.needle, result.target)
        np.testing.assert_allclose(offset, result.expected.offset, atol=1e-5)
        self.assertLess(np.linalg.norm(offset), 5e-5)

    def test_worst_case_in_models_built_anew(self):
        moduli = {"prostate": 60e3, "surrounding": 30e3}
        scene = trocar.Scene.load(SCENE)
        moduli = {name: scene[f"regions[{name}].youngs_modulus"] for name in moduli}
        lines = "".join(f"    regions[{name}].youngs_modulus: {{values: [{0.7 * value}, {1.3 * value}]}}\n" for name, value in moduli.items())
        text = PROBLEM.replace("tilt: 0.2", "tilt: 0") + "roll: 0\nuncertainty:\n  samples: {method: grid}\n  parameters:\n" + lines
        _, _, (result,) = self.solved(text)
        errors = []
        for stiffness in [(1, 1)] + [(a, b) for a in (0.7, 1.3) for b in (0.7, 1.3)]:
            scene = trocar.Scene.load(SCENE)
            scene["needle.bevel_slope"] = 0.05
            for (name, value), factor in zip(moduli.items(), stiffness):
                scene[f"regions[{name}].youngs_modulus"] = factor * value
            errors.append(np.linalg.norm(carried_out(trocar.Model(scene), result.needle, result.target)))
        self.assertAlmostEqual(max(errors), result.expected.worst, delta=1e-5)
        self.assertAlmostEqual(np.mean(errors), result.expected.mean, delta=1e-5)
        self.assertLess(result.expected.worst, 0.95 * result.nominal.worst)
        self.assertGreater(result.expected.error, result.nominal.error)    # at the nominal values, the robust plan is worse than the nominal one

    def test_few_insertions_suffice(self):
        """The search reuses its Jacobian. Finite differences over all variables would take 7 insertions per step, or 35 with five samples."""
        text = (SOURCE / "docs/examples/planning.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes"))
        problem = planner.read(self.write(text))
        models, targets = planner.models_of(problem), dict(problem.targets)
        robust = planner.plan_target(problem, models, "right apex", targets["right apex"])
        self.assertLessEqual(robust.expected.worst, 0.3e-3)
        self.assertLessEqual(robust.runs, 100)
        problem.objective = "nominal"
        for name in ("left apex", "left anterior apex"):
            result = planner.plan_target(problem, models[:1], name, targets[name])
            self.assertTrue(result.reached)
            self.assertLess(np.linalg.norm(carried_out(models[0], result.needle, targets[name])), 0.02e-3)
            self.assertGreater(result.rigid.error, 1e-3)
            self.assertLessEqual(result.runs, 12)

    def test_saved_states_change_nothing(self):
        scene = trocar.Scene.load(SCENE)
        scene["needle.bevel_slope"] = 0.05
        model = trocar.Model(scene)
        target = Target([0.006, 0.004, 0.05], model)
        aim = Aim(np.array([0.006, 0.004, 0.0]), np.array([0.0, 0.0, 1.0]), 0.3, plans.Turn(0.02, np.pi))
        used = Rehearsal(model, Implant())
        for turn, depth in ((0.021, 0.05), (0.02, 0.052), (0.02, 0.049)):
            used.at(aim._replace(turn=plans.Turn(turn, np.pi)), depth, target)
        begun = used.ticks
        one, other = used.at(aim, 0.0505, target), Rehearsal(model, Implant()).at(aim, 0.0505, target)
        self.assertLess(used.ticks - begun, 150)    # of about 1400
        np.testing.assert_array_equal(one.shaft, other.shaft)
        np.testing.assert_array_equal(one.field, other.field)

    def test_same_for_any_number_of_workers(self):
        text = PROBLEM.replace("entry:", "  - {name: T2, at: [-0.004, 0.002, 0.045]}\nentry:")
        problem = planner.read(self.write(text))
        models = planner.models_of(problem)
        one, two = (planner.plan(problem, models, workers) for workers in (1, 2))
        same = lambda results: [dataclasses.replace(result, seconds=0.0) for result in results]
        self.assertEqual(same(one), same(two))
        self.assertEqual([result.name for result in one], ["T1", "T2"])


class Template(Case):
    def test_rolls_the_bevel_away_from_a_target_beside_the_hole(self):
        text = (SOURCE / "docs/examples/planning-template.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes"))
        text = text[:text.index("targets:")].replace("coordinates: patient", "coordinates: mesh") + \
            "targets: [{name: far, at: [-0.0135, 0.0005, 0.055]}]\nentry: {template: template, holes: [I4]}\nturn: false\n"
        problem, models, (result,) = self.solved(text)
        self.assertEqual(result.needle.hole, "I4")
        guide = models[0].guides[0]
        off = np.array(result.target) - plans.hole_axis(guide, "I4")
        off -= (off @ guide.normal) * guide.normal
        # At roll 0 the bevel faces +y, and the tip deviates toward -y. The target is too far away to be reached by that deviation.
        away = np.array([np.sin(result.needle.roll), -np.cos(result.needle.roll), 0.0])
        self.assertGreater(away @ off / np.linalg.norm(off), np.cos(0.25))
        self.assertLess(result.expected.error, result.rigid.error - 1e-3)
        self.assertFalse(result.reached)
        self.assertIn("bevel", result.why)


class Seeds(Case):
    def test_deeper_needles_leave_seeds_at_their_places(self):
        text = (SOURCE / "docs/examples/planning-seeds.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes")).replace(
            "implant-plan.yaml", str(SOURCE / "docs/examples/implant-plan.yaml"))
        path = self.write(text[:text.index("uncertainty:")])
        status, output, errors = self.main("run", path, "--out", self.out / "plan", "--only", "F4", "--workers", "1", "--quiet", "--no-plots")
        self.assertIn(status, (0, 1), errors)
        scene = trocar.Scene.load(SOURCE / "meshes/implant.yaml")
        model, before, after = trocar.Model(scene), plans.read(SOURCE / "docs/examples/implant-plan.yaml"), plans.read(self.out / "plan/plan.yaml")
        self.assertEqual([needle for needle in before.needles if needle.hole != "F4"], [dataclasses.replace(needle, line=old.line) for needle, old in
                                                                                        zip(after.needles, before.needles) if needle.hole != "F4"])
        means = []
        for plan in (before, after):    # each plan is executed and compared with the original one
            only = lambda plan: dataclasses.replace(plan, needles=[needle for needle in plan.needles if needle.hole == "F4"])
            sim = trocar.Sim(model)
            for poses in Implant(plan=only(plan)).play(sim, 1e-3):
                sim.run(poses, 1e-3)
            means.append(plans.summary(plans.compare(only(before), model, plans.seeds_of(sim))))
        self.assertGreater(means[0]["along"], 1.0)
        self.assertLess(means[1]["along"], 0.15)
        self.assertRegex(output, rf"\| F4 .*\| {means[1]['distance']:.2f} \|")


class Failures(Case):
    """Tests insertions that cannot be simulated, and searches that end without a result."""

    def seeds(self):
        text = (SOURCE / "docs/examples/planning-seeds.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes")).replace(
            "implant-plan.yaml", str(SOURCE / "docs/examples/implant-plan.yaml"))
        return planner.read(self.write(text))

    def test_an_insertion_that_cannot_be_simulated_ranks_last(self):
        problem = planner.read(self.write(PROBLEM))
        case = Search(problem, planner.models_of(problem), problem.targets[0][1])
        with mock.patch.object(Rehearsal, "best", side_effect=trocar.Error("lost", "numeric")):
            found = case.search(Freedom(problem, case.rigid()[1], 0.05, 0.0))
        self.assertGreater(found.rank(), dataclasses.replace(found, missing=0.01, error=0.03).rank())

    def test_turns_are_those_that_a_plan_may_have(self):
        problem = planner.read(self.write(PROBLEM + "turn: true\n"))
        freedom = Freedom(problem, Aim(np.array([0.006, 0.004, 0.0]), np.array([0.0, 0.0, 1.0])), 0.05, 0.0)
        self.assertGreaterEqual(freedom.aim(freedom.low).turn.depth, 1e-3)

    def test_one_sample_that_cannot_be_simulated_leaves_the_others(self):
        problem = self.seeds()
        problem.objective = "nominal"
        given, scene = problem.plan.needles[0], trocar.Scene.load(SOURCE / "meshes/implant.yaml")
        one, other = (trocar.Model(scene, mesh_only=True) for _ in range(2))

        def placed(problem, model, given, needle):
            if model is other:
                raise trocar.Error("the tip is lost", "numeric")
            return np.full((len(given.seeds), 3), 1e-6)

        with mock.patch.object(planner, "_placed", placed):
            result = planner.plan_seeds(problem, [one, other], given)
            problem.tolerance = 1e-9
            short = planner.plan_seeds(problem, [one, other], given)
        np.testing.assert_allclose(result.after, [[np.sqrt(3) * 1e-6] * 4, [np.nan] * 4])
        self.assertEqual((result.reached, short.reached, short.why), (True, False, "cannot be simulated: the tip is lost"))

    def test_finished_results_are_kept_and_the_lost_one_is_named(self):
        problem, lost = self.seeds(), []

        def plan_seeds(problem, models, needle):
            if needle.hole == "F4":
                raise MemoryError()
            return planner.SeedResult(needle, [[0.0]], [[0.0]], True, "", 1)

        with mock.patch.object(planner, "plan_seeds", plan_seeds):
            results = planner.plan(problem, [None], 1, lost=lost.append)
            self.assertEqual([result.needle.hole for result in results], [needle.hole for needle in problem.plan.needles if needle.hole != "F4"])
            self.assertEqual(len(lost), 1)
            self.assertRegex(lost[0], "needle F4: .*ended without a result")
            with self.assertRaisesRegex(trocar.Error, "needle F4"):
                planner.plan(problem, [None], 1)


class Program(Case):
    BAD = [
        ("scene: SCENE", "scene: none.yaml", r":1: scene: no file .*none.yaml"),
        ("set: {needle.bevel_slope: 0.05}", "set: {needle.bevel: 1}", r":2: set.needle.bevel: scene: no key"),
        ("[0.006, 0.004, 0.05]", "[6, 4, 50]", r":4: targets\[0\].at: not in the tissue at rest: write x, y, z in metres in the mesh"),
        ("at: [0.006", "place: [0.006", r":4: targets\[0\]: unknown key \"place\""),
        ("name: T1, at: [0.006, 0.004, 0.05]}", "name: T1, at: [0.006, 0.004, 0.05]}\n  - {name: T1, at: [0, 0, 0.05]}", r":5: .*\"T1\" is another target's"),
        ("x: [-0.02, 0.02]", "x: [0.02, -0.02]", r":5: entry.x: -0.02 is not above 0.02"),
        ("x: [-0.02, 0.02]", "x: 0.01", r":5: entry: write two of x, y and z as \[from, to\]"),
        ("z: 0, tilt", "z: 0.03, tilt", r":5: entry: the rectangle is in the tissue"),
        ("z: 0, tilt", "z: -0.01, direction: [0, 0, -1], tilt", r":5: entry: target \"T1\" is in front of the rectangle"),
        ("z: 0, tilt: 0.2", "tilt: 0.2", r":5: entry: missing key \"z\""),
        ("tilt: 0.2", "tilt: 20", r":5: entry.tilt: 20: write an angle"),
        ("entry: {x: [-0.02, 0.02], y: [-0.02, 0.02], z: 0, tilt: 0.2}", "entry: {template: t}", r":5: entry.template: no guide \"t\": the scene has none"),
        ("entry:", "coordinates: patient\nentry:", r":5: coordinates: the scene has no patient_to_mesh"),
        ("entry:", "speed: 1e-6\nentry:", r":5: speed: \"1e-6\": write a number of 0.001 or above"),
        ("entry:", "turns: 2\nentry:", r":5: unknown key \"turns\""),
        ("entry:", "avoid: [{surface: bone, clearance: 1e-3}]\nentry:", r":5: avoid\[0\].surface: no surface \"bone\": the mesh has .*capsule"),
        ("entry:", "avoid: [{surface: capsule, clearance: 1e-3, roi: x}]\nentry:", r":5: avoid\[0\]: \"roi\", the name of a region of interest in the file, is required"),
        ("set: {needle.bevel_slope: 0.05}", "turn: true", r":2: turn: the scene's needle has no bevel"),
        ("entry:", "uncertainty: {samples: {method: saltelli, count: 4, seed: 1}, parameters: {}}\nentry:", r":5: samples.method: \"saltelli\": there are sobol"),
        ("entry:", "uncertainty: {samples: {method: random, count: 4, seed: 1}, parameters: {motion.x: {uniform: [0, 1]}}}\nentry:", r":5: parameters.motion.x: not of a plan"),
        ("entry:", "uncertainty: {objective: best, samples: {method: grid}, parameters: {}}\nentry:", r":5: uncertainty.objective: \"best\": there are nominal, mean, worst"),
        ("targets:\n  - {name: T1, at: [0.006, 0.004, 0.05]}\n", "", r":1: write targets, or a plan"),
        ("name: T1", "name: T|1", r":4: targets\[0\].name: write one line without \|"),
        ("name: T1", "name: \"T\\n1\"", r":4: targets\[0\].name: write one line without \|"),
        ("entry:", "tolerance: 0.3\nentry:", r":5: tolerance: 0.3 m: write at most 0.1; lengths are in metres"),
        ("entry:", "settle: 1e9\nentry:", r":5: settle: 1e\+09 s: write at most 60"),
        ("entry:", "avoid: [{surface: capsule, clearance: 2}]\nentry:", r":5: avoid\[0\].clearance: 2 m: write at most 0.1; lengths are in metres"),
        ("entry:", "uncertainty: {samples: {method: random, count: 65, seed: 1}, parameters: {\"regions[prostate].youngs_modulus\": {uniform: [1e3, 2e3]}}}\nentry:",
         r":5: samples: 65 of them: write at most 64, as a model of each is kept in memory"),
        ("entry:", "uncertainty: {samples: {method: random, count: 4, seed: 1}, parameters: {needle.outer_diameter: {uniform: [1e-3, 2e-3]}}}\nentry:",
         r":5: parameters.needle.outer_diameter: not of a plan"),
        ("[0.006, 0.004, 0.05]}\nentry: {x: [-0.02, 0.02], y: [-0.02, 0.02], z: 0, tilt", "[-0.045, 0, 0.005]}\nentry: {x: [-0.02, 0.02], y: [-0.02, 0.02], z: 0, "
         "direction: [0.97, 0, 0.24], tilt", r":5: entry: the direction points away from target \"T1\""),
        ("entry:", "avoid: [{region: surrounding, clearance: 0}]\nentry:", r":5: avoid\[0\].region: \"surrounding\" is too large: .* points, 0.25 mm apart"),
    ]

    def test_bad_problems_are_refused_with_file_line_and_remedy(self):
        for old, new, words in self.BAD:
            self.assertEqual(PROBLEM.count(old), 1, old)
            path = self.write(PROBLEM.replace(old, new))
            with self.subTest(new=new):
                status, _, errors = self.main("run", path, "--out", self.out / "plan", "--quiet")
                self.assertEqual(status, 2, errors)
                self.assertRegex(errors, "problem.yaml" + words)
                self.assertFalse((self.out / "plan").exists())

    def test_holes_are_named_once(self):
        text = (SOURCE / "docs/examples/planning-template.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes"))
        for holes, words in (("[]", "entry.holes: empty: write at least one"), ("[C3, D4, C3.0]", r"entry.holes\[2\]: C3 is given twice")):
            path = self.write(text.replace("{template: template}", f"{{template: template, holes: {holes}}}"))
            status, _, errors = self.main("check", path)
            self.assertEqual(status, 2)
            self.assertRegex(errors, words)

    def test_keeps_what_it_has_not_made(self):
        path = self.write(PROBLEM)
        (self.out / "plan.yaml").write_text("mine\n")
        seeds = (SOURCE / "docs/examples/planning-seeds.yaml").read_text().replace("../../meshes", str(SOURCE / "meshes"))
        made = "# Made by trocar-plan\n" + (SOURCE / "docs/examples/implant-plan.yaml").read_text()
        for name, text in (("problem.yaml", "mine\n"), ("seeds.yaml", made)):
            if text == made:
                path = self.write(seeds.replace("implant-plan.yaml", "plan.yaml"), name)
                (self.out / "plan.yaml").write_text(made)
            status, _, errors = self.main("run", path, "--out", self.out, "--quiet")
            self.assertEqual(status, 2)
            self.assertRegex(errors, "plan.yaml: it would be overwritten: choose another folder with --out")
            self.assertEqual((self.out / "plan.yaml").read_text(), text)

    def test_what_would_fail_at_the_end_fails_at_the_start(self):
        path = self.write(PROBLEM)
        for out in (path, path / "plan"):
            status, _, errors = self.main("run", path, "--out", out, "--quiet")
            self.assertEqual(status, 2)
            self.assertIn(f"{out}: not a folder: choose another folder with --out", errors)
        with mock.patch.dict(sys.modules, {"matplotlib": None}):
            status, _, errors = self.main("run", path, "--out", self.out / "plan", "--quiet")
        self.assertEqual(status, 3)
        self.assertIn("python3-matplotlib", errors)
        with mock.patch.object(planner, "models_of", side_effect=MemoryError()):
            status, _, errors = self.main("run", path, "--out", self.out / "plan", "--quiet")
        self.assertEqual((status, errors.count("\n")), (3, 1))
        self.assertIn("not enough memory", errors)
        self.assertFalse((self.out / "plan").exists())

    def test_plans_that_cannot_be_carried_out_are_refused(self):
        path = self.write(PROBLEM)
        plan = "needles:\n  - {name: T1, entry: [0.006, 0.004, 0], depth: 0.05}\n"
        for old, new, words in (("0.05}", "60}", "its depth of 60 m .*lengths are in metres"), ("0.05}", "1e9}", r"its depth of 1e\+09 m .*lengths are in metres"),
                                ("0.004, 0]", "0.004, 0.01]", "its entry is in the tissue")):
            status, output, errors = self.main("carry-out", path, self.write(plan.replace(old, new), "plan.yaml"))
            self.assertEqual((status, output), (2, ""))
            self.assertRegex(errors, f"plan.yaml:2: needle T1: {words}")
        with mock.patch.object(planner, "carried_out", side_effect=trocar.Error("the tip\nis lost", "numeric")):
            status, output, errors = self.main("carry-out", path, self.write(plan, "plan.yaml"))
        self.assertEqual(status, 1)
        self.assertIn("| T1 | - |", output)
        self.assertIn("plan.yaml:2: needle T1: cannot be simulated: the tip is lost", errors)

    def test_runs_checks_and_carries_out(self):
        path = self.write(PROBLEM)
        status, output, errors = self.main("check", path)
        self.assertEqual((status, errors), (0, ""))
        self.assertRegex(output, "1 targets; .*depth and roll are free")
        status, output, errors = self.main("run", path, "--out", self.out / "plan", "--quiet")
        self.assertEqual((status, errors), (0, ""))
        self.assertIn("1 of 1 targets are reached within 0.3 mm", output)
        self.assertEqual({file.name for file in (self.out / "plan").iterdir()}, {"plan.yaml", "result.csv", "summary.md", "errors.svg", "paths.svg"})
        status, output, errors = self.main("carry-out", path, self.out / "plan/plan.yaml")
        self.assertEqual((status, errors), (0, ""))
        self.assertRegex(output, r"\| T1 \| 0\.0\d \|")
        plan = (self.out / "plan/plan.yaml").read_text()
        self.write(re.sub(r"depth: ([\d.]+)", lambda match: f"depth: {float(match[1]) + 2e-3}", plan), "deeper.yaml")
        self.assertRegex(self.main("carry-out", path, self.out / "deeper.yaml")[1], r"\| T1 \| (1\.9|2\.0)\d \|")
        self.write(plan.replace("T1", "T9"), "other.yaml")
        status, _, errors = self.main("carry-out", path, self.out / "other.yaml")
        self.assertEqual(status, 2)
        self.assertRegex(errors, "other.yaml:3: needle T9: no target in .* has its name")
        status, _, errors = self.main("run", path, "--only", "T2", "--out", self.out / "plan")
        self.assertEqual(status, 2)
        self.assertIn("--only T2: there is no such target: there are T1", errors)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
