"""Makes HDF5 files self-describing: dimension scales as in netCDF-4, so that xarray can read them, units, the version, and the text of the study."""
from __future__ import annotations

import json
from typing import Any, Sequence

import h5py
import numpy as np

from .. import __version__
from ._definition import Study

_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable. "    # netCDF-4's marker for a dimension without coordinates


def describe(file: h5py.File, study: Study, title: str) -> None:
    """Records where the data come from in the file's attributes. The `manifest` attribute (JSON) holds everything that the results depend on."""
    file.attrs.update({"title": title, "source": f"trocar {__version__}", "study": study.text, "manifest": json.dumps(study.manifest(), sort_keys=True)})


def scale(file: h5py.File, name: str, values: int | Sequence[str]) -> None:
    """Creates a dimension with this length or these labels. If there is already a data set of this name, it becomes the dimension's coordinate."""
    if name in file:
        file[name].make_scale(name)
    elif isinstance(values, int):
        file.create_dataset(name, shape=(values,), dtype=">f4").make_scale(f"{_NO_VARIABLE}{values:10d}")
    else:
        file.create_dataset(name, data=list(values), dtype=h5py.string_dtype()).make_scale(name)


def attach(file: h5py.File, name: str, dimensions: Sequence[str], units: str = "", words: str = "") -> None:
    """Attaches dimension scales to a data set, and records its unit and meaning."""
    data = file[name]
    for axis, dimension in zip(data.dims, dimensions, strict=True):
        axis.attach_scale(file[dimension])
    data.attrs.update({key: value for key, value in (("units", units), ("long_name", words)) if value})


def add_columns(file: h5py.File, name: str, values: Any, columns: Sequence[str]) -> None:
    """Writes a data set `name`s (runs, columns), whose columns are labelled by the dimension `name` and have the units in `name`_unit. Each entry of
    `columns` is a name, followed by the unit in brackets if there is one."""
    names, units = zip(*((column.removesuffix("]").rpartition(" [")[::2] if column.endswith("]") else (column, "")) for column in columns))
    table = f"{name}s"
    file[table] = np.asarray(values, np.float64).reshape(-1, len(columns))
    file[table].attrs["columns"] = columns
    scale(file, name, names)
    file.create_dataset(f"{name}_unit", data=list(units), dtype=h5py.string_dtype())
    attach(file, f"{name}_unit", (name,))
    attach(file, table, ("run", name))
