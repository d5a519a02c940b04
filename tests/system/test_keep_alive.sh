#!/bin/bash
# Tests that exit statuses 0, 2 and 4, and a stop signal from outside, are final. After any other status, the command is restarted, without a busy loop. usage:
# test_keep_alive.sh
# KEEP_ALIVE
set -euo pipefail
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }

# Makes the command end in each of these ways, one after another. The last, `never`, must not be reached.
ends_after() {
    local wanted=$1 status=0
    printf '%s\n' "${@:2}" >ends
    timeout 10 "$keep_alive" sh -c 'read -r how <ends; sed -i 1d ends; eval "$how"' 2>said || status=$?
    [ "$status" = "$wanted" ] || fail "status $status, not $wanted, after: ${*:2}"
    [ "$(cat ends)" = "never" ] || fail "left of $*: $(cat ends)"
}
keep_alive=$1
ends_after 0 'exit 1' 'kill -KILL $$' 'exit 0' never
grep -q 'status 137' said || fail "the kill is not reported: $(cat said)"
ends_after 2 'exit 1' 'kill -SEGV $$' 'exit 2' never
ends_after 4 'exit 1' 'exit 4' never

"$keep_alive" sh -c 'echo >>runs; exit 1' 2>/dev/null &
sleep 1
kill -TERM $!
wait $! || fail "status $? after SIGTERM"
[ "$(wc -l <runs)" -ge 2 ] && [ "$(wc -l <runs)" -le 12 ] || fail "$(wc -l <runs) starts in a second"
echo passed
