#!/usr/bin/python3
"""Tests for problems that real scans have revealed, reproduced with shapes of known position and volume: files, names, choice of regions, skin, entry point,
and individual parts. Meshes that take longer are in tests/verification/verify_anatomy.py.
"""
import contextlib
import io
import os
import subprocess
import tempfile
import unittest
import unittest.mock
from sys import executable

import nibabel
import numpy as np
import scipy.ndimage

from anatomy_cases import SOURCE, ellipse, ellipsoid, ellipsoid_volume
from anatomy import __main__ as command, approach, binding, check, limits, losses, materials, meshing, options, organ, pipeline, quality, reading, scene, session, sources, trouble
from anatomy.shapes import contours, labels, shells, voxels
from anatomy.trials import cases, inputs, label_stress, nrrd, torso

LIBRARY = os.path.join(SOURCE, "build/core/libtrocar.so")


class Case(unittest.TestCase):
    def setUp(self):
        directory = tempfile.TemporaryDirectory()
        self.addCleanup(directory.cleanup)
        os.chdir(directory.name)

    def run_(self, *arguments, tries=2):
        """Returns the result of run() and its output on stderr."""
        said = io.StringIO()
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said), unittest.mock.patch.object(meshing, "TRIES", tries):
            made = command.run(options.parse([str(argument) for argument in arguments]))
        return made, said.getvalue()


def ball(size=40, radius=12.0, middle=(0, 0, 0)):
    grid = torso.Grid((1.0, 1.0, 1.0), (-size / 2,) * 3, (size / 2,) * 3)
    return grid.ellipsoid(middle, (radius,) * 3).astype(np.uint8), grid.place


class Names(Case):
    def test_names_in_the_files_of_totalsegmentator(self):
        labels_, place = ball()
        inputs.write_nifti("total.nii.gz", labels_ * 5, place, names={5: "liver", 6: "stomach & co"})
        self.assertEqual(list(reading.read_image("total.nii.gz").segments), ["liver"])
        self.assertIn(b"<![CDATA[liver]]>", nibabel.load("total.nii.gz").header.extensions[0].get_content())
        both = '<Label Key="1" Red="1"><![CDATA[a < b]]></Label><Label Key="2">c &amp; d</Label><Label Red="0" Key="3"></Label>'

        class Image:
            class header:
                extensions = [nibabel.nifti1.Nifti1Extension(0, both.encode())]
        self.assertEqual(voxels.names_in(Image), {1: "a < b", 2: "c & d"})

    def test_regions_by_pattern_and_all_of_them(self):
        found = sources.Sources(dict.fromkeys(["liver", "rib_left_7", "rib_right_7", "spleen", "body_trunc", "hip_left"]))

        def chosen(*arguments):
            with contextlib.redirect_stderr(io.StringIO()):
                return sources.choose(options.parse(["x.nii.gz", *arguments]), found)
        some = chosen("--roi", "Spleen", "--roi", "l*", "--bone", "rib_*")
        self.assertEqual((some.soft, some.bones, some.body), (["Spleen"] if "Spleen" in found.regions else ["spleen", "liver"], ["rib_left_7", "rib_right_7"], None))
        whole = chosen("--roi", "liver", "--all")
        self.assertEqual((whole.soft, whole.bones, whole.body), (["liver", "spleen"], ["rib_left_7", "rib_right_7", "hip_left"], "body_trunc"))
        with self.assertRaisesRegex(trouble.BadFile, r'no region "livr" \(perhaps liver\)'):
            chosen("--roi", "livr")
        with self.assertRaisesRegex(trouble.BadFile, "no region \"lung_\\*\""):
            chosen("--roi", "lung_*")

    def test_progress_is_told_unless_it_is_not_wanted(self):
        with unittest.mock.patch.object(limits, "TELL", True), contextlib.redirect_stderr(io.StringIO()) as said:
            limits.run("a stage", int)
        self.assertRegex(said.getvalue(), "anatomy: [0-9]+ s: a stage")
        self.assertFalse(options.parse(["x"]).quiet)

    def test_materials_say_where_they_are_from(self):
        lines = "\n".join(quality.used({name: materials.find(name) for name in ("liver", "1", "fat")}))
        self.assertRegex(lines, r"\| liver \| liver \| 31 \| 0.25 \| 0.9 \| cited: ")
        self.assertRegex(lines, r"\| 1 \| any other \| 30 \| 0.25 \|  \| guess: ")
        self.assertRegex(lines, r"\| fat \| fat \| 3.2 ")
        self.assertRegex(lines, r"\| liver .*\| bovine, Okamura et al. 2004 \|")
        self.assertIn("No published force on a needle was found for 1, fat:", lines)
        remarks = command.remarks_on_materials({"1": materials.find("1"), "heart": materials.find("heart"), "liver": materials.find("liver")})
        self.assertEqual(len(remarks), 2)
        self.assertIn("1, heart: a guess", remarks[0])
        self.assertIn("no material is known for 1:", remarks[1])

    def test_a_lone_label_of_a_file_has_the_files_name(self):
        labels_, place = ball()
        inputs.write_nifti("kidney_left.nii.gz", labels_, place)
        self.assertEqual(list(reading.read_image("kidney_left.nii.gz").segments), ["kidney_left"])


OLD_SLICER = """NRRD0004
type: unsigned char
dimension: 4
space: left-posterior-superior
sizes: {sizes}
space directions: {axes}
kinds: {kinds}
endian: little
encoding: raw
space origin: {origin}
Segment0_ID:=Segment_1
Segment0_Name:=Liver
Segment0_LabelValue:=1
Segmentation_Extent:={extent}

"""


def write_old_nrrd(path, labels_, origin, extent, first=True, name="Liver", four=False):
    """Writes a segmentation as 3D Slicer 4.6 does, with a segment axis of length 1 and data that start at Segmentation_Extent. With `first`, the segment axis
    comes first. With `four`, all directions have four coordinates."""
    sizes = list(map(str, labels_.shape[::-1]))
    axes, nothing = (["(1,0,0,0)", "(0,1,0,0)", "(0,0,1,0)"], "(0,0,0,1)") if four else (["(1,0,0)", "(0,1,0)", "(0,0,1)"], "none")
    fields = {"sizes": " ".join(["1", *sizes] if first else [*sizes, "1"]), "axes": " ".join([nothing, *axes] if first else [*axes, nothing]),
              "kinds": "vector domain domain domain", "origin": "(" + ",".join(map(str, [*origin, *([0] if four else [])])) + ")", "extent": " ".join(map(str, extent))}
    with open(path, "wb") as file:
        file.write(OLD_SLICER.format(**fields).replace("Liver", name).encode() + labels_.tobytes())


class Files(Case):
    def test_segmentations_of_older_slicers(self):
        labels_, _ = ball(20, 6.0)
        for number, (first, four) in enumerate(((True, False), (False, False), (True, True), (False, True))):
            write_old_nrrd(f"{number}.seg.nrrd", labels_, (-100, -90, 50), (30, 49, 40, 59, 7, 26), first, four=four)
            map_ = reading.read_image(f"{number}.seg.nrrd")
            self.assertEqual(list(map_.segments), ["Liver"])
            middle = map_.place[:3] @ np.append(np.argwhere(map_.mask("Liver")).mean(axis=0)[::-1], 1.0)
            self.assertTrue(np.allclose(middle, [-100 + 30 + 10, -90 + 40 + 10, 50 + 7 + 10], atol=1e-6), middle)
        write_old_nrrd("odd.seg.nrrd", labels_, (0, 0, 0), (0, 5, 0, 5, 0, 5))
        self.assertIn("Segmentation_Extent does not fit", reading.read_image("odd.seg.nrrd").notes[0])

    def test_maps_of_different_extents_on_one_lattice_are_put_together(self):
        labels_, _ = ball(20, 6.0)
        write_old_nrrd("a.seg.nrrd", labels_, (0, 0, 0), (30, 49, 40, 59, 7, 26))
        write_old_nrrd("b.seg.nrrd", labels_[:, 2:-2], (0, 0, 0), (-12, 7, 4, 19, 30, 49), name="Spleen")
        both = sources.of_maps([(path, reading.read_image) for path in ("a.seg.nrrd", "b.seg.nrrd")], True).map
        for name, middle in (("Liver", (40, 50, 17)), ("Spleen", (-2, 12, 40))):
            found = both.place[:3] @ np.append(np.argwhere(both.mask(name)).mean(axis=0)[::-1], 1.0)
            self.assertTrue(np.allclose(found, middle, atol=1e-6), (name, found))
        write_old_nrrd("c.seg.nrrd", labels_, (0.4, 0, 0), (0, 19, 0, 19, 0, 19))
        with self.assertRaisesRegex(trouble.BadFile, "c.seg.nrrd: its voxels are not those of a.seg.nrrd"):
            sources.of_maps([(path, reading.read_image) for path in ("a.seg.nrrd", "c.seg.nrrd")], True)

    def test_two_transforms_that_disagree_get_a_remark(self):
        labels_, place = ball()
        for apart, notes in ((0.0, 0), (50.0, 1)):
            image = nibabel.Nifti1Image(labels_.T, np.diag([-1.0, -1, 1, 1]) @ place)
            moved = image.affine.copy()
            moved[0, 3] += apart
            image.set_sform(image.affine, 1)
            image.set_qform(moved, 1)
            nibabel.save(image, "x.nii")
            self.assertEqual(len(reading.read_image("x.nii").notes), notes)
        self.assertIn("50.0 mm apart", reading.read_image("x.nii").notes[0])

    def test_values_that_rounding_has_changed_are_labels(self):
        labels_, place = ball()
        inputs.write_nifti("x.nii.gz", labels_ * 1.0000001, place, np.float64)
        self.assertEqual(np.count_nonzero(reading.read_image("x.nii.gz").mask("x")), np.count_nonzero(labels_))
        inputs.write_nifti("y.nii.gz", labels_ * 0.4, place, np.float64)
        with self.assertRaisesRegex(trouble.BadFile, "not whole numbers"):
            reading.read_image("y.nii.gz")

    def test_a_surface_that_is_cut_off_is_called_so(self):
        labels_, place = ball()
        surface = voxels.outlined(voxels.LabelMap([labels_], place, {"x": voxels.Segment(0, 1)}), ["x"])["x"].shells[0]
        for name in ("x.stl", "x.ply"):
            inputs.write_surface(name, surface)
            with open(name, "rb") as file:
                whole = file.read()
            for lost in (8 * 50, len(whole) // 2):
                with open(name, "wb") as file:
                    file.write(whole[:-lost])
                with self.assertRaisesRegex(trouble.BadFile, f"{name}: cut off"):
                    reading.read_surface(name, 1.0)

    def test_a_dicom_folder(self):
        os.mkdir("export")
        labels_, place = ball()
        inputs.write_seg("export/IM0001", labels_, place, {1: "Liver"})
        with open("export/notes.txt", "w", encoding="utf-8") as file:
            file.write("nothing")
        with contextlib.redirect_stdout(io.StringIO()) as said, contextlib.redirect_stderr(io.StringIO()):
            command.run(options.parse(["export", "--list"]))
        self.assertEqual(said.getvalue().split(), ["Liver"])
        os.mkdir("none")
        with self.assertRaisesRegex(trouble.BadFile, "none: has no structure set, segmentation, label map or surface"):
            reading.files_in("none")

    def test_the_output_may_be_a_folder_and_nothing_half_done_is_left(self):
        os.mkdir("out")
        for given in ("out", "out/"):
            self.assertEqual(command.prefix_of(options.parse(["x", "--output", given])), os.path.join("out", "patient"))

        def full(_given, _organs, _skin, _own, prefix):
            with open(prefix + ".msh", "w", encoding="ascii") as file:
                file.write("$MeshFormat")
            raise OSError(28, "No space left on device", prefix + ".msh")
        labels_, place = ball()
        nrrd.write_nrrd("x.nrrd", labels_, place)
        with unittest.mock.patch.object(command, "make", full), self.assertRaisesRegex(OSError, "No space left"):
            self.run_("x.nrrd", "--output", "out/", "--quiet")
        self.assertEqual(os.listdir("out"), [])

    def test_an_island_of_an_outline_that_is_left_out_is_told(self):
        rings = [*ellipsoid(20, 20, 20, 5), ellipse(0.4, 0.4, 2.5, centre=(40, -3))]
        notes = contours.build_stack("Gland", rings).notes
        self.assertEqual(len(notes), 1)
        self.assertRegex(notes[0], r"slice z = 2.5 mm: 1 outline at \(40, -3\) mm left out")
        self.assertEqual(contours.build_stack("Gland", rings[:-1]).notes, [])

    def test_a_home_folder_that_cannot_be_written_to_causes_no_warning(self):
        said = subprocess.run([executable, "-c", "from anatomy import quality"], env={"PYTHONPATH": os.path.join(SOURCE, "meshes"), "HOME": "/proc/none", "PATH": os.environ["PATH"]},
                              capture_output=True, text=True, check=True)
        self.assertEqual(said.stderr, "")

    def test_a_sheet_of_one_voxel_takes_no_more_memory_than_another_label(self):
        sheet = np.zeros((120, 160, 160), np.uint8)
        sheet[60] = 1
        code = ("import sys, resource, numpy as np\nsys.path.insert(0, sys.argv[1])\nfrom anatomy import organ\nfrom anatomy.shapes import label_image, voxels\n"
                "found = voxels.outlined(voxels.LabelMap([np.load('sheet.npy')], np.eye(4), {'x': voxels.Segment(0, 1)}), ['x'])['x']\n"
                "label_image.image_of([organ.of_label('x', 'x', False, found).shells], 6.0)\nprint(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)")
        np.save("sheet.npy", sheet)
        used = subprocess.run([executable, "-c", code, os.path.join(SOURCE, "meshes")], capture_output=True, text=True, check=True).stdout
        self.assertLess(int(used) / 1024, 800)      # MB; 3700 before


    def test_a_fin_on_a_closed_surface_is_dropped(self):
        labels_, place = ball()
        surface = voxels.outlined(voxels.LabelMap([labels_], place, {"x": voxels.Segment(0, 1)}), ["x"])["x"].shells[0]
        a, b = surface.points[surface.triangles[0, :2]]
        points = np.vstack([surface.points, (a + b) / 2 + [0, 0, 30]])
        fin = [[surface.triangles[0, 0], surface.triangles[0, 1], len(surface.points)]]
        inputs.write_surface("x.stl", shells.Shell(points, np.vstack([surface.triangles, fin])))
        found, notes = reading.read_surface("x.stl", 1.0)
        self.assertIn("1 facets that stick out", " ".join(notes))
        self.assertAlmostEqual(found.volume() / surface.volume(), 1, delta=0.01)

    def test_a_small_region_beside_a_large_one_is_no_other_unit(self):
        def sphere(name, radius, middle=0.0):
            grid = torso.Grid((radius / 6,) * 3, (-1.3 * radius,) * 3, (1.3 * radius,) * 3)
            mask = grid.ellipsoid((0, 0, 0), (radius,) * 3).astype(np.uint8)
            shell = voxels.outlined(voxels.LabelMap([mask], grid.place, {"x": voxels.Segment(0, 1)}), ["x"])["x"].shells[0]
            return organ.of_surface(name, name, False, shells.Shell(shell.points + [middle, 0, 0], shell.triangles))
        lesion, liver = sphere("lesion", 2.5), sphere("liver", 60.0, 30.0)
        organ.check_sizes([lesion, liver], False)
        self.assertTrue(sources.is_large({name: (each.shells[0], []) for name, each in (("lesion", lesion), ("liver", liver))}))
        organ.check_sizes([lesion], True)       # a single lesion, in a file whose unit is known to be mm
        with self.assertRaisesRegex(contours.Unusable, "is the file's unit right"):
            organ.check_sizes([lesion], False)

    def test_a_small_mesh_of_this_program_needs_no_unit(self):
        with open("x.msh", "w", encoding="ascii") as file:
            file.write("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n")
        self.assertFalse(reading.says_where("x.msh"))
        pipeline.write_transform("x.msh", pipeline.patient_to_mesh(np.array([1.0, 2, 3])))
        self.assertTrue(reading.says_where("x.msh"))

    def test_too_little_memory_is_one_line(self):
        def hungry():
            raise MemoryError
        with self.assertRaisesRegex(MemoryError, "mesh of x: this machine's memory does not suffice: choose fewer regions or nodes"):
            limits.run("mesh of x", hungry)
        with unittest.mock.patch.object(command, "run", side_effect=limits.NoMemory("mesh of x: too little")), unittest.mock.patch("sys.argv", ["anatomy", "x"]), \
                contextlib.redirect_stderr(io.StringIO()) as said, self.assertRaises(SystemExit) as ended:
            command.main()
        self.assertEqual((ended.exception.code, said.getvalue()), (2, "anatomy: mesh of x: too little\n"))


class Way(Case):
    def test_the_border_of_the_image_is_no_skin(self):
        """The body extends beyond the image on all sides but the front, and the kidney is close to its back."""
        grid = torso.Grid((2.5, 2.5, 2.5), (-100, -90, -80), (100, 90, 80))
        labels_ = np.zeros(grid.shape, np.uint8)
        labels_[np.broadcast_to(grid.y > -75 + 0.002 * grid.x ** 2, grid.shape)] = 1
        labels_[grid.ellipsoid((55, 50, -10), (25, 24, 40))] = 2
        body = voxels.body_of(voxels.LabelMap([labels_], grid.place, {"Body": voxels.Segment(0, 1), "Kidney": voxels.Segment(0, 2)}), "Body")
        self.assertEqual(len(body.border.normals), 5)
        path = approach.through_skin(np.array([55.0, 50, -10]), body.shells, [], cut=body.border)
        self.assertLess(abs(path.entry[1] - (-75 + 0.002 * path.entry[0] ** 2)), 3.0)      # through the front
        outward = body.border(path.entry[None])[0]
        self.assertGreater(outward, approach.FROM_CUT)
        inside = np.ones((12, 12, 12), np.uint8)
        all_ = voxels.body_of(voxels.LabelMap([inside], np.diag([9.0, 9, 9, 1]), {"Body": voxels.Segment(0, 1)}), "Body")
        with self.assertRaisesRegex(contours.Unusable, "the image cuts off the body on all sides"):
            approach.through_skin(np.array([50.0, 50, 50]), all_.shells, [], cut=all_.border)

    def test_the_target_in_an_organ_is_in_none_of_its_lesions(self):
        """The liver's centre is inside a lesion. In map 94, that lesion touches itself along an edge of voxels; in map 159, another lesion is 0.1 mm away."""
        for number in (94, 159):
            labels_, place, names, _ = label_stress.crowded_map(number, label_stress.SMALL)
            map_ = voxels.LabelMap([labels_], place, {name: voxels.Segment(0, value) for value, name in names.items()})
            liver = organ.of_label("Liver", "liver", False, voxels.outlined(map_, ["Liver", "Lesions"])["Liver"]).shells
            own = labels_ == label_stress.ORGAN
            within = scipy.ndimage.distance_transform_edt(own, np.linalg.norm(place[:3, :3], axis=0)[::-1])

            def room(point, place=place, within=within):
                """mm, from a voxel of the liver to the nearest voxel of another part"""
                return within[tuple(np.rint(np.linalg.solve(place[:3, :3], point - place[:3, 3])).astype(int)[::-1])]
            self.assertLess(room(liver[0].centre()), approach.ASIDE)
            self.assertGreater(room(approach.middle_of(liver)), approach.ASIDE)

    def test_the_needle_keeps_out_of_the_urethra(self):
        def tube(radius, half):
            grid = torso.Grid((1.0, 1.0, 1.0), (-30, -30, -40), (30, 30, 40))
            mask = grid.rod((0, 0, -half), (0, 0, half), radius) if radius < 10 else grid.ellipsoid((0, 0, 0), (24, 20, 18))
            return voxels.outlined(voxels.LabelMap([mask.astype(np.uint8)], grid.place, {"x": voxels.Segment(0, 1)}), ["x"])["x"].shells
        gland, urethra = tube(20, 0), tube(3, 30)
        target = approach.middle_of(gland, urethra)
        self.assertGreater(np.hypot(*target[:2]), 3 + approach.ASIDE)
        self.assertLess(shells.distances(gland[0], target[None])[0], -3)
        self.assertTrue(np.allclose(approach.middle_of(gland), 0, atol=0.6))
        organs = [organ.of_surface(name, name, False, surface[0]) for name, surface in (("prostate", gland), ("urethra", urethra))]
        path = pipeline.path_and_block([gland[0]], [], [urethra[0]], pipeline.Plan(), [urethra[0]])[0]
        along = path.entry + np.linspace(0, 1, 50)[:, None] * (path.target - path.entry)
        self.assertGreater(shells.distances(urethra[0], along).min(), 1.5)
        self.assertTrue(materials.is_spared(organs[1].roi))

    def test_a_templates_columns_begin_on_the_patients_right(self):
        """The template is that of implant.yaml, in whose mesh x also points to the patient's right."""
        plate = approach.Template(np.array([0.0, 0, -60]), np.array([0.0, 0, 1]))
        lines = "\n".join(scene.guide(plate, pipeline.patient_to_mesh(np.zeros(3))))
        self.assertIn("along: [-1, 0, 0]", lines)
        self.assertIn("rows_along: [0, 1, 0]", lines)
        with open(os.path.join(SOURCE, "meshes/implant.yaml"), encoding="utf-8") as file:
            shipped = file.read()
        self.assertIn("along: [-1, 0, 0]", shipped)
        self.assertIn("rows_along: [0, 1, 0]", shipped)


class Parts(Case):
    def test_bones_that_touch_are_one_surface_that_the_library_takes(self):
        """The surface between two hollow bones does not belong to any tetrahedron."""
        for gap in (0, 3):
            arguments = cases.vertebrae(cases.Case("."), gap)
            arguments[arguments.index("--nodes") + 1] = 800
            (_, mesh, _, _), _ = self.run_(*arguments, "--output", f"gap{gap}", "--quiet")
            faces = {tuple(sorted(face)) for tet in mesh.tets.tolist() for face in (tet[:3], tet[1:], tet[:1] + tet[2:], tet[:2] + tet[3:])}
            bone = mesh.surfaces["bone"].triangles
            self.assertTrue({tuple(sorted(triangle)) for triangle in bone.tolist()} <= faces)
            if os.path.exists(LIBRARY):
                self.assertEqual(check.refused(binding.trocar(), os.path.abspath(f"gap{gap}.yaml"), True), "")

    def test_a_scene_that_the_library_refuses_is_not_written(self):
        labels_, place = ball(40, 14.0)
        nrrd.write_nrrd("x.nrrd", labels_, place)
        with unittest.mock.patch.object(binding, "trocar", lambda: None), unittest.mock.patch.object(check, "refused", lambda *_: "no face of any tetrahedron"), \
                self.assertRaisesRegex(contours.Unusable, "the library rejects the scene: no face of any tetrahedron"):
            self.run_("x.nrrd", "--nodes", 300, "--output", "x", "--quiet")
        self.assertEqual(os.listdir("."), ["x.nrrd"])

    def test_a_small_lesion_in_a_gland_is_meshed_whatever_the_order(self):
        for first in ("Lesion", "Prostate"):
            (organs, mesh, _, _), _ = self.run_(*cases.in_prostate(cases.Case("."), 8, 1500, first), "--output", "x", "--quiet")
            lesion = next(each for each in organs if each.roi == "Lesion")
            self.assertAlmostEqual(mesh.region_volume("lesion") * 1e9 / lesion.read, 1, delta=0.05)
            self.assertAlmostEqual(lesion.read / ellipsoid_volume(4, 4, 4), 1, delta=0.1)

    def test_a_lesion_that_is_not_taken_leaves_a_hole_of_its_size(self):
        """The point lies 6.6 mm below the gland's surface."""
        arguments = cases.in_prostate(cases.Case("."), 10, 900, "Prostate")
        del arguments[arguments.index("Lesion") - 1:arguments.index("Lesion") + 1]
        (organs, mesh, domain, outlined), _ = self.run_(*arguments, "--output", "x", "--quiet")
        self.assertAlmostEqual(mesh.region_volume("prostate") / outlined["prostate"], 1, delta=0.01)
        self.assertEqual(sum("in the mesh (" in note for note in organs[0].notes), 0)
        middle = pipeline.world(np.array([10.0, 6, 3]), domain.origin)
        hole = np.linalg.norm(mesh.points[mesh.tets].mean(axis=1) - middle, axis=1) < 5e-3
        self.assertAlmostEqual(mesh.volumes()[hole & (mesh.region == mesh.regions.index("surrounding"))].sum() * 1e9 / ellipsoid_volume(5, 5, 5), 1, delta=0.2)

    def test_voxels_that_share_an_edge_are_one_part_and_those_that_share_a_corner_two(self):
        for apart, parts in (((6, 6, 6), [216, 216]), ((0, 6, 6), [432]), ((0, 0, 6), [432])):
            labels_ = np.zeros((20, 20, 20), np.uint8)
            for k, j, i in ((2, 2, 2), np.add(2, apart)):
                labels_[k:k + 6, j:j + 6, i:i + 6] = 1
            found = voxels.outlined(voxels.LabelMap([labels_], np.eye(4), {"x": voxels.Segment(0, 1)}), ["x"])["x"]
            self.assertEqual(([round(volume) for volume in found.volumes], len(found.shells), found.gone), (parts, len(parts), []))
            notes = " ".join(organ.of_label("x", "x", False, found).notes)
            # if the mesh joins two parts that other programs count separately, the notes mention both
            self.assertEqual("2 parts, of 0.22 ml, 0.22 ml, around" in notes, apart == (0, 6, 6), notes)

    def test_satellites_keep_their_volume_or_are_named(self):
        (organs, mesh, domain, _), said = self.run_(*cases.satellites(cases.Case(".")), "--output", "x")
        labels_ = voxels.read_nrrd("x.seg.nrrd", None, {}, None)
        numbers, true = label_stress.parts_of_map(labels_.layers[0], labels_.place, 1)
        held = label_stress.volumes_in_mesh(mesh, domain, "tumour", numbers, labels_.place)
        self.assertEqual(len(true), 3)
        for volume, got in zip(true, held):
            self.assertTrue(abs(got / volume - 1) <= losses.PART_LOSS or organ.in_ml(volume) in " ".join(organs[0].notes), (volume, got, organs[0].notes))
        with open("x-quality.md", encoding="utf-8") as file:
            report = file.read()
        self.assertEqual(report.count("| Tumour: part at ("), 3)
        self.assertIn("| Tumour: part at (28, ", report)
        self.assertIn("material of", said)

    def test_a_small_part_far_away_is_kept(self):
        """The part has a volume of 0.43 ml, 0.3 % of the bowel it belongs to."""
        grid = torso.Grid((1.5, 1.5, 1.5), (-80, -40, -40), (80, 40, 40))
        labels_ = (grid.ellipsoid((-35, 0, 0), (40, 30, 30)) | grid.ellipsoid((65, 20, 10), (4.7,) * 3)).astype(np.uint8)
        found = voxels.outlined(voxels.LabelMap([labels_], grid.place, {"small_bowel": voxels.Segment(0, 1)}), ["small_bowel"])["small_bowel"]
        made = organ.of_label("small_bowel", "small_bowel", False, found)
        self.assertEqual(len(made.shells), 2)
        self.assertAlmostEqual(made.volumes[1] / ellipsoid_volume(4.7, 4.7, 4.7), 1, delta=0.05)
        self.assertTrue(np.allclose(made.shells[1].centre(), (65, 20, 10), atol=1.0))

    def test_nothing_is_left_of_cells_without_tetrahedra(self):
        found = labels.complex_of(np.zeros((4, 3)), np.array([[0, 1, 2, 3]]), np.zeros(1, int))
        self.assertEqual((len(found.triangles), found.cells), (0, []))

    def test_what_is_too_thin_is_named_before_the_mesh_or_left_out(self):
        grid = torso.Grid((1.0, 1.0, 1.0), (-60, -50, -50), (60, 50, 50))
        labels_ = np.zeros(grid.shape, np.uint8)
        labels_[grid.ellipsoid((-15, 0, 0), (25, 25, 25))] = 1
        labels_[grid.rod((30, -45, -45), (30, 45, 45), 1.2)] = 2
        labels_[grid.rod((45, -45, 0), (45, 45, 0), 1.2)] = 3
        nrrd.write_nrrd("x.seg.nrrd", labels_, grid.place, {1: "Liver", 2: "rib_left_7", 3: "rib_left_8"})
        choice = ["x.seg.nrrd", "--roi", "Liver", "--bone", "rib_*", "--nodes", "300", "--output", "x", "--quiet"]
        with unittest.mock.patch.object(meshing, "generate", side_effect=AssertionError), \
                self.assertRaisesRegex(contours.Unusable, r"more than twice --nodes 300: .* --skip-small: rib_left_[78] \(0\.\d+ ml\), rib"):
            self.run_(*choice)
        (organs, mesh, _, _), _ = self.run_(*choice, "--skip-small")
        self.assertEqual([each.roi for each in organs], ["Liver"])
        self.assertRegex(" ".join(organs[0].notes), r"beside it are left out, because .*: rib_left_[78] \(0\.\d+ ml\)")
        self.assertLess(len(mesh.points), 600)

    def test_one_rib_that_is_too_thin_is_named_in_seconds_and_the_others_stay(self):
        grid = torso.Grid((2.0, 2.0, 2.0), (-60, -50, -50), (60, 50, 50))
        labels_ = (grid.ellipsoid((0, 0, 0), (56, 46, 300))).astype(np.uint8)
        labels_[grid.ellipsoid((-8, 0, 0), (28, 26, 30))] = 2
        for value, (height, radius) in enumerate(((-35, 4.0), (0, 1.5), (35, 4.0)), 3):
            labels_[grid.rod((34, -18, height), (34, 22, height), radius)] = value
        nrrd.write_nrrd("x.seg.nrrd", labels_, grid.place, {1: "Body", 2: "Liver", 3: "rib_left_9", 4: "rib_left_8", 5: "rib_left_7"})
        choice = ["x.seg.nrrd", "--roi", "Liver", "--bone", "rib_*", "--skin", "Body", "--nodes", "360", "--output", "x", "--quiet"]
        with unittest.mock.patch.object(meshing, "generate", side_effect=AssertionError), \
                self.assertRaisesRegex(contours.Unusable, r"raise --nodes to \d+00, or leave out what is too small, with --skip-small: rib_left_8 \(0\.\d+ ml\)$"):
            self.run_(*choice)
        (organs, mesh, _, _), _ = self.run_(*choice, "--skip-small")
        self.assertEqual({each.roi for each in organs}, {"Liver", "rib_left_7", "rib_left_9"})
        self.assertRegex(" ".join(organs[0].notes), r"beside it are left out, because .*: rib_left_8 \(0\.\d+ ml\)")
        self.assertLess(len(mesh.points), 720)


if __name__ == "__main__":
    session.start()
    unittest.main()
