#!/usr/bin/python3
"""Tests trocar-fit: least squares against scipy, recordings in CSV and LCM logs, parameters of a simulated insertion, warnings, files, and bad input. The
confidence intervals are checked in tests/verification/verify_fit.py.

usage: test_fit.py BUILD_DIR SOURCE_DIR
"""
import contextlib
import io
import json
import math
import os
import struct
import sys
import tempfile
import unittest
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path[:0] = [str(BUILD / "clients/python"), str(SOURCE / "clients/python")]    # the second folder is for trocar_client
sys.dont_write_bytecode = True

import numpy as np
from scipy.optimize import least_squares

import trocar
import trocar_client
from trocar import motion
from trocar.studies import _least_squares as solver
from trocar.studies import _measurements as measurements
from trocar.studies import fit

SCENE = SOURCE / "meshes/figure8.yaml"
RATE = 500
SHAFT = "regions[surrounding].friction.kinetic"
MODULUS = "regions[surrounding].youngs_modulus"
SKIN = "membranes[skin].puncture_force"
TRUE = {SHAFT: 9.0, MODULUS: 22e3, SKIN: 0.8}
FIT = f"""scene: {os.path.relpath(SCENE, '/')}
set: {{rate_hz: {RATE}}}
recordings: [{{poses: poses.csv, forces: forces.csv, points: points.csv}}]
points: {{near: [0.004, 0.010, 0.012]}}
noise: {{force: 0.01, position: 0.1e-3}}
parameters:
  {SHAFT}: {{within: [1, 12]}}
  {MODULUS}: {{within: [5e3, 100e3]}}
  {SKIN}: {{within: [0.1, 3]}}
"""


def poses():
    """Returns poses that push in by 25 mm, rest, and draw back by 10 mm."""
    legs = ((0.0, 0.3, (0, 0, 0.025)), (0.4, 0.55, (0, 0, -0.010)))
    return motion.Script(start=motion.START, legs=tuple(motion.Leg(*leg) for leg in legs), seconds=0.55).poses(motion.START, 1.0 / RATE)


def write_table(path, head, columns):
    np.savetxt(path, np.column_stack(columns), "%.17g", ",", header=head, comments="")


def event(number, channel, data, time=0):
    return struct.pack(">IqqII", 0xEDA1DA01, number, time, len(channel), len(data)) + channel.encode() + data


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name)

    def problem(self, text=FIT):
        path = self.out / "fit.yaml"
        path.write_text(text.replace("scene: ", "scene: " + os.path.relpath("/", self.out) + "/", 1))
        return path

    def measure(self, noise=0.0):
        """Writes a recording of the scene with the true values, simulated through the package's own interface."""
        scene = trocar.Scene.load(SCENE)
        scene["rate_hz"] = RATE
        for key, value in TRUE.items():
            scene[key] = value
        sim, track, random = trocar.Sim(trocar.Model(scene)), poses(), np.random.default_rng(7)
        time = np.arange(len(track)) / RATE
        sim.reset(track[0])
        force, place = [], []
        point = np.array([0.004, 0.010, 0.012])
        nodes, tets = sim.model.nodes, sim.model.tets
        for pose in track:
            force.append(sim.step(pose, 1.0 / RATE).force)
            place.append(point + self.interpolate(nodes, tets, sim.displacements(), point) if len(place) % 25 == 0 else np.full(3, np.nan))
        write_table(self.out / "poses.csv", "t,x,y,z,qw,qx,qy,qz", [time, track])
        write_table(self.out / "forces.csv", "t [s],fx [N],fy [N],fz [N]", [time, np.array(force) + noise * random.standard_normal((len(track), 3))])
        seen = np.arange(0, len(track), 25)
        write_table(self.out / "points.csv", "t [s],near_x [mm],near_y [mm],near_z [mm]", [time[seen], 1e3 * np.array(place)[seen]])

    def interpolate(self, nodes, tets, field, point):
        if not hasattr(self, "corner"):
            for tet in tets:
                weights = np.linalg.solve(np.vstack([nodes[tet].T, np.ones(4)]), [*point, 1.0])
                if weights.min() >= 0:
                    self.corner = tet, weights
                    break
        return self.corner[1] @ field[self.corner[0]]

    def run_program(self, *arguments):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            status = fit.main([str(argument) for argument in arguments])
        return status, out.getvalue(), err.getvalue()


class SolverTest(unittest.TestCase):
    """Fits an exponential and a constant to noisy data. The reference is scipy's solution."""

    def setUp(self):
        self.time = np.linspace(0.0, 2.0, 400)
        random = np.random.default_rng(3)
        self.data = self.curve([0.3, 0.6, 0.4]) + 0.02 * random.standard_normal(len(self.time))

    def curve(self, p):
        return p[0] + p[1] * np.exp(-self.time / (0.05 + p[2]))

    def residuals(self, p):
        return (self.curve(p) - self.data) / 0.02

    def test_finds_the_solution_and_covariance_of_scipy(self):
        found = solver.minimise(lambda points: [self.residuals(p) for p in points], np.array([0.6, 0.2, 0.8]))
        reference = least_squares(self.residuals, [0.6, 0.2, 0.8], bounds=(0, 1), xtol=1e-12, ftol=1e-12)
        expected = np.linalg.inv(reference.jac.T @ reference.jac)
        deviation = np.sqrt(np.diag(expected))
        self.assertTrue(found.converged)
        np.testing.assert_array_less(np.abs(found.point - reference.x) / deviation, 0.15)    # the search ends within a seventh of a standard error
        np.testing.assert_allclose(solver.covariance(found.jacobian).matrix, expected, rtol=0.05, atol=0.02 * deviation.max() ** 2)
        self.assertLess(found.evaluations, 40)

    def test_stays_within_bounds(self):
        self.data = self.curve([0.3, 1.2, 0.4])
        found = solver.minimise(lambda points: [self.residuals(p) for p in points], np.array([0.6, 0.2, 0.8]))
        reference = least_squares(self.residuals, [0.6, 0.2, 0.8], bounds=(0, 1), xtol=1e-12, ftol=1e-12)
        self.assertEqual(found.point[1], 1.0)
        self.assertLess(found.residuals @ found.residuals, 1.001 * 2 * reference.cost)

    def test_goes_round_points_that_cannot_be_computed(self):
        """Fits run into points that cannot be computed, for example where kinetic friction would exceed static friction."""
        evaluate = lambda points: [self.residuals(p) if p[0] + p[1] < 1.05 else None for p in points]
        found = solver.minimise(evaluate, np.array([0.2, 0.8, 0.2]))
        self.assertTrue(found.converged)
        np.testing.assert_allclose(found.point, [0.3, 0.6, 0.4], atol=0.03)
        with self.assertRaises(ValueError):
            solver.minimise(evaluate, np.array([0.6, 0.6, 0.5]))

    def test_names_the_direction_that_is_not_determined(self):
        jacobian = np.outer(np.linspace(0, 10, 50), [1.0, 1.0, 0.0])
        jacobian[:, 2] = 7.0
        spread, direction = solver.covariance(jacobian).directions[0]
        self.assertGreater(spread, 1e3)
        np.testing.assert_allclose(np.abs(direction), [math.sqrt(0.5), math.sqrt(0.5), 0.0], atol=1e-6)


class MeasurementTest(Case):
    def table(self):
        return motion.Table(times=np.array([0.0, 1.0]), given=np.tile(motion.START, (2, 1)))

    def test_means_and_their_spreads(self):
        channel = measurements.Channel("force", 2, "", np.array([0.0, 0.004, 0.008, 0.030, 0.034]), np.array([1.0, 2.0, 3.0, 7.0, 9.0]), 0.02)
        np.testing.assert_allclose(channel.means(channel.values), [2.0, 8.0])
        np.testing.assert_allclose(channel.at(), [0.004, 0.032])
        slope = 6.0 / 0.028
        np.testing.assert_allclose(channel.spreads(0.3, 0.001), np.sqrt([0.09 / 3 + (1e-3 * slope) ** 2, 0.09 / 2 + (1e-3 * slope) ** 2]))

    def test_reads_the_columns_of_trocar_replay(self):
        path = self.out / "replay.csv"
        path.write_text("t [s],fx [N],fy [N],fz [N],tx [N m],ty [N m],tz [N m],depth [m],contacts,events,needle\n0,1,2,3,4,5,6,0,0,none,0\n0.5,2,3,4,5,6,7,0,0,touched,0\n")
        found = measurements.read_forces(path, self.table(), 0.02, ["force", "torque"])
        self.assertEqual([channel.name for channel in found], ["force x", "force y", "force z", "torque x", "torque y", "torque z"])
        np.testing.assert_array_equal(found[4].values, [5.0, 6.0])

    def test_reads_points_with_gaps_in_millimetres(self):
        path = self.out / "points.csv"
        path.write_text("t [s],a_x [mm],a_y [mm],a_z [mm]\n0,1,2,3\n0.1,,,\n0.2,4,5,6\n")
        found = measurements.read_points(path, self.table(), 0.02, ["a", "b"])
        np.testing.assert_allclose(found[1].values, [2e-3, 5e-3])
        np.testing.assert_allclose(found[1].times, [0.0, 0.2])

    def test_reads_a_log_of_lcm(self):
        pose = lambda utime, session, x, needle=0: trocar_client._NEEDLE_POSE.encode(utime=utime, session=session, seq=1, position=(x, 0.0, 0.0), orientation=(1.0, 0.0, 0.0, 0.0),
                                                                                     needle=needle)
        wrench = lambda utime, session, f: trocar_client._NEEDLE_WRENCH.encode(session=session, pose_seq=1, pose_utime=utime, force=(9.0, 9.0, 9.0), raw_force=(0.0, 0.0, f))
        messages = [("TROCAR_POSE", pose(1_000_000, 5, 0.1)), ("TROCAR_POSE", pose(1_000_500, 6, 0.7)), ("TROCAR_WRENCH", wrench(1_000_000, 5, 0.25)),
                    ("TROCAR_STATUS", b"anything"), ("TROCAR_POSE", pose(1_010_000, 5, 0.2)), ("TROCAR_WRENCH", wrench(1_010_000, 5, 0.5)),
                    ("TROCAR_WRENCH", wrench(1_010_500, 6, 0.9))]
        path = self.out / "a.log"
        path.write_bytes(b"".join(event(i, *message) for i, message in enumerate(messages)))
        found = measurements.read_log(path, 0.02, ["force"])
        np.testing.assert_allclose(found.motion.times, [0.0, 0.01])
        np.testing.assert_allclose(found.motion.given[:, 0], [0.1, 0.2])
        self.assertEqual([channel.name for channel in found.channels], ["force x", "force y", "force z"])
        np.testing.assert_allclose(found.channels[2].values, [0.25, 0.5])
        path.write_bytes(path.read_bytes()[:-3])
        with self.assertRaisesRegex(measurements.BadRecording, r"a.log: byte \d+: no complete event"):
            measurements.read_log(path, 0.02, ["force"])
        path.write_bytes(event(0, "TROCAR_POSE", b"another message"))
        with self.assertRaisesRegex(measurements.BadRecording, "event 0: TROCAR_POSE: a message of another type"):
            measurements.read_log(path, 0.02, ["force"])

    def test_refuses_tables(self):
        for text, words in (("t [s],fz [N]\n0,1\n0,2\n", r":3: time 0 s is not after 0 s: sort"), ("t [s],fz [N]\n0,1\n1,much\n", ":3: column fz: \"much\": write a number"),
                            ("t [s],fz [kg]\n0,1\n1,2\n", r":1: column fz \[kg\]: write the unit N"), ("t [s],force [N]\n0,1\n1,2\n", ":1: no column of force"),
                            ("fz [N]\n1\n2\n", ":1: no column \"t"), ("t [s],fz [N]\n", "0 rows"), ("t [s],fz [N]\n5,1\n6,2\n", "0 samples between the first and the last pose"),
                            ("t [s],fz [N]\n0,nan\n1,2\n", ":2: column fz: nan: write a finite number")):
            path = self.out / "forces.csv"
            path.write_text(text)
            with self.assertRaisesRegex(measurements.BadRecording, words):
                measurements.read_forces(path, self.table(), 0.02, ["force"])


class FitTest(Case):
    def test_finds_the_parameters_of_a_simulated_insertion(self):
        self.measure(noise=0.01)
        status, out, err = self.run_program("run", self.problem(), "--out", self.out / "fit", "--quiet")
        self.assertEqual((status, err), (0, ""), out)
        found = json.loads((self.out / "fit/fit.json").read_text())
        self.assertTrue(found["converged"])
        for key, true in TRUE.items():
            parameter = found["parameters"][key]
            self.assertLess(abs(parameter["value"] / true - 1.0), 0.05, (key, parameter))
            self.assertLess(parameter["low"], parameter["value"])
            self.assertLess(parameter["value"], parameter["high"])
            self.assertIn(f"| {key} | {parameter['value']:.4g} |", out)
        self.assertTrue((self.out / "fit/residuals.svg").read_text().startswith("<?xml"))
        self.assertLess(found["chi2"], 1.3 * found["degrees_of_freedom"])

        # Merged with a mesh and a fixed surface, the fragment is a scene.
        merged = self.out / "merged.yaml"
        merged.write_text(f"mesh: {SOURCE / 'meshes/prostate-570.msh'}\nfixed: [fixed]\n" + (self.out / "fit/fitted.yaml").read_text())
        scene = trocar.Scene.load(merged)
        for key in TRUE:
            self.assertEqual(scene[key], found["parameters"][key]["value"])

    def test_check_names_what_the_motion_does_not_determine(self):
        """The needle does not reach the prostate, so the data do not determine its cutting force. They do determine the friction outside it."""
        self.measure()
        text = FIT + "  regions[prostate].cutting_force: {within: [0.1, 2]}\n"
        status, out, err = self.run_program("check", self.problem(text))
        self.assertEqual(status, 0)
        self.assertIn("warning: the data do not determine regions[prostate].cutting_force", err)
        self.assertRegex(out, r"regions\[prostate\].cutting_force .* not determined")
        self.assertNotIn(f"determine {SHAFT}", err)

    def test_a_prior_takes_the_place_of_data(self):
        self.measure()
        text = FIT + "  regions[prostate].cutting_force: {within: [0.1, 2], prior: [0.3, 0.02]}\n"
        problem = fit.read(self.problem(text))
        found = fit.expected(problem).estimates[-1]
        self.assertTrue(found.determined)
        self.assertAlmostEqual(math.log(found.high / found.low) / 2, 1.96 * 0.02 / 0.3, delta=0.002)

    def test_results_do_not_depend_on_workers(self):
        self.measure()
        problem = fit.read(self.problem())
        one, two = fit.expected(problem, 1), fit.expected(problem, 2)
        self.assertEqual([estimate.low for estimate in one.estimates], [estimate.low for estimate in two.estimates])

    def test_says_that_the_scene_does_not_describe_the_data(self):
        self.measure()
        table = np.loadtxt(self.out / "forces.csv", delimiter=",", skiprows=1)
        write_table(self.out / "forces.csv", "t [s],fx [N],fy [N],fz [N]", [table[:, 0], table[:, 1:] + 0.2 * np.sin(40 * table[:, :1])])
        found = fit.fit(fit.read(self.problem()))
        self.assertTrue(any("does not describe the data within the noise" in words for words in found.warnings), found.warnings)

    def test_bad_input(self):
        self.measure()
        cases = [("scene: ", "scenes: ", r"fit.yaml:1: unknown key \"scenes\""), ("poses: poses.csv", "poses: other.csv", r"fit.yaml:3: recordings\[0\].poses: no file"),
                 ("poses: poses.csv, ", "", r"fit.yaml:3: recordings\[0\]: write poses, a CSV file, or log"), ("force: 0.01", "force: 0", r"fit.yaml:5: noise.force: \"0\": write a number above 0"),
                 ("near: [0.004", "near: [4.0", r"fit.yaml:4: points.near: not in the tissue at rest"), ("{within: [1, 12]}", "{within: [12, 1]}", r"fit.yaml:7: .*: 1 is not above 12"),
                 ("{within: [1, 12]}", "{within: [8, 12]}", r"fit.yaml:7: .*: 7, as in the scene, is not within 8 to 12"), (SHAFT, "regions[liver].youngs_modulus", "fit.yaml:7: .*liver"),
                 (SHAFT, "needle.segments", "fit.yaml:7: .*: not a property that can be fitted"), (", position: 0.1e-3", "", r"fit.yaml:3: recordings\[0\].points: write the points' places"),
                 ("{within: [1, 12]}", "{within: [1, 12], prior: [7, 0]}", r"fit.yaml:7: .*: write the mean, within the bounds, and a standard deviation above 0"),
                 ("{within: [1, 12]}", "{within: [1, 20], start: 19}", "the start values cannot be simulated: .*exceeds the static limit.*: write other values")]
        for old, new, words in cases:
            with self.subTest(new):
                self.assertIn(old, FIT)
                status, out, err = self.run_program("run", self.problem(FIT.replace(old, new, 1)), "--out", self.out / "fit", "--quiet", "--no-plots", "--workers", 1)
                self.assertEqual(status, 2, err)
                self.assertRegex(err, words)
                self.assertEqual(err.count("\n"), 1, err)


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
