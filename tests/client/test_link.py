#!/usr/bin/python3
"""A bridge with the free client on a network that loses every tenth datagram, doubles every twentieth and mixes up their order within 4 ms: the
insertion is the same as on a good network, no wrench is followed by an older one, and the force keeps to the rate of the client. The needle
follows the hand rigidly: a virtual coupling would be softer where the round trip is longer.

usage: test_link.py BUILD_DIR SOURCE_DIR
"""
import json
import os
import subprocess
import sys
import tempfile

BUILD, SOURCE = sys.argv[1:3]
sys.path.insert(0, f"{SOURCE}/tests")
sys.dont_write_bytecode = True
from in_namespace import in_namespace

in_namespace(SOURCE)

NEAR, FAR = "239.255.76.67", "239.255.76.68"
LOSS, TWICE, DELAY = 0.1, 0.05, 0.004


def until_ready(command, **more):
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)
    for line in program.stdout:
        if line.strip() == "ready":
            return program
    sys.exit(f"{command[0]} ended before it was ready")


def insertion(group):
    done = subprocess.run([f"{BUILD}/tests/client/insertion", f"udpm://{group}:7667?ttl=0"], capture_output=True, text=True, timeout=60)
    print(f"{group}: {' '.join(done.stdout.split())}{done.stderr}")
    assert done.returncode == 0
    return {name: float(value) for name, value in map(str.split, done.stdout.splitlines())}


def rigid_scene(folder):
    with open(f"{SOURCE}/meshes/figure8.yaml", encoding="utf-8") as file, open(f"{folder}/scene.yaml", "w", encoding="utf-8") as scene:
        scene.write(file.read().replace("mesh: ", f"mesh: {SOURCE}/meshes/") + "\ndevice: {max_stiffness: .inf}\n")
    return scene.name


def main():
    with tempfile.TemporaryDirectory() as folder:
        server = until_ready([f"{BUILD}/server/trocar-server", "--scene", rigid_scene(folder), "--allow-non-rt"])
    link = until_ready([sys.executable, f"{SOURCE}/tests/client/lossy_link.py", NEAR, FAR, str(LOSS), str(TWICE), str(DELAY)])
    try:
        good, bad = insertion(NEAR), insertion(FAR)
        link.terminate()
        done = json.loads(link.communicate(timeout=10)[0])
        print(f"link: {done}")
        server.terminate()
        print("server:", *[line for line in server.communicate(timeout=10)[0].splitlines() if "pose" in line])
    finally:
        link.kill()
        server.kill()
    for way in (0, 1):  # from the server, to the server
        total = done["passed"][way] + done["lost"][way]
        assert total > 2000 and 0.08 < done["lost"][way] / total < 0.12 and done["overtaken"][way] > 0.2 * total, f"the link is too good: {done}"
    assert bad["back"] == 0, "an older wrench followed a newer one"
    assert bad["outages"] == good["outages"] == 0, "the watchdog expired"
    assert bad["answered"] > 0.99 * bad["periods"]
    for name, part in (("force", 0.01), ("most", 0.01), ("depth", 0.01)):
        assert abs(bad[name] - good[name]) < part * good[name], f"{name}: {bad[name]} on the bad network, {good[name]} on the good one"
    assert bad["step"] < 2000 * 0.01, "the force changed faster than the client permits"
    assert good["resets"] == 1 and bad["resets"] >= 1, "no reply"


main()
