"""Rows of the verification results for checks in Python: `verify_NAME.py [--short] [--build FOLDER] FOLDER` writes FOLDER/NAME.json. The functions correspond
to those in rows.h:

    rows = Rows.from_arguments(__doc__, "Tissue: patch test")
    rows.compare("displacement", "u = G x", value, expected, 1e-9, "m")
    sys.exit(rows.end())
"""
import argparse
import json
import math
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
SKIPPED = 77  # exit status if something the check needs is not installed


def number(value):
    value = float(value)
    return value if math.isfinite(value) else None


class Rows:
    """Collects rows and curves. `section` may be changed between them."""

    def __init__(self, name, section, folder, build, short_form):
        self.name, self.section = name, section
        self.folder, self.build, self.short_form = Path(folder), Path(build), short_form
        self.entries = []

    @classmethod
    def from_arguments(cls, description, section):
        parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
        parser.add_argument("--short", action="store_true", help="a few seconds at most")
        parser.add_argument("--build", default=REPOSITORY / "build", help="build folder of the C programs")
        parser.add_argument("folder", help="for output; must exist")
        options = parser.parse_args()
        return cls(Path(sys.argv[0]).stem.removeprefix("verify_"), section, options.folder, options.build, options.short)

    def add(self, check, reference, value, expected, error, limit, unit="", note=""):
        """Adds a row to the report. It passes if error <= limit. `error` is relative unless the note says otherwise."""
        passed = bool(error <= limit)
        self.entries.append({"kind": "row", "section": self.section, "check": check, "reference": reference,
                             "value": number(value), "expected": None if expected is None else number(expected),
                             "error": number(error), "limit": limit, "unit": unit, "note": note, "pass": passed})
        print(f"{'pass' if passed else 'FAIL'}  {check}: {value:.6g} {unit} (error {error:.3g}, limit {limit:.3g})", flush=True)

    def measured(self, check, reference, value, expected, error, unit="", note=""):
        """Adds a row without a limit, which neither passes nor fails and is not counted."""
        self.entries.append({"kind": "measured", "section": self.section, "check": check, "reference": reference, "value": number(value),
                             "expected": None if expected is None else number(expected), "error": number(error), "unit": unit, "note": note})
        print(f"      {check}: {value:.6g} {unit} (error {error:.3g}, no limit)", flush=True)

    def compare(self, check, reference, value, expected, limit, unit="", note=""):
        """Compares a value with the expected one by relative error."""
        self.add(check, reference, value, expected, abs(value - expected) / abs(expected), limit, unit, note)

    def error(self, check, reference, error, limit, note=""):
        """Adds a row whose value is itself an error."""
        self.add(check, reference, error, None, abs(error), limit, note=note)

    def curve(self, figure, label, x, y, x_label, y_label, logarithmic=False):
        """Adds a curve to FIGURE.svg, where all curves of that figure are drawn."""
        self.entries.append({"kind": "curve", "section": self.section, "figure": figure, "label": label,
                             "x": [number(v) for v in x], "y": [number(v) for v in y],
                             "x_label": x_label, "y_label": y_label, "logarithmic": logarithmic})

    def plot(self, file):
        """Adds a figure that the check itself has drawn into the output folder."""
        self.entries.append({"kind": "plot", "section": self.section, "plot": file})

    def end(self):
        """Writes the file. Returns the program's exit status: 0 if every row passed, 1 otherwise."""
        (self.folder / f"{self.name}.json").write_text(json.dumps(self.entries, indent=1) + "\n")
        return 0 if all(entry.get("pass", True) for entry in self.entries) else 1
