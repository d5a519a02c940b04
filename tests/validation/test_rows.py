#!/usr/bin/python3
"""Tests which rows of the validation report fail, and which the report counts as predictions."""
import contextlib
import io
import json
import sys
import tempfile
import unittest
from pathlib import Path

from report import report_lines
from rows import ABSTRACT, CONSISTENT, PREDICTED, Rows


class TestRows(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.rows = Rows("test", "Test", folder.name, short=True)

    def seeds(self, ours, **options):
        """Returns the exit status for a single row whose published range is 1.9 to 5.7 mm."""
        self.rows.entries.clear()
        with contextlib.redirect_stdout(io.StringIO()):
            self.rows.add("seeds", "paper", ABSTRACT, (1.9, 5.7), ours, "mm", kind=PREDICTED, fitted="", **options)
        return self.rows.end()

    def test_inside(self):
        self.assertEqual(self.seeds(3.8), 0)

    def test_outside_needs_reason_and_regression_interval(self):
        self.assertEqual(self.seeds(1.3), 1)
        self.assertEqual(self.seeds(1.3, reason="known"), 1)
        self.assertEqual(self.seeds(1.3, regression=(1.2, 1.4)), 1)
        self.assertEqual(self.seeds(1.3, reason="known", regression=(1.2, 1.4)), 0)

    def test_a_reason_does_not_excuse_another_number(self):
        self.assertEqual(self.seeds(30, reason="known", regression=(1.2, 1.4)), 1)
        self.assertEqual(self.seeds(3.8, reason="known", regression=(1.2, 1.4)), 1)     # the number is now inside, so the reason no longer applies
        self.assertEqual(self.seeds(float("nan"), reason="known", regression=(1.2, 1.4)), 1)

    def test_interval(self):
        def status(ours, **options):
            self.rows.entries.clear()
            with contextlib.redirect_stdout(io.StringIO()):
                self.rows.interval("shift", "paper", ABSTRACT, "15 mm", 15.0, ours, "mm", kind=PREDICTED, fitted="", **options)
            return self.rows.end()
        self.assertEqual(status((10, 12, 16)), 0)
        self.assertEqual(status((5, 8, 12)), 1)
        self.assertEqual(status((5, 8, 12), reason="known", regression=(7, 9)), 0)
        self.assertEqual(status((5, 9.5, 12), reason="known", regression=(7, 9)), 1)
        self.assertEqual(status((-30, -2, 20)), 0)
        self.assertEqual(status((-30, -2, 20), same_sign=True), 1)

    def test_tendency(self):
        for number, status in ((1.0, 0), (0.5, 1)):
            self.rows.entries.clear()
            with contextlib.redirect_stdout(io.StringIO()):
                self.rows.trend("force", "paper", ABSTRACT, "less", False, f"{number}", kind=PREDICTED, fitted="", reason="known", number=number, regression=(0.9, 1.1))
            self.assertEqual(self.rows.end(), status)

    def test_weak_row_is_held_to_its_regression_interval(self):
        self.assertEqual(self.seeds(2.0, weak=True, regression=(1.95, 2.1)), 0)
        self.assertEqual(self.seeds(5.0, weak=True, regression=(1.95, 2.1)), 1)
        with self.assertRaises(ValueError):
            self.seeds(2.0, weak=True)

    def test_how_sure_is_a_defined_word(self):
        with self.assertRaises(ValueError):
            self.rows.trend("force", "paper", "order of magnitude", "less", True, "", kind=PREDICTED, fitted="")

    def test_counts(self):
        with contextlib.redirect_stdout(io.StringIO()):
            self.rows.add("number", "", ABSTRACT, (1, 2), 1.5, "", kind=PREDICTED, fitted="")
            self.rows.add("weak", "", ABSTRACT, (0, 2), 1.5, "", kind=PREDICTED, fitted="", weak=True, regression=(1, 2))
            self.rows.trend("tendency", "", ABSTRACT, "", True, "", kind=PREDICTED, fitted="")
            self.rows.add("follows", "", ABSTRACT, (1, 2), 3, "", kind=CONSISTENT, fitted="", reason="known", regression=(2, 4))
            self.rows.show("part", "", ABSTRACT, "not measured", "1 mm")
            self.rows.remark("24 runs")
        self.assertEqual(self.rows.end(), 0)
        text = "\n".join(report_lines(json.loads((Path(self.rows.folder) / "test.json").read_text()), "0"))
        for count in ("1 of 1** predictions of numbers", "1 of 1** predictions of a tendency", "1 of 1** weak", "0 of 1** rows of consistency", "0 of 0** fits", "Test: 24 runs."):
            self.assertIn(count, text)
        self.assertNotIn("part", text)


if __name__ == "__main__":
    sys.exit(unittest.main())
