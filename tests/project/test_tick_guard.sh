#!/bin/bash
# Checks that the tick takes no longer than recorded, in multiples of a dgemm in the same run, and that the comparison fails if the tick does take longer.
# usage: test_tick_guard.sh TROCAR_BENCH SOURCE_DIR
set -euo pipefail
bench=$1 source=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$source"
compare() { scripts/compare_ticks "$bench" "$@" --spacing 0.0008; }

compare docs/results/tick/guard.json --ticks 300 --rounds 3 --limit 1.25

sed -E 's/("per_baseline": )([0-9.]+)/\10.001/' docs/results/tick/guard.json >"$work/faster.json"
status=0
compare "$work/faster.json" --ticks 20 --rounds 1 --limit 1.25 2>"$work/stderr" || status=$?
[ "$status" -eq 1 ] && grep -q 'times as long as before; at most 1.25 is allowed' "$work/stderr" || { echo "FAILED: a slow tick passes: status $status"; exit 1; }
echo '{}' >"$work/empty.json"
! compare "$work/empty.json" --ticks 20 --rounds 1 2>"$work/stderr" || { echo "FAILED: an empty record is accepted"; exit 1; }
grep -q 'not a recorded comparison' "$work/stderr"

# A record must contain a single scene and a single spacing.
fails() { # WHY COMMAND...
    local why=$1 status=0
    shift
    "$@" --ticks 20 --rounds 1 >/dev/null 2>"$work/stderr" || status=$?
    [ "$status" -eq 1 ] && grep -q "recorded with --scene meshes/figure8.yaml and --spacing 0.0008" "$work/stderr" || { echo "FAILED: $why: status $status"; exit 1; }
}
cp docs/results/tick/guard.json "$work/record.json"
fails 'compared at another spacing' scripts/compare_ticks "$bench" "$work/record.json" --spacing 0.001
fails 'compared with another scene' compare "$work/record.json" --scene meshes/prostate.yaml
fails 'another spacing beside the recorded one' scripts/compare_ticks "$bench" "$bench" --spacing 0.001 --record "$work/record.json"
fails "the scene's spacing beside another one" scripts/compare_ticks "$bench" "$bench" --record "$work/record.json"
cmp docs/results/tick/guard.json "$work/record.json"
sed -E 's/"(portable|avx512)"/"other_\1"/; s/0.0008/8e-4/' docs/results/tick/guard.json >"$work/record.json"
compare "$bench" --ticks 20 --rounds 1 --record "$work/record.json" >/dev/null
[ "$(grep -cE '^  "(portable|avx512|other_portable|other_avx512)"' "$work/record.json")" -eq 3 ] || { echo 'FAILED: rows of other kernels are not kept'; exit 1; }

# The wider kernels run if the processor has all the instructions that core/linalg/simd_wide.h requires.
python3 - <<'END'
import re
import runpy
kernels_for = runpy.run_path("scripts/compare_ticks")["kernels_for"]
with open("core/linalg/simd_wide.h", encoding="utf-8") as file:
    needed = re.findall(r'__builtin_cpu_supports\("(\w+)"\)', file.read())
assert len(needed) > 1
assert kernels_for("flags : fma " + " ".join(needed)) == "avx512"
for missing in needed:
    assert kernels_for("flags : fma " + " ".join(f for f in needed if f != missing)) == "portable", missing
END
