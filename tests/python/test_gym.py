#!/usr/bin/python3
"""Tests the Gymnasium environments by comparing them with simulations stepped here and with each other, and runs Gymnasium's checker. If gymnasium is not
installed, a stand-in takes its place (gymnasium_standin.py), and the checker is not run.

usage: test_gym.py BUILD_DIR SOURCE_DIR
"""
import os
import re
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

try:
    import gymnasium
    STANDIN = False
except ImportError:
    import gymnasium_standin
    gymnasium_standin.install()
    import gymnasium
    STANDIN = True

import numpy as np

import trocar
import trocar.gym
from trocar.gym import NeedleEnv, VectorNeedleEnv

SCENE = SOURCE / "meshes/figure8.yaml"
TARGET = np.array([1e-3, -2e-3, 0.03])    # m, relative to the entry point
ENTRY = np.array([0.005, 0.003, 0.0])     # m: where the needle meets the skin from its default start
TASK = f"""scene: {SCENE}
set: {{needle.bevel_slope: 0.1}}
target: {{x: [{TARGET[0]}, {TARGET[0]}], y: [{TARGET[1]}, {TARGET[1]}], depth: [{TARGET[2]}, {TARGET[2]}]}}
"""
RANDOM = TASK.replace(f"x: [{TARGET[0]}, {TARGET[0]}]", "x: [-2e-3, 2e-3]") + """randomise:
  needle.bevel_slope: [0.05, 0.15]
  regions[surrounding].youngs_modulus: [20e3, 40e3]
stiffnesses: 2
"""
QUICK = RANDOM[:RANDOM.index("  regions")]    # one model only
OBSTACLE = "obstacle: {along: [0.5, 0.5], x: [%g, %g], y: [0, 0], radius: [1e-3, 1e-3]}\n"
PUSH, HALF = np.array([1.0, 0.0], np.float32), np.array([0.5, 0.3], np.float32)


class Case(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def file(self, text=TASK):
        (self.folder / "task.yaml").write_text(text)
        return self.folder / "task.yaml"

    def episode(self, env, actions, seed=1):
        """Returns (observations, rewards, terminated, infos) of an episode, which ends after the last action at the latest."""
        observation, info = env.reset(seed=seed)
        found, ends = [(observation, 0.0, info)], False
        for action in actions:
            observation, reward, ends, truncated, info = env.step(action)
            self.assertFalse(truncated)
            found.append((observation, reward, info))
            if ends:
                break
        return np.array([f[0] for f in found]), np.array([f[1] for f in found]), ends, [f[2] for f in found]


def place_in(model, point):
    """Returns the nodes (4,) of the tetrahedron that contains a point of the tissue at rest, and the point's weights."""
    corners = model.nodes[model.tets]
    inner = np.linalg.solve((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1), point - corners[:, 0])
    weights = np.concatenate([1.0 - inner.sum(axis=1, keepdims=True), inner], axis=1)
    best = weights.min(axis=1).argmax()
    assert weights[best].min() > -1e-9
    return model.tets[best], weights[best]


class MechanicsTest(Case):
    def test_steps_are_those_of_a_simulation(self):
        """Compares depth, force, error and the observed target with a `Sim` given the specified poses: 50 mm/s and 12 rad/s for 20 ticks of 1 ms."""
        env = NeedleEnv("reach", self.file())
        actions = [HALF] * 30 + [np.array([1.0, -0.5], np.float32)] * 20
        observations, _, _, infos = self.episode(env, actions)
        scene = trocar.Scene.load(SCENE)
        scene["needle.bevel_slope"] = 0.1
        sim = trocar.Sim(trocar.Model(scene))
        nodes, weights = place_in(sim.model, ENTRY + TARGET)
        travel = roll = 0.0
        pose = np.array([0.005, 0.003, -0.201, 1, 0, 0, 0])
        sim.reset(pose)
        for count, (speed, rate) in enumerate(actions[:len(infos) - 1], 1):
            for _ in range(20):
                travel, roll = travel + 0.05 * float(speed) * 1e-3, roll + 12.0 * float(rate) * 1e-3
                out = sim.step([0.005, 0.003, -0.201 + travel, np.cos(roll / 2), 0, 0, np.sin(roll / 2)], 1e-3)
            away = ENTRY + TARGET + weights @ sim.displacements()[nodes] - sim.centreline()[-1]
            with self.subTest(count):
                self.assertAlmostEqual(observations[count][6], 1e3 * out.depth, delta=1e-3)
                np.testing.assert_allclose(np.linalg.norm(observations[count][3:6]), np.linalg.norm(out.force), atol=1e-4)
                self.assertAlmostEqual(infos[count]["error"], np.linalg.norm(away), delta=1e-8)
                np.testing.assert_allclose(np.linalg.norm(observations[count][:3]), 1e3 * np.linalg.norm(away), rtol=1e-5)
        self.assertGreater(out.depth, 0.02)

    def test_target_is_observed_in_the_frame_of_the_tip(self):
        """Before the insertion, the needle is straight, so the target's coordinates are those in the file plus 1 mm along the needle. After a roll by a right
        angle in the air, what was +y (the bevel's side) is +x."""
        env = NeedleEnv("reach", self.file())
        observation, _ = env.reset(seed=1)
        np.testing.assert_allclose(observation[:3], 1e3 * (TARGET + [0, 0, 1e-3]), atol=1e-4)
        for _ in range(10):
            observation, *_ = env.step(np.array([0.0, np.pi / 2 / 2.4], np.float32))
        np.testing.assert_allclose(observation[:3], 1e3 * np.array([TARGET[1], -TARGET[0], TARGET[2] + 1e-3]), atol=1e-3)

    def test_a_needle_that_is_not_turned_curves_towards_minus_y(self):
        observations, *_ = self.episode(NeedleEnv("reach", self.file(TASK.replace(str(TARGET[1]), "0").replace(str(TARGET[0]), "0"))), [PUSH] * 35)
        self.assertGreater(observations[-1][1], 0.5)
        self.assertLess(abs(observations[-1][0]), 0.3 * observations[-1][1])

    def test_rewards_sum_to_the_progress(self):
        _, rewards, ends, infos = self.episode(NeedleEnv("reach", self.file()), [PUSH] * 60)
        self.assertTrue(ends)
        self.assertAlmostEqual(rewards.sum(), 1e3 * (infos[0]["error"] - infos[-1]["error"]), delta=1e-9)
        self.assertFalse(infos[-1]["is_success"])

    def test_episode_ends_when_the_tip_passes_the_target(self):
        """The tip's distance from the target along z is positive until the last step. After that, the tip is beyond the target by at most the 1 mm of a step
        plus the tissue's displacement."""
        straight = TASK.replace("needle.bevel_slope: 0.1", "needle.bevel_slope: 0").replace(str(TARGET[0]), "0").replace(str(TARGET[1]), "0")
        observations, _, ends, infos = self.episode(NeedleEnv("reach", self.file(straight)), [PUSH] * 60)
        self.assertTrue(ends)
        self.assertGreater(observations[-2][2], 0.0)
        self.assertLessEqual(observations[-1][2], 1e-3)
        self.assertGreater(observations[-1][2], -2.0)
        self.assertTrue(infos[-1]["is_success"])

    def test_base_does_not_go_back_beyond_its_start(self):
        env = NeedleEnv("reach", self.file())
        first, _ = env.reset(seed=1)
        observation, *_ = env.step(np.array([-1.0, 0.0], np.float32))
        np.testing.assert_array_equal(observation, first)

    def test_obstacle_on_the_line_is_hit(self):
        """A straight 1.27 mm needle hits a sphere of 1 mm radius in its path, at a cost of 20 mm, and misses one whose surface is at least 0.4 mm from the
        needle."""
        straight = TASK.replace("needle.bevel_slope: 0.1", "needle.bevel_slope: 0").replace(str(TARGET[0]), "0").replace(str(TARGET[1]), "0")
        observations, rewards, ends, infos = self.episode(NeedleEnv("avoid", self.file(straight + OBSTACLE % (0, 0))), [PUSH] * 60)
        self.assertTrue(ends and infos[-1]["hit"] and not infos[-1]["is_success"])
        np.testing.assert_allclose(observations[0][7:11], [0, 0, 16, 1], atol=1e-3)
        distance = np.linalg.norm(observations[:, 7:10], axis=1)
        self.assertGreater(distance[-2], 1.0 + 0.5 * 1.27)
        self.assertLess(distance[-1], 1.0 + 0.5 * 1.27)
        self.assertAlmostEqual(rewards.sum(), 1e3 * (infos[0]["error"] - infos[-1]["error"]) - 20.0, delta=1e-9)
        beside = 1e-3 + 0.5 * 1.27e-3 + 0.4e-3
        _, _, ends, infos = self.episode(NeedleEnv("avoid", self.file(straight + OBSTACLE % (beside, beside))), [PUSH] * 60)
        self.assertTrue(ends and not infos[-1]["hit"] and infos[-1]["is_success"])

    def test_seed_is_left_where_a_simulation_leaves_it(self):
        """The final error is the seed's distance from the target in the tissue at rest, and each mm of displacement costs 5 mm per second."""
        env = NeedleEnv("implant", self.file())
        push, release = np.array([1.0, 0.0, -1.0], np.float32), np.array([0.0, 0.0, 1.0], np.float32)
        observation, info = env.reset(seed=1)
        self.assertFalse(env.step(release)[2], "there is no tissue at the tip yet")
        _, rewards, ends, infos = self.episode(env, [push] * 33 + [release])
        self.assertTrue(ends)
        scene = trocar.Scene.load(SCENE)
        scene["needle.bevel_slope"] = 0.1
        sim = trocar.Sim(trocar.Model(scene))
        way = np.concatenate([np.arange(1, 661) * 5e-5, np.full(20, 0.033)])
        pose = lambda z: np.array([0.005, 0.003, -0.201 + z, 1, 0, 0, 0])
        sim.reset(pose(0))
        sim.run([pose(z) for z in way], 1e-3)
        sim.drop_seeds(1)
        sim.run([pose(0.033 - z) for z in np.arange(1, 301) * 5e-5], 1e-3)
        self.assertAlmostEqual(infos[-1]["error"], np.linalg.norm(sim.seeds()[0].position - ENTRY - TARGET), delta=1e-8)
        cost = 5.0 * 0.02 * 1e3 * sum(info["displacement"] for info in infos[1:])
        self.assertGreater(cost, 0.0)
        self.assertAlmostEqual(rewards.sum(), 1e3 * (infos[0]["error"] - infos[-1]["error"]) - cost, delta=1e-9)


class RandomTest(Case):
    def test_equal_seeds_give_equal_episodes(self):
        file = self.file(RANDOM)
        first, second = NeedleEnv("reach", file), NeedleEnv("reach", file)
        actions = [HALF] * 40
        one, other, again = self.episode(first, actions, 7), self.episode(second, actions, 7), self.episode(first, actions, 7)
        for found in (other, again):
            np.testing.assert_array_equal(one[0], found[0])
            np.testing.assert_array_equal(one[1], found[1])
        self.assertFalse(np.array_equal(one[0][0], self.episode(first, actions[:1], 8)[0][0]))

    def test_a_reset_without_seed_goes_on(self):
        env = NeedleEnv("reach", self.file(QUICK))
        places = [env.reset(seed=3)[0], env.reset()[0], env.reset(seed=3)[0], env.reset()[0]]
        np.testing.assert_array_equal(places[0], places[2])
        np.testing.assert_array_equal(places[1], places[3])
        self.assertFalse(np.array_equal(places[0], places[1]))

    def test_targets_fill_their_range(self):
        env = NeedleEnv("reach", self.file(QUICK))
        x = [env.reset(seed=seed)[0][0] for seed in range(60)]
        self.assertTrue(-2.0 <= min(x) < -1.5 and 1.5 < max(x) <= 2.0, x)

    def test_bevel_varies(self):
        """Slopes from 0.05 to 0.15: near the same target, deflections differ by a factor of up to three."""
        env = NeedleEnv("reach", self.file(QUICK.replace("x: [-2e-3, 2e-3]", "x: [0, 0]").replace(str(TARGET[1]), "0")))
        deflections = [self.episode(env, [PUSH] * 27, seed)[0][-1][1] for seed in range(12)]
        self.assertTrue(1.5 < max(deflections) / min(deflections) < 3.5, deflections)

    def test_stiffness_varies(self):
        """Each episode uses one of two models."""
        env = NeedleEnv("reach", self.file(TASK + "randomise:\n  regions[surrounding].youngs_modulus: [20e3, 40e3]\nstiffnesses: 2\n"))
        self.assertEqual(len({self.episode(env, [PUSH] * 5, seed)[0][-1].tobytes() for seed in range(12)}), 2)

class VectorTest(Case):
    def test_rows_are_single_environments(self):
        """Tests all three autoreset modes: the sequences of episodes in the rows are those of single environments with seeds 5, 6 and 7."""
        random = np.random.default_rng(0)
        actions = random.uniform([-0.2, -1.0], 1.0, (130, 3, 2)).astype(np.float32)
        for mode in ("NextStep", "SameStep", "Disabled"):
            with self.subTest(mode):
                file = self.file(RANDOM if mode == "NextStep" else QUICK)
                vector = VectorNeedleEnv(3, "reach", file, max_episode_steps=55, threads=2, autoreset_mode=mode)
                singles = [NeedleEnv("reach", file) for _ in range(3)]
                observations, _ = vector.reset(seed=5)
                for row, env in enumerate(singles):
                    np.testing.assert_array_equal(observations[row], env.reset(seed=5 + row)[0])
                steps, over, restarts = [0] * 3, [False] * 3, 0
                for action in actions:
                    observations, rewards, terminated, truncated, info = vector.step(action)
                    for row, env in enumerate(singles):
                        if over[row] and mode == "NextStep":
                            expected, reward, ended, steps[row] = env.reset()[0], 0.0, False, 0
                        else:
                            expected, reward, ended, _, single = env.step(action[row])
                            steps[row] += 1
                        cut = steps[row] == 55
                        self.assertEqual((rewards[row], terminated[row], truncated[row]), (reward, ended, cut))
                        over[row] = ended or cut
                        restarts += over[row]
                        if over[row] and mode == "SameStep":
                            np.testing.assert_array_equal(info["final_obs"][row], expected)
                            self.assertEqual(info["final_info"]["error"][row], single["error"])
                            expected, steps[row] = env.reset()[0], 0
                        np.testing.assert_array_equal(observations[row], expected)
                    if mode == "Disabled" and any(over):
                        with self.assertRaisesRegex(gymnasium.error.ResetNeeded, "reset_mask"):
                            vector.step(action)
                        observations, _ = vector.reset(options={"reset_mask": np.array(over)})
                        for row in np.flatnonzero(over):
                            np.testing.assert_array_equal(observations[row], singles[row].reset()[0])
                            steps[row], over[row] = 0, False
                self.assertGreaterEqual(restarts, 4)

    def test_threads_do_not_matter(self):
        found = []
        for threads in (1, 2):
            env = VectorNeedleEnv(4, "reach", self.file(QUICK), threads=threads)
            env.reset(seed=1)
            found.append([env.step(np.tile(HALF, (4, 1)))[0] for _ in range(30)])
        np.testing.assert_array_equal(*found)

    def test_bad_arguments(self):
        env = VectorNeedleEnv(2, "reach", self.file())
        for arguments, words in (({"seed": [1, 2, 3]}, "3 seeds: write one, or 2"), ({"options": {"reset_mask": np.zeros(2, bool)}}, "2 booleans, at least one"),
                                 ({"options": {"reset_mask": [1, 0]}}, "2 booleans")):
            with self.assertRaisesRegex(ValueError, words):
                env.reset(**arguments)
        with self.assertRaisesRegex(ValueError, "rgb_array"):
            NeedleEnv("reach", self.file(), render_mode="human")


class PictureTest(Case):
    def test_target_and_needle_are_where_they_should_be(self):
        """The rendered image shows 80 mm, from 10 mm in front of the skin to 20 mm beyond the range of targets. The target is 30 mm deep, 1 mm along x and -2
        mm along y."""
        env = NeedleEnv("reach", self.file(TASK.replace("depth: [0.03, 0.03]", "depth: [0.03, 0.05]")), render_mode="rgb_array")
        env.reset(seed=1)
        picture = env.render()
        self.assertEqual((picture.shape, picture.dtype), ((240, 800, 3), np.uint8))
        depth = env.reset(seed=1)[0][2] - 1.0
        for left, up in ((0, -2.0), (400, 1.0)):
            rows, columns = np.nonzero(np.all(picture[:, left:left + 400] == (0, 127, 95), axis=2))
            self.assertAlmostEqual(columns.mean(), 5.0 * (10.0 + depth), delta=0.6)
            self.assertAlmostEqual(rows.mean(), 120.0 - 5.0 * up, delta=0.6)
            rows, columns = np.nonzero(np.all(picture[:, left:left + 400] == (36, 41, 47), axis=2))
            self.assertAlmostEqual(columns.max(), 5.0 * 9.0, delta=1.6)    # the tip is 1 mm in front of the skin
            self.assertAlmostEqual(rows.mean(), 120.0, delta=0.6)
        self.assertIsNone(NeedleEnv("reach", self.file()).render())

    def test_borders_of_regions_are_drawn(self):
        """The section shows the skin at depth 0, and the gland, an ellipsoid centred 55 mm deep with a semi-axis of 20 mm along the needle."""
        env = NeedleEnv("reach", self.file(TASK.replace("depth: [0.03, 0.03]", "depth: [0.07, 0.07]")), render_mode="rgb_array")
        env.reset(seed=1)
        border = np.all(env.render()[:, :400] == (138, 146, 155), axis=2)
        columns = np.flatnonzero(border.any(axis=0)) / 4.0 - 10.0    # mm, depth: 400 pixels for 100 mm
        self.assertAlmostEqual(columns.min(), 0.0, delta=0.5)
        self.assertAlmostEqual(columns[columns > 1.0].min(), 36.0, delta=1.5)
        self.assertAlmostEqual(columns.max(), 74.0, delta=1.5)


class FileTest(Case):
    def test_faults_name_line_and_remedy(self):
        faults = (("speed: 0\n", r"task.yaml:4: speed: \"0\": write a number above 0"),
                  ("speeed: 1\n", r"task.yaml:4: unknown key \"speeed\""),
                  ("randomise: {needle.bevel: [0, 1]}\n", r"task.yaml:4: randomise.needle.bevel: scene: no key"),
                  ("randomise: {needle.bevel_slope: [0.1, 2]}\n", r"task.yaml:4: randomise.needle.bevel_slope: "),
                  ("randomise: {needle.bevel_slope: [0.2, 0.1]}\n", "write the lower limit, then the upper one"),
                  ("randomise: {needle.length: [0.1, 0.2]}\n", "except for its start and length"),
                  ("obstacle: {along: [0, 1], x: [0, 0], y: [0, 0], radius: [0, 0]}\n", "radii above 0"),
                  ("set: {}\n", "given twice"))
        for text, words in faults:
            with self.subTest(text), self.assertRaisesRegex(trocar.gym.BadTask, words):
                trocar.gym.read("avoid" if "obstacle" in text else "reach", self.file(TASK + text))
        with self.assertRaisesRegex(trocar.gym.BadTask, "task.yaml:3: target: a corner of the ranges is outside the tissue"):
            trocar.gym.read("reach", self.file(TASK.replace(f"depth: [{TARGET[2]}", "depth: [-0.001")))
        with self.assertRaisesRegex(trocar.gym.BadTask, "missing key \"obstacle\""):
            trocar.gym.read("avoid", self.file())
        with self.assertRaisesRegex(trocar.gym.BadTask, "there are reach, avoid, implant"):
            trocar.gym.read("biopsy")

    def test_without_gymnasium_the_import_says_what_to_install(self):
        program = "import sys; sys.modules['gymnasium'] = None\nimport trocar.gym"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(BUILD / "clients/python")})
        self.assertNotEqual(done.returncode, 0)
        self.assertRegex(done.stderr, "trocar.gym needs the package gymnasium, 1.0 or newer: run `pip install gymnasium`")


@unittest.skipIf(STANDIN, "gymnasium is not installed: pip install gymnasium, in an environment made by python3 -m venv --system-site-packages")
class CheckerTest(Case):
    def test_gymnasiums_checker_passes(self):
        from gymnasium.utils.env_checker import check_env
        for task, text in (("reach", RANDOM), ("avoid", QUICK + OBSTACLE % (0, 0)), ("implant", QUICK)):
            with self.subTest(task), warnings.catch_warnings():
                warnings.simplefilter("error")
                check_env(gymnasium.make(f"trocar/{task.capitalize()}-v0", file=self.file(text)).unwrapped)

    def test_files_of_the_package_can_be_used(self):
        for task in trocar.gym.TASKS:
            env = gymnasium.make(f"trocar/{task.capitalize()}-v0")
            observation, info = env.reset(seed=1)
            self.assertTrue(30.0 < observation[2] < 70.0 and not info["is_success"])

    def test_vector_environment_is_that_of_gymnasium(self):
        """At every step, observations, rewards, termination, truncation and infos equal those of Gymnasium's SyncVectorEnv with its wrapper's time limit."""
        from gymnasium.vector import SyncVectorEnv
        for task, text, mode in (("reach", QUICK, "NextStep"), ("avoid", QUICK + OBSTACLE % (0, 0), "SameStep"), ("implant", QUICK, "NextStep")):
            with self.subTest(task):
                id, options = f"trocar/{task.capitalize()}-v0", {"file": self.file(text), "max_episode_steps": 50}
                own = gymnasium.make_vec(id, num_envs=2, autoreset_mode=mode, **options)
                other = SyncVectorEnv([lambda: gymnasium.make(id, **options)] * 2, autoreset_mode=mode)
                self.assertEqual((own.observation_space, own.action_space), (other.observation_space, other.action_space))
                self.assertEqual(own.metadata["autoreset_mode"], other.metadata["autoreset_mode"])
                own.action_space.seed(0)
                self.equal(own.reset(seed=3), other.reset(seed=3))
                for _ in range(110):
                    action = own.action_space.sample()
                    action[:, 0] = np.abs(action[:, 0])
                    action[:, 2:] -= 0.95    # so that seeds are seldom released
                    found, expected = own.step(action), other.step(action)
                    self.assertIn(found[0], own.observation_space)
                    self.equal(found, expected)

    def equal(self, found, expected):
        if isinstance(expected, dict):
            self.assertEqual(found.keys(), expected.keys())
            for key in expected:
                valid = expected.get("_" + key, slice(None))
                self.equal(*((each[key] if isinstance(each[key], dict) else each[key][valid]) for each in (found, expected)))
        elif isinstance(expected, tuple):
            for one, other in zip(found, expected):
                self.equal(one, other)
        elif getattr(expected, "dtype", None) == object:
            for one, other in zip(found, expected):
                np.testing.assert_array_equal(one, other)
        else:
            np.testing.assert_array_equal(found, expected)


if __name__ == "__main__":
    unittest.main(argv=[sys.argv[0], *sys.argv[3:]])
