#!/usr/bin/python3
"""Tests trocar.training: reading tasks and courses, scoring recordings whose numbers are known, and the reports.

usage: test_training.py BUILD_DIR SOURCE_DIR
"""
import base64
import contextlib
import csv
import io
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import unittest
from html.parser import HTMLParser
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True
import numpy as np

import trocar
from trocar import _lcm_messages
from trocar._locate import distance, locate
from trocar.brachy import _plan_command, plan as plans
from trocar.training import BadRecording, BadTask, Course, Task, score
from trocar.training.program import main

SCENE, PLAN = SOURCE / "meshes/implant.yaml", SOURCE / "docs/examples/implant-plan.yaml"
MODEL = trocar.Model(trocar.Scene.load(SCENE), mesh_only=True)
NODES = len(MODEL.nodes)
START = 1_700_000_000_000_000    # us
TARGETS = f"""title: Two targets
text: Reach both.
scene: {SCENE}
targets:
  - {{name: left, position: [0.010, -0.005, 0.060], hole: E3.5}}
  - {{name: right, position: [-0.010, -0.005, 0.060]}}
organs: {{gland: [prostate]}}
avoid: [muscle]
criteria:
  - {{measure: tip_error, most: 5e-3, source: a choice}}
  - {{measure: passes, most: 2, source: a choice}}
hints: [Look twice.]
"""
PLANNED = f"""title: An implant
text: Carry out the plan.
scene: {SCENE}
plan: {PLAN}
organs: {{gland: [prostate]}}
criteria:
  - {{measure: D90, least: 145, source: a choice}}
"""


def message_types():
    """Returns the classes that lcm-gen generates from lcmtypes/trocar.lcm, by name."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["lcm-gen", "-p", "--ppath", folder, SOURCE / "lcmtypes/trocar.lcm"], check=True, capture_output=True)
        found = {}
        for path in Path(folder, "trocar").glob("*_t.py"):
            space = {}
            exec(compile(path.read_text(), path.name, "exec"), space)
            found[path.stem] = space[path.stem]
        return found


TYPES = message_types()


class Log:
    """Writes messages as LCM's logger does, encoded by lcm-gen's classes."""

    def __init__(self, server=7, period=1e-3):
        self.events, self.server, self.tick, self.period = [], server, 0, round(1e6 * period)

    def add(self, channel, type_, **values):
        message = TYPES[type_]()
        for name, value in {"server": self.server, "tick": self.tick, "utime": START + self.period * self.tick, **values}.items():
            setattr(message, name, value)
        self.events.append((channel, message.encode()))

    def wrench(self, depth, force=(0, 0, 0), needle=0, session=1):
        self.tick += 1
        if needle > 0:    # the server sends a wrench of needle 0 in each tick, even if nobody holds it
            self.add("TROCAR_WRENCH", "needle_wrench_t", depth=0.0, raw_force=(0, 0, 0), needle=0, session=0)
        self.add("TROCAR_WRENCH", "needle_wrench_t", depth=depth, raw_force=force, needle=needle, session=session)

    def stroke(self, *depths, needle=0, session=1):
        """Logs a needle that moves from depth to depth (mm), by 0.1 mm per tick."""
        for start, end in zip(depths[:-1], depths[1:]):
            for depth in np.linspace(start, end, max(round(abs(end - start) / 0.1), 1) + 1)[1:]:
                self.wrench(1e-3 * depth, needle=needle, session=session)

    def tissue(self, moved=np.zeros((NODES, 3))):
        self.add("TROCAR_DEFORMATION", "deformation_t", node_count=len(moved), displacement=moved.tolist())

    def look(self, tip, moved=np.zeros((NODES, 3)), needle=0):
        """Logs a frame of the tissue with the needle's tip at `tip` (3,), m."""
        self.add("TROCAR_CONTACTS", "contacts_t", needle=needle, joint_count=2, centreline=[[0, 0, -0.1], list(tip)], pose_utime=0, orientation=[1, 0, 0, 0], tip_lead=0.0,
                 contact_count=0, position=[], force=[], arc=[], state=b"", kind=b"")
        self.tissue(moved)

    def tracks(self, *tracks, needle=0):
        points = [point for track in tracks for point in track]
        numbers = [i for i, track in enumerate(tracks) for _ in track]
        self.add("TROCAR_TRACKS", "tracks_t", needle=needle, point_count=len(points), position=points, tet=[0] * len(points), track=numbers, membrane=[-1] * len(points))

    def seeds(self, planned):
        count, three = len(planned), [s.position.tolist() for s in planned]
        along = [s.direction.tolist() for s in planned]
        holes = [plans.hole_number(s.hole) for s in planned]
        zeros = [0] * count
        self.add("TROCAR_SEEDS", "seeds_t", needle_count=1, pending=[0], seed_count=count, position=three, direction=along, rest_position=three, rest_direction=along,
                 needle=zeros, guide=zeros, hole=[column + 13 * row for column, row in holes], strand=zeros)

    def write(self, path):
        with open(path, "wb") as file:
            for number, (channel, data) in enumerate(self.events):
                file.write(struct.pack(">IqqII", 0xEDA1DA01, number, 0, len(channel), len(data)) + channel.encode() + data)
        return path


def straight(x, y, end):
    """Returns a track parallel to z, from the skin to depth `end` (m)."""
    return [[x, y, z] for z in np.linspace(0.0, end, 17)]


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.out = Path(folder.name)

    def task(self, text, name="task.yaml"):
        (self.out / name).write_text(text)
        return self.out / name

    def run_program(self, *arguments):
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                status = main([str(argument) for argument in arguments])
            except SystemExit as end:
                status = end.code
        return status, out.getvalue(), err.getvalue()


class Scores(Case):
    def score(self, text, log):
        return score(Task.read(self.task(text)), log.write(self.out / "run.log"))

    def log(self):
        log = Log()
        log.tissue()
        return log

    def test_every_measure_of_a_run_with_known_numbers(self):
        log = self.log()
        log.wrench(0.0, (9, 9, 9))                 # outside the tissue, where force and time do not count
        log.stroke(0, 63)
        log.wrench(0.063, (2, -3, 6))              # 7 N
        log.look((0.010, -0.005, 0.063))
        log.tracks(straight(0.010, -0.005, 0.063))
        log.wrench(0.063, (50, 0, 0), session=0)   # session 0: nobody holds the needle
        moved = np.zeros((NODES, 3))
        inner = np.unique(MODEL.tets[MODEL.tet_regions == MODEL.groups.index("prostate")])
        outer = np.setdiff1d(np.arange(NODES), inner)
        moved[inner[5]], moved[outer[3]] = (1e-3, 2e-3, -2e-3), (0.02, 0, 0)
        log.tissue(moved)
        log.tissue()
        log.stroke(63, 0)
        log.look((0, 0, 0))
        log.stroke(0, 56)
        log.look((-0.006, -0.005, 0.060))
        log.tracks(straight(0.010, -0.005, 0.063), straight(-0.006, -0.005, 0.060))
        result = self.score(TARGETS, log)
        measures = result.measures
        self.assertAlmostEqual(result.reached[0].error, 0.003, places=8)
        self.assertAlmostEqual(result.reached[1].error, 0.004, places=8)
        self.assertEqual(measures["tip_error"], result.reached[1].error)
        self.assertEqual((measures["passes"], measures["redirections"]), (2, 0))
        self.assertAlmostEqual(measures["path"], 0.123, places=7)
        self.assertAlmostEqual(measures["force"], 7.0, places=12)
        self.assertAlmostEqual(measures["displacement"], 0.003, places=9)
        # time from the first tick with a depth above 0 to the last: 630 ticks inward, one at rest, one without a hand, 630 outward, where the depth ends at 0,
        # and 560 inward
        self.assertAlmostEqual(measures["time"], 1e-3 * (630 + 1 + 1 + 630 + 560 - 1), places=9)
        self.assertEqual(measures["organs_touched"], 1)
        self.assertTrue(result.passed)
        self.assertEqual(result.began, START + 1000)

    def test_the_tip_is_compared_with_the_target_in_the_displaced_tissue_while_the_needle_is_deepest(self):
        moved = np.zeros((NODES, 3)) + [0.001, 0.0, 0.004]
        def errors(*visits):
            log = self.log()
            for visit in visits:
                for depth, z, tissue in visit:
                    log.wrench(depth)
                    log.look((0.010, -0.005, z), tissue)
            return [r.error for r in self.score(TARGETS, log).reached]
        still = np.zeros((NODES, 3))
        self.assertAlmostEqual(errors([(0.050, 0.060, moved)])[0], np.hypot(0.001, 0.004), places=8)
        self.assertAlmostEqual(errors([(0.050, 0.064, moved)])[0], 0.001, places=8)
        self.assertAlmostEqual(errors([(0.050, 0.060, still), (0.060, 0.067, still)])[0], 0.007, places=8)                    # the tip went on past the target
        self.assertAlmostEqual(errors([(0.060, 0.064, still), (0.0597, 0.062, still), (0.050, 0.060, still)])[0], 0.002, places=8)  # drawn back
        self.assertAlmostEqual(errors([(0.060, 0.067, still), (0.0, 0.0, still)], [(0.053, 0.061, still)])[0], 0.001, places=8)     # a second needle path
        self.assertEqual(errors([(0.0, 0.060, still)]), [None, None])

    def test_regions_are_those_along_the_path(self):
        """Layer boundaries in meshes/implant.msh: skin and perineum 6 mm, muscle to 26 mm."""
        log = self.log()
        log.stroke(0, 60)
        log.tracks(straight(0.0, 0.0, 0.060))
        organs = self.score(TARGETS, log).organs
        self.assertAlmostEqual(organs["perineum"], 0.006, delta=0.001)
        self.assertAlmostEqual(organs["muscle"], 0.020, delta=0.001)
        self.assertAlmostEqual(sum(organs.values()), 0.060, delta=0.001)

    def test_passes_and_redirections(self):
        for depths, passes, redirections in (((0, 1.5, 0), 0, 0),                       # the skin only
                                             ((0, 50, 46, 50), 1, 0), ((0, 50, 45, 50), 1, 1), ((0, 50, 45, 49), 1, 0),
                                             ((0, 50, 30, 33, 31, 40, 20, 60), 1, 2), ((0, 30, 0, 30, 0), 2, 0)):
            log = self.log()
            log.stroke(*depths)
            measures = self.score(TARGETS, log).measures
            self.assertEqual((measures["passes"], measures["redirections"]), (passes, redirections), depths)

    def test_a_needle_that_is_left_and_taken_has_entered_once(self):
        log = self.log()
        log.stroke(0, 50)
        log.stroke(0, 40, needle=1, session=2)
        for _ in range(20):
            log.wrench(0.0, session=0)
        log.stroke(50, 44, session=3)
        log.stroke(44, 50, session=3)
        measures = self.score(TARGETS, log).measures
        self.assertEqual((measures["passes"], measures["redirections"]), (2, 1))

    def test_tracks_before_a_reset_count(self):
        log = self.log()
        log.stroke(0, 20)
        log.tracks(straight(0, 0, 0.020))
        log.tracks(straight(0, 0, 0.030))          # each message has all tracks of its needle
        log.tracks()
        log.tracks()
        log.tracks(straight(0, 0, 0.040))
        self.assertAlmostEqual(self.score(TARGETS, log).measures["path"], 0.070, places=8)

    def test_nothing_done(self):
        log = self.log()
        log.wrench(0.0)
        result = self.score(TARGETS, log)
        self.assertIsNone(result.measures["tip_error"])
        self.assertIsNone(result.measures["force"])
        self.assertFalse(result.passed)

    def test_dose_of_seeds_as_planned(self):
        """The plan's dose figures, as given in docs/examples/implant-plan.yaml and docs/seeds.md: D90 166 Gy, V100 97.8 %, V150 48.3 %."""
        log = self.log()
        log.wrench(0.0)
        log.seeds(plans.planned_seeds(plans.read(PLAN), MODEL))
        result = self.score(PLANNED, log)
        self.assertEqual((result.measures["seeds_missing"], result.measures["seeds_extra"]), (0, 0))
        self.assertLess(result.measures["seed_error_largest"], 1e-8)      # seeds are sent in single precision
        self.assertAlmostEqual(result.measures["D90"], 166, delta=0.5)
        self.assertAlmostEqual(100 * result.measures["V100"], 97.8, delta=0.05)
        self.assertAlmostEqual(100 * result.measures["V150"], 48.3, delta=0.05)
        self.assertTrue(result.passed)

    def test_an_organ_of_two_regions_counts_once(self):
        """The plan's dose figures in the pelvis, as given in docs/examples/implant-plan.yaml: D90 159 Gy, V100 96 %. Part of this gland is a region of its own,
        the transition zone."""
        scene = SOURCE / "meshes/pelvis.yaml"
        model = trocar.Model(trocar.Scene.load(scene), mesh_only=True)
        zones = [model.groups.index(name) for name in ("prostate", "transition_zone")]
        corners = model.nodes[model.tets[np.isin(model.tet_regions, zones)]]
        volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / 6
        for gland in ("prostate", "prostate, transition_zone"):
            log = Log()
            log.tissue(np.zeros((len(model.nodes), 3)))
            log.wrench(0.0)
            log.seeds(plans.planned_seeds(plans.read(PLAN), model))
            result = self.score(PLANNED.replace(str(SCENE), str(scene)).replace("[prostate]", f"[{gland}]"), log)
            dvh = next(histogram.achieved for histogram in result.histograms if histogram.role == "gland")
            self.assertAlmostEqual(dvh.voxel * len(dvh.doses) / volume, 1, delta=0.01)
            self.assertAlmostEqual(result.measures["D90"], 159, delta=0.5)
            self.assertAlmostEqual(100 * result.measures["V100"], 96, delta=0.5)
            self.assertEqual(len(result.task.tets_of("gland")), np.isin(model.tet_regions, zones).sum())

    def test_seeds_that_are_missing_or_displaced(self):
        log = self.log()
        log.wrench(0.0)
        planned = plans.planned_seeds(plans.read(PLAN), MODEL)
        moved = [seed._replace(position=seed.position + [0.003, 0.0, -0.004]) for seed in planned if seed.hole != "E3"]
        log.seeds(planned)
        log.seeds(moved)                                                   # the last message counts
        measures = self.score(PLANNED, log).measures
        self.assertEqual((measures["seeds_missing"], measures["seeds_extra"]), (4, 0))
        self.assertAlmostEqual(measures["seed_error"], 0.005, places=7)
        self.assertLess(measures["D90"], 160)

    def test_force_on_the_probe(self):
        task = TARGETS.replace(str(SCENE), str(SOURCE / "meshes/trus.yaml")).replace("[muscle]", "[surrounding]").replace("measure: passes, most: 2", "measure: probe_force, most: 5")
        nodes = len(trocar.Model(trocar.Scene.load(SOURCE / "meshes/trus.yaml"), mesh_only=True).nodes)
        log = Log()
        log.tissue(np.zeros((nodes, 3)))
        log.wrench(0.0)
        self.assertFalse(self.score(task, log).judgements[1].met)      # the probe has not been placed
        for force in ((0, 1, 0), (2, -3, 6), (0, 0, 0)):
            log.add("TROCAR_PROBE_WRENCH", "probe_wrench_t", force=force, torque=(9, 9, 9), position=(8, 8, 8), orientation=(1, 0, 0, 0))
        self.assertAlmostEqual(self.score(task, log).measures["probe_force"], 7.0, places=12)

    def test_touching_bone(self):
        """A needle touches the surface `bone` of meshes/pelvis.msh if its path ends within half a millimetre of a triangle."""
        scene = SOURCE / "meshes/pelvis.yaml"
        model = trocar.Model(trocar.Scene.load(scene), mesh_only=True)
        corners = model.nodes[model.surface("bone")]
        place = corners[len(corners) // 2].mean(axis=0)
        normal = np.cross(corners[len(corners) // 2][1] - corners[len(corners) // 2][0], corners[len(corners) // 2][2] - corners[len(corners) // 2][0])
        normal /= np.linalg.norm(normal)
        outwards = normal if locate(model, [place + 1e-3 * normal])[0][0] >= 0 else -normal
        task = TARGETS.replace(str(SCENE), str(scene)).replace("[muscle]", "[urethra, bone]").replace("measure: passes", "measure: organs_touched")
        aside = np.cross(outwards, [0.6, 0.0, 0.8])
        aside *= 1e-3 / np.linalg.norm(aside)
        for away, passes, touched in ((0.3e-3, False, ["bone"]), (0.9e-3, False, []), (0.3e-3, True, ["bone"])):
            log = Log()
            log.tissue(np.zeros((len(model.nodes), 3)))
            log.wrench(0.0)
            end = place + away * outwards
            ends = (end - 2 * aside + 1e-3 * outwards, end + 2 * aside - 1e-3 * outwards) if passes else (end + 0.01 * outwards, end)    # the path ends there, or passes
            log.tracks([point.tolist() for point in ends])
            result = self.score(task, log)
            self.assertEqual((result.touched, result.measures["organs_touched"]), (touched, len(touched)))
        with self.assertRaisesRegex(BadTask, "no region or impenetrable surface \"capsule\": there are .*urethra.*, bone$"):
            self.score(task.replace("[urethra, bone]", "[capsule]"), log)

    def test_distance_from_triangles(self):
        """Compared with the nearest of many points on the triangles."""
        rng = np.random.default_rng(5)
        triangles = rng.normal(size=(6, 3, 3))
        grid = [(i / 80, j / 80) for i in range(81) for j in range(81 - i)]
        weights = np.array([(a, b, 1 - a - b) for a, b in grid])
        spread = np.einsum("wc,tci->twi", weights, triangles).reshape(-1, 3)
        points = np.concatenate([2 * rng.normal(size=(40, 3)), triangles[:, 0], triangles.mean(axis=1)])
        sampled = [np.linalg.norm(spread - point, axis=1).min() for point in points]
        found = distance(points, triangles)
        self.assertTrue((found <= np.array(sampled) + 1e-12).all())
        self.assertLess(np.abs(found - sampled).max(), 0.03)
        self.assertLess(found[40:].max(), 1e-12)

    def test_lost_wrenches_are_counted(self):
        log = self.log()
        log.stroke(0, 30)
        log.events = [event for i, event in enumerate(log.events) if i not in (100, 200, 201)]
        result = self.score(TARGETS, log)
        self.assertEqual((result.lost, result.ticks), (3, 300))
        status, _, err = self.run_program(self.out / "run.log", "--task", self.out / "task.yaml", "--html", self.out / "r.html", "--json", self.out / "r.json")
        self.assertEqual(status, 1)
        self.assertIn("missing from the recording: 3 of 300", err)
        self.assertIn("missing from the recording: 3 of 300", (self.out / "r.html").read_text())
        self.assertEqual(json.loads((self.out / "r.json").read_text())["lost"], {"wrenches": 3, "of": 300})

    def test_message_types_are_those_of_the_server(self):
        kinds = {"TROCAR_WRENCH": "needle_wrench_t", **{f"TROCAR_{name}": f"{name.lower()}_t" for name in ("DEFORMATION", "TRACKS", "SEEDS", "CONTACTS", "PROBE_WRENCH")}}
        self.assertEqual(_lcm_messages.FINGERPRINTS, {channel: struct.unpack(">Q", TYPES[name]._get_packed_fingerprint())[0] for channel, name in kinds.items()})

    def test_bad_recordings(self):
        task = Task.read(self.task(TARGETS))
        whole = self.log()
        whole.wrench(0.0)
        other, second, without = Log(), Log(), Log()
        other.tissue(np.zeros((NODES + 1, 3)))
        second.tissue()
        second.wrench(0.0)
        second.server = 8
        second.tissue()
        without.wrench(0.0)
        infinite = self.log()
        infinite.wrench(np.inf)
        wrong = self.log()
        wrong.events.append(("TROCAR_WRENCH", wrong.events[0][1]))
        short = self.log()
        short.events.append(("TROCAR_TRACKS", TYPES["tracks_t"]().encode()[:-3]))
        for log, words in ((Log(), "no message on TROCAR_WRENCH"), (self.log(), "no message on TROCAR_WRENCH"), (without, "no message on TROCAR_DEFORMATION"),
                           (other, f"tissue of {NODES + 1} nodes, the task's scene has {NODES}"), (second, "messages of 2 servers"), (infinite, "not finite"),
                           (wrong, "event 1: TROCAR_WRENCH: a message of another type"), (short, "event 1: TROCAR_TRACKS: a message of another type")):
            with self.assertRaisesRegex(BadRecording, words):
                score(task, log.write(self.out / "bad.log"))
        data = whole.write(self.out / "whole.log").read_bytes()
        score(task, self.out / "whole.log")
        for size in range(1, len(data), 97):
            (self.out / "cut.log").write_bytes(data[:size])
            with self.assertRaises(BadRecording):
                score(task, self.out / "cut.log")
        with self.assertRaisesRegex(BadRecording, "cannot be opened"):
            score(task, self.out / "none.log")


class Tasks(Case):
    def test_what_a_task_has(self):
        task = Task.read(self.task(TARGETS))
        self.assertEqual((task.name, task.title, task.avoid, task.hints), ("task", "Two targets", ["muscle"], ["Look twice."]))
        self.assertEqual([t.hole for t in task.targets], ["E3.5", ""])
        self.assertEqual(task.targets[0].position.tolist(), [0.010, -0.005, 0.060])

    def test_mistakes_are_named_with_their_line(self):
        for before, after, words in (
                ("title: Two targets", "titel: Two", r":1: unknown key \"titel\""), ("text: Reach both.\n", "", "missing key \"text\""),
                (f"scene: {SCENE}", "scene: none.yaml", ":3: scene: no file "), (f"scene: {SCENE}", f"scene: {PLAN}", ":3: scene: "),
                ("[0.010, -0.005, 0.060]", "[10, -5, 60]", r":5: targets\[0\].position: 10, -5, 60 m is outside the tissue.*in metres"),
                ("[0.010, -0.005, 0.060]", "[0.010, -0.005]", ":5: .*2 numbers: write 3"), ("hole: E3.5", "hole: Z9", ":5: .*no guide of the scene has a hole \"Z9\""),
                ("gland: [prostate]", "gland: [gland]", ":7: organs.gland: the scene has no region \"gland\": there are .*prostate"),
                ("gland: [prostate]", "gland: []", ":7: organs.gland: empty"), ("organs: {gland", "organs: {nose", ":7: .*unknown key \"nose\": there are gland"),
                ("[muscle]", "[skin]", ":8: avoid: the scene has no region or impenetrable surface \"skin\""), ("tip_error", "tip", r":10: criteria\[0\].measure: unknown measure \"tip\": there are tip_error"),
                ("most: 5e-3, ", "", ":10: .*write either least or most"), ("most: 5e-3", "most: 1, least: 0", ":10: .*write either least or most"),
                ("most: 5e-3", "most: -1", ":10: .*a number of 0 or above"), (", source: a choice}\n  - {measure: passes", "}\n  - {measure: passes", ":10: .*missing key \"source\""),
                ("measure: passes", "measure: seed_error", ":11: .*cannot be computed: the task has no plan"), ("measure: passes", "measure: D90", "the task has no plan"),
                ("hints: [Look twice.]", "hints: Look", ":12: hints: write a list"), ("hints: [Look twice.]", "reference: run.json", ":12: reference: no file"),
                ("hints: [Look twice.]", f"plan: {PLAN}", "write either targets, .* or a plan")):
            self.assertIn(before, TARGETS)
            with self.assertRaisesRegex(BadTask, words):
                Task.read(self.task(TARGETS.replace(before, after)))
        with self.assertRaisesRegex(BadTask, "write either targets, .* or a plan"):
            Task.read(self.task(re.sub(r"targets:\n(  .*\n)+", "", TARGETS)))
        with self.assertRaisesRegex(BadTask, ":7: .*D90 cannot be computed: the task has no organs.gland"):
            Task.read(self.task(PLANNED.replace("organs: {gland: [prostate]}", "hints: [none]")))
        with self.assertRaisesRegex(BadTask, ":9: criteria: empty: a task has at least one"):
            Task.read(self.task(re.sub(r"criteria:\n(  .*\n)+", "criteria: []\n", TARGETS)))
        with self.assertRaisesRegex(BadTask, "letters, digits"):
            Task.read(self.task(TARGETS, "a task.yaml"))

    def test_mistakes_of_a_plan_are_reported_with_the_task(self):
        shutil.copy(PLAN, self.out / "plan.yaml")
        text = PLANNED.replace(str(PLAN), "plan.yaml")
        Task.read(self.task(text))
        plan = (self.out / "plan.yaml").read_text()
        (self.out / "plan.yaml").write_text(plan.replace("hole: E3, depth: 0.09475", "hole: E3, depth: 0.18"))
        with self.assertRaisesRegex(BadTask, r"task.yaml:4: plan: .*plan.yaml:\d+: needle E3: seed 1, .* is not in the tissue"):
            Task.read(self.task(text))
        (self.out / "plan.yaml").write_text(plan.replace("prescription: 145", "# none"))
        with self.assertRaisesRegex(BadTask, "D90 cannot be computed: the task has no source and prescription in its plan"):
            Task.read(self.task(text))

    def test_courses(self):
        self.task(TARGETS, "one.yaml")
        self.task(PLANNED, "two.yaml")
        course = Course.read(self.task("title: All\ntasks: [one.yaml, two.yaml]\n", "course.yaml"))
        self.assertEqual([Path(path).name for path in course.tasks], ["one.yaml", "two.yaml"])
        for text, words in (("title: All\ntasks: []\n", ":2: tasks: empty"), ("title: All\ntasks: [three.yaml]\n", r":2: tasks\[0\]: no file"),
                            ("title: All\ntasks: [one.yaml, one.yaml]\n", r":2: tasks\[1\]: a task \"one\" is in the list already")):
            with self.assertRaisesRegex(BadTask, words):
                Course.read(self.task(text, "course.yaml"))


class Shipped(Case):
    def test_the_course_and_its_tasks_are_valid(self):
        course = Course.read(SOURCE / "meshes/tasks/course.yaml")
        self.assertEqual(len(course.tasks), 7)
        for path in course.tasks:
            task = Task.read(path)
            for criterion in task.criteria:
                self.assertTrue(criterion.source, path)
            self.assertEqual(list(task.translations), ["de"], path)


    def test_the_pelvis_with_a_probe_is_the_pelvis(self):
        """Its scene differs only in mesh, content of the rectum, and probe."""
        pelvis, probe = (trocar.Scene.load(SOURCE / "meshes" / name) for name in ("pelvis.yaml", "pelvis-probe.yaml"))
        names, values = pelvis.names("regions"), lambda scene: {key: scene[key] for key in scene if not re.match(r"mesh|probe\.|regions", key)}
        self.assertEqual(values(pelvis), values(probe))
        self.assertEqual(probe.names("regions"), [name for name in names if name != "rectal_content"])
        for i, name in enumerate(probe.names("regions")):
            of = lambda scene, k: {key.partition(".")[2]: scene[key] for key in scene if key.startswith(f"regions[{k}].")}
            self.assertEqual(of(probe, i), of(pelvis, names.index(name)), name)


class Page(HTMLParser):
    """Collects the cells of tables, and checks that the page is self-contained and closes all its tags."""

    def __init__(self, text):
        super().__init__()
        self.cells, self.images, self.open, self.outside, self.words = [], [], [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag == "img":
            self.images.append(given)
        elif tag not in ("meta", "!doctype"):
            self.open.append(tag)
        if tag in ("script", "link") or "style" in given or any(str(value).startswith("http") for value in given.values()):
            self.outside.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words += data
        if self.open and self.open[-1] == "td":
            self.cells[-1] += data


class Reports(Case):
    def setUp(self):
        super().setUp()
        self.log = Log()
        self.log.tissue()
        self.log.stroke(0, 63)
        self.log.wrench(0.063, (0, 0, -7.25))
        self.log.look((0.010, -0.005, 0.063))
        self.log.tracks(straight(0.010, -0.005, 0.063), straight(-0.006, -0.005, 0.060))
        self.log.wrench(0.0)
        self.log.look((0, 0, 0))
        self.log.stroke(0, 60)
        self.log.look((-0.006, -0.005, 0.060))
        self.log.write(self.out / "run.log")

    def test_reports_have_the_numbers_of_the_score(self):
        path = self.task(TARGETS.replace("title: Two targets", "title: Two <targets> & more"))
        status, said, _ = self.run_program(self.out / "run.log", "--task", path, "--html", self.out / "r.html", "--json", self.out / "r.json", "--csv", self.out / "r.csv")
        self.assertEqual(status, 0)
        self.assertIn("tip_error              4.0 mm   at most 5.0 mm", said)
        self.assertTrue(said.endswith("passed\n"))
        result = score(Task.read(path), self.out / "run.log")
        report = json.loads((self.out / "r.json").read_text())
        self.assertEqual(report["measures"], result.measures)              # the report has every digit
        self.assertEqual((report["task"], report["began"], report["passed"]), ("task", "2023-11-14T22:13:20Z", True))
        table = {row["measure"]: row for row in csv.DictReader((self.out / "r.csv").read_text().splitlines())}
        self.assertEqual({name: float(row["value"]) for name, row in table.items()}, result.measures)
        self.assertEqual((table["passes"]["most"], table["passes"]["met"], table["force"]["met"]), ("2.0", "yes", ""))
        page = Page((self.out / "r.html").read_text())
        self.assertEqual((page.open, page.outside), ([], []))
        self.assertIn("Two <targets> & more", page.words)
        for words in ("4.0 mm", "at most 5.0 mm", "7.25 N", "a choice"):
            self.assertIn(words, page.cells)
        self.assertEqual(len(page.images), 2)
        for image in page.images:
            self.assertTrue(image["alt"])
            svg = base64.b64decode(image["src"].removeprefix("data:image/svg+xml;base64,"))
            self.assertIn(b"</svg>", svg)

    def test_the_same_recording_gives_the_same_files(self):
        path, made = self.task(TARGETS), []
        for name in ("a", "b"):
            self.run_program(self.out / "run.log", "--task", path, "--html", self.out / f"{name}.html", "--json", self.out / f"{name}.json", "--csv", self.out / f"{name}.csv")
            made.append([(self.out / f"{name}.{kind}").read_bytes() for kind in ("html", "json", "csv")])
        self.assertEqual(*made)

    def test_other_languages_have_the_same_numbers(self):
        path, cells = self.task(TARGETS), {}
        translation = "title: Zwei Ziele\ntext: Erreichen Sie beide.\nhints: [Sehen Sie zweimal hin.]\nsources: [eine Wahl, eine Wahl]\n"
        self.task(translation, "task.de.yaml")
        for language in ("en", "de", "xx"):
            self.assertEqual(self.run_program(self.out / "run.log", "--task", path, "--language", language, "--html", self.out / "r.html", "--json", self.out / f"{language}.json")[0], 0)
            text = (self.out / "r.html").read_text()
            self.assertIn(f'<html lang="{"de" if language == "de" else "en"}">', text)
            cells[language] = Page(text)
        self.assertEqual(cells["xx"].words, cells["en"].words)               # without a translation, the report is in English
        self.assertIn("Zwei Ziele", cells["de"].words)
        self.assertNotIn("Two targets", cells["de"].words)
        number = re.compile(r"[\d.]+ ?(?:mm|N|s|%|Gy)?$")
        values = [[number.search(cell).group() for cell in page.cells if number.search(cell)] for page in (cells["en"], cells["de"])]
        self.assertEqual(*values)
        self.assertEqual((self.out / "en.json").read_text(), (self.out / "de.json").read_text())
        described = self.run_program("--task", path, "--prepare", self.out / "view") and json.loads((self.out / "view/task.json").read_text())["texts"]
        self.assertEqual((described["de"]["title"], described["de"]["hints"], described["en"]["title"]), ("Zwei Ziele", ["Sehen Sie zweimal hin."], "Two targets"))
        self.assertEqual(described["de"]["criteria"][0]["limit"], described["en"]["criteria"][0]["limit"].replace("at most", "höchstens"))
        for before, after, words in (("[eine Wahl, eine Wahl]", "[eine Wahl]", "task.de.yaml:4: sources: 1 texts, the task has 2"),
                                     ("text:", "texte:", 'task.de.yaml:2: unknown key "texte"')):
            self.task(translation.replace(before, after), "task.de.yaml")
            with self.assertRaisesRegex(BadTask, words):
                Task.read(path)

    def test_all_languages_have_the_same_texts(self):
        from trocar.training import _words
        from trocar.training._measures import MEASURES
        texts = {code: json.loads((_words.FOLDER / f"{code}.json").read_text()) for code in _words.languages()}
        self.assertGreater(len(texts), 1)
        places = lambda text: sorted(re.findall(r"{\w+}", text))
        for code, own in texts.items():
            self.assertEqual(list(own), list(texts["en"]), code)
            self.assertEqual([places(text) for text in own.values()], [places(text) for text in texts["en"].values()], code)
        self.assertEqual([key for key in texts["en"] if key.startswith("measure.")], [f"measure.{name}" for name in MEASURES])

    def test_exit_status(self):
        path = self.task(TARGETS.replace("most: 5e-3", "most: 3.9e-3"))
        self.assertEqual(self.run_program(self.out / "run.log", "--task", path)[0], 1)
        self.assertEqual(self.run_program("--task", path)[:2], (0, f"{path}: 2 targets, 2 criteria\n"))
        for arguments, words in (((self.out / "none.log", "--task", path), "none.log: cannot be opened"), ((self.out / "run.log",), "--task is missing"),
                                 ((self.out / "run.log", "--task", self.out / "none.yaml"), "none.yaml: cannot be opened"),
                                 (("--task", path, "--json", "r.json"), "LOG is missing"), (("--course", path), "--course: give --runs")):
            status, _, said = self.run_program(*arguments)
            self.assertEqual(status, 2)
            self.assertIn(words, said)

    def test_comparison_with_earlier_runs_and_a_reference(self):
        runs = self.out / "runs/task"
        runs.mkdir(parents=True)
        path = self.task(TARGETS)
        self.run_program(self.out / "run.log", "--task", path, "--json", self.out / "r.json")
        report = json.loads((self.out / "r.json").read_text())
        for name, began, error in (("a", "2023-11-01T00:00:00Z", 1.5e-3), ("b", "2023-11-02T00:00:00Z", 9e-3), ("later", "2024-01-01T00:00:00Z", 0.5e-3)):
            (runs / f"{name}.json").write_text(json.dumps({**report, "began": began, "measures": {**report["measures"], "tip_error": error}}))
        (self.out / "reference.json").write_text(json.dumps({**report, "measures": {"tip_error": 0.7e-3}}))
        path.write_text(TARGETS + "reference: reference.json\n")
        self.assertEqual(self.run_program(self.out / "run.log", "--task", path, "--runs", self.out / "runs", "--html", self.out / "r.html")[0], 0)
        page = Page((self.out / "r.html").read_text())
        at = next(i for i, cell in enumerate(page.cells) if cell == "tip_error")
        self.assertEqual(page.cells[at + 2:at + 6], ["4.0 mm", "9.0 mm", "1.5 mm", "0.7 mm"])    # runs: this, previous, best so far, reference
        self.assertIn("after earlier runs: 2", page.words)
        (runs / "a.json").write_text("{}")
        status, _, said = self.run_program(self.out / "run.log", "--task", path, "--runs", self.out / "runs")
        self.assertEqual((status, "a.json: not a report of trocar-score" in said), (2, True))
        (runs / "a.json").write_text(json.dumps({**report, "task": "another"}))
        self.assertIn("a report of the task \"another\"", self.run_program(self.out / "run.log", "--task", path, "--runs", self.out / "runs")[2])

    def test_progress_in_a_course(self):
        one = self.task(TARGETS, "one.yaml")
        self.task(PLANNED, "two.yaml")
        course = self.task("title: All\ntasks: [one.yaml, two.yaml]\n", "course.yaml")
        status, said, _ = self.run_program("--course", course, "--runs", self.out / "runs")
        self.assertEqual((status, said), (1, "All\n  Two targets: not tried\n  An implant: not tried\n0 of 2 tasks passed\n"))
        (self.out / "runs/one").mkdir(parents=True)
        self.run_program(self.out / "run.log", "--task", one, "--json", self.out / "runs/one/a.json")
        status, said, _ = self.run_program("--course", course, "--runs", self.out / "runs")
        self.assertEqual((status, said), (1, "All\n  Two targets: 1 run, passed on 2023-11-14\n  An implant: not tried\n1 of 2 tasks passed\n"))

    def test_what_the_viewer_gets(self):
        path = self.task(PLANNED)
        status, said, _ = self.run_program("--task", path, "--prepare", self.out / "view")
        self.assertEqual((status, said), (0, f"scene {SCENE}\nname task\nplan {self.out}/view/plan.csv\nsource I-125 6711\nstrength 0.45\nprescription 145\n"))
        self.assertEqual(json.loads((self.out / "view/task.json").read_text())["texts"]["en"]["title"], "An implant")
        self.assertEqual(_plan_command.main(["show", str(PLAN), "--scene", str(SCENE), "--out", str(self.out / "shown.csv")]), 0)
        self.assertEqual((self.out / "view/plan.csv").read_text(), (self.out / "shown.csv").read_text())


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
