#!/bin/bash
# Makes the wheel, installs it with pip into a folder, and checks that it is self-contained and computes what the build tree computes, bit for bit.
# tests/project/bare_system.sh installs it on a system that has only pip. usage: test_wheel.sh BUILD_DIR SOURCE_DIR. Exit status 77: pip or patchelf is missing.
set -euo pipefail
build=$1 source=$2
for tool in "/usr/bin/python3 -m pip" "/usr/bin/python3 -m wheel" patchelf; do
    # shellcheck disable=SC2086
    $tool --help >/dev/null 2>&1 || { echo "skipped: install python3-pip, python3-wheel and patchelf"; exit 77; }
done
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "FAILED: $*" >&2; exit 1; }

"$source/scripts/packaging/wheel/make_wheel" "$build" "$work/out" >/dev/null
wheel=$(echo "$work"/out/*.whl)
echo "${wheel##*/}: $(stat -c %s "$wheel") bytes"
/usr/bin/python3 -m pip install --quiet --no-index --no-deps --target "$work/installed" "$wheel" || fail "pip"
libraries=$work/installed/trocar/libraries

# Every library needed comes from the wheel, or is one that PEP 600 expects on every system. None is bundled without its licence.
for library in "$libraries"/*; do
    # libraries that resolve elsewhere, or not at all
    ldd "$library" | grep -vE "$libraries/|linux-vdso|ld-linux|lib(c|m|gcc_s)\.so" && fail "$library needs libraries of this system"
    grep -q "${library##*/}" "$work"/installed/trocar-*.dist-info/RECORD || fail "no record of $library"
done
[ "$(ls "$libraries" | wc -l)" -gt 8 ] || fail "few libraries: $(ls "$libraries")"
for licence in trocar libopenblas0-pthread libcholmod3 libmetis5; do
    [ -s "$work"/installed/trocar-*.dist-info/licenses/$licence ] || fail "no licence of $licence"
done

# The wheel's name promises a glibc version.
promised=$(sed -E 's/.*manylinux_([0-9]+)_([0-9]+)_.*/\1.\2/' <<<"$wheel")
used=$(objdump -T "$libraries"/* 2>/dev/null | grep -oE 'GLIBC_[0-9.]+' | sort -Vu | tail -n1)
[ "$used" = "GLIBC_$promised" ] || fail "the wheel needs $used, its name says $promised"

insert() { /usr/bin/python3 "$source/docs/examples/insert.py" "$source/meshes/figure8.yaml"; }
PYTHONPATH=$build/clients/python TROCAR_LIBRARY=$build/core/libtrocar.so insert >"$work/expected"
[ "$(wc -l <"$work/expected")" -eq 10 ] || fail "the build tree: $(cat "$work/expected")"
(cd "$work" && env -u TROCAR_LIBRARY PYTHONPATH="$work/installed" /usr/bin/python3 -c "import trocar; print(trocar.__file__)") | grep -qF "$work/installed" || fail "another package is loaded"
env -u TROCAR_LIBRARY PYTHONPATH="$work/installed" bash -c "$(declare -f insert); source=$source; insert" | diff "$work/expected" - || fail "the wheel computes other forces"
for program in trocar-study trocar-plan trocar-fit trocar-score; do
    grep -qE "^$program [0-9.]+$" <<<"$(env -u TROCAR_LIBRARY PYTHONPATH="$work/installed" "$work/installed/bin/$program" --version)" || fail "$program"
done
echo passed
