#!/usr/bin/python3
"""Tests names and materials of regions, and what happens to surfaces that cannot be meshed."""
import csv
import math
import os
import tempfile
import unittest
import unittest.mock

import numpy as np

from anatomy_cases import SOURCE, ellipse, ellipsoid
from anatomy import limits, losses, materials, meshing, organ, pipeline, quality, scene, session
from anatomy.shapes import contours, field, shells
from anatomy.trials import patient


class Names(unittest.TestCase):
    def test_names_are_those_of_the_rois(self):
        self.assertEqual(organ.region_names(["Pubic arch", "Harnr\u00f6hre", "CTV+5 mm"]),
                         {"Pubic arch": "pubic_arch", "Harnr\u00f6hre": "harnrohre", "CTV+5 mm": "ctv_5_mm"})

    def test_names_that_collide_are_numbered(self):
        rois = ["PTV 1", "PTV-1", "\u524d\u7acb\u817a", "\u5c3f\u9053", "Surrounding", "x" * 64, "x" * 63]
        self.assertEqual(list(organ.region_names(rois).values()),
                         ["ptv_1", "ptv_1_2", "region", "region_2", "surrounding_2", "x" * 40, "x" * 40 + "_2"])

    def test_regions_have_their_material_by_name(self):
        regions = scene.text("title", "x.msh", ["ctv", "rectum"], False, []).split("  - name: ")
        self.assertRegex(regions[1], r"ctv +# any other: guess.*\n    youngs_modulus: 30e3")
        self.assertRegex(regions[2], r"rectum +# rectum: assumed.*\n    youngs_modulus: 20e3")
        self.assertRegex(regions[3], r"surrounding +# surrounding: assumed.*\n    youngs_modulus: 30e3")

    def test_materials_are_those_of_the_table(self):
        with open(os.path.join(SOURCE, "meshes/parameters/materials.csv"), encoding="utf-8", newline="") as file:
            rows = [row[:5] for row in csv.reader(file)][1:]
        known = {name: row.material for name, row in materials.TABLE.items()} | {"any other": materials.OTHER.material, "surrounding": materials.SURROUNDING.material}
        self.assertEqual({name: tuple(map(float, values)) for name, *values in rows},
                         {name: (m.modulus, m.cutting, m.static, m.kinetic) for name, m in known.items()})


def turned(ring, degrees, aside):
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return ring @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) + [aside, 0, 0]


class Crossing(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        session.start()
        cls.sphere = pipeline.domain_of([organ.of_rings("Gland", "gland", False, ellipsoid(20, 20, 20, 5))], 570, None)[0]

    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        self.path = os.path.join(directory.name, "x.msh")

    def test_spheres_cross_each_other_where_they_meet(self):
        sphere = shells.decimated(field.of_stack(contours.build_stack("x", ellipsoid(20, 20, 20, 4))).surfaces()[0], 1000)
        apart, beside = (shells.Shell(sphere.points + [aside, 0, 0], sphere.triangles) for aside in (41, 24))
        self.assertEqual(list(shells.crossings([sphere, apart])), [])
        found = list(shells.crossings([sphere, beside]))
        self.assertEqual({(i, j) for _, i, j in found}, {(0, 1), (1, 0)})
        self.assertTrue(np.allclose([point[0] for point, _, _ in found], 12, atol=0.3))

    def test_a_section_turned_against_the_others_is_named_and_made_without_a_loft(self):
        rings = [turned(ellipse(24, 8, z), 90, 18) if z == 15 else ellipse(24, 8, z) for z in np.arange(0, 41, 5.0)]
        gland = organ.of_rings("Gland", "gland", False, rings)
        with unittest.mock.patch.object(meshing, "TRIES", 3):
            mesh, _, _, _ = pipeline.mesh_of([gland], 570, None, self.path)
        self.assertAlmostEqual(len(mesh.points) / 570, 1, delta=0.1)
        self.assertRegex(gland.notes[0], r"as a loft, its surface crosses itself at z = (10|15|20) mm")

    def test_what_cannot_be_meshed_is_named_with_its_slice(self):
        organs = [organ.of_rings(name, name.lower(), False, ellipsoid(20, 20, 20, 5)) for name in ("Gland", "Node")]
        for each in organs:
            each.shape = field.of_stack(each.stack)
        domain, _ = pipeline.domain_of(organs[:1], 570, None)
        body = domain.bodies[0]
        moved = shells.Shell(body.shell.points + [0.02, 0, 0], body.shell.triangles)
        domain.bodies.append(meshing.Body("node", "node_wall", moved, body.volume, body.longest))
        with unittest.mock.patch.object(meshing, "FAILURES", 1), self.assertRaises(meshing.Failure) as caught:
            meshing.generate(domain, 570, self.path)
        pipeline.give_way(organs, caught.exception, domain)
        for each in organs:
            self.assertRegex(each.notes[-1], "their surfaces cross at z = [-0-9.]+ mm: its surface is made from an image")
        domain.regions = ["not empty"]
        with self.assertRaisesRegex(contours.Unusable, '"Gland" and "Node": their surfaces cross at z = [-0-9.]+ mm'):
            pipeline.give_way(organs, caught.exception, domain)
        self.assertFalse(os.path.exists(self.path))

    def test_a_mesh_beyond_the_limits_is_refused_and_leaves_no_file(self):
        gland = organ.of_rings("Gland", "gland", False, ellipsoid(20, 20, 20, 5))
        flat = quality.Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 0.01]]), np.array([[0, 1, 2, 3]]), np.array([0]), ["gland"])
        with self.search(flat), self.assertRaisesRegex(contours.Unusable, r"dihedral angles of 1\.\d\d to 17\d\.\d\d degrees .* raise --nodes"):
            pipeline.mesh_of([gland], 4, None, self.path)
        half = quality.Mesh(0.0288 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) * 0.58, np.array([[0, 1, 2, 3]]), np.array([0]), ["gland"])
        with self.search(half), self.assertRaisesRegex(contours.Unusable, r'region "Gland": the mesh holds \d\d\.\d\d ml of 3\d\.\d\d ml \(-\d\d\.\d %\)'):
            pipeline.mesh_of([gland], 4, None, self.path)
        self.assertFalse(os.path.exists(self.path))

    @staticmethod
    def search(mesh):
        """Makes every search for a mesh return this mesh."""
        def found(_domain, _nodes, path):
            with open(path, "w", encoding="ascii"):
                return meshing.Attempt(mesh, [0.0], [mesh.region_volume("gland")])
        return unittest.mock.patch.object(meshing, "search", found)

    def test_a_bone_that_is_missing_is_told_or_refused(self):
        rib = organ.of_rings("Rib", "rib", True, ellipsoid(20, 20, 20, 5))
        for share, refused in ((0.005, False), (0.05, False), (0.2, True)):
            distances = {"rib": np.where(np.arange(1000) < 1000 * share, 30.0, 0.5)}
            if refused:
                with self.assertRaisesRegex(contours.Unusable, r'region "Rib": 20\.0 % of its surface lie more than 5 mm .*at most 30 mm.*--nodes'):
                    losses.check_bones([rib], distances)
            else:
                rib.notes.clear()
                losses.check_bones([rib], distances)
                self.assertEqual(len(rib.notes), int(share > 0.01))

    def test_the_search_goes_on_whatever_the_clock_says_and_ends_by_its_work(self):
        mesh = quality.Mesh(np.zeros((570, 3)), np.zeros((1, 4), int), np.array([0]), ["gland"])
        for work, tries in ((1e9, meshing.TRIES), (3000, 6)):
            sizes = []

            def attempt(_stage, _work, _domain, fine, path, sizes=sizes):
                sizes.append(fine)
                with open(path, "w", encoding="ascii"):
                    return meshing.Attempt(mesh, [0.0], [mesh.region_volume("gland")])
            with unittest.mock.patch.object(meshing.limits, "run", attempt), unittest.mock.patch.object(meshing.limits, "SECONDS", 0), \
                    unittest.mock.patch.object(quality.Mesh, "badness", lambda _: 2.0), unittest.mock.patch.object(meshing, "MOST_WORK", work):
                meshing.search(self.sphere, 570, self.path)
            self.assertEqual(len(sizes), tries)

    def test_the_search_for_a_large_mesh_goes_between_one_with_too_few_and_one_with_too_many_nodes(self):
        wanted, sizes = 30000, []

        def attempt(_stage, _work, _domain, fine, path):    # the first size gives a fifth of the nodes wanted, and half of it far too many
            sizes.append(fine)
            points = np.zeros((round(0.2 * wanted * (sizes[0] / fine) ** 5), 3))
            with open(path, "w", encoding="ascii"):
                return meshing.Attempt(quality.Mesh(points, np.zeros((1, 4), int), np.array([0]), ["gland"]), [0.0])
        with unittest.mock.patch.object(meshing.limits, "run", attempt), unittest.mock.patch.object(quality.Mesh, "badness", lambda _: 0.5):
            found = meshing.search(self.sphere, wanted, self.path)
        self.assertEqual((len(sizes), len(found.mesh.points)), (3, wanted))

    def test_the_search_ends_where_larger_elements_do_not_give_fewer_nodes(self):
        for counts, tries in (((300, 200, 250), 3), ((300, 250, 190, 90), 4), ((300, 200, 0, 0), 4), ((300, 0, 90), 3)):      # 0: Gmsh fails
            sizes = []

            def attempt(_stage, _work, _domain, fine, path, sizes=sizes, counts=counts):
                sizes.append(fine)
                if not counts[len(sizes) - 1]:
                    raise meshing.Failure("no mesh", ["gland"])
                mesh = quality.Mesh(np.zeros((counts[len(sizes) - 1], 3)), np.zeros((1, 4), int), np.array([0]), ["gland"])
                with open(path, "w", encoding="ascii"):
                    return meshing.Attempt(mesh, [0.0])
            with unittest.mock.patch.object(meshing.limits, "run", attempt), unittest.mock.patch.object(quality.Mesh, "badness", lambda _: 0.5):
                found = meshing.search(self.sphere, 90, self.path)
            self.assertEqual((len(sizes), len(found.mesh.points)), (tries, min(filter(None, counts))))

    def test_a_mesh_with_a_part_of_a_surface_missing_is_refined_by_its_number_of_nodes_and_counts_as_work(self):
        def made(nodes, missed):
            mesh = quality.Mesh(np.full((nodes, 3), 2.0), np.zeros((1, 4), int), np.array([0]), ["gland"])
            return meshing.Attempt(mesh, [missed])

        def sizes_of(first, *others):
            """Returns each attempt's element size relative to the previous one's, if the attempts give these results in turn and then repeat the last."""
            sizes, coming = [], [made(*first), *(made(*other) for other in others)]

            def attempt(_stage, _work, _domain, fine, path):
                sizes.append(fine)
                with open(path, "w", encoding="ascii"):
                    return coming[min(len(sizes), len(coming)) - 1]
            with unittest.mock.patch.object(meshing.limits, "run", attempt), unittest.mock.patch.object(quality.Mesh, "badness", lambda mesh: mesh.points[0, 0]), \
                    unittest.mock.patch.object(meshing, "MOST_WORK", 3000), unittest.mock.patch.object(meshing, "LARGE_WORK", 1):
                meshing.search(self.sphere, 1000, self.path)
            return np.array(sizes[1:]) / sizes[:-1]
        self.assertAlmostEqual(sizes_of((125, 0.05))[0], 0.5)       # with an eighth of the nodes wanted, the size is halved
        self.assertAlmostEqual(sizes_of((1500, 0.05))[0], 0.98)
        self.assertEqual(len(sizes_of((1000, 0.0), (1000, 0.05))), 3)     # tries again until the mesh has more than 3000 nodes

    def test_the_search_prefers_usable_angles_then_whole_surfaces_then_the_number_of_nodes(self):
        tries = [(1490, 50.0, 0.0), (1480, 0.9, 0.05), (1200, 2.0, 0.0), (1000, 0.9, 0.0)]     # (nodes, badness, missing fraction of a surface)
        for count in range(1, len(tries) + 1):
            coming = iter(tries[:count])

            def attempt(_stage, _work, _domain, _fine, path, coming=coming):
                nodes, badness, missed = next(coming)
                made = quality.Mesh(np.full((nodes, 3), badness), np.zeros((1, 4), int), np.array([0]), ["gland"])
                with open(path, "w", encoding="ascii"):
                    return meshing.Attempt(made, [missed])
            with unittest.mock.patch.object(meshing.limits, "run", attempt), unittest.mock.patch.object(meshing, "TRIES", count), \
                    unittest.mock.patch.object(quality.Mesh, "badness", lambda mesh: mesh.points[0, 0]):
                found = meshing.search(self.sphere, 1500, self.path)
            self.assertEqual(len(found.mesh.points), [1490, 1480, 1200, 1200][count - 1])

    def test_another_number_of_nodes_is_told_and_twice_as_many_refused(self):
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
        mesh = quality.Mesh(corners, np.array([[0, 1, 2, 3]]), np.array([0]), ["gland"])
        gland = organ.of_rings("Gland", "gland", False, ellipsoid(20, 20, 20, 5))
        domain, _ = pipeline.domain_of([gland], 570, None)
        for nodes, words in ((4, None), (7, "has 4 nodes instead of 7, the closest that was found$"), (3, "instead of 3, .*: the surface of gland alone has 4$")):
            with self.search(mesh):
                made = meshing.generate(domain, nodes, self.path).mesh
            told = meshing.remarks_on_number(made, nodes)
            self.assertEqual(len(told), 0 if words is None else 1)
            self.assertRegex("".join(told), words or "^$")
        with self.search(mesh), self.assertRaisesRegex(contours.Unusable, "no mesh has 9 nodes; the closest has 4$"):
            meshing.generate(domain, 9, self.path)

    def test_a_search_whose_every_try_fails_says_why(self):
        for tries in (1, 2, meshing.TRIES):
            with unittest.mock.patch.object(meshing, "TRIES", tries), \
                    unittest.mock.patch.object(meshing.limits, "run", side_effect=limits.Crashed("mesh: ended by signal 11")), \
                    self.assertRaisesRegex(meshing.Failure, "ended by signal 11"):
                meshing.generate(self.sphere, 570, self.path)

    def test_a_stage_that_takes_too_long_ends_the_work(self):
        with unittest.mock.patch.object(meshing.limits, "run", side_effect=limits.TooLong("mesh: not done")), self.assertRaises(limits.TooLong):
            meshing.search(self.sphere, 570, self.path)

    def test_too_few_nodes_are_refused_and_the_region_named_that_needs_more(self):
        rois = patient.outlines(patient.Gland())
        organs = [organ.of_rings(roi, roi.lower(), False, rois[roi]) for roi in ("Prostate", "Urethra")]
        with unittest.mock.patch.object(meshing, "TRIES", 2), \
                self.assertRaisesRegex(contours.Unusable, r'"Urethra": thin regions need about \d+ nodes on their surfaces alone, .* raise --nodes to \d+00'):
            pipeline.mesh_of(organs, 60, None, self.path)
        self.assertFalse(os.path.exists(self.path))


if __name__ == "__main__":
    unittest.main()
