#!/bin/bash
# Starts the container image with podman in a network of its own, fetches the viewer's page, inserts a needle with trocar-device, and stops the container. Run it by
# hand, as root, after `scripts/package image`. usage: container.sh BUILD_DIR IMAGE [PODMAN_OPTION...]     BUILD_DIR has trocar-device; IMAGE is out/trocar-VERSION.oci.tar
set -euo pipefail
[ $# -ge 2 ] || { sed -n '2,3s/^# //p' "$0"; exit 2; }
source=$(cd "$(dirname "$0")/../.." && pwd)
[ -n "${TROCAR_INSIDE-}" ] || exec env TROCAR_INSIDE=1 "$source/scripts/netns" "$0" "$@"
build=$1 image=$2
shift 2
work=$(mktemp -d)
fail() { echo "FAILED: $*" >&2; cat "$work"/* >&2; exit 1; }
name=$(podman load --quiet --input "$image" | sed 's/^Loaded image: //')
began=$(date +%s%N)
podman run --rm --name trocar-trial --network host "$@" "$name" >"$work/said" 2>&1 &
run=$!
trap 'podman kill trocar-trial >/dev/null 2>&1 || true; rm -rf "$work"' EXIT
until grep -qx ready "$work/said" && grep -q "^scene" "$work/said" && curl -sf -o "$work/page" http://127.0.0.1:8686/; do
    kill -0 $run 2>/dev/null || fail "the container has ended"
    [ $(($(date +%s%N) - began)) -lt 60000000000 ] || fail "neither server nor page"
    sleep 0.1
done
echo "server and page after $((($(date +%s%N) - began) / 1000000)) ms"
grep "real time" "$work/said" || true
grep -q "<script" "$work/page" || fail "no page"
"$build/clients/trocar-device" --script insert --scene "$source/meshes/prostate.yaml" >"$work/device" 2>&1 || fail "the device"
grep -E "^(deepest|on the hand, z)" "$work/device" || fail "no forces"
podman stop --time 10 trocar-trial >/dev/null
status=0
wait $run || status=$?
[ $status -eq 0 ] || fail "status $status after SIGTERM"
grep -E "^lateness" "$work/said"
echo passed
