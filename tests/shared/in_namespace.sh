# Tests source this file with the absolute paths BUILD_DIR and SOURCE_DIR as arguments. It continues the test in a private network namespace, or exits with
# status 77 if that is not permitted. It sets `build`, `source` and `work`, a temporary folder. When the test exits, its background jobs are stopped and the
# folder is removed.
build=$1 source=$2
if [ "${3:-}" != --inside ]; then
    "$source/scripts/netns" true || exit 77
    exec "$source/scripts/netns" "$0" "$build" "$source" --inside
fi
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
