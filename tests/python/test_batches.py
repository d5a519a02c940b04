#!/usr/bin/python3
"""Compares the Python package's batches with single simulations.

usage: test_batches.py BUILD_DIR SOURCE_DIR
"""
import copy
import os
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
ROWS, STEPS = 4, 150
EVERY = ("force", "torque", "depth", "tip", "contacts", "events", "membrane", "passes", "switches", "seeds")


def straight(rows=ROWS, steps=STEPS):
    """Returns poses (rows, steps, 7) that advance the needles by 30 mm at different positions."""
    poses = np.zeros((rows, steps, 7))
    poses[..., 0] = np.linspace(-0.006, 0.006, rows)[:, None]
    poses[..., 2] = -0.201 + 2e-4 * np.arange(steps)
    poses[..., 3] = 1
    return poses


class Batches(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.model = trocar.Model(trocar.Scene.load(FIGURE8))
        cls.slippery = cls.model.derive(**{"regions[prostate].friction.kinetic": 3.0, "needle.bevel_slope": 0.05})

    def test_rows_equal_single_simulations(self):
        poses = straight()
        batch = trocar.Batch([self.model, self.slippery], ROWS, threads=2, outputs=EVERY)
        self.assertEqual((len(batch), batch.threads, batch.needles), (ROWS, 2, 1))
        self.assertEqual(batch.models, (self.model, self.slippery) * 2)
        batch.reset(poses[:, 0])
        out = batch.run(poses)
        batch.reset(poses[:, 0])
        for step in range(STEPS):
            last = batch.step(poses[:, step])
        for row in range(ROWS):
            sim = trocar.Sim(batch.models[row])
            sim.reset(poses[row, 0])
            single = sim.run(poses[row], 0.001)
            for name in ("force", "torque", "depth", "contacts", "events", "membrane", "passes", "switches"):
                np.testing.assert_array_equal(out[name][row], single[name], name)
                np.testing.assert_array_equal(last[name][row], single[name][-1], name)
            np.testing.assert_array_equal(out["tip"][row, -1, :3], sim.centreline()[-1])
            np.testing.assert_array_equal(batch[row].centreline(), sim.centreline())
        self.assertGreater(np.abs(out["force"][0] - out["force"][1]).max(), 0.01)
        self.assertEqual(out["seeds"].shape, (ROWS, STEPS))
        np.testing.assert_array_equal(batch.status, 0)

    def test_arrays_are_shared_and_have_an_axis_of_needles_if_the_poses_have(self):
        poses = straight()
        batch = trocar.Batch(self.model, ROWS, threads=1, outputs=("force", "seeds"))
        batch.reset(poses[:, 0])
        first = batch.step(poses[:, 0])
        second = batch.step(poses[:, 1, None])
        self.assertTrue(np.shares_memory(first["force"], second["force"]))
        self.assertEqual((first["force"].shape, second["force"].shape), ((ROWS, 3), (ROWS, 1, 3)))
        self.assertEqual((set(first), first["seeds"].shape, second["seeds"].shape), ({"force", "seeds"}, (ROWS,), (ROWS,)))
        self.assertEqual(batch.run(poses[:, :2, None])["force"].shape, (ROWS, 2, 1, 3))

    def test_only_rows_of_the_mask_are_stepped_and_reset(self):
        poses, mask = straight(), np.array([True, False, True, False])
        batch = trocar.Batch(self.model, ROWS)
        batch.reset(poses[:, 0])
        masked = np.where(mask[:, None, None], poses, np.nan)
        out = batch.run(masked, mask=mask)
        np.testing.assert_array_equal(out["depth"][:, -1] > 0, mask)
        self.assertEqual([batch[row].time > 0 for row in range(ROWS)], list(mask))
        batch.reset(masked[:, 0], mask=mask)
        self.assertEqual([batch[row].time for row in range(ROWS)], [0.0] * ROWS)
        again = batch.run(poses)
        np.testing.assert_array_equal(again["force"][mask], out["force"][mask])

    def test_needles_of_a_row(self):
        scene = self.model.scene
        scene["needles"] = 2
        model = self.model.derive(scene)
        poses = np.stack([straight(2), straight(2) + [0, 0.008, 0, 0, 0, 0, 0]], axis=2)
        batch = trocar.Batch(model, 2, needles=2, outputs=("force",))
        batch.reset(poses[:, 0])
        out = batch.run(poses)
        sim = trocar.Sim(model)
        for needle in range(2):
            sim.reset(poses[1, 0, needle], needle)
        for step in range(STEPS):
            force = [sim.step(poses[1, step, needle], 0.001, needle).force for needle in range(2)]
        np.testing.assert_array_equal(out["force"][1, -1], force)
        with self.assertRaisesRegex(trocar.Error, "2 needles are driven and the model has 1"):
            trocar.Batch(self.model, 2, needles=2)
        with self.assertRaisesRegex(ValueError, r"poses are \(2, 2, 7\)"):
            batch.step(poses[:, 0, 0])

    def test_states_go_to_other_rows_and_other_processes(self):
        poses = straight()
        batch = trocar.Batch(self.model, ROWS, outputs=("force",))
        batch.reset(poses[:, 0])
        batch.run(poses[:, :100])
        states = batch.save()
        self.assertLess(max(map(len, states)), 300000)
        rest = batch.run(poses[:, 100:])["force"]
        batch.restore([states[0], states[3]], mask=[True, True, False, False])
        crossed = poses[:, 100:][[0, 3, 2, 3]]
        out = batch.run(crossed, mask=[True, True, False, False])["force"]
        np.testing.assert_array_equal(out[:2], rest[[0, 3]])
        batch.restore(states[2])
        self.assertEqual({batch[row].time for row in range(ROWS)}, {batch[0].time})
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "state").write_bytes(states[1])
            np.save(Path(folder, "poses.npy"), poses[1, 100:])
            program = ("import sys, numpy, trocar; from pathlib import Path; sim = trocar.Sim(trocar.Model(trocar.Scene.load(sys.argv[1])));"
                       "sim.restore(Path(sys.argv[2], 'state').read_bytes());"
                       "numpy.save(Path(sys.argv[2], 'force.npy'), sim.run(numpy.load(Path(sys.argv[2], 'poses.npy')), 0.001)['force'])")
            subprocess.run([sys.executable, "-c", program, FIGURE8, folder], check=True, env={**os.environ, "PYTHONPATH": str(BUILD / "clients/python")})
            np.testing.assert_array_equal(np.load(Path(folder, "force.npy")), rest[1])
        with self.assertRaisesRegex(trocar.Error, "another model"):
            trocar.Sim(self.slippery).restore(states[0])
        with self.assertRaisesRegex(trocar.Error, "damaged"):
            batch[0].restore(states[0][:-1] + bytes([states[0][-1] ^ 1]))
        with self.assertRaisesRegex(ValueError, "1 states for 4 rows"):
            batch.restore([states[0]])

    def test_a_row_takes_another_model(self):
        poses = straight()
        batch = trocar.Batch(self.model, ROWS, outputs=("force",))
        row = batch[1]
        batch.set_model(1, self.slippery)
        self.assertIs(row.model, self.slippery)
        self.assertIs(batch[1], row)
        batch.reset(poses[:, 0])
        out = batch.run(poses)["force"]
        sim = copy.copy(row)
        self.assertEqual(sim.time, row.time)
        sim.reset(poses[1, 0])
        single = trocar.Sim(self.slippery)
        single.reset(poses[1, 0])
        np.testing.assert_array_equal(out[1], single.run(poses[1], 0.001)["force"])
        with self.assertRaises(IndexError):
            batch.set_model(ROWS, self.model)

    def test_an_error_in_a_row_does_not_stop_the_others(self):
        poses = straight()
        batch = trocar.Batch(self.model, ROWS)
        batch.reset(poses[:, 0])
        out = batch.step(poses[:, 0])
        wrong = poses[:, 1].copy()
        wrong[2] = np.nan
        with self.assertRaisesRegex(trocar.Error, "row 2: step 0: the pose is not finite") as raised:
            batch.step(wrong)
        self.assertEqual(raised.exception.status, "bad input")
        self.assertEqual((list(batch.status), list(batch.done)), ([0, 0, 1, 0], [1, 1, 0, 1]))
        self.assertEqual(list(out["tip"][:, 3] != 0), [True, True, False, True])

    def test_what_is_wrong_with_the_arguments(self):
        batch = trocar.Batch(self.model, ROWS)
        for call, words in ((lambda: trocar.Batch(self.model, 2, outputs=("wrench",)), 'no "wrench"'), (lambda: trocar.Batch([], 2), "0 models"),
                            (lambda: batch.step(np.zeros((3, 7))), r"\(4, 7\)"), (lambda: batch.run(np.zeros((4, 7))), r"\(4, steps, 7\)"),
                            (lambda: batch.step(np.zeros((4, 7)), mask=[True]), "a mask is"), (lambda: batch.reset(np.zeros(6)), "broadcast")):
            with self.assertRaisesRegex(ValueError, words):
                call()
        with self.assertRaises(IndexError):
            batch[ROWS]
        with self.assertRaisesRegex(trocar.Error, "threads"):
            trocar.Batch(self.model, 2, threads=1000)

    def test_progress_cancels_and_other_threads_are_refused(self):
        poses = straight()
        batch = trocar.Batch(self.model, ROWS, threads=1)
        batch.reset(poses[:, 0])

        def stop(_, fraction):
            if fraction > 0.2:
                raise KeyboardInterrupt
        with self.assertRaises(KeyboardInterrupt):
            batch.run(poses, progress=stop)
        self.assertTrue(0 < batch.done.sum() < ROWS * STEPS)
        refused = []

        def intrude(*_):
            try:
                batch[0].time
            except trocar.Error as error:
                refused.append(str(error))
        batch.run(poses[:, :10], progress=intrude)
        self.assertIn("this Batch is in use", refused[0])

    def test_the_interpreter_runs_meanwhile(self):
        poses = np.repeat(straight(), 4, axis=1)
        batch = trocar.Batch(self.model, ROWS, threads=1)
        batch.reset(poses[:, 0])
        begun, ticks, done = threading.Event(), [], threading.Event()

        def count():
            begun.set()
            while not done.is_set():
                ticks.append(time.monotonic())
                time.sleep(0.001)
        thread = threading.Thread(target=count)
        thread.start()
        begun.wait()
        begin = time.monotonic()
        batch.run(poses)
        end = time.monotonic()
        done.set()
        thread.join()
        self.assertGreater(sum(begin < tick < end for tick in ticks), 10)

    def test_a_row_outlives_the_name_of_its_batch(self):
        sim = trocar.Batch(self.model, 1)[0]
        sim.reset(straight()[0, 0])
        self.assertEqual(sim.step(straight()[0, 0], 0.001).contacts, 0)

    def test_scenes_and_models_are_copied_with_changes(self):
        scene = self.model.scene
        other = scene.copy()
        other["needle.length"] = 0.18
        self.assertEqual((scene["needle.length"], self.model.scene["needle.length"], other["needle.length"]), (0.2, 0.2, 0.18))
        derived = self.slippery.derive(**{"needle.length": 0.15})
        self.assertEqual((derived.needle_length, derived.scene["needle.bevel_slope"], self.slippery.needle_length), (0.15, 0.05, 0.2))
        self.assertEqual(self.model.derive(other).needle_length, 0.18)
        with self.assertRaisesRegex(trocar.Error, "youngs_modulus"):
            self.model.derive(**{"regions[prostate].youngs_modulus": 1e3})


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1], verbosity=2)
