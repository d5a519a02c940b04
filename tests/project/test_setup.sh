#!/bin/bash
# Tests which packages scripts/setup requests from apt, and its messages when apt fails. Nothing is installed: scripts stand in for dpkg-query and apt-get. Also
# tests that the demo can be configured and built without libraries that it does not use, in a folder whose name has a space.
# usage: test_setup.sh SOURCE_DIR
set -euo pipefail
source=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }
mkdir "$work/bin" "$work/a tree"
cd "$work"

stand_in() { printf '#!/bin/bash\n%s\n' "$2" >"bin/$1"; chmod +x "bin/$1"; }
setup() { # status in $status, output in the file `said`
    status=0
    PATH=$work/bin:$PATH WORK=$work "$source/scripts/setup" "$@" >said 2>&1 || status=$?
}
stand_in dpkg-query 'exit 1'
stand_in sudo 'exec "$@"'
stand_in sleep 'echo nap >>"$WORK/naps"'

# The demo needs no web page, no tests and no Python packages.
stand_in apt-get 'echo "$@" >>"$WORK/asked"'
setup --demo one-more
[ $status -eq 0 ] || fail "$(cat said)"
grep -q 'install.* libyaml-dev .* one-more' asked || fail "requested: $(cat asked)"
! grep -qE 'npm|nodejs|libwebsockets|matplotlib|numpy|cmocka|gmsh|ncurses|help2man|chromium|cjson|igtlink|spnav|evdev' asked || fail "more than the demo needs: $(cat asked)"
rm asked && setup --view
! grep -qE 'cjson|igtlink|spnav|evdev' asked || fail "more than the view needs: $(cat asked)"
rm asked && setup --package
for package in libwebsockets-dev libncurses-dev help2man python3-numpy libcjson-dev libopenigtlink-dev libspnav-dev libx11-dev libevdev-dev; do grep -q " $package" asked || fail "no $package: $(cat asked)"; done
! grep -qE 'matplotlib|cmocka|gmsh' asked || fail "more than the package needs: $(cat asked)"
rm asked && setup one-more two-more     # only the requested packages
[ "$(grep -o 'install.*' asked | sed 's/.*recommends //')" = "one-more two-more" ] || fail "more than was asked for: $(cat asked)"
rm asked && setup --all one-more
grep -q 'libcmocka-dev libgmsh-dev .*one-more' asked || fail "requested: $(cat asked)"
rm asked && setup
for package in libwebsockets-dev libcmocka-dev libncurses-dev help2man libcjson-dev libopenigtlink-dev libspnav-dev libx11-dev libevdev-dev; do grep -q " $package" asked || fail "no $package: $(cat asked)"; done
# shellcheck disable=SC2016
for program in man:man-db col:bsdextrautils; do # used by the tests
    grep -q "^ .*[^-]\b${program#*:}\b" "$source/scripts/test" || fail "scripts/test does not install ${program#*:} for ${program%:*}"
done

# scripts/anatomy asks only for the packages it uses; here, its library has already been built.
rm asked && mkdir -p tree/scripts tree/meshes && cp "$source/scripts/anatomy" "$source/scripts/setup" tree/scripts
PATH=$work/bin:$PATH WORK=$work TROCAR_LIBRARY=there tree/scripts/anatomy --help >said 2>&1 || true
for package in python3-gmsh python3-vtk9 python3-pygalmesh python3-nibabel; do grep -q " $package" asked || fail "no $package: $(cat asked)"; done
! grep -qE 'npm|nodejs|cmocka|cmake|gcc|websockets|igtlink' asked || fail "more than anatomy needs: $(cat asked)"

# If apt is locked, the script waits, gives up in the end, and names the process that holds the lock.
stand_in apt-get 'echo "E: Could not get lock /var/lib/dpkg/lock-frontend. It is held by process 4711 (unattended-upgr)" >&2; exit 100'
setup --demo
[ $status -eq 1 ] || fail "status $status with a lock"
[ "$(wc -l <naps)" -gt 20 ] || fail "waited only $(wc -l <naps) times"
grep -q 'setup: apt is still locked.*process 4711 (unattended-upgr).*Run this again' said || fail "$(cat said)"
stand_in apt-get '[ -e "$WORK/free" ] && exit 0; touch "$WORK/free"; echo "E: Could not get lock /var/lib/apt/lists/lock" >&2; exit 100'
setup --demo
[ $status -eq 0 ] || fail "the lock was released: $(cat said)"

# No network.
stand_in apt-get 'echo "E: Unable to locate package" >&2; exit 100'
setup --demo
[ $status -eq 1 ] && grep -q 'is there a network' said || fail "status $status: $(cat said)"

# Hides everything the demo does not use: .pc files cannot be found, and programs fail.
mkdir pkgconfig
for file in $(pkg-config --variable pc_path pkg-config | tr : ' '); do
    [ ! -d "$file" ] || find "$file" -name '*.pc' ! -name 'ncurses*' ! -name 'cmocka*' ! -name 'libwebsockets*' \
        ! -name 'libcjson*' ! -name 'spnav*' ! -name 'libevdev*' \
        -exec ln -sf -t pkgconfig {} +
done
for program in npm node help2man; do stand_in $program 'exit 1'; done
for folder in CMakeLists.txt CMakePresets.json lcmtypes core server clients meshes; do ln -s "$source/$folder" "a tree/$folder"; done
cd "a tree"
PATH=$work/bin:$PATH PKG_CONFIG_LIBDIR=$work/pkgconfig cmake --preset demo >../said 2>&1 || fail "$(cat ../said)"
cmake --build build --target trocar_types >../said 2>&1 || fail "$(cat ../said)"
! PKG_CONFIG_LIBDIR=$work/pkgconfig cmake --preset view >../said 2>&1 || fail "the view is configured without libwebsockets"
grep -q libwebsockets ../said || fail "$(cat ../said)"

# help2man passes the program's path to a shell. To test this, the command that CMake generated for a man page is run here with a script as the program.
rm ../bin/help2man
for folder in tests scripts docs README.md CHANGELOG.md LICENSE LICENSES; do [ ! -e "$source/$folder" ] || ln -s "$source/$folder" "$folder"; done
cmake --preset release >../said 2>&1 || fail "$(cat ../said)"
cat >build/clients/trocar-device <<'END'
#!/bin/sh
case $1 in
    --version) echo "trocar-device 1" ;;
    *) printf 'Usage: trocar-device [OPTION...]\n\n  -x, --extra    More\n' ;;
esac
END
chmod +x build/clients/trocar-device
bash -c "$(ninja -C build -t commands scripts/packaging/trocar-device.1 | tail -n 1)" >../said 2>&1 || fail "$(cat ../said)"
grep -q extra build/scripts/packaging/trocar-device.1 || fail "$(cat build/scripts/packaging/trocar-device.1)"
echo passed
