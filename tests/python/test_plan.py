#!/usr/bin/python3
"""Tests plans: the YAML reader, DICOM RT Plans (compared with the readers of dcmtk and dicom3tools), misplacement, and a replayed log with commands.

usage: test_plan.py BUILD_DIR SOURCE_DIR
"""
import contextlib
import io
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
import warnings
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True
import numpy as np
import pydicom

import trocar
from trocar.brachy import _obstacles, _plan_command, plan as plans
from trocar.brachy import rtplan

SCENE, EXAMPLE = SOURCE / "meshes/implant.yaml", SOURCE / "docs/examples/implant-plan.yaml"
MODEL = trocar.Model(trocar.Scene.load(SCENE), mesh_only=True)


def with_guide(**keys):
    """Writes the same scene with a different guide."""
    scene = trocar.Scene.load(SCENE)
    for key, value in keys.items():
        scene[f"guides[0].{key}"] = value
    return trocar.Model(scene, mesh_only=True)


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name)

    def write(self, text, name="plan.yaml"):
        (self.out / name).write_text(text)
        return self.out / name

    def refused(self, words, call, *arguments):
        with self.assertRaises(plans.BadPlan) as caught:
            call(*arguments)
        self.assertRegex(str(caught.exception), words)


class Holes(Case):
    def test_letters_run_from_the_patients_right_and_numbers_from_the_back(self):
        guide, frame = MODEL.guides[0], plans.Frame(MODEL)
        left, posterior, _ = frame.position(plans.hole_axis(guide, "A1")).T
        self.assertAlmostEqual(float(left), -30)
        self.assertAlmostEqual(float(posterior), 30)

    def test_names(self):
        self.assertEqual([plans.hole_name(*at) for at in ((0, 0), (2, 5), (12, 12), (25, 1), (26, 0), (99, 99))], ["A1", "C3.5", "M7", "Z1.5", "AA1", "CV50.5"])
        for column in range(100):
            for row in range(100):
                self.assertEqual(plans.hole_number(plans.hole_name(column, row)), (column, row))
        self.assertEqual(plans.hole_number("C3.0"), (2, 4))
        self.assertEqual(plans.hole_number("c3.5"), (2, 5))
        for wrong in ("", "3C", "C0", "C3.2", "C-1", "C3.", "C 3", "ABC1", "C1e1"):
            self.assertIsNone(plans.hole_number(wrong), wrong)


class Reader(Case):
    def test_the_example(self):
        plan = plans.read(EXAMPLE)
        seeds = plans.planned_seeds(plan, MODEL)
        self.assertEqual((len(plan.needles), len(seeds)), (16, 60))
        self.assertEqual(plans.check(plan, MODEL), {"prostate": 60})
        # Column F is the sixth of 13 columns, 5 mm apart, of which the seventh is in the middle. Row 4 is the seventh of 13 rows. The template's face is at z =
        # -25 mm.
        first = next(s for s in seeds if s.hole == "F4")
        np.testing.assert_allclose(first.position, [0.005, 0.0, -0.025 + 0.09975 - 0.00225], atol=1e-12)
        np.testing.assert_allclose(plans.Frame(MODEL).position(first.position), [-5, 0, 72.5], atol=1e-9)
        np.testing.assert_allclose(plans.Frame(MODEL).to_mesh([-5, 0, 72.5]), first.position, atol=1e-12)

    def test_written_and_read_again(self):
        plan = plans.read(EXAMPLE)
        plan.source.model = 'a "b" \\ c'
        plans.write(plan, self.out / "again.yaml", "two\nlines")
        again = plans.read(self.out / "again.yaml")
        self.assertEqual((again.source, again.prescription), (plan.source, 145.0))
        self.assertEqual([(n.hole, n.depth, n.seeds) for n in again.needles], [(n.hole, n.depth, n.seeds) for n in plan.needles])

    def test_bad_plans_are_refused_with_file_line_and_remedy(self):
        text = EXAMPLE.read_text()
        needle = "{hole: F4, depth: 0.09975, seeds: [0.00225, 0.01225, 0.02725, 0.03725]}"
        first, line = (text[:text.index(begin)].count("\n") + 1 for begin in ("template:", needle))
        self.assertIn(needle, text)
        cases = [
            ("template: template ", "templte: template ", rf":{first}: unknown key \"templte\": there are template, columns"),
            ("rows: 13\n", "", rf":{first}: missing key \"rows\""),
            ("rows: 13", "rows: 13\nrows: 13", rf":{first + 3}: \"rows\" is given twice"),
            ("rows: 13", "rows: 1e9", rf":{first + 2}: rows: \"1e9\": write a whole number from 1 to 100"),
            ("rows: 13", "rows: 2.5", rf":{first + 2}: rows: .* whole number"),
            ("spacing: 5e-3", "spacing: five", rf":{first + 3}: spacing: \"five\": write a number above 0"),
            ("spacing: 5e-3", "spacing: .nan", rf":{first + 3}: spacing: "),
            ("spacing: 5e-3", "spacing: [1]", rf":{first + 3}: spacing: a list: write a number"),
            ("I-125", "I-131", rf":{first + 4}: source.isotope: \"I-131\": there are I-125, Pd-103, Cs-131"),
            ("strength: 0.45", "strength: -1", rf":{first + 4}: source.strength"),
            ("strength: 0.45", "activity: 0.45", rf":{first + 4}: source: unknown key \"activity\""),
            ("prescription: 145", "prescription: 0", rf":{first + 5}: prescription: \"0\": write a number above 0"),
            (needle, needle.replace("F4", "N4"), rf":{line}: needles\[7\].hole: no hole \"N4\": the template has columns A to M, rows 1 to 7 in halves"),
            (needle, needle.replace("F4", "F7.5"), rf":{line}: needles\[7\].hole: no hole \"F7.5\""),
            (needle, needle.replace("F4", "F4.3"), rf":{line}: .*no hole \"F4.3\""),
            (needle, needle.replace("F4", "F3"), rf":{line}: .*F3 is taken by the needle in line {line - 6}"),
            (needle, needle.replace("0.00225", "0.02"), rf":{line}: needles\[7\].seeds\[1\]: 0.01225 m is not behind"),
            (needle, needle.replace("0.03725", "37.25"), rf":{line}: needles\[7\].seeds\[3\]: 37.25 m behind the tip is outside .* in metres"),
            (needle, needle.replace("depth: 0.09975, ", ""), rf":{line}: needles\[7\]: missing key \"depth\""),
            (needle, "F4", rf":{line}: needles\[7\]: write keys and values"),
            (needle, needle.replace("[", "{"), rf":{line}: not YAML"),
            (text[text.index("needles:"):], "needles: []\n", rf":{first + 7}: needles: empty"),
            (text, "", r":1: empty"), (text, "a plan", r":1: a plan: write keys"), (text, "[" * 2000, r"not YAML|too deep"),
        ]
        for old, new, words in cases:
            with self.subTest(new=new[:60]):
                self.refused(r"plan\.yaml" + words, plans.read, self.write(text.replace(old, new, 1)))
        self.refused("nowhere.yaml: cannot be opened", plans.read, self.out / "nowhere.yaml")
        (self.out / "binary.yaml").write_bytes(bytes(range(256)))
        self.refused("binary.yaml: not", plans.read, self.out / "binary.yaml")

    def test_a_fifo_does_not_wait_for_its_writer(self):
        fifo = self.out / "fifo"
        os.mkfifo(fifo)
        for read in (plans.read, lambda path: rtplan.read(path, MODEL), lambda path: plans.read_seeds(path, MODEL)):
            self.refused("fifo: cannot be opened: not a regular file", read, fifo)
            self.refused("none: cannot be opened: No such file or directory", read, self.out / "none")
        self.assertRaisesRegex(trocar.Error, "fifo: cannot open the scene: not a regular file", trocar.Scene.load, fifo)
        scene = trocar.Scene.load(SCENE)
        scene["mesh"] = str(fifo)
        self.assertRaisesRegex(trocar.Error, "fifo: cannot open the mesh: not a regular file", trocar.Model, scene)

    def test_what_does_not_fit_the_scene_is_refused(self):
        text = EXAMPLE.read_text()
        plan = plans.read(EXAMPLE)
        self.refused(r"plan.yaml:\d+: the plan is for the template \"template\"; the scene has plate", plans.planned_seeds, plan, with_guide(name="plate"))
        self.refused(r"plan.yaml:\d+: .*13 x 13 holes, 5 mm apart; the scene's has 13 x 11, 5 mm", plans.planned_seeds, plan, with_guide(rows=11))
        self.refused(r"the scene's has 13 x 13, 4.8 mm", plans.planned_seeds, plan, with_guide(spacing=4.8e-3))
        self.refused(r"the scene has none", plans.planned_seeds, plan, trocar.Model(trocar.Scene.load(SOURCE / "meshes/figure8.yaml"), mesh_only=True))
        for old, new, words in (("depth: 0.09975", "depth: 99.75", r"needle F4: its depth of 99.75 m .* 0.2 m long; lengths are in metres"),
                                ("[0.00225, 0.01225, 0.02725, 0.03725]", "[0.002]", "needle F4: the first seed's centre is 2 mm behind the tip, less than half"),
                                ("[0.00225, 0.01225, 0.02725, 0.03725]", "[0.0025, 0.006]", "needle F4: seeds of 4.5 mm at 2.5 and 6 mm behind the tip overlap"),
                                ("[0.00225, 0.01225, 0.02725, 0.03725]", "[0.00225, 0.0735]", "needle F4: seed 2, 73.5 mm behind the tip, is not in the tissue")):
            with self.subTest(new=new):
                self.refused(words, plans.check, plans.read(self.write(text.replace(old, new, 1))), MODEL)


def dumped(path):
    """Returns what dcmtk reads, as a list of (applicator, position, orientation, relative position) of the control points."""
    found, hole, place = [], None, {}
    for line in subprocess.run(["dcmdump", "+L", path], check=True, capture_output=True, text=True).stdout.splitlines():
        match = re.match(r" *\((300a,\w{4})\) \w\w \[?([^\]#]*?)\]? *#", line)
        if not match:
            continue
        tag, value = match.groups()
        numbers = lambda: [float(v) for v in value.split("\\")]
        if tag == "300a,0291":
            hole = value
        elif tag == "300a,02d2":
            place = {"behind": numbers()[0]}
        elif tag == "300a,02d4":
            place["at"] = numbers()
        elif tag == "300a,0412":
            found.append((hole, place["at"], numbers(), place["behind"]))
    return found


class Package(Case):
    def test_what_a_plan_asks_of_a_model(self):
        np.testing.assert_allclose(MODEL.entry([0.004, 0.003, -0.1], [0.004, 0.003, 0.05]), [0.004, 0.003, 0], atol=1e-9)
        self.assertIsNone(MODEL.entry([0.2, 0, -0.1], [0.2, 0, 0.05]))
        self.assertEqual((MODEL.needle_length, MODEL.seed_size), (0.2, (4.5e-3, 0.8e-3, 10e-3)))
        seed = trocar.Seed(MODEL.nodes[MODEL.tets[5]].mean(axis=0), np.array([0, 0, 1.0]), 0, None, None, 0, 5, np.full(4, 0.25))
        stretched = MODEL.nodes * [0, 0, 0.1] + [1e-3, 0, 0]
        places, directions = MODEL.displaced_seeds([seed], stretched)
        np.testing.assert_allclose(places[0], seed.position * [1, 1, 1.1] + [1e-3, 0, 0], atol=1e-12)
        np.testing.assert_allclose(directions[0], [0, 0, 1], atol=1e-12)
        turned = np.cross([0, 0.3, 0], MODEL.nodes)
        np.testing.assert_allclose(MODEL.displaced_seeds([seed], turned)[1][0], np.array([0.3, 0, 1]) / np.hypot(0.3, 1), atol=1e-9)
        with self.assertRaises(ValueError):
            MODEL.displaced_seeds([seed], stretched[:5])
        with self.assertRaises(ValueError):
            MODEL.displaced_seeds([seed._replace(tet=len(MODEL.tets))], stretched)
        with self.assertRaises(trocar.Error):
            trocar.Sim(MODEL)


class Dicom(Case):
    def exported(self, model=MODEL, structures=None):
        path = self.out / "plan.dcm"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            rtplan.export(plans.read(EXAMPLE), model, path, structures)
        return path

    def test_other_readers_find_the_seeds(self):
        plan = plans.read(EXAMPLE)
        path, seeds = self.exported(), plans.planned_seeds(plan, MODEL)
        points, by_hole = dumped(path), {needle.hole: needle.seeds for needle in plan.needles}
        self.assertEqual(len(points), 2 * len(seeds))
        for i, seed in enumerate(seeds):
            for hole, at, along, behind in points[2 * i:2 * i + 2]:
                self.assertEqual(hole, seed.hole)
                np.testing.assert_allclose(at, [-1e3, -1e3, 1e3] * seed.position, atol=1e-4)
                np.testing.assert_allclose(along, [0, 0, 1], atol=1e-6)
                self.assertAlmostEqual(behind, 1e3 * (by_hole[hole][seed.number - 1] - by_hole[hole][0]), places=4)
        said = subprocess.run(["dciodvfy", path], capture_output=True, text=True).stderr
        self.assertRegex(said, r"(?m)^RTPlan$")
        self.assertEqual([line for line in said.splitlines() if line.startswith("Error")], [])

    def test_read_back_it_is_the_same_plan(self):
        plan, again = plans.read(EXAMPLE), rtplan.read(self.exported(), MODEL)
        self.assertEqual((again.template, again.columns, again.rows, again.spacing, again.source), ("template", 13, 13, 0.005, plan.source))
        self.assertEqual((again.prescription, again.remarks), (145.0, []))
        for needle, planned in zip(again.needles, plan.needles, strict=True):
            self.assertEqual(needle.hole, planned.hole)
            np.testing.assert_allclose([needle.depth, *needle.seeds], [planned.depth, *planned.seeds], atol=2e-7)

    def test_needles_keep_their_order(self):
        """The seeds are in the order of insertion given in the file, not in alphabetical order."""
        plan = plans.read(EXAMPLE)
        plan.needles = plan.needles[5:] + plan.needles[:5]
        rtplan.export(plan, MODEL, self.out / "turned.dcm")
        self.assertEqual([n.hole for n in rtplan.read(self.out / "turned.dcm", MODEL).needles], [n.hole for n in plan.needles])

    def test_the_prescription_is_dicoms(self):
        said = subprocess.run(["dcmdump", "+L", self.exported()], check=True, capture_output=True, text=True).stdout
        self.assertRegex(said, r"\(300a,0020\) CS \[TARGET\]")
        self.assertRegex(said, r"\(300a,0026\) DS \[145\]")
        plan = plans.read(EXAMPLE)
        plan.prescription = None
        rtplan.export(plan, MODEL, self.out / "without.dcm")
        self.assertNotIn("300a,0010", subprocess.run(["dcmdump", self.out / "without.dcm"], check=True, capture_output=True, text=True).stdout)
        self.assertIsNone(rtplan.read(self.out / "without.dcm", MODEL).prescription)

    def test_seeds_that_are_moved_to_their_axes_are_counted(self):
        """The template is slightly offset from the scene's, and one seed lies off its needle's axis."""
        moved = rtplan.read(self.exported(), with_guide(origin=[0.0004, 0, -0.025]))
        self.assertEqual(len(moved.remarks), 1)
        self.assertRegex(moved.remarks[0], r"^60 of 60 seeds were off .* moved onto them, all by the same 0\.40 mm \([+-]0\.40 along columns, [+-]0\.00 along rows\): check the template's place$")
        data = pydicom.dcmread(self.exported())
        for point in data.ApplicationSetupSequence[0].ChannelSequence[7].BrachyControlPointSequence:
            point.ControlPoint3DPosition[0] += 0.3
        data.save_as(self.out / "beside.dcm")
        self.assertRegex(rtplan.read(self.out / "beside.dcm", MODEL).remarks[0], r"^1 of 60 seeds .* by 0\.30 mm at most, 0\.0[01] on average$")

    def test_it_belongs_to_the_structure_set(self):
        structures = SOURCE / "meshes/synthetic.dcm"
        given, data = pydicom.dcmread(structures), pydicom.dcmread(self.exported(structures=structures))
        for name in ("PatientName", "PatientID", "StudyInstanceUID"):
            self.assertEqual(data[name].value, given[name].value)
        self.assertEqual(data.RTPlanGeometry, "PATIENT")
        self.assertEqual(data.ReferencedStructureSetSequence[0].ReferencedSOPInstanceUID, given.SOPInstanceUID)
        self.assertEqual(data.FrameOfReferenceUID, rtplan._frame_of_reference(given) or data.FrameOfReferenceUID)
        said = subprocess.run(["dciodvfy", self.out / "plan.dcm"], capture_output=True, text=True).stderr
        self.assertEqual([line for line in said.splitlines() if line.startswith("Error")], [])
        self.refused("plan.dcm: its modality is RTPLAN, not RTSTRUCT", self.exported, MODEL, self.out / "plan.dcm")

    def test_seeds_that_were_left_are_exported(self):
        """The seeds are tilted and displaced, and one of them belongs to a needle outside the template."""
        tilt = np.array([0.6, 0.0, 0.8])
        placed = [plans.Placed(1, "template", "F4", np.array([0.005, 0.001, 0.066]), tilt), plans.Placed(2, "template", "F4", np.array([0.005, 0.001, 0.0575]), tilt),
                  plans.Placed(3, "", "", np.array([0.0101, 0.002, 0.05]), np.array([0, 0, 1.0]))]
        rtplan.export(plans.read(EXAMPLE), MODEL, self.out / "left.dcm", placed=placed)
        points = dumped(self.out / "left.dcm")
        self.assertEqual([(hole, behind) for hole, _, _, behind in points[::2]], [("F4", 0), ("F4", 8.5), ("(no value available)", 0)])
        for i, seed in enumerate(placed):
            np.testing.assert_allclose(points[2 * i][1], [-1e3, -1e3, 1e3] * seed.position, atol=1e-4)
            np.testing.assert_allclose(points[2 * i][2], [-1, -1, 1] * seed.direction, atol=1e-6)
        said = subprocess.run(["dciodvfy", self.out / "left.dcm"], capture_output=True, text=True).stderr
        self.assertEqual([line for line in said.splitlines() if line.startswith("Error")], [])
        self.refused(r"channel 1: the seed at .* is 1.0 mm from the axis .*: read them with --seeds", rtplan.read, self.out / "left.dcm", MODEL)
        for again, seed in zip(rtplan.read_seeds(self.out / "left.dcm", MODEL), placed, strict=True):
            self.assertEqual((again.number, again.guide, again.hole), (seed.number, seed.guide, seed.hole))
            np.testing.assert_allclose(again.position, seed.position, atol=1e-7)
            np.testing.assert_allclose(again.direction, seed.direction, atol=1e-6)
        self.refused("no seeds", rtplan.dataset, plans.read(EXAMPLE), MODEL, None, None, [])

    def test_what_is_no_plan_for_this_scene_is_refused(self):
        path = self.exported()
        self.refused(r"its template is \"template\"; the scene has plate: .*--template", rtplan.read, path, with_guide(name="plate"))
        self.assertEqual(rtplan.read(path, with_guide(name="plate"), "plate").template, "plate")
        self.refused("has 13x13 5 mm of holes; the scene's has 13x11 5 mm", rtplan.read, path, with_guide(rows=11))
        self.refused(r"channel 1: the seed at \(-10.0, 10.0, 67.5\) mm is 2.0 mm from the axis of the closest hole, E3", rtplan.read, path,
                     with_guide(origin=[0.002, 0, -0.025]))
        data = pydicom.dcmread(path)

        def changed(change):
            again = pydicom.dcmread(path)
            change(again)
            again.save_as(self.out / "changed.dcm")
            return self.out / "changed.dcm"
        for change, words in ((lambda d: setattr(d, "BrachyTreatmentTechnique", "INTERSTITIAL"), "technique is INTERSTITIAL, not PERMANENT"),
                              (lambda d: delattr(d, "ApplicationSetupSequence"), "RTPLAN, without seeds"),
                              (lambda d: delattr(d.ApplicationSetupSequence[0].ChannelSequence[3].BrachyControlPointSequence[0], "ControlPoint3DPosition"), "channel 4: a control point has no"),
                              (lambda d: setattr(d.SourceSequence[0], "SourceIsotopeName", "Ir-192"), "seeds of \"Ir-192\": there are I-125, Pd-103, Cs-131"),
                              (lambda d: setattr(d.ApplicationSetupSequence[0], "ChannelSequence", []), "no seeds")):
            self.refused(words, rtplan.read, changed(change), MODEL)
        for name, isotope in (("Palladium-103", "Pd-103"), ("Cesium-131", "Cs-131"), ("CS131", "Cs-131")):
            self.assertEqual(rtplan.read(changed(lambda d: setattr(d.SourceSequence[0], "SourceIsotopeName", name)), MODEL).source.isotope, isotope)
        self.refused("not a DICOM file", rtplan.read, EXAMPLE, MODEL)
        self.refused("its modality is RTSTRUCT, not RTPLAN", rtplan.read, SOURCE / "meshes/synthetic.dcm", MODEL)
        plan = plans.read(EXAMPLE)
        self.refused("no patient_to_mesh", rtplan.dataset, plans.Plan("template", 13, 13, 0.005, plan.needles, plan.source),
                     trocar.Model(trocar.Scene.load(self.without_patient()), mesh_only=True))
        plan.source = None
        self.refused("without \"source\", which a DICOM plan needs: add source", rtplan.dataset, plan, MODEL)
        self.assertEqual(data.Modality, "RTPLAN")

    def test_what_ends_too_early_is_refused(self):
        """The file may be cut off anywhere, in every uncompressed transfer syntax, with sequences of defined and undefined length. dcmtk writes the files."""
        path, expected = self.exported(), len(plans.planned_seeds(plans.read(EXAMPLE), MODEL))
        for options in (["+te", "+e"], ["+te", "-e"], ["+ti", "+e"], ["+ti", "-e"], ["+tb", "+e"], ["+tb", "-e"], ["+td"]):
            with self.subTest(options=options):
                subprocess.run(["dcmconv", *options, path, self.out / "again.dcm"], check=True)
                count = lambda at: len(plans.planned_seeds(rtplan.read(at, MODEL), MODEL))
                self.assertEqual(count(self.out / "again.dcm"), expected)
                whole = (self.out / "again.dcm").read_bytes()
                for size in (*range(0, len(whole), len(whole) // 40), *range(len(whole) - 18, len(whole))):
                    (self.out / "cut.dcm").write_bytes(whole[:size])
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        try:
                            found = count(self.out / "cut.dcm")
                        except plans.BadPlan as refusal:
                            self.assertIn("cut.dcm: ", str(refusal))
                            continue
                    self.assertEqual((found, len(whole) - size), (expected, 18)) # everything except the last element, the plan's approval
        whole = path.read_bytes()
        (self.out / "cut.dcm").write_bytes(whole[:20000])
        self.refused("cut.dcm: ends too early, within an element, after 20000 bytes: copy or export it again", rtplan.read, self.out / "cut.dcm", MODEL)
        structures = (SOURCE / "meshes/synthetic.dcm").read_bytes()
        (self.out / "cut.dcm").write_bytes(structures[:30000])
        self.refused("cut.dcm: ends too early", self.exported, MODEL, self.out / "cut.dcm")
        with self.assertRaisesRegex(_obstacles.BadContours, "cut.dcm: ends too early"):
            _obstacles.read_contours(str(self.out / "cut.dcm"), "Prostate")

    def without_patient(self):
        text = re.sub(r"(?m)^patient_to_mesh:.*\n", "", SCENE.read_text()).replace("implant.msh", str(SOURCE / "meshes/implant.msh"))
        return self.write(text, "scene.yaml")


class Compare(Case):
    def test_misplacements(self):
        plan = plans.read(EXAMPLE)
        seeds = plans.planned_seeds(plan, MODEL)
        moved = [np.array([0.3e-3, -0.4e-3, -2e-3]) * (1 + 0.1 * i) for i in range(len(seeds))]
        placed = [plans.Placed(i + 1, "template", s.hole, s.position + moved[i], s.direction) for i, s in enumerate(seeds)]
        rows = plans.compare(plan, MODEL, list(reversed(placed)))
        self.assertEqual(len(rows), 60)
        for row in rows:
            off = moved[row.placed.number - 1] * 1e3
            np.testing.assert_allclose(row.offset, [-off[0], -off[1], off[2]], atol=1e-9)  # components to the left, posterior and cranial
            self.assertAlmostEqual(row.along, off[2])
            self.assertAlmostEqual(row.across, np.hypot(off[0], off[1]))
            np.testing.assert_array_equal(row.planned.position, seeds[row.placed.number - 1].position)
        mean = plans.summary(rows)
        self.assertAlmostEqual(mean["distance"], 1e3 * np.mean(np.linalg.norm(moved, axis=1)))
        self.assertAlmostEqual(mean["deeper"], 1e3 * np.mean(moved, axis=0)[2])

    def test_seeds_without_a_counterpart(self):
        plan = plans.read(EXAMPLE)
        seeds = [s for s in plans.planned_seeds(plan, MODEL) if s.hole in ("C3.5", "F4")]
        there = lambda number, guide, hole, position: plans.Placed(number, guide, hole, position, np.array([0, 0, 1.0]))
        placed = [there(1, "template", "F4", seeds[4].position + [0, 0, 1e-3]), there(2, "template", "F4", seeds[6].position),
                  *(there(3 + i, "template", "C3.5", seeds[0].position - [0, 0, 9e-3 * i]) for i in range(4)),
                  there(7, "", "", seeds[0].position), there(8, "template", "A1", seeds[0].position), there(9, "plate", "F4", seeds[0].position)]
        rows = {(r.placed.number if r.placed else None, r.planned.number if r.planned else None) for r in plans.compare(plan, MODEL, placed) if r.hole in ("F4", "C3.5", "A1", "")}
        self.assertEqual(rows, {(1, 2), (2, 4), (None, 1), (None, 3), (3, 1), (4, 2), (5, 3), (6, None), (7, None), (8, None), (9, None)})

    def test_pairs_have_the_least_distance(self):
        random = np.random.default_rng(1)
        import itertools
        for _ in range(200):
            few, many = np.sort(random.uniform(0, 50, 3)), np.sort(random.uniform(0, 50, 5))
            best = min(np.abs(few - many[list(chosen)]).sum() for chosen in itertools.combinations(range(5), 3))
            for a, b in ((few, many), (many, few)):
                pairs = plans._pairs(list(a), list(b))
                self.assertAlmostEqual(sum(abs(a[p] - b[k]) for p, k in pairs if p is not None and k is not None), best)
                self.assertEqual(len(pairs), 5)
                for side, count in ((0, len(a)), (1, len(b))):
                    self.assertEqual(sorted(pair[side] for pair in pairs if pair[side] is not None), list(range(count)))

    def test_bad_tables_are_refused(self):
        good = ("seed,guide,hole,rest_x [m],rest_y [m],rest_z [m],x [m],y [m],z [m],along_x,along_y,along_z,rest_along_x,rest_along_y,rest_along_z\n"
                "1,template,F4,1e-3,2e-3,3e-3,4e-3,5e-3,6e-3,0,0.6,0.8,0.8,0,0.6\n")
        at_rest, now = plans.read_seeds(self.write(good), MODEL)[0], plans.read_seeds(self.write(good), MODEL, now=True)[0]
        np.testing.assert_allclose([at_rest.position, at_rest.direction], [[1e-3, 2e-3, 3e-3], [0.8, 0, 0.6]])
        np.testing.assert_allclose([now.position, now.direction], [[4e-3, 5e-3, 6e-3], [0, 0.6, 0.8]])
        patient = plans.read_seeds(self.write(good.replace("[m]", "[mm]").replace("e-3", "")), MODEL)[0]
        np.testing.assert_allclose([patient.position, patient.direction], [[-1e-3, -2e-3, 3e-3], [-0.8, 0, 0.6]], atol=1e-12)
        figure8 = trocar.Model(trocar.Scene.load(SOURCE / "meshes/figure8.yaml"), mesh_only=True)
        for text, words, model in ((good.replace("hole", "hull"), ":1: not a table of seeds", MODEL), (good.replace("1e-3", "x"), ":2: could not convert", MODEL),
                                   (good.replace("1e-3", "nan"), ":2: a number is not finite", MODEL), (good.replace(",2e-3", ""), ":2: 14 columns, not 15", MODEL),
                                   (good.replace("0.8,0,0.6", "0.8,1,0.6"), ":2: along_x, along_y and along_z are not a unit vector", MODEL),
                                   ("", ":1: not a table", MODEL), (good.replace("[m]", "[mm]"), ":1: in the patient's coordinates", figure8)):
            self.refused(words, plans.read_seeds, self.write(text), model)


class Program(Case):
    def run_plan(self, *arguments):
        said, error = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(error):
            status = _plan_command.main([str(a) for a in arguments])
        return status, said.getvalue(), error.getvalue()

    def test_subcommands(self):
        scene = ("--scene", SCENE)
        self.assertEqual(self.run_plan("check", EXAMPLE, *scene), (0, f"{EXAMPLE}: 16 needles, 60 seeds: 60 in prostate\n", ""))
        status, said, _ = self.run_plan("show", EXAMPLE, *scene)
        self.assertEqual((status, len(said.splitlines())), (0, 61))
        self.assertRegex(said, r"(?m)^ +F4 +1 +0.005000 +0.000000 +0.072500 +-5.000 +-?0.000 +72.500$")
        self.assertEqual(self.run_plan("export", EXAMPLE, *scene, "--out", self.out / "a.dcm")[0], 0)
        self.assertEqual(self.run_plan("import", self.out / "a.dcm", *scene, "--out", self.out / "a.yaml")[0], 0)
        self.assertEqual(self.run_plan("check", self.out / "a.yaml", *scene)[0], 0)
        table = self.write("seed,guide,hole,rest_x [m],rest_y [m],rest_z [m],rest_along_x,rest_along_y,rest_along_z\n1,template,F4,5e-3,0,0.0715,0,0,1\n", "seeds.csv")
        self.assertEqual(self.run_plan("export", EXAMPLE, *scene, "--seeds", table, "--out", self.out / "b.dcm")[0], 0)
        self.assertEqual(len(dumped(self.out / "b.dcm")), 2)
        self.assertEqual(self.run_plan("import", self.out / "b.dcm", *scene, "--seeds", self.out / "b.csv"), (0, "", ""))
        self.assertEqual(self.run_plan("compare", EXAMPLE, self.out / "b.csv", *scene), self.run_plan("compare", EXAMPLE, table, *scene))
        status, _, error = self.run_plan("import", self.out / "b.dcm", *scene, "--out", self.out / "b.yaml")
        self.assertEqual((status, error), (0, ""))    # no remark, because the seed is on its hole's axis
        shifted = SCENE.read_text().replace("origin: [0, 0, -0.025]", "origin: [0.0004, 0, -0.025]").replace("implant.msh", str(SOURCE / "meshes/implant.msh"))
        self.assertIn("0.0004", shifted)
        status, _, error = self.run_plan("import", self.out / "a.dcm", "--scene", self.write(shifted, "shifted.yaml"), "--out", self.out / "c.yaml")
        self.assertEqual(status, 0)
        self.assertRegex(error, r"a.dcm: 60 of 60 seeds were off the axes of their holes and have been moved onto them, all by the same 0.40 mm")
        self.assertIn("# 60 of 60 seeds were off", (self.out / "c.yaml").read_text())
        with self.assertRaises(SystemExit), contextlib.redirect_stderr(io.StringIO()):
            self.run_plan("import", self.out / "a.dcm", *scene)
        status, said, _ = self.run_plan("compare", EXAMPLE, table, *scene)
        self.assertEqual(status, 0)
        self.assertRegex(said, r"(?m)^ +F4 +1 +1 +-?0.000 +-?0.000 +-1.000 +-1.000 +0.000 +1.000$")
        self.assertRegex(said, r"mean of 1 seeds: 1.00 mm \(left 0.00, posterior 0.00, superior 1.00\); along the needle 1.00, -1.00 with its sign, across 0.00")
        status, _, error = self.run_plan("check", self.out / "none.yaml", *scene)
        self.assertEqual((status, error), (2, f"trocar.brachy.plan: {self.out}/none.yaml: cannot be opened: No such file or directory\n"))
        self.assertEqual(self.run_plan("check", EXAMPLE, "--scene", self.out / "none.yaml")[0], 2)
        self.assertEqual(self.run_plan("show", EXAMPLE, *scene, "--out", self.out / "no/folder.csv")[0], 3)
        done = subprocess.run(["/usr/bin/python3", "-m", "trocar.brachy.plan", "import", EXAMPLE, "--scene", SCENE, "--out", self.out / "b.yaml"], capture_output=True, text=True,
                              env=dict(os.environ, PYTHONPATH=str(BUILD / "clients/python")))
        self.assertEqual(done.returncode, 2)
        self.assertIn("not a DICOM file", done.stderr)


class Log:
    """An LCM event log, assembled byte by byte."""

    def __init__(self, path):
        self.file, self.count = open(path, "wb"), 0

    def add(self, channel, message):
        data, name = message.encode(), channel.encode()
        self.file.write(struct.pack(">IqqII", 0xEDA1DA01, self.count, message.utime, len(name), len(data)) + name + data)
        self.count += 1


class Replay(Case):
    def replay_answered(self, status):
        """Replays the same log, including the server's reply to a drop of one seed that was requested while three seeds were in the needle."""
        command_t, command_reply_t = self.command_types
        log = Log(self.out / "answered.log")
        for channel, message in self.events:
            log.add(channel, message)
            if isinstance(message, command_t) and message.seq == self.too_early:
                reply = command_reply_t()
                reply.utime, reply.session, reply.seq, reply.command, reply.needle = message.utime, message.session, message.seq, message.command, message.needle
                reply.status, reply.message = status, "as it was"
                log.add("TROCAR_REPLY", reply)
        log.file.close()
        done = subprocess.run([BUILD / "clients/trocar-replay", "--scene", SCENE, "--seeds", self.out / "answered.csv", "--poses", self.out / "answered.log",
                               "--out", self.out / "answered-out.log"],
                              capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertNotIn("refused", done.stderr)
        holes = [s.hole for s in plans.read_seeds(self.out / "answered.csv", self.model)]
        done = subprocess.run([BUILD / "clients/trocar-replay", "--scene", SCENE, "--seeds", self.out / "again.csv", "--poses", self.out / "answered-out.log"],
                              capture_output=True, text=True)
        self.assertEqual([s.hole for s in plans.read_seeds(self.out / "again.csv", self.model)], holes, done.stderr) # the server's replies are written as well
        return holes

    def test_a_log_with_commands_is_an_implant(self):
        subprocess.run(["lcm-gen", "-p", "--ppath", self.out, SOURCE / "lcmtypes/trocar.lcm"], check=True, capture_output=True)
        needle_pose_t, command_t, command_reply_t = self.types()
        self.command_types, self.events, self.too_early = (command_t, command_reply_t), [], None
        model = self.model = trocar.Model(trocar.Scene.load(SCENE))
        sim, log, dt = trocar.Sim(model), Log(self.out / "implant.log"), 4000  # us
        guide = model.guides[0]
        state = {"utime": 10 ** 9, "seq": 0}

        def pose(hole, tip):
            base = plans.hole_axis(guide, hole) + (tip - model.needle_length) * guide.normal
            return np.array([*base, 1, 0, 0, 0])

        def step(hole, tip):
            at, message = pose(hole, tip), needle_pose_t()
            message.utime, message.session, message.seq, message.needle = state["utime"], 7, state["seq"], 0
            message.position, message.orientation = list(at[:3]), list(at[3:])
            if state["seq"] == 0:
                sim.reset(at)
            sim.step(at, 1 / model.rate_hz if state["seq"] == 0 else 1e-6 * dt)
            log.add("TROCAR_POSE", message)
            self.events.append(("TROCAR_POSE", message))
            state["utime"] += dt
            state["seq"] += 1

        def tell(command, seeds=0, spacing=0.0, session=7):
            message = command_t()
            message.utime, message.session, message.command, message.seeds, message.spacing = state["utime"] - 1, session, command, seeds, spacing
            state["told"] = message.seq = state.get("told", 0) + 1
            log.add("TROCAR_COMMAND", message)
            self.events.append(("TROCAR_COMMAND", message))

        tell(command_t.DROP_SEED, 1)                     # comes before the first pose, so it is skipped
        for hole in ("F4", "I3.5"):
            ways = {"in": np.arange(-0.02, 0.0900, 8e-4), "out": np.arange(0.0900, -0.02, -8e-4)}
            for tip in ways["in"]:
                step(hole, tip)
            tell(command_t.DROP_SEED, 3, 9e-3)
            sim.drop_seeds(3, 9e-3)
            tell(command_t.DROP_SEED, 1, session=8)      # another session's: skipped
            if hole == "F4":
                tell(command_t.DROP_SEED, 1)             # refused while three seeds are pending
                self.too_early = state["told"]
            for tip in ways["out"]:
                step(hole, tip)
            if hole == "F4":
                tell(command_t.UNDO)
                sim.undo_seed()
        log.file.close()
        expected = plans.seeds_of(sim)
        self.assertEqual([s.hole for s in expected], ["F4"] * 2 + ["I3.5"] * 3)
        for given, others in (("implant.log", "3 commands for seeds skipped"), ("again.log --patient", "")):
            done = subprocess.run([BUILD / "clients/trocar-replay", "--scene", SCENE, "--seeds", self.out / "seeds.csv", "--out", self.out / "copy.log", "--poses",
                                   *f"{self.out}/{given}".split()], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertRegex(done.stderr, rf"5 seeds\n{others}")
            self.assertRegex(done.stderr, r"1 of 4 commands refused; the first: needle 0 still holds 3 of the seeds")
            placed = plans.read_seeds(self.out / "seeds.csv", model)
            self.assertEqual([(s.number, s.guide, s.hole) for s in placed], [(s.number, s.guide, s.hole) for s in expected])
            np.testing.assert_allclose([s.position for s in placed], [s.position for s in expected], atol=1e-9)
            np.testing.assert_allclose([s.direction for s in placed], [s.direction for s in expected], atol=1e-6)
            np.testing.assert_allclose([s.position for s in plans.read_seeds(self.out / "seeds.csv", model, now=True)],
                                       [s.position for s in plans.seeds_of(sim, now=True)], atol=1e-9)
            (self.out / "copy.log").rename(self.out / "again.log")
        self.assertEqual(self.replay_answered(command_reply_t.REFUSED), ["F4"] * 2 + ["I3.5"] * 3)
        # The server had already accepted the drop, which waits until the three earlier seeds have been released. UNDO cancels it.
        self.assertEqual(self.replay_answered(command_reply_t.DONE), ["F4"] * 3 + ["I3.5"] * 3)

    def types(self):
        """The generated package has the same name as the library's, so its modules are loaded by path."""
        import importlib.util
        found = []
        for name in ("needle_pose_t", "command_t", "command_reply_t"):
            spec = importlib.util.spec_from_file_location(f"generated_{name}", self.out / f"trocar/{name}.py")
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            found.append(getattr(module, name))
        return found


if __name__ == "__main__":
    for program in ("dcmdump", "dciodvfy", "lcm-gen"):
        if not shutil.which(program):
            sys.exit(f"FAILED: no {program}: scripts/test installs dcmtk, dicom3tools and liblcm-bin")
    unittest.main(argv=sys.argv[:1])
