#!/usr/bin/python3
"""Checks the JSON of `trocar-bench features`.

usage: check_features_bench.py FEATURES.json

With TROCAR_CHECK_TIMING=no, the ratio of times is not checked.
"""
import json
import os
import sys

from check_bench import check, check_quantiles

MOST_RATIO = 2              # tick time with the features over that without, while the needle advances; about 1.25 on an idle machine


def main():
    with open(sys.argv[1]) as file:
        bench = json.load(file)
    rows = {(row["motion"], row["features"]): row for row in bench["rows"]}
    check(bench["benchmark"] == "features", "head")
    check(list(rows) == [(motion, features) for motion in ("advance", "sweep") for features in ("without", "with")], f"rows: {list(rows)}")
    for where, row in rows.items():
        check_quantiles(row, where)
        check(row["timed_contacts"] >= bench["contacts"] and row["passes"] >= 1 and row["unstable"] == 0, f"{where}: {row}")
    for motion in ("advance", "sweep"):
        without, whole = rows[motion, "without"], rows[motion, "with"]
        check(abs(whole["p50_ratio"] * without["p50_s"] / whole["p50_s"] - 1) < 1e-4, f"{motion}: ratio {whole['p50_ratio']}")
    advance = rows["advance", "with"]
    check(advance["passes"] < rows["advance", "without"]["passes"] + 0.5, f"turning takes more Newton passes: {advance['passes']}")
    if os.environ.get("TROCAR_CHECK_TIMING") != "no":
        check(advance["p50_ratio"] <= MOST_RATIO, f"slow: {advance['p50_ratio']} times as long as without")


if __name__ == "__main__":
    main()
