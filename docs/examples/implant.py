#!/usr/bin/python3
"""Carries out a plan, one needle after the other, and lists where its seeds have come to lie.

usage: implant.py SCENE PLAN [HOLE...]    only the needles of these holes, by default all
"""
import sys

import numpy as np
import trocar
from trocar import plan as plans

SPEED, DT = 0.08, 1e-3  # m/s; s


class Hand:
    """Holds the needle on the axis of a hole: `tip` is the depth behind the template's face that its tip has without bending, m."""

    def __init__(self, sim, guide):
        self.sim, self.guide, self.tip = sim, guide, -0.02
        self.face = None

    def pose(self):
        base = self.face + (self.tip - self.sim.model.needle_length) * self.guide.normal
        axis, z = self.guide.normal, np.array([0.0, 0.0, 1.0])
        half = np.array([1 + z @ axis, *np.cross(z, axis)])  # the quaternion that turns +z into the axis, unless that is -z
        return np.array([*base, *(half / np.linalg.norm(half))])

    def take(self, face):
        self.face = face
        self.sim.reset(self.pose())

    def go(self, tip):
        steps = int(np.ceil(abs(tip - self.tip) / (SPEED * DT)))
        for at in np.linspace(self.tip, tip, steps + 1)[1:]:
            self.tip = at
            self.sim.step(self.pose(), DT)

    def hold(self, seconds):
        for _ in range(round(seconds / DT)):
            self.sim.step(self.pose(), DT)


def insert(hand, needle, face, length):
    """One needle: in to its depth, then back from seed to seed. A seed's centre is half its length behind the tip when it is dropped."""
    hand.take(face)
    hand.go(needle.depth)
    for behind in needle.seeds:
        hand.go(needle.depth - (behind - 0.5 * length))
        hand.hold(0.05)
        hand.sim.drop_seeds()
        while hand.sim.pending_seeds():
            hand.go(hand.tip - 0.5e-3)
    hand.go(-0.02)


def main(scene, path, *holes):
    model = trocar.Model(trocar.Scene.load(scene))
    plan = plans.read(path)
    plans.check(plan, model)
    guide, sim = plans.guide_of(plan, model), trocar.Sim(model)
    for needle in plan.needles:
        if not holes or needle.hole in holes:
            insert(Hand(sim, guide), needle, plans.hole_axis(guide, needle.hole), model.seed_size.length)
    rows = [row for row in plans.compare(plan, model, plans.seeds_of(sim)) if row.placed]
    for row in rows:
        print(row.hole, row.planned.number, "left %.2f, posterior %.2f, superior %.2f mm" % tuple(row.offset))
    mean = plans.summary(rows)
    print("mean of %d seeds: %.2f mm, along the needle %.2f" % (mean["count"], mean["distance"], mean["along"]))


if __name__ == "__main__":
    main(*sys.argv[1:])
