#!/usr/bin/python3
"""Tests how scripts/bench_server parses results, using made-up ones. No program is run.

usage: test_bench_server.py SOURCE_DIR
"""
import importlib.machinery
import importlib.util
import sys

sys.dont_write_bytecode = True
loader = importlib.machinery.SourceFileLoader("bench_server", f"{sys.argv[1]}/scripts/bench_server")
bench = importlib.util.module_from_spec(importlib.util.spec_from_loader("bench_server", loader))
loader.exec_module(bench)

SERVER = """scene      out/scale.yaml
mesh       out/prostate.msh: 44987 nodes, 264927 tetrahedra, 2 regions, 2 membranes
inverse    condensed (as the scene asks): 3418 nodes, kept
memory     1300 MiB, locked
ready
ticks      60000, 3 periods missed
lateness   p50 18.0 us, p99 40.0 us, max 900.0 us
compute    p50 30.0 us, p99 60.0 us, max 200.0 us
loop       1 allocations, 2 minor faults, 5 major faults, 7 involuntary context switches
worker     300 requests served
wrenches   4 dropped
"""
CYCLICTEST = "000010 000098\n000020 000001\n000400 000001\n# Max Latencies: 00400\n"

seen = bench.collect(SERVER, CYCLICTEST)
assert (seen["nodes"], seen["tetrahedra"], seen["inverse"], seen["memory_bytes"]) == (44987, 264927, "condensed", 1300 * 2**20), seen
counts = ("ticks", "periods_missed", "allocations", "page_faults", "requests", "dropped")
assert [seen[name] for name in counts] == [60000, 3, 1, 7, 300, 4], seen
for part, expected in (("lateness", (18, 40, 900)), ("tick", (30, 60, 200)), ("cyclictest", (10, 20, 400))):
    assert all(abs(1e6 * found - us) < 1e-9 for found, us in zip(seen[part].values(), expected)), (part, seen[part])
text = bench.row({**seen, "start_s": 5.0, "motions": [{"late_ticks": 2, "wrenches": 15000}, {"late_ticks": 0, "wrenches": 60}]})
assert text.split()[:4] == ["44987", "condensed", "5.0", "1.4"] and text.endswith("2 of 15000, 0 of 60"), text
try:
    bench.collect(SERVER.replace("lateness", "nothing"), CYCLICTEST)
except bench.soak.Failed:
    print("passed")
else:
    sys.exit("missing results are not detected")
