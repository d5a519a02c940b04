#!/usr/bin/python3
"""Tests that scripts/fit_friction recovers the parameters of simulated insertions from data with noise and outliers and refuses bad input.

usage: test_fit_friction.py BUILD_DIR SOURCE_DIR
"""
import contextlib
import functools
import importlib.machinery
import importlib.util
import io
import os
import re
import subprocess
import sys
import tempfile
import types

import numpy as np

BUILD, SOURCE = (os.path.abspath(path) for path in sys.argv[1:3])
FIT = os.path.join(SOURCE, "scripts/fit_friction")
os.environ["TROCAR_LIBRARY"] = os.path.join(BUILD, "core/libtrocar.so")
sys.path.insert(0, os.path.join(BUILD, "clients/python"))
sys.dont_write_bytecode = True  # leaves no compiled files next to the script
import trocar

RATE = 1000          # Hz
NOISE = 0.02         # N, standard deviation
OUTLIERS = 0.01      # fraction of samples that are off by up to 2 N
START = -0.201       # m, needle's base when the tip is 1 mm in front of the skin
CAPSULE = 36.8       # mm, depth at which this track crosses the capsule
REGIONS = ["--region", "surrounding=0", "--region", f"prostate={CAPSULE}"]
PUNCTURES = ["--puncture", "skin=0", "--puncture", f"capsule={CAPSULE}"]
FAST = ["fast1.csv", "fast2.csv", "fast3.csv", "fast4.csv"]   # several files, because fast insertions have few samples
TRUTH = {"surrounding": {"cutting_force": 0.4, "cutting_viscosity": 1.0, "static": 12.0, "kinetic": 7.0, "viscous": 100.0},
         "prostate": {"cutting_force": 0.5, "cutting_viscosity": 1.0, "static": 15.0, "kinetic": 9.0, "viscous": 100.0},
         "skin": {"puncture_force": 1.0}, "capsule": {"puncture_force": 1.3}}


def load_script():
    loader = importlib.machinery.SourceFileLoader("fit_friction", FIT)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module


SCRIPT = load_script()


def fit(*arguments):
    """Runs the script's main function in this process, which saves starting Python and NumPy for each run. Exceptions are passed on."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    sys.argv = [FIT, *arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            SCRIPT.main()
        except SystemExit as end:
            status = end.code
    return types.SimpleNamespace(returncode=status, stdout=out.getvalue(), stderr=err.getvalue())


# ---- data --------------------------------------------------------------------------------------------------------------


def in_and_out(speed, depth=0.072, rest=0.3):
    """Returns the base's z (m) during an insertion and a withdrawal at this speed (m/s)."""
    steps = int(depth / speed * RATE)
    way = speed / RATE * np.arange(steps)
    return np.concatenate([START + way, np.full(int(rest * RATE), START + depth), START + depth - way, np.full(50, START)])


def insertion(model, positions):
    """Returns the outputs of all ticks as a structured array, for a needle moved to these values of z in turn."""
    poses = np.zeros((1, len(positions), 7))
    poses[..., :4] = [0.005, 0.003, 0, 1]
    poses[0, :, 2] = positions
    return trocar.rollout(model, poses, 1.0 / RATE)[0]


def write_scene(path, youngs_modulus):
    """Writes a scene with the parameters TRUTH and the mesh of figure 8."""
    lines = [f"mesh: {SOURCE}/meshes/prostate-570.msh", "fixed: [fixed]", "regions:"]
    for name in ("surrounding", "prostate"):
        t = TRUTH[name]
        lines += [f"  - name: {name}", f"    youngs_modulus: {youngs_modulus:g}", f"    cutting_force: {t['cutting_force']}",
                  f"    cutting_viscosity: {t['cutting_viscosity']}",
                  f"    friction: {{static: {t['static']}, kinetic: {t['kinetic']}, viscous: {t['viscous']}}}"]
    lines += ["membranes:"]
    lines += [f"  - {{name: {name}, puncture_force: {TRUTH[name]['puncture_force']}}}" for name in ("skin", "capsule")]
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


def measure(model, speed, *paths):
    """Writes measurements as a laboratory would: depth in mm and force in N, each with independent noise."""
    out = insertion(model, in_and_out(speed))
    for path in paths:
        random = np.random.default_rng(len(path) + ord(path[-5]))
        force = -out["force"][:, 2] + NOISE * random.standard_normal(len(out))
        off = random.random(len(out)) < OUTLIERS
        force[off] += random.uniform(-2, 2, off.sum())
        with open(path, "w", encoding="utf-8") as file:
            file.write("time [s],depth [mm],force [N]\n")
            file.writelines(f"{k / RATE:.6f},{1e3 * depth:.5f},{f:.5f}\n" for k, (depth, f) in enumerate(zip(out["depth"], force)))


def model_of(scene):
    return trocar.Model(trocar.Scene.load(scene))


# ---- checks ------------------------------------------------------------------------------------------------------------


def parse(text):
    """Returns {region or membrane: {key: value}} parsed from the script's output."""
    values, name = {}, None
    for line in text.splitlines():
        key, _, value = line.split("#")[0].strip().lstrip("- ").partition(": ")
        if key == "name":
            name = value
            values[name] = {}
        elif name and value:
            values[name][key] = float(value)
    return values


@functools.lru_cache
def fitted(*arguments):
    result = fit(*arguments)
    assert result.returncode == 0, result.stderr
    return result.stdout, parse(result.stdout)


def assert_truth(values, keys, limit=0.05):
    for name, parameters in TRUTH.items():
        for key in set(parameters) & set(keys):
            error = values[name][key] / parameters[key] - 1.0
            print(f"{name} {key}: {values[name][key]:.4g}, true {parameters[key]:.4g} ({100 * error:+.1f} %)")
            assert abs(error) < limit, f"{name}: {key} is off by {100 * error:.1f} %"


def parameters_come_back():
    """In soft tissue, all parameters are recovered except static friction, for which a lower bound is reported."""
    write_scene("soft.yaml", 40e3)
    soft = model_of("soft.yaml")
    measure(soft, 0.005, "slow.csv")
    measure(soft, 0.05, *FAST)
    text, values = fitted("slow.csv", *FAST, *REGIONS, *PUNCTURES, "--figure", "fit.svg")
    assert_truth(values, ["cutting_force", "kinetic", "viscous", "puncture_force"])
    assert "lower bound" in text
    for name in ("surrounding", "prostate"):
        assert values[name]["kinetic"] <= values[name]["static"] < TRUTH[name]["static"]
    with open("fit.svg", encoding="utf-8") as file:
        assert "</svg>" in file.read()


def static_friction_comes_back_in_stiff_tissue():
    """Stiff tissue deforms by less than the distance over which friction weakens, so static friction is recovered as well."""
    write_scene("stiff.yaml", 1e6)
    stiff = model_of("stiff.yaml")
    measure(stiff, 0.005, "stiff-slow.csv")
    measure(stiff, 0.02, "stiff-fast.csv")
    text, values = fitted("stiff-slow.csv", "stiff-fast.csv", *REGIONS, *PUNCTURES)
    assert "lower bound" not in text
    assert_truth(values, ["cutting_force", "kinetic", "static"])


def punctures_are_found():
    _, values = fitted("slow.csv", *REGIONS)
    assert sorted(values) == ["membrane_1", "membrane_2", "prostate", "surrounding"], sorted(values)
    assert abs(values["membrane_1"]["puncture_force"] / 1.0 - 1.0) < 0.05
    assert abs(values["membrane_2"]["puncture_force"] / 1.3 - 1.0) < 0.05


def other_records_of_the_same_do():
    """Tests data with a tenth of the samples, with noise in the depth, without time, or in another program's format."""
    random = np.random.default_rng(1)
    changed("coarse.csv", lambda text: "\n".join(text.splitlines()[::10]))
    changed("noisy.csv", of_each_row(lambda t, d, f: f"{t},{float(d) + 0.01 * random.standard_normal():.5f},{f}"))
    changed("timeless.csv", lambda text: re.sub("^[^,]*,", "", text, flags=re.MULTILINE))
    changed("other.csv", lambda text: "\ufeff# of another laboratory\n" + text.replace(",", ";").replace("depth [mm]", "Depth (mm)"))
    _, expected = fitted("slow.csv", *REGIONS)
    for record in (["coarse.csv"], ["noisy.csv"], ["timeless.csv", "--speed", "5"], ["other.csv"]):
        _, values = fitted(*record, *REGIONS)
        for name, keys in (("surrounding", ("cutting_force", "kinetic")), ("prostate", ("cutting_force", "kinetic")),
                           ("membrane_1", ("puncture_force",)), ("membrane_2", ("puncture_force",))):
            for key in keys:
                assert abs(values[name][key] / expected[name][key] - 1.0) < 0.05, f"{record[0]}: {name} {key}: {values[name][key]}"


def one_speed_is_announced():
    text, values = fitted("slow.csv", *REGIONS, *PUNCTURES)
    assert "cannot be identified" in text and values["surrounding"]["viscous"] == 0.0
    apparent = TRUTH["surrounding"]["kinetic"] + TRUTH["surrounding"]["viscous"] * 0.005
    assert abs(values["surrounding"]["kinetic"] / apparent - 1.0) < 0.05


def the_output_makes_a_scene():
    """With a mesh and a fixed surface added, the fragment is a scene in which a needle can be inserted (the skin yields by 20 mm first)."""
    text, _ = fitted("slow.csv", *FAST, *REGIONS, *PUNCTURES, "--figure", "fit.svg")
    with open("fitted.yaml", "w", encoding="utf-8") as file:
        file.write(f"mesh: {SOURCE}/meshes/prostate-570.msh\nfixed: [fixed]\n{text}")
    assert insertion(model_of("fitted.yaml"), in_and_out(0.05)[:600])["depth"][-1] > 5e-3


def it_runs_as_a_program():
    program = subprocess.run([FIT, "slow.csv", *REGIONS], capture_output=True, text=True, check=True)
    assert program.stdout == fitted("slow.csv", *REGIONS)[0] and program.stderr == ""
    program = subprocess.run([FIT, "none.csv"], capture_output=True, text=True, check=False)
    assert program.returncode == 2 and program.stderr == fit("none.csv").stderr != ""


def refuses(words, *arguments):
    result = fit(*arguments)
    assert result.returncode == 2, f"status {result.returncode}: {arguments}"
    assert words in result.stderr and "Traceback" not in result.stderr, result.stderr
    assert result.stdout == ""


def changed(path, change):
    """Writes slow.csv with changes to its text."""
    with open("slow.csv", encoding="utf-8") as file:
        text = file.read()
    with open(path, "w", encoding="utf-8") as file:
        file.write(change(text))
    return path


def of_each_row(change):
    """Returns a function that applies `change` to the time, depth and force in each row of a text."""
    def of_text(text):
        head, *lines = text.splitlines()
        return "\n".join([head] + [change(*line.split(",")) for line in lines]) + "\n"
    return of_text


def nonsense_is_refused():
    refuses("none.csv", "none.csv")
    refuses("at least 100 samples", changed("empty.csv", lambda text: ""))
    refuses("has no unit", changed("unit.csv", lambda text: text.replace("depth [mm]", "depth")))
    refuses("'inch'", changed("inch.csv", lambda text: text.replace("[mm]", "[inch]")))
    refuses("no column 'force", changed("column.csv", lambda text: text.replace("force", "torque")))
    refuses("word.csv:3", changed("word.csv", lambda text: re.sub(r"\n(.*\n)[^,]*,", r"\n\1two,", text, count=1)))
    refuses("word.csv:4", changed("word.csv", lambda text: "# note\n" + re.sub(r"\n(.*\n)[^,]*,", r"\n\1two,", text, count=1)))
    refuses("zero throughout", changed("still.csv", lambda text: re.sub(r"^[\d.]+,", "0,", text, flags=re.MULTILINE).replace("time [s]", "speed [m/s]")))
    refuses("stays within 0 mm", changed("depth.csv", of_each_row(lambda t, d, f: f"{t},0,{f}")))
    refuses("comma.csv:2: '0,00000' in column depth", changed("comma.csv", lambda text: text.replace(",", ";").replace(".", ",")))
    refuses("not finite", changed("nan.csv", lambda text: text.replace("\n0.009000", "\nnan", 1)))
    refuses("sign reversed", changed("sign.csv", of_each_row(lambda t, d, f: f"{t},{d},{-float(f)}")))
    refuses("no retraction", changed("half.csv", lambda text: "\n".join(text.splitlines()[:10000])))
    refuses("time does not increase", changed("time.csv", lambda text: text.replace("\n0.009000", "\n0.001000", 1)))
    refuses("no speed", changed("speed.csv", lambda text: text.replace("time [s]", "run [1]")))
    refuses("steady sliding", "slow.csv", "--region", "a=0", "--region", "b=60")
    refuses("must start at 0", "slow.csv", "--region", "a=5")
    refuses("no insertion reaches this depth", "slow.csv", *REGIONS, "--puncture", "skin=150")
    refuses("NAME=DEPTH", "slow.csv", "--region", "a")
    refuses("NAME=DEPTH", "slow.csv", "--region", "a: b=0")
    refuses("above 0", "slow.csv", "--speed", "-3")


def main():
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for check in (parameters_come_back, static_friction_comes_back_in_stiff_tissue, punctures_are_found,
                      other_records_of_the_same_do, one_speed_is_announced, the_output_makes_a_scene, nonsense_is_refused, it_runs_as_a_program):
            print(f"-- {check.__name__}", flush=True)
            check()
        os.chdir("/")


if __name__ == "__main__":
    main()
