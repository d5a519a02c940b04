#!/bin/bash
# Tests the Debian packages in a separate root: dpkg installs, upgrades, removes and purges them while the server is running, and lintian checks them. A script
# stands in for systemctl.
# usage: test_package.sh BUILD_DIR SOURCE_DIR     the packages are in BUILD_DIR/packages
set -euo pipefail
build=$1 source=$2 # absolute
if [ "$(id -u)" -ne 0 ]; then
    unshare --map-root-user true 2>/dev/null || { echo "skipped: no user namespace here, in which dpkg would be root"; exit 77; }
    exec unshare --map-root-user "$0" "$@"
fi
work=$(mktemp -d)
root=$work/root
trap 'kill "$(cat "$work/pid" 2>/dev/null)" 2>/dev/null || true; rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; cat dpkg.txt calls 2>/dev/null >&2; exit 1; }

package=$(echo "$build"/packages/trocar_*.deb) python_package=$(echo "$build"/packages/python3-trocar_*.deb) bridges=$(echo "$build"/packages/trocar-bridges_*.deb)
[ "$(dpkg-deb --field "$package" Version)" = "$(dpkg-parsechangelog -l "$source/scripts/packaging/changelog" -S Version)" ] ||
    fail "scripts/packaging/changelog has another version than $package"
lintian --allow-root --fail-on error,warning "$package" "$python_package" "$bridges" || fail "lintian"

# Stand-in for systemctl: applies start, stop and try-restart to the server in the root, and logs the calls.
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
! grep -q 'start' calls || fail "the installation starts the server"
[ -z "$(links)" ] || fail "the installation enables the server: $(links)"
package --install "$package"
! [ -e pid ] || fail "an upgrade starts the server"

package --install "$python_package"
[ -n "$(find root/usr/lib/python3 -name '__init__.*.pyc')" ] || fail "the Python package is not compiled"
package --purge python3-trocar
[ -z "$(find root -path '*python3*trocar*')" ] || fail "files left of the Python package: $(find root -path '*python3*trocar*')"

package --install "$bridges"
[ -x root/usr/bin/trocar-haply ] || fail "no bridge is installed"
package --purge trocar-bridges
left=$(find root -name '*bridges*' -not -path 'root/usr/share/doc/trocar/*') # the pages of clients/bridges belong to trocar
[ -z "$left" ] && ! [ -e root/usr/bin/trocar-haply ] || fail "files left of the bridges: $left"

/usr/bin/systemctl --root="$root" enable trocar-server 2>systemctl.txt || fail "$(cat systemctl.txt)"
[ -n "$(links)" ] || fail "not enabled"
systemctl start trocar-server.service
sleep 0.3
[ "$(server)" = "$root/usr/bin/trocar-server" ] || fail "no server: $(cat server.txt)"
mkdir -p root/var/cache/private/trocar
ln -s private/trocar root/var/cache/trocar
touch root/var/cache/private/trocar/any.inverse
package --install "$package"
sleep 0.3
[ "$(server)" = "$root/usr/bin/trocar-server" ] || fail "running after the upgrade: $(server)"
[ -n "$(links)" ] || fail "an upgrade disables the server"

package --remove trocar
[ -z "$(server)" ] || fail "running after the removal: $(server)"
[ -z "$(links)" ] || fail "links left after removal: $(links)"
[ -f root/var/cache/private/trocar/any.inverse ] || fail "removal deletes the cache"
package --purge trocar
[ -d root/var/cache/private ] || fail "purge deletes files of others"
left=$(find root -name '*trocar*')
[ -z "$left" ] || fail "files left after purge: $left"
echo passed
