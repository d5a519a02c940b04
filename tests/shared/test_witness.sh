#!/bin/sh
# Tests the witness: a failure on a stalled machine does not count, a sanitizer's report is detected wherever it appears in the output, and a process left in
# the background does not delay the witness.
# usage: test_witness.sh WITNESS
set -eu
witness=$1

# ends_with STATUS [OPTION...] COMMAND: runs the command in a shell under the witness and checks its exit status.
ends_with() {
    wanted=$1 status=0 options=
    shift
    while [ $# -gt 1 ]; do options="$options $1"; shift; done
    timeout 20 "$witness" $options sh -c "$1" >/dev/null 2>&1 || status=$?
    [ $status = "$wanted" ] || { echo "FAILED: status $status, not $wanted:$options $1"; exit 1; }
}

report='echo "WARNING: ThreadSanitizer: data race"'
ends_with 0 'exit 0'
export TROCAR_WITNESS_STALLED=yes
ends_with 77 'echo "0 is not 1"; exit 1'
unset TROCAR_WITNESS_STALLED
if chrt -f 98 true 2>/dev/null; then # every wake-up is later than zero, so all of them count
    ends_with 77 --tolerates 0 'sleep 0.1; exit 1'
fi
ends_with 77 'exit 77'
ends_with 137 'kill -KILL $$'
ends_with 0 'sleep 60 &'
ends_with 0 'yes &'
ends_with 0 --reports 'exit 1'
ends_with 77 --reports 'exit 77'
ends_with 127 --reports no-such-program
ends_with 137 --reports 'kill -KILL $$'
ends_with 1 --reports "$report"
ends_with 1 --reports "$report & wait; yes &"
ends_with 66 --reports "$report >&2; exit 66"
ends_with 1 --reports 'head -c 100000 /dev/zero; printf "x: ThreadSanit"; sleep 0.1; printf "izer: x"; head -c 100000 /dev/zero'
echo passed
