#!/bin/bash
# Installs the wheel with pip on a minimal system, made with debootstrap, and simulates 1000 insertions there. Run it by hand, as root; it takes four minutes.
# Besides python3-pip, the system has Debian's NumPy and cffi, which the wheel requires, so PyPI is not needed.
# usage: bare_system.sh WHEEL [SUITE [MIRROR]]     by default bookworm, from the mirror that debootstrap chooses
set -euo pipefail
[ $# -ge 1 ] || { sed -n '2,4s/^# //p' "$0"; exit 2; }
wheel=$1 suite=${2:-bookworm}
root=$(mktemp -d)
trap 'umount "$root/proc" 2>/dev/null || true; rm -rf --one-file-system "$root"' EXIT
debootstrap --variant=minbase --include=python3-pip "$suite" "$root" ${3:+"$3"} >"$root.log" || { tail "$root.log" >&2; exit 1; }
rm "$root.log"
mount -t proc proc "$root/proc"
in_root() { chroot "$root" env -i PATH=/usr/local/bin:/usr/bin:/bin HOME=/root LC_ALL=C.UTF-8 "$@"; }
in_root sh -c 'apt-get -qq update && apt-get install -qq -y --no-install-recommends python3-numpy python3-cffi' >/dev/null 2>&1
cp "$wheel" "$root/tmp"
in_root pip install --no-index --break-system-packages --root-user-action=ignore "/tmp/${wheel##*/}"
in_root python3 - <<'END'
import time
from pathlib import Path

import numpy as np
import trocar

began = time.time()
model = trocar.Model(trocar.Scene.load(str(Path(trocar.__file__).parent / "gym/figure8.yaml")))
made = time.time()
poses = np.zeros((1000, 300, 7))    # at 1 kHz, 0.2 m/s, from 1 mm in front of the skin to a depth of 59 mm
poses[..., 0], poses[..., 1] = np.random.default_rng(1).uniform(-0.005, 0.005, (2, 1000, 1))
poses[..., 2], poses[..., 3] = -0.201 + np.linspace(0, 0.06, 300), 1
out = trocar.rollout(model, poses, threads=2)
assert np.isfinite(out["force"]).all() and out["depth"][:, -1].min() > 0.05
print(f"Python {'.'.join(map(str, __import__('sys').version_info[:3]))}, NumPy {np.__version__}: model {made - began:.1f} s, "
      f"1000 insertions {time.time() - made:.1f} s, sum of forces {out['force'].sum():.17g} N")
END
du -shx "$root" | sed "s|$root|the whole system|"
