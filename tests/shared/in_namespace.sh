# Sourced by tests with the arguments BUILD_DIR SOURCE_DIR (absolute). Runs the test in a private network namespace; status 77 where that
# is not permitted. Sets build, source, and work, a temporary folder. At the end, background jobs are stopped and the folder is removed.
build=$1 source=$2
if [ "${3:-}" != --inside ]; then
    "$source/scripts/netns" true || exit 77
    exec "$source/scripts/netns" "$0" "$build" "$source" --inside
fi
work=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$work"' EXIT
