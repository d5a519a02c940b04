#!/usr/bin/python3
"""Checks the JSON of `trocar-bench tick` for these numbers of contacts.

usage: check_bench.py BENCH.json CONTACTS...

Only ratios of times are compared. With TROCAR_CHECK_TIMING=no, ratios to the time of the matrix product are not checked.
"""
import json
import os
import sys
from pathlib import Path

MOTIONS = ("advance", "sweep")
MOST_GROWTH = 16            # ratio of the times for 2 n and n contacts; the solve is cubic, and there may be a second Newton pass
MOST_PER_BASELINE = 0.5     # time for 10 contacts over that of a matrix product of order 256; about 0.05 on an idle machine


def check(holds, what):
    if not holds:
        sys.exit(f"{Path(sys.argv[0]).stem}: {what}")


def check_quantiles(times, where):
    check(0 < times["p50_s"] <= times["p99_s"] <= times["max_s"] < 60, f"{where}: not 0 < p50 <= p99 <= max: {times}")


def check_row(row, baseline):
    where = f"{row['contacts']} contacts, {row['motion']}"
    check_quantiles(row, where)
    check(row["contacts"] <= row["timed_contacts"], f"{where}: had {row['timed_contacts']}")
    check(row["passes"] >= 1, f"{where}: {row['passes']} passes a tick")
    check(row["switches"] >= 0 and row["unstable"] == 0, f"{where}: {row['switches']} switches, {row['unstable']} unstable")
    ratio = row["p50_s"] / baseline["p50_s"]
    check(abs(row["p50_per_baseline"] / ratio - 1) < 1e-4, f"{where}: ratio {row['p50_per_baseline']}, not {ratio}")


def check_growth(rows, counts):
    time = {(row["contacts"], row["motion"]): row["p50_s"] for row in rows}
    for motion in MOTIONS:
        for n in counts:
            growth = time.get((2 * n, motion), 0) / time[n, motion]
            check(growth <= MOST_GROWTH, f"{motion}: {2 * n} contacts take {growth:.1f} times as long as {n}")


def main():
    with open(sys.argv[1]) as file:
        bench = json.load(file)
    counts, rows, baseline = [int(text) for text in sys.argv[2:]], bench["rows"], bench["baseline"]
    check(bench["benchmark"] == "tick" and bench["ticks"] > 0 and bench["rate_hz"] > 0, "head")
    check(bench["nodes"] > 4 and bench["tetrahedra"] > bench["nodes"] and bench["contact_spacing_m"] > 0, "mesh")
    check_quantiles(baseline, "baseline")
    check([(row["contacts"], row["motion"]) for row in rows] == [(n, motion) for n in counts for motion in MOTIONS], "rows")
    for row in rows:
        check_row(row, baseline)
    check_growth(rows, counts)
    if os.environ.get("TROCAR_CHECK_TIMING") != "no":
        slow = [row for row in rows if row["contacts"] <= 10 and row["p50_per_baseline"] > MOST_PER_BASELINE]
        check(not slow, f"slow compared with the baseline: {slow}")


if __name__ == "__main__":
    main()
