#!/usr/bin/python3
"""Compares a mesh's quality measures with values known from geometry."""
import unittest

import numpy as np

import anatomy_cases  # noqa: F401  puts the sources on the path
from anatomy import quality, relocate
from anatomy.shapes import shells

REGULAR = quality.Mesh(np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]), np.array([[0, 1, 2, 3]]), np.array([0]), ["x"])
# The tetrahedron at a cube's corner and its mirror image, which share a face.
CORNERS = quality.Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1.0]]), np.array([[0, 1, 2, 3], [0, 2, 1, 4]]),
                       np.array([0, 1]), ["up", "down"])


class Quality(unittest.TestCase):
    def test_angles(self):
        self.assertTrue(np.allclose(REGULAR.dihedral_angles(), np.degrees(np.arccos(1 / 3))))
        self.assertTrue(np.allclose(np.sort(CORNERS.dihedral_angles()[0]), [54.7356103] * 3 + [90] * 3))

    def test_volumes_edges_and_valence(self):
        self.assertTrue(np.allclose(REGULAR.volumes(), 8 / 3))
        self.assertAlmostEqual(CORNERS.region_volume("down"), 1 / 6)
        self.assertTrue(np.allclose(REGULAR.edges(), 8 ** 0.5))
        self.assertEqual(len(CORNERS.edges()), 9)
        self.assertEqual(CORNERS.valence().tolist(), [2, 2, 2, 1, 1])

    def test_a_surface_off_the_faces_of_tetrahedra_is_torn(self):
        for triangle, torn in (((0, 2, 1), []), ((3, 4, 0), ["bone"])):
            surfaces = {"skin": shells.Shell(CORNERS.points, np.array([[1, 2, 3]])), "bone": shells.Shell(CORNERS.points, np.array([[0, 3, 1], triangle]))}
            self.assertEqual(quality.Mesh(CORNERS.points, CORNERS.tets, CORNERS.region, CORNERS.regions, surfaces).torn(), torn)

    def test_badness_has_its_limit_at_the_papers_angles(self):
        def wedge(angle):  # a tetrahedron with this angle between two of its faces
            radians = np.radians(angle)
            points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, np.cos(radians), np.sin(radians)]])
            return quality.Mesh(points, np.array([[0, 1, 2, 3]]), np.array([0]), ["x"])
        self.assertGreater(wedge(9.8).badness(), 1)
        self.assertLess(wedge(10.1).badness(), 1)
        self.assertGreater(wedge(160).badness(), 1)

    @staticmethod
    def ball(height):
        """Returns tetrahedra that fill a cube of side 2 around a node at this height."""
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)] + [[0, 0, height]], float)
        faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])
        tets = np.column_stack([triangles, np.full(len(triangles), 8)])
        return quality.Mesh(corners, tets, np.zeros(len(tets), int), ["x"], {"skin": shells.Shell(corners, triangles)})

    def test_nodes_are_moved_to_widen_flat_angles(self):
        """A node close to a face is moved back to the middle without changing the surface."""
        mesh, held = self.ball(0.97), np.arange(9) < 8
        corners = mesh.points.copy()
        self.assertTrue(np.allclose(relocate.badness(corners[mesh.tets]).max(), mesh.badness()))
        self.assertGreater(mesh.badness(), 2)
        mesh.points = relocate.relocated(mesh, held)
        self.assertLess(mesh.badness(), 1)
        self.assertTrue(np.array_equal(mesh.points[held], corners[held]))
        self.assertAlmostEqual(mesh.region_volume("x"), 8)      # no tetrahedron is inverted

    def test_nodes_are_moved_until_angles_are_above_10_degrees(self):
        mesh = next(m for m in map(self.ball, np.linspace(0.9, 0.7, 500)) if m.badness() < 0.999)
        self.assertGreater(mesh.badness(), 0.99)      # corresponds to a smallest angle between 9.94 and 10 degrees, which is enough
        mesh.points = relocate.relocated(mesh, np.arange(9) < 8)
        self.assertLess(mesh.badness(), 0.99)

    def test_the_report_sets_the_papers_figures_beside(self):
        rows = quality.table(CORNERS, {"up": 0.125}, {"up": np.array([0.5, 1.5])})
        text = quality.markdown("title", rows, ["a note"], "x.svg")
        self.assertIn("| dihedral angles, deg | 54.74 to 90.00 | 9.94 to 159.49 |", text)
        self.assertIn("(+33.3 %)", text)
        self.assertIn("surface of up, mm | mean 1.00, at most 1.50 |", text)
        self.assertIn("- a note", text)


if __name__ == "__main__":
    unittest.main()
