#!/bin/bash
# Runs scripts/spy on a virtual screen while a server and a device are running: see CheckSpy.java. Exit status 77: network namespaces are not available.
# usage: test_spy.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"

"$build/server/trocar-server" --scene "$source/meshes/figure8.yaml" --allow-non-rt >"$work/server" 2>&1 &
until grep -qx ready "$work/server"; do kill -0 $! || { cat "$work/server"; exit 1; }; sleep 0.05; done
"$build/clients/trocar-device" --script again --duration 100 >"$work/device" &
"$source/scripts/spy" --jar
javac -d "$work" -cp /usr/share/java/lcm.jar:"$source/out/spy/types.jar" "$source/tests/clients/CheckSpy.java"
Xvfb -displayfd 3 -nolisten tcp 3>"$work/display" >/dev/null 2>&1 &
until [ -s "$work/display" ]; do kill -0 $! || { echo "no Xvfb"; exit 1; }; sleep 0.05; done
DISPLAY=:$(cat "$work/display") SPY_CLASSPATH=$work SPY_MAIN=CheckSpy "$source/scripts/spy"
