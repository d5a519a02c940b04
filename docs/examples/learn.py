#!/usr/bin/python3
"""Learns to steer a bevelled needle to its target, with the cross-entropy method, in a few minutes on two cores.

usage: learn.py [CURVE.csv]    also writes the learning curve

The needle is pushed at full speed, and its roll rate is tanh(w o), where o consists of the observation, multiplied by fixed scales, and a 1. A
generation draws 16 vectors w from a normal distribution, tries each in the same episodes, and fits the distribution to the best four (Rubinstein 1999,
Methodology and Computing in Applied Probability 1:127-190), with added variance against early convergence (Szita and Lorincz 2006, Neural Computation
18:2936-2941).
"""
import csv
import sys
import time

import gymnasium
import numpy as np

import trocar.gym

CANDIDATES, ELITE, GENERATIONS = 16, 4, 8
ROWS = 32                                  # episodes that run side by side, ROWS / CANDIDATES for each candidate
SCALES = np.array([1.0, 1.0, 0.02, 0.2, 0.2, 0.2, 0.02])    # per mm (target in the tip's frame), N (force) and mm (depth)
START, EXTRA = 1.0, 0.3                    # standard deviations: initial, and added in the first generation; less is added in later ones
TEST = 1_000_000                           # first seed of the test episodes, which are not used for training


def linear(weights, observations):
    """Returns the actions (rows, 2) of controllers with weights (8,) or (rows, 8)."""
    features = np.concatenate([SCALES * observations, np.ones((len(observations), 1))], axis=1)
    return np.stack([np.ones(len(observations)), np.tanh(np.sum(weights * features, axis=1))], axis=1)


def pushed(_, observations):
    return np.tile([1.0, 0.0], (len(observations), 1))


def turned(_, observations):
    return np.tile([1.0, 1.0], (len(observations), 1))


def run(env, policy, weights, seeds):
    """Returns the sum of rewards and the last error (mm) of an episode in each row; weights (8,) or (rows, 8)."""
    observations, info = env.reset(seed=seeds)
    running = np.ones(env.num_envs, bool)
    total, error = np.zeros(env.num_envs), np.zeros(env.num_envs)
    while running.any():                   # rows that have ended begin another episode, which is not counted
        observations, reward, terminated, truncated, info = env.step(policy(weights, observations))
        total += np.where(running, reward, 0.0)
        error = np.where(running, 1e3 * info["error"], error)
        running &= ~(terminated | truncated)
    return total, error


def learn(env, random, report):
    """Returns the weights (8,) that have been learned."""
    mean, deviation, each = np.zeros(len(SCALES) + 1), np.full(len(SCALES) + 1, START), ROWS // CANDIDATES
    for generation in range(GENERATIONS):
        candidates = mean + deviation * random.standard_normal((CANDIDATES, len(mean)))
        seeds = [generation * each + i for i in range(each)] * CANDIDATES    # rows 0 and 1 belong to candidate 0, rows 2 and 3 to candidate 1, ...
        total, error = run(env, linear, np.repeat(candidates, each, axis=0), seeds)
        best = np.argsort(total.reshape(CANDIDATES, each).sum(axis=1))[-ELITE:]
        report("tried", (generation + 1) * ROWS, error)
        report("best four", (generation + 1) * ROWS, error.reshape(CANDIDATES, each)[best])
        mean = candidates[best].mean(axis=0)
        deviation = np.sqrt(candidates[best].var(axis=0) + (EXTRA * max(0.0, 1.0 - 1.5 * generation / GENERATIONS)) ** 2)
    return mean


def main(path=None):
    env = gymnasium.make_vec("trocar/Reach-v0", num_envs=ROWS)
    begun, rows = time.monotonic(), []

    def report(controller, episodes, error):
        rows.append((controller, episodes, f"{error.mean():.3f}", f"{np.quantile(error, 0.9):.3f}"))
        print(f"{time.monotonic() - begun:.0f} s, {episodes} episodes, {controller}: error {error.mean():.2f} mm, 90 % below {np.quantile(error, 0.9):.2f} mm", flush=True)

    weights = learn(env, np.random.default_rng(1), report)
    print("learned:", np.array2string(weights, precision=3, separator=", "), flush=True)
    for name, policy in (("learned", linear), ("pushed without turning", pushed), ("turned all the time", turned)):
        report(name, GENERATIONS * ROWS, run(env, policy, weights, [TEST + i for i in range(ROWS)])[1])
    if path:
        with open(path, "w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["controller", "episodes", "mean error [mm]", "90 % quantile [mm]"])
            table.writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
