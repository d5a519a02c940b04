#!/usr/bin/python3
"""Runs the command as a user would, with the shipped outlines and with bad input.
"""
import contextlib
import io
import os
import signal
import subprocess
import sys
import tempfile
import unittest
import unittest.mock

import numpy as np
import pydicom
import vtk

from anatomy_cases import SOURCE, ellipse, ellipsoid, ellipsoid_volume
from anatomy import __main__ as command, meshing, organ, picture, quality, reading, session, sources
from anatomy.shapes import shells
from anatomy.trials import stress

PROGRAMS = os.path.join(SOURCE, "build/clients")
SHIPPED = os.path.join(SOURCE, "meshes/synthetic.dcm")


def anatomy(*arguments):
    """Returns exit status, stdout and stderr. Runs in this process, because starting another takes seconds."""
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


def raising(_path, error):
    raise error


def killed(_path, number):
    os.kill(os.getpid(), number)


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

    def replay(self, scene, *more):
        subprocess.run([f"{PROGRAMS}/trocar-device", "--script", "figure8", "--write-log", "in.log"], check=True, capture_output=True)
        subprocess.run([f"{PROGRAMS}/trocar-replay", "--scene", scene, "--poses", "in.log", "--csv", "out.csv", "--quiet", *more], check=True)
        return content("out.csv").decode()

    def test_the_same_input_gives_the_same_files_and_the_server_runs_them(self):
        for name in ("a", "b"):
            os.mkdir(name)
        chosen = ("--roi", "prostate", "--bone", "Pubic arch", "--nodes", "500", "--output")
        subprocess.run([f"{SOURCE}/scripts/anatomy", SHIPPED, *chosen, "a/patient"], check=True, capture_output=True)
        self.make(SHIPPED.replace(".dcm", ".csv"), *chosen, "b/patient")
        for part in (".msh", "-quality.md", "-quality.svg"):
            self.assertEqual(content(f"a/patient{part}"), content(f"b/patient{part}"), part)
        table = self.replay("a/patient.yaml")
        for event in ("puncture:skin", "puncture:capsule"):
            self.assertIn(event, table)

    def test_all_regions_of_a_patient(self):
        os.mkdir("a")
        rois = {"prostate": "Prostate", "urethra": "Urethra", "rectum": "Rectum", "bladder": "Bladder"}
        with unittest.mock.patch.object(meshing, "TRIES", 3):    # limits the search for better angles, which takes long
            self.make(SHIPPED, *[argument for roi in rois.values() for argument in ("--roi", roi)], "--bone", "Pubic arch", "--nodes", "1400",
                      "--output", "a/five")
        nodes, _, mesh = read_msh("a/five.msh")
        self.assertAlmostEqual(nodes / 1400, 1, delta=0.1)
        self.assertEqual(set(mesh.regions), {*rois, "surrounding"})
        self.assertEqual(set(mesh.surfaces), {"skin", "fixed", "capsule", "bone", "urethra_wall", "rectum_wall", "bladder_wall"})
        self.assertLess(mesh.badness(), 4)
        rings = reading.read_outlines(SHIPPED)
        for region in ("urethra", "rectum", "bladder"):
            self.assertAlmostEqual(mesh.region_volume(region) * 1e9 / stress.planimetry(rings[rois[region]]), 1, delta=0.03, msg=region)
        urethra = mesh.points[np.unique(mesh.tets[mesh.region == mesh.regions.index("urethra")])]
        inside = shells.distances(mesh.surfaces["capsule"], urethra) < 0
        self.assertTrue(inside.any() and not inside.all())      # the surface is partly inside the gland
        whole = mesh.region_volume("prostate") + mesh.volumes()[self.within(mesh, "urethra", "capsule")].sum()
        self.assertAlmostEqual(whole * 1e9 / stress.planimetry(rings["Prostate"]), 1, delta=0.02)
        self.assertIn("# surfaces without resistance: bladder_wall, rectum_wall, urethra_wall", content("a/five.yaml").decode())
        self.assertIn("puncture:capsule", self.replay("a/five.yaml"))

    @staticmethod
    def within(mesh, region, surface):
        """Returns the mask of a region's tetrahedra that lie inside a surface."""
        return (mesh.region == mesh.regions.index(region)) & (shells.distances(mesh.surfaces[surface], mesh.points[mesh.tets].mean(axis=1)) < 0)

    def test_surfaces_and_a_corridor(self):
        self.write_surface("gland.stl", vtk.vtkSTLWriter(), 30)
        with unittest.mock.patch.object(meshing, "TRIES", 2):    # limits the search for better angles, which takes long
            status, _, complained = anatomy("gland.stl", "--nodes", "700", "--corridor", "10", "0", "4", "--output", "x", "--picture", "x.svg")
        self.assertEqual(status, 0, complained)
        self.assertGreater(content("x.svg").decode().count("gland, z ="), 10)
        self.assertIn("puncture:capsule", self.replay("x.yaml", "--shift", "shift.csv"))
        self.assertIn(b"coronal", content("shift.csv"))
        self.assertLess(float(content("x-quality.md").decode().split("surface of gland, mm | mean ")[1].split(",")[0]), 0.5)
        nodes, x, mesh = read_msh("x.msh")
        self.assertAlmostEqual(nodes / 700, 1, delta=0.1)
        near = np.hypot(x[:, 0] - 0.010, x[:, 1]) < 0.008
        far = np.hypot(x[:, 0] + 0.010, x[:, 1]) < 0.008
        self.assertGreater(np.count_nonzero(near), 1.5 * np.count_nonzero(far))
        self.assertAlmostEqual(mesh.region_volume("gland") * 1e9 / ellipsoid_volume(24, 17, 20), 1, delta=0.03)

    def test_surfaces_of_any_size_that_are_not_clean(self):
        binary, text = vtk.vtkPLYWriter(), vtk.vtkPLYWriter()
        text.SetFileTypeToASCII()
        for name, writer, size in (("coarse.ply", text, 14), ("fine.ply", binary, 60), ("coarse.stl", vtk.vtkSTLWriter(), 14)):
            count = self.write_surface(name, writer, size, torn=True)
            self.assertEqual(count, {14: 336, 60: 6960}[size])
            with unittest.mock.patch.object(organ, "MOST_CHECKED", 6000):    # lowered, so that the fine surface is decimated before the search for crossings
                found = organ.of_surface("x", "x", False, *reading.read_surface(name, 1.0))
            self.assertIn("were closed", found.notes[0])
            self.assertAlmostEqual(found.volume / ellipsoid_volume(24, 17, 20), 1, delta=0.08 if size == 14 else 0.005)

    @staticmethod
    def write_surface(name, writer, size, torn=False, scale=1.0):
        """Writes an ellipsoid with size x 2 size facets and, if `torn`, with holes and duplicate facets. Returns the number of facets."""
        sphere = vtk.vtkSphereSource()
        sphere.SetRadius(1)
        sphere.SetThetaResolution(size)
        sphere.SetPhiResolution(size)
        sphere.Update()
        unit = shells.from_vtk(sphere.GetOutput())
        triangles = unit.triangles
        if torn:
            triangles = np.vstack([triangles[2:], triangles[-1:], triangles[100:101]])
        writer.SetFileName(name)
        writer.SetInputData(shells.to_vtk(shells.Shell(scale * unit.points * [24, 17, 20], triangles)))
        writer.Write()
        return len(triangles)

    def test_the_picture_shows_all_slices_or_says_how_many_more(self):
        rois = {"Gland": [*ellipsoid(24, 17, 20, 4), ellipse(0.4, 0.4, 30)]}
        for panels, shown, more in ((60, 11, False), (5, 5, True)):
            with unittest.mock.patch.object(picture, "PANELS", panels):
                picture.draw([organ.of_rings("Gland", "gland", False, rois["Gland"])], rois, "x.svg")
            drawn = content("x.svg").decode()
            self.assertEqual((drawn.count("Gland, z ="), "and 6 more" in drawn), (shown, more))
            self.assertEqual("left out" in drawn, not more)

    def test_a_structure_set_that_is_cut_off_or_damaged_is_refused(self):
        whole = content(SHIPPED)
        for length in [200, 700, *range(1000, len(whole), 9001)]:
            with open("cut.dcm", "wb") as file:
                file.write(whole[:length])
            self.assertIn(f"cut.dcm: ends too early, within an element, after {length} bytes", self.refused("cut.dcm", "--roi", "Prostate"))

        def without(change):
            data = pydicom.dcmread(SHIPPED)
            change(data)
            data.save_as("x.dcm")
            return self.refused("x.dcm", "--roi", "Prostate", "--bone", "Rectum")
        self.assertIn("ReferencedROINumber", without(lambda data: delattr(data.ROIContourSequence[1], "ReferencedROINumber")))
        self.assertIn("it has: (ROI 1), Urethra", without(lambda data: delattr(data.StructureSetROISequence[0], "ROIName")))
        self.assertIn("it has: Prostate (ROI 1), Prostate (ROI 2)", without(lambda data: setattr(data.StructureSetROISequence[1], "ROIName", "Prostate")))
        at = whole.index(b"\\", len(whole) // 2)
        with open("number.dcm", "wb") as file:
            file.write(whole[:at + 1] + b"x" + whole[at + 2:])
        self.assertIn("number.dcm: damaged", self.refused("number.dcm", "--roi", "Prostate"))

    def test_exclusive_outlines_are_read_as_such(self):
        data = pydicom.dcmread(SHIPPED)
        data.ROIContourSequence[0].ContourSequence[3].ContourGeometricType = "CLOSEDPLANAR_XOR"
        data.save_as("x.dcm")
        rois = reading.read_outlines("x.dcm")
        self.assertEqual([roi for roi, rings in rois.items() if rings.exclusive], ["Prostate"])
        self.assertEqual(len(rois["Prostate"]), len(reading.read_outlines(SHIPPED)["Prostate"]))

    def test_open_outlines_are_not_dropped_in_silence(self):
        data = pydicom.dcmread(SHIPPED)
        for outline in data.ROIContourSequence[0].ContourSequence[2:6]:
            outline.ContourGeometricType = "OPEN_PLANAR"
        data.save_as("open.dcm")
        self.assertRegex(self.refused("open.dcm", "--roi", "Prostate"), r'region "Prostate": 4 of \d+ outlines .* are open .* at z = ')

    def test_regions_that_cannot_be_told_apart_are_refused(self):
        for folder in ("a", "b"):
            os.mkdir(folder)
            self.write_surface(f"{folder}/gland.stl", vtk.vtkSTLWriter(), 14)
        self.assertIn("a/gland.stl", self.refused("a/gland.stl", "b/gland.stl", "--roi", "gland"))
        self.assertIn("chosen twice", self.refused(SHIPPED, "--roi", "Prostate", "--bone", "prostate"))

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
        self.assertIn("choose the regions with --roi", self.refused(SHIPPED))
        self.assertIn("open.stl", self.refused("open.stl"))
        self.assertIn("none.dcm", self.refused("none.dcm"))
        self.assertIn("bad.dcm", self.refused(os.path.relpath(self.copy("bad.csv", "bad.dcm"))))
        self.assertIn("--nodes", self.refused(SHIPPED, "--nodes", "5"))
        self.assertFalse([name for name in os.listdir(".") if name.endswith(".msh")])

    def test_outlines_are_always_in_mm_however_small_they_are(self):
        rings = ellipsoid(2.5, 2.5, 2.5, 0.5)       # 65 mm^3
        with open("small.csv", "w", encoding="utf-8") as file:
            file.write(",".join(reading.COLUMNS) + "\n")
            file.writelines(f"Lesion,{n},{x},{y},{z}\n" for n, ring in enumerate(rings) for x, y, z in ring)
        with unittest.mock.patch.object(meshing, "TRIES", 2):
            status, _, complained = anatomy("small.csv", "--nodes", "2000", "--margin", "5", "--output", "small")
        self.assertEqual(status, 0, complained)
        self.assertIn("few of the mesh's elements are in it", complained)
        self.assertNotIn("unit", complained)
        self.write_surface("small.stl", vtk.vtkSTLWriter(), 14, scale=0.1)
        self.assertRegex(self.refused("small.stl"), "is the file's unit right\\? Give it with --unit$")

    def test_options_without_a_meaning_for_the_file_are_refused(self):
        self.write_surface("x.stl", vtk.vtkSTLWriter(), 14)
        with open("names.txt", "w", encoding="utf-8") as file:
            file.write("1 Prostate\n")
        csv, msh = SHIPPED.replace(".dcm", ".csv"), os.path.join(SOURCE, "meshes/prostate.msh")
        values = {"unit": "mm", "frame": "LPS", "names": "names.txt", "labels": "x"}
        for path, names in ((csv, values), (SHIPPED, values), ("x.stl", ("names", "labels")), (msh, ("names", "labels")), (self.copy(csv, "x.nrrd"), ("labels",))):
            for name in names:
                self.assertIn(f"{path}: --{name} has no meaning for this kind of file: leave it out", self.refused(path, "--list", f"--{name}", values[name]))
        self.assertIn("prostate", self.make(msh, "--list", "--unit", "m", "--frame", "LPS"))

    def test_what_ends_the_reading_of_a_file_is_told(self):
        def fails(error):
            with self.assertRaises(Exception) as caught:
                sources.read("x.nrrd", raising, error)
            return caught.exception
        damaged = fails(KeyError("sizes"))
        self.assertIsInstance(damaged, reading.BadFile)
        self.assertEqual(str(damaged), "x.nrrd: damaged, or not what its name says: KeyError: 'sizes'")
        self.assertEqual(str(fails(np.core._exceptions._ArrayMemoryError((2 ** 40,), np.dtype(float)))), "x.nrrd: too large for this machine's memory")
        self.assertEqual(str(fails(MemoryError())), "x.nrrd: too large for this machine's memory")
        self.assertIsInstance(fails(PermissionError(13, "Permission denied", "x.nrrd")), PermissionError)
        self.assertIn("damaged", str(fails(OSError("Invalid data stream"))))
        for number, words in ((signal.SIGKILL, "damaged, not what its name says, or too little memory"), (signal.SIGSEGV, "damaged, or not what its name says")):
            with self.assertRaisesRegex(reading.BadFile, f"^x.nrrd: {words}: reading x.nrrd: ended by signal {number:d}$"):
                sources.read("x.nrrd", killed, number)
        with unittest.mock.patch.object(os, "access", lambda path, mode: mode != os.R_OK):
            self.assertIn("synthetic.dcm: no permission to read it", self.refused(SHIPPED, "--list"))

    def test_the_folder_of_the_output_is_checked_before_the_work(self):
        with unittest.mock.patch.object(sources, "read_all", side_effect=AssertionError):
            self.assertIn("nowhere/x: the folder nowhere does not exist, or cannot be written to", self.refused(SHIPPED, "--roi", "Prostate", "--output", "nowhere/x"))
        self.make(SHIPPED, "--list", "--output", "nowhere/x")

    def test_points_that_are_not_finite_are_refused(self):
        points, cells = vtk.vtkPoints(), vtk.vtkCellArray()
        for point in ((0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, float("nan"))):
            points.InsertNextPoint(point)
        for triangle in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)):
            cells.InsertNextCell(3, triangle)
        surface, grid = vtk.vtkPolyData(), vtk.vtkUnstructuredGrid()
        surface.SetPoints(points)
        surface.SetPolys(cells)
        grid.SetPoints(points)
        grid.InsertNextCell(vtk.VTK_TETRA, 4, (0, 1, 2, 3))
        for path, writer, data in (("x.vtp", vtk.vtkXMLPolyDataWriter(), surface), ("x.vtu", vtk.vtkXMLUnstructuredGridWriter(), grid)):
            writer.SetFileName(path)
            writer.SetInputData(data)
            writer.Write()
            self.assertIn(f"{path}: some of its points have coordinates that are not finite numbers", self.refused(path))

    @staticmethod
    def copy(source, target):
        with open(target, "wb") as file:
            file.write(content(source))
        return target


def read_msh(path):
    """Returns the number of nodes, their positions, and the mesh."""
    meshing.gmsh.open(path)
    mesh, _ = meshing.current_mesh()
    return len(mesh.points), mesh.points, mesh


class Committed(unittest.TestCase):
    """Tests the default scene's mesh, which is made from the shipped outlines."""

    def test_it_has_the_papers_size_and_quality(self):
        nodes, _, mesh = read_msh(os.path.join(SOURCE, "meshes/prostate.msh"))
        rings = reading.read_outlines(SHIPPED)["Prostate"]
        outlined = stress.planimetry(rings) * 1e-9
        self.assertAlmostEqual(nodes / 570, 1, delta=0.05)
        self.assertAlmostEqual(len(mesh.tets) / 2801, 1, delta=0.1)
        self.assertGreaterEqual(mesh.dihedral_angles().min(), quality.LEAST_ANGLE)
        self.assertLessEqual(mesh.dihedral_angles().max(), quality.GREATEST_ANGLE)
        self.assertAlmostEqual(mesh.region_volume("prostate") / outlined, 1, delta=0.02)


if __name__ == "__main__":
    session.start()
    unittest.main()
