#!/usr/bin/python3
"""Makes the verification report (REPORT.md next to this script, figures in plots/) from the checks' JSON files.

usage: report.py FOLDER     FOLDER: the output of scripts/verify, out/verify
"""
import json
import os
import platform
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shared"))
from reports import COLOURS, axes_for, commit_of, line, output_of, write  # noqa: E402

PLOTS = HERE / "plots"
PACKAGES = ("libcholmod3", "libopenblas0-pthread", "libgmsh4.8", "calculix-ccx")
STYLES = ("-", "--", ":", "-.")
MANY = 30  # curves with at least this many points have no markers


def read_entries(folder):
    return [entry for path in sorted(folder.glob("*.json")) for entry in json.loads(path.read_text())]


def figure_number(value, digits=5):
    return "" if value is None else f"{value:.{digits}g}"


def table(rows):
    yield "| check | reference | value | expected | error | limit | |"
    yield "|---|---|---:|---:|---:|---:|---|"
    for row in rows:
        unit = f" {row['unit']}" if row["unit"] else ""
        value, expected = (figure_number(row[key]) and figure_number(row[key]) + unit for key in ("value", "expected"))
        error, limit = (figure_number(row.get(key), 2) for key in ("error", "limit"))
        verdict = ("measured" if row["kind"] == "measured" else "pass" if row["pass"] else "**fail**") + (f": {row['note']}" if row["note"] else "")
        yield line((row["check"], row["reference"], value, expected, error, limit, verdict))


# ---- figures ----

def draw(curves, path):
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
    """Draws or copies a section's figures into PLOTS; yields their file names."""
    curves = {}
    for entry in entries:
        if entry["kind"] == "curve":
            curves.setdefault(entry["figure"] + ".svg", []).append(entry)
        elif entry["kind"] == "plot":
            shutil.copy(folder / entry["plot"], PLOTS)
            yield entry["plot"]
    for name, lines in curves.items():
        draw(lines, PLOTS / name)
        yield name


# ---- machine ----

def machine():
    names = [line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")]
    versions = ", ".join(f"{name} {output_of(HERE, 'dpkg-query', '-W', '-f', '${Version}', name)}" for name in PACKAGES)
    return (f"{names[0] if names else platform.machine()}, {os.cpu_count()} processors, Linux {platform.release()}, "
            f"{output_of(HERE, 'gcc', '--version').splitlines()[0]}; {versions}.")


# ---- the report ----

def subject_of(title):
    """"Needle: bending of a rod" -> "Bending of a rod"."""
    subject = title.split(":", 1)[-1].strip()
    return subject[:1].upper() + subject[1:]


def section_lines(title, entries, folder):
    yield f"### {title}\n"
    rows = [entry for entry in entries if entry["kind"] in ("row", "measured")]
    if rows:
        yield "\n".join(table(rows)) + "\n"
    for name in figures(entries, folder):
        yield f"![{Path(name).stem}](plots/{name})\n"


def report_lines(entries, folder, commit):
    rows = [entry for entry in entries if entry["kind"] == "row"]
    passed = sum(row["pass"] for row in rows)
    measured = sum(entry["kind"] == "measured" for entry in entries)
    yield "# Verification report\n"
    yield ("Made by `scripts/verify`; do not edit. A row passes if its error is at most its limit; errors are relative "
           "unless the row says otherwise. Rows that are only measured have no limit and are not counted. Each check is described at the head of its source in this folder.\n")
    yield f"**{passed} of {len(rows)} rows pass**, {measured} more are measured. Commit {commit}. {machine()}\n"
    failing = [row for row in rows if not row["pass"]]
    if failing:
        yield "Rows that fail:\n"
        yield "\n".join(f"- {row['section']}: {row['check']}" + (f": {row['note']}" if row["note"] else "") for row in failing) + "\n"
    part = None
    for title in sorted({entry["section"] for entry in entries}):
        if title.split(":")[0] != part:
            part = title.split(":")[0]
            yield f"## {part}\n"
        yield from section_lines(subject_of(title),
                                 [entry for entry in entries if entry["section"] == title], folder)


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    folder = Path(sys.argv[1])
    commit = commit_of(HERE)  # determined first, because replacing the plots changes the working tree
    write(HERE, report_lines(read_entries(folder), folder, commit))
    return 0


if __name__ == "__main__":
    sys.exit(main())
