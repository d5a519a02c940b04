"""Writes label maps as NRRD, with NumPy only."""
import gzip

import numpy as np


def write_nrrd(path, layers, place, names=None, space="left-posterior-superior"):
    """Writes a NRRD file. `layers`: one array (k, j, i), or several, as 3D Slicer writes labels that overlap; `names`: label -> name for the first layer, or
    (layer, label) -> name."""
    several = isinstance(layers, list)
    sign = np.diag([-1.0, -1.0, 1.0]) if space.startswith("right") else np.eye(3)
    vectors = ["(" + ",".join(f"{v:.9g}" for v in column) + ")" for column in (sign @ place[:3, :3]).T]
    origin = "(" + ",".join(f"{v:.9g}" for v in sign @ place[:3, 3]) + ")"
    sizes = [len(layers), *layers[0].shape[::-1]] if several else layers.shape[::-1]
    lines = ["NRRD0004", "type: unsigned char", f"dimension: {len(sizes)}", f"space: {space}", "sizes: " + " ".join(map(str, sizes)),
             "space directions: " + " ".join((["none"] if several else []) + vectors), f"space origin: {origin}", "encoding: gzip", "endian: little"]
    for n, (key, name) in enumerate((names or {}).items()):
        layer, value = key if several else (0, key)
        lines += [f"Segment{n}_Name:={name}", f"Segment{n}_Layer:={layer}", f"Segment{n}_LabelValue:={value}"]
    data = np.stack([layer.T for layer in layers]) if several else layers.T
    with open(path, "wb") as file:
        file.write(("\n".join(lines) + "\n\n").encode() + gzip.compress(data.astype(np.uint8).tobytes(order="F"), mtime=0))
