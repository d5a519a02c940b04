#!/usr/bin/python3
"""Tests the real server and trocar-haply with a simulated device behind the stand-in: a hand that pushes the needle comes to rest, as it does when the same
closed loop runs in one process (../stability/stability_map.c); and --measure-delay finds the device's delay and mass.

usage: test_device.py BUILD_DIR SOURCE_DIR [--points FILE] [--slow]

--points: runs the points of a CSV file of stability_map instead, and prints the same columns. --slow: for instrumented programs, whose timing is not checked.
"""
import argparse
import csv
import io
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.dont_write_bytecode = True
from rig import Rig, wait_for
from in_namespace import in_namespace
from simulated_device import Device, Properties
from standin import use_realtime

PUSH = {"bone": (1e-3, 11e-3), "liver": (1e-3, 41e-3), "air": (60e-3, 40e-3)}    # m: distance from the tip to the skin, and length of the push
SPEED, WINDOW, WINDOWS, LARGE = 0.1, 0.25, 20, 0.5e-3    # m/s, s, dimensionless, m; as in stability_map.c
# consecutive windows in which the hand must rest, and the most windows to wait for; a stall of the machine sets a resting hand in motion again
REST, PATIENCE = 4, 60
COLUMNS = "profile,tissue,hand,device,mass_kg,delay_ms,told,swing_mm,quiet_s,widest_mm,force_n,stiffness_n_per_m,active".split(",")


def write_scene(source, path, point):
    """Writes the figure-8 scene with the same changes as stability_map.c."""
    text = (Path(source) / "meshes/figure8.yaml").read_text().replace("mesh: ", f"mesh: {source}/meshes/")
    if point["tissue"] == "bone":
        text = re.sub(r"youngs_modulus: (60|30)e3", "youngs_modulus: 10e9", text).replace("puncture_force: 0.6", "puncture_force: .inf")
        text = text.replace("outer_diameter: 1.27e-3", "outer_diameter: 4e-3")
    if point["tissue"] == "liver":
        text = re.sub(r"youngs_modulus: (60|30)e3", "youngs_modulus: 4.5e3", text).replace("cutting_force: 0.3 ", "cutting_force: 0.25 ")
    keys = ([f"profile: {point['profile']}"] if point["profile"] != "none" else []) + ([f"delay: {2e-3 * float(point['delay_ms'])}"] if point["told"] == "1" else [])
    Path(path).write_text(text + (f"device: {{{', '.join(keys)}}}\n" if keys else ""))


def device_of(build, point):
    stiffness, damping = map(float, point["hand"].split(":"))
    period, resolution = (1e-3 * float(value) for value in point["device"].split(":"))
    return Device(build, Properties(float(point["mass_kg"]), damping, stiffness, 1e-3 * float(point["delay_ms"]), period, resolution), (0.0, 0.1, 0.1))


def coupling(build):
    """Returns the coupling's stiffness (N/m) and whether the server reports ACTIVE, both from trocar-top."""
    text = subprocess.run([f"{build}/clients/trocar-top", "--once"], capture_output=True, text=True, timeout=20).stdout
    return float(re.search(r"coupling ([0-9]+) N/m", text).group(1)), "ACTIVE" in text.upper()


def run(build, source, point):
    """Runs one point and returns its row."""
    gap, push = PUSH[point["tissue"]]
    device = device_of(build, point)
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(build, source, folder, realtime=True, device=device)
        rig.scene = f"{folder}/scene.yaml"
        write_scene(source, rig.scene, point)
        try:
            rig.start_server()
            rig.start_bridge("--realtime", "--orientation", "fixed", "--start", f"0.005,0.003,{-0.2 - gap}")
            wait_for(lambda: "trocar-server answers" in rig.said(), "no answer")
            time.sleep(2)
            device.push((0.0, SPEED, 0.0), push / SPEED)
            time.sleep(push / SPEED)
            swings, begin = [], time.monotonic()
            while len(swings) < WINDOWS or (max(swings[-REST:]) > LARGE and len(swings) < PATIENCE):
                device.watch()
                time.sleep(max(0.0, begin + WINDOW * (len(swings) + 1) - time.monotonic()))
                swings.append(device.swing())
            stiffness, active = coupling(build)
            forces = rig.norms_since(begin - push / SPEED)
        finally:
            rig.end()
    quiet = max((WINDOW * (i + 1) for i, swing in enumerate(swings) if swing > LARGE), default=0.0)
    return {**point, "swing_mm": f"{1e3 * max(swings[-REST:]):.4f}", "quiet_s": f"{quiet:.2f}", "widest_mm": f"{1e3 * max(swings):.3f}", "force_n": f"{max(forces):.3f}",
            "stiffness_n_per_m": f"{stiffness:.1f}", "active": str(int(active))}


def in_one_process(build, profile, tissue, hand, mass, delay, *options):
    done = subprocess.run([f"{build}/tests/stability/stability_map", f"--profile={profile}", f"--tissue={tissue}", f"--hand={hand}", f"--mass={mass}", f"--delay={delay}", *options],
                          capture_output=True, text=True, check=True)
    return next(csv.DictReader(io.StringIO(done.stdout)))


POINTS = (("touch", "bone", "300:3", "0.05", "10"), ("omega.3", "bone", "300:3", "0.05", "2"), ("none", "bone", "300:3", "0.2", "5", "--told"))


def check_points(build, source, slow):
    for choice in POINTS:
        expected = in_one_process(build, *choice)
        found = run(build, source, expected)
        print(choice, {name: (found[name], expected[name]) for name in COLUMNS[7:]}, flush=True)
        assert float(expected["swing_mm"]) < 1e3 * LARGE, expected
        assert float(found["swing_mm"]) < 1e3 * LARGE, f"the hand does not come to rest: {found}"
        ratio = float(found["stiffness_n_per_m"]) / float(expected["stiffness_n_per_m"])
        # one level of the adaptation changes the stiffness by a factor of 4
        assert slow or 0.2 < ratio < 5, f"another stiffness than in one process: {found}, {expected}"


def measure_delay(build, source, mass, delay):
    """Returns a device's delay (s, round trip) and mass (kg) as measured by --measure-delay."""
    device = Device(build, Properties(mass, 3.0, 300.0, delay, 0.0, 2e-5), (0.0, 0.1, 0.1))
    with tempfile.TemporaryDirectory() as folder:
        rig = Rig(build, source, folder, realtime=True, device=device)
        try:
            rig.start_bridge("--measure-delay", "--realtime")
            status = rig.bridge.wait(30)
            told = re.search(r"device: \{delay: ([0-9.]+), mass: ([0-9.]+)\}", rig.out.read_text())
            assert status == 0 and told, (status, rig.said(), rig.out.read_text())
            assert max(rig.norms_since(0)) <= 0.5 and rig.force() == (0, 0, 0), "more than a small force, or one that remains"
        finally:
            rig.end()
    return float(told.group(1)), float(told.group(2))


def check_measurement(build, source):
    for mass, delay in ((0.1, 4e-3), (0.3, 1e-3)):
        delays, masses = zip(*(measure_delay(build, source, mass, delay) for _ in range(3)))
        print(f"device of {mass} kg and {2e3 * delay} ms: {delays} s, {masses} kg", flush=True)
        assert abs(statistics.median(delays) - 2 * delay) < 1.5e-3 and abs(statistics.median(masses) / mass - 1) < 0.25


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build")
    parser.add_argument("source")
    parser.add_argument("--points")
    parser.add_argument("--slow", action="store_true")
    arguments = parser.parse_args()
    arguments.build, arguments.source = os.path.abspath(arguments.build), os.path.abspath(arguments.source)
    in_namespace(arguments.source)
    use_realtime()
    if arguments.points:
        writer = csv.DictWriter(sys.stdout, COLUMNS)
        writer.writeheader()
        for point in csv.DictReader(open(arguments.points)):
            writer.writerow(run(arguments.build, arguments.source, point))
            sys.stdout.flush()
        return
    check_points(arguments.build, arguments.source, arguments.slow)
    check_measurement(arguments.build, arguments.source)
    print("passed")


if __name__ == "__main__":
    main()
