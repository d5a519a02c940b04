"""Pushes a scene's needle from its start to its target, like trocar-device's `insert` script, and reports the result.

usage: python3 -m anatomy.trials.insertion SCENE.yaml [BUILD_DIR]
"""
import dataclasses
import sys

import numpy as np

from .. import binding

DT = 1e-3               # s
SPEED = 0.05            # m/s
REST = 0.3              # s, rest at the target before the last force is read
ROUNDS = 30             # maximum number of iterations in the search for the tissue at the tip


@dataclasses.dataclass
class Insertion:
    """The results of an insertion, in N and m."""
    peak: float              # N, largest force on the hand
    last: float              # N, force after the rest at the target
    punctures: list          # (membrane, travel beyond the skin's rest position, force just before the puncture)
    region: str              # region that the tip ends up in; "" outside the tissue
    off_target: float        # distance from the tip to the displaced target
    shift: float             # displacement of the target
    failed: str = ""         # reason for the failure, if the state is not finite


def push(path, build=None, speed=SPEED, change=None):
    """Simulates an insertion in the scene at this path. change(scene), if given, is called before the model is built."""
    trocar = binding.trocar(build)
    scene = trocar.Scene.load(path)
    if change:
        change(scene)
    model = trocar.Model(scene)
    sim, start, depth = trocar.Sim(model), np.array(model.start), float(scene["needle.start.depth"])
    w, x, y, z = start[3:]
    way = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    target = start[:3] + (model.needle_length + depth) * way
    membranes, found, peak, failed = scene.names("membranes"), [], 0.0, ""
    sim.reset(start)
    ticks = int(np.ceil(depth / (speed * DT)))
    before = 0.0
    for tick in range(1, ticks + 1 + int(REST / DT)):
        gone = depth * min(1.0, tick / ticks)
        out = sim.step(np.concatenate([start[:3] + gone * way, start[3:]]), DT)
        force = float(np.linalg.norm(out.force))
        if out.events & trocar.Event.PUNCTURED:
            found.append((membranes[out.membrane], gone - 1e-3, before))
        if out.events & trocar.Event.UNSTABLE:
            failed = failed or f"unstable after {1e3 * gone:.0f} mm"
        peak, before = max(peak, force), force
    tip, moved = sim.centreline()[-1], Moved(model, sim.displacements())
    there = target + moved.at(target)
    return Insertion(peak, before, found, moved.region_at(tip), float(np.linalg.norm(tip - there)), float(np.linalg.norm(there - target)), failed)


class Moved:
    """Tissue with displaced nodes."""

    def __init__(self, model, displacements):
        self.model, self.u = model, np.asarray(displacements).reshape(-1, 3)
        corners = model.nodes[model.tets]
        self.first = corners[:, 0]
        self.inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1))

    def place(self, point):
        """Returns the tetrahedron that contains a rest position (or the nearest one), and the barycentric coordinates in it."""
        inner = np.einsum("tij,tj->ti", self.inverse, point - self.first)
        every = np.column_stack([1 - inner.sum(axis=1), inner])
        best = int(every.min(axis=1).argmax())
        return best, every[best]

    def at(self, point):
        tet, weights = self.place(point)
        return weights @ self.u[self.model.tets[tet]]

    def region_at(self, point):
        """Returns the name of the region whose tissue is at a point of the displaced tissue."""
        rest = point.copy()
        for _ in range(ROUNDS):
            rest += 0.7 * (point - rest - self.at(rest))
        tet, weights = self.place(rest)
        return self.model.groups[self.model.tet_regions[tet]] if weights.min() > -1e-3 else ""


def main():
    found = push(sys.argv[1], *sys.argv[2:])
    for membrane, travel, force in found.punctures:
        print(f"{membrane}: gives way at {force:.2f} N, {1e3 * travel:.1f} mm beyond the skin at rest")
    print(f"largest force {found.peak:.2f} N, at the target {found.last:.2f} N; tip in {found.region or 'no tissue'}, {1e3 * found.off_target:.1f} mm from the target, "
          f"which has moved by {1e3 * found.shift:.1f} mm" + (f"; {found.failed}" if found.failed else ""))


if __name__ == "__main__":
    main()
