"""Shared by the experiments: a block of one material, a needle held at its hub, and insertions at constant speed.

The block is the mesh of figure 8, 100 x 90 x 100 mm with its skin at z = 0, held at its far and lower faces. The package `trocar` is found through
PYTHONPATH and TROCAR_LIBRARY, as described in docs/python.md.
"""
from pathlib import Path

import numpy as np
import trocar

MESHES = Path(__file__).resolve().parents[2] / "meshes"
DT = 1e-3                 # s
AIR = 1e-3                # m, between tip and skin at the start


def block(youngs_modulus, poisson_ratio=0.45, *, cutting=0.1, cutting_viscosity=0.0, friction=(0.0, 0.0, 0.0), puncture=0.0, needle=None,
          relaxation=(), more=None):
    """Returns the scene of a block of one material. `friction`: (static, kinetic, viscous). `relaxation`: list of pairs (weight, time)."""
    scene = trocar.Scene.load(str(MESHES / "figure8.yaml"))
    for name in ("prostate", "surrounding"):
        region = f"regions[{name}]"
        scene[f"{region}.youngs_modulus"] = youngs_modulus
        scene[f"{region}.poisson_ratio"] = poisson_ratio
        scene[f"{region}.cutting_force"] = cutting
        scene[f"{region}.cutting_viscosity"] = cutting_viscosity
        for key, value in zip(("static", "kinetic", "viscous"), friction):
            scene[f"{region}.friction.{key}"] = value
    scene["membranes[skin].puncture_force"] = puncture
    scene["membranes[capsule].puncture_force"] = 0.0
    for i, (weight, time) in enumerate(relaxation):
        scene[f"relaxation[{i}].weight"] = weight
        scene[f"relaxation[{i}].time"] = time
    for key, value in (needle or {}).items():
        scene[f"needle.{key}"] = value
    for key, value in (more or {}).items():
        scene[key] = value
    return scene


class Bench:
    """A needle at (x, y) that moves along z and turns about its axis."""

    def __init__(self, model, length=0.2, x=0.005, y=0.003):
        self.sim, self.length, self.x, self.y = trocar.Sim(model), length, x, y
        self.tip = -AIR       # m, z that the tip would have if the needle were undeformed
        self.roll = 0.0       # rad
        self.sim.reset(self.pose())

    def pose(self):
        return np.array([self.x, self.y, self.tip - self.length, np.cos(self.roll / 2), 0, 0, np.sin(self.roll / 2)])

    def step(self):
        return self.sim.step(self.pose(), DT)

    def move(self, to, speed, turn=0.0):
        """Moves the tip to z = `to` (m) at `speed` while turning at `turn` (rad/s). Returns the outputs of all ticks."""
        way, start = to - self.tip, self.tip
        ticks = max(1, round(abs(way) / (speed * DT)))
        outputs = []
        for i in range(ticks):
            self.tip = start + way * (i + 1) / ticks
            self.roll += turn * DT
            outputs.append(self.step())
        return outputs

    def hold(self, seconds):
        return [self.step() for _ in range(round(seconds / DT))]

    def rotate(self, to, rate):
        """Turns the base to the angle `to` (rad) at `rate` (rad/s)."""
        ticks = max(1, round(abs(to - self.roll) / (rate * DT)))
        start = self.roll
        outputs = []
        for i in range(ticks):
            self.roll = start + (to - start) * (i + 1) / ticks
            outputs.append(self.step())
        return outputs


def push(outputs):
    """Returns the axial force (N) that resists insertion at each tick."""
    return np.array([-out.force[2] for out in outputs])


def depths(outputs):
    return np.array([out.depth for out in outputs])
