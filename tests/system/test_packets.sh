#!/bin/bash
# Sends crafted packets and a stream of fuzzed fragments to server, device, bridge, monitor and viewer: all of them must survive and keep working. Exit status
# 77: network namespaces are not permitted. usage: test_packets.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
cd "$work"
touch server view # may be read before their programs have started

fail() { echo "FAILED: $*" >&2; tail -n 5 server device top view report.json 2>/dev/null || true; exit 1; }
declare -A programs # name: process

"$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt >server 2>&1 & programs[server]=$!
until grep -qx ready server; do kill -0 $! || fail "no server"; sleep 0.05; done
"$build/clients/trocar-device" --script figure8 --duration 6 --report report.json >device 2>&1 & programs[device]=$!
until "$build/clients/trocar-top" --once 2>/dev/null | grep "of session" >owner; do # the device, not the bridge, owns the needle
    kill -0 ${programs[device]} || fail "the device did not start"
done
"$build/clients/bridge" >bridge 2>&1 & programs[bridge]=$!
TERM=dumb "$build/clients/trocar-top" --plain >top 2>&1 & programs[top]=$!
mkdir page && touch page/index.html
"$build/clients/view/trocar-view" --scene "$source/meshes/figure8.yaml" --socket "$work/browsers" --page "$work/page" >view 2>&1 & programs[view]=$!
until grep -qx ready view; do kill -0 $! || fail "no viewer"; sleep 0.05; done
for name in "${!programs[@]}"; do
    kill -0 ${programs[$name]} || fail "$name did not start"
done

/usr/bin/python3 "$source/tests/system/crafted_packets.py" 2
dead=
for name in "${!programs[@]}"; do
    kill -0 ${programs[$name]} 2>/dev/null || dead+=" $name"
done
[ -z "$dead" ] || fail "dead:$dead"
wait ${programs[device]} || fail "the device: status $?"
grep -q '"puncture_count": [2-9]' report.json || fail "the device did not feel both punctures"
rm -f top # makes sure that the page read next is a new one
"$build/clients/trocar-top" --once >top || fail "the server is silent"
/usr/bin/python3 - <<'END_OF_REQUEST' || fail "the viewer does not answer"
import socket
browser = socket.socket(socket.AF_UNIX)
browser.settimeout(5)
browser.connect("browsers")
browser.sendall(b"GET / HTTP/1.0\r\nHost: localhost\r\n\r\n")
assert b" 200 " in browser.recv(100)
END_OF_REQUEST
for name in server bridge top view; do
    kill ${programs[$name]}
    status=0
    wait ${programs[$name]} || status=$?
    [ $status -eq 0 ] || [ $status -eq 143 ] || fail "$name ended with status $status"
done
echo passed
