"""Runs a test inside a private network namespace."""
import os
import subprocess
import sys

INSIDE = "TROCAR_TEST_INSIDE"


def in_namespace(source):
    """Runs this program again inside a private network namespace. Exits with status 77 if that is not permitted."""
    if os.environ.get(INSIDE):
        return
    netns = f"{source}/scripts/netns"
    if subprocess.run([netns, "true"]).returncode != 0:
        sys.exit(77)
    os.environ[INSIDE] = "1"
    os.execv(netns, [netns, sys.executable, *sys.argv])
