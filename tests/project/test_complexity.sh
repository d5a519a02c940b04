#!/bin/sh
# Checks that no function of the insertion step has a cyclomatic complexity (McCabe) above 11, as counted by pmccabe.
# usage: test_complexity.sh SOURCE_DIR
command -v pmccabe >/dev/null || { echo "skipped: install pmccabe"; exit 77; }
cd "$1" || exit 1
found=$(find core/insertion -name '*.c' -o -name '*.h' | xargs pmccabe) || exit 1
echo "$found" | sort -rn | head -n 1
[ "$(echo "$found" | wc -l)" -gt 300 ] || { echo "pmccabe found too few functions"; exit 1; }
echo "$found" | awk '$1 > 11 { print "too complex: " $0; bad = 1 } END { exit bad }'
