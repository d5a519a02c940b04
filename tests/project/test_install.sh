#!/bin/bash
# Tests the installed files, unpacked from the Debian packages into a separate folder: programs, man pages, completions and the Python package. Bridges and
# planners are built against these files outside the source tree.
# usage: test_install.sh BUILD_DIR SOURCE_DIR     the packages are in BUILD_DIR/packages
set -euo pipefail
build=$1 source=$2 # absolute
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
cd "$work"
export LC_ALL=C.UTF-8

fail() { echo "FAILED: $*" >&2; exit 1; }

package=$(echo "$build"/packages/trocar_*.deb) python_package=$(echo "$build"/packages/python3-trocar_*.deb) bridges=$(echo "$build"/packages/trocar-bridges_*.deb)
for archive in "$package" "$python_package" "$bridges"; do dpkg-deb --extract "$archive" root; done
prefix=$work/root/usr

# Every library a program needs comes from a package in Depends, and apt can install these packages.
for archive in "$package" "$bridges"; do
    for path in $(dpkg-deb --fsys-tarfile "$archive" | tar -t --wildcards './usr/bin/*'); do
        for library in $(objdump -p "root/$path" 2>objdump.txt | awk '$1 == "NEEDED" && !/ld-linux/ { print $2 }'); do
            file=$(ldd "root/$path" | awk -v library="$library" '$1 == library { print $3 }')
            echo "$archive $path $library $(realpath "$file")"
        done
    done
done >needed
[ -s needed ] || fail "no program needs a library"
# One call for all libraries, because each call takes half a second. Packages may list /usr/lib as /lib.
dpkg -S $(awk '{ print $4; sub("^/usr/", "/", $4); print $4 }' needed | sort -u) >owners 2>/dev/null || true
while read -r archive path library file; do
    depends=$(dpkg-deb --field "$archive" Depends)
    grep -qwFf <(sed -nE "s|:.* (/usr)?${file#/usr}\$||p" owners) <<<"$depends" ||
        fail "$path needs $library of $(grep "${file##*/}\$" owners), which is missing from: $depends"
done <needed
depends=$(dpkg-deb --field "$package" Depends)
[[ $depends == *libopenblas0-pthread* ]] || fail "libopenblas0-pthread is not required: $depends"
! [[ $depends =~ cjson|openigtlink|spnav|evdev ]] || fail "the server needs a bridge's library: $depends"
# Gmsh depends on a hundred packages and is needed only for meshes in other formats, so no package may depend on it.
! grep gmsh needed || fail "a program needs Gmsh"
! objdump -p root/usr/lib/*/libtrocar.so | grep -i gmsh || fail "the library needs Gmsh"
[[ $depends$(dpkg-deb --field "$package" Recommends) != *gmsh* && $(dpkg-deb --field "$package" Suggests) == *libgmsh4.8* ]] || fail "Gmsh is not just suggested"
apt-get install --simulate "$package" "$python_package" "$bridges" >apt.txt 2>&1 || fail "$(cat apt.txt)"
for name in trocar python3-trocar trocar-bridges; do grep -q "^Inst $name " apt.txt || fail "$(cat apt.txt)"; done
for archive in "$python_package" "$bridges"; do
    grep -qF "trocar (= $(dpkg-deb --field "$package" Version))" <<<"$(dpkg-deb --field "$archive" Depends)" ||
        fail "$archive depends on another version of trocar: $(dpkg-deb --field "$archive" Depends)"
done
for file in share/trocar/trocar.lcm share/trocar/scenes/figure8.yaml share/doc/trocar/README.md share/doc/trocar/copyright; do
    [ -f "$prefix/$file" ] || fail "no $file"
done
! grep -rlFe "$build" -e "$source" "$prefix" || fail "an installed file contains a path of the build"
libraries=$prefix/lib/$(cc -print-multiarch)
for library in "$libraries"/libtrocar{_types,}.a; do
    objdump -h "$library" >sections && ! grep -F .debug sections || fail "$library contains debug information and with it paths of the build"
done
# The viewer's page includes third-party libraries, whose licences require a notice.
for library in three.js uPlot; do
    [ ! -d "$prefix/share/trocar/page" ] || grep -qx "Files: $library" "$prefix/share/doc/trocar/copyright" || fail "no notice of $library"
done

# All links within the documents have a target.
find "$prefix" -name '*.md' >documents
grep -q /core/README.md documents || fail "documents that README.md links to are missing: $(cat documents)"
while read -r document; do
    { grep -oE '\]\([^)]+' "$document" || true; } | sed 's/^](//; s/#.*//' | while read -r link; do
        case $link in '' | *://*) continue ;; esac
        [ -e "${document%/*}/$link" ] || fail "$document links to $link, which does not exist"
    done
done <documents

# The systemd unit refers to files that are installed, whatever the prefix, and to a group that the package creates.
names_what_is_there() {
    local unit=$1$2/lib/systemd/system/trocar-server.service file
    grep -qxF "ExecStart=$2/bin/trocar-server --scene \${TROCAR_SCENE}" "$unit" || fail "the unit of $2 starts another program: $(cat "$unit")"
    for file in $(grep -oE "$2/[a-z0-9/._-]+" "$unit"); do
        [ -e "$1$file" ] || fail "the unit names $file, which is not installed"
    done
}
names_what_is_there "$work/root" /usr
mkdir root/etc
systemd-sysusers --root="$work/root" 2>sysusers.txt || fail "$(cat sysusers.txt)"
grep -q "^$(sed -n 's/^SupplementaryGroups=//p' "$prefix/lib/systemd/system/trocar-server.service"):" root/etc/group || fail "$(cat sysusers.txt)"
cmake --install "$build" --prefix "$work/local" >cmake.txt || fail "$(cat cmake.txt)"
names_what_is_there "" "$work/local"
"$work/local/bin/trocar-server" --version >version

# Every program prints its version, and has a man page with its options and a completion file. One of the programs is written in Python.
export PYTHONPATH=$prefix/lib/python3/dist-packages TROCAR_LIBRARY=$libraries/libtrocar.so PYTHONDONTWRITEBYTECODE=1
for path in "$prefix"/bin/*; do
    program=$(basename "$path")
    grep -qE "^$program [0-9.]+$" <<<"$("$path" --version)" || fail "$program --version"
    man -l "$prefix/share/man/man1/$program.1.gz" | col -b >page
    grep -qE "^ +$program - " page || fail "no name in the man page of $program"
    for option in $("$path" --help | grep -oE '^ .*--[a-z-]+' | grep -oE -- '--[a-z-]+'); do
        grep -qF -- "$option" page || fail "$program $option is not in its man page"
    done
    [ -f "$prefix/share/bash-completion/completions/$program" ] || fail "no completion of $program"
done
unset PYTHONPATH TROCAR_LIBRARY

# Prints the completions that bash offers for this command line.
offers() {
    PATH=$prefix/bin:$PATH bash -c '
        source /usr/share/bash-completion/bash_completion
        source "$0"/share/bash-completion/completions/trocar-server
        COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMP_LINE="$*" COMP_POINT=${#COMP_LINE}
        compopt() { :; }
        _trocar "$1" "${!#}" "${@: -2:1}"
        printf "%s\n" "${COMPREPLY[@]}"' "$prefix" "$@"
}
offers trocar-server --sc | grep -q '^--scene=' || fail "trocar-server --sc<TAB>: $(offers trocar-server --sc)"
offers trocar-device --script fig | grep -qx figure8 || fail "trocar-device --script fig<TAB>: $(offers trocar-device --script fig)"
offers trocar-bench t | grep -qx tick || fail "trocar-bench t<TAB>: $(offers trocar-bench t)"
offers trocar-bench tick --con | grep -q '^--contacts=' || fail "trocar-bench tick --con<TAB>: $(offers trocar-bench tick --con)"
offers trocar-study ru | grep -qx run || fail "trocar-study ru<TAB>: $(offers trocar-study ru)"
offers trocar-plan car | grep -qx carry-out || fail "trocar-plan car<TAB>: $(offers trocar-plan car)"
offers trocar-fit ch | grep -qx check || fail "trocar-fit ch<TAB>: $(offers trocar-fit ch)"
offers trocar-spacemouse --dead | grep -q "^--dead-zone=" || fail "trocar-spacemouse --dead<TAB>: $(offers trocar-spacemouse --dead)"
[ "$(offers trocar-haply --point t)" = tip ] || fail "trocar-haply --point t<TAB>: $(offers trocar-haply --point t)"
touch scene.yaml scene.csv scene.jsonl
[ "$(offers trocar-replay --shift sc)" = scene.csv ] || fail "trocar-replay --shift sc<TAB>: $(offers trocar-replay --shift sc)"
[ "$(offers trocar-replay --json-lines sc)" = scene.jsonl ] || fail "trocar-replay --json-lines sc<TAB>: $(offers trocar-replay --json-lines sc)"
[ "$(offers trocar-replay --scene sc)" = scene.yaml ] || fail "trocar-replay --scene sc<TAB>: $(offers trocar-replay --scene sc)"

# The implant report is installed, finds the message definitions, and evaluates an incomplete recording as far as it goes.
/usr/bin/python3 - poses.log <<'END'
import struct, sys
event = lambda number, channel, data: struct.pack(">IqqII", 0xEDA1DA01, number, number, len(channel), len(data)) + channel + data
open(sys.argv[1], "wb").write(event(0, b"TROCAR_SEEDS", b"no seeds"))
END
printf '%s\n' "t [s],needle,hole,stage,tip [m],against [N]" 0,0,E3,in,0,0 1,0,E3,out,0,0 >forces.csv
status=0
PYTHONPATH=$prefix/lib/python3/dist-packages TROCAR_LIBRARY=$libraries/libtrocar.so "$prefix/share/trocar/implant_report" \
    "$prefix/share/trocar/scenes/implant.yaml" "$prefix/share/doc/trocar/examples/implant-plan.yaml" poses.log forces.csv . 2>report.txt || status=$?
[ $status -eq 2 ] && grep -q "implant_report: poses.log: channel TROCAR_SEEDS: a message of another type" report.txt || fail "implant_report: status $status, $(cat report.txt)"

grep -qx Prostate <<<"$("$prefix/bin/trocar-anatomy" --list "$prefix/share/trocar/scenes/synthetic.dcm")" || fail "trocar-anatomy --list"

# Outside the source tree, builds the documentation's bridge with CMake and with pkg-config, and programs that use the library.
export PKG_CONFIG_PATH=$libraries/pkgconfig
cp -r "$prefix/share/doc/trocar/examples" bridge
cmake -S bridge -B bridge/build -DCMAKE_PREFIX_PATH="$prefix" >cmake.txt && cmake --build bridge/build >>cmake.txt || fail "$(cat cmake.txt)"
cc bridge/bridge.c -o bridge/with-pkg-config $(pkg-config --cflags --libs trocar-client) || fail "pkg-config trocar-client"
cc bridge/bridge.c -o bridge/unicast $(pkg-config --cflags --libs trocar-client-unicast) || fail "pkg-config trocar-client-unicast"
c++ -std=c++17 bridge/bridge.cpp -o bridge/in-c++ $(pkg-config --cflags --libs trocar-client) || fail "the bridge in C++"
# Builds the bridge with only the free client, as on a system that has nothing but a compiler: first with the static library through pkg-config, then from
# source.
for how in "$(PKG_CONFIG_PATH= PKG_CONFIG_LIBDIR=$libraries/pkgconfig pkg-config --cflags --libs trocar-client)" \
           "-std=gnu99 -I$prefix/share/trocar/client $prefix/share/trocar/client/trocar_client.c -lpthread -lm"; do
    cc -Wall -Wextra -Werror bridge/bridge.c -o alone $how || fail "the client alone: $how"
    ! ldd alone | grep -E 'lcm|glib' || fail "the client needs a library: $how"
done
# libtrocar: the same program prints the same digits in C and C++, each built with CMake or pkg-config, and in Python.
examples=$prefix/share/doc/trocar/examples figure8=$prefix/share/trocar/scenes/figure8.yaml
export LD_LIBRARY_PATH=$(dirname "$(find "$prefix/lib" -name libtrocar.so)")
cmake -S "$source/tests/project/install" -B planner -DCMAKE_PREFIX_PATH="$prefix" >cmake.txt && cmake --build planner >>cmake.txt || fail "$(cat cmake.txt)"
c++ -std=c++17 "$examples/insert.cpp" -o insert_cpp $(pkg-config --cflags --libs trocar) || fail "pkg-config trocar"
# Builds without files from any other package, as on a system with nothing but a compiler and pkg-config.
alone=$(PKG_CONFIG_PATH= PKG_CONFIG_LIBDIR=$(dirname "$(find "$prefix" -name trocar.pc)") pkg-config --cflags --libs trocar 2>&1) || fail "pkg-config alone: $alone"
[ "$(xargs -n 1 <<<"$alone" | sort -u)" = "$(xargs -n 1 <<<"$(pkg-config --cflags --libs trocar)" | sort -u)" ] || fail "pkg-config alone: $alone"
! pkg-config --libs --static trocar | grep gfortran || fail "the static library needs a Fortran compiler"
cc "$examples/insert.c" -o insert_static $(pkg-config --cflags trocar) "$LD_LIBRARY_PATH/libtrocar.a" $(pkg-config --libs --static trocar | sed 's/-ltrocar //') -lpthread ||
    fail "the static library"
planner/insert "$figure8" >insert_c.txt || fail "the C example: status $?"
[ "$(wc -l <insert_c.txt)" -eq 10 ] || fail "$(cat insert_c.txt)"
./insert_cpp "$figure8" | diff insert_c.txt - || fail "C and C++ differ"
(unset LD_LIBRARY_PATH; ./insert_static "$figure8") | diff insert_c.txt - || fail "shared and static library differ"
PYTHONPATH=$prefix/lib/python3/dist-packages /usr/bin/python3 "$prefix/share/doc/python3-trocar/examples/insert.py" "$figure8" | diff insert_c.txt - ||
    fail "C and Python differ"
[ "$(find "$prefix/include" -name '*.h' | grep -c /trocar.h)" -eq 1 ] || fail "no trocar.h"
unset LD_LIBRARY_PATH

# The bridge shown in the README drives a device if it is compiled with another device.h.
sed -n '/^```c$/,/^```$/{/^```/!p}' "$prefix/share/doc/trocar/README.md" | diff bridge/bridge.c - || fail "README.md does not show bridge.c"
mkdir filled_in && cp bridge/bridge.c filled_in
cc -I "$source/tests/project/install" filled_in/bridge.c -o filled $(pkg-config --cflags --libs trocar-client) -lm || fail "the bridge with a device"

# The installed server answers the bridge: a recording has wrenches for the bridge's poses. When the server dies in the middle of an insertion, the device's
# force drops to zero within 50 ms; the next server provides a force again.
netns=$source/scripts/netns
"$netns" true || { echo "passed, except the running bridge: no network namespace here"; exit 0; }
at_once=$(chrt --fifo 20 true 2>/dev/null && echo chrt --fifo 20) || true # real-time priority, as for a bridge
cat >session <<END
trap 'kill \$(jobs -p); wait' EXIT
start_server() {
    rm -f ready
    $prefix/bin/trocar-server --scene $prefix/share/trocar/scenes/figure8.yaml --allow-non-rt >ready & server=\$!
    until grep -qsx ready ready; do sleep 0.05; kill -0 \$server || exit 1; done
}
wait_for() { for _ in {1..100}; do "\$@" && return; sleep 0.05; done; echo "timed out after 5 s: \$*"; return 1; }
felt() { tail -n +\$1 forces | awk '\$2 > '\$2' { found = 1 } END { exit !found }'; } # succeeds if a force since line \$1 exceeds \$2

start_server
lcm-logger --quiet --force session.log >logger.txt & logger=\$!
wait_for test -s session.log # monitors the server: waits until the logger receives something
timeout 1 bridge/build/bridge || [ \$? -eq 124 ]
kill \$logger
sleep 2.2 # until the needle may have another owner
$at_once ./filled 2>forces &
wait_for felt 1 0.2
date +%s.%N >killed
kill -KILL \$server
sleep 0.3
wc -l <forces >dead
start_server
wait_for felt \$(cat dead) 0
END
"$netns" bash -eu session || fail "server and bridge: $(cat ready; tail -n 3 forces)"
"$prefix/bin/trocar-replay" --scene "$prefix/share/trocar/scenes/figure8.yaml" --poses session.log --compare session.log
head -n "$(cat dead)" forces | awk -v killed="$(cat killed)" '
    $2 > 0 { last = $1 - killed } END { printf "after the server\047s death the device had force for %.0f ms\n", 1e3 * last; exit !(last < 0.05) }' ||
    fail "the bridge kept the last force"
echo passed
