#!/usr/bin/python3
"""Lofts, distance fields and what keeps regions apart, on shapes of known volume."""
import unittest

import numpy as np

from anatomy_cases import ellipse, ellipsoid, ellipsoid_volume, trousers
from anatomy import contours, field, loft, meshing, session, shells


def stack(rings):
    return contours.build_stack("x", rings)


class Surfaces(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        session.start()

    def test_both_ways_give_the_volume_of_an_ellipsoid(self):
        made = stack(ellipsoid(24, 17, 20, 5))
        for found in ([loft.of_stack(made)], field.of_stack(made).surfaces()):
            self.assertEqual(len(found), 1)
            self.assertTrue(loft.is_closed(found[0]))
            self.assertGreater(found[0].signed_volume(), 0)
            self.assertAlmostEqual(found[0].volume() / ellipsoid_volume(24, 17, 20), 1, delta=0.03)

    def test_branching_outlines_are_no_loft_but_one_surface(self):
        made = stack(trousers())
        self.assertIsNone(loft.of_stack(made))
        found = field.of_stack(made).surfaces()
        self.assertEqual(len(found), 1)
        self.assertAlmostEqual(found[0].volume() / made.volume(), 1, delta=0.04)

    def test_separate_legs_are_separate_surfaces(self):
        found = field.of_stack(stack([ring for ring in trousers() if ring[0, 2] < 20])).surfaces()
        self.assertEqual(len(found), 2)

    def test_distance_to_a_sphere(self):
        sphere = field.of_stack(stack(ellipsoid(20, 20, 20, 3))).surfaces()[0]
        points = np.array([[30.0, 0, 0], [0, 25, 0], [0, 0, 0], [12, 0, 0]])
        self.assertTrue(np.allclose(shells.distances(sphere, points), [10, 5, -20, -8], atol=0.8))

    def test_a_rod_through_a_sphere_is_cut_at_its_surface(self):
        sphere = field.of_stack(stack(ellipsoid(20, 20, 20, 4))).surfaces()[0]
        rod = field.of_stack(stack([ellipse(4, 4, z) for z in np.arange(-40, 41, 5.0)]))
        found = rod.apart_from(sphere, 3.0).surfaces()
        self.assertEqual(len(found), 3)
        for part in found:
            self.assertGreater(np.abs(shells.distances(sphere, part.points)).min(), 2.0)

    def test_a_coarse_surface_holds_the_same_volume(self):
        made = stack(trousers())
        fine = field.of_stack(made).surfaces()[0]
        fine = shells.Shell(fine.points * 1e-3, fine.triangles)
        body = meshing.Body("x", "x", fine, made.volume() * 1e-9, 10e-3)
        coarse = meshing.coarse(body, "0.008")
        self.assertTrue(loft.is_closed(coarse))
        self.assertLess(len(coarse.triangles), 400)
        self.assertAlmostEqual(coarse.volume() / body.volume, 1, places=6)
        self.assertLess(np.abs(shells.distances(fine, coarse.points)).max(), 2.5e-3)

    def test_a_torn_surface_is_mended(self):
        sphere = field.of_stack(stack(ellipsoid(20, 20, 20, 4))).surfaces()[0]
        torn = shells.Shell(sphere.points, np.vstack([sphere.triangles[7:], sphere.triangles[200:240]]))
        self.assertGreater(shells.open_edges(shells.to_vtk(torn)), 0)
        mended = shells.mended(shells.to_vtk(torn))
        self.assertEqual(shells.open_edges(mended), 0)
        again = field.of_surface(mended).surfaces()
        self.assertAlmostEqual(again[0].volume() / sphere.volume(), 1, delta=0.02)


if __name__ == "__main__":
    unittest.main()
