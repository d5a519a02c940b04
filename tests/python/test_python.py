#!/usr/bin/python3
"""Compares the Python package with trocar-replay and with itself.

usage: test_python.py BUILD_DIR SOURCE_DIR
"""
import csv
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
import unittest
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
import numpy as np

import trocar

FIGURE8 = SOURCE / "meshes/figure8.yaml"


def cube(n=3, h=0.01):
    """Returns a cube of n^3 boxes, each divided into six tetrahedra around its diagonal (Kuhn)."""
    side = n + 1
    index = lambda x, y, z: x + side * (y + side * z)
    axis = np.arange(side) * h
    nodes = np.array([[x - 0.5 * n * h, y - 0.5 * n * h, z] for z in axis for y in axis for x in axis])
    tets, triangles, surface = [], [], []
    for x, y, z in np.ndindex(n, n, n):
        for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
            at, corner = [x, y, z], [index(x, y, z)]
            for k in order:
                at[k] += 1
                corner.append(index(*at))
            tets.append(corner)
    faces = {}
    for tet in tets:
        for k in range(4):
            face = tuple(sorted(tet[:k] + tet[k + 1:]))
            faces[face] = faces.get(face, 0) + 1
    for face, count in faces.items():
        depth = nodes[list(face), 2]
        if count == 1 and (np.all(depth == 0) or np.all(depth == axis[-1])):
            triangles.append(face)
            surface.append(0 if depth[0] == 0 else 1)
    return trocar.Mesh(nodes=nodes, tets=tets, regions=["body"], surfaces=["skin", "back"], triangles=triangles, triangle_surface=surface)


def measured(work):
    """Returns the result of `work`, its CPU time (s), and by how much it grew the process's memory (bytes)."""
    resident = lambda: int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    results, before, peak = [], resident(), 0
    start = time.process_time()
    thread = threading.Thread(target=lambda: results.append(work()))
    thread.start()
    while thread.is_alive():
        peak = max(peak, resident())
        time.sleep(0.005)
    return results[0], time.process_time() - start, peak - before


class PythonTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.model = trocar.Model(trocar.Scene.load(FIGURE8))

    def test_start_and_patient_coordinates(self):
        self.assertIsNone(self.model.start)
        self.assertIsNone(self.model.patient_to_mesh)
        scene = trocar.Scene()
        scene.set_mesh(cube())
        scene["regions[body].youngs_modulus"], scene["fixed"] = 10e3, ["back"]
        matrix = np.array([[0, -1e-3, 0, 0.25], [1e-3, 0, 0, -0.125], [0, 0, 1e-3, 0.5], [0, 0, 0, 1]])
        scene["patient_to_mesh"] = matrix.ravel()
        scene["needle.start.position"] = [0, 0, -0.21]
        scene["needle.start.orientation"] = [0.8, 0.6, 0, 0]
        model = trocar.Model(scene)
        np.testing.assert_array_equal(model.patient_to_mesh, matrix)
        np.testing.assert_allclose(model.start, [0, 0, -0.21, 0.8, 0.6, 0, 0], atol=1e-15)

    def test_forces_are_those_of_replay(self):
        """Applied tick by tick, a golden trace's poses give the same digits as trocar-replay."""
        with tempfile.TemporaryDirectory() as folder:
            table = Path(folder) / "out.csv"
            log = SOURCE / "tests/traces/figure8.log"
            subprocess.run([BUILD / "clients/trocar-replay", "-q", "--scene", FIGURE8, "--poses", log, "--csv", table], check=True)
            rows = list(csv.reader(table.read_text().splitlines()))[1:]
        poses = list(read_poses(log))
        self.assertEqual(len(poses), len(rows))
        sim = trocar.Sim(self.model)
        sim.reset(poses[0][1])
        before = poses[0][0] - 1000
        for (utime, pose), row in zip(poses, rows):
            out = sim.step(pose, 1e-6 * (utime - before))
            before = utime
            np.testing.assert_array_equal([*out.force, *out.torque], [float(x) for x in row[1:7]])
        self.assertGreater(sim.centreline().shape[0], 10)

    def test_rollout_is_the_same_insertions_one_by_one(self):
        """64 insertions on two threads. Each step is bit-identical to that of a single simulation, and the rollout is faster than real time and keeps one
        simulation per thread."""
        batch, steps, dt = 64, 200, 0.001
        poses = np.zeros((batch, steps, 7))
        poses[..., 0] = 0.005 + 1e-4 * np.arange(batch)[:, None]
        poses[..., 1] = 0.003
        poses[..., 2] = -0.201 + 1.5e-4 * np.arange(steps)
        poses[..., 3] = 1
        together, seconds, memory = measured(lambda: trocar.rollout(self.model, poses, dt, threads=2))
        self.assertEqual(together["force"].shape, (batch, steps, 3))
        for insertion in range(batch):
            sim = trocar.Sim(self.model)
            sim.reset(poses[insertion, 0])
            alone = [sim.step(pose, dt) for pose in poses[insertion]]
            for field in alone[0]._fields:
                np.testing.assert_array_equal([getattr(out, field) for out in alone], together[field][insertion])
        self.assertGreater(np.abs(together["force"][:, -1, 2]).min(), 0.1)
        _, _, single = measured(lambda: trocar.rollout(self.model, poses[:1], dt, threads=1))
        print("\nrollout: %.1f times real time per core; %.1f MB without the results, %.1f MB for one insertion"
              % (batch * steps * dt / seconds, 1e-6 * (memory - together.nbytes), 1e-6 * single))
        self.assertGreater(batch * steps * dt / seconds, 2)
        self.assertLess(memory - together.nbytes, 0.1 * batch * single)

    def test_guides_hold_the_needle(self):
        scene = trocar.Scene.load(SOURCE / "meshes/template.yaml")
        self.assertEqual(scene["guides[template].columns"], 13)
        sim = trocar.Sim(trocar.Model(scene))
        pose = lambda x, z: [x, 0.003, z, 1, 0, 0, 0]
        sim.reset(pose(0.005, -0.24))
        self.assertIsNone(sim.hole(0))
        for i in range(400):
            output = sim.step(pose(0.005 + 4e-6 * i, -0.24 + 1e-4 * i), 0.001)
        self.assertEqual(sim.hole(0), 7 + 13 * 6)
        contacts = sim.contacts()
        self.assertEqual(contacts[0].kind, "guide")
        np.testing.assert_allclose(sum(contact.force for contact in contacts), -output.force, atol=1e-9)

    def test_a_mesh_in_memory(self):
        scene = trocar.Scene()
        scene.set_mesh(cube())
        scene["regions[body].youngs_modulus"] = 20e3
        scene["membranes[skin].puncture_force"] = 0.3
        scene["fixed"] = ["back"]
        model = trocar.Model(scene)
        self.assertEqual(model.nodes.shape, (64, 3))
        self.assertEqual(model.groups, ["body", "skin", "back"])
        with self.assertRaises(ValueError):
            model.nodes[0, 0] = 1
        sim = trocar.Sim(model)
        sim.reset([1e-3, 2e-3, -0.201, 1, 0, 0, 0])
        for tick in range(300):
            out = sim.step([1e-3, 2e-3, -0.201 + 5e-5 * tick, 1, 0, 0, 0], 0.001)
        total = sum(contact.force for contact in sim.contacts())
        np.testing.assert_allclose(total, -out.force, atol=1e-9)
        self.assertTrue(np.all(sim.displacements()[model.nodes[:, 2] > 0.0299] == 0))

    def test_contacts_by_id_slot_status_and_needle(self):
        """Checks each field against the library's documentation while the second of two needles is pushed in and retracted."""
        scene = trocar.Scene.load(FIGURE8)
        scene["needles"] = 2
        sim = trocar.Sim(trocar.Model(scene))
        pose = lambda tick: [0.005, 0.003, -0.201 + 1.5e-4 * min(tick, 400 - tick), 1, 0, 0, 0]
        sim.reset(pose(0), needle=1)
        held, seen = {}, set()  # held: slot and depth of each contact, by id
        for tick in range(400):
            out = sim.step(pose(tick), 0.001, needle=1)
            self.assertEqual(sim.contacts(), [])
            active, pending = sim.contacts(needle=1), sim.pending_contacts(needle=1)
            tissue = [c for c in active if c.kind == "tissue"]
            self.assertEqual(len(tissue), out.contacts)
            for c in active:
                self.assertEqual((c.needle, c.status), (1, "sliding" if c.state else "sticking"))
            for c in active[len(tissue):]:
                self.assertEqual((c.kind, c.id, c.slot), ("tip", 0, -1))
            for c in pending:
                self.assertIn(c.status, ("planned", "adding"))
                self.assertFalse(c.force.any())
            for c in tissue + pending:
                self.assertEqual(held.setdefault(c.id, (c.slot, c.depth)), (c.slot, c.depth))
            slots = [c.slot for c in tissue + pending]
            self.assertEqual(len(set(slots)), len(slots))
            seen.update(c.status for c in active + pending)
        self.assertGreater(len(held), 2)
        self.assertNotIn(0, held)
        self.assertLessEqual({"planned", "sticking", "sliding"}, seen)

    def test_a_needle_rests_and_is_taken_again(self):
        scene = trocar.Scene.load(f"{SOURCE}/meshes/figure8.yaml")
        scene["needles"] = 2
        sim = trocar.Sim(trocar.Model(scene))
        base = np.array([0.005, 0.003, -0.201, 1, 0, 0, 0])
        sim.reset(base)
        for _ in range(300):
            base[2] += 1e-4
            sim.step(base, 0.001)
        self.assertEqual(sim.needle_state(0), "held")
        sim.leave(0)
        self.assertEqual(sim.needle_state(0), "resting")
        forces = np.array([c.force for c in sim.contacts(0)])
        with self.assertRaisesRegex(trocar.Error, "take it first"):
            sim.step(base, 0.001)
        sim.take(0)
        self.assertEqual(sim.needle_state(0), "held")
        out = sim.step(sim.base(0), 0.001)
        self.assertLess(np.linalg.norm(out.force), 2e-3)
        np.testing.assert_allclose([c.force for c in sim.contacts(0)], forces, atol=1e-3)  # the forces at the moment the needle was released

    def test_tracks_are_where_the_needle_went(self):
        sim = trocar.Sim(self.model)
        sim.reset([0.005, 0.003, -0.201, 1, 0, 0, 0])
        for x in (0.005, 0.012):
            for z in (*np.arange(-0.201, -0.140, 2e-4), *np.arange(-0.140, -0.205, -5e-4)):
                sim.step([x, 0.003, z, 1, 0, 0, 0], 0.002)
        tracks = sim.tracks()
        self.assertEqual(len(tracks), 2)
        for x, track in zip((0.005, 0.012), tracks):
            self.assertEqual(track.points.shape, (len(track.membranes), 3))
            self.assertLess(np.abs(track.points[:, :2] - [x, 0.003]).max(), 5e-4)
            self.assertTrue(np.all(np.diff(track.points[:, 2]) >= 0) and track.points[-1, 2] > 0.03)
            self.assertEqual(track.membranes[track.membranes >= 0].tolist(), [0, 1])
        sim.reset([0.005, 0.003, -0.201, 1, 0, 0, 0])
        self.assertEqual(sim.tracks(), [])

    def test_changes_during_a_run(self):
        """After a change, the forces are those of a derived model that had the new values from the start. Bad values change nothing."""
        values = {"membranes[skin].puncture_force": 1.5, "regions[surrounding].cutting_force": 0.8}
        at = lambda depth: [0.005, 0.003, depth - 0.2, 1, 0, 0, 0]
        model = trocar.Model(trocar.Scene.load(FIGURE8))
        changed, built = trocar.Sim(model), trocar.Sim(model.derive(**values))
        for sim in changed, built:
            sim.reset(at(-0.002))
        before = changed.parameters
        self.assertEqual(before["membranes[skin].puncture_force"], 0.6)
        for bad, words in (({"needle.length": 0.1}, "cannot change during a run"), ({"membranes[skin].puncture_force": -1}, "at least 0"), ({}, "nothing"),
                           ({"membranes[skin].puncture_force": np.inf}, "bone")):
            with self.assertRaisesRegex(trocar.Error, words):
                changed.change(bad)
        with self.assertRaisesRegex(trocar.Error, "0.1 to 60 s"):
            changed.change(values, time=0.01)
        self.assertEqual(changed.parameters, before)
        changed.change(values, time=0.1)
        self.assertAlmostEqual(changed.changing, 0.1)
        self.assertEqual(changed.parameters, {**before, **values})
        for i in range(100):
            changed.step(at(-0.002), 0.001), built.step(at(-0.002), 0.001)
        self.assertEqual(changed.changing, 0.0)
        for depth in np.arange(0, 0.02, 1e-4):
            self.assertEqual(list(changed.step(at(depth), 0.001).force), list(built.step(at(depth), 0.001).force))

    def test_save_and_restore(self):
        pose = lambda tick: [0.005, 0.003, -0.201 + 1e-4 * tick, 1, 0, 0, 0]
        sim = trocar.Sim(self.model)
        sim.reset(pose(0))
        for tick in range(100):
            sim.step(pose(tick), 0.001)
        state = sim.save()
        forces = [sim.step(pose(tick), 0.001).force for tick in range(100, 200)]
        sim.restore(state)
        np.testing.assert_array_equal(forces, [sim.step(pose(tick), 0.001).force for tick in range(100, 200)])

    def test_time_is_that_of_the_steps(self):
        sim = trocar.Sim(self.model)
        sim.reset([0.005, 0.003, -0.201, 1, 0, 0, 0])
        self.assertEqual(sim.time, 0)
        for _ in range(10):
            sim.step([0.005, 0.003, -0.201, 1, 0, 0, 0], 0.002)
        self.assertAlmostEqual(sim.time, 0.02, delta=1e-12)
        state = sim.save()
        sim.step([0.005, 0.003, -0.201, 1, 0, 0, 0], 0.5)
        self.assertAlmostEqual(sim.time, 0.52, delta=1e-12)
        sim.restore(state)
        self.assertAlmostEqual(sim.time, 0.02, delta=1e-12)

    def test_messages_go_to_logging(self):
        scene = trocar.Scene()
        scene.set_mesh(cube())
        scene["regions[body].youngs_modulus"] = 20e3
        scene["fixed"] = ["back"]
        scene["needle.length"] = 5.0    # so much longer than the body that the mesh unit looks wrong
        with self.assertLogs("trocar", "INFO") as logged:
            model = trocar.Model(scene)
        self.assertEqual([record.levelname for record in logged.records], ["WARNING", "INFO"])
        self.assertIn("mesh_unit", logged.records[0].getMessage())
        self.assertIn(model.description, logged.records[1].getMessage())

    def test_the_gil_is_released(self):
        """This thread keeps running during a rollout in another thread."""
        poses = np.zeros((4, 500, 7))
        poses[..., 0:3] = [0.005, 0.003, -0.201]
        poses[..., 2] += 1e-4 * np.arange(500)
        poses[..., 3] = 1
        counted = 0
        thread = threading.Thread(target=trocar.rollout, args=(self.model, poses))
        thread.start()
        while thread.is_alive():
            counted += 1
        thread.join()
        self.assertGreater(counted, 1000)

    def test_errors_are_exceptions_with_the_librarys_text(self):
        with self.assertRaisesRegex(trocar.Error, "/nowhere.yaml: cannot open"):
            trocar.Scene.load("/nowhere.yaml")
        scene = trocar.Scene()
        with self.assertRaisesRegex(trocar.Error, 'no key "needle.lenght"'):
            scene["needle.lenght"] = 1
        with self.assertRaisesRegex(trocar.Error, 'missing key "mesh"') as caught:
            trocar.Model(scene)
        self.assertEqual(caught.exception.status, "bad input")
        sim = trocar.Sim(self.model)
        with self.assertRaisesRegex(trocar.Error, "unit length"):
            sim.step([0, 0, 0, 0, 0, 0, 0], 0.001)
        with self.assertRaises(ValueError):
            sim.step([0, 0, 0], 0.001)
        with self.assertRaises(ValueError):
            trocar.rollout(self.model, np.zeros((3, 7)))

    def test_events_are_those_of_the_header(self):
        header = re.findall(r"TROCAR_EVENT_(\w+) = 1 << (\d+)", (SOURCE / "core/include/trocar/sim.h").read_text())
        self.assertIn(("TOUCHED", "0"), header)
        self.assertEqual([(event.name, int(event)) for event in trocar.Event], [(name, 1 << int(bit)) for name, bit in header])

    def test_the_table_of_keys(self):
        rows = {row.key: row for row in trocar.keys()}
        self.assertEqual(rows["needle.length"].unit, "m")
        self.assertEqual(float(rows["needle.length"].default), 0.2)
        self.assertTrue(rows["mesh"].required)
        scene = trocar.Scene.load(FIGURE8)
        self.assertEqual(scene["regions[prostate].youngs_modulus"], 60e3)
        self.assertEqual(scene["fixed"], ["fixed"])


def read_poses(path):
    """Returns (utime, pose) of the poses in an LCM event log. Values are big-endian: an 8-byte fingerprint, then the fields of needle_pose_t."""
    data, at = path.read_bytes(), 0
    while at < len(data):
        assert data[at:at + 4] == bytes.fromhex("EDA1DA01")
        channel, size = (int.from_bytes(data[at + k:at + k + 4], "big") for k in (20, 24))
        payload = data[at + 28 + channel:at + 28 + channel + size]
        if data[at + 28:at + 28 + channel] == b"TROCAR_POSE":
            yield int.from_bytes(payload[8:16], "big"), np.frombuffer(payload[32:88], ">f8").astype(float)
        at += 28 + channel + size


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
