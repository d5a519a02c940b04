#!/bin/bash
# Plays a recording back to a running server with lcm-logplayer at its original speed, and records the wrenches with lcm-logger. The wrenches must match those
# of the
# lockstep replay. Exit status 77: network namespaces are not permitted. usage: live_replay.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
. "${0%/*}/../shared/in_namespace.sh"

# Player and server have no common clock, so a tick may get two new poses or none. To viscous friction (100 N s/m^2 over 50 mm, up to a third of the force),
# this looks like a change in speed, all the more so if the machine stalls. The limits are therefore wide, except for the last wrench, when both needles are at
# rest.
at_once=$(chrt --fifo 60 true 2>/dev/null && echo chrt --fifo 60) || true # real-time priority for the player, as for a device
common=15   # limit for 95 % of the wrenches, in percent of the peak
largest=100 # limit for all wrenches
last=1      # limit for the last wrench
scene=$source/meshes/figure8.yaml
trace=$work/poses.log

"$build/clients/trocar-device" --script figure8 --write-log "$trace" # the recorded trace uses the older message types
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
