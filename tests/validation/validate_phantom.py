#!/usr/bin/python3
"""Compares how the force is distributed along a needle in a uniform phantom with a measurement."""
import sys

import numpy as np
import trocar
from laboratory import Bench, block
from rows import CONSISTENT, SECONDARY, Rows

DIMAIO = "DiMaio and Salcudean 2003, IEEE Trans. Robotics and Automation 19, PVC"

rows = Rows.from_arguments(__doc__, "Force along the shaft")
bench = Bench(trocar.Model(block(20e3, cutting=0.3, friction=(60, 60, 0))))
bench.move(0.09, 0.01)
contacts = bench.sim.contacts()
shaft = [c for c in contacts if c.kind == "tissue"]
tip = next(c for c in contacts if c.kind == "tip")
depth = np.array([c.depth for c in shaft])
# A contact stands for the part of the shaft that extends halfway to each neighbour.
edges = np.concatenate([[0], (depth[1:] + depth[:-1]) / 2, [tip.depth]])
density = np.array([c.force[2] for c in shaft]) / np.diff(edges)
inner = (depth > 0.01) & (depth < tip.depth - 0.01)
spread = density[inner].std() / density[inner].mean()
rows.trend("force per length along the shaft", DIMAIO, SECONDARY, "flat", spread < 0.1, f"varies by {100 * spread:.0f} % (standard deviation) between 10 mm from skin and tip",
           kind=CONSISTENT, fitted="friction assumed the same along the shaft")
peak = (tip.force[2] + density[-1] * (edges[-1] - edges[-2])) / (edges[-1] - edges[-2]) / density[inner].mean()
rows.trend("force per length at the tip", DIMAIO, SECONDARY, "a peak", peak > 1.5, f"{peak:.1f} times that of the shaft, over the last {1e3 * (edges[-1] - edges[-2]):.1f} mm",
           kind=CONSISTENT, fitted="cutting force assumed")
rows.curve("phantom", "model", np.concatenate([1e3 * depth[:-1], [1e3 * tip.depth]]), np.concatenate([density[:-1], [peak * density[inner].mean()]]),
           "depth (mm)", "force per length (N/m)")
sys.exit(rows.end())
