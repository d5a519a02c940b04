#!/usr/bin/python3
"""Tests how the results of checks are recorded and reported, in a copy of the scripts with its own checks."""
import csv
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SCRIPTS = ("tests/verification/record.py", "tests/verification/report.py", "tests/verification/results.py", "tests/verification/rows.py", "tests/shared/reports.py",
           "scripts/pages/verification_summary")
CHECK = '''"""Checks a beam. And more."""
import sys
from rows import Rows
if {status}:
    sys.exit({status})
rows = Rows.from_arguments(__doc__, "Beam: tip")
rows.compare("deflection", "exact | series", {value}, 2, 0.1, "m")
rows.measured("time", "", 5, None, 0.2, "s")
if {curve}:
    rows.curve("beam", "tip", [0, 1], [0, {value}], "m", "m")
rows.error("median of all 3 forces", "", 0.011, 0.02)
sys.exit(rows.end())
'''


class TestResults(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.root = Path(folder.name)
        self.here = self.root / "tests/verification"
        for name in SCRIPTS:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.root / name)
        self.write("docs/verification.md", "<!-- begin: written by scripts/pages/verification_summary -->\n<!-- end -->\n")
        self.write("README.md", "| [Verification](docs/verification.md#summary) | none |\n")
        self.write("core/beam.c", "int beam;\n")
        self.write("out/README", "")
        self.check("beam", 2.1)
        self.check("rod", 2.1)
        self.git("init", "-q")
        self.commit()

    def write(self, name, text):
        (self.root / name).parent.mkdir(parents=True, exist_ok=True)
        (self.root / name).write_text(text)

    def check(self, name, value, status=0, curve=False):
        self.write(f"tests/verification/verify_{name}.py", CHECK.format(value=value, status=status, curve=curve))

    def git(self, *arguments):
        subprocess.run(["git", "-c", "user.name=test", "-c", "user.email=test@localhost", *arguments], cwd=self.root, check=True, capture_output=True)

    def commit(self):
        self.git("add", ".")
        self.git("commit", "-q", "-m", "test")

    def run_check(self, name):
        command = [sys.executable, "-B", self.here / "record.py", "out", name, sys.executable, "-B", self.here / f"verify_{name}.py"]
        return subprocess.run(command, cwd=self.root, capture_output=True).returncode

    def table(self, name):
        with open(self.here / "results" / f"{name}.csv", newline="") as file:
            return list(csv.DictReader(file))

    def pages(self, *arguments):
        return subprocess.run([sys.executable, self.root / "scripts/pages/verification_summary", *arguments], capture_output=True).returncode

    def report(self):
        self.assertEqual(self.pages(), 0)
        return (self.here / "REPORT.md").read_text()

    def test_rows_and_run(self):
        self.check("beam", 2.1, curve=True)
        self.commit()
        self.assertEqual(self.run_check("beam"), 0)
        first, second, third = self.table("beam")
        self.assertEqual([first[key] for key in ("section", "reference", "value", "expected", "error", "limit", "unit", "pass")],
                         ["Beam: tip", "exact | series", "2.1", "2", "0.05", "0.1", "m", "yes"])
        self.assertEqual((second["pass"], second["limit"], third["pass"]), ("", "", "yes"))
        run, = self.table("runs")
        self.assertEqual([run[key] for key in ("check", "rows", "failed", "measured", "figures")], ["beam", "2", "0", "1", "beam.svg"])
        self.assertRegex(run["commit"], "^[0-9a-f]{7}$")
        self.assertTrue((self.here / "plots/beam.svg").exists())
        text = self.report()
        for words in ("**2 of 2 rows pass**, 1 more are measured", "| [beam](results/beam.csv) | 2 | 2 |  | 1 | 0.55 |", "Not yet recorded: rod."):
            self.assertIn(words, text)
        self.assertNotIn("Rows that fail", text)
        self.assertIn("| 2 of 2 rows pass; median error of 3 forces 1.1 %;", (self.root / "README.md").read_text())
        self.check("beam", 2.1)
        self.assertEqual(self.run_check("beam"), 0)
        self.assertFalse((self.here / "plots/beam.svg").exists())

    def test_other_results_stay(self):
        self.run_check("beam")
        self.run_check("rod")
        before = (self.here / "results/beam.csv").read_text()
        self.check("rod", 3)
        self.assertEqual(self.run_check("rod"), 1)
        self.assertEqual((self.here / "results/beam.csv").read_text(), before)
        self.assertEqual([(run["check"], run["failed"]) for run in self.table("runs")], [("beam", "0"), ("rod", "1")])
        text = self.report()
        self.assertIn("**3 of 4 rows pass**", text)
        self.assertIn("| Beam: tip: deflection | exact \\| series | 0.5 | 0.1 |  |", text)

    def test_changed_mechanics(self):
        self.run_check("beam")
        self.assertIn("have not changed since", self.report())
        self.write("core/beam.c", "/* deflects */\nint beam; /* \"m\" */\n")
        self.assertIn("have not changed since", self.report()) # comments are not mechanics
        self.write("core/beam.c", "long beam;\n")
        self.assertEqual(self.pages("--check"), 1)
        self.run_check("rod")
        self.assertTrue(self.table("runs")[1]["commit"].endswith("-dirty"))
        self.assertIn("have changed since all checks ran", self.report()) # running uncommitted mechanics proves nothing about a commit
        self.commit()
        self.run_check("rod")
        self.assertIn("have changed since 1 of 2 checks ran", self.report())
        self.assertEqual(self.pages("--check"), 0)

    def test_crash_and_skip(self):
        self.run_check("beam")
        before = (self.here / "results/beam.csv").read_text()
        self.check("beam", 2.1, status=77)
        self.assertEqual(self.run_check("beam"), 77)
        self.assertEqual((self.here / "results/beam.csv").read_text(), before)
        self.check("beam", 2.1, status=3)
        self.assertEqual(self.run_check("beam"), 3)
        row, = self.table("beam")
        self.assertEqual((row["pass"], row["note"]), ("no", "exit status 3"))

    def test_missing_place(self):
        self.run_check("beam")
        self.write("README.md", "")
        self.assertNotEqual(self.pages(), 0)


if __name__ == "__main__":
    sys.exit(unittest.main())
