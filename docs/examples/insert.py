"""Pushes a needle 50 mm into a scene at 50 mm/s and prints the force on the hand every 5 mm.

python3 insert.py /usr/share/trocar/scenes/figure8.yaml
"""
import sys

import trocar

scene = trocar.Scene.load(sys.argv[1] if len(sys.argv) > 1 else "scene.yaml")
sim = trocar.Sim(trocar.Model(scene))
base = [0.005, 0.003, -0.201, 1, 0, 0, 0]  # tip 1 mm in front of the skin
sim.reset(base)
for tick in range(1, 1001):
    base[2] = -0.201 + tick * 50e-6
    out = sim.step(base, 0.001)
    if tick % 100 == 0:
        print("%.4f %.17g %.17g %.17g" % (tick * 50e-6, *out.force))
