"""Rows of the validation report: `validate_NAME.py [--short] FOLDER` writes FOLDER/NAME.json.

    rows = Rows.from_arguments(__doc__, "Relaxation of a held needle")
    rows.add("force after 8 s", source, ABSTRACT, (0.4, 0.6), ours, "of the peak", kind=FITTED, fitted="the series")
    sys.exit(rows.end())
"""
import argparse
import json
import sys
from pathlib import Path


FITTED = "fitted"              # parameters were fitted to this very number
CONSISTENT = "consistency"     # the number follows from fitted or assumed values if the model works as described
PREDICTED = "predicted"        # the model was fitted to other data
SHOWN = "not counted"          # explains another row

# Reliability of a published number, as defined in docs/validation.md.
ABSTRACT, TABLE, SECONDARY, DOUBTFUL, UNPUBLISHED = GRADES = ("abstract", "table", "secondary", "doubtful", "none")


class Rows:
    """Collects rows and curves of one experiment or group of experiments."""

    def __init__(self, name, section, folder, short):
        self.name, self.section, self.folder, self.short = name, section, Path(folder), short
        self.entries = []

    @classmethod
    def from_arguments(cls, description, section):
        parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
        parser.add_argument("--short", action="store_true", help="fewer cases: a few seconds")
        parser.add_argument("folder", help="for output; must exist")
        options = parser.parse_args()
        return cls(Path(sys.argv[0]).stem.removeprefix("validate_"), section, options.folder, options.short)

    def _add(self, quantity, source, sure, published, inside, ours, kind, fitted, reason, note, number, unit, regression, scatter="", trend=False, weak=False, depends=""):
        if sure not in GRADES:
            raise ValueError(f"{quantity}: '{sure}' is not one of {GRADES}")
        held = f"{regression[0]:g} to {regression[1]:g} {unit}".strip() if regression else ""
        kept = not regression or regression[0] <= number <= regression[1]
        passed = bool(kept and (inside or (reason and regression)))
        self.entries.append({"entry": "row", "section": self.section, "quantity": quantity, "source": source, "sure": sure, "published": published, "ours": ours,
                             "scatter": scatter, "kind": kind, "trend": trend, "weak": weak, "fitted": fitted, "inside": bool(inside), "reason": reason,
                             "note": note, "depends": depends, "regression": held, "kept": bool(kept), "passed": passed})
        print(f"{'inside ' if inside else 'OUTSIDE'}  {quantity}: {ours}{' (' + scatter + ')' if scatter else ''}; published {published}"
              + (f"; regression interval {held}" if held else "") + ("" if passed else "  <- FAILED"), flush=True)

    def add(self, quantity, source, sure, interval, ours, unit, *, published="", kind, fitted, reason="", note="", scatter="", digits=3, regression=None, weak=False):
        """Adds a number. It is inside if it lies in the interval (low, high). `published` describes the published value if it is not simply low to high.
        `scatter` is how much the model's number varies. A row that is outside needs a reason and `regression`, an interval around the number that this model
        gives; if the number leaves this interval, the row fails. `weak` marks a row that even a model in which nothing moves would pass; such a row also
        needs `regression`."""
        low, high = interval
        if weak and not regression:
            raise ValueError(f"{quantity}: a weak row needs a regression interval")
        self._add(quantity, source, sure, published or f"{low:g} to {high:g} {unit}", low <= ours <= high, f"{ours:.{digits}g} {unit}".strip(),
                  kind, fitted, reason, note, ours, unit, regression, scatter, weak=weak)

    def interval(self, quantity, source, sure, published, value, ours, unit, *, kind, fitted, reason="", note="", digits=2, regression=None, middle="median", depends="", same_sign=False):
        """Adds a published mean, median or maximum and the numbers of many runs, `ours` = (5 %, median, 95 %), or another interval around the value that
        `middle` names. The row is inside if the published value lies in the interval and, with `same_sign`, has the middle's sign. `reason` and `regression` are as in `add`, for the middle. `depends` names
        the parameter that the number depends on most."""
        low, centre, high = ours
        inside = low <= value <= high and (value * centre > 0 or not same_sign)
        self._add(quantity, source, sure, published, inside, f"{low:.{digits}g} to {high:.{digits}g} {unit}".strip(), kind, fitted, reason, note, centre, unit,
                  regression, f"{middle} {centre:.{digits}g}", depends=depends)

    def show(self, quantity, source, sure, published, ours, *, note="", depends=""):
        """Adds a number that explains another row. It is not judged, and not counted."""
        self.entries.append({"entry": "row", "section": self.section, "quantity": quantity, "source": source, "sure": sure, "published": published, "ours": ours, "scatter": "",
                             "kind": SHOWN, "trend": False, "weak": False, "fitted": "", "inside": None, "reason": "", "note": note, "depends": depends, "regression": "",
                             "kept": True, "passed": True})
        print(f"{'':7}  {quantity}: {ours}; published {published}", flush=True)

    def trend(self, quantity, source, sure, published, holds, ours, *, kind, fitted, reason="", note="", number=None, unit="", regression=None):
        """Adds a published tendency without comparable numbers. If it does not hold, the row needs a reason, and `number` and `regression` as in `add`."""
        self._add(quantity, source, sure, published, holds, ours, kind, fitted, reason, note, number, unit, regression, trend=True)

    def remark(self, text):
        """Adds a sentence about all rows of the experiment."""
        self.entries.append({"entry": "remark", "section": self.section, "text": text})
        print(text, flush=True)

    def curve(self, figure, label, x, y, x_label, y_label, published=False):
        """Adds a curve to FIGURE.svg, where all curves of that figure are drawn."""
        self.entries.append({"entry": "curve", "section": self.section, "figure": figure, "label": label, "x": [float(v) for v in x],
                             "y": [float(v) for v in y], "x_label": x_label, "y_label": y_label, "published": published})

    def end(self):
        """Writes the file. Returns the program's exit status: 1 if a row is outside without a reason and a regression interval, or if a number lies outside its
        regression interval; otherwise 0."""
        (self.folder / f"{self.name}.json").write_text(json.dumps(self.entries, indent=1) + "\n")
        return int(any(e["entry"] == "row" and not e["passed"] for e in self.entries))
