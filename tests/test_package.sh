#!/bin/bash
# The Debian package's life in a root of its own: installed, upgraded, removed and purged by dpkg while its server runs; and
# lintian's opinion of it. A stand-in plays systemctl's part for the one unit.
# usage: test_package.sh BUILD_DIR SOURCE_DIR
set -euo pipefail
build=$1 source=$2 # absolute
if [ "$(id -u)" -ne 0 ]; then
    unshare --map-root-user true 2>/dev/null || { echo "no user namespace here, in which dpkg would be root"; exit 77; }
    exec unshare --map-root-user "$0" "$@"
fi
work=$(mktemp -d)
root=$work/root
trap 'kill "$(cat "$work/pid" 2>/dev/null)" 2>/dev/null || true; rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; cat dpkg.txt calls 2>/dev/null >&2; exit 1; }

cpack --config "$build/CPackConfig.cmake" -B "$work" -D CPACK_DEBIAN_COMPRESSION_TYPE=gzip >cpack.txt 2>&1 || fail "$(cat cpack.txt)"
package=$(echo trocar_*.deb)
[ "$(dpkg-deb --field "$package" Version)" = "$(dpkg-parsechangelog -l "$source/scripts/packaging/changelog" -S Version)" ] ||
    fail "scripts/packaging/changelog is of another version: $package"
lintian --allow-root --fail-on error,warning "$package" || fail "lintian"

# systemctl: start, stop and try-restart are done to the server in the root, and noted.
mkdir -p bin root/run/systemd/system root/etc root/var/lib/dpkg/{info,updates} root/var/cache/private
touch root/var/lib/dpkg/{status,available} calls
cat >bin/systemctl <<END
#!/bin/bash
echo "\$@" >>$work/calls
running() { [ -s $work/pid ] && kill -0 "\$(cat $work/pid)" 2>/dev/null; }
stop() { if running; then kill "\$(cat $work/pid)"; while running; do sleep 0.05; done; fi; }
start() {
    $root/usr/bin/trocar-server --scene $root/usr/share/trocar/scenes/figure8.yaml --allow-non-rt --lcm-url memq:// >$work/server.txt 2>&1 &
    echo \$! >$work/pid
}
case \$* in
    *try-restart*trocar-server.service) if running; then stop; start; fi ;;
    *stop*trocar-server.service) stop ;;
    *start*trocar-server.service) start ;;
esac
END
chmod +x bin/systemctl
export PATH=$work/bin:$PATH
package() { dpkg --root="$root" --force-script-chrootless --force-depends --force-unsafe-io --log=/dev/null "$@" >dpkg.txt 2>&1 || fail "dpkg $*"; }
server() { readlink "/proc/$(cat pid)/exe" 2>/dev/null || true; }
links() { find "$root/etc/systemd" -name 'trocar*' 2>/dev/null || true; }

package --install "$package"
! grep -q 'start' calls || fail "the server is started unasked"
[ -z "$(links)" ] || fail "the server is enabled unasked: $(links)"
package --install "$package"
! [ -e pid ] || fail "an upgrade starts the server"

/usr/bin/systemctl --root="$root" enable trocar-server 2>systemctl.txt || fail "$(cat systemctl.txt)"
[ -n "$(links)" ] || fail "not enabled"
systemctl start trocar-server.service
sleep 0.3
[ "$(server)" = "$root/usr/bin/trocar-server" ] || fail "no server: $(cat server.txt)"
mkdir -p root/var/cache/private/trocar
ln -s private/trocar root/var/cache/trocar
touch root/var/cache/private/trocar/inverse.h5
package --install "$package"
sleep 0.3
[ "$(server)" = "$root/usr/bin/trocar-server" ] || fail "after an upgrade this runs: $(server)"
[ -n "$(links)" ] || fail "an upgrade disables the server"

package --remove trocar
[ -z "$(server)" ] || fail "after removal this runs: $(server)"
[ -z "$(links)" ] || fail "left after removal: $(links)"
[ -f root/var/cache/private/trocar/inverse.h5 ] || fail "a removal empties the cache"
package --purge trocar
[ -d root/var/cache/private ] || fail "a purge removes what is others'"
left=$(find root -name '*trocar*')
[ -z "$left" ] || fail "left after purge: $left"
echo passed
