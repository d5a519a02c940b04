#!/usr/bin/python3
"""Carries out a plan, one needle after the other, and lists the final positions of its seeds.

usage: implant.py SCENE PLAN [HOLE...]    only the needles in these holes, by default all
"""
import sys
from dataclasses import replace

import trocar
from trocar.brachy import plan as plans
from trocar.brachy.implant import Implant

DT = 1e-3  # s


def main(scene, path, *holes):
    model = trocar.Model(trocar.Scene.load(scene))
    plan = plans.read(path)
    if holes:
        wanted = [plans.hole_number(hole) for hole in holes]
        plan = replace(plan, needles=[needle for needle in plan.needles if plans.hole_number(needle.hole) in wanted])
    sim = trocar.Sim(model)
    for poses in Implant(plan=plan).play(sim, DT):      # insertion, retraction from seed to seed, and withdrawal, at 80 mm/s
        sim.run(poses, DT)
    rows = [row for row in plans.compare(plan, model, plans.seeds_of(sim)) if row.placed]
    for row in rows:
        print(row.hole, row.planned.number, "left %.2f, posterior %.2f, superior %.2f mm" % tuple(row.offset))
    mean = plans.summary(rows)
    print("mean of %d seeds: %.2f mm, along the needle %.2f" % (mean["count"], mean["distance"], mean["along"]))


if __name__ == "__main__":
    main(*sys.argv[1:])
