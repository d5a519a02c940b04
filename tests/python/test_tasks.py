#!/usr/bin/python3
"""Tests that the shipped tasks can be done: an error-free virtual operator who follows the image carries them out in a simulation and meets all criteria.

usage: test_tasks.py BUILD_DIR SOURCE_DIR [whole]        whole: only the two whole implants, which take five minutes

With a folder in the environment variable REFERENCES, writes the runs' reports there instead of comparing them with the shipped reference runs in
meshes/tasks/reference. Add the key "reference" to a new task only after that.
"""
import os
import sys
import tempfile
import unittest
from pathlib import Path

from test_training import SOURCE, Log    # also selects the build's library and package

import numpy as np

import trocar
from trocar._locate import locate
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator
from trocar.motion import minimum_jerk, towards
from trocar.training import Task, score
from trocar.training._report import as_json, read_report

WHOLE, REFERENCES = sys.argv[3:] == ["whole"], os.environ.get("REFERENCES", "")
SAME = 0.01        # relative difference from the reference run; more than rounding errors, less than a trainee would see
DT = 4e-3          # s
FRAME = 25         # steps between two recorded frames of the tissue
RAISED = 2e-3      # m, how far the probe is raised, of which the last 1.5 mm press on the wall
PERFECT = dict(image_error=0.0, splay=0.0, speed_spread=0.0)


def plan_for(task):
    """Returns a task's plan. For targets, it is a plan with a seed behind each, because the operator brings the tip to the distal end of a seed."""
    if task.plan:
        return task.plan
    guide, half = task.model.guides[0], 0.5 * task.model.seed_size.length
    needles = [plans.Needle(t.hole, float((t.position - plans.hole_axis(guide, t.hole)) @ guide.normal), [half]) for t in task.targets]
    return plans.Plan(guide.name, guide.columns, guide.rows, guide.spacing, needles)


def add_state(log, sim, needle):
    """Adds the server's messages that describe the tissue, a needle, the probe and the seeds."""
    line, tracks, seeds = sim.centreline(needle), sim.tracks(needle), sim.seeds()
    log.add("TROCAR_CONTACTS", "contacts_t", needle=needle, joint_count=len(line), centreline=line.tolist(), pose_utime=0, orientation=[1, 0, 0, 0], tip_lead=0.0,
            contact_count=0, position=[], force=[], arc=[], state=b"", kind=b"")
    log.tissue(sim.displacements())
    if sim.probe:
        log.add("TROCAR_PROBE_WRENCH", "probe_wrench_t", position=sim.probe.pose[:3].tolist(), orientation=sim.probe.pose[3:].tolist(), force=sim.probe.force.tolist(),
                torque=sim.probe.torque.tolist(), session=1, pose_seq=1, contacts=sim.probe.contacts)
    log.tracks(*(track.points.tolist() for track in tracks), needle=needle)
    place, along = [s.position.tolist() for s in seeds], [s.direction.tolist() for s in seeds]
    log.add("TROCAR_SEEDS", "seeds_t", needle_count=1, pending=[0], seed_count=len(seeds), position=place, direction=along, rest_position=place, rest_direction=along,
            needle=[s.needle for s in seeds], guide=[s.guide for s in seeds], hole=[s.hole for s in seeds], strand=[s.strand for s in seeds])


class CarefulHand:
    """Carries out a plan, one needle after another. Tissue sticks to the shaft, so the hand pushes the tip past the position of each needle's first seed, draws
    it back to where the image shows that position, and corrects until it is there. Then it drops the seed. Iterating yields the poses of each stroke, as
    Operator does."""

    SPEED = 0.04       # m/s
    PAST = 6e-3        # m
    NEAR = 3e-4        # m
    LOOKS = 6          # maximum number of corrections
    REST = 0.5         # s

    def __init__(self, plan, sim):
        self.plan, self.sim, self.needle = plan, sim, 0

    def __iter__(self):
        model, half = self.sim.model, 0.5 * self.sim.model.seed_size.length
        for needle in self.plan.needles:
            self.face, self.axis = plans.needle_axis(self.plan, needle, model)
            self.depth = -2e-3
            self.sim.reset(self.pose(self.depth), self.needle)
            for i, behind in enumerate(needle.seeds):
                place = needle.depth - behind
                tets, weights = locate(model, [self.face + place * self.axis])
                ring = lambda: place + half + float(weights[0] @ self.sim.displacements()[model.tets[tets[0]]] @ self.axis)
                if i == 0:
                    yield from self.follow(lambda: ring() + self.PAST)
                yield from self.follow(ring)
                self.sim.drop_seeds(needle=self.needle)
                yield self.needle, self.stroke(self.depth - 2 * half)
                while self.sim.pending_seeds(self.needle):    # at first, tissue and seed follow the shaft
                    yield self.needle, self.stroke(self.depth - 5e-4)
            yield self.needle, self.stroke(-2e-3)

    def pose(self, depth):
        return np.array([*(self.face + (depth - self.sim.model.needle_length) * self.axis), *towards(self.axis)])

    def stroke(self, depth):
        steps = max(int(abs(depth - self.depth) / self.SPEED / DT), 1)
        depths = self.depth + (depth - self.depth) * minimum_jerk(np.linspace(0.0, 1.0, steps + 1)[1:])
        self.depth = depth
        return np.array([self.pose(d) for d in [*depths, *[depth] * round(self.REST / DT)]])

    def follow(self, wanted):
        for _ in range(self.LOOKS):
            depth = wanted()
            if abs(depth - self.depth) < self.NEAR:
                return
            yield self.needle, self.stroke(depth)


class Solvable(unittest.TestCase):
    def carry_out(self, name, hand=lambda task, sim: Operator(plan=plan_for(task), follows_image=True, **PERFECT).moves(sim, DT)):
        task = Task.read(SOURCE / "meshes/tasks" / f"{name}.yaml")
        sim, log = trocar.Sim(trocar.Model(trocar.Scene.load(task.scene))), Log(period=DT)
        if task.has_probe:
            sim.set_probe(sim.model.probe_start + [0.0, RAISED, 0.0, 0.0, 0.0, 0.0, 0.0])
        for needle, poses in hand(task, sim):
            for first in range(0, len(poses), FRAME):
                for row in sim.run(poses[first:first + FRAME], DT, needle):
                    log.wrench(float(row["depth"]), row["force"].tolist(), needle, 1 + needle)
                add_state(log, sim, needle)
        with tempfile.TemporaryDirectory() as folder:
            result = score(task, log.write(Path(folder, "run.log")))
        self.check_reference(result)
        return task, sim, result

    def check_reference(self, result):
        """Compares a run with the shipped reference run of its task, so that a change of the simulator that changes a trainee's score is seen."""
        if REFERENCES:
            Path(REFERENCES, f"{result.task.name}.json").write_text(as_json(result))
            return
        reference = read_report(Path(result.task.reference), result.task.name)
        self.assertTrue(reference.passed)
        self.assertEqual(result.lost, 0)
        self.assertEqual(list(reference.measures), list(result.measures))
        for name, value in reference.measures.items():
            self.assertAlmostEqual(value, result.measures[name], delta=SAME * abs(value), msg=name)

    def test_one_needle(self):
        _, _, result = self.carry_out("one-needle")
        self.assertTrue(result.passed, result.judgements)

    def test_three_targets(self):
        _, _, result = self.carry_out("three-targets")
        self.assertTrue(result.passed, result.judgements)

    def check_plan(self, name):
        task, sim, result = self.carry_out(name)
        self.assertTrue(result.passed, result.judgements)
        rows = plans.compare(task.plan, task.model, plans.seeds_of(sim))    # computed from the simulation's seeds, not from messages
        self.assertAlmostEqual(1e3 * result.measures["seed_error"], plans.summary(rows)["distance"], places=3)

    def test_with_the_probe(self):
        _, sim, result = self.carry_out("with-the-probe")
        self.assertTrue(result.passed, result.judgements)
        self.assertAlmostEqual(result.measures["probe_force"], np.linalg.norm(sim.probe.force), delta=0.5)    # needles hardly change it

    def test_four_seeds(self):
        self.check_plan("four-seeds")

    def test_beside_the_urethra(self):
        self.check_plan("beside-the-urethra")

    def check_implant(self, name):
        _, _, result = self.carry_out(name, lambda task, sim: CarefulHand(task.plan, sim))
        self.assertTrue(result.passed, result.judgements)

    @unittest.skipUnless(WHOLE, "in the long tests")
    def test_whole_implant(self):
        self.check_implant("whole-implant")

    @unittest.skipUnless(WHOLE, "in the long tests")
    def test_full_bladder_implant(self):
        self.check_implant("full-bladder-implant")


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0], *(["Solvable.test_whole_implant", "Solvable.test_full_bladder_implant"] if WHOLE else [])])
