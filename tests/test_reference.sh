#!/bin/bash
# scene.md and messages.md in docs/reference equal the output of scripts/reference for the scene table and trocar.lcm, and are
# complete.
# usage: test_reference.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2 # absolute
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$source/scripts/reference" "$build" "$work"
for page in "$work"/*; do
    diff "$source/docs/reference/$(basename "$page")" "$page" || { echo "FAILED: $(basename "$page") is out of date: run scripts/reference" >&2; exit 1; }
done
# Every key of a commented scene and every field and constant is present, counted independently.
lcm=$source/lcmtypes/trocar.lcm
[ "$(grep -cE '^ +(const )?[a-z0-9_]+ [A-Za-z]' "$lcm")" -eq "$(grep -c '^| `' "$work/messages.md")" ] || { echo "FAILED: fields are missing" >&2; exit 1; }
for key in $(sed -nE 's/^ *([a-z_]+):.*/\1/p' "$source/tests/fuzz/corpus/scene/every_key.yaml" | sort -u); do
    grep -qE "^\| .*\b$key\b" "$work/scene.md" || { echo "FAILED: no key $key in scene.md" >&2; exit 1; }
done
echo passed
