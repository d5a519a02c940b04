#!/usr/bin/python3
"""The command as a user runs it, on the shipped outlines and on bad input.
"""
import contextlib
import io
import os
import subprocess
import sys
import tempfile
import unittest
import unittest.mock

import numpy as np
import vtk

from anatomy_cases import SOURCE, ellipsoid, ellipsoid_volume
from anatomy import __main__ as command, contours, field, meshing, quality, reading, shells

PROGRAMS = os.path.join(SOURCE, "build/clients")
SHIPPED = os.path.join(SOURCE, "meshes/synthetic.dcm")


def anatomy(*arguments):
    """Exit status, what was printed, what was complained: in this process, since starting one takes seconds."""
    printed, complained = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(complained), unittest.mock.patch.object(sys, "argv", ["anatomy", *arguments]):
        try:
            command.main()
            status = 0
        except SystemExit as end:
            status = end.code
    return status, printed.getvalue(), complained.getvalue()


def content(path):
    with open(path, "rb") as file:
        return file.read()


class Command(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        os.chdir(directory.name)

    def make(self, *arguments):
        status, printed, complained = anatomy(*arguments)
        self.assertEqual(status, 0, complained)
        return printed

    def refused(self, *arguments):
        status, _, complained = anatomy(*arguments)
        self.assertEqual(status, 2, complained)
        return complained

    def replay(self, scene):
        subprocess.run([f"{PROGRAMS}/trocar-device", "--script", "figure8", "--write-log", "in.log"], check=True, capture_output=True)
        subprocess.run([f"{PROGRAMS}/trocar-replay", "--scene", scene, "--poses", "in.log", "--csv", "out.csv", "--quiet"], check=True)
        return content("out.csv").decode()

    def test_the_same_input_gives_the_same_files_and_the_server_runs_them(self):
        for name in ("a", "b"):
            os.mkdir(name)
        chosen = ("--roi", "prostate", "--bone", "Pubic arch", "--output")
        subprocess.run([f"{SOURCE}/scripts/anatomy", SHIPPED, *chosen, "a/patient"], check=True, capture_output=True)
        self.make(SHIPPED.replace(".dcm", ".csv"), *chosen, "b/patient")
        for part in (".msh", "-quality.md", "-quality.svg"):
            self.assertEqual(content(f"a/patient{part}"), content(f"b/patient{part}"), part)
        table = self.replay("a/patient.yaml")
        for event in ("puncture:skin", "puncture:capsule"):
            self.assertIn(event, table)

    def test_surfaces_regions_and_a_corridor(self):
        sphere = field.of_stack(contours.build_stack("x", ellipsoid(24, 17, 20, 3))).surfaces()[0]
        writer = vtk.vtkSTLWriter()
        writer.SetFileName("gland.stl")
        writer.SetInputData(shells.to_vtk(sphere))
        writer.Write()
        self.make("gland.stl", "--nodes", "900", "--corridor", "10", "0", "4", "--output", "x")
        nodes, x, _ = read_msh("x.msh")
        self.assertAlmostEqual(nodes / 900, 1, delta=0.1)
        near = np.hypot(x[:, 0] - 0.010, x[:, 1]) < 0.008
        far = np.hypot(x[:, 0] + 0.010, x[:, 1]) < 0.008
        self.assertGreater(np.count_nonzero(near), 1.5 * np.count_nonzero(far))
        with open("x-quality.md", encoding="utf-8") as file:
            volume = float(file.read().split("volume of gland, ml | ")[1].split(",")[0])
        self.assertAlmostEqual(volume / (ellipsoid_volume(24, 17, 20) * 1e-3), 1, delta=0.03)

    def test_bad_input_is_refused_with_its_place(self):
        with open("bad.csv", "w", encoding="utf-8") as file:
            file.write(",".join(reading.COLUMNS) + "\nProstate,0,1,2,3\nProstate,0,1,two,3\n")
        with open("flat.csv", "w", encoding="utf-8") as file:
            file.write(",".join(reading.COLUMNS) + "\n" + "".join(f"Prostate,0,{x},{y},7\n" for x, y in ((0, 0), (30, 0), (0, 30))))
        with open("open.stl", "w", encoding="utf-8") as file:
            file.write("solid x\nendsolid x\n")
        self.assertIn("bad.csv:3:", self.refused("bad.csv"))
        self.assertIn('region "Prostate"', self.refused("flat.csv", "--picture", "why.svg"))
        self.assertIn("<svg", content("why.svg").decode())
        self.assertIn("it has: Prostate", self.refused("flat.csv", "--roi", "Liver"))
        self.assertIn("choose the gland with --roi", self.refused(SHIPPED))
        self.assertIn("open.stl", self.refused("open.stl"))
        self.assertIn("none.dcm", self.refused("none.dcm"))
        self.assertIn("bad.dcm", self.refused(os.path.relpath(self.copy("bad.csv", "bad.dcm"))))
        self.assertIn("--nodes", self.refused(SHIPPED, "--nodes", "5"))
        self.assertFalse([name for name in os.listdir(".") if name.endswith(".msh")])

    @staticmethod
    def copy(source, target):
        with open(target, "wb") as file:
            file.write(content(source))
        return target


def read_msh(path):
    """Number of nodes, their positions, and the mesh."""
    meshing.gmsh.open(path)
    mesh = meshing.current_mesh()
    return len(mesh.points), mesh.points, mesh


class Committed(unittest.TestCase):
    """The mesh of the default scene, made from the shipped outlines."""

    def test_it_has_the_papers_size_and_quality(self):
        nodes, _, mesh = read_msh(os.path.join(SOURCE, "meshes/prostate.msh"))
        outlined = contours.build_stack("Prostate", reading.read_outlines(SHIPPED)["Prostate"]).volume() * 1e-9
        self.assertAlmostEqual(nodes / 570, 1, delta=0.05)
        self.assertAlmostEqual(len(mesh.tets) / 2801, 1, delta=0.1)
        self.assertGreaterEqual(mesh.dihedral_angles().min(), quality.LEAST_ANGLE)
        self.assertLessEqual(mesh.dihedral_angles().max(), quality.GREATEST_ANGLE)
        self.assertAlmostEqual(mesh.region_volume("prostate") / outlined, 1, delta=0.02)


if __name__ == "__main__":
    meshing.quiet()
    unittest.main()
