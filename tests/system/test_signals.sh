#!/bin/bash
# Tests that every signal that would terminate a program makes the server exit with a ramp, so that the hand never feels the force vanish in one step. Exit
# status 77: network
# namespaces are not permitted. usage: test_signals.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
cd "$work"

fail() { echo "FAILED: $*" >&2; tail -n 5 server device 2>/dev/null || true; exit 1; }

start_server() {
    : >server
    "$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt >server 2>&1 &
    server=$!
    until grep -qx ready server; do kill -0 $server || fail "no server"; sleep 0.05; done
}

push() { "$build/clients/trocar-device" --script insert --speed 0.5 --realtime --csv "$1.csv" >device 2>&1 & device=$!; }

# Checks that the wrenches in $1.csv end at zero and that the needle was in the tissue before that. In no tick of the last 200 ms, 100 ms of which are the ramp,
# may the force drop by more than a fifth, which allows for a puncture.
ends_by_a_ramp() {
    awk -F, -v name="$1" 'NR == 1 { next }
        { force[++n] = sqrt($2 * $2 + $3 * $3 + $4 * $4); tick[n] = $(NF - 4) }
        END { for (i = n > 200 ? n - 200 : 2; i <= n; i++) {
                  if (force[i] > most) most = force[i]
                  fall = (force[i - 1] - force[i]) / (tick[i] - tick[i - 1])
                  if (fall > largest) largest = fall }
              printf "SIG%s: %.2f N, largest step %.4f N, last %.4f N\n", name, most, largest, force[n]
              exit !(most > 0.2 && largest < most / 5 && force[n] == 0) }' "$1.csv" || fail "the force does not end by a ramp after SIG$1"
}

for signal in HUP INT QUIT TERM USR1 USR2 ALRM VTALRM PROF IO PWR XCPU; do
    start_server
    push $signal
    for _ in $(seq 50); do # until the shaft is in the tissue
        "$build/clients/trocar-top" --once >top || fail "no server for top"
        if grep -qE ', [2-9] contacts|, 1[0-9] contacts' top; then break; fi
    done
    kill -$signal $server
    status=0
    wait $server || status=$?
    [ $status -eq 0 ] || fail "status $status after SIG$signal"
    sleep 0.2 # lets the device receive the last wrenches
    kill $device 2>/dev/null || true
    wait $device || true
    ends_by_a_ramp $signal
done

# The server keeps running if nobody reads its output, or if it was started with nohup and its terminal is closed.
start_server
kill -PIPE $server
kill -XFSZ $server
sleep 0.2
kill -0 $server || fail "SIGPIPE has ended it"
kill $server
wait $server || fail "status $?"
(trap '' HUP; exec "$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt) >server 2>&1 &
server=$!
until grep -qx ready server; do kill -0 $server || fail "no server"; sleep 0.05; done
kill -HUP $server
sleep 0.2
kill -0 $server || fail "SIGHUP has ended it although it is to be ignored"
kill $server
wait $server || fail "status $?"
echo passed
