#!/usr/bin/python3
"""Tests lofts, distance fields and the separation of regions on shapes of known volume."""
import collections
import unittest

import numpy as np
import vtk

from anatomy_cases import ellipse, ellipsoid, ellipsoid_volume, trousers
from anatomy import meshing, organ, session
from anatomy.shapes import contours, field, label_image, labels, loft, shells


def stack(rings):
    return contours.build_stack("x", rings)


def around_cells(cells):
    """Returns the surface of a set of unit cubes, given by their lowest corners. Adjacent cubes share points."""
    numbers, triangles = {}, []
    for cell in sorted(cells):
        for axis in range(3):
            for side in (0, 1):
                beside = list(cell)
                beside[axis] += 2 * side - 1
                if tuple(beside) not in cells:
                    face = np.tile(cell, (4, 1))
                    face[:, axis] += side
                    face[:, [(axis + 1) % 3, (axis + 2) % 3]] += [(0, 0), (1, 0), (1, 1), (0, 1)] if side else [(0, 0), (0, 1), (1, 1), (1, 0)]
                    a, b, c, d = (numbers.setdefault(tuple(corner), len(numbers)) for corner in face.tolist())
                    triangles += [(a, b, c), (a, c, d)]
    return shells.Shell(np.array(list(numbers), float), np.array(triangles))


def turns_around(shell, point):
    """Returns the winding number of a closed surface around a point, from the solid angles of its triangles (van Oosterom and Strackee 1983)."""
    a, b, c = (shell.points[shell.triangles[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    dot = [np.einsum("ij,ij->i", *pair) for pair in ((a, b), (b, c), (c, a))]
    return np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), la * lb * lc + dot[0] * lc + dot[1] * la + dot[2] * lb).sum() / (2 * np.pi)


class Surfaces(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        session.start()

    @staticmethod
    def coarse_sphere():
        """A sphere with few triangles, because the search for crossings goes edge by edge."""
        return shells.decimated(field.of_stack(stack(ellipsoid(20, 20, 20, 4))).surfaces()[0], 2000)

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
        mended, notes = shells.mended(shells.to_vtk(torn))
        self.assertEqual(shells.open_edges(mended), 0)
        self.assertRegex(notes[0], r"holes of \d+ edges in all were closed, which changes its volume by [+-]\d")
        found = organ.of_surface("x", "x", False, shells.from_vtk(mended), notes)
        self.assertAlmostEqual(found.volume / sphere.volume(), 1, delta=0.02)

    def test_triangles_in_any_order_become_a_surface_with_normals_outward(self):
        sphere = self.coarse_sphere()
        flipped = np.random.default_rng(1).uniform(size=len(sphere.triangles)) < 0.5
        mixed = shells.Shell(sphere.points, np.where(flipped[:, None], sphere.triangles[:, ::-1], sphere.triangles))
        self.assertLess(mixed.volume(), 0.5 * sphere.volume())
        for found in (shells.oriented(mixed), shells.all_parts(mixed)[0], shells.from_vtk(shells.mended(shells.to_vtk(mixed))[0])):
            self.assertAlmostEqual(found.signed_volume() / sphere.volume(), 1)

    def test_a_surface_that_touches_itself_along_an_edge_keeps_its_inside(self):
        """Tests the surface around two cells that share only an edge, alone and also joined by a chain of further cells. Triangles in files may have any
        orientation and order."""
        random = np.random.default_rng(1)
        for cells in ({(0, 0, 0), (1, 1, 0)}, {(0, 0, 0), (1, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1)}):
            touching = around_cells(cells)
            flipped = random.uniform(size=len(touching.triangles)) < 0.5
            mixed = np.where(flipped[:, None], touching.triangles[:, ::-1], touching.triangles)
            inside_out = touching.triangles[:, ::-1]
            for triangles in (touching.triangles, inside_out, mixed[random.permutation(len(mixed))]):
                found = shells.oriented(shells.Shell(touching.points, triangles))
                self.assertAlmostEqual(found.signed_volume(), len(cells))
                for middle in np.ndindex(2, 2, 2):
                    self.assertAlmostEqual(turns_around(found, np.add(middle, 0.5)), middle in cells)

    def test_a_cavity_is_no_part_of_a_surface_from_a_file(self):
        sphere = self.coarse_sphere()
        island = shells.Shell(sphere.points * 0.2, sphere.triangles)        # in the cavity
        for inner in (sphere.scaled(0.5), shells.Shell(sphere.scaled(0.5).points, sphere.triangles[:, ::-1])):
            hollow, _ = shells.mended(shells.to_vtk(shells.joined([island, inner, sphere])))
            hollow = shells.from_vtk(hollow)
            self.assertAlmostEqual(hollow.signed_volume() / sphere.volume(), 1 - 0.5 ** 3 + 0.2 ** 3, places=3)
            self.assertEqual((shells.distances(hollow, np.array([[0, 0, 0], [7, 0, 0], [15.0, 0, 0], [25.0, 0, 0]])) < 0).tolist(),
                             [True, False, True, False])
            self.assertIn("2 separate parts", " ".join(organ.of_surface("x", "x", False, hollow).notes))

    def test_a_surface_that_crosses_itself_is_told_with_the_volume(self):
        sphere = self.coarse_sphere()
        crossed = shells.Shell(sphere.points.copy(), sphere.triangles)
        top = crossed.points[:, 2] > 14
        crossed.points[top, 2] -= 44     # the cap passes through the bottom and is inverted
        found = organ.of_surface("x", "x", False, crossed)
        self.assertRegex(found.notes[-1], r"crosses itself at \d+ edges, first at \(.*\) mm: replaced by the surface of everything that it encloses")
        self.assertGreater(found.volume, 1.02 * crossed.volume())

    def test_a_displaced_part_is_told(self):
        sphere = self.coarse_sphere()
        sphere.points[sphere.points[:, 2] > 19] -= [0, 0, 22]
        self.assertIn("as long as usual", " ".join(organ.of_surface("x", "x", False, sphere).notes))

    def test_a_unit_that_is_not_likely_is_told_and_one_that_is_not_possible_refused(self):
        def sized(*factors, unit=None):
            organs = [organ.of_surface("abc"[n], "x", False, self.coarse_sphere().scaled(factor)) for n, factor in enumerate(factors)]
            organ.check_sizes(organs, bool(unit))
            return [" ".join(each.notes) for each in organs]
        self.assertEqual(sized(1), [""])
        self.assertIn("is the file's unit right?", sized(0.2)[0])
        self.assertEqual(sized(0.2, unit="mm"), [""])
        for factor in (0.05, 1000):
            with self.assertRaisesRegex(contours.Unusable, "is the file's unit right\\? Give it with --unit$"):
                sized(factor)
            sized(factor, unit="mm")
        large, small = sized(1, 0.05)      # a lesion of 4 mm^3 next to an organ
        self.assertEqual(large, "")
        self.assertRegex(small, "few of the mesh's elements are in it")
        self.assertRegex(sized(0.05, unit="mm")[0], "few of the mesh's elements are in it")
        with self.assertRaisesRegex(contours.Unusable, 'region "b": .* too small to be meshed: leave it out'):
            sized(1, 0.02)


def shared(found, a, b):
    """Returns the area of the boundary between two regions, and whether this boundary closes either region's surface."""
    between = {tuple(pair) for pair in ((a, b), (b, a))}
    mine = [(found.cells[i] if i >= 0 else None, found.cells[j] if j >= 0 else None) in between for i, j in found.sides]
    return found.areas()[mine].sum()


def is_watertight(shell):
    """Returns whether each edge is traversed equally often in both directions."""
    ways = collections.Counter(tuple(way) for pair in ((0, 1), (1, 2), (2, 0)) for way in shell.triangles[:, pair].tolist())
    return all(ways[b, a] == count for (a, b), count in list(ways.items()))


class Shared(unittest.TestCase):
    """Regions that touch."""

    def test_a_void_may_touch_the_outer_surface_at_a_point(self):
        points = np.array([[x, y, z] for x in (0, 3) for y in (0, 3) for z in (0, 3)] + [[1, 1, 1], [1, 2, 1], [2, 1, 1]], float)
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        outer = [t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))]
        void = [(0, 8, 9), (0, 9, 10), (0, 10, 8), (8, 10, 9)]        # the apex of the void coincides with a corner of the cube
        size = shells.Shell(points, np.array(void)).signed_volume()
        void = void if size < 0 else [t[::-1] for t in void]
        triangles = np.array(outer + void)
        found = labels.with_voids(labels.Complex(points, triangles, np.column_stack([np.zeros(len(triangles), int), np.full(len(triangles), -1)]), [0]))
        self.assertEqual(found.cells, [0, label_image.OUTSIDE])
        self.assertEqual(found.sides[:, 1].tolist(), [-1] * 12 + [1] * 4)

    @staticmethod
    def channelled(count=9, half=30.0, narrow=0.5, high=30.0):
        """Returns the complex of a block with a slot 2 * narrow wide, open at the top, that ends above the bottom."""
        x = np.concatenate([np.linspace(-half, -narrow, count), np.linspace(narrow, half, count)])
        y = np.linspace(-half, half, count)
        cells = np.zeros((2 * count - 1, count - 1, 2), bool)
        cells[:, :, 0] = True
        cells[:, :, 1] = np.arange(2 * count - 1)[:, None] != count - 1
        z = np.array([-high, 0.0, high])
        number = np.arange(len(x) * len(y) * len(z)).reshape(len(x), len(y), len(z))
        points = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
        faces, filled = [], np.pad(cells, 1)
        for axis in range(3):
            for i, j, k in np.argwhere(np.diff(filled.astype(int), axis=axis) != 0):
                at = np.array([i, j, k])
                outward = filled[i, j, k]       # along the axis
                first = at + np.eye(3, dtype=int)[axis] - 1
                u, v = np.eye(3, dtype=int)[[a for a in range(3) if a != axis]]
                a, b, c, d = (number[tuple(p)] for p in (first, first + u, first + u + v, first + v))
                turn = bool(outward) == (axis != 1)
                faces += [(a, b, c), (a, c, d)] if turn else [(a, c, b), (a, d, c)]
        used, triangles = np.unique(np.array(faces), return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        return labels.Complex(points[used], triangles, np.column_stack([np.zeros(len(triangles), int), np.full(len(triangles), -1)]), [0])

    def test_a_correction_of_the_volume_does_not_close_a_narrow_channel(self):
        block = self.channelled()
        whole = block.volume([0])
        self.assertAlmostEqual(whole / (60 * 60 * 60 - 60 * 30), 1, delta=1e-9)
        self.assertEqual(list(shells.crossings([block.surface([0])])), [])
        made = labels.corrected(block, [([0], 1.08 * whole)])      # each wall would have to move by more than half the slot's width
        self.assertAlmostEqual(made.volume([0]) / whole, 1.08, delta=1e-5)
        self.assertEqual(list(shells.crossings([made.surface([0])])), [])

    @staticmethod
    def box(low, high):
        cube = vtk.vtkCubeSource()
        cube.SetBounds(low[0], high[0], low[1], high[1], low[2], high[2])
        cube.Update()
        return shells.from_vtk(shells.mended(cube.GetOutput())[0])

    @staticmethod
    def made(regions, volumes, edge, *box):
        """Returns the complex of regions whose parts have these volumes, and the pieces it consists of."""
        image, pieces, lost = label_image.image_for(regions, edge, *box)
        found, missed = labels.shared_surfaces(image, pieces, lost, regions, volumes, edge)
        return image, pieces, found, lost, missed

    def check(self, regions, volumes, kept):
        _, pieces, found, lost, _ = self.made(regions, volumes, 8.0)
        for k, volume in enumerate(kept):
            mine = [piece for piece, region in enumerate(pieces.regions) if region == k]
            self.assertTrue(is_watertight(found.surface(mine)))
            self.assertAlmostEqual(found.volume(mine) / volume, 1, delta=0.02)
        return found, lost

    def test_touching_regions_share_their_boundary_and_keep_their_volume(self):
        left, right = self.box((0, 0, 0), (20, 30, 30)), self.box((20, 0, 0), (45, 30, 30))
        found, lost = self.check([[left], [right]], [18e3, 22.5e3], [18e3, 22.5e3])
        self.assertLess(sum(lost.values()), 0.03)
        self.assertAlmostEqual(shared(found, 0, 1) / 900, 1, delta=0.1)

    def test_a_nested_region_is_found_and_taken_from_the_one_around_it(self):
        ball = field.of_stack(stack(ellipsoid(8, 8, 8, 1))).surfaces()[0]
        inner = shells.Shell(ball.points + [22, 20, 24], ball.triangles)
        volume = inner.volume()
        found, lost = self.check([[inner], [self.box((0, 0, 0), (45, 40, 42))]], [volume, 75600], [volume, 75600 - volume])
        self.assertAlmostEqual(lost[1, 0] * 75600 / volume, 1, delta=0.05)
        self.assertEqual(sorted(found.cells), [0, 1])

    def test_a_small_gap_is_closed_and_the_volumes_stay(self):
        left, right = self.box((0, 0, 0), (20, 30, 30)), self.box((22, 0, 0), (45, 30, 30))
        found, _ = self.check([[left], [right]], [18e3, 20.7e3], [18e3, 20.7e3])
        self.assertGreater(shared(found, 0, 1), 700)

    def test_separate_parts_are_all_found(self):
        boxes = [self.box((x, 0, 0), (x + 10, 10, 60)) for x in (0, 40, 80)]
        found, _ = self.check([boxes], [6e3, 6e3, 6e3], [18e3])
        self.assertEqual(sorted(found.cells), [0, 1, 2])

    def test_what_a_box_cuts_off_is_told(self):
        box = [[self.box((0, 0, 0), (40, 30, 30))]]
        _, _, found, lost, _ = self.made(box, [36e3], 8.0, (np.zeros(3) - 1, np.array([30, 31, 31.0])))
        self.assertAlmostEqual(lost[0, label_image.OUTSIDE], 0.25, delta=0.02)
        self.assertAlmostEqual(found.volume([0]) / 27e3, 1, delta=8 / label_image.VOXELS_PER_EDGE / 30)    # a voxel

    @staticmethod
    def image(shape):
        """Returns an empty image of two regions with one part each."""
        return label_image.Image(np.zeros(3), 1.0, np.zeros(shape, np.uint16), np.zeros(shape, np.uint16), np.array([0, 1, 2]))

    def test_a_sheet_goes_to_what_is_around_it(self):
        image = self.image((36, 36, 40))
        image.labels[4:32, 4:32, 4:10] = 1
        image.labels[4:32, 4:32, 10] = 2        # a one-voxel sheet of the second region that covers the first and sticks out beside the second
        image.labels[4:32, 12:32, 10:34] = 2
        image.sources[:] = image.labels
        label_image.drop_thin(image, 2, 1.0)
        self.assertFalse(np.any(image.labels[6:30, 5:9, 10] == 2))
        self.assertTrue(np.all(image.labels[6:30, 6:30, 5:9] == 1) and np.all(image.labels[6:30, 14:30, 12:32] == 2))

    def test_parts_that_do_not_touch_keep_clear_of_each_other(self):
        image = self.image((20, 20, 40))
        image.labels[4:16, 4:16, 4:20] = 1
        image.labels[4:16, 4:16, 21:32] = 1     # a voxel away
        label_image.separate(image)
        self.assertEqual(len(label_image.connected_in(image.labels == 1)[1]), 2)
        empty = ~np.any(image.labels, axis=(0, 1))[20:32]     # voxels beside the larger part
        self.assertGreaterEqual(np.argmin(empty) + 1, label_image.CLEAR)

    def test_a_thin_bone_beside_a_large_organ_is_not_lost(self):
        ball = field.of_stack(stack(ellipsoid(40, 40, 40, 4))).surfaces()[0]
        angle = np.radians(np.linspace(-100, 100, 41))
        centres = np.column_stack([44 * np.cos(angle), 44 * np.sin(angle), 0 * angle])    # touches the ball
        rib = self.tube(centres, 3.0)
        bars = [self.box((-30 + x, -30, 50), (-25 + x, 30, 56)) for x in (0, 50)]
        regions = [[ball], [rib, *bars]]
        edge = 14.0
        _, pieces, found, _, missed = self.made(regions, [ball.volume(), None, None, None], edge)
        self.assertLess(max(missed), 0.01)
        bone = found.surface([piece for piece, region in enumerate(pieces.regions) if region == 1])
        for shell in regions[1]:
            self.assertLess(np.abs(shells.distances(bone, shell.points)).max(), 5.0)

    def test_corners_of_triangles_lie_on_the_region(self):
        """The surface must not include the border of the image, which CGAL would treat as a surface."""
        ball = field.of_stack(stack(ellipsoid(40, 40, 40, 4))).surfaces()[0]
        image, _, found, _, _ = self.made([[ball]], [None], 20.0)
        self.assertLess(np.abs(shells.distances(ball, found.points)).max(), image.step)

    @staticmethod
    def tube(centres, radius):
        """Returns a closed surface around a polyline in the plane z = 0."""
        line = vtk.vtkPolyLineSource()
        line.SetNumberOfPoints(len(centres))
        for k, point in enumerate(centres):
            line.SetPoint(k, *point)
        around = shells.configured(vtk.vtkTubeFilter(), Radius=radius, NumberOfSides=12, Capping=True)
        around.SetInputConnection(line.GetOutputPort())
        around.Update()
        return shells.from_vtk(shells.mended(around.GetOutput())[0])

    def test_a_part_with_a_thin_neck_stays_one(self):
        image = self.image((24, 24, 60))
        image.labels[4:20, 4:20, 4:26] = 1
        image.labels[4:20, 4:20, 34:56] = 1
        image.labels[11:13, 11:13, 26:34] = 1
        image.sources[:] = image.labels
        label_image.drop_thin(image, 1, 2.0)
        self.assertEqual(len(label_image.connected_in(image.labels == 1)[1]), 1)


if __name__ == "__main__":
    unittest.main()
