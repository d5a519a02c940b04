#!/bin/sh
# Checks the systemd unit with systemd-analyze. The unit is changed to start the newly built server. usage: test_unit.sh UNIT SERVER
set -eu

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
sed -e "s|@CMAKE_INSTALL_PREFIX@/bin/trocar-server|\"$2\"|" -e '/^Documentation=/d' "$1" >"$work/trocar-server.service"
grep -q "^ExecStart=\"$2\" --scene" "$work/trocar-server.service"
systemd-analyze verify "$work/trocar-server.service" >"$work/complaints" 2>&1 || { cat "$work/complaints"; exit 1; }
if [ -s "$work/complaints" ]; then cat "$work/complaints"; exit 1; fi

# A unit with an error must be refused.
sed -i 's/^Restart=.*/Restart=sometimes/' "$work/trocar-server.service"
systemd-analyze verify "$work/trocar-server.service" 2>&1 | grep -q sometimes
