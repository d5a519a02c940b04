#!/usr/bin/python3
"""Runs the full form of one verification check and keeps its results: the rows in results/NAME.csv, its line in results/runs.csv, and its figures in plots/.

usage: record.py FOLDER NAME COMMAND...     COMMAND FOLDER writes FOLDER/NAME.json (rows.h, rows.py)
The exit status is the check's. A check that crashes leaves one failing row. A commit ending in -dirty had uncommitted changes in the mechanics or the checks.
"""
import datetime
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import results
from results import HERE, PLOTS, RESULTS, ROOT
from rows import SKIPPED

sys.path.insert(0, str(HERE.parent / "shared"))

PACKAGES = ("libcholmod3", "libopenblas0-pthread", "libgmsh4.8", "calculix-ccx")
JUDGED = ("core", "meshes", "tests", ":!tests/verification/results", ":!tests/verification/plots", ":!*.md")  # uncommitted changes here make a commit -dirty
STYLES = ("-", "--", ":", "-.")
MANY = 30  # curves with at least this many points are drawn without markers


# ---- figures ----

def draw(curves, path):
    from reports import COLOURS, axes_for  # imports matplotlib, which takes a second or more
    with axes_for(curves, path) as axes:
        for i, curve in enumerate(curves):
            marker = "osv^D"[i % 5] if len(curve["x"]) < MANY else None
            pairs = [(x, y) for x, y in zip(curve["x"], curve["y"]) if x is not None and y is not None]
            axes.plot(*zip(*pairs), label=curve["label"], color=COLOURS[i % len(COLOURS)], linestyle=STYLES[i % len(STYLES)],
                      marker=marker, markersize=4, linewidth=1.4)
        if curves[0]["logarithmic"]:
            axes.set_xscale("log")
            axes.set_yscale("log")


def figures(entries, folder):
    """Draws or copies a check's figures into PLOTS and returns their file names."""
    PLOTS.mkdir(exist_ok=True)
    curves, names = {}, []
    for entry in entries:
        if entry["kind"] == "curve":
            curves.setdefault(entry["figure"] + ".svg", []).append(entry)
        elif entry["kind"] == "plot":
            shutil.copy(folder / entry["plot"], PLOTS)
            names.append(entry["plot"])
    for name, lines in curves.items():
        draw(lines, PLOTS / name)
    return names + list(curves)


# ---- the run ----

def output_of(*command):
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"


def commit_of_checks():
    commit = output_of("git", "rev-parse", "--short=7", "HEAD")
    return commit + ("-dirty" if output_of("git", "status", "--porcelain", "--", *JUDGED) else "")


def machine():
    names = [line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")]
    versions = [f"{name} {output_of('dpkg-query', '-W', '-f', '${Version}', name)}" for name in PACKAGES]
    return (f"{names[0] if names else platform.machine()}, {os.cpu_count()} processors; "
            + ", ".join([f"gcc {output_of('gcc', '-dumpfullversion')}", *versions]))


def number(value, digits):
    return "" if value is None else f"{value:.{digits}g}"


def csv_row(entry):
    passed = {"row": "yes" if entry.get("pass") else "no", "measured": ""}[entry["kind"]]
    return {**entry, **{key: number(entry[key], 6) for key in ("value", "expected")}, "error": number(entry["error"], 3),
            "limit": number(entry.get("limit"), 3), "pass": passed}


def record(name, entries, folder, run):
    rows = [csv_row(entry) for entry in entries if entry["kind"] in ("row", "measured")]
    others = [other for other in results.runs() if other["check"] != name]
    old = [other for other in results.runs() if other["check"] == name]
    drawn = figures(entries, folder)
    for figure in " ".join(run["figures"] for run in old).split():
        if figure not in drawn:
            (PLOTS / figure).unlink(missing_ok=True)
    run |= {"check": name, "rows": sum(row["pass"] != "" for row in rows), "failed": sum(row["pass"] == "no" for row in rows),
            "measured": sum(row["pass"] == "" for row in rows), "figures": " ".join(drawn)}
    RESULTS.mkdir(exist_ok=True)
    results.write(RESULTS / f"{name}.csv", results.ROW, rows)
    results.write(RESULTS / "runs.csv", results.RUN, sorted([*others, run], key=lambda run: run["check"]))


def main():
    if len(sys.argv) < 4 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    folder, name, command = Path(sys.argv[1]), sys.argv[2], sys.argv[3:]
    run = {"commit": commit_of_checks(), "mechanics": results.digest_of_mechanics(), "machine": machine(),
           "date": datetime.datetime.now(datetime.timezone.utc).date().isoformat()}
    status = subprocess.run([*command, str(folder)]).returncode
    if status == SKIPPED:
        print(f"record.py: {name} was skipped, so its results stay as they are", file=sys.stderr)
        return status
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    run["minutes"] = f"{(used.ru_utime + used.ru_stime) / 60:.1f}"
    if status in (0, 1):
        entries = json.loads((folder / f"{name}.json").read_text())
    else:
        entries = [{"kind": "row", "section": "Checks that did not finish", "check": name, "reference": "", "value": None, "expected": None,
                    "error": None, "limit": None, "unit": "", "note": f"exit status {status}", "pass": False}]
    record(name, entries, folder, run)
    return status if status >= 0 else 128 - status


if __name__ == "__main__":
    sys.exit(main())
