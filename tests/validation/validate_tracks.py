#!/usr/bin/python3
"""Compares a second insertion along the same track with a measurement. Forces at the tip and along the shaft are fitted to what makes up the force of a first
insertion: tearing 61 %, spreading 18 %, friction 21 %. The forces of a second and a third insertion follow from this if the needle finds its track again; a
needle beside the track meets the full forces.
"""
import sys

import numpy as np
import trocar
from laboratory import Bench, block, push
from rows import ABSTRACT, CONSISTENT, FITTED, UNPUBLISHED, Rows

BARNETT = "Barnett, Lee, Moore 2015, J. Manufacturing Science and Engineering, doi 10.1115/1.4030374, ex vivo"
TOTAL, DEPTH = 1.0, 0.045       # N, m


def scene():
    scene = block(60e3, cutting=0.61 * TOTAL, friction=(0.21 * TOTAL / DEPTH,) * 2 + (0,), needle={"inner_diameter": 0})
    for region in ("prostate", "surrounding"):
        scene[f"regions[{region}].spreading_force"] = 0.18 * TOTAL
    return scene


rows = Rows.from_arguments(__doc__, "Old tracks")
bench = Bench(trocar.Model(scene()))
forces = []
for place in (0, 0, 0, 0.003):
    bench.x = 0.005 + place
    outputs = bench.move(DEPTH + 0.012, 0.02)
    depth = np.array([out.depth for out in outputs])
    force = push(outputs)
    forces.append((depth, force, float(np.interp(DEPTH, depth, force))))
    bench.move(-0.005, 0.05)
first, second, third, beside = (f for _, _, f in forces)
shares = "shares of the first force"
follows = f"{shares}; 39 % remain if the needle stays in its track"
rows.add("force of the first insertion, 45 mm deep", BARNETT, ABSTRACT, (0.9 * TOTAL, 1.1 * TOTAL), first, "N", published="the sum of the shares, scaled to 1 N (tolerance 10 %)", kind=FITTED, fitted=shares)
rows.add("second insertion over the first", BARNETT, ABSTRACT, (34, 44), 100 * second / first, "%", published="39 %, if only tearing is absent (tolerance 5)", kind=CONSISTENT, fitted=follows)
rows.add("third insertion over the first", BARNETT, ABSTRACT, (34, 44), 100 * third / first, "%", published="39 % (tolerance 5)", kind=CONSISTENT, fitted=follows)
rows.add("3 mm beside the track, over the first", BARNETT, UNPUBLISHED, (90, 110), 100 * beside / first, "%", published="not measured; 100 % of intact tissue (tolerance 10)", kind=CONSISTENT, fitted=shares)
for label, (depth, force, _) in zip(("first", "second", "third", "3 mm beside"), forces):
    rows.curve("tracks", label, 1e3 * depth[::20], force[::20], "depth (mm)", "force (N)")
sys.exit(rows.end())
