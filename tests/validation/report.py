#!/usr/bin/python3
"""Makes the validation report (REPORT.md and results.csv next to this script, figures in plots/) from the experiments' JSON files.

usage: report.py FOLDER     FOLDER: the output of scripts/validate, out/validate
"""
import csv
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shared"))
from reports import COLOURS, axes_for, commit_of, write  # noqa: E402

PLOTS = HERE / "plots"
OURS, STYLES = COLOURS[:5], ("-", "--", "-.")  # published curves are black and dotted


COLUMNS = ("section", "quantity", "source", "certainty", "published", "trocar", "kind", "fitted", "inside", "remark", "depends most on", "regression interval")


def kind(row):
    return row["kind"] + (", weak" if row["weak"] else ", tendency" if row["trend"] else "")


def ours(row):
    return row["ours"] + (f" ({row['scatter']})" if row["scatter"] else "")


def write_rows(rows, path):
    """Writes all data of each row as CSV."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(COLUMNS)
        for row in rows:
            table.writerow((row["section"], row["quantity"], row["source"], row["sure"], row["published"], ours(row), kind(row), row["fitted"],
                            {True: "yes", False: "no", None: ""}[row["inside"]], row["reason"] if row["inside"] is False else row["note"], row["depends"],
                            row["regression"] + ("" if row["kept"] else ", left")))


def draw(curves, path):
    with axes_for(curves, path) as axes:
        for i, curve in enumerate(curves):
            look = {"color": "black", "linestyle": ":", "marker": "o" if len(curve["x"]) == 1 else None} if curve["published"] else {"color": OURS[i % len(OURS)], "linestyle": STYLES[i % len(STYLES)]}
            axes.plot(curve["x"], curve["y"], label=curve["label"], linewidth=1.4, **look)


def report_lines(entries, commit):
    rows = [entry for entry in entries if entry["entry"] == "row"]
    yield "# Validation report\n"
    yield (f"Made by `scripts/validate` from commit {commit}; do not edit. [`results.csv`](results.csv) lists all rows: published number and source, its certainty, "
           "trocar's number, the fitted parameters and remarks, and rows that are not counted because they explain others. [Validation](../../docs/validation.md) explains the terms, and the head of each script in this "
           "folder its experiment.\n")
    groups = (("predictions of numbers are inside", lambda r: kind(r) == "predicted"),
              ("predictions of a tendency hold", lambda r: kind(r) == "predicted, tendency"),
              ("weak predictions are inside: the published range contains 0, so a model without any motion would also be inside", lambda r: r["weak"]),
              ("rows of consistency hold", lambda r: r["kind"] == "consistency"), ("fits are inside", lambda r: r["kind"] == "fitted"))
    for text, chosen in groups:
        group = [r for r in rows if chosen(r)]
        yield f"- **{sum(r['inside'] for r in group)} of {len(group)}** {text}"
    yield from (f"\n{entry['section']}: {entry['text']}." for entry in entries if entry["entry"] == "remark")
    yield ""
    outside = [r for r in rows if r["inside"] is False]
    if outside:
        yield "Outside, each with the reason:\n"
        alike = {}
        for r in outside:
            alike.setdefault((r["section"], r["reason"] or "not explained"), []).append(r["quantity"])
        yield "\n".join(f"- {section}: {'; '.join(quantities)}: {reason}" for (section, reason), quantities in alike.items()) + "\n"
    for section in sorted({entry["section"] for entry in entries if entry["entry"] == "curve"}):
        yield f"## {section}\n"
        figures = {}
        for entry in entries:
            if entry["entry"] == "curve" and entry["section"] == section:
                figures.setdefault(entry["figure"], []).append(entry)
        for name, curves in figures.items():
            draw(curves, PLOTS / f"{name}.svg")
            yield f"![{name}](plots/{name}.svg)\n"


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if "--help" in sys.argv else 2
    commit = commit_of(HERE)    # before results.csv changes
    entries = [entry for path in sorted(Path(sys.argv[1]).glob("*.json")) for entry in json.loads(path.read_text())]
    write_rows([entry for entry in entries if entry["entry"] == "row"], HERE / "results.csv")
    write(HERE, report_lines(entries, commit))
    return 0


if __name__ == "__main__":
    sys.exit(main())
