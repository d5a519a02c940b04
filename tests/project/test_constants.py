#!/usr/bin/python3
"""Tests that scripts/pages/constants reads constants and their comments and turns them into variables that a compiler accepts; that every constant of the
mechanics has a unit, a purpose and a source, and that docs/reference/constants.csv agrees with these comments and the measured changes.

usage: test_constants.py SOURCE_DIR
"""
import importlib.machinery
import importlib.util
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.dont_write_bytecode = True
loader = importlib.machinery.SourceFileLoader("constants", f"{sys.argv[1]}/scripts/pages/constants")
constants = importlib.util.module_from_spec(importlib.util.spec_from_loader("constants", loader))
loader.exec_module(constants)

SOURCE = """#include <stdio.h>
typedef struct { double aside, turn; } line_tolerance;
static const double DEPTH = 3e-3; /* m: over which
                                     it grows to 1.5 times itself. Chosen: about two diameters */
static const double SHARE = 0.7;  /* fraction below 1: of something. Fitted to a row (tests/x.c) */
enum { PASSES = 3 };              /* passes: before it is given up. Cost */
enum { ROOM = 4, NONE = -1 };     /* of an array: not a constant */
static const line_tolerance SAME = {0.5, 4}; /* m and rad: equal. Rounding */
static const double BARE = 1.0;   /* m, with a comment of another form */
int main(void) { printf("%g %g %d %g %g %g", DEPTH, SHARE, PASSES, SAME.aside, SAME.turn, BARE); }
"""

found, faults = constants.read("folder/file.c", SOURCE)
assert [(c.name, c.type, c.value, c.unit, c.kind) for c in found] == [
    ("DEPTH", "double", "3e-3", "m", "Chosen"), ("SHARE", "double", "0.7", "fraction below 1", "Fitted"), ("PASSES", "int", "3", "passes", "Cost"),
    ("SAME", "line_tolerance", "{0.5, 4}", "m and rad", "Rounding")], found
assert found[0].purpose == "over which it grows to 1.5 times itself" and found[0].source == "Chosen: about two diameters", found[0]
assert len(faults) == 1 and faults[0].startswith("core/folder/file.c:9: BARE"), faults
assert [c.accepts(2.0) for c in found] == [True, False, True, True] and all(c.accepts(0.5) for c in found)

with tempfile.TemporaryDirectory() as folder:
    paths = [Path(folder, "file.c"), Path(folder, "factors.c")]
    paths[0].write_text(constants.variable(SOURCE, found))
    paths[1].write_text(constants.FACTORS)
    subprocess.run(["cc", "-Wall", "-Wextra", "-Werror", "-o", Path(folder, "program"), *paths], check=True)
    for key, expected in ((None, "0.003 0.7 3 0.5 4 1"), ("DEPTH", "0.006 0.7 3 0.5 4 1"), ("PASSES", "0.003 0.7 6 0.5 4 1"), ("SAME", "0.003 0.7 3 1 8 1")):
        varied = {"TROCAR_CONSTANT": f"folder/file.c:{key}", "TROCAR_FACTOR": "2"} if key else {}
        said = subprocess.run([Path(folder, "program")], env={**os.environ, **varied}, check=True, capture_output=True, text=True).stdout
        assert said == expected, (key, said)

before = [[(0.0, 0.0, 4.0), (0.0, 0.0, 4.0), (0.0, 3.0, 0.0), (0.0, 3.0, 0.0)]]
assert abs(constants.change(before, [before[0][:3] + [(0.0, 3.0, 0.02)]]) - 0.5) < 1e-9                   # 0.02 N is 0.5 % of 4 N
assert abs(constants.change(before, [before[0][:3] + [(0.0, 3.0, 0.2)]]) - 5.0) < 1e-9
assert constants.change(before, [before[0][:2] + [(0.0, 0.0, 4.0), (0.0, 3.0, 0.0)]]) == 1.0    # one tick later
assert math.isnan(constants.change(before, None))

checked = subprocess.run([f"{sys.argv[1]}/scripts/pages/constants", "--check"], capture_output=True, text=True, check=False)
assert checked.returncode == 0, checked.stderr
