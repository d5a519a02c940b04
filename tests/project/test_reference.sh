#!/bin/bash
# Checks that scene.csv and programs.csv in docs/reference agree with the output of scripts/pages/reference for the scene table and the programs' --help, and
# that these tables and the site's page of messages are complete.
# usage: test_reference.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2 # absolute
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$source/scripts/pages/reference" "$build" "$work"
for table in "$work"/*; do
    diff "$source/docs/reference/$(basename "$table")" "$table" || { echo "FAILED: $(basename "$table") is out of date: run scripts/pages/reference" >&2; exit 1; }
done
"$source/scripts/pages/reference" --pages "$work"
# Every field and every constant of the messages is there, counted independently.
lcm=$source/lcmtypes/trocar.lcm
[ "$(grep -cE '^ +(const )?[a-z0-9_]+ [A-Za-z]' "$lcm")" -eq "$(grep -c '^| `' "$work/messages.md")" ] || { echo "FAILED: fields are missing" >&2; exit 1; }
/usr/bin/python3 - "$source/tests/fuzz" "$work/scene.csv" <<'EOF' # the scene fuzzer starts from a scene with every key, and knows their words
import csv, pathlib, re, sys
import yaml

def keys(node, path):
    if isinstance(node, dict):
        return set().union(*(keys(value, f"{path}.{name}".lstrip(".")) for name, value in node.items()))
    return set().union(*(keys(entry, f"{path}[]") for entry in node)) if isinstance(node, list) and isinstance(node[0], dict) else {path}

fuzz, table = map(pathlib.Path, sys.argv[1:])
listed = {row["key"] for row in csv.DictReader(table.read_text().splitlines())}
given = keys(yaml.safe_load((fuzz / "corpus/scene/every_key.yaml").read_text()), "")
words = set(re.findall(r'^"(\w+): "$', (fuzz / "scene.dict").read_text(), re.MULTILINE))
faults = [f"{key} is missing from scene.csv" for key in given - listed] + [f"{key} is missing from every_key.yaml" for key in listed - given]
faults += [f"{word} is in only one of scene.csv and scene.dict" for word in words ^ {word for key in listed for word in key.replace("[]", "").split(".")}]
sys.exit("FAILED: " + "; ".join(sorted(faults)) if faults else 0)
EOF
# Every option in the programs' tables and every script is there, and the documentation says what to do about every flag.
for option in $(sed -nE 's/^    \{"([a-z][a-z-]+)", .*/--\1/p' "$source"/server/main.c "$source"/clients/{device/device,replay/replay,top/top,bench/bench_*}.c "$source"/clients/view/view_options.c "$source"/clients/bridges/*/*.c); do
    grep -qE "^trocar-[a-z -]*,\"?(-., )?$option(,|=|\[=|\")" "$work/programs.csv" || { echo "FAILED: no option $option in programs.csv" >&2; exit 1; }
done
for script in "$source"/scripts/* "$source"/scripts/pages/*; do
    [ -d "$script" ] || grep -q "^${script#"$source"/}," "$work/programs.csv" || { echo "FAILED: no $script in programs.csv" >&2; exit 1; }
done
for flag in $(sed -nE '/struct needle_wrench_t/,/EVENT_/s/.* const int32_t ([A-Z_]+) .*/\1/p' "$lcm" | grep -v EVENT_); do
    grep -q "\`$flag\`" "$source/docs/troubleshooting.md" || { echo "FAILED: nothing about $flag in troubleshooting.md" >&2; exit 1; }
done
echo passed
