#!/bin/bash
# Tests the exit statuses of trocar-server --condense and the single message printed with each: 0 (saved), 2 (nothing to save, or an invalid option) and 1 (the
# file cannot be written). usage: test_condense.sh SERVER MESHES
set -euo pipefail
server=$1 meshes=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "FAILED: $*" >&2; cat "$work/said" >&2; exit 1; }

# Writes a scene with the keys of figure 8, this kind of inverse and this cache folder.
scene() {
    sed "s|^mesh:.*|mesh: $meshes/prostate-570.msh|" "$meshes/figure8.yaml"
    printf 'inverse: %s\nregion_of_interest: {corridor: {from: [0, 0, 0], to: [0, 0, 0.1], radius: 0.02}}\ncache: %s\n' "$1" "$2"
}
expect() { # STATUS WORDS ARGUMENT...
    local status=0
    "$server" --scene "$work/scene.yaml" --condense "${@:3}" >"$work/said" 2>&1 || status=$?
    [ "$status" = "$1" ] || fail "exit status $status, not $1"
    grep -q -- "$2" "$work/said" || fail "no \"$2\""
}

scene condensed "$work/cache" >"$work/scene.yaml"
expect 2 "--rate has no effect" --rate 500
expect 2 "--prepare has no effect" --prepare
[ ! -e "$work/cache" ] || fail "wrong options made an inverse"
expect 0 "written to $work/cache/"
expect 0 "read from $work/cache/"
[ "$(find "$work/cache" -type f | wc -l)" = 1 ] || fail "not one file"
scene dense "$work/cache" >"$work/scene.yaml"
expect 2 "set inverse: condensed"
scene condensed /proc/nowhere >"$work/scene.yaml"
expect 1 "cannot be written"
[ "$(wc -l <"$work/said")" = 1 ] || fail "more than one message"
