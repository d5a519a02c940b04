#!/usr/bin/python3
"""Makes the validation report (REPORT.md next to this script, figures in plots/) from the experiments' JSON files.

usage: report.py FOLDER     FOLDER: the output of scripts/validate, out/validate
"""
import json
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "shared"))
from reports import COLOURS, axes_for, commit_of, line, write  # noqa: E402

PLOTS = HERE / "plots"
OURS, STYLES = COLOURS[:5], ("-", "--", "-.")  # published curves are black and dotted


def verdict(row):
    parts = ["inside" if row["inside"] else "**outside**", row["note"] if row["inside"] else row["reason"]]
    if row["regression"]:
        parts.append(("" if row["kept"] else "**left the** ") + f"regression interval {row['regression']}")
    return "; ".join(part for part in parts if part)


def kind(row):
    return row["kind"] + (", weak" if row["weak"] else ", tendency" if row["trend"] else "")


def table(rows):
    yield "| quantity | source | how sure | published | trocar | | fitted | |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in rows:
        ours = row["ours"] + (f" ({row['scatter']})" if row["scatter"] else "")
        yield line((row["quantity"], row["source"], row["sure"], row["published"], ours, kind(row), row["fitted"], verdict(row)))


def draw(curves, path):
    with axes_for(curves, path) as axes:
        for i, curve in enumerate(curves):
            look = {"color": "black", "linestyle": ":", "marker": "o" if len(curve["x"]) == 1 else None} if curve["published"] else {"color": OURS[i % len(OURS)], "linestyle": STYLES[i % len(STYLES)]}
            axes.plot(curve["x"], curve["y"], label=curve["label"], linewidth=1.4, **look)


def report_lines(entries, commit):
    rows = [entry for entry in entries if entry["entry"] == "row"]
    yield "# Validation report\n"
    yield ("Made by `scripts/validate`; do not edit. What the words mean, and what was left out, is in [docs/validation.md](../../docs/validation.md). "
           f"Each experiment is described at the head of its script in this folder. Commit {commit}.\n")
    groups = (("predictions of numbers are inside", lambda r: kind(r) == "predicted"),
              ("predictions of a tendency hold", lambda r: kind(r) == "predicted, tendency"),
              ("weak predictions are inside: the published range holds 0, so a model without any motion would be as well", lambda r: r["weak"]),
              ("rows of consistency hold", lambda r: r["kind"] == "consistency"), ("fits are inside", lambda r: r["kind"] == "fitted"))
    for text, chosen in groups:
        group = [r for r in rows if chosen(r)]
        yield f"- **{sum(r['inside'] for r in group)} of {len(group)}** {text}"
    yield ""
    outside = [r for r in rows if not r["inside"]]
    if outside:
        yield "Outside, each with the reason:\n"
        yield "\n".join(f"- {r['section']}: {r['quantity']}: {r['ours']}, published {r['published']}: {r['reason'] or 'not explained'}" for r in outside) + "\n"
    for section in sorted({entry["section"] for entry in entries}):
        yield f"## {section}\n"
        yield "\n".join(table([r for r in rows if r["section"] == section])) + "\n"
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
    entries = [entry for path in sorted(Path(sys.argv[1]).glob("*.json")) for entry in json.loads(path.read_text())]
    write(HERE, report_lines(entries, commit_of(HERE)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
