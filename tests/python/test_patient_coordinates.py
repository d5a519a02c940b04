"""Tests programs with a scene in patient coordinates: needle.start and --patient. Expected values are computed here with NumPy.

usage: test_patient_coordinates.py BUILD_DIR SOURCE_DIR"""
import re
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
ROTATION = np.array([[-1, 0, 0], [0, np.cos(2.8), -np.sin(2.8)], [0, -np.sin(2.8), -np.cos(2.8)]])  # a rotation by almost half a turn
ORIGIN = np.array([0.012, -0.034, 0.056])  # m, the patient's origin in the mesh
START, TILT = np.array([0.004, 0.055, -0.185]), 0.3  # START: m; TILT: angle about x, rad, so the direction is (0, -sin, cos)
QUATERNION = [np.cos(TILT / 2), np.sin(TILT / 2), 0, 0]
AXIS = np.array([0, -np.sin(TILT), np.cos(TILT)])


def patient(points):
    """Converts positions in the mesh (m) to patient coordinates (mm)."""
    return 1e3 * (points - ORIGIN) @ ROTATION


def run(program, *options, status=0):
    done = subprocess.run([BUILD / "clients" / program, *map(str, options)], capture_output=True, text=True)
    assert done.returncode == status, f"{program}: {done.returncode}: {done.stderr}"
    return done.stderr


def table(path):
    lines = path.read_text().splitlines()
    names = lines[0].split(",")
    rows = [line.split(",") for line in lines[1:]]
    return {name: np.array([float(row[i]) for row in rows]) for i, name in enumerate(names) if name not in ("events",)}


def columns(data, *names):
    return np.column_stack([data[name] for name in names])


def array_of(path, name):
    text = re.search(rf'Name="{name}"[^>]*>([^<]*)<', path.read_text())[1]
    return np.array(text.split(), float).reshape(-1, 3)


class PatientCoordinates(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = tempfile.TemporaryDirectory()
        cls.out = Path(cls.folder.name)
        assert np.allclose(ROTATION.T @ ROTATION, np.eye(3)) and np.linalg.det(ROTATION) > 0
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = 1e-3 * ROTATION, ORIGIN
        text = (SOURCE / "meshes/template.yaml").read_text()
        text = re.sub(r"^mesh: *", f"mesh: {SOURCE}/meshes/", text, flags=re.M)
        numbers = lambda values: "[" + ", ".join(f"{value:.17g}" for value in np.ravel(values)) + "]"
        start = f"start: {{position: {numbers(START)}, orientation: {numbers(QUATERNION)}}}, "
        text = re.sub(r"^needle: *{", lambda found: found[0] + start, text, flags=re.M)
        cls.scene = cls.out / "patient.yaml"
        cls.scene.write_text(text + f"\npatient_to_mesh: {numbers(matrix)}\n")
        cls.log = cls.out / "poses.log"
        run("trocar-device", "--scene", cls.scene, "--script", "insert", "--write-log", cls.log, "--rate", 250)
        cls.mesh, cls.lps = ({}, {})
        for files, options in ((cls.mesh, []), (cls.lps, ["--patient"])):
            place = cls.out / ("lps" if options else "mesh")
            run("trocar-replay", "--quiet", "--scene", cls.scene, "--poses", cls.log, "--csv", f"{place}.csv", "--shift", f"{place}-shift.csv",
                "--vtu", place, "--at", 1.4, *options)
            files["csv"], files["shift"] = table(Path(f"{place}.csv")), table(Path(f"{place}-shift.csv"))
            files["tissue"], files["needle"] = Path(f"{place}-tissue.vtu"), Path(f"{place}-needle.vtu")

    @classmethod
    def tearDownClass(cls):
        cls.folder.cleanup()

    def test_device_starts_where_the_scene_says_and_moves_along_the_needle(self):
        base = columns(self.mesh["csv"], "base_x [m]", "base_y [m]", "base_z [m]")
        np.testing.assert_allclose(base[0], START, atol=1e-15)
        way = base - START
        along = way @ AXIS
        self.assertAlmostEqual(along.max(), 0.066, places=12)
        np.testing.assert_allclose(way, np.outer(along, AXIS), atol=1e-15)
        self.assertGreater(self.mesh["csv"]["contacts"].max(), 3)
        tip = columns(self.mesh["csv"], "tip_x [m]", "tip_y [m]", "tip_z [m]")
        np.testing.assert_allclose(tip[0], START + 0.2 * AXIS, atol=1e-12)

    def test_replay_writes_positions_and_vectors_in_the_patients_axes(self):
        mesh, lps = self.mesh["csv"], self.lps["csv"]
        for point in ("base", "tip"):
            expected = patient(columns(mesh, *(f"{point}_{axis} [m]" for axis in "xyz")))
            np.testing.assert_allclose(columns(lps, *(f"{point}_{axis} [mm]" for axis in "xyz")), expected, atol=1e-9)
        for names in (("fx [N]", "fy [N]", "fz [N]"), ("tx [N m]", "ty [N m]", "tz [N m]")):
            self.assertGreater(np.abs(columns(mesh, *names)).max(), 1e-5)
            np.testing.assert_allclose(columns(lps, *names), columns(mesh, *names) @ ROTATION, atol=1e-12)
        np.testing.assert_array_equal(lps["depth [m]"], mesh["depth [m]"])
        turned = columns(self.mesh["shift"], "right [mm]", "anterior [mm]", "superior [mm]") @ ROTATION
        self.assertGreater(np.abs(turned).max(), 0.01)
        np.testing.assert_allclose(columns(self.lps["shift"], "left [mm]", "posterior [mm]", "superior [mm]"), turned, atol=2e-6)

    def test_vtu_files_are_in_the_patients_coordinates(self):
        for part in ("tissue", "needle"):
            np.testing.assert_allclose(array_of(self.lps[part], "Points"), patient(array_of(self.mesh[part], "Points")), atol=1e-9)
        displacement = array_of(self.mesh["tissue"], "displacement")
        self.assertGreater(np.abs(displacement).max(), 1e-4)
        np.testing.assert_allclose(array_of(self.lps["tissue"], "displacement"), 1e3 * displacement @ ROTATION, atol=1e-12)
        np.testing.assert_allclose(array_of(self.lps["needle"], "force"), array_of(self.mesh["needle"], "force") @ ROTATION, atol=1e-12)

    def test_a_start_may_be_given_in_patient_coordinates(self):
        place = ",".join(f"{value:.9f}" for value in patient(START + [0.002, 0, 0]))
        moved, csv = self.out / "moved.log", self.out / "moved.csv"
        run("trocar-device", "--scene", self.scene, "--patient", f"--start={place}", "--duration", 0.1, "--write-log", moved)
        run("trocar-replay", "--quiet", "--scene", self.scene, "--poses", moved, "--csv", csv)
        np.testing.assert_allclose(columns(table(csv), "base_x [m]", "base_y [m]", "base_z [m]")[0], START + [0.002, 0, 0], atol=1e-11)

    def test_a_scene_says_how_deep_scripts_go(self):
        scene, log, csv = self.out / "deep.yaml", self.out / "deep.log", self.out / "deep.csv"
        scene.write_text(self.scene.read_text().replace("start: {", "start: {depth: 0.11, ", 1))
        run("trocar-device", "--scene", scene, "--script", "insert", "--write-log", log, "--rate", 250)
        run("trocar-replay", "--quiet", "--scene", scene, "--poses", log, "--csv", csv)
        way = columns(table(csv), "base_x [m]", "base_y [m]", "base_z [m]") - START
        self.assertAlmostEqual((way @ AXIS).max(), 0.11, places=12)
        self.assertAlmostEqual(table(csv)["t [s]"].max(), 3.0 * 0.11 / 0.066, delta=0.01)

    def test_refusals_say_what_is_missing(self):
        plain = SOURCE / "meshes/template.yaml"
        said = run("trocar-device", "--scene", plain, "--write-log", self.out / "none.log", status=2)
        self.assertIn("template.yaml: has no needle.start", said)
        said = run("trocar-replay", "--quiet", "--patient", "--scene", plain, "--poses", self.log, "--csv", self.out / "none.csv", status=2)
        self.assertIn("template.yaml: has no patient_to_mesh", said)
        self.assertFalse((self.out / "none.csv").exists())
        self.assertIn("--patient needs --scene", run("trocar-device", "--patient", "--start=1,2,3", status=2))


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
