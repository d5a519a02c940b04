#!/usr/bin/python3
"""Loads frames.h5 of trocar-study one insertion at a time, as data sets of PyTorch and the like want it.

usage: frames.py FRAMES.h5
"""
import sys

import h5py


class Insertions:
    """Insertion i: its parameters, and for each frame the base's pose, the force, and the nodes' displacements."""

    def __init__(self, path):
        self.file = h5py.File(path)
        self.nodes, self.time = self.file["nodes"][:], self.file["time"][:]

    def __len__(self):
        return len(self.file["run"])

    def __getitem__(self, i):
        return {name: self.file[name][i] for name in ("parameters", "pose", "force", "displacements")}


if __name__ == "__main__":
    insertions = Insertions(sys.argv[1])
    print(len(insertions), "insertions,", len(insertions.time), "frames,", len(insertions.nodes), "nodes")
    print({name: values.shape for name, values in insertions[0].items()})
