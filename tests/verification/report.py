"""Generates the text of the verification report (REPORT.md), its summary in docs/verification.md and its row in README.md from the tables in results/.
scripts/pages/verification_summary writes them."""
import re

import results

HEAD = """# Verification report

Made by `scripts/pages/verification_summary` from the tables in `results`; do not edit. A row passes if its error is at most its limit; errors are
relative unless the row's note says otherwise. Rows without a limit are only measured, and are not counted.
"""
MEDIAN = re.compile(r"median of all (\d+) forces")  # row of needle_meshes


def table(head, lines):
    right = {"rows", "passed", "failed", "measured", "error / limit", "minutes", "limit", "error"}
    rule = "|" + "|".join("---:" if name in right else "---" for name in head) + "|"
    return "\n".join(["| " + " | ".join(head) + " |", rule, *("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)]) + "\n"


def worst(rows):
    """Returns the largest ratio of error to limit as text. A limit of zero has no ratio."""
    ratios = [float(row["error"]) / float(row["limit"]) for row in rows if row["pass"] and row["error"] and row["limit"] and float(row["limit"]) > 0]
    return f"{max(ratios):.2g}" if ratios else ""


def counts(rows):
    number = lambda verdict: sum(row["pass"] == verdict for row in rows)
    return number("yes") + number("no"), number("yes"), number("no") or "", number("") or "", worst(rows)


def grouped(rows, key):
    groups = {}
    for row in sorted(rows, key=key):
        groups.setdefault(key(row), []).append(row)
    return groups


def changed(run, digest):
    return run["mechanics"] != digest or run["commit"].endswith("-dirty")


class Report:
    def __init__(self):
        self.runs, self.digest = results.runs(), results.digest_of_mechanics()
        self.rows = [row | {"of": run["check"]} for run in self.runs for row in results.rows_of(run["check"])]
        self.failing = [row for row in self.rows if row["pass"] == "no"]
        self.oldest = min(run["date"] for run in self.runs)

    def score(self):
        rows, passed, *_ = counts(self.rows)
        return f"{passed} of {rows} rows pass"

    def age(self):
        changes = sum(changed(run, self.digest) for run in self.runs)
        commits = sorted({run["commit"] for run in self.runs if run["date"] == self.oldest})
        oldest = f"The oldest checks ran on {self.oldest} (commit{'s' if len(commits) > 1 else ''} {', '.join(commits)})"
        if not changes:
            return oldest + "; the mechanics (`core/`) have not changed since then."
        which = "all checks" if changes == len(self.runs) else f"{changes} of {len(self.runs)} checks"
        return oldest + f". The mechanics (`core/`) have changed since {which} ran, and their rows may differ now."

    def missing(self):
        ran = {run["check"] for run in self.runs}
        return [check for check in results.all_checks() if check not in ran]

    def failures(self):
        if self.failing:
            yield table(("check", "reference", "error", "limit", "reason"),
                        [(f"{row['section']}: {row['check']}", row["reference"], row["error"], row["limit"], row["note"]) for row in self.failing])

    def checks(self):
        for run in self.runs:
            figures = ", ".join(f"[{i}](plots/{name})" for i, name in enumerate(run["figures"].split(), 1))
            yield (f"[{run['check']}](results/{run['check']}.csv)", *counts([row for row in self.rows if row["of"] == run["check"]]), figures,
                   run["commit"], run["date"], run["minutes"], "yes" if changed(run, self.digest) else "no")

    def lines(self):
        """Returns the text of REPORT.md."""
        measured = sum(row["pass"] == "" for row in self.rows)
        yield HEAD
        yield f"**{self.score()}**, {measured} more are measured. {self.age()}\n"
        if self.failing:
            yield "## Rows that fail\n"
            yield from self.failures()
        yield "## Checks\n"
        yield ("The last full run of each check `verify_NAME`, whose head says what it compares. *Error / limit*: the largest of its rows, without limits of zero. "
               "*Changed*: whether the C sources in `core/` have changed since. Processor, compiler and libraries are in [`runs.csv`](results/runs.csv).\n")
        yield table(("check", "rows", "passed", "failed", "measured", "error / limit", "figures", "commit", "date", "minutes", "changed"), self.checks())
        if self.missing():
            yield f"Not yet recorded: {', '.join(self.missing())}.\n"

    def summary(self):
        """Returns the lines between the markers in docs/verification.md."""
        yield f"**{self.score()}**. {self.age()}\n"
        yield table(("part", "rows", "passed", "failed", "measured", "error / limit"),
                    [(part, *counts(rows)) for part, rows in grouped(self.rows, lambda row: row["section"].split(":")[0]).items()])

    def readme(self):
        """Returns the text of README's row."""
        error, forces = next((float(row["value"]), found[1]) for row in self.rows if (found := MEDIAN.match(row["check"])))
        since = "changed" if any(changed(run, self.digest) for run in self.runs) else "unchanged"
        return f"{self.score()}; median error of {forces} forces {100 * error:.1f} %; oldest {self.oldest}, mechanics {since} since"
