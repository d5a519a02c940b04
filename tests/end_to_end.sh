#!/bin/sh
# Server and device over LCM: the figure-8 motion, then each way to end.
# usage: end_to_end.sh SERVER DEVICE SCENE; in a private network namespace (scripts/netns).
set -eu

server=$1 device=$2 scene=$3
work=$(mktemp -d)
pid=
trap 'test -z "$pid" || kill -KILL "$pid" 2>/dev/null || true; rm -rf "$work"' EXIT

die() { echo "FAILED: $*"; cat "$work"/*.out 2>/dev/null || true; exit 1; }

# Value of a number in the device's report.
value() { sed -n "s/^ *\"$1\": *\([-+0-9.eE]*\),*\$/\1/p" "$work/report.json"; }

# Is the arithmetic condition true?
holds() { awk "BEGIN { exit !($1) }"; }

# Datagrams sent in this namespace so far.
sent() { awk '/^Udp: [0-9]/ { print $5 }' /proc/net/snmp; }

start_server() {
    : >"$work/server.out" # no "ready" of the server before
    "$server" --scene "$scene" --allow-non-rt "$@" >"$work/server.out" 2>&1 &
    pid=$!
    for _ in $(seq 100); do
        grep -q '^ready' "$work/server.out" && return
        kill -0 "$pid" 2>/dev/null || die "the server ended before it was ready"
        sleep 0.1
    done
    die "the server is not ready after 10 s"
}

# Sends SIGNAL (if not -) and expects exit status 0 within 5 s.
end_server() {
    if [ "$1" != - ]; then kill -"$1" "$pid"; fi
    for _ in $(seq 50); do
        kill -0 "$pid" 2>/dev/null || break
        sleep 0.1
    done
    ! kill -0 "$pid" 2>/dev/null || die "the server does not end after $1"
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
    holds "$(value wrenches_received) > 2000" || die "too few wrenches came"
    holds "$(value wrenches_lost) == 0" || die "wrenches were lost"
    holds "$(value round_trip_p50_s) < 1.2e-3" || die "round trip longer than a period and 0.2 ms"
fi

silent=$(sent)
start_server --rate 500
end_server INT
[ "$(sent)" -gt "$silent" ] || die "no datagram of a server that runs was seen"

# What is wrong is said, with exit status 2, before anything is sent.
refuses() {
    text=$1 status=0 before=$(sent)
    shift
    "$server" "$@" >"$work/bad.out" 2>&1 || status=$?
    [ "$status" = 2 ] || die "exit status $status, not 2: $*"
    [ "$(sent)" = "$before" ] || die "something was sent: $*"
    grep -qF -- "$text" "$work/bad.out" || die "no '$text' in: $(cat "$work/bad.out")"
}
refuses none.yaml --scene "$work/none.yaml"
refuses --scene
refuses nonsense:// --scene "$scene" --lcm-url nonsense://
sed "s|^rate_hz:|rat_hz:|" "$scene" >"$work/key.yaml"
refuses "key.yaml:$(grep -n rat_hz "$work/key.yaml" | cut -d: -f1): unknown key" --scene "$work/key.yaml"
head -c 20000 "${scene%/*}/prostate-570.msh" >"$work/cut.msh"
sed "s|^mesh:.*|mesh: cut.msh|" "$scene" >"$work/mesh.yaml"
refuses "cut.msh: Gmsh cannot read" --scene "$work/mesh.yaml"
case $("$server" --version) in 'trocar-server '[0-9]*) ;; *) die "--version" ;; esac
echo passed
