#!/usr/bin/python3
"""Repeats a stored run, an implant of four needles, and compares it with its row in spreads.csv, so that a change of the mechanics cannot move the intervals of
validate_intervals.py unnoticed. Also tests how outlines are compared. Takes 10 s of CPU time."""
import sys
import types
import unittest

import numpy as np
import pelvis_runs

KEPT, COUNT, SEED = pelvis_runs.ROOT / "tests/validation/spreads.csv", 24, 1
NEAR = 0.02, 0.02    # relative, and absolute in a row's units (mm, degrees, N, Gy): chosen by judgement, far below the width of the intervals


class TestRuns(unittest.TestCase):
    def test_a_stored_run_can_be_repeated(self):
        stored = next(row for row in pelvis_runs.read(KEPT) if row["case"] == "few" and row["run"] == 0)
        again = pelvis_runs.run("spreads", 0, pelvis_runs.units("spreads", COUNT, SEED)[0], SEED, case="few")
        self.assertEqual(again["status"], "ok")
        moved = {name: (stored[name], value) for name, value in again.items() if isinstance(value, (int, float)) and not np.isclose(stored[name], value, *NEAR, equal_nan=True)}
        self.assertFalse(moved, "the model now gives other numbers (stored, now): repeat the runs with scripts/validate intervals, and compare the report's intervals")

    def test_every_parameter_is_drawn_from_its_range(self):
        low, high = (pelvis_runs.values_of(np.full(len(pelvis_runs.NAMES), unit)) for unit in (0.0, 1.0))
        for name, ends in pelvis_runs.MODULI.items():
            np.testing.assert_allclose((low[name], high[name]), ends)
        self.assertLessEqual(set(pelvis_runs.CITED), set(pelvis_runs.NAMES))


class TestOutlines(unittest.TestCase):
    """A cone with its point at the base, 40 mm long, whose radius is half of the distance from the base."""

    def setUp(self):
        depth, angle = np.meshgrid(np.linspace(0, 0.04, 81), np.linspace(0, 2 * np.pi, 64, endpoint=False), indexing="ij")
        points = np.stack([0.5 * depth * np.cos(angle), 0.5 * depth * np.sin(angle), -depth], -1).reshape(-1, 3)
        number = np.arange(len(points)).reshape(depth.shape)
        self.gland = types.SimpleNamespace(rest=points, nodes=np.arange(len(points)), edges=np.stack([number[:-1], number[1:]], -1).reshape(-1, 2))
        self.gland.outlines = lambda points: pelvis_runs.Gland.outlines(self.gland, points)

    def deformation(self, field):
        return pelvis_runs.Gland.deformation(self.gland, field)

    def test_edges(self):
        radius = 0.5 * (pelvis_runs.SLICE * (np.arange(8) + 0.5))
        np.testing.assert_allclose(self.gland.outlines(self.gland.rest), np.outer(radius, [-1, 1, -1, 1]), atol=1e-6)

    def test_motion_along_the_needles_changes_no_slice(self):
        np.testing.assert_allclose(self.deformation(np.full_like(self.gland.rest, [0, 0, 0.01])), 0, atol=1e-9)

    def test_motion_across_them_moves_edges_and_centres(self):
        np.testing.assert_allclose(self.deformation(np.full_like(self.gland.rest, [0.002, 0.002, 0])), (0.002, 0, 0.002), atol=1e-9)

    def test_tissue_that_only_moves_along_the_needles_changes_the_slices(self):
        edge, width, centre = self.deformation(np.outer(-0.25 * self.gland.rest[:, 2], [0, 0, -1]))    # stretched by a quarter
        np.testing.assert_allclose((edge, width, centre), (0.002, 0.004, 0), atol=2e-4)                 # radius 10 mm on average, which becomes 8


if __name__ == "__main__":
    sys.exit(unittest.main())
