#!/bin/sh
# Runs a server and a device over LCM: first the figure-8 motion, then every way of stopping the server. usage: end_to_end.sh SERVER DEVICE SCENE     (in a
# private network namespace: scripts/netns)
set -eu

server=$1 device=$2 scene=$3
work=$(mktemp -d)
pid=
trap 'test -z "$pid" || kill -KILL "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

die() { echo "FAILED: $*"; cat "$work"/*.out 2>/dev/null || true; exit 1; }

# Prints the number with this name from the device's report.
value() { sed -n "s/^ *\"$1\": *\([-+0-9.eE]*\),*\$/\1/p" "$work/report.json"; }

# Succeeds if the arithmetic condition is true.
holds() { awk "BEGIN { exit !($1) }"; }

# Prints the number of datagrams sent in this namespace so far.
sent() { awk '/^Udp: [0-9]/ { print $5 }' /proc/net/snmp; }

start_server() {
    : >"$work/server.out" # clears any earlier "ready"
    "$server" --scene "$scene" --allow-non-rt "$@" >"$work/server.out" 2>&1 &
    pid=$!
    for _ in $(seq 100); do
        grep -q '^ready' "$work/server.out" && return
        kill -0 "$pid" 2>/dev/null || die "the server ended before it was ready"
        sleep 0.1
    done
    die "the server is not ready after 10 s"
}

# Sends SIGNAL (unless it is -) to the server and checks that it exits with status 0 within 5 s.
end_server() {
    if [ "$1" != - ]; then kill -"$1" "$pid"; fi
    for _ in $(seq 50); do
        kill -0 "$pid" 2>/dev/null || break
        sleep 0.1
    done
    ! kill -0 "$pid" 2>/dev/null || die "the server does not stop on $1"
    status=0
    wait "$pid" || status=$?
    pid=
    [ "$status" = 0 ] || die "exit status $status after $1"
}

start_server
"$device" --script figure8 --realtime --report "$work/report.json" >"$work/device.out" 2>&1 || die "the device failed"
end_server TERM
cat "$work/device.out" "$work/server.out"

holds "$(value puncture_count) == 2" || die "skin and capsule were not both punctured"
if [ "${TROCAR_CHECK_TIMING:-yes}" = yes ]; then
    holds "$(value poses_sent) > 2000" || die "the device sent too few poses"
    holds "$(value wrenches_received) > 2000" || die "too few wrenches were received"
    holds "$(value wrenches_lost) == 0" || die "wrenches were lost"
    holds "$(value round_trip_p50_s) < 1.2e-3" || die "the round trip is longer than a period plus 0.2 ms"
fi

silent=$(sent)
start_server --rate 500
end_server INT
[ "$(sent)" -gt "$silent" ] || die "the running server sent no datagram"

# Checks that the command exits with this status and message, and sends no datagrams.
ends_with() {
    wanted=$1 text=$2 status=0 before=$(sent)
    shift 2
    "$@" >"$work/bad.out" 2>&1 || status=$?
    [ "$status" = "$wanted" ] || die "exit status $status, not $wanted: $*: $(cat "$work/bad.out")"
    [ "$(sent)" = "$before" ] || die "datagrams were sent by: $*"
    grep -qF -- "$text" "$work/bad.out" || die "no '$text' in: $(cat "$work/bad.out")"
}
refuses() {
    text=$1
    shift
    ends_with 2 "$text" "$server" --allow-non-rt "$@"
}
refuses none.yaml --scene "$work/none.yaml"
refuses --scene
refuses nonsense:// --scene "$scene" --lcm-url nonsense://
sed "s|^rate_hz:|rat_hz:|" "$scene" >"$work/key.yaml"
refuses "key.yaml:$(grep -n rat_hz "$work/key.yaml" | cut -d: -f1): unknown key" --scene "$work/key.yaml"
head -c 20000 "${scene%/*}/prostate-570.msh" >"$work/cut.msh"
sed "s|^mesh:.*|mesh: cut.msh|" "$scene" >"$work/mesh.yaml"
refuses "the file ends inside \$" --scene "$work/mesh.yaml"

# If real-time priorities are not permitted, the supervisor does not restart the server. As a service with raised limits but no capabilities, the server runs in
# real time, provided this machine permits raising the limits.
without="setpriv --bounding-set -sys_nice,-ipc_lock"
ends_with 4 "Raise the limit" timeout 10 "$(dirname "$0")/../../scripts/keep_alive" prlimit --rtprio=0 --memlock=65536 $without "$server" --scene "$scene"
[ "$(grep -c "Raise the limit" "$work/bad.out")" = 1 ] || die "the server was restarted: $(cat "$work/bad.out")"
as_service="prlimit --rtprio=80 --memlock=unlimited"
if [ "$(id -u)" = 0 ] && $as_service true 2>/dev/null; then
    $as_service $without "$server" --scene "$scene" >"$work/server.out" 2>&1 &
    pid=$!
    for _ in $(seq 100); do
        if grep -q '^ready' "$work/server.out" || ! kill -0 "$pid" 2>/dev/null; then break; fi
        sleep 0.1
    done
    end_server TERM
    grep -q '^real time  yes' "$work/server.out" || die "no real time as a service"
fi
case $("$server" --version) in 'trocar-server '[0-9]*) ;; *) die "--version" ;; esac
echo passed
