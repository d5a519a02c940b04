"""Results of the verification checks, kept in results/: each check's rows in NAME.csv, and one line for its last full run in runs.csv."""
import csv
import hashlib
import re
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
RESULTS, PLOTS = HERE / "results", HERE / "plots"
ROW = ("section", "check", "reference", "value", "expected", "error", "limit", "unit", "pass", "note")  # pass: yes, no, or empty without a limit
RUN = ("check", "commit", "mechanics", "date", "machine", "rows", "failed", "measured", "minutes", "figures")  # mechanics: a digest; minutes: CPU time


def read(path):
    if not path.exists():
        return []
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def write(path, columns, rows):
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def runs():
    return read(RESULTS / "runs.csv")


def rows_of(check):
    return read(RESULTS / f"{check}.csv")


def source_of(check):
    return next(path for path in sorted(HERE.rglob(f"verify_{check}.*")) if path.suffix in (".c", ".py"))


def all_checks():
    return sorted(path.stem.removeprefix("verify_") for path in HERE.rglob("verify_*") if path.suffix in (".c", ".py"))


def digest_of_mechanics():
    """Returns a digest of the C sources in core/ without comments and white space. It shows whether the code has changed since a run, even without the
    repository's history."""
    digest = hashlib.sha256()
    for path in sorted(str(path.relative_to(ROOT)) for path in (ROOT / "core").rglob("*") if path.suffix in (".c", ".h")):
        code = re.sub(r'("(?:\\.|[^"\\\n])*")|/\*.*?\*/', r"\1 ", (ROOT / path).read_text(encoding="utf-8"), flags=re.DOTALL)
        digest.update(f"{path}\0{' '.join(code.split())}".encode())
    return digest.hexdigest()[:12]
