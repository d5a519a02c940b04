#!/usr/bin/python3
"""Loads frames.h5 of trocar-study one insertion at a time, as data sets of PyTorch and the like want it, also with workers.

usage: frames.py FRAMES.h5
"""
import os
import sys

import h5py


class Insertions:
    """Insertion i: its parameters, and for each frame the base's pose, the force, and the nodes' displacements."""

    def __init__(self, path):
        self.path, self.opened = path, (None, None)
        with h5py.File(path) as file:
            self.nodes, self.time, self.count = file["nodes"][:], file["time"][:], len(file["run"])

    @property
    def file(self):
        """HDF5's files cannot be shared by processes, such as PyTorch's workers: each opens its own when it first reads."""
        process, file = self.opened
        if process != os.getpid():
            file = h5py.File(self.path)
            self.opened = os.getpid(), file
        return file

    def __getstate__(self):    # for workers that are spawned
        return dict(self.__dict__, opened=(None, None))

    def __len__(self):
        return self.count

    def __getitem__(self, i):
        return {name: self.file[name][i] for name in ("parameters", "pose", "force", "displacements")}


if __name__ == "__main__":
    insertions = Insertions(sys.argv[1])
    print(len(insertions), "insertions,", len(insertions.time), "frames,", len(insertions.nodes), "nodes")
    print({name: values.shape for name, values in insertions[0].items()})
