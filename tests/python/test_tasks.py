#!/usr/bin/python3
"""Tests that the shipped tasks can be done: a virtual operator without errors, who follows the image, carries them out in a simulation, and meets all criteria.

usage: test_tasks.py BUILD_DIR SOURCE_DIR
"""
import sys
import tempfile
import unittest
from pathlib import Path

from test_training import SOURCE, Log    # also chooses the library and the package of the build

import trocar
from trocar.brachy import plan as plans
from trocar.brachy.virtual_operator import Operator
from trocar.training import Task, score

DT = 4e-3          # s
FRAME = 25         # steps between two frames of the tissue
PERFECT = dict(image_error=0.0, splay=0.0, speed_spread=0.0)


def plan_for(task):
    """Returns the plan of a task; for targets, a plan with a seed behind each, because the operator brings the tip to the distal end of a seed."""
    if task.plan:
        return task.plan
    guide, half = task.model.guides[0], 0.5 * task.model.seed_size.length
    needles = [plans.Needle(t.hole, float((t.position - plans.hole_axis(guide, t.hole)) @ guide.normal), [half]) for t in task.targets]
    return plans.Plan(guide.name, guide.columns, guide.rows, guide.spacing, needles)


def add_state(log, sim, needle):
    """Adds the messages of the server that describe the tissue, a needle and the seeds."""
    line, tracks, seeds = sim.centreline(needle), sim.tracks(needle), sim.seeds()
    log.add("TROCAR_CONTACTS", "contacts_t", needle=needle, joint_count=len(line), centreline=line.tolist(), pose_utime=0, orientation=[1, 0, 0, 0], tip_lead=0.0,
            contact_count=0, position=[], force=[], arc=[], state=b"", kind=b"")
    log.tissue(sim.displacements())
    log.tracks(*(track.points.tolist() for track in tracks), needle=needle)
    place, along = [s.position.tolist() for s in seeds], [s.direction.tolist() for s in seeds]
    log.add("TROCAR_SEEDS", "seeds_t", needle_count=1, pending=[0], seed_count=len(seeds), position=place, direction=along, rest_position=place, rest_direction=along,
            needle=[s.needle for s in seeds], guide=[s.guide for s in seeds], hole=[s.hole for s in seeds], strand=[s.strand for s in seeds])


class Solvable(unittest.TestCase):
    def carry_out(self, name):
        task = Task.read(SOURCE / "meshes/tasks" / f"{name}.yaml")
        sim, log = trocar.Sim(trocar.Model(trocar.Scene.load(task.scene))), Log()
        for needle, poses in Operator(plan=plan_for(task), follows_image=True, **PERFECT).moves(sim, DT):
            for first in range(0, len(poses), FRAME):
                for row in sim.run(poses[first:first + FRAME], DT, needle):
                    log.wrench(float(row["depth"]), row["force"].tolist(), needle, 1 + needle)
                add_state(log, sim, needle)
        with tempfile.TemporaryDirectory() as folder:
            result = score(task, log.write(Path(folder, "run.log")))
        return task, sim, result

    def test_one_needle(self):
        _, _, result = self.carry_out("one-needle")
        self.assertTrue(result.passed, result.judgements)

    def test_three_targets(self):
        _, _, result = self.carry_out("three-targets")
        self.assertTrue(result.passed, result.judgements)

    def check_plan(self, name):
        task, sim, result = self.carry_out(name)
        self.assertTrue(result.passed, result.judgements)
        rows = plans.compare(task.plan, task.model, plans.seeds_of(sim))    # from the simulation, not from messages
        self.assertAlmostEqual(1e3 * result.measures["seed_error"], plans.summary(rows)["distance"], places=3)

    def test_four_seeds(self):
        self.check_plan("four-seeds")

    def test_beside_the_urethra(self):
        self.check_plan("beside-the-urethra")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
