#!/usr/bin/python3
"""Checks the JSON of `trocar-bench dose`. Only ratios of times are compared. With TROCAR_CHECK_TIMING=no, ratios to the baseline are not checked.

usage: check_dose_bench.py DOSE.json VOXELS SEEDS
"""
import json
import os
import sys

from check_bench import check, check_quantiles

MOST_PER_VOXEL = 2e-4       # time per voxel for adding a seed, over that of a matrix product of order 256; about 2.5e-5 on an idle machine


def main():
    with open(sys.argv[1]) as file:
        bench = json.load(file)
    check((bench["benchmark"], bench["voxels"], bench["seeds"]) == ("dose", int(sys.argv[2]), int(sys.argv[3])), "head")
    for name in ("baseline", "pass", "add", "remove"):
        row = bench[name]
        check_quantiles(row, name)
        ratio = row["p50_s"] / bench["baseline"]["p50_s"]
        check(abs(row["p50_per_baseline"] / ratio - 1) < 1e-4, f"{name}: ratio {row['p50_per_baseline']}, not {ratio}")
        check(os.environ.get("TROCAR_CHECK_TIMING") == "no" or name == "baseline" or ratio <= MOST_PER_VOXEL * bench["voxels"], f"{name}: {ratio:.1f} times the baseline")


if __name__ == "__main__":
    main()
