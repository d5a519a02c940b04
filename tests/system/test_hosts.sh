#!/bin/bash
# Runs server, device and monitor on three hosts (network namespaces connected by a switch) whose clocks differ by hours. The figure-8 motion must succeed and
# be monitored. Then the device's cable is briefly unplugged. Exit status 77: network namespaces are not permitted. usage: test_hosts.sh BUILD_DIR
# SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
url='udpm://239.255.76.67:7667?ttl=1'
cd "$work"

fail() { echo "FAILED: $*" >&2; cat server top report.json 2>/dev/null || true; exit 1; }

declare -A hosts    # from a host's name to the process that keeps its namespace alive
ip link add switch type bridge mcast_snooping 0
ip link set switch up

# Creates a host named $1 with address 10.0.0.$2, connected to the switch by the cable "to-$1". The route is the one docs/connect-a-device.md tells users to
# configure.
plug_in() {
    unshare --net sleep 1000 &
    hosts[$1]=$!
    until [ "$(readlink /proc/${hosts[$1]}/ns/net)" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.01; done
    ip link add "to-$1" type veth peer name lan netns "${hosts[$1]}"
    ip link set "to-$1" master switch up
    on "$1" ip address add "10.0.0.$2/24" dev lan
    on "$1" ip link set lan up
    on "$1" ip route add 239.255.76.67/32 dev lan
}

on() { nsenter --target "${hosts[$1]}" --net "${@:2}"; }

# Runs a command on host $1 with its wall clock offset by $2.
on_wrong() {
    on "$1" env LD_LIBRARY_PATH=/usr/lib/x86_64-linux-gnu/faketime LD_PRELOAD=libfaketime.so.1 FAKETIME="$2" \
        FAKETIME_DONT_FAKE_MONOTONIC=1 "${@:3}"
}

# Prints the number with this name from the device's report.
value() { sed -n "s/^ *\"$1\": *\([-+0-9.eE]*\),*\$/\1/p" report.json; }
holds() { awk "BEGIN { exit !($1) }" || fail "not: $1"; }

plug_in server 1
plug_in device 2
plug_in monitor 3
[ "$(on_wrong device +3h date +%s)" -gt $(($(date +%s) + 10000)) ] || fail "the device's clock is right"

nsenter --target "${hosts[server]}" --net "$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --lcm-url "$url" --allow-non-rt >server 2>&1 &
until grep -qx ready server; do kill -0 $! || fail "the server ended"; sleep 0.05; done
play() { on_wrong device "$1" "$build/clients/trocar-device" --lcm-url "$url" --realtime --report report.json >device || fail "$(cat device)"; }

play +3h
holds "$(value puncture_count) == 2"
holds "$(value wrenches_lost) == 0"
on_wrong monitor -5h "$build/clients/trocar-top" --lcm-url "$url" --once >top || fail "the monitor hears nothing"
grep -E 'poses +taken [0-9]{4}' top || fail "the monitor shows no poses"

# The cable is unplugged for 60 ms, which is longer than the wrench's hold time but shorter than the time after which the needle must be engaged again.
(sleep 1.5; ip link set to-device down; sleep 0.06; ip link set to-device up) &
play -1d
echo "lost: $(value wrenches_lost) wrenches; unanswered: $(value poses_unanswered) poses"
holds "$(value wrenches_lost) >= 40 && $(value wrenches_lost) < 400"
holds "$(value poses_unanswered) >= 40" # the lost ones, and any that arrived in the same tick as the next; the server counts the lost ones
on_wrong monitor -5h "$build/clients/trocar-top" --lcm-url "$url" --once >top || fail "the monitor hears nothing"
lost=$(sed -nE 's/.*, lost ([0-9]+),.*/\1/p' top)
holds "$lost >= 40 && $lost < 200"
holds "$(value puncture_count) == 2"
grep -qE '"flags": .*(stale|ramping)' report.json || fail "the server did not ramp the wrench"
echo passed
