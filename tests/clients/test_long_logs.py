#!/usr/bin/python3
"""Tests that trocar-replay needs no more memory for a long log than for a short one, even when it compares wrenches and writes files.

usage: test_long_logs.py BUILD_DIR SOURCE_DIR
"""
import os
import subprocess
import sys
import tempfile
from pathlib import Path

BUILD, SOURCE = Path(sys.argv[1]), Path(sys.argv[2])
REPLAY, DEVICE = BUILD / "clients/trocar-replay", BUILD / "clients/trocar-device"
SHORT, LONG = 2, 150    # s, durations of the logs, which have a thousand poses per second


def peak(*command):
    """Returns the command's peak memory in MB."""
    process = os.posix_spawn(command[0], [str(part) for part in command], os.environ)
    _, status, used = os.wait4(process, 0)
    if status != 0:
        sys.exit(f"FAILED: {command}: status {status}")
    return used.ru_maxrss / 1024.0


with tempfile.TemporaryDirectory() as folder:
    peaks = {}
    for seconds in (SHORT, LONG):
        log, wrenches = (f"{folder}/{seconds}.{kind}" for kind in ("poses", "wrenches"))
        subprocess.run([DEVICE, "--script", "figure8", "--start", "0.005,0.003,-1", "--duration", str(seconds), "--write-log", log], check=True, stdout=subprocess.DEVNULL)
        common = (REPLAY, "-q", "--scene", SOURCE / "meshes/figure8.yaml", "--poses", log)
        peaks[seconds] = (peak(*common, "--out", wrenches, "--csv", "/dev/null"), peak(*common, "--compare", wrenches))
    for short, long, what in zip(peaks[SHORT], peaks[LONG], ("writing", "comparing")):
        print(f"{what}: {short:.1f} MB for {SHORT} s, {long:.1f} MB for {LONG} s")
        if long > short + 4:
            sys.exit(f"FAILED: {what}: it grows with the log")
print("passed")
