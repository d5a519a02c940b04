#!/bin/bash
# Two devices hold the two needles of a scene, 60 mm apart. Tests that each device feels its own needle, that no other client is given a needle, and that, if
# one device dies, only its needle's force decreases along a ramp. Exit status 77: network namespaces are not permitted. usage: test_two_needles.sh BUILD_DIR
# SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
cd "$work"

fail() { echo "FAILED: $*" >&2; tail -n 20 server device* top 2>/dev/null || true; exit 1; }

sed "s|^mesh: *|mesh: $source/meshes/|" "$source/meshes/figure8.yaml" >pair.yaml
echo 'needles: 2' >>pair.yaml
LD_PRELOAD="$build/tests/liballocator_calls.so" "$build/server/trocar-server" --scene pair.yaml --allow-non-rt >server 2>&1 &
until grep -qx ready server; do kill -0 $! || fail "no server"; sleep 0.05; done
server=$!
grep -q '^needles    2' server || fail "the server does not say how many needles it has"

# Inserts needle $1 and records its wrenches in NAME.csv.
hold() {
    local x=(-0.03 0.03 0) needle=$1 name=$2
    shift 2
    exec "$build/clients/trocar-device" --script insert --speed 2 --needle "$needle" --start "${x[$needle]},0.003,-0.201" --realtime \
        --csv "$name.csv" "$@" >"device-$name" 2>&1
}
top() { "$build/clients/trocar-top" --once >top || fail "no server for top"; }
shows() { grep -qE "$1" top || fail "top does not show '$1'"; }

# A device that asks for an unavailable needle gets no answer and prints a message that names the needle.
refused() {
    local status=0
    (hold "$@" --wait 0.4) || status=$?
    [ $status -eq 1 ] || fail "status $status, not 1: needle $1"
    grep -q "no answer within 0.4 s for needle $1" "device-$2" || fail "the device does not say why"
}

(hold 0 alone-0) || fail "needle 0 alone"
(hold 1 alone-1) || fail "needle 1 alone"
(hold 0 first) & first=$!
(hold 1 second) & second=$!
sleep 0.3
refused 0 third
top
shows "^! last fault .* refused for needle 0: (another session|session [0-9]+) holds the needle"
shows "^. needle 0 +of session"
shows "^. needle 1 +of session"
refused 2 fourth
top
shows "^! last fault .* of session [0-9]+ refused for needle 2: the scene's .needles. is 2, counted from 0"
wait $first || fail "needle 0"
wait $second || fail "needle 1"

# Prints the mean axial force while the base rests half-way, from 0.75 s to 0.8 s. The other needle contributes less than a tenth of it (see
# tests/public/test_needles.c).
force() {
    awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) { split($i, name, " "); column[name[1]] = i } next }
             $column["needle"] != needle { exit 2 }
             $1 > 0.75 && $1 < 0.8 { rows++; sum += $column["fz"] }
             END { if (rows < 20) exit 3; print sum / rows }' needle="$2" "$1.csv" || fail "$1.csv"
}
for needle in 0 1; do
    both=(first second)
    alone=$(force "alone-$needle" $needle) both=$(force "${both[$needle]}" $needle)
    echo "needle $needle: $both N, alone $alone N"
    awk "BEGIN { exit !($alone < -0.2 && ($both - $alone) ^ 2 < (0.1 * $alone) ^ 2) }" || fail "needle $needle does not feel what it feels alone"
done
# A device is killed. Its needle becomes stale and loses its force; the other needle is not affected.
(hold 0 survivor) & first=$!
(hold 1 killed --duration 20) & second=$!
sleep 0.9
kill -KILL $second
sleep 0.3
top
shows "^. needle 0 +of session [0-9]+, [0-9]+ contacts(, not_realtime)?$"
shows "^! needle 1 +of session [0-9]+, [0-9]+ contacts, stale"
wait $first || fail "needle 0 after the other device's death"
both=$(force survivor 0) alone=$(force alone-0 0)
awk "BEGIN { exit !(($both - $alone) ^ 2 < (0.1 * $alone) ^ 2) }" || fail "needle 0 is disturbed: $both N, alone $alone N"
awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) if ($i == "flags") column = i; next } $column % 2 { exit 1 }' survivor.csv || fail "needle 0 was stale"

kill $server
wait $server || fail "the server's status is $?"
grep -q '^loop       0 allocations' server || fail "the loop allocated: $(grep ^loop server)"
echo passed
