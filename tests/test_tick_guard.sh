#!/bin/bash
# The tick takes no longer than recorded, in multiples of a dgemm in the same run; and the comparison notices if it does.
# usage: test_tick_guard.sh TROCAR_BENCH SOURCE_DIR
set -euo pipefail
bench=$1 source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$source"
compare() { scripts/compare_ticks "$bench" "$@" --spacing 0.0008; }

compare docs/results/tick-guard.json --ticks 300 --rounds 3 --limit 1.25

sed -E 's/("per_baseline": )([0-9.]+)/\10.001/' docs/results/tick-guard.json >"$work/faster.json"
status=0
compare "$work/faster.json" --ticks 20 --rounds 1 --limit 1.25 2>"$work/stderr" || status=$?
[ "$status" -eq 1 ] && grep -q 'times as long as before; at most 1.25 is allowed' "$work/stderr" || { echo "FAILED: a slow tick passes: status $status"; exit 1; }
echo '{}' >"$work/empty.json"
! compare "$work/empty.json" --ticks 20 --rounds 1 2>"$work/stderr" || { echo "FAILED: an empty record is accepted"; exit 1; }
grep -q 'not a recorded comparison' "$work/stderr"
