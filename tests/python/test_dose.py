#!/usr/bin/python3
"""Compares the library's dose, through Python, with a plain NumPy computation from the same tables: TG-43, voxels inside organs, and histograms.

usage: test_dose.py BUILD_DIR SOURCE_DIR
"""
import os
import sys
import tempfile
import unittest
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
import numpy as np
import yaml

import trocar
from trocar import brachy

TABLES = {"I-125 6711": "i125-6711.yaml", "Pd-103 200": "pd103-200.yaml"}
GRID = dict(origin=[-0.03, -0.028, -0.026], spacing=2e-3, shape=(31, 29, 27))


def table_of(name):
    return yaml.safe_load((SOURCE / "core/dose/data" / TABLES[name]).read_text())


def rate(table, position, direction, points):
    """Returns the dose rate (Gy/h) of a 1 U seed according to AAPM TG-43U1 and its supplement. Lengths are in cm, angles in degrees."""
    axis = np.asarray(direction) / np.linalg.norm(direction)
    v = 100 * (np.asarray(points) - position)
    z, rho = v @ axis, np.linalg.norm(np.cross(v, axis), axis=1)
    r, theta, length = np.hypot(z, rho), np.degrees(np.arctan2(rho, abs(z))), table["active_length"]
    on_axis = rho < 1e-9
    beta = np.arctan2(z + length / 2, np.where(on_axis, 1, rho)) - np.arctan2(z - length / 2, np.where(on_axis, 1, rho))
    geometry = np.where(on_axis, 1 / (r**2 - length**2 / 4), beta / (length * np.where(on_axis, 1, rho)))
    radii, g = np.array(table["radial"], float).T
    slope = np.log(g[-1] / g[-2]) / (radii[-1] - radii[-2])
    log_g = np.interp(r, radii, np.log(g)) + slope * np.maximum(r - radii[-1], 0)
    rows, at = np.array(table["anisotropy"]["rows"], float), np.array(table["anisotropy"]["radii"], float)
    by_radius = np.array([np.interp(theta, rows[:, 0], rows[:, 1 + k]) for k in range(len(at))])
    k = np.clip(np.searchsorted(at, r, "right") - 1, 0, len(at) - 2)
    u = (np.clip(r, at[0], at[-1]) - at[k]) / (at[k + 1] - at[k])
    n = np.arange(len(r))
    f = (1 - u) * by_radius[k, n] + u * by_radius[k + 1, n]
    return 0.01 * table["dose_rate_constant"] * geometry / (2 * np.arctan(length / 2) / length) * np.exp(log_g) * f


def inside_capsule(table, position, direction, points):
    axis = np.asarray(direction) / np.linalg.norm(direction)
    v = 100 * (points - position)
    return (abs(v @ axis) <= table["capsule"]["length"] / 2) & (np.linalg.norm(np.cross(v, axis), axis=1) < table["capsule"]["diameter"] / 2)


def grid_points():
    axes = [o + GRID["spacing"] * np.arange(n) for o, n in zip(GRID["origin"], GRID["shape"])]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def implant(count, seed):
    random = np.random.default_rng(seed)
    return random.uniform(-0.02, 0.02, (count, 3)), random.normal(size=(count, 3)), random.uniform(0.3, 0.8, count)


def icosphere(radius, centre, times):
    """Returns a closed surface: an octahedron, refined and projected onto a sphere."""
    nodes = [np.array(p, float) for p in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))]
    triangles = [(x, y, z) for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    for _ in range(times):
        middle, finer = {}, []
        def half(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                nodes.append((nodes[a] + nodes[b]) / np.linalg.norm(nodes[a] + nodes[b]))
                middle[key] = len(nodes) - 1
            return middle[key]
        for a, b, c in triangles:
            ab, bc, ca = half(a, b), half(b, c), half(c, a)
            finer += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = finer
    return radius * np.array(nodes) + centre, np.array(triangles)


def solid_angle(nodes, triangles, points):
    """Returns the solid angle of a surface of outward-facing triangles, seen from points, divided by 4 pi: 1 inside, 0 outside (van Oosterom and Strackee
    1983)."""
    a, b, c = (nodes[triangles[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    dot = lambda x, y: np.einsum("ijk,ijk->ij", x, y)
    return np.arctan2(dot(a, np.cross(b, c)), la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb).sum(1) / (2 * np.pi)


def lattice(low, high, h):
    axes = [h * (np.arange(np.floor(a / h) - 1, np.ceil(b / h) + 1) + 0.5) for a, b in zip(low, high)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)


def as_set(points, h):
    return set(map(tuple, np.rint(points / h - 0.5).astype(int)))


class DoseTest(unittest.TestCase):
    def test_check_values(self):
        """Checks dose rates (cGy/h) on the transverse axis and on the seed's axis, and the total dose, for model 6711 and 1 U. The expected values were
        published with the consensus data."""
        source = brachy.Source("I-125 6711")
        points = [[0.005, 0, 0], [0.01, 0, 0], [0, 0.02, 0], [0, -0.05, 0], [0, 0, 0.01], [0, 0, -0.01]]
        found = 100 * source.rates([[0, 0, 0]], [[0, 0, 2]], [1], points)
        np.testing.assert_allclose(found, [4.046, 0.965, 0.1975, 0.01415, 0.368, 0.368], rtol=1e-3)
        self.assertAlmostEqual(0.01 * found[1] * source.hours(), 19.85, delta=0.02)
        self.assertAlmostEqual(source.hours(24 * 59.4) / source.hours(), 0.5, delta=1e-12)
        self.assertAlmostEqual(source.hours(1e-3), 1e-3, delta=1e-9)
        self.assertAlmostEqual(100 * brachy.Source("Pd-103 200").rates([[0, 0, 0]], [[0, 0, 1]], [2], [[0.01, 0, 0]])[0], 2 * 0.686, delta=1e-9)

    def test_the_formula_at_any_point(self):
        """Tests points from the capsule's wall to a distance of 30 cm, at every angle, including points on the axis at both ends."""
        random = np.random.default_rng(3)
        direction = random.normal(size=(20000, 3))
        points = direction / np.linalg.norm(direction, axis=1)[:, None] * (10 ** random.uniform(-2.59, -0.52, 20000))[:, None]
        points = np.vstack([points, [[0, 0, z] for z in (0.0025, -0.004, 0.011, -0.05, 0.2)], [[1e-6, 0, 0.01], [0.0005, 0, 0.0001]]])
        for name in TABLES:
            found = brachy.Source(name).rates([[0, 0, 0]], [[0, 0, 1]], [1], points)
            np.testing.assert_allclose(found, rate(table_of(name), [0, 0, 0], [0, 0, 1], points), rtol=1e-10)

    def test_hundred_seeds_against_a_plain_sum(self):
        """Outside the seeds, doses agree to 1e-6, both on a grid and at listed points."""
        points, table, source = grid_points(), table_of("I-125 6711"), brachy.Source("I-125 6711")
        dose, expected, outside = brachy.Dose(source, **GRID), np.zeros(len(points)), np.ones(len(points), bool)
        for position, direction, strength in zip(*implant(100, 7)):
            dose.add(position, direction, strength)
            expected += strength * rate(table, position, direction, points) * 24 * table["half_life"] / np.log(2)
            outside &= ~inside_capsule(table, position, direction, points)
        values = dose.values
        self.assertEqual(values.shape, GRID["shape"])
        np.testing.assert_allclose(values.ravel()[outside], expected[outside], rtol=1e-6)
        print("\n100 seeds: largest relative difference %.1e" % abs(values.ravel()[outside] / expected[outside] - 1).max())
        self.assertTrue(np.all(np.isfinite(values)) and (~outside).any())
        listed = brachy.Dose.at(source, points[::97])
        for one in zip(*implant(100, 7)):
            listed.add(*one)
        np.testing.assert_allclose(listed.values, values.ravel()[::97], rtol=1e-12, atol=1e-9)

    def test_seeds_come_and_go_without_a_trace(self):
        """Doses are bit-identical whatever the order of the seeds, even if seeds were removed and moved in between."""
        source, seeds = brachy.Source("I-125 6711"), list(zip(*implant(20, 1)))
        grid = dict(GRID, shape=(20, 20, 20))
        direct, wandering, random = brachy.Dose(source, **grid), brachy.Dose(source, **grid), np.random.default_rng(2)
        for seed in seeds:
            direct.add(*seed)
        ids = {}
        for step in range(600):
            k = random.integers(20)
            if k in ids and step % 3:
                wandering.remove(ids.pop(k))
            elif k in ids:
                wandering.move(ids[k], *seeds[random.integers(20)])
            else:
                ids[k] = wandering.add(*seeds[k])
        for k in random.permutation(20):
            if k in ids:
                wandering.move(ids[k], *seeds[k])
            else:
                wandering.add(*seeds[k])
        self.assertEqual(wandering.seeds, 20)
        np.testing.assert_array_equal(wandering.values, direct.values)

    def test_voxels_of_a_surface(self):
        """Compares the voxels inside a surface with the surface's solid angle at their centres. Spacing and position are chosen so that some voxel centres lie
        on edges and corners of the surface."""
        for centre, h in (([0.0005, -0.0005, 0.0015], 1e-3), ([0.00213, 0.01, -0.0377], 1.3e-3)):
            nodes, triangles = icosphere(0.01, np.array(centre), 2)
            a, b, c = (nodes[triangles[:, k]] - centre for k in range(3))
            volumes = np.einsum("ij,ij->i", np.cross(a, b), c) / 6
            outward, flip = triangles.copy(), volumes < 0
            outward[flip] = outward[flip][:, ::-1]
            structure = brachy.Structure.from_surface(nodes, triangles, h)
            candidates = lattice(nodes.min(0), nodes.max(0), h)
            angle = solid_angle(nodes, outward, candidates)
            near = abs(np.linalg.norm(candidates - centre, axis=1) - 0.01) < 1e-9      # points at corners of the surface
            found, sure = as_set(structure.points, h), as_set(candidates[(angle > 0.75) & ~near], h)
            self.assertLessEqual(sure, found)
            self.assertLessEqual(found, as_set(candidates[(angle > 0.25) | near], h))
            self.assertAlmostEqual(len(structure.points) * structure.voxel / abs(volumes).sum(), 1, delta=0.01)

    def test_voxels_of_a_region_include_those_of_its_parts(self):
        scene = trocar.Scene.load(SOURCE / "meshes/figure8.yaml")
        apart = [brachy.Structure.from_region(trocar.Model(scene, mesh_only=True), name, 3e-3) for name in ("prostate", "surrounding")]
        scene["regions[surrounding].part_of"] = "prostate"
        model = trocar.Model(scene, mesh_only=True)
        self.assertEqual(as_set(brachy.Structure.from_region(model, "prostate", 3e-3).points, 3e-3), as_set(apart[0].points, 3e-3) | as_set(apart[1].points, 3e-3))
        self.assertEqual(as_set(brachy.Structure.from_region(model, "surrounding", 3e-3).points, 3e-3), as_set(apart[1].points, 3e-3))
        self.assertEqual([model.groups[i] for i in model.part_of], ["prostate" if name == "surrounding" else name for name in model.groups])
        with self.assertRaisesRegex(ValueError, 'no region "capsule"'):
            model.tets_of("capsule")

    def test_voxels_of_a_region_and_their_displacements(self):
        model = trocar.Model(trocar.Scene.load(SOURCE / "meshes/figure8.yaml"))
        structure = brachy.Structure.from_region(model, "prostate", 2e-3)
        tets = model.nodes[model.tets[model.tet_regions == model.groups.index("prostate")]]
        candidates, inside = lattice(tets.min((0, 1)), tets.max((0, 1)), 2e-3), set()
        for tet in tets:
            box = np.all((candidates >= tet.min(0)) & (candidates <= tet.max(0)), axis=1)
            w = np.linalg.solve((tet[1:] - tet[0]).T, (candidates[box] - tet[0]).T)
            inside |= as_set(candidates[box][np.all(w >= -1e-12, axis=0) & (w.sum(0) <= 1 + 1e-12)], 2e-3)
        self.assertEqual(as_set(structure.points, 2e-3), inside)
        self.assertEqual(len(structure.points), len(inside))
        volume = abs(np.einsum("ij,ij->i", np.cross(tets[:, 1] - tets[:, 0], tets[:, 2] - tets[:, 0]), tets[:, 3] - tets[:, 0])).sum() / 6
        self.assertAlmostEqual(len(inside) * structure.voxel / volume, 1, delta=0.01)
        gradient = np.array([[0.1, 0.02, 0], [0, -0.05, 0.03], [0.01, 0, 0.04]])   # a linear field is interpolated exactly
        moved = structure.displacements(model.nodes @ gradient.T + [1e-3, 0, -2e-3])
        np.testing.assert_allclose(moved, structure.points @ gradient.T + [1e-3, 0, -2e-3], atol=1e-15)
        source, seeds = brachy.Source("I-125 6711"), list(zip(*implant(5, 4)))
        rest, deformed = brachy.Dose.at(source, structure.points), brachy.Dose.at(source, structure.points + moved)
        for position, direction, strength in seeds:
            rest.add(position + [0, 0, 0.05], direction, strength)
            deformed.add(position + [0, 0, 0.05], direction, strength)
        before = rest.values
        rest.displace(moved)
        np.testing.assert_array_equal(rest.values, deformed.values)
        rest.displace(None)
        np.testing.assert_array_equal(rest.values, before)

    def test_dose_volume_histogram(self):
        """For gland, urethra and rectum with 60 seeds, every dose index is within 0.1 % of the value from histograms (0.01 Gy bins) that this script computes
        from its own voxels."""
        table, source = table_of("I-125 6711"), brachy.Source("I-125 6711")
        positions, directions, _ = implant(60, 11)
        for radius, centre, h in ((0.02, (0, 0, 0), 1e-3), (0.004, (0, 0.002, 0.003), 3e-4), (0.012, (0, -0.03, 0), 8e-4)):
            nodes, triangles = icosphere(radius, np.array(centre), 3)
            structure = brachy.Structure.from_surface(nodes, triangles, h)
            dose = brachy.Dose.at(source, structure.points)
            points = lattice(nodes.min(0), nodes.max(0), h)
            normals = np.cross(nodes[triangles[:, 1]] - nodes[triangles[:, 0]], nodes[triangles[:, 2]] - nodes[triangles[:, 0]])
            offset = np.einsum("ij,ij->i", normals, nodes[triangles[:, 0]] - centre)
            normals[offset < 0] *= -1
            own = points[np.linalg.norm(points - centre, axis=1) < radius * 1.001]
            keep = np.ones(len(own), bool)
            for normal, o in zip(normals, abs(offset)):    # the polyhedron with these corners is convex
                keep &= (own - centre) @ normal <= o
            own = own[keep]
            expected = np.zeros(len(own))
            for position, direction in zip(positions, directions):
                dose.add(position, direction, 0.45)
                safe = np.where(inside_capsule(table, position, direction, own)[:, None], [1, 0, 0], own)
                expected += 0.45 * rate(table, position, direction, safe) * 24 * 59.4 / np.log(2) + 1e6 * (safe[:, 0] == 1)
            self.assertEqual(len(own), len(structure.points))
            found = brachy.DVH(dose.values, structure.voxel)
            figures = found.summary(145.0)
            counts, edges = np.histogram(np.minimum(expected, 3000), np.arange(0, 3000.02, 0.01))
            above = np.append(counts[::-1].cumsum()[::-1], 0) / len(own)               # fraction of voxels with at least the dose at each bin's lower edge
            for name, fraction in (("d10", 0.1), ("d30", 0.3), ("d80", 0.8), ("d90", 0.9)):
                by_script = np.interp(-fraction, -above, edges)
                self.assertAlmostEqual(figures[name] / by_script, 1, delta=1e-3, msg=name)
            for name, level in (("v100", 145.0), ("v150", 217.5), ("v200", 290.0)):
                self.assertAlmostEqual(figures[name], np.mean(expected >= level), delta=1e-3 * max(figures[name], 1e-3), msg=name)
            self.assertAlmostEqual(figures["volume_cm3"], len(own) * h**3 * 1e6, delta=1e-9)
            self.assertAlmostEqual(figures["v100_cm3"], figures["v100"] * figures["volume_cm3"], delta=1e-9)
            self.assertEqual((figures["minimum"], figures["maximum"]), (found.doses[-1], found.doses[0]))
            self.assertEqual(found.dose(0), found.doses[0])
            self.assertEqual(found.dose(1), found.doses[-1])
            self.assertEqual(found.volume(0), 1)

    def test_a_table_of_ones_own(self):
        """A copy of a built-in table gives the same doses. A table that differs between the two ends of the seed is not mirrored."""
        text = (SOURCE / "core/dose/data/i125-6711.yaml").read_text()
        points = np.random.default_rng(5).uniform(-0.03, 0.03, (500, 3))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "seed.yaml"
            path.write_text(text)
            np.testing.assert_array_equal(brachy.Source.load(path).rates([[0, 0, 0]], [[1, 2, 3]], [1], points),
                                          brachy.Source("I-125 6711").rates([[0, 0, 0]], [[1, 2, 3]], [1], points))
            path.write_text(text.replace("    - [90, 1, 1, 1, 1, 1, 1]", "    - [90, 1, 1, 1, 1, 1, 1]\n    - [180, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]"))
            front, back = brachy.Source.load(path).rates([[0, 0, 0]], [[0, 0, 1]], [1], [[0, 0, 0.01], [0, 0, -0.01]])
            self.assertAlmostEqual(front / back, 0.37 / 0.5, delta=1e-12)

    def test_errors_are_exceptions(self):
        source = brachy.Source("I-125 6711")
        dose = brachy.Dose(source, [0, 0, 0], 1e-3, (3, 3, 3))
        for wrong, text in ((lambda: brachy.Source("I-125 6712"), "I-125 6711"), (lambda: dose.remove(3), "no seed has the id 3"),
                            (lambda: dose.add([0, 0, np.nan], [0, 0, 1], 1), "finite"), (lambda: dose.add([0, 0, 0], [0, 0, 0], 1), "direction"),
                            (lambda: dose.add([0, 0, 0], [0, 0, 1], 0), "above 0"), (lambda: brachy.DVH([], 1e-9), "at least one"),
                            (lambda: brachy.DVH([1, np.inf], 1e-9), "finite"), (lambda: brachy.Source.load("/nowhere.yaml"), "cannot open"),
                            (lambda: brachy.Dose(source, [0, 0, 0], 0, (3, 3, 3)), "spacing"),
                            (lambda: brachy.Structure.from_surface([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], 0.1), "not closed")):
            with self.assertRaisesRegex(trocar.Error, text) as caught:
                wrong()
            self.assertEqual(caught.exception.status, "bad input")
        for wrong in (lambda: dose.add([0, 0], [0, 0, 1], 1), lambda: dose.displace([[0, 0, 0]]), lambda: brachy.Dose.at(source, [0, 0, 0])):
            with self.assertRaises(ValueError):
                wrong()
        self.assertEqual(dose.seeds, 0)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1] + sys.argv[3:])
