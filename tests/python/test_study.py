#!/usr/bin/python3
"""Tests studies: derived models, motions equal to trocar-device's, strict reading, samples, resuming after a kill, records, frames, and the Sobol indices of a
function for which they are known.

usage: test_study.py BUILD_DIR SOURCE_DIR
"""
import contextlib
import csv
import errno
import io
import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path
from unittest import mock

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
os.environ["PYTHONPATH"] = str(BUILD / "clients/python")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True

import h5py
import numpy as np

import trocar
from trocar.studies import _definition as definition
from trocar.studies import _estimate as costs
from trocar.studies import _runs as runs
from trocar import motion
from trocar.studies import frames, sensitivity
from trocar.studies import study as studies

SCENE = SOURCE / "meshes/figure8.yaml"
MODEL = trocar.Model(trocar.Scene.load(SCENE))
STUDY = f"""scene: {os.path.relpath(SCENE, '/')}
motion: {{straight: {{depth: 0.006, speed: 0.1}}}}
samples: {{method: random, count: 12, seed: 3}}
parameters:
  regions[surrounding].friction.kinetic: {{uniform: [5, 13]}}
  motion.x: {{normal: [0, 1e-3], within: [-2e-3, 2e-3]}}
record:
  - peak_force
  - work
  - tip: {{at: [0.02, 0.06]}}
  - shift: {{region: prostate}}
"""


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name)

    def write(self, text=STUDY, **edits):
        """Returns the text of a study with some lines replaced. Relative paths refer to its folder."""
        for old, new in edits.values():
            self.assertIn(old, text)
            text = text.replace(old, new)
        text = text.replace(os.path.relpath(SCENE, "/"), os.path.relpath(SCENE, self.out))
        (self.out / "study.yaml").write_text(text)
        return self.out / "study.yaml"

    def main(self, *arguments):
        """Returns the program's (status, stdout, stderr)."""
        output, errors = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
            status = studies.main([str(argument) for argument in arguments])
        return status, output.getvalue(), errors.getvalue()

    def result(self, path, folder, *options):
        status, _, errors = self.main("run", path, "--out", self.out / folder, "--quiet", *options)
        self.assertEqual(status, 0, errors)
        return (self.out / folder / "result.csv").read_bytes()


class Derived(unittest.TestCase):
    def test_shares_the_stiffness(self):
        scene = trocar.Scene.load(SCENE)
        for key, value in (("regions[prostate].friction.kinetic", 5), ("regions[prostate].cutting_force", 0.5), ("needle.bevel_slope", 0.2),
                           ("membranes[skin].puncture_force", 0.9), ("regions[surrounding].stiffening", 0.3), ("needle.outer_diameter", 1.5e-3)):
            scene[key] = value
        base = trocar.Model(trocar.Scene.load(SCENE))
        derived = base.derive(scene)
        del base    # the base model's memory stays in use
        poses = motion.script("insert", speed=4).poses(motion.START, 1e-3)
        forces = []
        for model in (derived, trocar.Model(scene), MODEL):
            sim = trocar.Sim(model)
            sim.reset(poses[0])
            forces.append(sim.run(poses, 1e-3)["force"])
        np.testing.assert_array_equal(forces[0], forces[1])
        self.assertGreater(np.abs(forces[0] - forces[2]).max(), 0.1)

    def test_refuses_another_stiffness(self):
        for key, value in (("regions[prostate].youngs_modulus", 20e3), ("regions[surrounding].poisson_ratio", 0.4), ("membranes[skin].stiffness", 100), ("inverse", "sparse"),
                           ("volumetric_strain", "element"), ("mesh_unit", 2), ("fixed", ["skin"]), ("probe.surface", "skin")):
            scene = trocar.Scene.load(SCENE)
            try:
                scene[key] = value
            except trocar.Error as error:
                self.fail(f"{key}: {error}")
            with self.assertRaises(trocar.Error) as caught:
                MODEL.derive(scene)
            self.assertEqual(caught.exception.status, "bad input")
            self.assertRegex(str(caught.exception), f"^{re.sub(r'.*[.]', '.*', re.escape(key))}")


class Motions(Case):
    def test_scripts_are_those_of_the_device(self):
        source = (SOURCE / "clients/shared/motion.c").read_text()
        table = source[source.index("scripts[] = {"):source.index("};")].replace("3.141592653589793", repr(np.pi))
        found = dict(re.findall(r'\{"(\w+)", "[^"]*", (.*?)(?=\n    \{"|\Z)', table, re.DOTALL))
        self.assertEqual(found.keys(), motion.SCRIPTS.keys())
        for name, (seconds, legs) in motion.SCRIPTS.items():
            numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", found[name])]
            self.assertEqual(numbers[0], seconds, name)
            ours = [number for leg in legs for number in (leg.start, leg.end, *leg.shift, *leg.turn)]
            self.assertEqual(numbers[3:], ours or [0.0] * 8, name)

    def test_a_script_starts_where_the_patient_is_told_and_goes_as_deep_as_the_scene_says(self):
        text = SCENE.read_text().replace("mesh: ", f"mesh: {SCENE.resolve().parent}/")
        text = text.replace("needle:", "needle:\n  start: {position: [0, 0, -0.201], orientation: [0.8, 0.6, 0, 0], depth: 0.12}", 1)
        (self.out / "scene.yaml").write_text(text + "\npatient_to_mesh: [-1e-3, 0, 0, 0.05, 0, -1e-3, 0, 0.02, 0, 0, 1e-3, -0.3, 0, 0, 0, 1]\n")
        chosen = {"scene": (os.path.relpath(SCENE, "/"), "scene.yaml")}
        straight = "{straight: {depth: 0.006, speed: 0.1}}"
        study = definition.read(self.write(motion=(straight, "{script: insert, start: [20, 30, 130], coordinates: patient}"), **chosen))
        poses = study.motion.poses(study.motion.start, 0.01)
        np.testing.assert_allclose(poses[0], [0.03, -0.01, -0.17, 0.8, 0.6, 0, 0], atol=1e-12)
        way = (poses[:, :3] - poses[0, :3]) @ [0, -0.96, 0.28]     # the quaternion (0.8, 0.6, 0, 0) rotates z to this direction
        self.assertAlmostEqual(way.max(), 0.12, places=9)
        self.assertAlmostEqual(study.motion.duration(), 3.0 * 0.12 / 0.066, places=9)
        for wrong, word in (("{script: insert, coordinates: patient}", "allowed only with start"), ("{script: insert, start: [1, 2, 3, 1, 0, 0, 0], coordinates: patient}", "three numbers"),
                            ("{script: insert, start: [1, 2, 3], coordinates: feet}", "mesh .m. or patient")):
            with self.assertRaisesRegex(definition.BadStudy, word):
                definition.read(self.write(motion=(straight, wrong), **chosen))

    def test_the_scenes_depth_is_the_scripts(self):
        self.assertEqual(float(trocar.Scene.load(SCENE)["needle.start.depth"]), motion.DEPTH)
        self.assertNotIn("depth:", SCENE.read_text())

    def test_depth_of_a_script_varies(self):
        study = definition.read(self.write(motion=("{straight: {depth: 0.006, speed: 0.1}}", "{script: insert}"),
                                           parameter=("motion.x: {normal: [0, 1e-3], within: [-2e-3, 2e-3]}", "motion.depth: {values: [0.03, 0.132]}")))
        self.assertEqual(study.parameter_columns()[1], "motion.depth [m]")
        usual = motion.script("insert")
        for depth in (0.03, 0.132):
            deep = study.run_motion(np.array([8.0, depth]))
            poses = deep.poses(motion.START, 1e-3)
            self.assertAlmostEqual((poses[:, 2] - motion.START[2]).max(), depth, places=9)
            self.assertAlmostEqual(deep.duration(), usual.duration() * depth / 0.066, places=9)
            self.assertAlmostEqual(np.diff(poses[:, 2]).max(), np.diff(usual.poses(motion.START, 1e-3)[:, 2]).max(), delta=1e-8)    # as fast

    def test_a_target_in_the_patient_is_the_same_in_the_mesh(self):
        text = SCENE.read_text().replace("mesh: ", f"mesh: {SCENE.resolve().parent}/")
        (self.out / "scene.yaml").write_text(text + "\npatient_to_mesh: [0, -1e-3, 0, 0.25, 1e-3, 0, 0, -0.125, 0, 0, 1e-3, 0.5, 0, 0, 0, 1]\n")
        options = []
        for target in ("[0.005, 0.003, 0.04]", "[128, 245, -460], coordinates: patient", "[0.005, 0.003, 0.04], coordinates: mesh"):
            study = definition.read(self.write(scene=(os.path.relpath(SCENE, "/"), "scene.yaml"), record=("shift: {region: prostate}", f"target_error: {{target: {target}}}")))
            options.append(study.measures[-1].option)
        np.testing.assert_allclose(options, [[0.005, 0.003, 0.04]] * 3, atol=1e-12)
        with self.assertRaisesRegex(definition.BadStudy, "not in the tissue at rest: .*mm in the patient"):
            definition.read(self.write(scene=(os.path.relpath(SCENE, "/"), "scene.yaml"),
                                       record=("shift: {region: prostate}", "target_error: {target: [0.005, 0.003, 0.04], coordinates: patient}")))

    def test_a_run_is_what_replay_computes(self):
        subprocess.run([BUILD / "clients/trocar-device", "--script", "roll", "--speed=4", "--write-log", self.out / "poses.log"], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([BUILD / "clients/trocar-replay", "-q", "--scene", SCENE, "--poses", self.out / "poses.log", "--csv", self.out / "replay.csv"], check=True)
        with open(self.out / "replay.csv", newline="") as file:
            rows = list(csv.reader(file))
        theirs = np.array([[float(cell) for cell in row[1:4]] for row in rows[1:]])
        sim = trocar.Sim(MODEL)
        poses = next(motion.script("roll", speed=4).play(sim, 1e-3))
        ours = sim.run(poses, 1e-3)["force"]
        self.assertEqual(len(ours), len(theirs))
        np.testing.assert_allclose(ours, theirs, atol=1e-4 * np.abs(theirs).max())

    def test_adjustment(self):
        poses = motion.Straight(depth=0.01, speed=0.1).poses(motion.START, 1e-3)
        moved = motion.Adjustment(x=1e-3, tilt_y=0.1, roll=0.5).apply(poses, 0.2)
        tip = lambda all_poses: all_poses[:, :3] + 0.2 * motion.axis_of(all_poses)
        np.testing.assert_allclose(tip(moved)[0], tip(poses)[0] + [1e-3, 0, 0], atol=1e-12)    # the needle has been tilted about its tip
        np.testing.assert_allclose(motion.axis_of(moved)[0], [np.sin(0.1), 0, np.cos(0.1)], atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(tip(moved)[-1] - tip(moved)[0]), 0.01, atol=1e-12)

    def test_table(self):
        path = self.out / "poses.csv"
        path.write_text("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0.01,0,0,0.001,-1,0,0,0\n")
        np.testing.assert_allclose(motion.Table.read(path).poses(motion.START, 1e-3)[5], [0, 0, 0.0005, 1, 0, 0, 0], atol=1e-12)
        for text, words in (("t,x\n", ":1: write the columns"), ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0\n", ":2: write eight numbers"),
                            ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0,0,0,0,1,0,0,0\n", ":3: .*sort"), ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,2,0,0,0\n", ":2: .*length 2")):
            path.write_text(text)
            with self.assertRaisesRegex(motion.BadMotion, words):
                motion.Table.read(path)


class Reading(Case):
    def test_what_is_wrong_is_told_with_its_line(self):
        kinetic, at = "regions[surrounding].friction.kinetic", "{at: [0.02, 0.06]}"
        for old, new, words in (
                ("motion:", "movement:", r':2: unknown key "movement": there are scene, motion'),
                ("scene: ", "scene: no-", r":1: scene: no file"),
                ("method: random", "method: halton", r':3: samples.method: "halton": there are sobol'),
                ("method: random", "method: sobol", r":3: samples.count: 12 is not a power of 2.*write 8 or 16"),
                ("count: 12, ", "", r':3: samples: missing key "count"'),
                (f"{kinetic}: {{uniform: [5, 13]}}", "needle.start.depth: {uniform: [0.05, 0.07]}", r":5: .*needle.start.depth: the motion's start and depth .*vary motion.x, "),
                ("shift: {region: prostate}", "target_error: {target: [0, 0, 0.04], coordinates: patient}", r":11: .*target_error.coordinates: .*the scene has no patient_to_mesh"),
                ("shift: {region: prostate}", "target_error: {target: [0, 0, 0.04], coordinates: feet}", r":11: .*write mesh .m. or patient"),
                ("{region: prostate}", "{region: prostate, coordinates: patient}", r':11: .*unknown key "coordinates"'),
                (kinetic, "regions[surounding].friction.kinetic", r":5: parameters.*surounding"),
                ("[5, 13]", "[13, 5]", r":5: .*uniform: 5 is not above 13"),
                ("[5, 13]", "[-5, 13]", r":5: .*friction.kinetic"),
                ("[5, 13]", "[5]", r":5: .*1 numbers: write 2"),
                ("uniform: [5, 13]", "even: [5, 13]", r':5: .*unknown key "even"'),
                ("motion.x", "motion.w", r':6: .*no "w": there are motion.x'),
                ("normal: [0, 1e-3]", "normal: [0, 0]", r":6: .*deviation 0"),
                (f"{kinetic}: {{uniform: [5, 13]}}", "needle.segments: {uniform: [10, 20]}", r":5: .*takes a whole number from 2 to 64: write values"),
                (f"{kinetic}: {{uniform: [5, 13]}}", "needle.segments: {values: [10, 12.5, 20]}", r":5: .*takes a whole number from 2 to 64"),
                ("speed: 0.1", "speed: 0.1, hold: -1", r':2: motion.straight.hold: "-1": write a number of 0 or above'),
                ("- work", "- effort", r':9: record\[1\]: no quantity "effort"'),
                ("- work", "- peak_force", r':8: record: "peak_force \[N\]" is given twice'),
                (at, "{at: 7}", r":10: record\[2\].tip.at: 7 s is after the motion's end, 0.06 s"),
                ("{region: prostate}", "{region: kidney}", r':11: .*no region "kidney": the scene has prostate, surrounding'),
                ("shift: {region: prostate}", "shift", r':11: record\[3\].shift: missing key "region"'),
                ("shift: {region: prostate}", "target_error: {target: [1, 1, 1]}", r":11: .*not in the tissue"),
                ("- work", "- seed_error", r":9: .*only where the motion is a plan"),
                ("depth: 0.006, ", "", r':2: motion.straight: missing key "depth"'),
                ("motion: {", "motion: {script: insert, ", r":2: motion: write one of"),
                ("record:", "set: {needle.lenght: 1}\nrecord:", r":7: set.needle.lenght: .*lenght"),
                ("- peak_force", "- [", r":\d+: not YAML")):
            status, _, errors = self.main("run", self.write(edit=(old, new)), "--out", self.out / "o")
            self.assertEqual(status, 2, (new, errors))
            self.assertRegex(errors, r"study\.yaml" + words)
        self.assertFalse((self.out / "o").exists())

    def test_samples(self):
        study = studies.read(self.write())
        samples = study.samples()
        np.testing.assert_array_equal(samples, study.samples())
        self.assertTrue((samples[:, 0] > 5).all() and (samples[:, 0] < 13).all() and (np.abs(samples[:, 1]) < 2e-3).all())
        longer = studies.read(self.write(edit=("count: 12", "count: 400"))).samples()
        np.testing.assert_array_equal(samples, longer[:12])
        self.assertAlmostEqual(longer[:, 1].std(), 0.88e-3, delta=0.08e-3)    # standard deviation of a normal distribution truncated at two standard deviations
        tail = studies.read(self.write(edit=("within: [-2e-3, 2e-3]", "within: [9e-3, 10e-3]"))).samples()[:, 1]
        self.assertTrue((9e-3 <= tail).all() and (tail <= 10e-3).all() and len(set(tail)) == 12)
        self.assertLess(tail.mean(), 9.3e-3)    # beyond 9 standard deviations, values exceed that limit by 0.11 standard deviations on average
        grid = studies.read(self.write(a=("method: random, count: 12, seed: 3", "method: grid"), b=("uniform: [5, 13]", "uniform: [5, 13], steps: 3"),
                                       c=("normal: [0, 1e-3], within: [-2e-3, 2e-3]", "values: [0, 1e-3]")))
        np.testing.assert_allclose(grid.samples(), [[5, 0], [5, 1e-3], [9, 0], [9, 1e-3], [13, 0], [13, 1e-3]])


class Sensitivity(unittest.TestCase):
    FIRST, TOTAL = np.array([0.3139, 0.4424, 0.0]), np.array([0.5576, 0.4424, 0.2437])    # Sobol indices of the Ishigami function with a = 7, b = 0.1

    def ishigami(self, count, seed, resamples):
        x = np.pi * (2.0 * sensitivity.design(3, count, seed) - 1.0)
        return sensitivity.indices(np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]), 3, resamples)

    def test_ishigami(self):
        """The Sobol indices are correct to within 2 %, whatever the seed."""
        for seed in range(8):
            found = self.ishigami(8192, seed, resamples=2)
            np.testing.assert_allclose(found.first[:2], self.FIRST[:2], rtol=0.02)
            self.assertLess(abs(found.first[2]), 0.005)    # exactly 0
            np.testing.assert_allclose(found.total, self.TOTAL, rtol=0.02)

    def test_intervals(self):
        found = self.ishigami(4096, 1, resamples=100)
        for interval, exact in ((found.first_interval, self.FIRST), (found.total_interval, self.TOTAL)):
            self.assertTrue((interval[:, 0] <= exact + 0.005).all() and (exact - 0.005 <= interval[:, 1]).all())

    def test_values_that_are_nearly_constant(self):
        """The indices are undefined for bootstrap samples without any of the points at which the function departs from its constant value. If there is one such
        point, that is 36 % of the samples; if there are four, 2 %."""
        for points, has_interval in ((1, False), (4, True)):
            values = np.zeros((64, 3))
            values[:points] = [[1, 2, 3]]
            found = sensitivity.indices(values, 1)
            self.assertTrue(np.isfinite(found.total).all())
            self.assertEqual(np.isfinite([found.first_interval, found.total_interval]).all(), has_interval)


class Running(Case):
    def test_tasks_and_a_kill_change_nothing(self):
        path = self.write()
        whole = self.result(path, "whole", "--workers", "2")
        for task in ("1/3", "2/3", "3/3"):    # the tasks run one after another, with the arguments GNU parallel would pass
            self.assertEqual(self.main("run", path, "--out", self.out / "parts", "--task", task, "--workers", "1", "--quiet")[0], 0)
        self.assertEqual(self.main("collect", path, "--out", self.out / "parts")[0], 0)
        self.assertEqual((self.out / "parts/result.csv").read_bytes(), whole)

        killed = self.out / "killed/rows-1-of-1.csv"
        process = subprocess.Popen([sys.executable, "-m", "trocar.studies.study", "run", path, "--out", self.out / "killed", "--workers", "1", "--quiet"])
        limit = time.monotonic() + 60
        while not (killed.exists() and killed.read_bytes().count(b"\n") >= 3) and time.monotonic() < limit and process.poll() is None:
            time.sleep(0.002)
        process.send_signal(signal.SIGKILL)
        process.wait()
        before = killed.read_bytes().splitlines()
        self.assertIn(len(before), range(3, 13), "it was over before it was killed")
        status, _, errors = self.main("collect", path, "--out", self.out / "killed")
        self.assertEqual(status, 1)
        self.assertRegex(errors, f"{len(before) - 1} of 12 runs are done")
        with open(killed, "a") as file:
            file.write("11,ok,7.5")
        status, _, errors = self.main("run", path, "--out", self.out / "killed")
        self.assertEqual(status, 0, errors)
        self.assertRegex(errors, "incomplete last line.*\n.*%d of 12" % (len(before) - 1))
        self.assertEqual((self.out / "killed/result.csv").read_bytes(), whole)
        rows = killed.read_bytes().splitlines()
        self.assertEqual(rows[:len(before)], before)    # no run is repeated
        self.assertEqual(len(rows), 13)

        busy = studies.carry_out.__globals__["TaskFile"](killed, studies.read(path), studies.read(path).samples())
        self.addCleanup(busy.close)
        other = subprocess.run([sys.executable, "-m", "trocar.studies.study", "run", path, "--out", self.out / "killed"], capture_output=True, text=True)
        self.assertEqual(other.returncode, 2)
        self.assertIn("another process is working on this task", other.stderr)

    def test_results_of_another_study_are_left_alone(self):
        path = self.write(edit=("count: 12", "count: 2"))
        before = self.result(path, "o")
        path = self.write(edit=("[5, 13]", "[5, 14]"))
        status, _, errors = self.main("run", path, "--out", self.out / "o")
        self.assertEqual(status, 2)
        self.assertRegex(errors, r'"parameter regions\[surrounding\].friction.kinetic" differs: choose another folder')
        self.assertEqual((self.out / "o/result.csv").read_bytes(), before)

    def test_rows_that_cannot_be_used(self):
        path = self.write(edit=("count: 12", "count: 2"))
        study = studies.read(path)
        samples, file = study.samples(), self.out / "rows-1-of-1.csv"
        heading = runs.checked(runs.line_of(runs.heading(study)))
        row = runs.line_of(runs.cells_of(runs.Row(1, "ok", tuple(samples[1].tolist()), (1.0,) * len(study.result_columns()))))
        good = (heading + runs.checked(row)).decode()
        with mock.patch.object(os, "pread", lambda file, size, offset, read=os.pread: read(file, min(size, 7), offset)):    # in pieces
            task = runs.TaskFile(file, study, samples)
            task.close()
            file.write_text(good)
            task = runs.TaskFile(file, study, samples)
            task.close()
        self.assertEqual(([row.index for row in task.rows], file.read_text()), ([1], good))
        descriptors = len(os.listdir("/proc/self/fd"))
        for text, words in ((heading + runs.checked(row.replace("ok", "k" * 200_000)), "2: damaged or changed"), (good.encode().replace(b"ok", b"\xff"), "2: damaged or changed"),
                            (heading + runs.checked("0" + row[1:]), "2: run 0 has other parameters"), (b"run\n", "1: rows of another study")):
            file.write_bytes(text)
            with self.assertRaisesRegex(studies.BadStudy, f"csv:{words}.*: "):
                runs.TaskFile(file, study, samples)
            self.assertEqual(file.read_bytes(), text)
        with mock.patch.object(runs.fcntl, "lockf", side_effect=OSError(errno.ENOLCK, "No locks available")):
            with self.assertRaisesRegex(studies.BadStudy, "cannot be locked: No locks available"):
                runs.TaskFile(file, study, samples)
        self.assertEqual(len(os.listdir("/proc/self/fd")), descriptors)
        runs.check_manifest(study, self.out)
        with mock.patch.object(definition, "__version__", "0.0"):
            with self.assertRaisesRegex(studies.BadStudy, r'"version" differs \(trocar \d.*, scipy .* there, trocar 0.0, scipy .* now\): choose'):
                runs.check_manifest(study, self.out)

    def test_a_fifo_does_not_wait_for_its_writer(self):
        path = self.write()
        self.result(path, "study")
        for name in ("study.json", "rows-1-of-1.csv", "rows-1-of-2.csv"):
            there = self.out / "study" / name
            before = there.read_bytes() if there.exists() else None
            there.unlink(missing_ok=True)
            os.mkfifo(there)
            for command in ("run", "collect", "summary"):
                done = subprocess.run([sys.executable, "-m", "trocar.studies.study", command, path, "--out", self.out / "study"], capture_output=True, text=True, timeout=60)
                self.assertEqual((done.returncode, done.stderr), (3, f"trocar-study: {there}: not a regular file\n"), (name, command))
            there.unlink()
            if before is not None:
                there.write_bytes(before)

    def test_any_change_of_a_row_is_noticed(self):
        """Changes each character of a row, one at a time."""
        path = self.write(edit=("count: 12", "count: 2"))
        whole, file = self.result(path, "o"), self.out / "o/rows-1-of-1.csv"
        text = file.read_bytes()
        begin = text.index(b"\n") + 1
        for at in range(begin, text.index(b"\n", begin)):
            for new in (b"0", b"7", b",", b"."):
                if text[at:at + 1] == new:
                    continue
                file.write_bytes(text[:at] + new + text[at + 1:])
                with self.assertRaisesRegex(studies.BadStudy, "rows-1-of-1.csv:2: damaged or changed since it was written.*remove the line"):
                    runs.read_rows(file, studies.read(path), studies.read(path).samples())
        status, _, errors = self.main("run", path, "--out", self.out / "o", "--quiet")
        self.assertEqual(status, 2, errors)
        file.write_bytes(text[:begin] + text[text.index(b"\n", begin) + 1:])
        self.assertEqual(self.result(path, "o"), whole)

    def test_a_random_study_grows(self):
        """Finished runs are kept. The result equals that of the larger study run at once. A smaller study leaves runs out."""
        stiffness = ("regions[surrounding].friction.kinetic: {uniform: [5, 13]}", "regions[surrounding].youngs_modulus: {values: [20e3, 30e3]}")
        for kind, edit in (("motion", ("count: 12", "count: 12")), ("stiffness", stiffness)):
            small, large, smaller = ({"a": edit, "b": ("count: 12", f"count: {count}")} for count in (4, 11, 3))
            before = self.result(self.write(**small), kind)
            rows = (self.out / kind / "rows-1-of-1.csv").read_bytes()
            grown = self.result(self.write(**large), kind)
            self.assertTrue((self.out / kind / "rows-1-of-1.csv").read_bytes().startswith(rows))
            self.assertTrue(grown.startswith(before))
            self.assertEqual(grown, self.result(self.write(**large), f"{kind} at once"))
            self.assertEqual(self.result(self.write(**smaller), kind), b"".join(before.splitlines(keepends=True)[:4]))
            self.assertEqual(self.main("collect", self.write(**large), "--out", self.out / kind)[0], 0)
        for edit in ((("method: random", "method: latin hypercube"),), (("seed: 3", "seed: 4"),)):
            status, _, errors = self.main("run", self.write(**dict(zip("a", edit))), "--out", self.out / "motion")
            self.assertEqual(status, 2)
            self.assertRegex(errors, '"samples" differs')

    def test_a_comment_changes_no_study(self):
        scene, plan = self.out / "scene.yaml", self.out / "plan.yaml"
        scene.write_text(SCENE.read_text().replace("mesh: ", f"mesh: {SCENE.parent}/"))
        path = self.write(a=(os.path.relpath(SCENE, "/"), "scene.yaml"), b=("count: 12", "count: 2"))
        whole, rows = self.result(path, "o"), (self.out / "o/rows-1-of-1.csv").read_bytes()
        said = scene.read_text()
        for text in (said + "# measured by somebody\n", "\n# first\n" + said.replace("60e3", "60000.0"), said + "device: {max_force: 3}\n"):
            scene.write_text(text)
            self.assertEqual((self.result(path, "o"), (self.out / "o/rows-1-of-1.csv").read_bytes()), (whole, rows))
        scene.write_text(said.replace("60e3", "60001"))
        status, _, errors = self.main("run", path, "--out", self.out / "o")
        self.assertEqual(status, 2)
        self.assertRegex(errors, '"scene" differs')
        example = SOURCE / "docs/examples/implant-plan.yaml"
        study = STUDY.replace("straight: {depth: 0.006, speed: 0.1}", "plan: plan.yaml").replace(os.path.relpath(SCENE, "/"), str(SOURCE / "meshes/implant.yaml"))
        study = study.replace("tip: {at: [0.02, 0.06]}", "seed_error").replace("  motion.x: {normal: [0, 1e-3], within: [-2e-3, 2e-3]}\n", "").replace("surrounding", "muscle")
        study = study.replace("shift: {region: prostate}", "work").replace("  - work\n", "", 1)
        (self.out / "of plan.yaml").write_text(study)
        manifests = []
        for text in (example.read_text(), "# a comment\n" + example.read_text()):
            plan.write_text(text)
            manifests.append(studies.read(self.out / "of plan.yaml").manifest())
        self.assertEqual(*manifests)

    def test_each_run_with_a_stiffness_of_its_own(self):
        """Runs the test several times with the sparse inverse, and once with the dense one."""
        path = self.write(a=("count: 12", "count: 3"), b=("regions[surrounding].friction.kinetic: {uniform: [5, 13]}", "regions[surrounding].youngs_modulus: {uniform: [20e3, 40e3]}"))
        whole = self.result(path, "o", "--hdf5")
        for task in ("1/2", "2/2"):
            self.assertEqual(self.main("run", path, "--out", self.out / "p", "--task", task, "--workers", "1", "--quiet")[0], 0)
        self.assertEqual(self.main("collect", path, "--out", self.out / "p")[0], 0)
        self.assertEqual(whole, (self.out / "p/result.csv").read_bytes())
        study = studies.read(path)
        for row in studies.results(study, self.out / "o"):
            scene = trocar.Scene.load(SCENE)
            scene["regions[surrounding].youngs_modulus"] = row.parameters[0]
            model = trocar.Model(scene)
            self.assertEqual(model.inverse, "dense")
            sim = trocar.Sim(model)
            poses = motion.Straight(depth=0.006, speed=0.1).poses(motion.START + [row.parameters[1], 0, 0, 0, 0, 0, 0], 1e-3)
            sim.reset(poses[0])
            peak = -sim.run(poses, 1e-3)["force"][:, 2].min()
            np.testing.assert_allclose(row.results[0], peak, rtol=1e-6)
            np.testing.assert_allclose(row.results[5:8], sim.centreline()[-1], atol=1e-9)
        with h5py.File(self.out / "o/result.h5") as file:
            np.testing.assert_array_equal(file["results"], [row.results for row in studies.results(study, self.out / "o")])

    def test_membranes_belong_to_the_stiffness(self):
        friction = "regions[surrounding].friction.kinetic: {uniform: [5, 13]}"
        for key, columns in (("regions[surrounding].friction.kinetic", []), ("membranes[skin].puncture_force", []), ("membranes[skin].stiffness", [0])):
            path = self.write(a=("count: 12", "count: 2"), b=(friction, f"{key}: {{uniform: [5, 13]}}"))
            self.assertEqual(studies.read(path).stiffness_columns(), columns)
        self.assertEqual(self.main("run", path, "--out", self.out / "o", "--quiet")[0], 0)
        self.assertEqual([row.status for row in studies.results(studies.read(path), self.out / "o")], ["ok", "ok"])

    def test_a_run_that_fails_is_a_row(self):
        path = self.write(a=("count: 12", "count: 4"), b=("regions[surrounding].friction.kinetic: {uniform: [5, 13]}", "needle.inner_diameter: {values: [0.8e-3, 2e-3]}"))
        status, _, errors = self.main("run", path, "--out", self.out / "o", "--quiet")
        self.assertEqual(status, 1)
        self.assertRegex(errors, r"\d of 4 runs failed.*inner_diameter")
        rows = studies.results(studies.read(path), self.out / "o")
        for row in rows:
            self.assertEqual(row.status == "ok", row.parameters[0] < 1e-3)
            self.assertEqual(np.isfinite(row.results).all(), row.parameters[0] < 1e-3)

    def test_a_task_needs_few_stiffnesses(self):
        groups = runs.Groups(np.arange(64) % 4, False)
        tasks = [runs.runs_of_task(groups, (i, 5)) for i in range(1, 6)]
        self.assertEqual(sorted(sum(tasks, [])), list(range(64)))
        for task in tasks:
            self.assertIn(len(task), (12, 13))
            self.assertLessEqual(len({int(groups.of_run[index]) for index in task}), 2)

    def test_a_run_that_fails_gives_no_base(self):
        """In the first two runs, the inner diameter exceeds the outer one. The third run's model is reused for the remaining runs."""
        path = self.write(a=("random, count: 12, seed: 3", "grid"), b=("normal: [0, 1e-3], within: [-2e-3, 2e-3]", "values: [0, 1e-3]"),
                          c=("regions[surrounding].friction.kinetic: {uniform: [5, 13]}", "needle.inner_diameter: {values: [2e-3, 0.8e-3]}"))
        with mock.patch.object(runs, "Model", wraps=trocar.Model) as made:    # counts the models created in this process
            outcome = studies.carry_out(studies.read(path), self.out / "o", (1, 1), 1, lambda *_: None, self.fail)
        self.assertEqual((made.call_count, outcome.done, outcome.failed), (3, 4, 2))

    def test_a_run_without_memory_is_repeated(self):
        study = studies.read(self.write(edit=("count: 12", "count: 2")))
        with mock.patch.object(runs, "run", side_effect=trocar.Error("no memory", "no memory")):
            outcome = studies.carry_out(study, self.out / "o", (1, 1), 1, lambda *_: None, self.fail)
        self.assertEqual((outcome.done, len(outcome.lost)), (0, 2))
        self.assertEqual(studies.results(study, self.out / "o"), [])

    def test_plan(self):
        (self.out / "one.yaml").write_text(re.sub(r"(?ms)^(  - .*?\n)(  - .*)", r"\1", (SOURCE / "docs/examples/implant-plan.yaml").read_text()))
        path = self.write(a=("motion: {straight: {depth: 0.006, speed: 0.1}}", "motion: {plan: one.yaml, speed: 0.4}"), b=("count: 12", "count: 1"),
                          c=(os.path.relpath(SCENE, "/"), os.path.relpath(SOURCE / "meshes/implant.yaml", self.out)),
                          d=("regions[surrounding].friction.kinetic: {uniform: [5, 13]}\n  motion.x: {normal: [0, 1e-3], within: [-2e-3, 2e-3]}", "motion.roll: {uniform: [0, 3]}"),
                          e=("  - tip: {at: [0.02, 0.06]}\n", "  - seed_error\n"))
        study = studies.read(path)
        (self.out / "one.yaml").unlink()    # the study has already read the plan and does not read it again
        found = studies.simulate(study, 0)
        mean, worst = found["seed_error.mean [m]"], found["seed_error.worst [m]"]
        self.assertTrue(1e-4 < mean <= worst < 0.02, (mean, worst))

    def test_files_that_change_during_a_study(self):
        scene = self.out / "scene.yaml"
        scene.write_text(SCENE.read_text().replace("mesh: ", f"mesh: {SCENE.parent}/"))
        study = studies.read(self.write(edit=(os.path.relpath(SCENE, "/"), "scene.yaml")))
        before, manifest = studies.simulate(study, 0), study.manifest()
        scene.write_text(scene.read_text() + "rate_hz: 500\n")
        self.assertEqual((studies.simulate(study, 0), study.manifest()), (before, manifest))

    def test_summary(self):
        path = self.write(a=("random, count: 12", "saltelli, count: 4"), b=("  - tip: {at: [0.02, 0.06]}\n", ""))
        self.result(path, "o")
        status, text, errors = self.main("summary", path, "--out", self.out / "o")
        self.assertEqual(status, 0, errors)
        self.assertRegex(text, r"\| peak_force \[N\] \| 16 \| [\d.]+")
        self.assertRegex(text, r"\| work \[J\] \| motion.x \| -?\d\.\d{3} \(-?\d\.\d{3} to -?\d\.\d{3}\) \| \d\.\d{3}")
        for name in ("results.svg", "sensitivity.svg"):
            self.assertIn("</svg>", (self.out / "o" / name).read_text())


class Slurm(Case):
    def test_environment_of_a_job(self):
        given = studies._options().parse_args(["run", "study.yaml", "--engine", "slurm"])
        with mock.patch.dict(os.environ, PYTHONPATH=f":{self.out}::/usr", TROCAR_LIBRARY="libtrocar.so.1"):
            script = studies._batch_script(given, self.out)
        self.assertIn(f"export PYTHONPATH={self.out.resolve()}:/usr\nexport TROCAR_LIBRARY=libtrocar.so.1\n", script)
        with mock.patch.dict(os.environ, TROCAR_LIBRARY="./a:b.so"):
            self.assertIn(f"export TROCAR_LIBRARY={Path('a:b.so').resolve()}\n", studies._batch_script(given, self.out))


def opened_by(insertions):
    """Runs in a worker process. Returns the id of the process that opened the file it reads, its own process id, and the last insertion."""
    found = insertions[len(insertions) - 1]["force"]
    return insertions.opened[0], os.getpid(), found


class Estimates(Case):
    def test_the_estimate_is_what_runs_cost(self):
        """Compares the predicted CPU time with that of other runs, and the predicted sizes with those of the files."""
        path = self.write(edit=("count: 12", "count: 40"), safe=("[5, 13]", "[5, 11]"))
        cost = costs.estimate(studies.read(path, True))
        self.assertEqual((cost.runs, cost.pilots, cost.models), (40, 3, 1))
        self.assertAlmostEqual(cost.duration, 0.06)
        self.assertFalse((self.out / "o").exists())
        before = sum(os.times()[:4])
        self.result(path, "o", "--record", "frames", "--workers", "1")
        spent = sum(os.times()[:4]) - before    # CPU time of this process and its children
        self.assertTrue(0.5 < cost.seconds / spent < 1.5, (cost, spent))
        sizes = [file.stat().st_size for file in (self.out / "o/frames").glob("*.h5")]
        self.assertEqual(len(sizes), 40)
        self.assertTrue(abs(cost.frames / sum(sizes) - 1) < 0.1, (cost.frames, sum(sizes)))
        self.assertTrue(abs(cost.table / (self.out / "o/result.csv").stat().st_size - 1) < 0.05)

    def test_runs_with_models_of_their_own(self):
        cost = costs.estimate(studies.read(self.write(edit=("friction.kinetic: {uniform: [5, 13]}", "youngs_modulus: {uniform: [2e4, 4e4]}"))))
        self.assertEqual((cost.models, cost.frames), (0, 0))

    def test_the_program_says_it(self):
        status, output, _ = self.main("estimate", self.write(edit=("count: 12", "count: 100000")), "--out", self.out / "o", "--workers", "200", "--record", "frames")
        self.assertEqual(status, 0)
        self.assertRegex(output, r"runs +100000, of 0\.06 s")
        self.assertRegex(output, r"the study +[\d.]+ core-hours: \d+ (s|min) with 200 workers")
        self.assertRegex(output, r"frames [\d.]+ GB")
        self.assertEqual(os.listdir(self.out), ["study.yaml"])

    def test_a_study_whose_runs_fail_is_refused(self):
        path = self.write(edit=("regions[surrounding].friction.kinetic: {uniform: [5, 13]}", "needle.inner_diameter: {uniform: [2e-3, 3e-3]}"))
        status, _, errors = self.main("estimate", path, "--out", self.out / "o")
        self.assertEqual(status, 2)
        self.assertRegex(errors, "the runs tried all fail.*inner_diameter")


class Labels(Case):
    def test_other_programs_understand_the_files(self):
        text = STUDY + "# " + 100000 * "x" + "\n"     # longer than a compact attribute of HDF5
        path = self.write(text, edit=("count: 12", "count: 3"))
        self.result(path, "o", "--record", "frames", "--hdf5")
        for name in ("result", "frames"):
            with h5py.File(self.out / f"o/{name}.h5") as file:
                self.assertEqual(file.attrs["study"], path.read_text())
                self.assertEqual(file.attrs["source"], f"trocar {trocar.__version__}")
                for data in file.values():
                    if not h5py.h5ds.is_scale(data.id):
                        self.assertTrue(all(len(axis) == 1 for axis in data.dims), data.name)
                self.assertEqual([axis[0].name for axis in file["parameters"].dims], ["/run", "/parameter"])
                self.assertEqual(file["parameter_unit"].asstr()[:].tolist(), ["N/m", "m"])
        with h5py.File(self.out / "o/result.h5") as file:
            self.assertEqual(file["result"].asstr()[:].tolist()[:3], ["peak_force", "work", "tip.x@0.02"])
            self.assertEqual(file["result_unit"].asstr()[:].tolist()[:3], ["N", "J", "m"])

    def test_xarray_reads_them(self):
        try:
            import h5netcdf
            import xarray
        except ImportError:
            self.skipTest("install python3-xarray and python3-h5netcdf")
        path = self.write(edit=("count: 12", "count: 3"))
        self.result(path, "o", "--record", "frames", "--hdf5")
        rows = studies.results(studies.read(path), self.out / "o")
        with xarray.open_dataset(self.out / "o/result.h5", engine="h5netcdf") as table, xarray.open_dataset(self.out / "o/frames.h5", engine="h5netcdf") as film:
            np.testing.assert_array_equal(table.results.sel(result="work"), [row.results[1] for row in rows])
            self.assertEqual(dict(film.sizes), {"run": 3, "time": 4, "axis": 3, "pose_part": 7, "node": len(MODEL.nodes), "tet": len(MODEL.tets), "corner": 4,
                                                "joint": film.centreline.shape[2], "contact": film.contact_kind.shape[2], "parameter": 2})
            self.assertEqual(film.force.sel(run=1, axis="z").dims, ("time",))
            self.assertEqual((film.force.attrs["units"], film.time.attrs["units"]), ("N", "s"))
            with h5py.File(self.out / "o/frames.h5") as file:
                np.testing.assert_array_equal(film.force.sel(run=2, axis="z").values, file["force"][2, :, 2])


class Frames(Case):
    def test_the_size_is_said_before_it_starts(self):
        """Compares the predicted size with the file of a run with a longer motion. Also tests the prediction for a study that is too large to run."""
        longer = ("straight: {depth: 0.006, speed: 0.1}", "script: insert")
        study = studies.read(self.write(edit=longer, more=("count: 12", "count: 1")), True)
        said = []
        runs.carry_out(study, self.out / "o", (1, 1), 1, lambda done, of: None, said.append)
        size = re.fullmatch(r"frames: about ([\d.]+) MB for 1 runs \(151 frames of 572 nodes each\), and as much again once they are collected in frames.h5; "
                            rf"[\d.]+ [MG]B are free in {self.out}/o", said[0])
        self.assertTrue(size, said)
        written = (self.out / "o/frames/0000000.h5").stat().st_size
        self.assertTrue(0.6 < 1e6 * float(size[1]) / written < 1.6, (size[1], written))
        study = studies.read(self.write(edit=longer, more=("count: 12", "count: 100000")), True)
        self.assertRegex(frames.size_in_words(study, self.out), r"^frames: about \d\d GB for 100000 runs")
        self.assertEqual(frames.size_in_words(studies.read(self.write()), self.out), "")

    def test_the_example_reads_in_workers(self):
        """Workers are forked and spawned after the parent has read the file."""
        self.result(self.write(edit=("count: 12", "count: 3")), "o", "--record", "frames")
        sys.path.insert(0, str(SOURCE / "docs/examples"))
        self.addCleanup(sys.path.remove, str(SOURCE / "docs/examples"))
        import frames as example
        insertions = example.Insertions(self.out / "o/frames.h5")
        expected = insertions[2]["force"]
        self.assertEqual((len(insertions), insertions.nodes.shape), (3, MODEL.nodes.shape))
        parts = [pickle.loads(pickle.dumps(insertions))]    # pickled, as it would be for a spawned worker
        with multiprocessing.get_context("fork").Pool(2) as pool:
            for opened, process, found in pool.map(opened_by, [insertions] * 4):
                self.assertEqual(opened, process)
                np.testing.assert_array_equal(found, expected)
        read, write = os.pipe()
        child = os.fork()
        if child == 0:    # like a forked PyTorch worker, the child inherits the object unchanged
            opened, process, found = opened_by(insertions)
            os.write(write, bytes([opened == process and np.array_equal(found, expected)]))
            os._exit(0)
        os.waitpid(child, 0)
        self.assertEqual(os.read(read, 1), b"\1")
        np.testing.assert_array_equal(parts[0][2]["force"], expected)

    def test_pytorch_loads_with_workers(self):
        try:
            import torch
        except ImportError:
            self.skipTest("install python3-torch")
        self.result(self.write(edit=("count: 12", "count: 5")), "o", "--record", "frames")
        sys.path.insert(0, str(SOURCE / "docs/examples"))
        self.addCleanup(sys.path.remove, str(SOURCE / "docs/examples"))
        import frames as example
        insertions = example.Insertions(self.out / "o/frames.h5")
        batches = list(torch.utils.data.DataLoader(insertions, batch_size=2, num_workers=2))
        self.assertEqual([len(batch["force"]) for batch in batches], [2, 2, 1])
        with h5py.File(self.out / "o/frames.h5") as file:
            np.testing.assert_array_equal(torch.cat([batch["displacements"] for batch in batches]).numpy(), file["displacements"][:])

    def test_frames(self):
        path = self.write(edit=("count: 12", "count: 3"))
        self.result(path, "o", "--record", "frames")
        for command in ("collect", "summary"):    # both learn from the manifest that frames are recorded
            self.assertEqual(self.main(command, path, "--out", self.out / "o", *(["--no-plots"] if command == "summary" else []))[0], 0)
        status, _, errors = self.main("run", path, "--out", self.out / "o")
        self.assertEqual(status, 2)
        self.assertRegex(errors, r'"frames" differs \(every 0.02 s there, none now\): run it with or without --record frames as before')
        samples = studies.read(path).samples()
        with h5py.File(self.out / "o/frames.h5") as file:
            np.testing.assert_allclose(file["time"], [0, 0.02, 0.04, 0.06])
            np.testing.assert_array_equal(file["parameters"], samples)
            np.testing.assert_array_equal(file["nodes"], MODEL.nodes)
            self.assertEqual(file["displacements"].shape, (3, 4, len(MODEL.nodes), 3))
            self.assertEqual((file["displacements"].compression, file["displacements"].chunks[0]), ("gzip", 1))
            study = studies.read(path)
            model = trocar.Model(study.run_scene(samples[1]))
            sim = trocar.Sim(model)
            poses = next(study.run_motion(samples[1]).play(sim, 1e-3))
            outputs = sim.run(poses[:41], 1e-3)
            np.testing.assert_array_equal(file["force"][1, 2], outputs["force"][40])
            np.testing.assert_allclose(file["displacements"][1, 2], sim.displacements(), atol=1e-9)
            contacts = sim.contacts()
            self.assertEqual(file["contact_count"][1, 2], len(contacts))
            np.testing.assert_allclose(file["contact_force"][1, 2, len(contacts) - 1], contacts[-1].force, atol=1e-6)


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0], *sys.argv[3:]])
