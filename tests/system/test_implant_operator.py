#!/usr/bin/python3
"""Tests trocar-device --plan against a live server: where its needles are, according to the server, when it drops their first seeds.

usage: test_implant_operator.py BUILD_DIR SOURCE_DIR
"""
import os
import signal
import struct
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../shared"))
from in_namespace import in_namespace

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
in_namespace(SOURCE)
os.environ["TROCAR_LIBRARY"] = str(BUILD / "core/libtrocar.so")
sys.path.insert(0, str(BUILD / "clients/python"))
sys.dont_write_bytecode = True
import numpy as np

import trocar
from trocar.brachy import _plan_command as plan_command, dosimetry, plan as plans
from trocar.brachy.virtual_operator import Operator as VirtualOperator

SCENE = SOURCE / "meshes/implant.yaml"
MODEL = trocar.Model(trocar.Scene.load(SCENE), mesh_only=True)
FACE = MODEL.guides[0].origin @ MODEL.guides[0].normal
PLAN = """template: template
columns: 13
rows: 13
spacing: 5e-3
needles:
  - {hole: E3, depth: 0.09475, seeds: [0.00225, 0.01225]}
  - {hole: F3, depth: 0.09975, seeds: [0.00225, 0.01225]}
"""


def events(path):
    data, at = path.read_bytes(), 0
    while at < len(data):
        _, _, _, name, size = struct.unpack_from(">IqqII", data, at)
        yield data[at + 28:at + 28 + name].decode(), data[at + 28 + name:at + 28 + name + size]
        at += 28 + name + size


class Operator(unittest.TestCase):
    def server(self):
        """Starts the server, with real-time priority if permitted, because a gap between poses at the skin may make a needle buckle."""
        for options in ([], ["--allow-non-rt"]):
            server = subprocess.Popen([BUILD / "server/trocar-server", "--scene", SCENE, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
            for line in server.stdout:
                if line == "ready\n":
                    return server
            server.wait()
        self.fail("the server does not start")

    def carry_out(self, *options):
        """Returns the table of seeds and two depths for each needle, at the end of the insertion and at the first drop. Depths are in mm behind the template's
        face, measured at the seed-side end of the needle's base."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "plan.yaml").write_text(PLAN)
            plan = plans.read(folder / "plan.yaml")
            self.assertEqual(plan_command.main(["show", str(folder / "plan.yaml"), "--scene", str(SCENE), "--out", str(folder / "plan.csv")]), 0)
            server = self.server()
            log = folder / "implant.log"
            logger = subprocess.Popen(["lcm-logger", "--force", "--quiet", "--channel=TROCAR_(COMMAND|CONTACTS|DEFORMATION|SEEDS|STATUS)", log], stderr=subprocess.DEVNULL)
            try:
                while not log.exists() or log.stat().st_size == 0:
                    self.assertIsNone(logger.poll())
                done = subprocess.run([BUILD / "clients/trocar-device", "--scene", SCENE, "--plan", folder / "plan.csv", "--realtime", "--speed", "0.6", *options], cwd=folder, capture_output=True, text=True, timeout=200)
                self.assertEqual(done.returncode, 0, done.stderr)
            finally:
                logger.send_signal(signal.SIGINT)
                logger.wait()
                server.kill()
                server.wait()
            return self.judged(folder, log, plan), done.stdout, (folder / "errors.csv").read_text() if "--errors" in options else ""

    def judged(self, folder, log, plan):
        subprocess.run(["lcm-gen", "-p", "--ppath", folder, SOURCE / "lcmtypes/trocar.lcm"], check=True, capture_output=True)
        sys.path.insert(0, str(folder))
        # removes any other module named trocar, so that the generated one is imported
        ours = {key: sys.modules.pop(key) for key in list(sys.modules) if key.split(".")[0] == "trocar"}
        from trocar import command_t, contacts_t, deformation_t, seeds_t
        for key in [key for key in sys.modules if key.split(".")[0] == "trocar"]:
            del sys.modules[key]
        sys.modules.update(ours)
        sys.path.remove(str(folder))
        depth, left, dropped, seeds, frames, last = {}, {}, {}, None, {}, 0
        self.drops = []    # number and spacing of the seeds of each DROP_SEED
        for channel, data in events(log):
            if channel == "TROCAR_CONTACTS":
                m = contacts_t.decode(data)
                depth[m.needle] = 1e3 * (m.centreline[0][2] + MODEL.needle_length - FACE)
            elif channel == "TROCAR_SEEDS":
                before, seeds = seeds.seed_count if seeds else 0, seeds_t.decode(data)
                last = seeds.tick if seeds.seed_count > before else last
            elif channel == "TROCAR_DEFORMATION":
                m = deformation_t.decode(data)
                frames[m.tick] = np.array(m.displacement)
            elif channel == "TROCAR_COMMAND":
                m = command_t.decode(data)
                if m.command == command_t.LEAVE:
                    left[m.needle] = depth[m.needle]
                elif m.command == command_t.DROP_SEED:
                    dropped.setdefault(m.needle, depth[m.needle])
                    self.drops.append((m.seeds, round(m.spacing, 6)))
        name = lambda hole: plans.hole_name(hole % 13, hole // 13)
        placed = [plans.Placed(i, "template", name(seeds.hole[i]), np.array(seeds.rest_position[i]), np.array([0, 0, 1.0])) for i in range(seeds.seed_count)]
        rows = plans.compare(plan, MODEL, placed)
        self.check_recorded(dosimetry.recorded(SCENE, log), seeds, frames[min(tick for tick in frames if tick >= last)])
        return left, dropped, [row.along for row in rows]

    def check_recorded(self, done, seeds, field):
        """Compares the outcome that trocar.brachy.dosimetry reads from the recording with the messages, decoded by lcm-gen's classes."""
        self.assertEqual(len(done.seeds), seeds.seed_count)
        for wanted, found in ((seeds.rest_position, done.seeds), (seeds.position, done.now)):
            np.testing.assert_array_equal([seed.position for seed in found], wanted)
        np.testing.assert_array_equal([seed.direction for seed in done.seeds], seeds.rest_direction)
        self.assertEqual([plans.hole_number(seed.hole) for seed in done.seeds], [(hole % 13, hole // 13) for hole in seeds.hole])
        self.assertEqual(done.needles, list(zip(seeds.needle, seeds.strand)))
        np.testing.assert_array_equal(done.field, field)
        self.assertGreater(np.abs(field).max(), 1e-4)

    def test_depths_are_read_at_the_template(self):
        """The second needle drags the first one deeper. When the first is taken again, the device still draws it back to the planned depth."""
        (left, dropped, along), said, _ = self.carry_out()
        for needle, depth in enumerate((94.75, 99.75)):
            self.assertAlmostEqual(left[needle], depth, delta=0.3)
            self.assertAlmostEqual(dropped[needle], depth, delta=0.3)
        self.assertRegex(said, r"(?m)^greatest drag +-[2-9]\.\d mm while it rested, of the needle in hole [EF]3$")
        self.assertEqual(len(along), 4)

        """The device moves to where the seeds appear in an image. That is deeper than planned, because the needles push the gland ahead of them."""
        (left, followed, closer), _, _ = self.carry_out("--operator", "image", "--image-error", "0", "--splay", "0", "--speed-spread", "0")
        for needle, depth in enumerate((94.75, 99.75)):
            self.assertGreater(left[needle], depth + 1)
        self.assertLess(np.abs(closer).mean(), np.abs(along).mean())

    def test_a_strand_is_dropped_at_once(self):
        (_, dropped, along), said, _ = self.carry_out("--strands")
        self.assertEqual(self.drops, [(2, 0.01)] * 2)
        self.assertEqual(len(along), 4)
        self.assertRegex(said, r"(?m)^implant +2 needles, 4 seeds in")
        for needle, depth in enumerate((94.75, 99.75)):
            self.assertAlmostEqual(dropped[needle], depth, delta=0.3)

    def test_the_operator_of_a_simulation_is_the_same(self):
        """The device and the Python package draw the same errors. Their seeds end up only in about the same positions, because the server's ticks and worker
        run in real time."""
        _, said, table = self.carry_out("--operator", "image", "--seed", "3", "--errors", "errors.csv")
        rows = [dict(zip(table.splitlines()[0].split(","), line.split(","))) for line in table.splitlines()[1:]]
        with tempfile.TemporaryDirectory() as name:
            (Path(name) / "plan.yaml").write_text(PLAN)
            plan = plans.read(Path(name) / "plan.yaml")
        sim = trocar.Sim(trocar.Model(trocar.Scene.load(SCENE)))
        work = VirtualOperator(plan=plan, follows_image=True, seed=3, speed=0.6 * 0.065).moves(sim, 1e-3)
        for needle, poses in work:
            sim.run(poses, 1e-3, needle)
        errors = work.errors()
        vector = lambda row, part: np.array([float(row[f"{part}_{axis} [m]"]) for axis in "xyz"])
        self.assertEqual([(row["hole"], int(row["seed"])) for row in rows], [(error.hole, error.number) for error in errors])
        for row, error in zip(rows, errors):
            np.testing.assert_allclose(vector(row, "image"), error.image, atol=1e-7)
            np.testing.assert_allclose(vector(row, "splay"), error.splay, atol=2e-5)    # not exact, because the tip depths differ
            np.testing.assert_allclose(vector(row, "planned"), error.planned, atol=1e-6)
            np.testing.assert_allclose(vector(row, "total"), error.total, atol=0.6e-3)
            np.testing.assert_allclose(sum(vector(row, part) for part in ("tissue", "image", "splay", "remainder")), vector(row, "total"), atol=1e-6)
        mean = 1e3 * np.mean([np.linalg.norm(vector(row, "total")) for row in rows])
        self.assertRegex(said, rf"(?m)^misplacement +{mean:.2f} mm, mean of 4 seeds")


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])
