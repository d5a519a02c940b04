#!/usr/bin/python3
"""Tests that trocar-view's report at the end of a task and the one trocar-score makes later, from the viewer's recording and from one by lcm-logger, have the
same numbers to the last digit. Each run is random: scene, targets or plan, holes, depths, speeds, seeds, and what the hand does. The runs are driven over
the page's WebSocket, with a live server.

usage: test_reports.py BUILD_DIR SOURCE_DIR [RUNS [SEED [TABLE.csv]]]        exit status 77: namespaces or lcm-logger are not available
"""
import csv
import json
import os
import random
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import web_client as web
sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "../shared"))
from in_namespace import in_namespace

BUILD, SOURCE = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
RUNS, SEED, TABLE = int((sys.argv + ["3"] * 3)[3]), int(sys.argv[4]) if len(sys.argv) > 4 else 1, sys.argv[5] if len(sys.argv) > 5 else ""
if not shutil.which("lcm-logger"):
    sys.exit(77)
in_namespace(SOURCE)
START, FINISH = 13, 14
URGENT = ["chrt", "--fifo", "60"] if subprocess.run(["chrt", "--fifo", "60", "true"], stderr=subprocess.DEVNULL, check=False).returncode == 0 else []
SCENES = {"implant": {"gland": ["prostate"]}, "pelvis": {"gland": ["prostate"], "urethra": ["urethra"], "rectum": ["rectum", "rectal_content"]}}
AVOID = {"implant": ["muscle"], "pelvis": ["urethra", "rectum", "bladder", "bone"]}
CHANNELS = "TROCAR_(WRENCH|DEFORMATION|TRACKS|SEEDS|CONTACTS|PROBE_WRENCH)"    # channels whose messages the score uses
FACE = -0.025                                                     # m, z of the template's face
EVENT = struct.Struct(">IqqII")                                   # header of an event in an LCM log: mark, number, time, lengths of channel and data


# ---- a random task ------------------------------------------------------------------------------------------------------------------------


def random_needles(rng):
    """Returns (column, row, depth, seeds): depth (m) of the tip from the template's face, and the seeds' distances (m) from it."""
    holes = rng.sample([(column, row) for column in range(3, 10) for row in range(4, 9)], rng.randint(1, 3))
    return [(column, row, round(rng.uniform(0.075, 0.095), 5), [round(0.00225 + 0.01 * k, 5) for k in range(rng.randint(1, 3))]) for column, row in holes]


def hole_name(column, row):
    return f"{'ABCDEFGHIJKLM'[column]}{1 + row / 2:g}"


def write_task(folder, rng, scene, needles):
    """Writes a task with random criteria. Returns its path and its kind."""
    of_plan = rng.random() < 0.6
    lines = ["title: A random task", "text: Do something.", f"scene: {SOURCE}/meshes/{scene}.yaml", f"organs: {json.dumps(SCENES[scene])}", f"avoid: {json.dumps(AVOID[scene])}"]
    measures = ["passes", "redirections", "path", "time", "force", "displacement", "organs_touched"]
    if of_plan:
        measures += ["seed_error", "seed_error_largest", "seeds_missing", "seeds_extra", "D90", "V100", "V150"]
        measures += ["rectum_D2cc", "urethra_D10"] if scene == "pelvis" else []
        rows = [f"  - {{hole: {hole_name(c, r)}, depth: {depth}, seeds: {seeds}}}" for c, r, depth, seeds in needles]
        (folder / "plan.yaml").write_text("\n".join(["template: template", "columns: 13", "rows: 13", "spacing: 5e-3",
                                                     'source: {isotope: I-125, model: "6711", strength: 0.45}', f"prescription: {rng.choice([110, 145])}", "needles:", *rows]) + "\n")
        lines.append("plan: plan.yaml")
    else:
        measures += ["tip_error"]
        lines.append("targets:")
        for i, (c, r, depth, _) in enumerate(needles):
            position = [5e-3 * (6 - c) + rng.uniform(-2e-3, 2e-3), 5e-3 * (r - 6) + rng.uniform(-2e-3, 2e-3), FACE + depth + rng.uniform(-4e-3, 4e-3)]
            lines.append(f"  - {{name: t{i}, position: {position}, hole: {hole_name(c, r)}}}")
    lines.append("criteria:")
    lines += [f"  - {{measure: {name}, {rng.choice(['least', 'most'])}: {10 ** rng.uniform(-4, 3):.9g}, source: random}}" for name in measures]
    path = folder / "random.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path, "plan" if of_plan else "targets"


# ---- a random hand ------------------------------------------------------------------------------------------------------------------------


class Hand:
    """Drives a needle with the commands that a page sends. A stroke that does not end in time, as may happen on a busy machine, is given up, and the run is
    scored all the same."""

    def __init__(self, browser, rng):
        self.browser, self.rng = browser, rng

    def until(self, done, steer=None, seconds=20.0, again=None):
        end, asked = time.monotonic() + seconds, 0.0
        while not done() and time.monotonic() < end:
            if again and time.monotonic() - asked > 0.5:
                again()
                asked = time.monotonic()
            if steer:
                self.browser.say(web.STEER, *steer)
            self.browser.hear()
        return done()

    def stroke(self, needle, depth):
        """Moves the tip to a depth (m) in the tissue, with a random speed, roll and sideways motion."""
        forward = self.browser.depth.get(needle, 0) < depth
        speed, roll, aside = self.rng.uniform(0.3, 1.0), self.rng.choice([0, 0, self.rng.uniform(-1, 1)]), self.rng.uniform(-0.02, 0.02)
        done = (lambda: self.browser.depth.get(needle, 0) >= depth) if forward else (lambda: self.browser.depth.get(needle, 0) <= depth)
        reached = self.until(done, (aside, 0, speed if forward else -speed, 0, 0, roll))
        self.browser.say(web.STEER)
        return reached

    def work(self, needle, column, row, depth, seeds):
        """Inserts a needle, may draw it back and push it further, may drop seeds, and leaves or withdraws it. Returns the number of seeds requested."""
        browser, rng, dropped = self.browser, self.rng, 0
        of_needle = lambda: browser.status.get("needles", [{}] * 16)[needle]
        self.until(lambda: browser.status.get("drives") and of_needle().get("owned") == "here", again=lambda: browser.say(web.TAKE, needle=needle))
        self.until(lambda: (browser.status.get("hole") or {}).get("column") == column and not browser.status["hole"]["approaching"],
                   again=lambda: (browser.status.get("hole") or {}).get("column") == column or browser.say(web.HOLE, 0, column, row))
        deep = FACE + depth + rng.uniform(-3e-3, 3e-3)
        self.stroke(needle, deep)
        if rng.random() < 0.4:
            self.stroke(needle, deep - rng.uniform(3e-3, 12e-3))
            self.stroke(needle, deep)
        for _ in seeds[:rng.randint(0, len(seeds))]:
            browser.say(web.DROP, 1)
            dropped += 1
            deep -= 0.01
            self.stroke(needle, deep)
        if rng.random() < 0.5:
            browser.say(web.LEAVE)
            self.until(lambda: of_needle().get("state") == "resting")
        else:
            self.stroke(needle, 0.0)
            self.until(lambda: False, (0, 0, -0.5), 0.5)
            browser.say(web.RELEASE)
        self.until(lambda: not browser.status.get("drives"), again=lambda: browser.say(web.RELEASE))
        return dropped


# ---- recordings and reports ---------------------------------------------------------------------------------------------------------------


def read_log(path):
    """Returns the events of a log: (channel, data, the whole event)."""
    found, data, at = [], path.read_bytes(), 0
    while at + EVENT.size <= len(data):
        _, _, _, channel, length = EVENT.unpack_from(data, at)
        end = at + EVENT.size + channel + length
        found.append((data[at + EVENT.size:at + EVENT.size + channel], data[end - length:end], data[at:end]))
        at = end
    return found


def same_part(recorded, other, path):
    """Writes the events of the recording `other` between the first and the last message in `recorded` that the score uses. Returns whether both recordings have
    the same messages."""
    used = [event[:2] for event in recorded if event[0].decode() in {f"TROCAR_{name}" for name in CHANNELS[8:-1].split("|")}]
    known = set(used)
    at = [i for i, event in enumerate(other) if event[:2] in known]
    part = other[at[0]:at[-1] + 1]
    path.write_bytes(b"".join(event[2] for event in part))
    return [event[:2] for event in part] == used


def numbers(value):
    """Returns all numbers of a report, in order."""
    if isinstance(value, (dict, list)):
        return [number for item in (value.values() if isinstance(value, dict) else value) for number in numbers(item)]
    return [value] if isinstance(value, (int, float)) and not isinstance(value, bool) else []


def offline(folder, log, task, runs):
    files = {kind: folder / f"again.{kind}" for kind in ("html", "json", "csv")}
    done = subprocess.run([BUILD / "clients/view/trocar-score", log, "--task", task, "--runs", runs, *(word for kind, file in files.items() for word in (f"--{kind}", file))],
                          capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stderr
    return {kind: file.read_text() for kind, file in files.items()}


def one_run(seed):
    """Does a random run. Returns the row of the table; raises AssertionError if a number differs."""
    rng = random.Random(seed)
    scene = "pelvis" if seed % 2 == 0 else "implant"
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        needles = random_needles(rng)
        task, kind = write_task(folder, rng, scene, needles)
        (folder / "index.html").touch()
        server = web.start(BUILD / "server/trocar-server", "--scene", SOURCE / f"meshes/{scene}.yaml", "--allow-non-rt")[0]
        view, said = web.start(BUILD / "clients/view/trocar-view", "--task", task, "--runs", folder / "runs", "--port", "0", "--page", folder)
        address = next(line.split()[-1] for line in said if "http" in line).rstrip("/")
        logger = subprocess.Popen([*URGENT, "lcm-logger", f"--channel={CHANNELS}", str(folder / "logger.log")], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            browser = web.Browser(int(address.rsplit(":", 1)[1]))
            hand, task_state = Hand(browser, rng), lambda: browser.status.get("task", {})
            assert hand.until(lambda: browser.status.get("alive"))
            assert hand.until(lambda: task_state().get("state") == "running", again=lambda: browser.say(START)), browser.status
            dropped = sum(hand.work(number, *needle) for number, needle in enumerate(needles))
            assert hand.until(lambda: task_state().get("state") in ("scoring", "scored"), again=lambda: browser.say(FINISH)), browser.status
            assert hand.until(lambda: task_state().get("state") == "scored", seconds=600), browser.status
            run = task_state()["report"]
            assert run, task_state()
            live = {kind: urllib.request.urlopen(f"{address}/runs/{run}.{kind}").read().decode() for kind in ("html", "json", "csv")}
            time.sleep(0.5)
            logger.send_signal(signal.SIGINT)
            logger.wait()
            log = folder / f"runs/{run}.log"
            again = offline(folder, log, task, folder / "runs")
            own, other = json.loads(live["json"]), json.loads(again["json"])
            assert numbers(own) == numbers(other), f"seed {seed}: {[pair for pair in zip(numbers(own), numbers(other)) if pair[0] != pair[1]]}"
            assert live == again, f"seed {seed}: the files differ"
            complete = same_part(read_log(log), read_log(folder / "logger.log"), folder / "part.log")
            independent = json.loads(offline(folder, folder / "part.log", task, folder / "runs")["json"])
            differing = sum(a != b for a, b in zip(numbers(own), numbers(independent))) + abs(len(numbers(own)) - len(numbers(independent)))
            assert differing == 0 or not complete, f"seed {seed}: {differing} numbers of the two recordings differ"
            measures = own["measures"]
            return {"seed": seed, "scene": scene, "task": kind, "needles": len(needles), "seeds_dropped": dropped, "passes": measures["passes"],
                    "force_N": measures["force"], "tip_error_m": measures.get("tip_error", ""), "D90_Gy": measures.get("D90", ""),
                    "rectum_D2cc_Gy": measures.get("rectum_D2cc", ""), "urethra_D10_Gy": measures.get("urethra_D10", ""), "lost": own["lost"]["wrenches"],
                    "numbers": len(numbers(own)), "differ_offline": 0, "differ_lcm_logger": differing, "logger_complete": "yes" if complete else "no"}
        finally:
            for program in (view, server, logger):
                if program.poll() is None:
                    program.terminate()
                    program.wait()


rows = []
for seed in range(SEED, SEED + RUNS):
    rows.append(one_run(seed))
    print(", ".join(f"{name} {value}" for name, value in rows[-1].items()), flush=True)
if TABLE:
    with open(TABLE, "w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0], lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
assert any(row["passes"] for row in rows), "no needle has entered the tissue"
print(f"{len(rows)} runs, {sum(row['numbers'] for row in rows)} numbers: the same live and offline")
