#!/usr/bin/python3
"""Checks the JSON of `bench_parts remesh` for a scene with a dense inverse.

usage: check_remesh_bench.py BENCH.json

Only ratios of times are compared, and none with TROCAR_CHECK_TIMING=no. The limits are far looser than the results on an idle machine.
"""
import json
import os
import sys

from check_bench import check, check_quantiles

METHODS = ("nested", "implicit", "woodbury", "woodbury-general", "bcs", "bcs-blocked")
LEAST_RATIOS = (("woodbury", "nested", 30), ("bcs", "nested", 150), ("bcs", "woodbury", 2))


def main():
    with open(sys.argv[1]) as file:
        bench = json.load(file)
    check(bench["benchmark"] == "remesh" and len(bench["scenes"]) == 1, "head")
    scene = bench["scenes"][0]
    check(scene["inverse"] == "dense" and scene["unknowns"] <= 3 * scene["nodes"] and scene["sweep"]["p50_s"] > 0, "scene")
    added = {}
    for row in scene["rows"]:
        where = f"{row['method']}, {row['change']}"
        for times in (row["add"], row["remove"]):
            check_quantiles(times, where)
        check(row["samples"] >= 1, f"{where}: no samples")
        check(row["touched_nodes"] == {"inside": 5, "face": 6}.get(row["change"], row["touched_nodes"]), f"{where}: nodes touched")
        added.setdefault((row["method"], row["change"]), row["add"]["p50_s"])
    expected = {(m, c) for m in METHODS for c in ("inside", "face", "move")} - {("nested", "move")}
    check(set(added) == expected, f"rows: {sorted(set(added) ^ expected)} missing or too many")
    if os.environ.get("TROCAR_CHECK_TIMING") != "no":
        for slow, fast, least in LEAST_RATIOS:
            ratio = added[slow, "inside"] / added[fast, "inside"]
            check(ratio >= least, f"{slow} takes only {ratio:.1f} times as long as {fast}")


if __name__ == "__main__":
    main()
