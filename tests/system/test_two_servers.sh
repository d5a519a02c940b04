#!/bin/bash
# Tests that, with two servers on one URL, both servers and all clients report the conflict, and the device renders the wrenches of only one server, until that
# server ends.
# Exit status 77: network namespaces are not permitted. usage: test_two_servers.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
cd "$work"

fail() { echo "FAILED: $*" >&2; tail -n 20 first second device top 2>/dev/null || true; exit 1; }
touch first second

# Starts server $1 with its own scene file. $! is its process id.
start() {
    sed "s|^mesh: *|mesh: $source/meshes/|" "$source/meshes/figure8.yaml" >"$1.yaml"
    "$build/server/trocar-server" --scene "$1.yaml" --allow-non-rt >"$1" 2>&1 &
    until grep -qx ready "$1"; do kill -0 $! || fail "no server"; sleep 0.05; done
}
number_of() { sed -n 's/^server *//p' "$1"; }

start first
one=$!
start second
two=$!
"$build/clients/trocar-device" --script figure8 --report report.json --csv forces >device 2>&1 || fail "the device: status $?"
"$build/clients/trocar-top" --once >top || fail "no server for top"

for pair in "first second" "second first"; do
    read -r here other <<<"$pair"
    grep -qE "two servers on this LCM URL.*scene $other.yaml, number $(number_of $other)" $here || fail "the $here server does not name the other"
done
grep -qE "following ($(number_of first), not $(number_of second)|$(number_of second), not $(number_of first));" device ||
    fail "the device does not name both"
grep -qE '^! two servers' top || fail "top does not report two servers"
grep -qE "^! last fault +two servers" top || fail "top does not show the server's message"
grep -q '"puncture_count": 2' report.json || fail "not 2 punctures: $(grep count report.json)"
grep -q '"wrenches_lost": 0' report.json || fail "wrenches were lost: $(grep lost report.json)"
grep -qE '"wrenches_of_other_servers": [1-9]' report.json || fail "no wrench of the other server was ignored"

# When one server exits, the clients follow the other, which stops reporting that there are two.
"$build/clients/trocar-device" --script figure8 --report report.json >device 2>&1 & device=$!
sleep 1
kill $one
wait $device || fail "the device: status $?"
[ "$(sed -n 's/.*"wrenches_received": \([0-9]*\),/\1/p' report.json)" -gt 2000 ] || fail "the other server is not followed: $(grep received report.json)"
sleep 1.2
"$build/clients/trocar-top" --once >top || fail "no server for top"
! grep -q 'two servers' top || fail "two servers are still reported"
kill $two
echo passed
