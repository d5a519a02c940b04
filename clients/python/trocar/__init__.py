"""trocar: simulates a flexible needle in soft tissue.

This is a thin wrapper around libtrocar (see trocar.h). Arrays are NumPy arrays, units are SI, and the world frame is the mesh frame. A `Scene` describes
a simulation. A `Model` is built from a scene once and never changes; a `Sim` holds all mutable state. `rollout` runs many insertions in parallel, and a
`Batch` steps many simulations together.

    >>> import trocar
    >>> model = trocar.Model(trocar.Scene.load("figure8.yaml"))
    >>> sim = trocar.Sim(model)
    >>> sim.reset([0.005, 0.003, -0.201, 1, 0, 0, 0])
    >>> out = sim.step([0.005, 0.003, -0.190, 1, 0, 0, 0], dt=0.001)
    >>> out.force
    array([...])

The library logs messages, for example about the inverse it chose or about mesh repairs, to the "trocar" logger at level INFO or WARNING.

A pose is seven numbers: the position x, y, z (m) and orientation w, x, y, z (unit quaternion, needle frame -> world frame) of the needle's base.
"""
from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag
from os import PathLike, fspath
from typing import Any, Callable, Iterator, Mapping, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from ._library import Error, _check, _Turn, _Watch, _write_log, ffi, lib

__all__ = ["Batch", "Contact", "Derivatives", "Error", "Event", "Guide", "Key", "Mesh", "Model", "Output", "Probe", "Scene", "Seed", "SeedSize", "Sim", "Track", "keys", "rollout"]
__version__ = "%d.%d.%d" % (lib.trocar_version() // 10000, lib.trocar_version() // 100 % 100, lib.trocar_version() % 100)


class Event(IntFlag):
    """Bits of `Output.events`, as in trocar.h."""

    TOUCHED = lib.TROCAR_EVENT_TOUCHED
    PUNCTURED = lib.TROCAR_EVENT_PUNCTURED
    ADDED = lib.TROCAR_EVENT_ADDED
    REMOVED = lib.TROCAR_EVENT_REMOVED
    EXITED = lib.TROCAR_EVENT_EXITED
    REENTERED = lib.TROCAR_EVENT_REENTERED
    WITHDRAWN = lib.TROCAR_EVENT_WITHDRAWN
    LATE = lib.TROCAR_EVENT_LATE
    FULL = lib.TROCAR_EVENT_FULL
    UNSTABLE = lib.TROCAR_EVENT_UNSTABLE
    KEPT = lib.TROCAR_EVENT_KEPT
    MISSED_GUIDE = lib.TROCAR_EVENT_MISSED_GUIDE
    OUTSIDE_MODEL = lib.TROCAR_EVENT_OUTSIDE_MODEL
    TRACK_DROPPED = lib.TROCAR_EVENT_TRACK_DROPPED
    INEXACT = lib.TROCAR_EVENT_INEXACT


class Output(NamedTuple):
    """The result of one tick.

    force (3,) N and torque (3,) N m: what the needle's base exerts on the hand, in the world frame, with the torque about the base point; depth, m:
    length of the track in the tissue; contacts: number of active contacts along the shaft; events: bits of `Event`; membrane: index of the membrane
    punctured in this tick, or -1; passes: number of Newton iterations; switches: how often contacts changed between sticking and sliding during the
    solve.
    """

    force: npt.NDArray[np.float64]
    torque: npt.NDArray[np.float64]
    depth: float
    contacts: int
    events: int
    membrane: int
    passes: int
    switches: int


_PROPERTIES = ("cutting_force", "cutting_viscosity", "friction_static", "friction_kinetic", "friction_viscous", "youngs_modulus")


class Derivatives(NamedTuple):
    """Derivatives of a tick's results with respect to V variables (see `Sim.differentiate`), in the world frame."""

    wrench: npt.NDArray[np.float64]     #: (6, V): force (N) and torque (N m) on the hand
    tip: npt.NDArray[np.float64]        #: (3, V): position of the tip, m
    direction: npt.NDArray[np.float64]  #: (3, V): direction in which the tip points, a unit vector
    targets: npt.NDArray[np.float64]    #: (T, 3, V): positions of the targets, m
    range: npt.NDArray[np.float64]      #: (6,), m and rad: by how much each base variable can change before a contact sticks or slips, extrapolated linearly


def _contact_names(enum: str) -> dict[int, str]:
    """Returns a dict from the values of a C enum to short names: TROCAR_CONTACT_TIP becomes "tip"."""
    return {value: name.removeprefix("TROCAR_CONTACT_").lower() for value, name in ffi.typeof(enum).elements.items()}


_CONTACT_KIND = _contact_names("trocar_contact_kind")
_CONTACT_STATUS = _contact_names("trocar_contact_status")


class Contact(NamedTuple):
    """A point where the needle touches tissue or a guide. force (3,) N is the force on the tissue or guide; position (3,) m is a point on the deformed
    needle.

    A tissue contact keeps its id and slot for as long as it exists. A needle never reuses an id, but it does reuse slots.
    """

    kind: str  # "tissue", "tip" or "guide"
    state: int  # 0: sticking; 1: sliding forward; -1: sliding backward
    arc: float  # m, arc length from the base
    depth: float  # m, depth along the track
    position: npt.NDArray[np.float64]
    force: npt.NDArray[np.float64]
    id: int  # identifies the contact; 0 for the tip
    status: str  # "planned" while ahead of the tip, "adding" while the worker prepares it, then "sticking" or "sliding"
    slot: int  # index of the contact's slot; -1 for the tip
    needle: int  # index of the needle


class Track(NamedTuple):
    """A path that a needle has cut since its last reset. The cut remains when the needle is withdrawn.

    points (n, 3) m: the path in the tissue at rest, from skin to tip, at most 4 mm between points; membranes (n,): for each point, the index in the
    scene of the membrane punctured there, or -1.
    """

    points: npt.NDArray[np.float64]
    membranes: npt.NDArray[np.int32]


class Seed(NamedTuple):
    """A seed that a needle has left in the tissue.

    position (3,) m is the seed's centre; direction (3,) is the unit vector from its proximal to its distal end. Both refer to the tissue at rest. Use
    `Model.displaced_seeds` to get them for displaced tissue.
    """

    position: npt.NDArray[np.float64]
    direction: npt.NDArray[np.float64]
    needle: int  # index of the needle that left the seed
    guide: int | None  # index of the guide through which the needle passed
    hole: int | None  # index of the hole in that guide: column + columns * row, both counted from 0
    strand: int  # position of the seed in its strand, counted from 0 at the distal end
    tet: int  # index of the tetrahedron that contains the seed's centre
    weights: npt.NDArray[np.float64]  # (4,) barycentric coordinates of the centre in that tetrahedron


class Guide(NamedTuple):
    """A needle guide. The axis of hole (column, row), both counted from 0, meets the front face at
    `origin + (column - (columns - 1) / 2) * spacing * across[0] + (row - (rows - 1) / 2) * spacing * across[1]`.

    origin (3,) m; normal (3,): unit vector along which needles pass through the plate; across (2, 3): unit vectors along which columns and rows are counted.
    """

    name: str
    origin: npt.NDArray[np.float64]
    normal: npt.NDArray[np.float64]
    across: npt.NDArray[np.float64]
    columns: int
    rows: int
    spacing: float  # m
    hole_diameter: float  # m
    thickness: float  # m


class SeedSize(NamedTuple):
    """Dimensions and spacing (m) of the seeds, from the scene's `seeds.*` keys."""

    length: float
    diameter: float
    spacing: float  # centre-to-centre spacing of the seeds in a strand


class Probe(NamedTuple):
    """State of the ultrasound probe, as last computed.

    pose (7,): pose of the probe's base; force (3,) N and torque (3,) N m: what the probe exerts on the hand, in the world frame, with the torque about the
    base point; contacts: number of points on the tissue surface that the probe presses on; stopped: true while the tissue holds the probe back from the
    commanded pose, and until the probe has then caught up with that pose.
    """

    pose: npt.NDArray[np.float64]
    force: npt.NDArray[np.float64]
    torque: npt.NDArray[np.float64]
    contacts: int
    stopped: bool


class Key(NamedTuple):
    """A key of the scene file and what the reference table says about it."""

    key: str
    unit: str
    accepts: str
    default: str
    doc: str
    required: bool
    kind: str  # "number", "text", "numbers" or "names"


_KEY_KIND = {value: name.removeprefix("TROCAR_KEY_").lower() for value, name in ffi.typeof("trocar_key_kind").elements.items()}


def keys() -> list[Key]:
    """Returns all keys that a scene file may contain."""
    rows = (lib.trocar_key_at(i) for i in range(lib.trocar_key_count()))
    text = lambda value: ffi.string(value).decode()
    return [Key(text(r.key), text(r.unit), text(r.accepts), text(r.default_value), text(r.doc), bool(r.required), _KEY_KIND[r.kind]) for r in rows]


def _pattern(key: str) -> str:
    """Removes the name between the brackets of a key: regions[gland].friction.static becomes regions[].friction.static."""
    first, bracket, rest = key.partition("[")
    return first + "[]" + rest.rpartition("]")[2] if bracket else key


_KIND_OF = {key.key: key.kind for key in keys()}  # list entries appear here as "regions[]..."; see _pattern


@dataclass
class Mesh:
    """A tetrahedral mesh in memory.

    nodes (n, 3) m; tets (m, 4): node indices; regions: names; tet_region (m,): index into `regions` for each tetrahedron; surfaces: names; triangles
    (k, 3): node indices; triangle_surface (k,): index into `surfaces` for each triangle.
    """

    nodes: npt.ArrayLike
    tets: npt.ArrayLike
    regions: Sequence[str]
    tet_region: npt.ArrayLike | None = None
    surfaces: Sequence[str] = ()
    triangles: npt.ArrayLike = ()
    triangle_surface: npt.ArrayLike = ()


class Scene:
    """Description of a simulation: the keys of a scene file and their values. `in` and iteration cover only the keys that have a value; iteration names
    list entries by index. Several threads may read a scene or build models from it at once, but changing it meanwhile raises Error."""

    def __init__(self) -> None:
        """Creates a scene with default values. Set `mesh`, `regions` and `fixed` before you use it."""
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_scene **")
        _check(lib.trocar_scene_create(handle, why), why)
        self._own(handle[0])

    def _own(self, handle: Any) -> None:
        self._handle, self._turn = ffi.gc(handle, lib.trocar_scene_free), _Turn("Scene")

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Scene:
        """Reads a scene from a YAML file. The message of an Error names the file, line and key."""
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_scene **")
        _check(lib.trocar_scene_load(fspath(path).encode(), handle, why), why)
        scene = cls.__new__(cls)
        scene._own(handle[0])
        return scene

    def __copy__(self) -> Scene:
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_scene **")
        with self._turn.to_read():
            _check(lib.trocar_scene_copy(self._handle, handle, why), why)
        scene = type(self).__new__(type(self))
        scene.__dict__.update(self.__dict__)
        scene._own(handle[0])
        return scene

    def __deepcopy__(self, _: Any) -> Scene:
        return self.__copy__()

    def copy(self) -> Scene:
        """Returns an independent copy."""
        return self.__copy__()

    def __contains__(self, key: object) -> bool:
        return isinstance(key, str) and self._text(key) not in (None, "", "[]")

    def __iter__(self) -> Iterator[str]:
        for pattern in _KIND_OF:
            list_, brackets, rest = pattern.partition("[]")
            count = self._count(list_) if brackets else 1
            for key in ([f"{list_}[{i}]{rest}" for i in range(count)] if brackets else [pattern]):
                if key in self:
                    yield key

    def _text(self, key: str, why: Any = ffi.NULL) -> str | None:
        """Returns the value as it would be written in YAML, "" if the key has no value, or None if there is no such key."""
        text = ffi.new("char[8192]")
        with self._turn.to_read():
            status = lib.trocar_scene_get(self._handle, key.encode(), text, 8192, why)
        return ffi.string(text).decode() if status == lib.TROCAR_OK else None

    def __setitem__(self, key: str, value: float | str | Sequence[str] | Sequence[float]) -> None:
        """Sets a key: scene["needle.length"] = 0.15, scene["regions[prostate].youngs_modulus"] = 20e3 or scene["fixed"] = ["back"].

        If the list has no entry of that name, one is appended. Raises Error and leaves the scene unchanged if the key or value is invalid.
        """
        why = ffi.new("trocar_error *")
        with self._turn:
            if isinstance(value, (int, float, np.number)):
                _check(lib.trocar_scene_set_number(self._handle, key.encode(), float(value), why), why)
                return
            if not isinstance(value, str):
                value = "[" + ", ".join(item if isinstance(item, str) else repr(float(item)) for item in value) + "]"
            _check(lib.trocar_scene_set(self._handle, key.encode(), value.encode(), why), why)

    def __getitem__(self, key: str) -> Any:
        """Returns the value of a key: a float, a str, or a list of either. A key that is not set gives "" or an empty list."""
        why = ffi.new("trocar_error *")
        text = self._text(key, why)
        if text is None:
            raise Error(ffi.string(why.text).decode(errors="replace"), "bad input")
        kind = _KIND_OF[_pattern(key)]
        if kind in ("numbers", "names"):
            items = [item for item in text.strip("[]").split(", ") if item]
            return items if kind == "names" else [float(item) for item in items]
        if kind == "number":
            return float("inf") if text == ".inf" else float(text)
        return text

    def names(self, list_: str) -> list[str]:
        """Returns the names of the entries of a list: "regions", "membranes", "sliding" or "guides"."""
        return [str(self[f"{list_}[{i}].name"]) for i in range(self._count(list_))]

    def impenetrable(self) -> list[str]:
        """Returns the names of the membranes with an infinite puncture force, such as bone."""
        return [name for i, name in enumerate(self.names("membranes")) if self[f"membranes[{i}].puncture_force"] == float("inf")]

    def _count(self, list_: str) -> int:
        with self._turn.to_read():
            return int(lib.trocar_scene_count(self._handle, list_.encode()))

    def set_mesh(self, mesh: Mesh) -> None:
        """Uses a mesh given as arrays instead of a mesh file. The arrays are copied."""
        nodes = np.ascontiguousarray(mesh.nodes, np.float64).reshape(-1, 3)
        tets = np.ascontiguousarray(mesh.tets, np.int32).reshape(-1, 4)
        region = np.ascontiguousarray(np.zeros(len(tets)) if mesh.tet_region is None else mesh.tet_region, np.int32)
        triangles = np.ascontiguousarray(mesh.triangles, np.int32).reshape(-1, 3)
        surface = np.ascontiguousarray(mesh.triangle_surface, np.int32).reshape(-1)
        if len(region) != len(tets) or len(surface) != len(triangles):
            raise ValueError("tet_region needs an entry for each tetrahedron, triangle_surface one for each triangle")
        names = [ffi.new("char[]", name.encode()) for name in (*mesh.regions, *mesh.surfaces)]
        listed = ffi.new("char *[]", names + [ffi.NULL])
        given = ffi.new("trocar_mesh *", {
            "node_count": len(nodes), "tet_count": len(tets), "nodes": ffi.from_buffer("double[]", nodes),
            "tets": ffi.from_buffer("int32_t[]", tets), "tet_region": ffi.from_buffer("int32_t[]", region),
            "region_count": len(mesh.regions), "regions": ffi.cast("char const *const *", listed),
            "triangle_count": len(triangles), "triangles": ffi.from_buffer("int32_t[]", triangles),
            "triangle_surface": ffi.from_buffer("int32_t[]", surface), "surface_count": len(mesh.surfaces),
            "surfaces": ffi.cast("char const *const *", listed + len(mesh.regions))})
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_scene_set_mesh(self._handle, given, why), why)


class _View:
    """Exposes memory owned by the library to NumPy, read-only. The owner stays alive for as long as any array refers to the view."""

    def __init__(self, pointer: Any, kind: str, shape: tuple[int, ...], owner: Any):
        address = int(ffi.cast("uintptr_t", pointer))
        self.__array_interface__ = {"data": (address, True), "typestr": np.dtype(kind).str, "shape": shape, "version": 3}
        self.owner = owner


class Model:
    """Mesh, stiffness matrix, its inverse, needle and materials. A model is immutable, so any number of simulations and threads can share it."""

    def __init__(self, scene: Scene, mesh_only: bool = False, progress: Callable[[str, float], Any] | None = None) -> None:
        """Builds the model. This takes seconds for a mesh with thousands of nodes; the GIL is released meanwhile. mesh_only: read only the mesh and its
        group names; such a model cannot be simulated.

        progress(what, fraction) is called during long steps. An exception raised in it, or Ctrl-C, aborts the call, except while the mesh is being read
        or a matrix factorised.
        """
        why, handle, watch = ffi.new("trocar_error *"), ffi.new("trocar_model **"), _Watch(progress)
        options = ffi.new("trocar_model_options *", lib.trocar_default_model_options())
        options.watch, options.log.write, options.mesh_only = watch.pointer[0], _write_log, mesh_only
        with scene._turn.to_read():
            status = lib.trocar_model_create(scene._handle, options, handle, why)
        if handle[0]:
            self._handle = ffi.gc(handle[0], lib.trocar_model_free)
        watch.check(status, why)
        self._scene = scene.copy()
        self._guide_names = scene.names("guides")

    def __copy__(self) -> Model:
        return self  # immutable, so sharing it is safe

    def __deepcopy__(self, _: Any) -> Model:
        return self

    @property
    def scene(self) -> Scene:
        """A copy of the scene that the model was built from."""
        return self._scene.copy()

    def derive(self, scene: Scene | None = None, /, **changes: float | str | Sequence[str] | Sequence[float]) -> Model:
        """Builds a model of a modified scene in milliseconds by sharing this model's mesh, stiffness matrix and inverse. The modified scene is `scene`
        (default: this model's scene) with `changes` applied: model.derive(**{"needle.outer_diameter": 1e-3}). Needle, friction, cutting, puncture
        forces, relaxation, guides and seeds may change. A change that affects the stiffness matrix raises an Error that names the key."""
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_model **")
        changed = (scene or self._scene).copy()
        for key, value in changes.items():
            changed[key] = value
        _check(lib.trocar_model_derive(self._handle, changed._handle, handle, why), why)
        model = Model.__new__(Model)
        model._handle = ffi.gc(handle[0], lib.trocar_model_free)
        model._scene, model._guide_names = changed, changed.names("guides")
        return model

    @property
    def nodes(self) -> npt.NDArray[np.float64]:
        """Nodes of the mesh at rest, (n, 3) m; read-only, not a copy."""
        return np.asarray(_View(lib.trocar_model_nodes(self._handle), "f8", (lib.trocar_model_node_count(self._handle), 3), self))

    @property
    def tets(self) -> npt.NDArray[np.int32]:
        """Node indices of the tetrahedra, (m, 4); read-only, not a copy."""
        return np.asarray(_View(lib.trocar_model_tets(self._handle), "i4", (lib.trocar_model_tet_count(self._handle), 4), self))

    @property
    def tet_regions(self) -> npt.NDArray[np.int32]:
        """Index into `groups` for each tetrahedron, (m,); read-only, not a copy."""
        return np.asarray(_View(lib.trocar_model_tet_regions(self._handle), "i4", (lib.trocar_model_tet_count(self._handle),), self))

    @property
    def part_of(self) -> npt.NDArray[np.int32]:
        """For each group, the index of the region that it is part of (the scene's part_of), or its own index; (groups,)."""
        return np.array([lib.trocar_model_part_of(self._handle, i) for i in range(len(self.groups))], np.int32)

    def tets_of(self, region: str) -> npt.NDArray[np.int32]:
        """Returns the tetrahedra of a region, including the regions that are part of it, as node indices (k, 4). Raises ValueError if there is no such
        region."""
        index = lib.trocar_model_find_region(self._handle, region.encode(), 3)
        if index < 0:
            raise ValueError('no region "%s" of tetrahedra: there are %s' % (region, ", ".join(self.groups)))
        return self.tets[(self.tet_regions == index) | (self.part_of[self.tet_regions] == index)]

    def surface(self, name: str) -> npt.NDArray[np.int32]:
        """Returns the triangles of a surface as node indices (k, 3). Raises ValueError if the mesh has no such surface."""
        if name not in self.groups:
            raise ValueError("the mesh has no surface \"%s\": it has %s" % (name, ", ".join(self.groups)))
        shape = (lib.trocar_model_tet_count(self._handle), 4)
        bits = np.asarray(_View(lib.trocar_model_face_surfaces(self._handle), "u4", shape, self))
        tets, opposite = np.nonzero(bits >> self.groups.index(name) & 1)
        return np.array([np.delete(self.tets[t], corner) for t, corner in zip(tets, opposite)], np.int32).reshape(-1, 3)

    @property
    def groups(self) -> list[str]:
        """Names of the mesh's groups (regions, surfaces and points)."""
        count = lib.trocar_model_region_count(self._handle)
        return [ffi.string(lib.trocar_model_region_name(self._handle, i)).decode() for i in range(count)]

    @property
    def inverse(self) -> str:
        """Kind of inverse: "dense", "sparse" or "condensed"."""
        return ffi.string(lib.trocar_model_inverse(self._handle)).decode()

    @property
    def description(self) -> str:
        """Text that says which inverse was chosen, and why."""
        return ffi.string(lib.trocar_model_description(self._handle)).decode()

    @property
    def rate_hz(self) -> float:
        """The scene's rate_hz."""
        return lib.trocar_model_rate(self._handle)

    @property
    def start(self) -> npt.NDArray[np.float64] | None:
        """Pose of the first needle's base before the insertion: x y z (m), w x y z. None if the scene has no needle.start."""
        pose = ffi.new("trocar_pose *")
        return np.array([*pose.position, *pose.orientation]) if lib.trocar_model_start(self._handle, pose) else None

    @property
    def probe_start(self) -> npt.NDArray[np.float64] | None:
        """Initial pose of the probe's base: x y z (m), w x y z. None if the scene has no probe or no probe.start."""
        pose = ffi.new("trocar_pose *")
        return np.array([*pose.position, *pose.orientation]) if lib.trocar_model_probe_start(self._handle, pose) else None

    @property
    def needles(self) -> int:
        """Number of needles in a simulation."""
        return lib.trocar_model_needles(self._handle)

    @property
    def patient_to_mesh(self) -> npt.NDArray[np.float64] | None:
        """Transform (4, 4) from patient coordinates (DICOM, mm) to mesh coordinates (m). None if the scene does not define patient coordinates."""
        matrix = ffi.new("double[16]")
        return np.array(list(matrix)).reshape(4, 4) if lib.trocar_model_patient_to_mesh(self._handle, matrix) else None

    @property
    def needle_length(self) -> float:
        """Length of the needle from base to tip, m."""
        return lib.trocar_model_needle_length(self._handle)

    @property
    def guides(self) -> list[Guide]:
        """The scene's guides, in the order of the scene."""
        found = []
        for i in range(lib.trocar_model_guide_count(self._handle)):
            g = lib.trocar_model_guide(self._handle, i)
            found.append(Guide(self._guide_names[i], np.array(list(g.origin)), np.array(list(g.normal)), np.array([list(row) for row in g.across]),
                               g.columns, g.rows, g.spacing, g.hole_diameter, g.thickness))
        return found

    @property
    def seed_size(self) -> SeedSize:
        """Dimensions and spacing (m) of the seeds, from the scene's `seeds.*` keys."""
        size = lib.trocar_model_seed_size(self._handle)
        return SeedSize(size.length, size.diameter, size.spacing)

    def entry(self, start: npt.ArrayLike, end: npt.ArrayLike) -> npt.NDArray[np.float64] | None:
        """Returns the point (3,) m where the segment from `start` to `end` first enters the tissue at rest, or None if it doesn't."""
        point = ffi.new("double[3]")
        given = [ffi.new("double[3]", [float(x) for x in np.asarray(p, np.float64)]) for p in (start, end)]
        return np.array(list(point)) if lib.trocar_model_entry(self._handle, *given, point) else None

    def displaced_seeds(self, seeds: Sequence[Seed], displacements: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Returns the positions (k, 3) m and directions (k, 3) of seeds when the mesh nodes are displaced by `displacements` (n, 3) m."""
        field = np.ascontiguousarray(displacements, np.float64)
        if field.shape != self.nodes.shape:
            raise ValueError("displacements are %s; got shape %s" % (self.nodes.shape, field.shape))
        positions, directions = np.empty((len(seeds), 3)), np.empty((len(seeds), 3))
        place, along = ffi.new("double[3]"), ffi.new("double[3]")
        for i, seed in enumerate(seeds):
            given = ffi.new("trocar_seed *", {"position": list(seed.position), "direction": list(seed.direction), "weights": list(seed.weights),
                                              "tet": seed.tet})
            if not lib.trocar_model_displace_seed(self._handle, ffi.from_buffer("double[]", field), given, place, along):
                raise ValueError("seed %d is in tetrahedron %d, which the model does not have" % (i, seed.tet))
            positions[i], directions[i] = list(place), list(along)
        return positions, directions


def _pose(pose: npt.ArrayLike) -> Any:
    numbers = np.ascontiguousarray(pose, np.float64)
    if numbers.shape != (7,):
        raise ValueError("a pose is seven numbers: x y z (m), w x y z (unit quaternion); got shape %s" % (numbers.shape,))
    return ffi.cast("trocar_pose const *", ffi.from_buffer("double[]", numbers)), numbers


class Sim:
    """The state of a simulation: needles and tissue. Only one thread at a time may use it; a concurrent call raises Error. A copy starts in the same
    state and from then on is independent."""

    def __init__(self, model: Model) -> None:
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_sim **")
        _check(lib.trocar_sim_create(model._handle, handle, why), why)
        self.model = model
        self._handle = ffi.gc(handle[0], lib.trocar_sim_free)
        self._view = lib.trocar_sim_view(self._handle)
        self._out = ffi.new("trocar_output *")
        self._turn = _Turn("Sim")

    def __copy__(self) -> Sim:
        sim = type(self).__new__(type(self))
        sim.__dict__.update(self.__dict__)
        Sim.__init__(sim, self.model)
        sim.restore(self.save())
        return sim

    def __deepcopy__(self, _: Any) -> Sim:
        return self.__copy__()

    def _check_needle(self, needle: int) -> None:
        count = lib.trocar_model_needles(self.model._handle)
        if not 0 <= needle < count:
            raise Error("needle %d: %s; the scene's \"needles\" says how many" % (needle, "there is one, number 0" if count == 1 else "there are %d, numbers 0 to %d" %
                                                                                (count, count - 1)), "bad input")

    def reset(self, pose: npt.ArrayLike, needle: int = 0) -> None:
        """Puts the needle, straight, at `pose` (7,) and undoes everything that it did to the tissue. If the needle is in the tissue at this pose, it
        starts out inserted, with no force on it."""
        why = ffi.new("trocar_error *")
        pointer, _kept = _pose(pose)
        with self._turn:
            _check(lib.trocar_sim_reset(self._handle, needle, pointer, why), why)

    def step(self, pose: npt.ArrayLike, dt: float, needle: int = 0) -> Output:
        """Runs a tick of `dt` seconds with the base at `pose` (7,), then the mesh update that the tick asks for. Releases the GIL."""
        why = ffi.new("trocar_error *")
        pointer, _kept = _pose(pose)
        with self._turn:
            _check(lib.trocar_sim_step(self._handle, needle, pointer, dt, self._out, why), why)
            return self._output()

    def _output(self) -> Output:
        out = self._out
        return Output(np.array(list(out.force)), np.array(list(out.torque)), out.depth, out.contacts, out.events, out.membrane,
                      out.passes, out.switches)

    def differentiate(self, pose: npt.ArrayLike, dt: float, targets: npt.ArrayLike = (), parameters: Sequence[tuple[str, str]] = (),
                      needle: int = 0) -> tuple[Output, Derivatives]:
        """Runs a tick exactly as `step` does and also returns the derivatives of its results, with the state before the tick held fixed.

        The variables are the displacement of the base along x, y and z (m), its rotation about the world's x, y and z axes (rad), and then `parameters`:
        pairs of a property ("cutting_force", "cutting_viscosity", "friction_static", "friction_kinetic", "friction_viscous" or "youngs_modulus") and a
        region name. targets (T, 3): material points of the tissue, given by their positions at rest (m).

        dt must not exceed 0.001 s. Raises Error if a target is outside the tissue. If the result has no derivatives, raises Error after running the tick.
        Releases the GIL.
        """
        points = np.ascontiguousarray(targets, np.float64).reshape(-1, 3)
        count = 6 + len(parameters)
        arrays = {name: np.zeros(shape + (count,)) for name, shape in (("wrench", (6,)), ("tip", (3,)), ("direction", (3,)), ("targets", (len(points), 3)))}
        arrays["range"] = np.zeros(6)
        listed = ffi.new("trocar_parameter[]", [self._parameter(*pair) for pair in parameters])
        request = ffi.new("trocar_derivative_request *", {"parameters": listed, "parameter_count": len(parameters), "target_count": len(points),
                                                          "targets": ffi.from_buffer("double[]", points)})
        results = ffi.new("trocar_derivatives *", {name: ffi.from_buffer("double[]", array, require_writable=True) for name, array in arrays.items()})
        why = ffi.new("trocar_error *")
        pointer, _kept = _pose(pose)
        with self._turn:
            _check(lib.trocar_sim_differentiate(self._handle, needle, pointer, dt, request, self._out, results, why), why)
            return self._output(), Derivatives(**arrays)

    def _parameter(self, property_: str, region: str) -> dict[str, int]:
        number = getattr(lib, "TROCAR_" + property_.upper(), None) if property_ in _PROPERTIES else None
        if number is None:
            raise ValueError("%r is none of the properties %s" % (property_, ", ".join(_PROPERTIES)))
        return {"property": number, "region": lib.trocar_model_find_region(self.model._handle, region.encode(), 3)}

    def run(self, poses: npt.ArrayLike, dt: float, needle: int = 0, progress: Callable[[str, float], Any] | None = None) -> npt.NDArray[Any]:
        """Does what `step` does for each of the poses (steps, 7), faster than a Python loop. Returns a structured array (steps,) with the fields of
        `Output`. If a step fails, raises an Error that names it.

        progress("run", fraction) is called every 64 steps. An exception raised in it, or Ctrl-C, aborts the run.
        """
        given = np.ascontiguousarray(poses, np.float64)
        if given.ndim != 2 or given.shape[1] != 7:
            raise ValueError("poses are (steps, 7); got shape %s" % (given.shape,))
        outputs, why, watch = np.zeros(len(given), _OUTPUT), ffi.new("trocar_error *"), _Watch(progress)
        with self._turn:
            status = lib.trocar_sim_run(self._handle, needle, ffi.cast("trocar_pose const *", ffi.from_buffer("double[]", given)), len(given), dt,
                                        watch.pointer, ffi.cast("trocar_output *", ffi.from_buffer("char[]", outputs, require_writable=True)), why)
        watch.check(status, why)
        return outputs

    @property
    def time(self) -> float:
        """Simulated time (s) since this object was created: the sum of all `dt`. Ticks of several needles for the same period count once. The time is saved
        and restored with the state."""
        with self._turn:
            return lib.trocar_view_time(self._view)

    def change(self, values: Mapping[str, float], time: float = 0.5) -> None:
        """Changes parameters of the running simulation, for all needles: friction, cutting and puncture forces, moduli, calcifications and guides. For
        example, sim.change({"membranes[skin].puncture_force": 2.0}). `parameters` lists the keys. So that no force jumps, values move to their new setting
        over `time` (0.1 to 60) seconds of simulated time. A change to moduli builds a new model first, which takes as long as Model(). Raises Error and
        changes nothing if a key cannot change during a run, if a value is bad, or if moduli are still moving from an earlier change."""
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_change **")
        lines = "\n".join("%s: %s" % (key, ".inf" if value == np.inf else value) for key, value in values.items())
        with self._turn:
            _check(lib.trocar_change_create(self._handle, handle, why), why)
            change = ffi.gc(handle[0], lib.trocar_change_free)
            _check(lib.trocar_change_set(change, lines.encode(), why), why)
            _check(lib.trocar_change_prepare(change, ffi.NULL, why), why)
            _check(lib.trocar_sim_change(self._handle, change, time, why), why)

    @property
    def parameters(self) -> dict[str, float]:
        """The keys that `change` accepts, and their values: during a change, the values being moved to."""
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_change **")
        key, value, found = ffi.new("char[]", lib.TROCAR_CHANGE_KEY), ffi.new("double *"), {}
        with self._turn:
            _check(lib.trocar_change_create(self._handle, handle, why), why)
        change = ffi.gc(handle[0], lib.trocar_change_free)
        for index in range(lib.trocar_change_count(change)):
            lib.trocar_change_at(change, index, key, value)
            found[ffi.string(key).decode(errors="replace")] = value[0]
        return found

    @property
    def changing(self) -> float:
        """Simulated time (s) until the last change is complete; 0 if none is under way."""
        with self._turn:
            return lib.trocar_sim_changing(self._handle)

    def set_probe(self, pose: npt.ArrayLike) -> None:
        """Moves the probe's base to `pose` (7,): x y z (m), w x y z. This takes effect at the start of the next `step`."""
        why = ffi.new("trocar_error *")
        pointer, _kept = _pose(pose)
        with self._turn:
            _check(lib.trocar_sim_set_probe(self._handle, pointer, why), why)

    @property
    def probe(self) -> Probe | None:
        """Returns the state of the probe as last computed, or None if the scene has no probe or it has not been placed yet."""
        with self._turn:
            p = lib.trocar_view_probe(self._view)
        if not p.placed:
            return None
        return Probe(np.array([*p.base.position, *p.base.orientation]), np.array(list(p.force)), np.array(list(p.torque)), p.contacts,
                     bool(p.stopped))

    def leave(self, needle: int = 0) -> None:
        """Lets go of a needle's base, leaving the needle resting in the tissue and guides."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_leave(self._handle, needle, why), why)
            _check(lib.trocar_sim_work(self._handle, ffi.NULL, why), why)

    def take(self, needle: int = 0) -> None:
        """Takes hold of a resting needle again. Start from the pose `base(needle)`."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_take(self._handle, needle, why), why)
            _check(lib.trocar_sim_work(self._handle, ffi.NULL, why), why)

    def needle_state(self, needle: int = 0) -> str:
        """Returns "held" (also for a needle outside the tissue), "leaving", "resting" or "taking"."""
        self._check_needle(needle)
        with self._turn:
            return ("held", "leaving", "resting", "taking")[lib.trocar_sim_needle_state(self._handle, needle)]

    def base(self, needle: int = 0) -> npt.NDArray[np.float64]:
        """Returns the pose of the needle's base: x y z (m) and the quaternion w x y z."""
        self._check_needle(needle)
        with self._turn:
            pose = lib.trocar_view_base(self._view, needle)
        return np.array([*pose.position, *pose.orientation])

    def save(self) -> bytes:
        """Returns the complete state, about 10 to 300 kB. You may store it in a file: any simulation of the same model, or of one built from an equal scene
        and mesh, can `restore` it, even in another process."""
        why, size = ffi.new("trocar_error *"), lib.trocar_sim_state_size(self._handle)
        state = np.empty(size, np.uint8)  # `size` is a generous upper bound, but pages that are never written cost no memory
        buffer = ffi.from_buffer(state, require_writable=True)
        with self._turn:
            _check(lib.trocar_sim_save(self._handle, buffer, size, why), why)
        return state[:lib.trocar_state_bytes(buffer)].tobytes()

    def restore(self, state: bytes) -> None:
        """Restores a state returned by `save`. Raises Error if it belongs to a different model, is damaged, or was saved by another version of the
        library."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_restore(self._handle, ffi.from_buffer(state), len(state), why), why)

    def contacts(self, needle: int = 0) -> list[Contact]:
        """Returns the contacts, ordered from base to tip. If the tip is in the tissue, its contact comes last."""
        return self._contacts(lib.trocar_view_contacts, needle)

    def pending_contacts(self, needle: int = 0) -> list[Contact]:
        """Returns the tissue contacts that carry no force yet, ordered from base to tip: those with status "adding", then at most one that is
        "planned"."""
        return self._contacts(lib.trocar_view_pending_contacts, needle)

    def _contacts(self, read: Any, needle: int) -> list[Contact]:
        self._check_needle(needle)
        room = lib.TROCAR_MAX_POINTS
        found = ffi.new("trocar_contact[]", room)
        with self._turn:
            count = read(self._view, needle, found, room)
        return [Contact(_CONTACT_KIND[c.kind], c.state, c.arc, c.depth, np.array(list(c.position)), np.array(list(c.force)), c.id,
                        _CONTACT_STATUS[c.status], c.slot, needle) for c in found[0:count]]

    def hole(self, guide: int, needle: int = 0) -> int | None:
        """Returns which hole of the guide the needle is in, as column + columns * row, counted from 0, or None if it is in none."""
        self._check_needle(needle)
        guides = lib.trocar_model_guide_count(self.model._handle)
        if not 0 <= guide < guides:
            raise Error("guide %d: the scene has %d, numbered from 0" % (guide, guides), "bad input")
        with self._turn:
            hole = int(lib.trocar_view_hole(self._view, needle, guide))
        return hole if hole >= 0 else None

    def tracks(self, needle: int = 0) -> list[Track]:
        """Returns the tracks that the needle has cut since its last reset, oldest first."""
        self._check_needle(needle)
        room = lib.TROCAR_MAX_TRACK_POINTS
        found = ffi.new("trocar_track_point[]", room)
        with self._turn:
            count = lib.trocar_view_tracks(self._view, needle, found, room)
        points = np.frombuffer(ffi.buffer(found, count * ffi.sizeof("trocar_track_point")), _TRACK_POINT)
        return [Track(part["position"].copy(), part["membrane"].copy())
                for part in (points[points["track"] == t] for t in np.unique(points["track"]))]

    def centreline(self, needle: int = 0) -> npt.NDArray[np.float64]:
        """Returns the positions of the needle's joints from base to tip, (segments + 1, 3) m."""
        self._check_needle(needle)
        joints = np.empty((lib.trocar_model_segments(self.model._handle) + 1, 3))
        with self._turn:
            lib.trocar_view_centreline(self._view, needle, ffi.from_buffer("double[]", joints, require_writable=True), len(joints))
        return joints

    def drop_seeds(self, count: int = 1, spacing: float = 0.0, needle: int = 0) -> None:
        """Drops a seed, or a strand of seeds whose centres are `spacing` m apart (0: the scene's spacing). The first seed's distal end is at the tip.

        A seed comes to rest in the tissue once the needle has been drawn back past it; until then it is pending. Raises Error and changes nothing if, for
        example, the tip is outside the tissue or earlier seeds are still pending.
        """
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_drop_seeds(self._handle, needle, count, spacing, why), why)

    def undo_seed(self, needle: int = 0) -> None:
        """Cancels the needle's pending seeds or, if none are pending, removes the last seed that it left."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_undo_seed(self._handle, needle, why), why)

    def clear_seeds(self, needle: int = 0) -> None:
        """Removes all seeds that the needle left, and cancels its pending seeds."""
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_sim_clear_seeds(self._handle, needle, why), why)

    def seeds(self) -> list[Seed]:
        """Returns the seeds left in the tissue, oldest first."""
        found = ffi.new("trocar_seed[]", lib.TROCAR_MAX_SEEDS)
        with self._turn:
            count = lib.trocar_view_seeds(self._view, found, lib.TROCAR_MAX_SEEDS)
        none_below_0 = lambda index: index if index >= 0 else None
        return [Seed(np.array(list(s.position)), np.array(list(s.direction)), s.needle, none_below_0(s.guide), none_below_0(s.hole), s.strand,
                     s.tet, np.array(list(s.weights))) for s in found[0:count]]

    def pending_seeds(self, needle: int = 0) -> int:
        """Returns the number of seeds that have been dropped but are still inside the needle."""
        self._check_needle(needle)
        with self._turn:
            return lib.trocar_view_pending_seeds(self._view, needle)

    def displacements(self) -> npt.NDArray[np.float64]:
        """Returns the displacements of the mesh nodes, (n, 3) m. Each call solves with the full stiffness matrix."""
        why = ffi.new("trocar_error *")
        field = np.empty((lib.trocar_model_node_count(self.model._handle), 3))
        with self._turn:
            _check(lib.trocar_view_displacements(self._view, ffi.from_buffer("double[]", field, require_writable=True), why), why)
        return field

    def tip_lead(self, needle: int = 0) -> float:
        """Returns by how much the tip has rotated about the needle's axis relative to the base, in rad. It is negative if the tip lags behind a base that
        turns in the positive sense."""
        self._check_needle(needle)
        with self._turn:
            return lib.trocar_view_tip_lead(self._view, needle)

    def needle_energy(self, needle: int = 0) -> float:
        """Returns the elastic energy of the bent needle, J."""
        self._check_needle(needle)
        with self._turn:
            return lib.trocar_view_needle_energy(self._view, needle)


_TRACK_POINT = np.dtype([("position", "f8", 3), ("tet", "i4"), ("track", "i4"), ("membrane", "i4"), ("reserved", "i4")], align=True)
_OUTPUT = np.dtype([("force", "f8", 3), ("torque", "f8", 3), ("depth", "f8"), ("contacts", "i4"), ("events", "u4"), ("membrane", "i4"),
                    ("passes", "i4"), ("switches", "i4")], align=True)
assert _OUTPUT.itemsize == ffi.sizeof("trocar_output")


def rollout(model: Model | Sequence[Model], poses: npt.ArrayLike, dt: float = 0.001, threads: int = 1, progress: Callable[[str, float], Any] | None = None,
            states: Sequence[bytes | None] | bytes | None = None) -> npt.NDArray[Any]:
    """Simulates many insertions.

    model: one model for all insertions, or one for each. poses (batch, steps, 7), or (batch, steps, needles, 7) to drive several needles. Each insertion
    starts in tissue at rest, with its needles at their first poses, and runs one tick of `dt` seconds per pose. states: start from states returned by
    `Sim.save` instead; give one for all insertions, or a state or None for each. A needle that is resting in its state is not ticked: its poses are
    ignored, and its force, torque and events are 0.

    Returns a structured array with the fields of `Output`, (batch, steps) or (batch, steps, needles), so result["force"] is (batch, steps, 3). The
    insertions run in `threads` threads with the GIL released. With a dense or condensed inverse, the results do not depend on the number of threads.

    progress("rollout", fraction) is called every 64 ticks. An exception raised in it, or Ctrl-C, aborts the rollout.
    """
    given = np.ascontiguousarray(poses, np.float64)
    if given.ndim not in (3, 4) or given.shape[-1] != 7:
        raise ValueError("poses are (batch, steps, 7) or (batch, steps, needles, 7); got shape %s" % (given.shape,))
    batch, steps, needles = given.shape[0], given.shape[1], given.shape[2] if given.ndim == 4 else 1
    models = [] if isinstance(model, Model) else list(model)
    held = [states] * batch if isinstance(states, bytes) else [] if states is None else list(states)
    for name, entries in (("models", models), ("states", held)):
        if entries and len(entries) != batch:
            raise ValueError("%d %s for %d insertions" % (len(entries), name, batch))
    if not isinstance(model, Model) and not models and batch:
        raise ValueError("a rollout needs a model")
    options = ffi.new("trocar_rollout_options *", {"dt": dt, "threads": threads, "needles": needles})
    outputs, why, watch = np.zeros(given.shape[:-1], _OUTPUT), ffi.new("trocar_error *"), _Watch(progress)
    options.watch = watch.pointer[0]
    handles = ffi.new("trocar_model *[]", [each._handle for each in models])
    buffers = [ffi.NULL if state is None else ffi.from_buffer("char[]", state) for state in held]
    pointers, sizes = ffi.new("void const *[]", buffers), ffi.new("size_t[]", [len(state or b"") for state in held])
    if models:
        options.models = ffi.cast("trocar_model *const *", handles)
    if held:
        options.states, options.state_sizes = ffi.cast("void const *const *", pointers), sizes
    status = lib.trocar_rollout(model._handle if isinstance(model, Model) else ffi.NULL,
                                ffi.cast("trocar_pose const *", ffi.from_buffer("double[]", given)), batch, steps, options,
                                ffi.cast("trocar_output *", ffi.from_buffer("char[]", outputs, require_writable=True)), why)
    watch.check(status, why)
    return outputs


# For each output of a batch: NumPy type, C type, shape of one entry, and whether each needle has its own entry.
_BATCH_OUTPUTS = {"force": ("f8", "double *", (3,), True), "torque": ("f8", "double *", (3,), True), "depth": ("f8", "double *", (), True),
                  "tip": ("f8", "trocar_pose *", (7,), True), "contacts": ("i4", "int32_t *", (), True), "events": ("u4", "uint32_t *", (), True),
                  "membrane": ("i4", "int32_t *", (), True), "passes": ("i4", "int32_t *", (), True), "switches": ("i4", "int32_t *", (), True),
                  "seeds": ("i4", "int32_t *", (), False)}


class Batch:
    """Several simulations, called rows, that the library steps together in its own threads, with the GIL released. The results do not depend on the
    number of threads: they are bit-identical to those of separate simulations given the same poses.

    `batch[row]` is the `Sim` of a row. Use it between calls to the batch for contacts, centreline, drop_seeds, leave, take, save and so on. Only one
    thread at a time may use a batch and its rows; a concurrent call raises Error. `len(batch)` is the number of rows.

    The outputs, with their shape for each row, step and needle, are force (3,) N and torque (3,) N m on the hand, in the world frame; depth, m;
    tip (7,): pose of the tip, with +z along the needle and +y in the direction that the bevel faces; and contacts, events, membrane, passes and
    switches as in `Output`. There is also seeds, the number of seeds in the tissue, for each row and step. A resting needle is not ticked: its pose is
    ignored, and its force, torque and events are 0.
    """

    def __init__(self, models: Model | Sequence[Model], count: int | None = None, threads: int = 0,
                 outputs: Sequence[str] = ("force", "torque", "depth", "tip", "contacts", "events", "membrane"), needles: int = 1) -> None:
        """models: one model for all rows, or several, of which row i simulates models[i % len(models)]. count: number of rows (default: one per model).
        threads: number of threads; 0 uses one per CPU available to the process. outputs: names of the arrays that `step` and `run` return; the others are
        not computed. needles: number of needles driven in each row, with indices 0 to needles - 1. Each row uses 5 to 7 MB of memory."""
        given = [models] if isinstance(models, Model) else list(models)
        rows = len(given) if count is None else count
        if not given or rows < 1:
            raise ValueError("a batch has at least one model and one row; got %d models and %d rows" % (len(given), rows))
        unknown = [name for name in outputs if name not in _BATCH_OUTPUTS]
        if unknown:
            raise ValueError("outputs: there is no \"%s\": choose from %s" % (unknown[0], ", ".join(_BATCH_OUTPUTS)))
        self._models = [given[i % len(given)] for i in range(rows)]
        why, handle = ffi.new("trocar_error *"), ffi.new("trocar_batch **")
        options = ffi.new("trocar_batch_options *", {"threads": threads, "needles": needles})
        _check(lib.trocar_batch_create([model._handle for model in self._models], rows, options, handle, why), why)
        self._handle, self._turn = ffi.gc(handle[0], lib.trocar_batch_free), _Turn("Batch")
        self._needles, self._names = needles, tuple(outputs)
        self._sims: dict[int, Sim] = {}
        self._status, self._done = np.zeros(rows, np.int32), np.zeros(rows, np.int32)
        self._arrays = self._new_arrays(1)

    def __len__(self) -> int:
        return len(self._models)

    def __getitem__(self, row: int) -> Sim:
        if not -len(self) <= row < len(self):
            raise IndexError("row %d: the batch has %d" % (row, len(self)))
        row %= len(self)
        if row not in self._sims:
            self._sims[row] = Sim.__new__(Sim)
            self._bind(row)
        return self._sims[row]

    def _bind(self, row: int) -> None:
        """Points the `Sim` of a row at the row's current simulation. The `Sim` keeps the batch alive."""
        sim = self._sims[row]
        sim._handle = ffi.gc(lib.trocar_batch_sim(self._handle, row), lambda _, batch=self._handle: None)
        sim.model, sim._turn, sim._out = self._models[row], self._turn, ffi.new("trocar_output *")
        sim._view = lib.trocar_sim_view(sim._handle)

    @property
    def threads(self) -> int:
        """Number of threads."""
        return lib.trocar_batch_threads(self._handle)

    @property
    def needles(self) -> int:
        """Number of needles that are driven in each row."""
        return self._needles

    @property
    def models(self) -> tuple[Model, ...]:
        """The model of each row."""
        return tuple(self._models)

    @property
    def status(self) -> npt.NDArray[np.int32]:
        """(rows,): 0 if the row's last step succeeded, otherwise a positive error code. Overwritten by `step` and `run`."""
        return self._status

    @property
    def done(self) -> npt.NDArray[np.int32]:
        """(rows,): number of steps that the row completed in the last call. Overwritten by `step` and `run`."""
        return self._done

    def set_model(self, row: int, model: Model) -> None:
        """Replaces a row's simulation with a new one of this model, which takes a few milliseconds. Its needles are at the origin until you call
        `reset`."""
        row = range(len(self))[row]
        why = ffi.new("trocar_error *")
        with self._turn:
            _check(lib.trocar_batch_set_model(self._handle, row, model._handle, why), why)
            self._models[row] = model
            if row in self._sims:
                self._bind(row)

    def _mask(self, mask: npt.ArrayLike | None) -> tuple[Any, Any]:
        """Returns a C pointer to the mask, and the array that must be kept alive while the pointer is in use."""
        if mask is None:
            return ffi.NULL, None
        array = np.ascontiguousarray(mask, np.bool_)
        if array.shape != (len(self),):
            raise ValueError("a mask is (%d,): one entry for each row; got shape %s" % (len(self), array.shape))
        return ffi.from_buffer("uint8_t[]", array), array

    def reset(self, poses: npt.ArrayLike, mask: npt.ArrayLike | None = None) -> None:
        """Resets the rows selected by `mask` (rows,), or all rows if it is None, to their initial state: time 0, tissue at rest, and no seeds, tracks or
        resting needles. The needles start out straight at `poses`: (7,) for all, (rows, 7), or (rows, needles, 7). Poses of unselected rows are
        ignored."""
        given = np.asarray(poses, np.float64)
        if given.ndim == 2 and given.shape[0] == len(self):
            given = given[:, None]
        given = np.ascontiguousarray(np.broadcast_to(given, (len(self), self._needles, 7)))
        why = ffi.new("trocar_error *")
        chosen, _kept = self._mask(mask)
        with self._turn:
            _check(lib.trocar_batch_reset(self._handle, ffi.cast("trocar_pose const *", ffi.from_buffer("double[]", given)), chosen, why), why)

    def _new_arrays(self, steps: int) -> dict[str, npt.NDArray[Any]]:
        arrays = {}
        for name in self._names:
            kind, _, entry, of_needles = _BATCH_OUTPUTS[name]
            arrays[name] = np.zeros((len(self), steps, *((self._needles,) if of_needles else ()), *entry), kind)
        return arrays

    def _step(self, poses: npt.NDArray[np.float64], dt: float, mask: npt.ArrayLike | None, arrays: dict[str, npt.NDArray[Any]], watch: _Watch | None) -> None:
        """poses: (rows, steps, needles, 7)."""
        why, outputs = ffi.new("trocar_error *"), ffi.new("trocar_batch_outputs *")
        chosen, _kept = self._mask(mask)
        for name, array in arrays.items():
            setattr(outputs, name, ffi.cast(_BATCH_OUTPUTS[name][1], ffi.from_buffer("char[]", array, require_writable=True)))
        outputs.status = ffi.cast("int32_t *", ffi.from_buffer("char[]", self._status, require_writable=True))
        outputs.done = ffi.cast("int32_t *", ffi.from_buffer("char[]", self._done, require_writable=True))
        given = ffi.cast("trocar_pose const *", ffi.from_buffer("double[]", poses))
        with self._turn:
            status = lib.trocar_batch_step(self._handle, given, poses.shape[1], dt, chosen, watch.pointer if watch else ffi.NULL, outputs, why)
        if watch:
            watch.check(status, why)
        else:
            _check(status, why)

    def _given(self, poses: npt.ArrayLike, axes: str, many: bool) -> tuple[npt.NDArray[np.float64], bool]:
        """Reshapes poses to (rows, steps, needles, 7). Also returns whether the caller gave them with a needle axis."""
        given = np.ascontiguousarray(poses, np.float64)
        with_needles = given.ndim == (4 if many else 3)
        if not many:
            given = given[:, None] if given.ndim > 1 else given
        if not with_needles and given.ndim == 3 and self._needles == 1:
            given = given[:, :, None]
        if given.ndim != 4 or (given.shape[0], *given.shape[2:]) != (len(self), self._needles, 7):
            raise ValueError("poses are (%d%s%s, 7)%s; got shape %s" % (len(self), axes, ", %d" % self._needles if self._needles > 1 else "",
                                                                       " or (%d%s, 1, 7)" % (len(self), axes) if self._needles == 1 else "", np.shape(poses)))
        return given, with_needles

    def step(self, poses: npt.ArrayLike, dt: float = 0.001, mask: npt.ArrayLike | None = None) -> dict[str, npt.NDArray[Any]]:
        """Runs a tick of `dt` seconds, and the mesh update that it asks for, in each row selected by `mask` (rows,), or in all rows if it is None.
        poses: (rows, 7), or (rows, needles, 7).

        Returns the outputs chosen at construction: (rows, ...), or (rows, needles, ...) if the poses have a needle axis. The arrays belong to the batch,
        and the next call overwrites them; unselected rows keep their last values. An error in one row does not stop the others. Once all rows are done,
        an Error is raised with the message of the first row that failed. `status` then shows which rows failed, and the arrays that earlier calls
        returned hold the results of the rest."""
        given, with_needles = self._given(poses, "", False)
        self._step(given, dt, mask, self._arrays, None)
        shown = {name: array[:, 0] for name, array in self._arrays.items()}
        return shown if with_needles else {name: array[:, 0] if _BATCH_OUTPUTS[name][3] else array for name, array in shown.items()}

    def run(self, poses: npt.ArrayLike, dt: float = 0.001, mask: npt.ArrayLike | None = None,
            progress: Callable[[str, float], Any] | None = None) -> dict[str, npt.NDArray[Any]]:
        """Runs several ticks, faster than repeated calls to `step`. poses: (rows, steps, 7), or (rows, steps, needles, 7).

        Returns the outputs chosen at construction in new arrays, (rows, steps, ...) or (rows, steps, needles, ...); unselected rows are zero. Errors are
        reported as in `step`. progress("batch", fraction) is called at least once every 64 steps of a row. An exception raised in it, or Ctrl-C, aborts
        the call; `done` then holds the number of steps that each row has completed."""
        given, with_needles = self._given(poses, ", steps", True)
        arrays = self._new_arrays(given.shape[1])
        self._step(given, dt, mask, arrays, _Watch(progress))
        return arrays if with_needles else {name: array[:, :, 0] if _BATCH_OUTPUTS[name][3] else array for name, array in arrays.items()}

    def save(self, mask: npt.ArrayLike | None = None) -> list[bytes]:
        """Returns the states of the rows selected by `mask` (rows,), or of all rows if it is None, in row order. See `Sim.save`."""
        return [self[int(row)].save() for row in self._rows(mask)]

    def restore(self, states: bytes | Sequence[bytes], mask: npt.ArrayLike | None = None) -> None:
        """Restores the rows selected by `mask` (rows,), or all rows if it is None, in parallel. states: one state for all of these rows, or one for each,
        in row order. See `Sim.restore`."""
        rows = self._rows(mask)
        given = [states] * len(rows) if isinstance(states, bytes) else list(states)
        if len(given) != len(rows):
            raise ValueError("%d states for %d rows" % (len(given), len(rows)))
        why, pointers, sizes = ffi.new("trocar_error *"), ffi.new("void const *[]", len(self)), ffi.new("size_t[]", len(self))
        kept = [ffi.from_buffer(state) for state in given]
        for row, buffer, state in zip(rows, kept, given):
            pointers[int(row)], sizes[int(row)] = buffer, len(state)
        chosen, _kept = self._mask(mask)
        with self._turn:
            _check(lib.trocar_batch_restore(self._handle, pointers, sizes, chosen, why), why)

    def _rows(self, mask: npt.ArrayLike | None) -> npt.NDArray[np.intp]:
        return np.arange(len(self)) if mask is None else np.flatnonzero(np.asarray(mask, np.bool_))
