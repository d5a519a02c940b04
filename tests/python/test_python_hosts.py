#!/usr/bin/python3
"""Tests the Python package in the programs that use it: processes and threads, copies, wrong arguments, interruptions, and type checkers.

usage: test_python_hosts.py BUILD_DIR SOURCE_DIR
"""
import copy
import gc
import multiprocessing
import os
import pickle
import signal
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
from trocar import brachy

FIGURE8, IMPLANT, TRUS = (SOURCE / f"meshes/{name}.yaml" for name in ("figure8", "implant", "trus"))
PATIENCE = 60  # s, after which a process counts as hung


def pushed(model, ticks=300):
    """Returns a simulation in which a needle has been inserted."""
    sim = trocar.Sim(model)
    sim.run(straight(ticks), 0.001)
    return sim


def straight(ticks, end=1.5e-4):
    poses = np.zeros((ticks, 7))
    poses[:, :3], poses[:, 3] = [0.005, 0.003, -0.201], 1
    poses[:, 2] += end * np.arange(ticks)
    return poses


def last_force(scene_path):
    """Runs in a worker process and creates its own model. A scene that cannot be read raises Error."""
    return trocar.rollout(trocar.Model(trocar.Scene.load(scene_path)), straight(100)[None])["force"][0, -1].tolist()


def in_child(work):
    """Runs `work` in a forked child. Returns its exit status, or None if it hangs."""
    child = os.fork()
    if child == 0:
        try:
            work()
            os._exit(0)
        except BaseException:
            os._exit(1)
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


class ProcessTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.model = trocar.Model(trocar.Scene.load(FIGURE8))

    def test_a_child_makes_a_model_after_its_parent_has(self):
        self.assertEqual(in_child(lambda: trocar.Model(trocar.Scene.load(FIGURE8))), 0)

    def test_a_child_forked_while_another_thread_makes_models(self):
        """Forking works whatever locks the other thread holds at that moment."""
        over = threading.Event()

        def make():
            while not over.is_set():
                trocar.Model(trocar.Scene.load(FIGURE8))

        thread = threading.Thread(target=make)
        thread.start()
        try:
            for _ in range(5):
                self.assertEqual(in_child(lambda: trocar.Model(trocar.Scene.load(FIGURE8))), 0)
        finally:
            over.set()
            thread.join()

    def test_a_pool_of_forked_workers(self):
        expected = last_force(FIGURE8)
        with multiprocessing.get_context("fork").Pool(2) as pool:
            forces = pool.map_async(last_force, [FIGURE8] * 4).get(PATIENCE)
        self.assertEqual(forces, [expected] * 4)

    def test_an_error_in_a_worker_comes_back(self):
        with multiprocessing.get_context("fork").Pool(1) as pool:
            with self.assertRaisesRegex(trocar.Error, "/nowhere.yaml") as caught:
                pool.map_async(last_force, ["/nowhere.yaml"]).get(PATIENCE)
        self.assertEqual(caught.exception.status, "bad input")
        self.assertIsInstance(pickle.loads(pickle.dumps(caught.exception)), trocar.Error)

    def test_the_threads_of_other_programs_openmp_are_left_alone(self):
        """Once a model has been created, OpenMP's limit on nested regions is back to what the host program had set."""
        program = ("import ctypes, trocar, sys; openmp = ctypes.CDLL('libgomp.so.1'); openmp.omp_set_max_active_levels(3); "
                   "trocar.Model(trocar.Scene.load(sys.argv[1])); print(openmp.omp_get_max_active_levels())")
        done = subprocess.run([sys.executable, "-c", program, FIGURE8], env={**os.environ, "PYTHONPATH": str(BUILD / "clients/python")}, capture_output=True,
                              text=True, check=True)
        self.assertEqual(done.stdout.strip(), "3")


class ObjectTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        scene = trocar.Scene.load(FIGURE8)
        cls.model = trocar.Model(scene)

    def test_a_needle_that_does_not_exist(self):
        sim = pushed(self.model)
        for needle in (1, -1, 32, 1000):
            for call in (sim.centreline, sim.base, sim.needle_state, sim.contacts, sim.pending_contacts, sim.tracks, sim.pending_seeds, sim.tip_lead,
                         sim.needle_energy, sim.leave, sim.take, sim.undo_seed):
                with self.assertRaisesRegex(trocar.Error, f"needle {needle}: there is one, number 0", msg=call.__name__):
                    call(needle=needle)
            for call in (lambda: sim.reset(straight(1)[0], needle=needle), lambda: sim.step(straight(1)[0], 0.001, needle=needle),
                         lambda: sim.run(straight(1), 0.001, needle=needle), lambda: sim.drop_seeds(needle=needle), lambda: sim.hole(0, needle=needle)):
                with self.assertRaisesRegex(trocar.Error, f"needle {needle}: "):
                    call()
        with self.assertRaisesRegex(trocar.Error, "guide 0: the scene has 0"):
            sim.hole(0)

    def test_two_threads_on_one_simulation(self):
        """The second thread is refused and has no effect: the forces are those of an undisturbed simulation."""
        sim, alone, begun, refused, outputs = trocar.Sim(self.model), trocar.Sim(self.model), threading.Event(), 0, []
        poses = straight(4000, 0.2e-4)
        running = threading.Thread(target=lambda: outputs.append(sim.run(poses, 0.001, progress=lambda *_: begun.set())))
        running.start()
        self.assertTrue(begun.wait(PATIENCE))
        for call in (lambda: sim.step(poses[0], 0.001), sim.contacts, sim.save, sim.displacements, lambda: sim.reset(poses[0]), sim.seeds):
            with self.assertRaisesRegex(trocar.Error, "in use: another thread"):
                call()
        running.join()
        np.testing.assert_array_equal(outputs[0], alone.run(poses, 0.001))
        sim.contacts()

    def test_threads_that_make_models_of_one_scene(self):
        """Any thread may read the scene. Changing it is refused while any thread is reading it."""
        scene, models, refused, both = trocar.Scene.load(FIGURE8), [], [], threading.Barrier(2, timeout=PATIENCE)
        scene["inverse"], scene["region_of_interest.regions"] = "condensed", ["prostate"]

        def make():
            def tell(what, fraction):
                if told:
                    return
                told.append(what)
                both.wait()    # both threads are inside the library
                try:
                    scene["needle.length"] = 2 * scene["needle.length"]
                except trocar.Error as error:
                    refused.append(str(error))
                both.wait()
            told = []
            models.append(trocar.Model(scene, progress=tell))

        with tempfile.TemporaryDirectory() as cache:
            scene["cache"] = cache
            threads = [threading.Thread(target=make) for _ in range(2)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
        self.assertEqual(len(models), 2)
        self.assertEqual([model.needle_length for model in models], [0.2, 0.2])
        self.assertEqual(len(refused), 2)
        for text in refused:
            self.assertRegex(text, "in use: another thread")
        scene["needle.length"] = 0.25

    def test_threads_with_a_simulation_each(self):
        expected, results = pushed(self.model).step(straight(301)[300], 0.001).force, [None] * 4

        def run(i):
            results[i] = pushed(self.model).step(straight(301)[300], 0.001).force

        threads = [threading.Thread(target=run, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        np.testing.assert_array_equal(results, [expected] * 4)

    def test_models_may_go_before_their_simulations(self):
        """Python frees the objects of a reference cycle in any order. At exit, it does so with all objects."""
        for _ in range(20):
            model = trocar.Model(trocar.Scene.load(FIGURE8))
            circle = [model, model.derive(trocar.Scene.load(FIGURE8))]
            circle += [trocar.Sim(circle[0]), trocar.Sim(circle[1]), circle]
            del model, circle
            gc.collect()
        program = ("import sys, trocar\nmodel = trocar.Model(trocar.Scene.load(sys.argv[1]))\nderived = model.derive(trocar.Scene.load(sys.argv[1]))\n"
                   "trocar.kept = [model, trocar.Sim(derived)]\ntrocar.kept.append(trocar.kept)\n")
        subprocess.run([sys.executable, "-c", program, FIGURE8], env={**os.environ, "PYTHONPATH": str(BUILD / "clients/python")}, check=True)

    def test_a_model_lives_as_long_as_what_is_made_of_it(self):
        scene = trocar.Scene.load(FIGURE8)
        model = trocar.Model(scene)
        sim = pushed(model.derive(scene), 200)
        sim.model = None    # as if the host program had dropped the last reference to the model
        del model
        gc.collect()
        other = pushed(self.model, 200)
        np.testing.assert_array_equal(sim.step(straight(201)[200], 0.001).force, other.step(straight(201)[200], 0.001).force)

    def test_copies(self):
        sim = pushed(self.model)
        for copied in (copy.copy(sim), copy.deepcopy(sim)):
            ahead = copied.run(straight(400)[300:], 0.001)
            self.assertGreater(len(copied.tracks()[0].points), len(sim.tracks()[0].points))
            np.testing.assert_array_equal(copy.copy(sim).run(straight(400)[300:], 0.001)["force"], ahead["force"])
        scene = trocar.Scene.load(FIGURE8)
        for copied in (copy.copy(scene), copy.deepcopy(scene)):
            copied["needle.length"] = 0.123
            self.assertEqual(scene["needle.length"], 0.2)
        self.assertIs(copy.copy(self.model), self.model)
        source = brachy.Source("I-125 6711")
        self.assertIs(copy.deepcopy(source), source)
        with self.assertRaisesRegex(TypeError, "cannot be copied"):
            copy.copy(brachy.Dose(source, [0, 0, 0], 1e-3, (2, 2, 2)))

    def test_a_copied_scene_has_a_mesh_of_its_own(self):
        nodes = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
        scene = trocar.Scene()
        scene.set_mesh(trocar.Mesh(nodes, [[0, 1, 2, 3]], ["body"], surfaces=["floor"], triangles=[[0, 1, 2]], triangle_surface=[0]))
        scene["regions[body].youngs_modulus"], scene["fixed"] = 10e3, ["floor"]
        copied = copy.copy(scene)
        del scene
        gc.collect()
        np.testing.assert_array_equal(trocar.Model(copied, mesh_only=True).nodes, nodes)


class SceneTest(unittest.TestCase):
    def test_a_scene_is_asked_like_a_mapping(self):
        scene = trocar.Scene.load(IMPLANT)
        self.assertIn("needle.length", scene)
        self.assertIn("regions[prostate].youngs_modulus", scene)
        for key in ("needle.lenght", "regions[nowhere].youngs_modulus", "probe.surface", "regions[99].youngs_modulus", 5):
            self.assertNotIn(key, scene)
        keys = list(scene)
        self.assertEqual(len(set(keys)), len(keys))
        self.assertLess({"mesh", "regions[0].name", "guides[0].columns", "membranes[1].puncture_force"}, set(keys))
        again = trocar.Scene()
        for key in [k for k in keys if k.endswith(".name")] + [k for k in keys if not k.endswith(".name")]:
            if "[" in key and key.endswith(".name"):    # setting the name creates the entry
                list_, rest = key.split("[", 1)
                again[f"{list_}[{scene[key]}].name"] = scene[key]
            elif key != "device.profile" and not key.startswith("region_of_interest."):
                again[key] = scene[key] if key not in ("mesh", "cache") else str(SOURCE / "meshes" / Path(scene[key]).name)
        for key in again:
            if key not in ("mesh", "cache"):
                self.assertEqual(again[key], scene[key], key)

    def test_values_are_read_as_they_are_set(self):
        scene = trocar.Scene.load(TRUS)
        self.assertEqual(scene["fixed"], trocar.Scene.load(TRUS)["fixed"])
        self.assertIsInstance(scene["fixed"], list)
        scene["fixed"] = ["one", "2"]
        self.assertEqual(scene["fixed"], ["one", "2"])
        scene["probe.start.position"] = [0.01, -0.02, 0.125]
        self.assertEqual(scene["probe.start.position"], [0.01, -0.02, 0.125])
        self.assertEqual(trocar.Scene()["needle.start.position"], [])
        scene["device.max_stiffness"] = float("inf")
        self.assertEqual(scene["device.max_stiffness"], float("inf"))
        self.assertEqual(scene["needles"], trocar.Scene.load(TRUS)["needles"])
        self.assertIsInstance(scene["inverse"], str)

    def test_where_the_probe_begins(self):
        scene = trocar.Scene.load(TRUS)
        model = trocar.Model(scene, mesh_only=True)
        position, orientation = scene["probe.start.position"], scene["probe.start.orientation"]
        np.testing.assert_allclose(model.probe_start, [*position, *(orientation or [1, 0, 0, 0])])
        self.assertIsNone(trocar.Model(trocar.Scene.load(FIGURE8), mesh_only=True).probe_start)


class InterruptionTest(unittest.TestCase):
    """Long calls report their progress, and stop when the program asks them to."""

    @classmethod
    def setUpClass(cls):
        cls.model = trocar.Model(trocar.Scene.load(FIGURE8))
        cls.batch = np.tile(straight(2000, 0.3e-4), (200, 1, 1))    # a minute

    def interrupted(self, call):
        """Returns the time (s) after which Ctrl-C during this call raises KeyboardInterrupt."""
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
        timer.start()
        start = time.monotonic()
        try:
            with self.assertRaises(KeyboardInterrupt):
                call()
            return time.monotonic() - start - 0.3
        finally:
            timer.join()
            signal.signal(signal.SIGINT, before)

    def test_ctrl_c_ends_a_rollout(self):
        for threads in (1, 2):
            start = time.monotonic()
            trocar.rollout(self.model, self.batch[:10], threads=threads)
            whole = len(self.batch) / 10 * (time.monotonic() - start)
            self.assertLess(self.interrupted(lambda: trocar.rollout(self.model, self.batch, threads=threads)), 0.25 * whole)

    def test_ctrl_c_ends_a_run(self):
        sim = trocar.Sim(self.model)
        there_and_back = np.concatenate([self.batch[0], self.batch[0, ::-1]])
        sim.reset(there_and_back[0])
        start = time.monotonic()
        sim.run(there_and_back, 0.001)
        whole = 100 * (time.monotonic() - start)
        self.assertLess(self.interrupted(lambda: sim.run(np.tile(there_and_back, (100, 1)), 0.001)), 0.25 * whole)
        sim.reset(straight(1)[0])    # the simulation remains usable

    def test_progress_grows_to_the_end(self):
        seen = []
        outputs = trocar.rollout(self.model, self.batch[:4, :500], threads=2, progress=lambda what, fraction: seen.append((what, fraction)))
        fractions = [fraction for _, fraction in seen]
        self.assertEqual({what for what, _ in seen}, {"rollout"})
        self.assertEqual(fractions, sorted(fractions))
        self.assertEqual(fractions[-1], 1.0)
        self.assertGreaterEqual(len(fractions), 500 // 64)
        np.testing.assert_array_equal(outputs, trocar.rollout(self.model, self.batch[:4, :500]))
        seen.clear()
        trocar.Sim(self.model).run(self.batch[0, :500], 0.001, progress=lambda what, fraction: seen.append((what, fraction)))
        self.assertEqual(seen[-1], ("run", 1.0))

    def test_what_progress_raises_ends_the_call(self):
        class Enough(Exception):
            pass

        def stop(what, fraction):
            if fraction > 0.1:
                raise Enough(what)

        for threads in (1, 2):
            with self.assertRaises(Enough):
                trocar.rollout(self.model, self.batch, threads=threads, progress=stop)
        with self.assertRaises(Enough):
            trocar.Sim(self.model).run(self.batch[0], 0.001, progress=stop)

    def test_a_model_in_the_making_is_cancelled(self):
        scene = trocar.Scene.load(FIGURE8)
        scene["inverse"], scene["region_of_interest.regions"] = "condensed", ["prostate"]
        with tempfile.TemporaryDirectory() as cache:
            scene["cache"] = cache
            seen = []

            def stop(what, fraction):
                seen.append(what)
                raise RuntimeError("enough")

            with self.assertRaisesRegex(RuntimeError, "enough"):
                trocar.Model(scene, progress=stop)
            self.assertEqual(len(seen), 1)
            self.assertEqual(list(Path(cache).iterdir()), [])
            told = []
            trocar.Model(scene, progress=lambda what, fraction: told.append(fraction))
            self.assertEqual(told[-1], 1.0)


class TypeTest(unittest.TestCase):
    def test_a_program_with_types_passes_mypy(self):
        """The program uses the package as the documentation does, and a scene's values as programs typically do."""
        program = '''
import numpy as np
import trocar

scene = trocar.Scene.load("figure8.yaml")
longer: float = 2 * scene["needle.length"]
fixed: list[str] = scene["fixed"]
scene["needle.start.position"] = [0.0, 0.0, -0.2]
model = trocar.Model(scene, progress=lambda what, fraction: print(what, fraction))
sim = trocar.Sim(model)
out = sim.step([0.0, 0.0, -0.2, 1, 0, 0, 0], dt=0.001)
if out.events & trocar.Event.PUNCTURED:
    print(trocar.Event(out.events).name, longer, fixed, "key" in scene, list(scene))
outputs = trocar.rollout(model, np.zeros((1, 1, 7)), progress=lambda what, fraction: None)
print(outputs["force"], model.probe_start)
batch = trocar.Batch([model, model.derive(**{"needle.bevel_slope": 0.05})], 4, outputs=("force",))
batch.reset([0.0, 0.0, -0.2, 1, 0, 0, 0], mask=[True, False, True, False])
print(batch.step(np.zeros((4, 7)))["force"][0], batch[1].time, batch.done, scene.copy()["needle.length"])
'''
        if subprocess.run([sys.executable, "-m", "mypy", "--version"], capture_output=True).returncode:
            self.skipTest("mypy is not installed")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "program.py"
            path.write_text(program)
            done = subprocess.run([sys.executable, "-m", "mypy", "--strict", "--cache-dir", folder, path], capture_output=True, text=True,
                                  env={**os.environ, "MYPYPATH": str(BUILD / "clients/python")})
        own = [line for line in done.stdout.splitlines() if line.startswith(str(path))]
        self.assertEqual(own, [], done.stdout)
        self.assertNotIn("error", done.stderr)

    def test_all_events_of_the_library_have_names(self):
        header = (SOURCE / "core/include/trocar/sim.h").read_text()
        self.assertEqual({event.name for event in trocar.Event}, {line.split()[0].removeprefix("TROCAR_EVENT_") for line in header.splitlines()
                                                                  if line.startswith("    TROCAR_EVENT_")})


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
