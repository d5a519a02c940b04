#!/usr/bin/python3
"""Runs trocar-haply for minutes (started by hand, not by ctest), and prints the figures of docs/devices/haply.md: the time from a state to the force that
answers it, the time until the force is zero after either side has stopped, and the response to random faults of both sides.

usage: soak.py BUILD_DIR SOURCE_DIR [--minutes N] [--seed N]     defaults: 10 minutes of faults, seed 1
"""
import argparse
import json
import math
import os
import random
import signal
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.dont_write_bytecode = True
from rig import Rig
from in_namespace import in_namespace
from standin import Disconnect, use_realtime

HOME, LIMIT = (0.0, 0.1, 0.1), 0.4
WATCHDOG, SLACK = 0.02, 0.005  # s
STEP = 2e-4        # m, step of the hand, within the server's speed limit


def percentiles(values):
    values = sorted(values)
    return ", ".join(f"{name} {1e3 * values[min(len(values) - 1, int(q * len(values)))]:.2f} ms" for name, q in (("p50", 0.5), ("p99", 0.99), ("max", 1)))


def forward(distance):
    return (HOME[0], HOME[1] + distance, HOME[2])


def insert(rig, depth=0.04, speed=0.05):
    begin = time.monotonic()
    rig.service.position = lambda now: forward(min(depth, speed * max(0.0, now - begin)))
    time.sleep(depth / speed + 0.5)


def round_trips(rig, count):
    """Makes small steps with the resting hand. Returns the times from the first state that contains a step to the first force that differs, or inf if none
    differs within 80 ms."""
    insert(rig)
    times = []
    for k in range(1, count + 1):
        rest = [force for _, force in rig.since(time.monotonic() - 0.03)] or [rig.force()]
        noise = max(math.dist(rest[-1], force) for force in rest)
        depth, told = 0.04 + STEP * (k % 2), []
        rig.service.position = lambda now: told.append(now) or forward(depth)
        time.sleep(0.08 + 0.001 * random.random())
        forces = rig.since(told[0]) if told else []
        times.append(next((at - told[0] for at, force in forces if math.dist(force, rest[-1]) > max(3 * noise, 1e-4)), math.inf))
    return times


def rates(rig, seconds=5):
    begin = time.monotonic()
    time.sleep(seconds)
    return len(rig.since(begin)) / (time.monotonic() - begin)


def stops(rig, count):
    """Stops the server in the middle of an insertion, repeatedly. Returns the times from the last wrench to the last force."""
    times = []
    for _ in range(count):
        rig.wait_for_force(0.1, "no force before a stop")
        time.sleep(0.2 + 0.01 * random.random())
        rig.server.send_signal(signal.SIGSTOP)
        begin = time.monotonic()
        time.sleep(0.3)
        times.append(rig.force_without_server(begin, time.monotonic()))
        rig.server.send_signal(signal.SIGCONT)
    return times


def hangs(rig, count):
    """Checks that after the service has not answered for 0.3 s, the first force it gets is zero."""
    for _ in range(count):
        rig.wait_for_force(0.1, "no force before a hang")
        hung = []

        def hang_once(state):
            if not hung:
                hung.append(time.monotonic())
                time.sleep(0.3)
            return json.dumps(state)
        rig.service.answer = hang_once
        time.sleep(0.35)
        first = rig.since(hung[0] + 0.25)
        assert first[0][1] == (0, 0, 0), f"force after a hang: {first[0]}"
    rig.service.answer = json.dumps


# ---- random faults -----------------------------------------------------------------------------------------------------------

def damaged(state, change):
    device = state["inverse3"][0]["state"]
    if change == "nan":
        device["cursor_position"]["x"] = float("nan")
    elif change == "huge":
        device["cursor_position"]["y"] = 1e308
    elif change == "missing":
        del device["cursor_position"]
    elif change == "text":
        device["cursor_position"] = "here"
    elif change == "empty":
        state["inverse3"] = []
    elif change == "format 3.0":
        state["inverse3"] = {"049D": state["inverse3"][0]}
    elif change == "not calibrated":
        state["inverse3"][0]["status"]["calibrated"] = False
    return json.dumps(state)


class Faults:
    """Makes the service answer one message in `every` incorrectly, on average. Each force is checked at once."""

    def __init__(self, rig, random):
        self.rig, self.random, self.counts, self.judged, self.violations, self.greatest = rig, random, {}, len(rig.service.forces), [], 0.0
        self.every = 300

    def count(self, name):
        self.counts[name] = self.counts.get(name, 0) + 1

    def __call__(self, state):
        self.judge()
        self.bad = False
        if self.random.randrange(self.every):
            return json.dumps(state)
        kind = self.random.choice(("late", "cut off", "nan", "huge", "missing", "text", "empty", "format 3.0", "not calibrated", "no handle", "bad handle", "unknown",
                                   "disconnect", "bytes"))
        self.count(kind)
        if kind == "late":
            time.sleep(self.random.uniform(0.005, 0.2))
            return json.dumps(state)
        if kind == "disconnect":
            raise Disconnect
        if kind == "no handle":
            state["wireless_verse_grip"] = []
            return json.dumps(state)
        if kind == "bad handle":
            state["wireless_verse_grip"][0]["state"]["orientation"]["w"] = self.random.choice((0, 1e300, "1", None))
            return json.dumps(state)
        if kind == "unknown":
            return json.dumps({**state, "new": [[1], {"x": None}], "session_id": "seven"})
        self.bad = True
        if kind == "cut off":
            text = json.dumps(state)
            return text[:self.random.randrange(len(text))]
        if kind == "bytes":
            return bytes(self.random.randrange(256) for _ in range(self.random.randrange(400)))
        return damaged(state, kind)

    bad = False

    def judge(self):
        """Checks the forces received since the last call. Called before each answer, when the force in response to the previous one has arrived."""
        forces = self.rig.service.forces
        for at, force, _ in forces[self.judged:]:
            size = math.hypot(*force)
            self.greatest = max(self.greatest, size)
            if not size <= LIMIT + 1e-12:
                self.violations.append(f"{size} N is above the limit")
            if self.bad and size > 0:
                self.violations.append(f"{size} N after a bad message")
            if size > 0 and at - self.rig.wrenches.newest(at) > WATCHDOG + SLACK:
                self.violations.append(f"{size} N {1e3 * (at - self.rig.wrenches.newest(at)):.0f} ms after the last wrench")
        self.judged = len(forces)
        if len(forces) > 5000:
            del forces[:4000]
            self.judged -= 4000


def random_faults(rig, minutes, seed):
    r = random.Random(seed)
    faults = Faults(rig, random.Random(seed + 1))
    begin = rested = time.monotonic()

    def move(now):
        return forward(0.025 - 0.035 * math.cos(2 * math.pi * 0.25 * (now - rested)))
    rig.service.position, rig.service.answer = move, faults
    while time.monotonic() - begin < 60 * minutes:
        time.sleep(r.uniform(0.5, 4))
        kind = r.choice(("server stops", "server restarts", "clutch", "service restarts", "nothing"))
        if kind != "nothing":
            faults.count(kind)
        if kind == "server stops":
            rig.server.send_signal(signal.SIGSTOP)
            time.sleep(r.uniform(0.02, 0.8))
            rig.server.send_signal(signal.SIGCONT)
        elif kind == "server restarts":
            rig.kill_server()
            time.sleep(r.uniform(0.02, 0.8))
            rig.start_server()
        elif kind == "clutch":
            pressed = time.monotonic()
            held = move(pressed)
            rig.service.position = lambda now: (held[0] + 0.01 * math.sin(20 * (now - pressed)), *held[1:])
            rig.service.buttons["a"] = True
            time.sleep(r.uniform(0.05, 0.5))
            rig.service.position = held
            time.sleep(0.01)
            rig.service.buttons["a"] = False
            time.sleep(0.01)
            rested += time.monotonic() - pressed
            rig.service.position = move
        elif kind == "service restarts":
            rig.service.stop()
            time.sleep(r.uniform(0.05, 0.8))
            rig.service.start()
        if rig.bridge.poll() is not None:
            raise AssertionError(f"the bridge ended: {rig.bridge.returncode}\n{rig.said()}")
    # Server and service work again: the needle feels a force inside the tissue and none outside.
    rig.service.answer = json.dumps
    time.sleep(2)
    seen, end = [], time.monotonic() + 9
    while time.monotonic() < end:
        seen.append(math.hypot(*rig.force()))
        time.sleep(0.01)
    rig.stop_bridge()
    return faults, max(seen), min(seen)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("source")
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    in_namespace(arguments.source)
    use_realtime()
    random.seed(arguments.seed)
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(arguments.build, arguments.source, folder, realtime=True)
        rig.service.position = HOME
        try:
            rig.start_server()
            rig.start_bridge("--max-force", str(LIMIT), "--realtime", "--report", "10")
            print(f"load {os.getloadavg()[0]:.2f}")
            times = round_trips(rig, 500)
            print(f"state to force      {percentiles(times)} (500 steps of the hand, {times.count(math.inf)} of them without an answer within 80 ms)", flush=True)
            print(f"messages            {rates(rig):.0f} a second", flush=True)
            print(f"server stopped      last force after its last wrench: {percentiles(stops(rig, 50))} (50 times)", flush=True)
            hangs(rig, 50)
            print("service hangs       first force after 0.3 s: 0 N (50 times)", flush=True)
            faults, most, least = random_faults(rig, arguments.minutes, arguments.seed)
            print(f"random faults       {arguments.minutes:g} minutes, seed {arguments.seed}: " + ", ".join(f"{n} {name}" for name, n in sorted(faults.counts.items())))
            print(f"greatest force      {faults.greatest:.6f} N, limit {LIMIT} N; at the end {least:.3f} to {most:.3f} N")
            print(f"load {os.getloadavg()[0]:.2f}")
            print(rig.out.read_text().splitlines()[-1])
            assert not faults.violations, f"{len(faults.violations)} violations: {faults.violations[:10]}"
            assert most > 0.1 and least < 0.01, "a force is stuck"
            assert rig.force() == (0, 0, 0) and rig.bridge.returncode == 0, "the end"
        except AssertionError:
            print(rig.said()[-3000:], file=sys.stderr)
            raise
        finally:
            rig.end()
    print("passed")


if __name__ == "__main__":
    main()
