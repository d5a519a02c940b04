#!/usr/bin/python3
"""Tests that trocar-replay --json-lines gives the values of --csv, to the last bit, under the names listed in docs/studies/plotting.md.

usage: test_json_lines.py BUILD_DIR SOURCE_DIR
"""
import csv
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

BUILD, SOURCE = (Path(argument).resolve() for argument in sys.argv[1:3])


def run(program, *arguments):
    done = subprocess.run([BUILD / "clients" / program, *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, f"{program}: {done.returncode}: {done.stderr}"


def replay(folder, scene, poses, *options):
    run("trocar-replay", "--quiet", "--scene", scene, "--poses", poses, "--csv", folder / "a.csv", "--json-lines", folder / "a.jsonl", *options)
    with open(folder / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return rows, [json.loads(line) for line in (folder / "a.jsonl").read_text().splitlines()]


def expected(row):
    """Returns the JSON object for a row of the CSV table."""
    def vector(form):
        return {axis: float(row[form.format(axis)]) for axis in "xyz"}
    unit = "mm" if "base_x [mm]" in row else "m"
    o = {"timestamp": float(row["t [s]"]), "needle": int(row["needle"]), "force_N": vector("f{} [N]"), "torque_Nm": vector("t{} [N m]"),
         "depth_m": float(row["depth [m]"]), "contacts": int(row["contacts"]), "events": row["events"], "tip_lead_rad": float(row["tip_lead [rad]"]),
         f"base_{unit}": vector(f"base_{{}} [{unit}]"), f"tip_{unit}": vector(f"tip_{{}} [{unit}]")}
    if "probe_contacts" in row:
        o["probe"] = {"force_N": vector("probe_f{} [N]"), "torque_Nm": vector("probe_t{} [N m]"), "contacts": int(row["probe_contacts"])}
        if row[f"probe_x [{unit}]"]:    # the probe has been placed
            o["probe"][f"base_{unit}"] = vector(f"probe_{{}} [{unit}]")
    return o


def layout_curves():
    """Returns the curves of the CSV layout given in docs/studies/plotting.md."""
    return re.findall('<curve name="([^"]+)"', (SOURCE / "docs/examples/plotjuggler-csv.xml").read_text())


def compare(rows, objects):
    assert len(rows) == len(objects) > 10, (len(rows), len(objects))
    for row, found in zip(rows, objects):
        assert found == expected(row) and list(found) == list(expected(row)), (row, found)


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows, objects = replay(folder, SOURCE / "meshes/figure8.yaml", SOURCE / "tests/traces/figure8.log")
        compare(rows, objects)
        assert len(layout_curves()) > 5 and set(layout_curves()) < set(rows[0]), set(layout_curves()) - set(rows[0])
        assert any(o["contacts"] > 0 for o in objects) and any("puncture" in o["events"] for o in objects)

        scene = (SOURCE / "meshes/trus.yaml").read_text()
        (folder / "prober.yaml").write_text(re.sub("^mesh: *", f"mesh: {SOURCE}/meshes/", scene, flags=re.M))
        run("trocar-device", "--script", "figure8", "--rate", "100", "--duration", "0.2", "--write-log", folder / "poses.log")
        rows, objects = replay(folder, folder / "prober.yaml", folder / "poses.log", "--patient")
        compare(rows, objects)
        assert all("base_mm" in o and "base_mm" in o["probe"] for o in objects), objects[0]
        without_start, count = re.subn(r"^( *)start: .*$", "", (folder / "prober.yaml").read_text(), flags=re.M)
        assert count == 1, without_start
        (folder / "prober.yaml").write_text(without_start)
        rows, objects = replay(folder, folder / "prober.yaml", folder / "poses.log")
        compare(rows, objects)
        assert all("base_m" in o and "base_m" not in o["probe"] for o in objects), objects[0]

        done = subprocess.run([BUILD / "clients/trocar-replay", "--scene", SOURCE / "meshes/figure8.yaml", "--poses", SOURCE / "tests/traces/figure8.log",
                               "--json-lines", folder / "none/a.jsonl"], capture_output=True, text=True)
        assert done.returncode == 2 and "none/a.jsonl: cannot be written" in done.stderr, done
    print("passed")


if __name__ == "__main__":
    main()
