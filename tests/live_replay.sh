#!/bin/bash
# A recording played by lcm-logplayer at the speed it was made to the running server, whose wrenches lcm-logger records: they
# must be those of the lockstep replay. Status 77: no network namespace here.
# usage: live_replay.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2 # absolute
if [ "${3:-}" != --inside ]; then
    "$source/scripts/netns" true || exit 77
    exec "$source/scripts/netns" "$0" "$build" "$source" --inside
fi

# A tick may find two new poses or none, since player and server do not share a clock; viscous friction (100 N s/m^2 over
# 50 mm: up to a third of the force) takes that for another speed, all the more where the machine stalls. At the end both are at rest.
at_once=$(chrt --fifo 60 true 2>/dev/null && echo chrt --fifo 60) || true # the player, as a device would
common=15   # percent of the peak that 95 % of the wrenches keep to
largest=100 # that all keep to
last=1      # that the last one keeps to
trace=$source/tests/traces/figure8.log scene=$source/meshes/figure8.yaml
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT

"$build/server/trocar-server" --scene "$scene" --rate 500 --allow-non-rt >"$work/server" 2>&1 &
until grep -qx ready "$work/server"; do
    kill -0 $! || { cat "$work/server"; exit 1; }
    sleep 0.05
done
lcm-logger --quiet --force --channel=TROCAR_WRENCH "$work/live.log" &
logger=$!
sleep 0.3
$at_once lcm-logplayer "$trace" >/dev/null
sleep 0.2
kill $logger
wait $logger || true
"$build/clients/trocar-replay" --scene "$scene" --poses "$trace" --compare "$work/live.log" --tolerance $common 2>"$work/result" ||
    [ $? -eq 1 ] || { cat "$work/result"; exit 1; }
cat "$work/result"
awk -v common=$common -v largest=$largest -v last=$last '
    function share() { match($0, /[0-9.e+-]+ % of its peak/); return substr($0, RSTART) + 0 }
    / wrenches agree$/ { all = $2 }  / wrenches differ$/ { all = $4 }
    / largest: / { worst = share() }  / last: / { end = share() }  / off by less than / { most = $(NF - 1) }
    END { exit !(all > 900 && most != "" && most < common && worst < largest && end < last) }' "$work/result"
