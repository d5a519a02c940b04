#!/usr/bin/python3
"""Loads frames.h5 of trocar-study one insertion at a time, in the form that data sets of PyTorch and similar libraries require, even with several workers:

    torch.utils.data.DataLoader(Insertions("frames.h5"), batch_size=8, shuffle=True, num_workers=2)

usage: frames.py FRAMES.h5
"""
import os
import sys

import h5py


class Insertions:
    """Returns insertion i: its parameters, and for each frame the base's pose, the force, and the nodes' displacements."""

    def __init__(self, path):
        self.path, self.opened = path, (None, None)
        with h5py.File(path) as file:
            self.nodes, self.time, self.count = file["nodes"][:], file["time"][:], len(file["run"])

    @property
    def file(self):
        """Processes, such as PyTorch's workers, cannot share an open HDF5 file, so each opens the file when it first reads from it."""
        process, file = self.opened
        if process != os.getpid():
            file = h5py.File(self.path)
            self.opened = os.getpid(), file
        return file

    def __getstate__(self):    # for spawned workers, which receive a pickled copy
        return dict(self.__dict__, opened=(None, None))

    def __len__(self):
        return self.count

    def __getitem__(self, i):
        return {name: self.file[name][i] for name in ("parameters", "pose", "force", "displacements")}


if __name__ == "__main__":
    insertions = Insertions(sys.argv[1])
    print(len(insertions), "insertions,", len(insertions.time), "frames,", len(insertions.nodes), "nodes")
    print({name: values.shape for name, values in insertions[0].items()})
