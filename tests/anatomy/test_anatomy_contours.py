#!/usr/bin/python3
"""Tests outlines with every kind of defect."""
import math
import unittest

import numpy as np

from anatomy_cases import ellipse, ellipsoid, ellipsoid_volume
from anatomy.shapes import contours

SQUARE = np.array([[0, 0, 5], [10, 0, 5], [20, 0, 5], [20, 10, 5], [20, 20, 5], [0, 20, 5], [0, 10, 5]], float)


def area(*rings):
    return contours.build_stack("x", [*rings, SQUARE + [0, 0, 5]]).slices[0].outline.area


class Outlines(unittest.TestCase):
    def setUp(self):
        self.area = area(SQUARE)  # slightly below 400, because morphological opening rounds the corners

    def test_a_square(self):
        self.assertAlmostEqual(self.area, 400, delta=1)

    def test_direction_start_and_closing_points_do_not_matter(self):
        for ring in (SQUARE[::-1], np.roll(SQUARE, 3, axis=0), np.vstack([SQUARE, SQUARE[:1]]), np.repeat(SQUARE, 3, axis=0)):
            self.assertAlmostEqual(area(ring), self.area, places=9)

    def test_a_spike_is_cut_off(self):
        self.assertAlmostEqual(area(np.insert(SQUARE, 4, [[20, 10, 5], [45, 10.1, 5], [20, 10.2, 5]], axis=0)), self.area, delta=2)

    def test_points_without_order_are_ordered_by_angle(self):
        order = np.random.default_rng(3).permutation(60)
        self.assertAlmostEqual(area(ellipse(20, 15, 5)[order]), area(ellipse(20, 15, 5)), places=6)

    def test_an_outline_inside_another_is_a_hole(self):
        self.assertAlmostEqual(area(SQUARE, ellipse(5, 5, 5, centre=(10, 10))), self.area - 78.4, delta=1)

    def test_the_same_outline_twice_counts_once(self):
        self.assertAlmostEqual(area(SQUARE, np.roll(SQUARE[::-1], 2, axis=0)), self.area, places=9)

    def test_an_outline_drawn_again_beside_itself_is_united_with_it_and_that_is_told(self):
        gland = ellipse(22, 17, 5)
        for aside, told in ((0.3, 0), (0.5, 1), (1.5, 1)):
            stack = contours.build_stack("x", [gland, gland + [aside, 0, 0], SQUARE + [0, 0, 5]])
            self.assertAlmostEqual(stack.slices[0].outline.area, area(gland) + 2 * 17 * aside, delta=11)
            self.assertEqual(stack.notes, ["slice z = 5 mm: outlines overlap: united"] * told)
        self.assertAlmostEqual(area(gland, ellipse(20.5, 15.5, 5)), area(gland))

    def test_halves_that_overlap_are_united(self):
        self.assertAlmostEqual(area(SQUARE, SQUARE + [8, 0, 0]), 28 * 20, delta=1)

    def test_an_outline_in_a_hole_is_an_island(self):
        self.assertAlmostEqual(area(ellipse(22, 17, 5), ellipse(12, 9, 5), ellipse(5, 5, 5)), math.pi * (22 * 17 - 12 * 9 + 25), delta=4)

    def test_a_hole_drawn_twice_is_one_hole(self):
        self.assertAlmostEqual(area(ellipse(22, 17, 5), ellipse(6, 6, 5), ellipse(6, 6, 5, centre=(0.5, 0))), math.pi * (22 * 17 - 36) - 6, delta=4)

    def test_exclusive_outlines_are_outside_where_they_overlap(self):
        rings = contours.Rings([SQUARE, SQUARE + [8, 0, 0], SQUARE + [0, 0, 5]], exclusive=True)
        self.assertAlmostEqual(contours.build_stack("x", rings).slices[0].outline.area, 2 * 8 * 20, delta=2)

    def test_outlines_side_by_side_stay_apart(self):
        slice_ = contours.build_stack("x", [SQUARE, SQUARE + [40, 0, 0.02], SQUARE + [0, 0, 5]]).slices[0]
        self.assertEqual(len(slice_.outline.geoms), 2)

    def test_a_crossed_outline_keeps_both_loops(self):
        bow = np.array([[0, 0, 5], [20, 20, 5], [20, 0, 5], [0, 20, 5]], float)
        self.assertGreater(area(bow), 180)


class Stacks(unittest.TestCase):
    def test_planimetry_of_an_ellipsoid(self):
        for spacing in (3, 5, 7):
            stack = contours.build_stack("x", ellipsoid(24, 17, 20, spacing))
            self.assertAlmostEqual(stack.volume() / ellipsoid_volume(24, 17, 20), 1, delta=0.02)

    def test_a_missing_slice_changes_little_and_is_told(self):
        rings = ellipsoid(24, 17, 20, 4)
        whole = contours.build_stack("x", rings)
        gap = contours.build_stack("x", rings[:4] + rings[5:])
        self.assertAlmostEqual(gap.volume() / whole.volume(), 1, delta=0.02)
        self.assertIn("no slice between", gap.notes[0])
        self.assertEqual(whole.notes, [])

    def test_a_speck_is_left_out_and_told(self):
        stack = contours.build_stack("x", [*ellipsoid(24, 17, 20, 4), ellipse(0.4, 0.4, 60)])
        self.assertIn("z = 60 mm left out", stack.notes[0])
        self.assertLess(stack.slices[-1].z, 20)

    def test_open_outlines_are_told_by_slice_and_refused_if_many(self):
        rings = ellipsoid(24, 17, 20, 2)
        whole = contours.build_stack("x", rings)
        one = contours.build_stack("x", contours.Rings(rings[:9] + rings[10:], left_open=rings[9:10]))
        self.assertIn(f"1 of {len(rings)} outlines (5 %) are open (OPEN_PLANAR) and enclose nothing, at z = {rings[9][0, 2]:g} mm", " ".join(one.notes))
        self.assertAlmostEqual(one.volume() / whole.volume(), 1, delta=0.01)
        with self.assertRaisesRegex(contours.Unusable, r'region "x": 10 of 20 outlines \(50 %\) are open .* at z = -9, .*: close them'):
            contours.build_stack("x", contours.Rings(rings[:5] + rings[15:], left_open=rings[5:15]))

    def test_what_cannot_be_used_names_region_and_slice(self):
        tilted = SQUARE.copy()
        tilted[0, 2] = 9
        infinite = SQUARE.copy()
        infinite[2, 0] = np.inf
        for rings, words in (([tilted, SQUARE], ['"apex"', "z = 5 mm", "axial"]), ([SQUARE], ['"apex"', "1 usable slice"]),
                             ([], ['"apex"', "0 usable slices"]), ([infinite, SQUARE], ['"apex"', "not a number"]),
                             ([SQUARE[:2], SQUARE + [0, 0, 4]], ["z = 5 mm left out"])):
            with self.assertRaises(contours.Unusable) as caught:
                contours.build_stack("apex", rings)
            for word in words:
                self.assertIn(word, str(caught.exception))

    def test_smooth_outline_keeps_the_area(self):
        polygon = contours.build_stack("x", [SQUARE, SQUARE + [0, 0, 5]]).slices[0].outline.geoms[0]
        x, y = contours.smooth_outline(polygon, 240, 6).T
        self.assertAlmostEqual(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y), polygon.area, delta=0.005 * polygon.area)


if __name__ == "__main__":
    unittest.main()
