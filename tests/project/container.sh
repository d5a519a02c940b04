#!/bin/bash
# Starts the container image with podman: with the published port of docs/getting-started.md, inserting a needle with the image's own trocar-device; in the host's
# network, with trocar-device on the host; and with a client that shares a secret, through the container's bridge. Each time, fetches the viewer's page, and stops
# the container. Ends with rows for docs/results/clients.csv: what it takes from nothing to a force. Run it by hand, as root, after `scripts/package image`; podman
# needs crun, or with cgroups v1 runc, and the CNI plugins: apt install podman crun containernetworking-plugins.
# usage: container.sh BUILD_DIR IMAGE [PODMAN_OPTION...]     BUILD_DIR has trocar-device and insertion; IMAGE is out/trocar-VERSION.oci.tar
set -euo pipefail
[ $# -ge 2 ] || { sed -n '2,7s/^# //p' "$0"; exit 2; }
source=$(cd "$(dirname "$0")/../.." && pwd)
[ -n "${TROCAR_INSIDE-}" ] || exec env TROCAR_INSIDE=1 "$source/scripts/netns" "$0" "$@"
build=$1 image=$2
shift 2
options=("$@")
work=$(mktemp -d)
fail() { echo "FAILED: $*" >&2; tail -n 20 "$work"/{said,device} >&2 || true; exit 1; }
now() { date +%s%N; }
seconds() { awk "BEGIN { printf \"%.1f\", 1e-9 * $1 }"; }
began=$(now)
name=$(podman load --quiet --input "$image" | sed 's/^Loaded image: //')
load_time=$(($(now) - began))
trap 'podman kill trocar-trial >/dev/null 2>&1 || true; rm -rf "$work"' EXIT

# start [OPTION...] -- [ARGUMENT...]: runs the container in the background and waits for server and page.
start() {
    local given=()
    while [ "$1" != -- ]; do given+=("$1"); shift; done
    shift
    began=$(now)
    podman run --rm --name trocar-trial "${given[@]}" "${options[@]}" "$name" "$@" >"$work/said" 2>&1 &
    run=$!
    until grep -qx ready "$work/said" && grep -q "^scene" "$work/said" && curl -sf -o "$work/page" http://127.0.0.1:8686/; do
        kill -0 $run 2>/dev/null || fail "the container has ended"
        [ $(($(now) - began)) -lt 60000000000 ] || fail "neither server nor page"
        sleep 0.1
    done
    page_time=$(($(now) - began))
    echo "server and page after $(seconds $page_time) s"
    grep "real time" "$work/said" || true
    grep -q "<script" "$work/page" || fail "no page"
}

stop() {
    podman stop --time 10 trocar-trial >/dev/null
    local status=0
    wait $run || status=$?
    [ $status -eq 0 ] || fail "status $status after SIGTERM"
    grep -E "^lateness" "$work/said"
}

# The three commands from an image to a force: podman load, podman run, podman exec.
start -p 127.0.0.1:8686:8686 --
run_to_page=$page_time
asked=$(now)
podman exec trocar-trial trocar-device --script insert --scene /usr/share/trocar/scenes/prostate.yaml --csv /tmp/wrenches.csv >"$work/device" 2>&1 || fail "the device"
ended=$(now)
podman exec trocar-trial cat /tmp/wrenches.csv >"$work/wrenches.csv"
after_force=$(awk -F, 'NR > 1 && !felt && $2 ^ 2 + $3 ^ 2 + $4 ^ 2 > 0 { felt = 1; first = $1 }
    END { if (!felt) exit 1; printf "%.0f", 1e9 * ($1 - first) }' "$work/wrenches.csv") || fail "no forces inside" # in ns, to the last wrench
exec_to_force=$((ended - asked - after_force)) # too long by what trocar-device does after its last wrench
stop

start --network host --
"$build/clients/trocar-device" --script insert --scene "$source/meshes/prostate.yaml" >"$work/device" 2>&1 || fail "the device"
grep -E "^(deepest|on the hand, z)" "$work/device" || fail "no forces"
stop

# The server reads a copy of the secret that belongs to its user in the container.
mkdir "$work/secret"
(umask 077; head -c 32 /dev/urandom | base64 >"$work/secret/ours"; cp "$work/secret/ours" "$work/secret/servers")
chown "$(podman run --rm --network none --entrypoint id "${options[@]}" "$name" -u)" "$work/secret/servers"
chmod 755 "$work" "$work/secret"
start -p 127.0.0.1:8686:8686 -p 127.0.0.1:7668:7668/udp -v "$work/secret:/secret:ro" -- /usr/share/trocar/scenes/figure8.yaml --listen 0.0.0.0:7668 \
    --secret-file /secret/servers
TROCAR_SECRET_FILE=$work/secret/ours "$build/tests/client_library/insertion" udp://127.0.0.1:7668 >"$work/device" 2>&1 || fail "the client"
awk '{ felt[$1] = $2 } END { print "published ports: " felt["answered"] " of " felt["periods"] " periods answered, deepest " 1e3 * felt["depth"] " mm, " felt["force"] " N"
    exit !(felt["depth"] > 0.01 && felt["force"] > 0.1) }' "$work/device" || fail "no forces over unicast"
stop
measured="$(date +%F), $(podman --version | sed 's/ version//'), tests/project/container.sh"
cat <<END
"image: commands from its file to a force (podman load, run, exec)",3,,"$measured"
"image: size of the file",$(du -m "$image" | cut -f1),MB,"$measured"
"image: podman load",$(seconds $load_time),s,"$measured"
"image: from podman run to the page",$(seconds $run_to_page),s,"$measured"
"image: from podman exec trocar-device to the first force, through 0.1 s of air",$(seconds $exec_to_force),s,"$measured"
"image: all three commands, to the first force",$(seconds $((load_time + run_to_page + exec_to_force))),s,"$measured"
END
echo passed
