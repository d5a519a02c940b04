#!/usr/bin/python3
"""Tests label maps, surfaces and volume meshes of every kind, and the needle's entry point, on shapes of known position and volume.
"""
import bz2
import contextlib
import gzip
import io
import os
import re
import tempfile
import unittest
import unittest.mock
from sys import modules

import numpy as np
import pydicom

from anatomy_cases import ellipsoid_volume
from anatomy import __main__ as command, approach, materials, meshing, options, organ, pipeline, quality, reading, scene, session, trouble
from anatomy.shapes import contours, label_image, shells, voxels
from anatomy.trials import inputs, label_stress, nrrd

SPACING = (1.0, 1.25, 2.0)
MIDDLE = np.array([30.0, -20.0, 100.0])    # LPS, mm: centre of two touching half balls, the first of which is on the patient's left
RADIUS = 18.0


def two_halves(degrees=0.0):
    """Returns the label array (k, j, i) of a ball inside a larger ball of label 3, and the voxel-to-patient transform. The left half (+x) of the inner ball is
    label 1, its right half label 2."""
    size = np.array([60, 48, 30])
    x, y, z = np.meshgrid(*(np.arange(n) * s - n * s / 2 for n, s in zip(size, SPACING)), indexing="ij")
    radius = np.sqrt(x ** 2 + y ** 2 + z ** 2)
    found = np.where(radius < RADIUS, np.where(x > 0, 1, 2), np.where(radius < 26, 3, 0)).astype(np.uint8)
    place = np.diag([*SPACING, 1.0])
    place[:3, 3] = -size * SPACING / 2
    place = inputs.turned(place, degrees)
    place[:3, 3] += MIDDLE
    return found.transpose(2, 1, 0).copy(), place


NAMES = {1: "Left lobe", 2: "Right lobe", 3: "Body"}


class Files(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        os.chdir(directory.name)

    def check_map(self, found, place, values, tolerance=1e-4):
        """Checks that the map has the voxels of two_halves in the right places, whatever the order of its axes."""
        for name, value in values.items():
            mask = found.mask(name)
            self.assertEqual(np.count_nonzero(mask), np.count_nonzero(self.labels == value), name)
            where = found.place[:3] @ np.append(np.argwhere(mask).mean(axis=0)[::-1], 1.0)
            true = place[:3] @ np.append(np.argwhere(self.labels == value).mean(axis=0)[::-1], 1.0)
            self.assertTrue(np.allclose(where, true, atol=tolerance), (name, where, true))

    def test_every_kind_of_label_map_has_its_labels_where_they_are(self):
        self.labels, place = two_halves(20)
        by_name = {name: value for value, name in NAMES.items()}
        nrrd.write_nrrd("a.seg.nrrd", self.labels, place, NAMES, "right-anterior-superior")
        self.check_map(reading.read_image("a.seg.nrrd"), place, by_name)
        nrrd.write_nrrd("b.nrrd", [(self.labels == v).astype(np.uint8) for v in NAMES], place, {(v - 1, 1): name for v, name in NAMES.items()})
        self.check_map(reading.read_image("b.nrrd"), place, by_name)
        inputs.write_seg("c.dcm", self.labels, place, NAMES)
        self.check_map(reading.read_outlines("c.dcm"), place, by_name)
        try:
            inputs.write_nifti("d.nii.gz", self.labels, place)
        except ImportError:
            self.skipTest("nibabel is not installed")
        self.check_map(reading.read_image("d.nii.gz", names=NAMES), place, by_name, 1e-3)     # this format's header stores single-precision numbers
        inputs.write_nifti("e.nii", self.labels, place, np.float32)
        self.check_map(reading.read_image("e.nii"), place, {"1": 1, "2": 2}, 1e-3)

    def test_images_that_end_too_early_are_refused(self):
        """A file may be cut off anywhere, even after the last voxel, inside the checksum that ends a compressed file."""
        self.labels, place = two_halves()
        nrrd.write_nrrd("a.seg.nrrd", self.labels, place, NAMES, "right-anterior-superior")
        inputs.write_seg("b.dcm", self.labels, place, NAMES)
        names = ["a.seg.nrrd", "b.dcm"]
        try:
            inputs.write_nifti("c.nii.gz", self.labels, place)
            inputs.write_nifti("d.nii", self.labels, place)
            names += ["c.nii.gz", "d.nii"]
        except ImportError:
            print("nibabel is not installed: without NIfTI")
        for name in names:
            with open(name, "rb") as file:
                content = file.read()
            for length in (*range(0, len(content), len(content) // 23), *range(len(content) - 12, len(content))):
                with open(f"cut-{name}", "wb") as file:
                    file.write(content[:length])
                with self.assertRaises(trouble.BadFile, msg=f"{name}: {length} of {len(content)} bytes"):
                    reading.read_outlines(f"cut-{name}") if name.endswith(".dcm") else reading.read_image(f"cut-{name}")

    def test_dicom_label_map_with_planes_left_out(self):
        """Segmentation type LABELMAP: a pixel's value is the number of its segment. Only every other plane has a frame, so only the header tells how thick a
        plane is."""
        self.labels, place = two_halves(20)
        self.labels[1::2] = 0
        inputs.write_seg("a.dcm", self.labels, place, NAMES)
        data = pydicom.dcmread("a.dcm")
        planes = np.flatnonzero(self.labels.any(axis=(1, 2)))
        frames = []
        for k in planes:
            frame, position = pydicom.Dataset(), pydicom.Dataset()
            position.ImagePositionPatient = [f"{v:.9g}" for v in place[:3] @ [0, 0, k, 1]]
            frame.PlanePositionSequence = pydicom.Sequence([position])
            frames.append(frame)
        data.SegmentationType, data.PerFrameFunctionalGroupsSequence, data.NumberOfFrames = "LABELMAP", pydicom.Sequence(frames), len(frames)
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelData = 8, 8, 7, self.labels[planes].tobytes()
        data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].SpacingBetweenSlices = SPACING[2]
        data.save_as("b.dcm")
        self.check_map(reading.read_outlines("b.dcm"), place, {name: value for value, name in NAMES.items()})
        del data.SharedFunctionalGroupsSequence[0].PlaneOrientationSequence
        data.save_as("c.dcm")
        with self.assertRaisesRegex(trouble.BadFile, "c.dcm: .* no place in the patient"):
            reading.read_outlines("c.dcm")

    def test_a_code_of_3d_slicer(self):
        """Codes in the form written by 3D Slicer 5, with the anatomic region after the type."""
        found, place = two_halves()
        nrrd.write_nrrd("x.seg.nrrd", found, place, {1: "Segment_1"})
        with open("x.seg.nrrd", "rb") as file:
            content = file.read()
        entry = b"Segment0_Tags:=TerminologyEntry:General Anatomy list~SCT^1^Tissue~SCT^41216001^Prostate~^^~Anatomic codes~^^~^^|Segmentation.Status:x|\nSegment0_Name"
        with open("x.seg.nrrd", "wb") as file:
            file.write(content.replace(b"Segment0_Name", entry))
        self.assertEqual(reading.read_image("x.seg.nrrd").segments["Segment_1"].code, "SCT 41216001 Prostate")

    def test_a_missing_package_is_named(self):
        with unittest.mock.patch.dict(modules, {"nibabel": None}):
            open("x.nii", "wb").close()
            with self.assertRaisesRegex(trouble.BadFile, "x.nii.*apt install python3-nibabel"):
                reading.read_image("x.nii")

    def test_frames_and_units_of_surfaces(self):
        shell = approach_sphere(MIDDLE, 15.0)
        for name, frame, scale, options_ in (("a.stl", "LPS", 1.0, {}), ("b.vtk", "RAS", 1.0, {}), ("c.obj", "RAS", 0.1, {"frame": "RAS"}),
                                             ("d.vtp", "LPS", 0.001, {})):
            inputs.write_surface(name, shells.Shell(shell.points * scale, shell.triangles), frame)
            found, _ = reading.read_surface(name, 1 / scale, **options_)
            self.assertTrue(np.allclose(found.centre(), MIDDLE, atol=0.05), (name, found.centre()))
            self.assertAlmostEqual(found.volume() / shell.volume(), 1, delta=1e-3, msg=name)

    def test_cells_with_labels(self):
        mesh = quality.Mesh(*two_boxes())
        for name in ("a.vtu", "b.vtk"):
            inputs.write_cells(name, mesh)
            self.assertFalse(reading.is_surface(name))
            found = reading.read_mesh(name, "cm", "LPS", names={1: "low"})
            self.assertEqual(list(found), ["low", "2"])
            for surface, _ in found.values():
                self.assertAlmostEqual(surface.signed_volume(), 1e3)      # 1 cm^3 is 1e3 mm^3
        with self.assertRaisesRegex(trouble.BadFile, "no labels \"x\"; they have: Label"):
            reading.read_mesh("a.vtu", array="x")

    def test_a_gmsh_mesh_of_second_order(self):
        for order in (1, 2):
            session.start()
            box = meshing.gmsh.model.occ.addBox(0, 0, 0, 3, 4, 5)
            meshing.gmsh.model.occ.synchronize()
            meshing.gmsh.model.addPhysicalGroup(3, [box], 7)
            meshing.gmsh.model.setPhysicalName(3, 7, "gland")
            meshing.gmsh.model.mesh.generate(3)
            meshing.gmsh.model.mesh.setOrder(order)
            nodes = len(meshing.gmsh.model.mesh.getNodes()[0])
            meshing.gmsh.write("x.msh")
            surface, _ = reading.read_mesh("x.msh", "cm", "LPS")["gland"]
            self.assertAlmostEqual(surface.signed_volume(), 60e3, places=6)     # mm^3
            self.assertTrue(np.allclose(surface.centre(), [15, 20, 25]))
            self.assertEqual(len(surface.points) < nodes / 3, order == 2)     # of second-order elements, only the corner nodes are kept

    def test_files_that_cannot_be_used_say_why(self):
        found, place = two_halves()
        cases = {"empty.nrrd": np.zeros_like(found), "flat.nrrd": found[15:16]}
        for name, values in cases.items():
            nrrd.write_nrrd(name, values, place)
        nrrd.write_nrrd("whole.nrrd", found, place)
        with open("whole.nrrd", "rb") as file:
            content = file.read()
        wrong = {"cut.nrrd": content[:-200], "kind.nrrd": b"GIF89a" + content, "no.nrrd": content.replace(b"space directions", b"space conditions"),
                 "far.nrrd": content.replace(b"encoding: gzip", b"encoding: hex"), "x.csv": b"", "x.gif": b"", "half.nrrd": content[:150],
                 "zero.nrrd": content.replace(b"(1,0,0)", b"(0,0,0)")}
        for name, changed in wrong.items():
            with open(name, "wb") as file:
                file.write(changed)
        words = {"empty.nrrd": "no label", "flat.nrrd": "three axes", "cut.nrrd": "cut off", "kind.nrrd": "not a NRRD", "no.nrrd": "directions", "far.nrrd": "gzip, bzip2 or raw",
                 "half.nrrd": "no end", "x.gif": "unknown file type", "zero.nrrd": "how large its voxels are"}
        for name, word in words.items():
            with self.assertRaisesRegex(trouble.BadFile, f"^{name}: .*{word}"):
                reading.read_image(name)

    def test_values_of_a_nrrd_file_beside_it_and_packed_by_bzip2(self):
        self.labels, place = two_halves(20)
        nrrd.write_nrrd("a.nrrd", self.labels, place)
        with open("a.nrrd", "rb") as file:
            head, data = file.read().split(b"\n\n", 1)
        by_number = {str(value): value for value in NAMES}
        for name, content in (("b.nhdr", head + b"\ndata file: b.raw.gz\n"), ("c.nrrd", head.replace(b"gzip", b"bzip2") + b"\n\n" + bz2.compress(gzip.decompress(data)))):
            with open(name, "wb") as file:
                file.write(content)
        with self.assertRaisesRegex(trouble.BadFile, "b.nhdr: .*b.raw.gz, beside it"):
            reading.read_image("b.nhdr")
        with open("b.raw.gz", "wb") as file:
            file.write(data)
        for name in ("b.nhdr", "c.nrrd"):
            self.check_map(reading.read_image(name), place, by_number)
        for named, words in (("my scan %.raw.gz", None), ("slice%03d.raw 1 9 1", "several files"), ("LIST", "several files"), ("my other.raw", "my other.raw, beside it")):
            with open("d.nhdr", "wb") as file:
                file.write(head + f"\ndata file: {named}\n".encode())
            if words:
                with self.assertRaisesRegex(trouble.BadFile, f"d.nhdr: .*{words}"):
                    reading.read_image("d.nhdr")
            else:
                os.rename("b.raw.gz", named)
                self.check_map(reading.read_image("d.nhdr"), place, by_number)

    def test_packed_values_of_a_nrrd_file_in_several_streams(self):
        self.labels, place = two_halves(20)
        nrrd.write_nrrd("a.nrrd", self.labels, place)
        with open("a.nrrd", "rb") as file:
            head, data = file.read().split(b"\n\n", 1)
        values = gzip.decompress(data)
        for name, module in (("gzip", gzip), ("bzip2", bz2)):
            packed = b"".join(module.compress(values[start:start + 20000]) for start in range(0, len(values), 20000))
            for content, whole in ((packed, True), (packed[:-30], False)):
                with open("b.nrrd", "wb") as file:
                    file.write(head.replace(b"gzip", name.encode()) + b"\n\n" + content)
                if whole:
                    self.check_map(reading.read_image("b.nrrd"), place, {str(value): value for value in NAMES})
                else:
                    with self.assertRaisesRegex(trouble.BadFile, "b.nrrd: cut off"):
                        reading.read_image("b.nrrd")

    def test_names_of_labels(self):
        for content, path in (('{"labels": {"background": 0, "Prostate": 1, "Rectum": 2}}', "a.json"), ("# ITK-SNAP\n1 255 0 0 1 1 1 \"Prostate\"\n2 0 255 0 1 1 1 \"Rectum\"\n", "b.txt"),
                              ("number,name\n1,Prostate\n2,Rectum\n", "c.csv")):
            with open(path, "w", encoding="utf-8") as file:
                file.write(content)
            found = voxels.read_names(path)
            self.assertEqual({k: v for k, v in found.items() if k}, {1: "Prostate", 2: "Rectum"}, path)
        alike = voxels.numbered(two_halves()[0], {1: "Lobe", 2: "Lobe"})
        self.assertEqual({name: segment.value for name, segment in alike.items()}, {"Lobe": 1, "Lobe (2)": 2, "3": 3})

    def test_own_materials(self):
        with open("m.csv", "w", encoding="utf-8") as file:
            file.write("name,youngs_modulus,puncture_force\nLeft lobe,7e3,0.4\nliver,,.5\n")
        own = materials.read("m.csv")
        lobe, liver = (materials.find(name, "", own) for name in ("left_LOBE", "Liver"))
        self.assertEqual((lobe.material.modulus, lobe.material.wall, lobe.basis), (7e3, 0.4, "given"))
        self.assertEqual((liver.material.modulus, liver.material.wall), (materials.LIVER_FIT, 0.5))
        for content, word in (("name,stiffness\nx,1\n", "header"), ("name,youngs_modulus\nx,soft\n", "m.csv:2"), ("name,youngs_modulus\nx,0\n", "too small"),
                              ("name,friction_static\nx,1\n", "kinetic")):
            with open("m.csv", "w", encoding="utf-8") as file:
                file.write(content)
            with self.assertRaisesRegex(trouble.BadFile, word):
                materials.read("m.csv")


def approach_sphere(centre, radius):
    import vtk
    source = vtk.vtkSphereSource()
    source.SetCenter(*centre)
    source.SetRadius(radius)
    source.SetThetaResolution(40)
    source.SetPhiResolution(40)
    source.Update()
    return shells.from_vtk(source.GetOutput())


def two_boxes():
    """Two unit cubes, one on top of the other, made of tetrahedra."""
    points = np.array([[x, y, z] for z in (0, 1, 2) for y in (0, 1) for x in (0, 1)], float)
    cube = [[0, 1, 3, 7], [0, 1, 7, 5], [0, 5, 7, 4], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7]]
    tets = np.array([[n + 4 * k for n in tet] for k in (0, 1) for tet in cube])
    tets[::3, :2] = tets[::3, 1::-1]    # inverts every third tetrahedron, as happens in real files
    return points, tets, np.repeat([0, 1], 6), ["low", "high"]


class Names(unittest.TestCase):
    def test_organs_are_found_by_name_and_code(self):
        for name, kind, row in (("urinary_bladder", "", "bladder"), ("Kidney_Left", "", "kidney"), ("CTV prostate", "", "prostate"), ("Segment 1", "41216001 Prostate", "prostate"),
                                ("gluteus_maximus_left", "", "muscle"), ("Segment 2", "10200004", "liver"), ("PTV", "", None), ("adrenal_gland_right", "", "adrenal gland"), ("renal_vein", "", "blood vessel"),
                                ("hepatic_vessels", "", "blood vessel"), ("liver_lesions", "", "tumour"), ("kidney_cyst_left", "", "fluid"), ("lung_upper_lobe_left", "", "lung"),
                                ("subcutaneous_fat", "", "fat"), ("brain", "", "brain"), ("heart", "", "heart"), ("breast", "", "breast"), ("masseter_left", "", None)):
            self.assertEqual(materials.known(name, kind), row, name)


class Surfaces(unittest.TestCase):
    def test_labels_that_touch_share_their_surface(self):
        found_labels, place = two_halves(20)
        map_ = voxels.LabelMap([found_labels], place, {name: voxels.Segment(0, v) for v, name in NAMES.items()})
        found = voxels.outlined(map_, ["Left lobe", "Right lobe"])
        for each in found.values():
            self.assertEqual(len(each.shells), 1)
            self.assertGreater(each.shells[0].signed_volume(), 0)
            self.assertAlmostEqual(each.shells[0].volume() / each.volume, 1, delta=0.03)
        self.assertAlmostEqual(sum(each.volume for each in found.values()) / ellipsoid_volume(RADIUS, RADIUS, RADIUS), 1, delta=0.01)
        left, right = (found[name].shells[0] for name in ("Left lobe", "Right lobe"))
        turn = place[:3, 0] / SPACING[0]
        inner = np.abs((left.points - MIDDLE) @ turn) < 1.0       # points on the plane between the two halves
        inner &= np.linalg.norm(left.points - MIDDLE, axis=1) < 0.8 * RADIUS
        self.assertGreater(np.count_nonzero(inner), 50)
        self.assertLess(np.abs(shells.distances(right, left.points[inner])).max(), 0.5 * min(SPACING))     # accurate to a fraction of a voxel
        points = found["Left lobe"].points - MIDDLE
        aside, radius = points @ turn, np.linalg.norm(points, axis=1)
        off = np.where(radius < RADIUS, np.minimum(RADIUS - radius, np.abs(aside)), radius - RADIUS)    # distance from the half ball's surface
        self.assertLess(off.max(), max(SPACING))

    def test_a_cavity_is_no_part_of_a_label(self):
        found_labels, place = two_halves(20)
        map_ = voxels.LabelMap([found_labels], place, {"Wall": voxels.Segment(0, 3)})
        wall = voxels.outlined(map_, ["Wall"])["Wall"]
        self.assertEqual(len(wall.shells), 1)
        self.assertAlmostEqual(wall.shells[0].signed_volume() / wall.volume, 1, delta=0.03)
        found = organ.of_label("Wall", "wall", False, wall)
        self.assertEqual((found.volume, found.volumes, found.notes), (wall.volume, [wall.volume], []))
        image, _ = label_image.image_of([found.shells], 6.0)       # the label image that would be meshed
        self.assertAlmostEqual(image.volume(1) / wall.volume, 1, delta=0.03)

    def test_a_body_has_no_cavities_where_its_organs_are(self):
        found_labels, place = two_halves()
        map_ = voxels.LabelMap([found_labels], place, {name: voxels.Segment(0, v) for v, name in NAMES.items()})
        body = voxels.body_of(map_, "Body")
        skin = pipeline.skin_surfaces(organ.of_label("Body", "body", False, body))
        self.assertEqual(len(skin), 1)
        self.assertAlmostEqual(skin[0].volume() / ellipsoid_volume(26, 26, 26), 1, delta=0.02)


class Approach(unittest.TestCase):
    def test_the_needle_takes_the_nearest_way_past_the_bones(self):
        skin, target = approach_sphere((0, 0, 0), 50.0), np.array([20.0, 0, 0])
        path = approach.through_skin(target, [skin], [])
        self.assertTrue(np.allclose(path.entry, [50, 0, 0], atol=3))
        bone = approach_sphere((35, 0, 0), 8.0)
        path = approach.through_skin(target, [skin], [bone])
        self.assertIsNone(approach.first_hit(bone, path.entry, target))
        self.assertLess(np.linalg.norm(path.entry - target), 45)

    def test_the_skin_of_a_box_is_the_first_face_without_bones_in_the_way(self):
        gland, plate = approach_sphere((0, 0, 0), 15.0), approach_sphere((0, 0, 0), 1.0)
        below = shells.Shell(plate.points * [200, 200, 4] + [0, 0, -30], plate.triangles)
        path, low, high, face = pipeline.path_and_block([gland], [below], [], pipeline.Plan())
        self.assertEqual((face, path.entry.tolist()), ((1, -1), [0, low[1], 0]))
        self.assertIsNone(approach.first_hit(below, path.entry, path.target))
        path, low, high, face = pipeline.path_and_block([gland], [], [], pipeline.Plan())
        self.assertEqual((face, path.entry.tolist()), ((2, -1), [0, 0, low[2]]))
        around = approach_sphere((0, 0, 0), 20.0)      # the target is enclosed in a sphere of bone, so no path leads to it
        path, low, high, face = pipeline.path_and_block([gland], [around], [], pipeline.Plan())
        self.assertEqual((face, path.entry.tolist()), ((2, -1), [0, 0, low[2]]))

    def test_the_scripts_stop_at_the_target(self):
        skin = approach_sphere((0, 0, 0), 0.1)
        mesh = quality.Mesh(skin.points, np.array([[0, 1, 2, 3]]), np.array([0]), ["gland"], {"skin": skin})
        for depth, length in ((0.04, 0.2), (0.08, 0.2), (0.195, 0.2), (0.205, 0.25)):
            target = np.array([0, 0, -0.1 + depth])
            start = approach.start_in(mesh, np.array([0, 0, -0.1]), target, "gland")
            self.assertLess(np.linalg.norm(start.position + [0, 0, start.length + start.depth] - target), 1e-6)
            self.assertIn(f"depth: {depth + 0.001:.4f}", "\n".join(sum(scene.place(np.eye(4), start), [])))
            self.assertAlmostEqual(start.length, length)
            self.assertAlmostEqual(np.linalg.norm(start.position - start.entry), 0.001 + length)

    def test_the_base_of_the_needle_never_has_to_pass_the_template(self):
        """Scripted motions push the needle until its tip is at the target. Its base must then still be in front of the template's plate."""
        skin = approach_sphere((0, 0, 0), 0.1)
        mesh = quality.Mesh(skin.points, np.array([[0, 1, 2, 3]]), np.array([0]), ["gland"], {"skin": skin})
        for depth, before, wanted in ((0.04, 0.05, 0.2), (0.16, 0.025, 0.2), (0.16, 0.05, 0.25), (0.04, 0.3, 0.35)):
            face, way = np.array([0.03, 0.02, -0.1 - before]), np.array([0, 0, 1.0])
            start = approach.start_in(mesh, np.array([0, 0, -0.1]), np.array([0, 0, -0.1 + depth]), "gland", face)
            self.assertAlmostEqual(start.length, wanted)
            self.assertLessEqual((start.position + start.depth * way - face) @ way, 0)
            self.assertAlmostEqual((start.position + (start.length + start.depth) * way - start.entry) @ way, depth, delta=1e-7)      # VTK: single precision
        for face, words in ((None, "500 mm below the skin, and no needle .* move --entry or --target"),
                            (np.array([0, 0, -0.13]), "500 mm below the skin, that is 30 mm beyond the template, .* move --template or --target")):
            with self.assertRaisesRegex(contours.Unusable, words):
                approach.needle_for(np.array([0, 0, -0.1]), np.array([0, 0, 0.4]), face)

    def test_a_target_too_deep_for_any_needle_is_refused_before_the_mesh_is_made(self):
        gland = organ.of_surface("Gland", "gland", False, approach_sphere((0, 0, 0), 15.0))
        plan = pipeline.Plan(entry=np.array([0.0, 0, -520]))
        with unittest.mock.patch.object(meshing, "generate", side_effect=AssertionError), self.assertRaisesRegex(contours.Unusable, "520 mm below the skin"):
            pipeline.mesh_of([gland], 570, None, "x.msh", plan=plan)

    def test_the_orientation_turns_z_into_the_direction(self):
        for direction in ([0, 0, 1], [0, 0, -1], [1, 0, 0], [0.6, -0.8, 0], [-0.36, 0.48, -0.8]):
            w, x, y, z = approach.orientation(np.array(direction, float))
            turned = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
            self.assertTrue(np.allclose(turned, direction, atol=1e-9), direction)
            self.assertAlmostEqual(w * w + x * x + y * y + z * z, 1)

    def test_the_middle_of_a_hollow_region_is_in_it(self):
        outer, inner = approach_sphere((0, 0, 0), 30.0), approach_sphere((0, 0, 0), 22.0)
        hollow = shells.Shell(np.vstack([outer.points, inner.points]), np.vstack([outer.triangles, inner.triangles[:, ::-1] + len(outer.points)]))
        self.assertAlmostEqual(np.linalg.norm(approach.middle_of([hollow])), 26, delta=2)

    def test_patient_coordinates_go_to_the_mesh_and_back(self):
        origin, points = np.array([3.0, -40, 200]), np.array([[1.0, 2, 3], [-50, 60, 7]])
        matrix = pipeline.patient_to_mesh(origin)
        self.assertTrue(np.allclose(np.column_stack([points, np.ones(2)]) @ matrix.T[:, :3], pipeline.world(points, origin)))
        self.assertTrue(np.allclose(pipeline.patient(pipeline.world(points, origin), origin), points))


class Whole(unittest.TestCase):
    """Tests the command on label maps."""

    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        os.chdir(directory.name)
        patch = unittest.mock.patch.object(meshing, "TRIES", 3)     # limits the search for better angles, which takes long
        patch.start()
        self.addCleanup(patch.stop)

    def make(self, *arguments):
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            return command.run(options.parse(arguments))

    def test_two_lobes_under_the_skin_of_a_body(self):
        found, place = two_halves()
        nrrd.write_nrrd("x.seg.nrrd", found, place, NAMES)
        organs, mesh, domain, outlined = self.make("x.seg.nrrd", "--roi", "Left lobe", "--roi", "Right lobe", "--skin", "Body", "--nodes", "700", "--output", "x",
                                                   f"--entry={MIDDLE[0] + 26},{MIDDLE[1]},{MIDDLE[2]}")
        for organ in organs:
            self.assertAlmostEqual(mesh.region_volume(organ.name) * 1e9 / organ.read, 1, delta=0.01)
            self.assertNotIn("overlap", " ".join(organ.notes))      # labels in a single layer cannot overlap
        sides = {name: {tuple(sorted(t)) for t in mesh.boundary(name).triangles.tolist()} for name in ("left_lobe", "right_lobe")}
        shared = sides["left_lobe"] & sides["right_lobe"]
        middle = np.array([mesh.points[list(t)].mean(axis=0) for t in shared])
        area = sum(np.linalg.norm(np.cross(mesh.points[b] - mesh.points[a], mesh.points[c] - mesh.points[a])) / 2 for a, b, c in shared) * 1e6
        self.assertAlmostEqual(area / (np.pi * RADIUS ** 2), 1, delta=0.1)      # the whole disk between the halves, without a gap
        self.assertLess(np.abs(pipeline.patient(middle, domain.origin)[:, 0] - MIDDLE[0]).max(), 2.5)
        whole = sum(mesh.region_volume(name) for name in mesh.regions) * 1e9
        self.assertAlmostEqual(whole / ellipsoid_volume(26, 26, 26), 1, delta=0.03)     # only the body
        start = approach.start_in(mesh, *domain.path, "left_lobe")
        self.assertTrue(np.allclose(start.position, domain.path[0] + [-0.201, 0, 0], atol=3e-3) or start.position[0] < -0.19)
        text = open("x.yaml", encoding="utf-8").read()
        self.assertRegex(text, r"patient_to_mesh: \[-0.001, 0, 0, ")
        self.assertRegex(text, r"start: \{position: \[")
        self.assertIn("left_lobe_wall", text)
        self.assertNotIn("capsule", text)
        self.assertRegex(open("x-quality.md", encoding="utf-8").read(), r"\| Left lobe \| 11\.62 \| 11\.62 \(.0\.0 %\)")

    def test_twenty_small_lesions(self):
        spacing, size, radius = 1.0, 90, 4.0
        axes = np.meshgrid(*[(np.arange(size) - size / 2) * spacing] * 3, indexing="ij")
        found = np.where(sum(axis ** 2 for axis in axes) < 42 ** 2, 1, 0).astype(np.uint8)
        golden = np.pi * (3 - np.sqrt(5))       # spreads the lesions evenly over a sphere, about 12 mm apart
        for k in range(20):
            z = 24 * (1 - (2 * k + 1) / 20)
            middle = np.sqrt(24 ** 2 - z ** 2) * np.cos(golden * k), np.sqrt(24 ** 2 - z ** 2) * np.sin(golden * k), z
            found[sum((axis - m) ** 2 for axis, m in zip(axes, middle)) < radius ** 2] = 2 + k
        names = {1: "Liver", **{2 + k: f"Lesion {k + 1}" for k in range(20)}}
        nrrd.write_nrrd("x.seg.nrrd", found.transpose(2, 1, 0).copy(), np.diag([spacing] * 3 + [1.0]), names)
        organs, mesh, _, _ = self.make("x.seg.nrrd", *[word for name in names.values() for word in ("--roi", name)], "--nodes", "3000", "--output", "x")
        self.assertEqual(len(organs), 21)
        for k in range(20):
            voxels_of = np.count_nonzero(found == 2 + k) * spacing ** 3
            self.assertAlmostEqual(mesh.region_volume(f"lesion_{k + 1}") * 1e9 / voxels_of, 1, delta=0.05)

    def start_of(self, scene):
        """Returns the position and direction of the needle's base."""
        words = re.search(r"start: \{position: \[(.*?)\], orientation: \[(.*?)\]", open(scene, encoding="utf-8").read())
        position, (w, x, y, z) = (np.array([float(v) for v in text.split(",")]) for text in words.groups())
        return position, np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])

    def test_the_skin_of_a_box_is_the_face_of_the_entry_and_the_mesh_says_where_the_patient_is(self):
        found, place = two_halves()
        nrrd.write_nrrd("x.seg.nrrd", found, place, NAMES)
        target = MIDDLE + [9, 0, 0]
        entry = target + [3, 48, 5]         # from the back
        _, mesh, domain, _ = self.make("x.seg.nrrd", "--roi", "Left lobe", "--nodes", "500", "--output", "x", "--entry=" + ",".join(map(str, entry)),
                                       "--target=" + ",".join(map(str, target)))
        skin = mesh.points[np.unique(mesh.surfaces["skin"].triangles)]
        self.assertLess(np.abs(pipeline.patient(skin, domain.origin)[:, 1] - entry[1]).max(), 1e-6)
        position, way = self.start_of("x.yaml")
        aim = (target - entry) * [-1, -1, 1] / np.linalg.norm(target - entry)
        self.assertTrue(np.allclose(way, aim, atol=1e-6))
        self.assertTrue(np.allclose(position + 0.201 * aim, pipeline.world(entry, domain.origin), atol=1e-6))
        for held in meshing.fixed_faces("y-"):
            self.assertNotEqual(held, "y-")
        self.assertEqual([meshing.fixed_faces(front) for front in ("z-", "z+", "x+")], [["z+", "y-"], ["z-", "y-"], ["y-", "x-"]])
        session.start()
        again, _ = reading.read_mesh("x.msh")["left_lobe"]       # in patient coordinates
        self.assertAlmostEqual(again.volume() / mesh.region_volume("left_lobe"), 1e9, delta=1e4)
        self.assertLess(np.linalg.norm(again.centre() - target), 1.5)
        unmoved, _ = reading.read_mesh("x.msh", "m", "LPS")["left_lobe"]
        self.assertLess(np.linalg.norm(pipeline.world(again.centre(), domain.origin) * 1e3 - unmoved.centre()), 1e-3)

    def test_an_entry_in_the_region_is_moved_to_the_skin_which_is_told_and_labels_have_a_picture(self):
        found, place = two_halves()
        nrrd.write_nrrd("x.seg.nrrd", found, place, NAMES)
        entry, target = MIDDLE + [9, 0, -4], MIDDLE + [9, 0, 2]
        organs, _, domain, _ = self.make("x.seg.nrrd", "--roi", "Left lobe", "--nodes", "500", "--output", "x", "--entry=" + ",".join(map(str, entry)),
                                         "--target=" + ",".join(map(str, target)), "--picture", "x.svg")
        position, way = self.start_of("x.yaml")
        skin = pipeline.patient(position + 0.201 * way, domain.origin)
        self.assertIn(f"the needle enters the skin {np.linalg.norm(skin - entry):.1f} mm from --entry", " ".join(organs[0].notes))
        self.assertGreater(np.linalg.norm(skin - entry), 5)
        self.assertIn("Left lobe", open("x.svg", encoding="utf-8").read())

    def test_the_needle_starts_in_a_hole_of_the_template(self):
        found, place = two_halves()
        nrrd.write_nrrd("x.seg.nrrd", found, place, NAMES)
        _, _, domain, _ = self.make("x.seg.nrrd", "--roi", "Left lobe", "--nodes", "500", "--output", "x",
                                    "--template=" + ",".join(map(str, MIDDLE + [1, 2, -80])))
        position, way = self.start_of("x.yaml")
        self.assertTrue(np.allclose(way, [0, 0, 1]))
        hole = pipeline.patient(position, domain.origin) - (MIDDLE + [1, 2, -80])
        self.assertTrue(np.allclose(hole[:2] / 5, np.rint(hole[:2] / 5), atol=1e-4))     # holes are 5 mm apart
        self.assertLess(np.abs(pipeline.patient(position, domain.origin)[:2] - (MIDDLE[:2] + [9, 0])).max(), 3.0)      # the nearest
        text = open("x.yaml", encoding="utf-8").read()
        self.assertRegex(text, r"guides:\n  - name: template\n    origin: \[")
        with self.assertRaisesRegex(Exception, "move --template"):
            self.make("x.seg.nrrd", "--roi", "Left lobe", "--output", "x", "--template=" + ",".join(map(str, MIDDLE + [200, 2, -80])))


class Random(unittest.TestCase):
    """Runs two of the maps in label_stress; running them all would take too long."""

    def test_random_maps_are_meshed_or_refused_with_a_cause(self):
        with tempfile.TemporaryDirectory() as folder, unittest.mock.patch.object(meshing, "TRIES", 2):
            for number in (0, 6):    # in map 6, tetrahedra extend beyond the image
                row, good = label_stress.random_row(number, folder)
                self.assertTrue(good, row)


if __name__ == "__main__":
    session.start()
    unittest.main()
