"""Describes HDF5 files so that other programs understand them: dimension scales, as in netCDF-4 (which xarray reads), units, version and the study's text."""
from __future__ import annotations

import json
from typing import Any, Sequence

import h5py
import numpy as np

from .. import __version__
from ._definition import Study

_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable. "    # how netCDF-4 marks a dimension without coordinates


def describe(file: h5py.File, study: Study, title: str) -> None:
    """Records in the file's attributes where the data come from; the attribute `manifest` (JSON) holds everything that the results depend on."""
    file.attrs.update({"title": title, "source": f"trocar {__version__}", "study": study.text, "manifest": json.dumps(study.manifest(), sort_keys=True)})


def scale(file: h5py.File, name: str, values: int | Sequence[str]) -> None:
    """Creates a dimension: of this length, or with these labels. An existing data set of this name becomes the dimension's coordinate."""
    if name in file:
        file[name].make_scale(name)
    elif isinstance(values, int):
        file.create_dataset(name, shape=(values,), dtype=">f4").make_scale(f"{_NO_VARIABLE}{values:10d}")
    else:
        file.create_dataset(name, data=list(values), dtype=h5py.string_dtype()).make_scale(name)


def attach(file: h5py.File, name: str, dimensions: Sequence[str], units: str = "", words: str = "") -> None:
    """Attaches dimension scales of the file to a data set, and records its unit and meaning."""
    data = file[name]
    for axis, dimension in zip(data.dims, dimensions, strict=True):
        axis.attach_scale(file[dimension])
    data.attrs.update({key: value for key, value in (("units", units), ("long_name", words)) if value})


def add_columns(file: h5py.File, name: str, values: Any, columns: Sequence[str]) -> None:
    """Writes a data set called `name`s (runs, columns). The dimension `name` labels its columns, and `name`_unit holds their units. Each entry of
    `columns` is a name, with its unit in brackets if it has one."""
    names, units = zip(*((column.removesuffix("]").rpartition(" [")[::2] if column.endswith("]") else (column, "")) for column in columns))
    table = f"{name}s"
    file[table] = np.asarray(values, np.float64).reshape(-1, len(columns))
    file[table].attrs["columns"] = columns
    scale(file, name, names)
    file.create_dataset(f"{name}_unit", data=list(units), dtype=h5py.string_dtype())
    attach(file, f"{name}_unit", (name,))
    attach(file, table, ("run", name))
