#!/bin/bash
# Runs scripts/demo as a new user might, in a folder whose name has a space. Exit status 77: network namespaces are not permitted. usage: test_demo.sh BUILD_DIR
# SOURCE_DIR
set -euo pipefail
build=$1 source=$2
"$source/scripts/netns" true || exit 77
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

# Creates a source tree with the demo and prebuilt programs.
mkdir "$work/a tree"
cd "$work/a tree"
cp -r "$source/scripts" scripts
printf '#!/bin/sh\n' | tee scripts/setup >scripts/build
ln -s "$source/meshes" meshes
ln -s "$source/docs" docs
ln -s "$source/lcmtypes" lcmtypes
ln -s "$build" build

says() { grep -qF -- "$1" "$work/said" || fail "no '$1' in: $(cat "$work/said")"; }

# Checks that the command exits with this status.
ends_with() {
    local wanted=$1 status=0
    shift
    "$@" >"$work/said" 2>&1 || status=$?
    [ $status -eq "$wanted" ] || fail "status $status, not $wanted, of $*: $(cat "$work/said")"
}
has_results() { [ -s out/forces.svg ] && [ -s out/forces.csv ]; }

echo "without HOME"
ends_with 0 env -u HOME -u XDG_CACHE_HOME scripts/demo
says "Figure: out/forces.svg"
has_results || fail "no results"
tail -n1 out/forces.svg | grep -qx "</svg>" || fail "the figure is truncated"

echo "an implant of two needles"
ends_with 0 scripts/demo --implant --short
says "implant             2 needles, 8 seeds"
says "repeated            "
says "peak force pushing in"
says "shift of its base"
says "needles out"
for figure in forces seeds dvh; do
    tail -n1 out/implant-$figure.svg | grep -qx "</svg>" || fail "no complete out/implant-$figure.svg"
done
[ "$(wc -l <out/implant-seeds.csv)" -eq 9 ] || fail "not 8 seeds: $(cat out/implant-seeds.csv)"
[ -s out/implant.log ] && has_results || fail "no recording, or the other demo's results are gone"
head -n1 out/implant-forces.csv >heading.csv
ends_with 2 env PYTHONPATH=build/clients/python TROCAR_LIBRARY=build/core/libtrocar.so \
    scripts/implant_report meshes/pelvis.yaml docs/examples/implant-plan.yaml out/implant.log heading.csv out
says "implant_report: heading.csv: not the table of a complete implant"
head -c 200000 out/implant.log >cut.log
ends_with 2 env PYTHONPATH=build/clients/python TROCAR_LIBRARY=build/core/libtrocar.so \
    scripts/implant_report meshes/pelvis.yaml docs/examples/implant-plan.yaml cut.log out/implant-forces.csv out
says "cut.log: byte"
says "the log is truncated"
ends_with 2 scripts/demo --short
ends_with 1 scripts/demo --implant --view none
says "there is no task meshes/tasks/none.yaml"

echo "another one in the same folder"
exec 8<scripts/demo
flock 8
ends_with 1 scripts/demo
says "another demo is running in $PWD"
exec 8<&-
has_results || fail "the other demo's results are gone"

echo "Ctrl-C half way"
set -m # lets Ctrl-C reach a background job
scripts/demo >"$work/said" 2>&1 &
until [ -e out/forces.csv.part ]; do sleep 0.05; kill -0 $! || fail "$(cat "$work/said")"; done
sleep 1
kill -INT -- -$!
status=0
wait $! || status=$?
set +m
[ $status -eq 130 ] || fail "status $status after Ctrl-C: $(cat "$work/said")"
says "interrupted, no results"
[ ! -e out/forces.svg ] && [ ! -e out/forces.csv ] || fail "results of half a motion"

echo "terminated half way"
scripts/demo >"$work/said" 2>&1 &
until [ -e out/forces.csv.part ]; do sleep 0.05; kill -0 $! || fail "$(cat "$work/said")"; done
kill $!
status=0
wait $! || status=$?
[ $status -eq 143 ] || fail "status $status after SIGTERM: $(cat "$work/said")"
timeout 5 flock scripts/demo true || fail "the demo is still running"
! has_results || fail "results of half a motion"
rm -f out/forces.csv.part

# Simulates root in a container: without these capabilities and without user namespaces, and with loopback as the only network interface.
rights=-sys_admin,-net_admin
# shellcheck disable=SC2016
as_in_a_container() {
    unshare --user --map-root-user --net bash -c 'ip link set lo up multicast on; eval "$1"; echo 0 >/proc/sys/user/max_user_namespaces
        shift; exec setpriv --bounding-set "$0" --inh-caps "$0" "$@"' $rights "$@"
}
echo "without the right to a namespace"
ends_with 0 as_in_a_container 'ip route add 239.0.0.0/8 dev lo' scripts/demo
says "Start the container with: --cap-add SYS_ADMIN --cap-add NET_ADMIN"
has_results || fail "no results"

echo "nor a multicast route"
ends_with 1 as_in_a_container true scripts/demo
says "ip route add 239.255.76.67/32 dev lo"
! has_results || fail "old results were left as if they were new"
echo passed
