#!/usr/bin/python3
"""Checks the JSON of `bench_parts scale`: every part must be there and plausible. usage: check_scale_bench.py SCALE.json OWNER..."""
import json
import sys

with open(sys.argv[1]) as file:
    bench = json.load(file)
assert bench["benchmark"] == "scale"
assert [scene["inverse"] for scene in bench["scenes"]] == sys.argv[2:], bench
for scene in bench["scenes"]:
    assert scene["nodes"] > 4 and scene["tetrahedra"] > scene["nodes"] and scene["start_s"] > 0 and scene["peak_bytes"] > 1e6, scene
    assert [row["speed"] for row in scene["speeds"]] == [0.005, 0.02, 0.05], scene
    for row in [*scene["speeds"], scene["figure8"], scene["with_patches"], scene["without_patches"]]:
        assert row["patch"]["p50_s"] > 0 or row is scene["without_patches"], row
        assert row["crossings"] > 0 and 0 <= row["late_crossings"] <= row["crossings"] and row["late_ticks"] < row["ticks"], row
        for part in ("tick", "serve", "crossing"):
            assert 0 < row[part]["p50_s"] <= row[part]["p99_s"] <= row[part]["max_s"] < 60, (part, row)
        late = row["activation"]
        assert 0 <= late["p50_s"] <= late["p99_s"] <= late["max_s"] < 60 and (late["max_s"] == 0 or row["late_crossings"] > 0), row
        assert row["most_contacts"] <= late["count"] <= row["contacts"] - row["unanswered"], row
    assert scene["contacts"] and all(0 < row["p50_s"] <= row["p99_s"] and row["passes"] >= 1 for row in scene["contacts"]), scene
