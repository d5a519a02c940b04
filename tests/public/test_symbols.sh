#!/bin/bash
# Tests that the libraries export exactly the declared functions; that each public header compiles on its own as C and C++, is short, and is not named like a
# system header; and that the binary interface (ABI) equals tests/public/libtrocar.abi. With --renew, records an intended change to the interface there.
# usage: test_symbols.sh BUILD_DIR SOURCE_DIR [--renew]
set -euo pipefail
build=$1 source=$2 # absolute
library=$build/core/libtrocar.so include=$source/core/include

fail() { echo "FAILED: $*" >&2; exit 1; }

declared=$(sed -n 's/^TROCAR_API .*[ *]\(trocar_[a-z_]*\)(.*/\1/p' "$include"/trocar/*.h | sort)
[ "$(wc -w <<<"$declared")" -gt 20 ] || fail "the header declares $(wc -w <<<"$declared") functions"
for exported in "$(nm -D --defined-only "$library")" "$(nm --extern-only --defined-only "$build/core/libtrocar.a")"; do
    names=$(awk 'NF == 3 && $2 ~ /[TDBRVW]/ { print $3 }' <<<"$exported" | sort)
    diff <(echo "$declared") <(echo "$names") || fail "exported symbols (>) differ from the header's declarations (<)"
done
objdump -p "$library" | grep -qE 'SONAME +libtrocar\.so\.[0-9]+\.[0-9]+$' || fail "no soname"

for header in "$include"/trocar.h "$include"/trocar/*.h; do
    for standard in c11 c17; do
        ${CC:-cc} -std=$standard -Wall -Wextra -pedantic-errors -Werror -I "$include" -fsyntax-only -x c "$header" || fail "$header: $standard"
    done
    for standard in c++11 c++17 c++20; do
        ${CXX:-c++} -std=$standard -Wall -Wextra -pedantic-errors -Werror -I "$include" -fsyntax-only -x c++ "$header" || fail "$header: $standard"
    done
    [ "$(wc -l <"$header")" -lt 200 ] || fail "$header has 200 lines or more"
    # Clients of the server are compiled with -I include/trocar, so a header named like a system header would hide it.
    name=$(basename "$header")
    ! ${CC:-cc} -E -x c -include "$name" /dev/null >/dev/null 2>&1 || fail "$name is also a system header"
    [ "$name" = trocar.h ] || grep -qF "#include \"trocar/$name\"" "$include/trocar.h" || fail "trocar.h does not include trocar/$name"
done

# Dumps the binary interface. Source paths are cut to start at core, so that the dump does not depend on the machine.
dump() {
    abidw --no-corpus-path --no-comp-dir-path --exported-interfaces-only --drop-undefined-syms --drop-private-types --headers-dir "$include" \
        --no-show-locs "$library" | sed "s| path='[^']*/core/| path='core/|"
}
if [ "${3:-}" = --renew ]; then
    dump >"$source/tests/public/libtrocar.abi"
else
    dump >"$build/trocar.abi"
    abidiff "$source/tests/public/libtrocar.abi" "$build/trocar.abi" ||
        fail "the binary interface has changed: raise the soname's version if incompatible, then run this test with --renew"
fi
echo passed
