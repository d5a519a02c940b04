#!/usr/bin/python3
"""Tests how scripts/soak parses results and reaches its verdict, using made-up results. No program is run.

usage: test_soak.py SOURCE_DIR
"""
import importlib.machinery
import importlib.util
import json
import os
import sys
import tempfile

loader = importlib.machinery.SourceFileLoader("soak", f"{sys.argv[1]}/scripts/soak")
soak = importlib.util.module_from_spec(importlib.util.spec_from_loader("soak", loader))
sys.dont_write_bytecode = True
loader.exec_module(soak)

SERVER = """ready
ticks      60000, 3 periods missed
lateness   p50 18.0 us, p99 {p99} us, max 900.0 us
compute    p50 30.0 us, p99 60.0 us, max 200.0 us
loop       {allocations} allocations, {minor} minor faults, 0 major faults, 5 involuntary context switches
worker     10 requests served
wrenches   {dropped} dropped, {unsent} not sent
poses      59000 accepted, {poses_lost} lost
"""
# 98 wake-ups of 10 us, one of 20 us and one of 400 us: p50 is 10 us, p99 is 20 us.
CYCLICTEST = "# Histogram\n000010 000098\n000020 000001\n000021 000000\n000400 000001\n# Max Latencies: 00400\n"
DEVICE = {"round_trip_p50_s": 9e-4, "round_trip_p99_s": 1e-3, "round_trip_max_s": 2e-3, "wrenches_lost": 0, "poses_sent": 60000,
          "periods_skipped": 1, "poses_unanswered": 2}
HOLDS = {"p99": 79.0, "allocations": 0, "minor": 0, "dropped": 0, "unsent": 0, "poses_lost": 0}
CALM = ((1000, 500), (1000, 500), (1000, 500))


def judge(memory=CALM, lost=0, **said):
    """Returns the report and the verdict for a run with these results. The limit on p99 is 1.5 x 20 us + 50 us."""
    with tempfile.TemporaryDirectory() as out:
        for name, text in (("soak-server.txt", SERVER.format(**{**HOLDS, **said})),
                           ("soak-cyclictest.txt", CYCLICTEST), ("soak-device.json", json.dumps({**DEVICE, "wrenches_lost": lost}))):
            with open(os.path.join(out, name), "w", encoding="utf-8") as file:
                file.write(text)
        return soak.report(soak.collect(out, memory), 1)


assert soak.floor_times(CYCLICTEST) == (10, 20, 400)
text, good = judge()
assert good, text
assert "| cyclictest lateness | 10 | 20 | 400 |" in text and "| loop lateness | 18 | 79 | 900 |" in text, text
assert "at most 80 us" in text and "3 periods missed" in text, text
for spoilt in ({"p99": 81.0}, {"allocations": 1}, {"minor": 1}, {"dropped": 1}, {"unsent": 1}, {"poses_lost": 1},
               {"lost": 1}, {"memory": ((1000, 500), (1004, 500), (1000, 500))}, {"memory": ((1000, 500), (1000, 504), (1000, 500))}):
    text, good = judge(**spoilt)
    assert not good and text.count("**NO**") == 1, (spoilt, text)

# Memory that the server touches for the first time during the first motion does not count as growth. A server that keeps growing fails.
SERVER_STAND_IN = """#!/usr/bin/python3 -u
import os, time
print("scene\\nready")
kept = []
while True:
    if os.path.exists("first-motion") and (not kept or os.path.exists("leaks")):
        kept.append(bytearray(os.urandom(1 << 20)))
    time.sleep(0.02)
"""
with tempfile.TemporaryDirectory() as folder:
    os.chdir(folder)
    for name, text in (("server/trocar-server", SERVER_STAND_IN), ("clients/trocar-device", "#!/bin/sh\nsleep 0.3; touch first-motion; sleep 0.7\n"),
                       ("bin/cyclictest", "#!/bin/sh\n"), ("bin/stress-ng", "#!/bin/sh\nexec sleep 60\n")):
        os.makedirs(os.path.dirname(f"build/{name}"), exist_ok=True)
        with open(f"build/{name}", "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(f"build/{name}", 0o755)
    os.environ["PATH"] = f"{folder}/build/bin:{os.environ['PATH']}"
    soak.SAMPLING = 0.05
    steady = soak.run(1 / 60, ".")
    assert len(steady) > 5 and max(steady) == steady[0], steady
    with open("leaks", "w", encoding="utf-8"):
        pass
    growing = soak.run(1 / 60, ".")
    assert max(growing)[0] > growing[0][0] + 1024, growing
print("passed")
