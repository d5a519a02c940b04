#!/usr/bin/python3
"""Tests the dimensions of the synthetic patients, and runs one patient of the stress test through the pipeline."""
import tempfile
import unittest

import anatomy_cases  # noqa: F401  puts the sources on the path
from anatomy import session
from anatomy.shapes import contours
from anatomy.trials import patient, stress

NUMBER = 11     # one of the fifty patients of `python3 -m anatomy.trials.stress`, listed in docs/results/anatomy/patients.csv


class Patients(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        session.start()

    def test_a_gland_has_the_volume_asked_for(self):
        for volume in (15e3, 34e3, 120e3):
            rings = patient.outlines(patient.Gland(volume=volume, lobes=0.1, lean=0.1), 1.0)["Prostate"]
            self.assertAlmostEqual(contours.build_stack("x", rings).volume() / volume, 1, delta=0.02)

    def test_a_random_patient_is_meshed_within_the_limits(self):
        with tempfile.TemporaryDirectory() as folder:
            row, good = stress.run(NUMBER, folder)
        self.assertTrue(good, row)


if __name__ == "__main__":
    unittest.main()
