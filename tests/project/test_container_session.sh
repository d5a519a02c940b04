#!/bin/bash
# Starts trocar-session, the container's command, with each of the rights that real time needs, and with both: the server must run, and the session must say which
# options the container lacks. Only in a network of its own may the viewer listen on all addresses. A script stands in for the viewer.
# usage: test_container_session.sh BUILD_DIR SOURCE_DIR      exit status 77: without root's capabilities, there is nothing to take away
set -euo pipefail
build=$1 source=$2
setpriv --bounding-set -all,+sys_nice,+ipc_lock chrt --fifo 80 true 2>/dev/null || { echo "skipped: needs root, with SYS_NICE and IPC_LOCK"; exit 77; }
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
cd "$work"
fail() { echo "FAILED: $*: $(cat said)" >&2; exit 1; }
mkdir bin
ln -s "$build/server/trocar-server" bin
printf '#!/bin/sh\necho "viewer: $*"\nexec sleep 100\n' >bin/trocar-view
chmod +x bin/trocar-view
export PATH=$work/bin:$PATH

# session CAPABILITIES REAL_TIME: REAL_TIME is what the server must say about real time
session() {
    setpriv --bounding-set "-all$1" "$source/scripts/packaging/image/trocar-session" "$source/meshes/figure8.yaml" --lcm-url memq:// >said 2>&1 &
    until grep -qx ready said; do kill -0 $! 2>/dev/null || fail "the session has ended"; sleep 0.05; done
    kill $!
    wait $! || fail "status $?"
    grep -q "^real time  $2" said || fail "not: $2"
}
lacks() { grep -q -- "--cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1" said; }
ulimit -r 0 -l 64
session ,+sys_nice "NO: cannot lock memory"
lacks || fail "no advice about memory"
session ,+ipc_lock "NO: cannot use SCHED_FIFO"
lacks || fail "no advice about priority"
session ,+sys_nice,+ipc_lock yes
! lacks || fail "advice without need"
# binds ADDRESS [COMMAND...]: the address that the viewer must listen on if COMMAND starts the session
binds() {
    local address=$1
    shift
    "$@" "$source/scripts/packaging/image/trocar-session" "$source/meshes/figure8.yaml" --lcm-url memq:// >said 2>&1 &
    until grep -q "^viewer:" said && grep -qx ready said; do kill -0 $! 2>/dev/null || fail "the session has ended"; sleep 0.05; done
    kill $!
    wait $! || fail "status $?"
    grep -q -- "--bind $address\$" said || fail "the viewer does not listen on $address"
}
binds 0.0.0.0 unshare --net
binds 192.0.2.1 env TROCAR_VIEW_BIND=192.0.2.1
# Process 2 is the kernel's thread manager unless the test itself runs in a container.
[ "$(cat /proc/2/comm 2>/dev/null)" != kthreadd ] || [ "$(readlink /proc/1/ns/net)" != "$(readlink /proc/self/ns/net)" ] || binds 127.0.0.1

for page in getting-started real-time; do # the pages name the same options
    grep -q -- "--cap-add SYS_NICE --ulimit rtprio=99 --ulimit memlock=-1" "$source/docs/$page.md" || fail "$page.md names other options"
done
echo passed
