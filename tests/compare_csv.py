#!/usr/bin/python3
"""Compare the table of a replay (trocar-replay --csv) with golden forces and torques.

usage: compare_csv.py GOLDEN.csv REPLAY.csv       exit status 0: agree, 1: they do not, 2: a file is not such a table
       compare_csv.py --write REPLAY.csv          prints golden values for this replay: every 10th tick

Each golden value must lie within the tolerance of what the replay had at that tick or the ticks beside it. Other
processors and BLAS kernels change roundoff (OpenBLAS's kernels from Prescott to Zen: by less than 1e-9 N), and with it a
contact event may come a tick earlier or later. The rest of the tolerance lets solvers improve by what no hand would feel.
"""
import csv
import math
import sys

EVERY = 10                  # ticks
COLUMNS = ("fx [N]", "fy [N]", "fz [N]", "tx [N m]", "ty [N m]", "tz [N m]")
RELATIVE = 0.01             # of the column's peak: 0.018 N along the needle; a hand feels 7 %, or 0.05 N
LEAST = {"N": 1e-3, "N m": 2e-5}  # for columns that are nearly zero: a hand feels 0.05 N

HEADER = f"""\
# Golden forces and torques of a replay, every {EVERY}th tick. Tolerance: {RELATIVE:.0%} of a column's peak, at least \
{LEAST["N"]:g} N or {LEAST["N m"]:g} N m,
# at this tick or one beside it (why: tests/compare_csv.py). To make it again after a deliberate change of the mechanics:
#   trocar-replay --scene meshes/figure8.yaml --poses tests/traces/figure8.log --csv replay.csv
#   tests/compare_csv.py --write replay.csv >tests/traces/figure8.csv
# The poses are those of: trocar-device --script figure8 --rate 500 --write-log tests/traces/figure8.log"""


def read_table(path):
    """Times and columns of numbers."""
    with open(path, newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    if not rows:
        raise ValueError("no data")
    times = [float(row["t [s]"]) for row in rows]
    columns = {name: [float(row[name]) for row in rows] for name in COLUMNS}
    if not all(math.isfinite(value) for column in columns.values() for value in column):
        raise ValueError(f"{path}: a force or torque is not finite")
    return times, columns


def tolerance(name, values):
    unit = name[name.index("[") + 1:-1]
    return max(RELATIVE * max(abs(v) for v in values), LEAST[unit])


def excess(golden, beside):
    """How far the golden value is outside of the range of these."""
    return max(min(beside) - golden, golden - max(beside), 0.0)


def compare(golden_path, replay_path):
    times, golden = read_table(golden_path)
    replay_times, replay = read_table(replay_path)
    if len(times) != -(-len(replay_times) // EVERY) or any(abs(a - b) > 1e-6 for a, b in zip(times, replay_times[::EVERY])):
        print(f"{replay_path}: its ticks are not those of {golden_path}")
        return False
    good = True
    for name in COLUMNS:
        off = [excess(value, replay[name][max(EVERY * i - 1, 0):EVERY * i + 2]) for i, value in enumerate(golden[name])]
        limit, worst = tolerance(name, golden[name]), max(off)
        holds = worst <= limit
        good = good and holds
        print(f"{'ok  ' if holds else 'FAIL'}  {name:<9} off by {worst:.3g} at {times[off.index(worst)]:.3f} s, limit {limit:.3g}")
    return good


def write(replay_path):
    times, replay = read_table(replay_path)
    print(HEADER)
    print(",".join(("t [s]",) + COLUMNS))
    for i in range(0, len(times), EVERY):
        print(f"{times[i]:.6f}," + ",".join(f"{replay[name][i]:.9g}" for name in COLUMNS))


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    try:
        if sys.argv[1] == "--write":
            write(sys.argv[2])
            return 0
        return 0 if compare(sys.argv[1], sys.argv[2]) else 1
    except (OSError, ValueError, KeyError, TypeError) as error:
        print(f"compare_csv: {' '.join(sys.argv[1:])}: {type(error).__name__}: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
