#!/bin/bash
# Runs trocar-top with a server, in tmux and in a dumb terminal, and without a server. Exit status 77: network namespaces are not available. usage: test_top.sh
# BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
top=$build/clients/trocar-top
trap 'tmux -S "$work/tmux" kill-server 2>/dev/null || true; kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; cat screen once 2>/dev/null || true; exit 1; }
screen() { tmux -S tmux capture-pane -p >screen; }

# Waits up to 10 s for a line on the screen that matches this pattern.
appears() {
    for _ in $(seq 100); do
        screen
        ! grep -qE "$1" screen || return 0
        sleep 0.1
    done
    fail "no '$1' on the screen"
}

status=0
"$top" --once --wait 0.2 >once || status=$?
[ $status -eq 1 ] && grep -q '^! no server was heard' once || fail "status $status without a server"

"$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt >server 2>&1 &
until grep -qx ready server; do kill -0 $! || fail "$(cat server)"; sleep 0.05; done
"$build/clients/trocar-device" --script again --duration 60 >device &
device=$!

tmux -S tmux -f /dev/null new-session -d -x 80 -y 24 "'$top'; echo ended; sleep 60"
appears '^needle +of session [0-9]+, [1-9][0-9]* contacts'
appears '^lateness +[0-9.]+ (u|m)s +[0-9.]+ (u|m)s'
appears '^round trip +[1-9][0-9.]* [um]s'
appears '^\|.*#.*\|.*#'
first=$(sed -n 's/.* tick //p' screen)
sleep 0.5
screen
[ "$(sed -n 's/.* tick //p' screen)" -gt "$first" ] || fail "the screen is not updated"
tmux -S tmux resize-window -x 60 -y 10
appears '^stage, us '
kill $device
appears '^needle +free'
tmux -S tmux send-keys q
appears '^ended'

TERM=dumb "$top" --once >once || fail "--once: status $?"
grep -qE '^  lateness +[0-9.]+ [um]s' once || fail "no lateness"
TERM=dumb timeout 1.5 script -qec "'$top'" /dev/null >once </dev/null || [ $? -eq 124 ] || fail "dumb terminal"
grep -qE '^  lateness +[0-9.]+ [um]s' once && ! grep -q $'\e' once || fail "escape sequences in a dumb terminal"

# Here, no program receives the datagrams.
tmux -S tmux kill-server
tmux -S tmux -f /dev/null new-session -d -x 80 -y 24 "'$top' --udp-json '[::1]:9'; echo ended; sleep 60"
appears '^udp json +\[::1\]:9: no program listens there'
appears '^lateness +[0-9.]+ (u|m)s'
echo passed
