#!/usr/bin/python3
"""Compares meshes that Gmsh has written in all variants of MSH 2.2 and 4.1 with what Gmsh's own API returns for the same file: nodes, tetrahedra, their order,
groups, named surfaces. Needs python3-gmsh.

usage: test_mesh_formats.py BUILD_DIR SOURCE_DIR
"""
import os
import random
import sys
import tempfile
import unittest
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
import gmsh
import numpy as np

import trocar

KINDS = "point", "curve", "surface", "volume"
TRIANGLE, TETRAHEDRON = 2, 4


def model_of(path, regions):
    listed = "".join(f"  - {{name: {name}, youngs_modulus: 1e4}}\n" for name in regions)
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as scene:
        scene.write(f"mesh: {path}\nregions:\n{listed}fixed: [{regions[0]}]\n")
        scene.flush()
        return trocar.Model(trocar.Scene.load(scene.name), mesh_only=True)


def by_gmsh(path):
    """Returns the nodes used by tetrahedra, ordered by tag; the tetrahedra, ordered by volume, and their regions; the groups in Gmsh's order; and each
    surface's triangles."""
    gmsh.clear()
    gmsh.merge(str(path))
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    tags, coordinates = tags[order].astype(int), coordinates.reshape(-1, 3)[order]
    groups = [(d, t, gmsh.model.getPhysicalName(d, t) or f"{KINDS[d]}_{t}") for d, t in gmsh.model.getPhysicalGroups()]
    if not any(d == 3 for d, _, _ in groups):
        groups.append((3, 0, "tissue"))
    tets, regions = [], []
    for _, volume in gmsh.model.getEntities(3):
        corners = gmsh.model.mesh.getElementsByType(TETRAHEDRON, volume)[1].reshape(-1, 4).astype(int)
        physical = gmsh.model.getPhysicalGroupsForEntity(3, volume)
        region = groups.index(next(g for g in groups if g[:2] == (3, physical[0] if len(physical) else 0))) if len(corners) else 0
        tets.append(corners)
        regions += [region] * len(corners)
    tets = np.concatenate(tets)
    used = np.isin(tags, tets)
    surfaces = {}
    for d, t, name in groups:
        if d == 2:
            faces = [gmsh.model.mesh.getElementsByType(TRIANGLE, s)[1].astype(int) for s in gmsh.model.getEntitiesForPhysicalGroup(2, t)]
            surfaces[name] = {tuple(sorted(f)) for f in np.searchsorted(tags[used], np.concatenate(faces)).reshape(-1, 3).tolist()}
    return coordinates[used], np.searchsorted(tags[used], tets), np.array(regions), groups, surfaces


class Formats(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        cls.folder = tempfile.TemporaryDirectory()

    @classmethod
    def tearDownClass(cls):
        gmsh.finalize()
        cls.folder.cleanup()

    def compare(self, path):
        nodes, tets, regions, groups, surfaces = by_gmsh(path)
        model = model_of(path, [name for d, _, name in groups if d == 3])
        self.assertEqual(model.groups, [name for _, _, name in groups])
        np.testing.assert_array_equal(model.nodes, nodes)
        np.testing.assert_array_equal(np.sort(model.tets), np.sort(tets))   # tetrahedra with a negative volume in the file have been reoriented
        np.testing.assert_array_equal(model.tet_regions, regions)
        for name, triangles in surfaces.items():
            self.assertEqual({tuple(sorted(f)) for f in model.surface(name).tolist()}, triangles, name)

    def compare_variants(self, name, versions=(2.2, 4.1)):
        """Writes Gmsh's current model in each variant of the format and compares the results."""
        paths = []
        for version in versions:
            for binary in 0, 1:
                for every in 0, 1:
                    gmsh.option.setNumber("Mesh.MshFileVersion", version)
                    gmsh.option.setNumber("Mesh.Binary", binary)
                    gmsh.option.setNumber("Mesh.SaveAll", every)
                    paths.append(Path(self.folder.name, f"{name}-{version}-{binary}-{every}.msh"))
                    gmsh.write(str(paths[-1]))
        for path in paths:
            with self.subTest(path.name):
                self.compare(path)

    def boxes(self, named=True, periodic=False):
        """Tests three boxes in two regions, with an edge and a point, and with surfaces that belong to one or two groups, some of them unnamed."""
        gmsh.clear()
        occ = gmsh.model.occ
        boxes = occ.addBox(0, 0, 0, 1, 1, 1), occ.addBox(1, 0, 0, 1, 1, 1), occ.addBox(0, 1, 0, 2, 1, 1)
        occ.fragment([(3, boxes[0])], [(3, boxes[1]), (3, boxes[2])])
        occ.synchronize()
        volumes, faces, edges, points = ([t for _, t in gmsh.model.getEntities(d)] for d in (3, 2, 1, 0))
        for d, members, tag, name in ((3, [volumes[2], volumes[0]], 9, "ends"), (3, [volumes[1]], 4, ""), (2, faces[:5], 3, "skin"), (2, faces[3:8], 1, ""),
                                      (1, edges[:3], 7, "edge"), (0, points[:1], 2, "")):
            if named:
                gmsh.model.addPhysicalGroup(d, members, tag)
                gmsh.model.setPhysicalName(d, tag, name)
        if periodic:
            side = [[t for _, t in gmsh.model.getEntitiesInBoundingBox(x - 0.01, -0.01, -0.01, x + 0.01, 1.01, 1.01, 2)] for x in (0, 2)]
            gmsh.model.mesh.setPeriodic(2, side[1], side[0], [1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)

    def test_shipped_meshes(self):
        for path in sorted((SOURCE / "meshes").glob("*.msh")):
            self.compare(path)
            gmsh.clear()
            gmsh.merge(str(path))
            self.compare_variants(path.stem)

    def test_groups_with_and_without_names(self):
        self.boxes()
        self.compare_variants("boxes")

    def test_no_groups(self):
        self.boxes(named=False)
        self.compare_variants("bare")

    def test_periodic(self):
        self.boxes(periodic=True)
        self.compare_variants("periodic")

    def test_parametric_nodes(self):
        self.boxes()
        gmsh.option.setNumber("Mesh.SaveParametric", 1)
        self.compare_variants("parametric")
        gmsh.option.setNumber("Mesh.SaveParametric", 0)

    def test_partitions(self):
        """MSH 4.1 describes partitions by entities. When Gmsh imports partitioned MSH 2.2 files, it creates additional entities, in a different order."""
        self.boxes()
        gmsh.model.mesh.partition(3)
        self.compare_variants("parts", versions=(4.1,))

    def test_sparse_tags(self):
        """Tests two bodies with given nodes and elements, whose tags have gaps and are unsorted."""
        gmsh.clear()
        random.seed(3)
        node_tags, element_tags = random.sample(range(1, 1000000), 9), random.sample(range(1, 1000000), 4)
        where = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (3, 0, 0), (4, 0, 0), (3, 1, 0), (3, 0, 1)]
        tets = [[0, 1, 2, 3], [1, 2, 3, 4], [5, 6, 7, 8]]
        for volume, nodes, members in ((7, range(5), tets[:2]), (3, range(5, 9), tets[2:])):
            gmsh.model.addDiscreteEntity(3, volume)
            gmsh.model.mesh.addNodes(3, volume, [node_tags[n] for n in nodes], [x for n in nodes for x in where[n]])
            tags = [element_tags.pop() for _ in members]
            gmsh.model.mesh.addElementsByType(volume, TETRAHEDRON, tags, [node_tags[n] for tet in members for n in tet])
            gmsh.model.addPhysicalGroup(3, [volume], volume)
        self.compare_variants("sparse")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
