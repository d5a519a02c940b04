"""Frames of a study: displacement fields, contacts and wrenches at regular intervals, as training data for machine learning.

While a study is running, each run writes its own file in the `frames` folder. `trocar-study collect` merges them into frames.h5, whose data sets are
compressed, chunked by run, and have units and dimension scales, so that xarray can read them:

    time (frames) s                        parameters (runs, parameters), with parameter_unit, and names in the dimension `parameter`
    pose (runs, frames, 7)                 pose of the base: x y z (m), w x y z
    force, torque (runs, frames, 3)        N and N m, exerted by the base on the hand; torque about the base point
    depth (runs, frames) m                 length of the track
    centreline (runs, frames, joints, 3) m from base to tip
    displacements (runs, frames, nodes, 3) m, displacements of the mesh nodes, single precision
    contact_count (runs, frames)           number of entries used in the next three
    contact_position, contact_force (runs, frames, contacts, 3)    m, and N on the tissue
    contact_kind (runs, frames, contacts)  0 tissue, 1 tip, 2 guide
    run, ok (runs)                         index in the study; 1 if the run was finished
    nodes (nodes, 3) m at rest, tets (tets, 4), tet_regions (tets), with the attribute `names`
"""
from __future__ import annotations

import math
import shutil
from pathlib import Path
from types import TracebackType
from typing import Any

import h5py
import numpy as np

from .. import Model
from ._definition import Study
from .._files import replacing
from .._library import lib
from . import _hdf5
from ._estimate import size_in_words as _bytes
from ._quantities import Recording

__all__ = ["Writer", "collect", "size_in_words"]

_KINDS = {"tissue": 0, "tip": 1, "guide": 2}
_MESH = ("nodes", "tets", "tet_regions")
_COMPRESSED = {"compression": "gzip", "compression_opts": 4, "shuffle": True}
# for each data set: dimensions after run and time, unit, and description
_DATA = {"pose": (("pose_part",), "m and 1", "pose of the needle's base: position and quaternion"),
         "force": (("axis",), "N", "force of the base on the hand"), "torque": (("axis",), "N m", "torque of the base on the hand, about the base"),
         "depth": ((), "m", "length of the track"), "centreline": (("joint", "axis"), "m", "joints of the needle, from base to tip"),
         "displacements": (("node", "axis"), "m", "displacements of the mesh's nodes"), "contact_count": ((), "1", "number of contacts in use"),
         "contact_position": (("contact", "axis"), "m", "positions of the contacts"), "contact_force": (("contact", "axis"), "N", "forces of the contacts on the tissue"),
         "contact_kind": (("contact",), "1", "0 tissue, 1 tip, 2 guide")}
_LEFT = 0.65    # compression ratio: file size over the raw size of displacements and centrelines, as measured for the figure-8 insertion


def size_in_words(study: Study, folder: Path) -> str:
    """Returns a message with the approximate size of the frames of all runs and the free disk space in `folder`; "" if the study has no frames."""
    samples = study.samples()
    if not study.frames_every or not len(samples):
        return ""
    model = Model(study.run_scene(samples[0]), mesh_only=True)
    count = math.floor(study.run_motion(samples[0]).duration() / study.frames_every + 1e-9) + 1
    joints = lib.trocar_model_segments(model._handle) + 1
    each = _LEFT * count * (12 * len(model.nodes) + 24 * joints)
    return (f"frames: about {_bytes(each * len(samples))} for {len(samples)} runs ({count} frames of {len(model.nodes)} nodes each), and as much again once they are "
            f"collected in frames.h5; {_bytes(shutil.disk_usage(folder).free)} are free in {folder}")


class Writer:
    """Writes the frames of one run. The file appears under its name only once it is complete; after an exception, nothing is left behind."""

    def __init__(self, path: Path, model: Model):
        self.path, self.model = path, model
        self._frames: list[dict[str, Any]] = []

    def __enter__(self) -> Writer:
        return self

    def add(self, time: float, recording: Recording) -> None:
        sim, out = recording.sim, recording.outputs[-1][-1]
        contacts = sim.contacts()
        room = lib.TROCAR_MAX_POINTS
        place, force, kind = np.zeros((room, 3), np.float32), np.zeros((room, 3), np.float32), np.zeros(room, np.uint8)
        for i, contact in enumerate(contacts):
            place[i], force[i], kind[i] = contact.position, contact.force, _KINDS[contact.kind]
        self._frames.append({"time": time, "pose": recording.poses[-1][-1], "force": out["force"], "torque": out["torque"], "depth": out["depth"],
                             "centreline": sim.centreline(), "displacements": recording.displacements().astype(np.float32),
                             "contact_count": np.uint8(len(contacts)), "contact_position": place, "contact_force": force, "contact_kind": kind})

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is not None:
            return
        with replacing(self.path) as temporary, h5py.File(temporary, "w") as file:
            for name in self._frames[0]:
                file.create_dataset(name, data=np.stack([frame[name] for frame in self._frames]), **_COMPRESSED)
            for name in _MESH:
                file.create_dataset(name, data=getattr(self.model, name), **_COMPRESSED)
            file["tet_regions"].attrs["names"] = self.model.groups


def _describe(file: h5py.File, study: Study) -> None:
    _hdf5.describe(file, study, "Frames of a study")
    _hdf5.scale(file, "run", 0)
    _hdf5.scale(file, "time", 0)
    _hdf5.scale(file, "axis", "xyz")
    _hdf5.scale(file, "pose_part", ("x", "y", "z", "qw", "qx", "qy", "qz"))
    for name, size in (("node", len(file["nodes"])), ("tet", len(file["tets"])), ("corner", 4), ("joint", file["centreline"].shape[2]),
                       ("contact", file["contact_kind"].shape[2])):
        _hdf5.scale(file, name, size)
    file["time"].attrs["units"] = "s"
    _hdf5.attach(file, "ok", ("run",), "1", "1 if the run has frames")
    _hdf5.attach(file, "nodes", ("node", "axis"), "m", "nodes of the mesh at rest")
    _hdf5.attach(file, "tets", ("tet", "corner"), "1", "nodes of the tetrahedra")
    _hdf5.attach(file, "tet_regions", ("tet",), "1", "region of each tetrahedron: index of the attribute `names`")
    for name, (dimensions, units, words) in _DATA.items():
        _hdf5.attach(file, name, ("run", "time", *dimensions), units, words)


def collect(folder: Path, path: Path, study: Study, parameters: np.ndarray) -> int:
    """Merges the files of all runs in `folder` into one. parameters (runs, p): the parameter values of the runs. Returns how many runs have frames."""
    files = sorted(folder.glob("*.h5"))
    files = [file for file in files if int(file.stem) < len(parameters)]
    if not files:
        return 0
    with replacing(path) as temporary, h5py.File(temporary, "w") as whole:
        with h5py.File(files[0]) as first:
            for name, data in first.items():
                if name in (*_MESH, "time"):
                    first.copy(name, whole)
                else:    # chunks of at most 1 MB, or of a single frame if that is larger
                    each = max(1, min(len(data), (1 << 20) // max(data[0:1].nbytes, 1)))
                    whole.create_dataset(name, shape=(len(files), *data.shape), dtype=data.dtype, chunks=(1, each, *data.shape[1:]), **_COMPRESSED)
        whole["run"] = np.array([int(file.stem) for file in files], np.int64)
        whole["ok"] = np.zeros(len(files), np.uint8)
        _describe(whole, study)
        _hdf5.add_columns(whole, "parameter", parameters[whole["run"][:]], study.parameter_columns())
        whole["parameters"].attrs["names"] = study.parameter_columns()
        for i, file in enumerate(files):
            with h5py.File(file) as run:
                if run["time"].shape != whole["time"].shape:
                    continue
                for name, data in run.items():
                    if name not in (*_MESH, "time"):
                        whole[name][i] = data[:]
            whole["ok"][i] = 1
    return len(files)
