#!/bin/bash
# In a locale with a decimal comma, the library, the Python package and the programs work as in the C locale. Exit status 77: network namespaces or the
# definitions of locales (Debian package locales) are not available.
# usage: test_locale.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
command -v localedef >/dev/null && [ -e /usr/share/i18n/locales/de_DE ] || { echo "no sources of locales: apt install locales"; exit 77; }
. "$2/tests/shared/in_namespace.sh"
fail() { echo "FAILED: $*" >&2; exit 1; }

mkdir "$work/locales"
localedef -i de_DE -f UTF-8 "$work/locales/de_DE.UTF-8" || [ $? -eq 1 ] # warnings
export LOCPATH=$work/locales PYTHONPATH=$build/clients/python TROCAR_LIBRARY=$build/core/libtrocar.so
[ "$(LC_ALL=de_DE.UTF-8 locale decimal_point)" = , ] || fail "no decimal comma"

# Tests the library in a host program that sets the locale.
"$build/tests/public/test_locale"

# Tests the Python package in a program that sets the locale.
if [ -z "${TROCAR_SANITIZED:-}" ]; then
cat >"$work/host.py" <<'END'
import locale, sys
if len(sys.argv) > 2:
    locale.setlocale(locale.LC_ALL, sys.argv[2])
    assert locale.localeconv()["decimal_point"] == ","
import numpy as np
import trocar
scene = trocar.Scene.load(sys.argv[1])
scene["needle.length"] = 0.15
scene["needle.start.position"] = [0.0025, 0.5, 1e-7]
print({key: scene[key] for key in scene})
print(trocar.keys())
for key, value in (("regions[0].poisson_ratio", 0.75), ("needle.start.orientation", [0.5, 0, 0, 0.25])):
    try:
        scene[key] = value
    except trocar.Error as error:
        print(error)
scene = trocar.Scene.load(sys.argv[1])
model = trocar.Model(scene)
print(model.description)
sim = trocar.Sim(model)
poses = np.tile([0.005, 0.003, -0.201, 1, 0, 0, 0], (300, 1)); poses[:, 2] += 1e-4 * np.arange(300)
print(sim.run(poses, 0.001)["force"].tobytes().hex())
if len(sys.argv) > 2:
    assert locale.localeconv()["decimal_point"] == ",", "the program's locale has been changed"
END
/usr/bin/python3 "$work/host.py" "$source/meshes/implant.yaml" >"$work/plain"
LC_ALL=de_DE.UTF-8 /usr/bin/python3 "$work/host.py" "$source/meshes/implant.yaml" de_DE.UTF-8 >"$work/german"
[ "$(wc -c <"$work/plain")" -gt 10000 ] || fail "the program said little: $(head -c 500 "$work/plain")"
diff "$work/plain" "$work/german" || fail "Python differs"
fi

# Tests the programs: options, tables, JSON, .vtu files, logs, reports and messages.
study() {
    cat <<END
scene: $source/meshes/figure8.yaml
motion: {straight: {depth: 0.0125, speed: 0.05}, start: [0.005, 0.003, -0.2005]}
samples: {method: random, count: 3, seed: 1}
parameters: {"needle.outer_diameter": {uniform: [1.15e-3, 1.3e-3]}, motion.speed: {log_uniform: [0.025, 0.1]}}
record: [peak_force]
END
}
run_programs() { # FOLDER
    mkdir "$1"
    (
        cd "$1"
        "$build/clients/trocar-device" --script figure8 --speed 2.5 --rate 500.5 --start 0.0045,0.003,-0.201 --write-log poses.log >device.out
        "$build/clients/trocar-replay" --scene "$source/meshes/figure8.yaml" --poses poses.log --csv out.csv --json-lines out.json --vtu at --at 0.25 --pvd series \
            --shift shift.csv --out wrenches.log --seeds seeds.csv 2>replay.err
        "$build/clients/trocar-replay" --scene "$source/meshes/figure8.yaml" --poses poses.log --compare wrenches.log --tolerance 0.5 2>compare.err
        status=0
        sed "s|0.45$|0.75|; s|^mesh: |mesh: $source/meshes/|" "$source/meshes/figure8.yaml" >bad.yaml
        "$build/clients/trocar-replay" --scene bad.yaml --poses poses.log 2>bad.err || status=$?
        [ "$status" -eq 2 ] || fail "a bad scene: status $status"
        if [ -z "${TROCAR_SANITIZED:-}" ]; then
            study >study.yaml
            /usr/bin/python3 -m trocar.studies.study run study.yaml --out results --quiet >study.out 2>&1 || fail "$(cat study.out)"
            # rows are in the order in which the runs finished; result.csv is sorted
            LC_ALL=C sort -o results/rows-1-of-1.csv results/rows-1-of-1.csv
        fi
        # Tests a server and a device. Their measured values differ from run to run, but every number must be written in the C locale's format.
        "$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --rate 500.5 --allow-non-rt >server.live 2>&1 &
        server=$!
        until grep -qx ready server.live; do kill -0 $server || fail "$(cat server.live)"; sleep 0.05; done
        timeout 60 "$build/clients/trocar-device" --speed 2.5 --settle 0.2 --csv live.csv --report live.json >device.live 2>&1 || fail "$(cat device.live)"
        kill $server
        wait $server || true
        /usr/bin/python3 - <<'END'
import csv, json
rows = list(csv.reader(open("live.csv")))
assert len(rows) > 50 and all(len(row) == len(rows[0]) for row in rows), len(rows)
[float(cell) for row in rows[1:] for name, cell in zip(rows[0], row) if name not in ("events",)]
assert all(isinstance(json.load(open("live.json"))[key], float) for key in ("deepest_m", "round_trip_p50_s"))
END
        rm -rf server.live device.live live.csv live.json
    )
}
LC_ALL=C run_programs "$work/c"
LC_ALL=de_DE.UTF-8 run_programs "$work/de"
find "$work/de" -type f | xargs sed -i "s|$work/de|$work/c|g"
diff -r "$work/c" "$work/de" || fail "programs differ"
[ "$(find "$work/c" -type f | wc -l)" -gt 12 ] || fail "few files: $(find "$work/c" -type f)"
echo passed
