#!/bin/bash
# Another machine (a network namespace at the other end of a cable) sends datagrams to a server with LCM's default URL (ttl=0). They must have no effect, and
# the server must report that it drops them. With ttl=1, that machine may move the needle, but may shut the server down only while it holds a needle. Exit
# status 77: network namespaces are not permitted. usage: test_other_machine.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"
cd "$work"
here=10.0.0.1 there=10.0.0.2
url='udpm://239.255.76.67:7667?ttl=1'

fail() { echo "FAILED: $*" >&2; tail -n 8 server device; head -n 30 top 2>/dev/null || true; exit 1; }

lcm-gen -p --ppath types "$source/lcmtypes/trocar.lcm"

# The cable joins the two machines' interfaces, both named `lan`. This machine has the usual network configuration, in which multicast goes out over the cable.
unshare --net sleep 1000 &
other=$!
until [ "$(readlink /proc/$other/ns/net)" != "$(readlink /proc/self/ns/net)" ]; do sleep 0.01; done
ip link add lan type veth peer name lan netns $other
ip address add $here/24 dev lan
ip link set lan up
ip route replace 239.255.76.67/32 dev lan
there() { nsenter --target $other --net "$@"; }
there ip address add $there/24 dev lan
there ip link set lo up
there ip link set lan up
there ip route add 239.255.76.67/32 dev lan

stranger() { there /usr/bin/python3 "$source/tests/system/stranger.py" types $here "$@"; }

start_server() {
    : >server
    "$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt "$@" >server 2>&1 &
    server=$!
    until grep -qx ready server; do kill -0 $server || fail "no server"; sleep 0.05; done
}
alive() { kill -0 $server 2>/dev/null || fail "the server has ended: $1"; }
top() { "$build/clients/trocar-top" --once "$@" >top || fail "no server for top"; }
shows() { grep -qE "$1" top || fail "top does not show '$1'"; }

# ---- ttl=0 ----
start_server
stranger poses 5
top
shows 'poses +taken 0'
for session in 0 1 5; do stranger shutdown $session; done
stranger forged $here       # the kernel drops packets from outside that claim to come from this machine
stranger forged 127.0.0.1
there ping -c 1 -W 1 $here >ping 2>&1 || true
there env LCM_DEFAULT_URL="$url" "$build/clients/trocar-device" --script insert --wait 1 >device 2>&1 && fail "another machine has got a wrench"
sleep 0.2
alive "a packet of another machine ended it"
top
shows 'poses +taken 0'
grep -q "another machine ($there)" server || fail "the server does not say that it drops packets"
grep -q "another machine ($there)" top || fail "the status does not say so"

# Meanwhile, this machine's own clients work as if the other machine were not there.
stranger flood 8 & flood=$!
"$build/clients/trocar-device" --script insert --speed 2 --csv device.csv >device 2>&1 || fail "the device failed"
grep -qE '^punctures +2' device || fail "the device did not feel both punctures"
kill $flood 2>/dev/null || true
alive "a flood ended it"
"$build/clients/trocar-top" --once >top
/usr/bin/python3 "$source/tests/system/stranger.py" types 127.0.0.1 shutdown 1 # this machine may
wait $server || fail "status $? after a SHUTDOWN of this machine"
distant=$(sed -nE 's/^packets .* ([0-9]+) of other machines dropped.*/\1/p' server)
[ "$distant" -ge 1500 ] || fail "$distant packets of other machines counted"

# ---- ttl=1 ----
start_server --lcm-url "$url"
stranger shutdown 0
stranger shutdown 9
stranger poses 5 & poses=$!
for _ in $(seq 20); do
    alive "another machine has shut it down without a needle"
    top --lcm-url "$url"
    if grep -q 'of session 5,' top; then break; fi
done
shows 'of session 5,'
shows 'on another machine and holds no needle'
stranger shutdown 9
sleep 0.2
alive "a session without a needle has shut it down"
stranger shutdown 5
for _ in $(seq 50); do kill -0 $server 2>/dev/null || break; sleep 0.1; done
! kill -0 $server 2>/dev/null || fail "the owner cannot shut it down"
wait $server || fail "status $? after a SHUTDOWN of the owner"
wait $poses || true
echo passed
