"""Computes the dose from brachytherapy seeds according to AAPM TG-43. See the "dose" section of trocar.h."""
from __future__ import annotations

from os import PathLike, fspath
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .._library import _check, _Turn, ffi, lib

if TYPE_CHECKING:
    from .. import Model


def _vectors(values: npt.ArrayLike, what: str) -> npt.NDArray[np.float64]:
    vectors = np.ascontiguousarray(values, np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 3:
        raise ValueError("%s are (n, 3); got shape %s" % (what, vectors.shape))
    return vectors


def _three(values: npt.ArrayLike, what: str) -> list[float]:
    three = np.asarray(values, np.float64)
    if three.shape != (3,):
        raise ValueError("%s is three numbers; got shape %s" % (what, three.shape))
    return three.tolist()


def _inputs(array: npt.NDArray[Any], kind: str = "double[]") -> Any:
    return ffi.from_buffer(kind, array)


def _outputs(array: npt.NDArray[Any]) -> Any:
    return ffi.from_buffer("double[]", array, require_writable=True)


def _seed(position: npt.ArrayLike, direction: npt.ArrayLike, strength: float) -> Any:
    return ffi.new("trocar_dose_seed *", {"position": _three(position, "position"), "direction": _three(direction, "direction"), "strength": strength})


class Source:
    """A seed model: the TG-43 data for one type of seed. Immutable."""

    def __init__(self, name: str) -> None:
        """Loads the consensus data for "I-125 6711" or "Pd-103 200"."""
        self._create(lib.trocar_dose_source_create, name)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Source:
        """Reads a seed model from a table file. Raises Error; the message gives the file and line and says how to fix it."""
        source = cls.__new__(cls)
        source._create(lib.trocar_dose_source_load, fspath(path))
        return source

    def _create(self, create: Any, text: str) -> None:
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_dose_source **")
        _check(create(text.encode(), handle, why), why)
        self._handle = ffi.gc(handle[0], lib.trocar_dose_source_free)
        data = lib.trocar_dose_source_get(self._handle)
        self.name: str = ffi.string(data.name).decode(errors="replace")
        self.dose_rate_constant: float = data.dose_rate_constant
        self.active_length: float = data.active_length
        self.capsule_length: float = data.capsule_length
        self.capsule_diameter: float = data.capsule_diameter
        self.half_life: float = data.half_life

    def __copy__(self) -> Source:
        return self  # immutable, so sharing it is safe

    def __deepcopy__(self, _: Any) -> Source:
        return self

    def rates(self, positions: npt.ArrayLike, directions: npt.ArrayLike, strengths: npt.ArrayLike, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Returns the initial dose rates (n,) in Gy/h at points (n, 3) m from seeds with positions (m, 3) m, directions (m, 3) and air-kerma strengths
        (m,) U. Releases the GIL.
        """
        at, along, where = _vectors(positions, "positions"), _vectors(directions, "directions"), _vectors(points, "points")
        seeds = np.empty(len(at), _SEED)
        seeds["position"], seeds["direction"], seeds["strength"] = at, along, strengths
        rates, why = np.empty(len(where)), ffi.new("trocar_error *")
        _check(lib.trocar_dose_rates(self._handle, ffi.cast("trocar_dose_seed *", _inputs(seeds, "char[]")), len(seeds), _inputs(where), len(where),
                                     _outputs(rates), why), why)
        return rates

    def hours(self, hours: float = float("inf")) -> float:
        """Returns the factor, in h, by which to multiply an initial dose rate to get the dose accumulated in the first `hours`. The default, infinity,
        is right for a permanent implant."""
        return lib.trocar_dose_hours(self._handle, hours)


_SEED = np.dtype([("position", "f8", 3), ("direction", "f8", 3), ("strength", "f8")])
assert _SEED.itemsize == ffi.sizeof("trocar_dose_seed")


class Dose:
    """Dose of a permanent implant at many points. Only one thread at a time may use it; calls release the GIL.

    Sums are exact: removing a seed leaves every dose bit-identical to what it would be had the seed never been added.
    """

    def __init__(self, source: Source, origin: npt.ArrayLike, spacing: float, shape: tuple[int, int, int]) -> None:
        """Creates a Dose, without seeds yet, on a grid of `shape` voxels `spacing` m apart, with the centre of the first voxel at `origin` (3,) m."""
        grid = ffi.new("trocar_dose_grid *", {"origin": _three(origin, "origin"), "spacing": spacing, "counts": shape})
        self._create(source, tuple(shape), lambda handle, why: lib.trocar_dose_create(source._handle, grid, handle, why))

    @classmethod
    def at(cls, source: Source, points: npt.ArrayLike) -> Dose:
        """Creates a Dose for arbitrary points (n, 3) m instead of a grid."""
        where = _vectors(points, "points")
        dose = cls.__new__(cls)
        dose._create(source, (len(where),), lambda handle, why: lib.trocar_dose_create_points(source._handle, _inputs(where), len(where), handle, why))
        return dose

    def _create(self, source: Source, shape: tuple[int, ...], create: Any) -> None:
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_dose **")
        _check(create(handle, why), why)
        self.source, self.shape = source, shape
        self._handle, self._turn = ffi.gc(handle[0], lib.trocar_dose_free), _Turn("Dose")

    def __copy__(self) -> Dose:
        raise TypeError("a Dose cannot be copied: add its seeds to a second one")

    def __deepcopy__(self, _: Any) -> Dose:
        return self.__copy__()

    def add(self, position: npt.ArrayLike, direction: npt.ArrayLike, strength: float) -> int:
        """Adds a seed of air-kerma strength `strength` U at `position` (3,) m, oriented along `direction` (3,). Returns its id."""
        why, seed = ffi.new("trocar_error *"), ffi.new("int32_t *")
        with self._turn:
            _check(lib.trocar_dose_add(self._handle, _seed(position, direction, strength), seed, why), why)
        return seed[0]

    def remove(self, seed: int) -> None:
        """Removes the seed with this id."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_dose_remove(self._handle, seed, why), why)

    def move(self, seed: int, position: npt.ArrayLike, direction: npt.ArrayLike, strength: float) -> None:
        """Changes the position, direction and strength of the seed with this id."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_dose_move(self._handle, seed, _seed(position, direction, strength), why), why)

    def displace(self, displacements: npt.ArrayLike | None) -> None:
        """Displaces the points by (n, 3) m from their rest positions; None moves them back. Seeds do not move."""
        why, moved = ffi.new("trocar_error *"), None
        if displacements is not None:
            moved = np.ascontiguousarray(displacements, np.float64).reshape(-1, 3)
            if len(moved) != lib.trocar_dose_point_count(self._handle):
                raise ValueError("%d displacements for %d points" % (len(moved), lib.trocar_dose_point_count(self._handle)))
        with self._turn:
            _check(lib.trocar_dose_displace(self._handle, ffi.NULL if moved is None else _inputs(moved), why), why)

    @property
    def seeds(self) -> int:
        """Number of seeds."""
        with self._turn:
            return lib.trocar_dose_seed_count(self._handle)

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """The doses in Gy, as a copy: shape (nx, ny, nz) for a grid, otherwise (n,)."""
        values = np.empty(self.shape)
        with self._turn:
            lib.trocar_dose_values(self._handle, _outputs(values))
        return values


class Structure:
    """The voxels whose centres lie inside an organ at rest.

    points (n, 3) m: voxel centres, read-only; voxel: volume of one voxel, m^3.
    """

    def __init__(self, handle: Any) -> None:
        self._handle = ffi.gc(handle, lib.trocar_structure_free)
        count = lib.trocar_structure_count(self._handle)
        self.points: npt.NDArray[np.float64] = np.frombuffer(ffi.buffer(lib.trocar_structure_points(self._handle), 24 * count)).reshape(-1, 3).copy()
        self.points.flags.writeable = False
        self.voxel: float = lib.trocar_structure_voxel(self._handle)
        self._nodes: int | None = None  # number of nodes of the model's mesh, if made from a region

    def __copy__(self) -> Structure:
        return self  # immutable, so sharing it is safe

    def __deepcopy__(self, _: Any) -> Structure:
        return self

    @classmethod
    def from_surface(cls, nodes: npt.ArrayLike, triangles: npt.ArrayLike, spacing: float = 1e-3) -> Structure:
        """Voxelises a closed surface with nodes (n, 3) m and triangles (m, 3), which are node indices."""
        where, corners = _vectors(nodes, "nodes"), np.ascontiguousarray(triangles, np.int32).reshape(-1, 3)
        mesh = ffi.new("trocar_mesh *", {"node_count": len(where), "nodes": _inputs(where), "triangle_count": len(corners),
                                         "triangles": _inputs(corners, "int32_t[]")})
        return cls._made(lib.trocar_structure_from_surface, mesh, 0, spacing)

    @classmethod
    def from_region(cls, model: Model, region: str, spacing: float = 1e-3) -> Structure:
        """Voxelises a region of a model's mesh, including the regions that are part of it."""
        nodes, tets = model.nodes, model.tets_of(region)
        mesh = ffi.new("trocar_mesh *", {"node_count": len(nodes), "nodes": lib.trocar_model_nodes(model._handle), "tet_count": len(tets),
                                         "tets": _inputs(tets, "int32_t[]")})
        made = cls._made(lib.trocar_structure_from_region, mesh, 0, spacing)
        made._nodes = len(nodes)
        return made

    @classmethod
    def _made(cls, make: Any, mesh: Any, index: int, spacing: float) -> Structure:
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_structure **")
        _check(make(mesh, index, spacing, handle, why), why)
        return cls(handle[0])

    def displacements(self, nodal: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Interpolates nodal displacements, as returned by `Sim.displacements`, to the voxel centres: (n, 3) m. Only for structures made from a
        region."""
        nodal = _vectors(nodal, "displacements")
        if self._nodes is not None and len(nodal) != self._nodes:
            raise ValueError("%d displacements for a mesh of %d nodes" % (len(nodal), self._nodes))
        why, moved = ffi.new("trocar_error *"), np.empty_like(self.points)
        _check(lib.trocar_structure_displacements(self._handle, _inputs(nodal), _outputs(moved), why), why)
        return moved


class DVH:
    """Cumulative dose-volume histogram of voxels of equal size.

    doses (n,) Gy, largest first; voxel: volume of one voxel, m^3.
    """

    def __init__(self, doses: npt.ArrayLike, voxel: float) -> None:
        self.doses: npt.NDArray[np.float64] = np.array(doses, np.float64).ravel()
        self.voxel = voxel
        why = ffi.new("trocar_error *")
        _check(lib.trocar_dvh_sort(_outputs(self.doses), len(self.doses), why), why)

    def dose(self, fraction: float) -> float:
        """Returns the minimum dose (Gy) received by the hottest `fraction` of the volume; 0.9 gives D90."""
        return lib.trocar_dvh_dose(_inputs(self.doses), len(self.doses), fraction)

    def volume(self, dose: float) -> float:
        """Returns the fraction of the volume that receives at least `dose` Gy."""
        return lib.trocar_dvh_volume(_inputs(self.doses), len(self.doses), dose)

    def summary(self, prescription: float) -> dict[str, float]:
        """Returns the usual statistics for a prescription in Gy: mean, minimum, maximum, d10, d30, d80 and d90 in Gy; v100, v150 and v200 as fractions;
        and volume_cm3 and v100_cm3."""
        found = lib.trocar_dvh_summarise(_inputs(self.doses), len(self.doses), self.voxel, prescription)
        return {name: getattr(found, name) for name, _ in ffi.typeof("trocar_dvh_summary").fields}
