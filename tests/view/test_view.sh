#!/bin/bash
# Tests the complete viewer in a private network namespace: with a live server, with a log and pictures made from it, in the procedure mode of an implant,
# with a probe, with a trainee's task, with changes to the tissue, with ultrasound images, in other languages and by touch, or with the keyboard alone. Exit
# status 77: Chromium, npm or namespaces are not available. With OUT_DIR, screenshots are saved there.
# usage: test_view.sh BUILD_DIR SOURCE_DIR live|log|procedure|probe|task|tissue|ultrasound|language|keyboard [OUT_DIR]
set -euo pipefail
build=$1 source=$2 part=$3 out=${4:-}
if [ "${TROCAR_NAMESPACE:-}" != yes ]; then
    for needed in chromium npm; do
        command -v $needed >/dev/null || { echo "skipped: no $needed (scripts/setup chromium)"; exit 77; }
    done
    "$source/scripts/netns" true || exit 77
    TROCAR_NAMESPACE=yes exec "$source/scripts/netns" "$0" "$@"
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

fail() { echo "FAILED: $*" >&2; exit 1; }

TROCAR_PICTURES=$out node "$source/tests/view/${part}_test.mjs" "$build" "$source" "${out:-$work}"
[ "$part" = log ] || exit 0

# The picture that log_test.mjs saved without options is a PNG. With invalid options, the exit status is 2, a message is printed, and no file is written.
show=("$build/clients/view/trocar-view" --scene "$source/meshes/prostate.yaml" --log "$source/tests/traces/figure8.log")
taken=${out:-$work}/png-plain.png
head -c 8 "$taken" | od -An -tx1 | grep -q '89 50 4e 47 0d 0a 1a 0a' || fail "no PNG"
[ "$(stat -c %s "$taken")" -gt 20000 ] || fail "the picture is empty"

refuses() {
    local text=$1 status=0
    shift
    "$@" >"$work/said" 2>&1 || status=$?
    [ $status -eq 2 ] || fail "status $status, not 2: $*"
    grep -qF -- "$text" "$work/said" || fail "no '$text' in: $(cat "$work/said")"
}
refuses "--at 99 s is after the last pose" "${show[@]}" --png "$work/late.png" --at 99
head -c 50000 "$source/tests/traces/figure8.log" >"$work/cut.log"
refuses "the log is truncated; showing it up to there" "$build/clients/view/trocar-view" --scene "$source/meshes/prostate.yaml" --log "$work/cut.log" \
    --png "$work/late.png" --at 99
refuses "--png needs --log" "$build/clients/view/trocar-view" --scene x.yaml --png x.png
refuses "--at needs --png" "${show[@]}" --at 1
refuses "--plan needs a live server" "${show[@]}" --plan plan.csv
refuses "--plan: the scene has no template" "$build/clients/view/trocar-view" --scene "$source/meshes/prostate.yaml" --plan plan.csv
refuses "none.csv: cannot be opened" "$build/clients/view/trocar-view" --scene "$source/meshes/implant.yaml" --plan none.csv
refuses "--theme needs --png" "${show[@]}" --theme dark
for wrong in --size=10x10 --size=1600 --view=behind --cut=oblique --cut=axial:x --theme=blue; do
    refuses "${wrong%=*}" "${show[@]}" --png "$work/late.png" "$wrong"
done
refuses "does not cross the body, which extends from 0.0 to 100.0 mm" "${show[@]}" --png "$work/late.png" --cut axial:400
refuses none.yaml "$build/clients/view/trocar-view" --scene none.yaml
refuses "the page is not built" "${show[@]}" --page /nowhere
refuses /nowhere/x.png "${show[@]}" --png /nowhere/x.png
[ -z "$(find "$work" -name 'late*')" ] || fail "a failed picture left a file"
echo passed
