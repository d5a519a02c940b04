"""Reads a task from its file and builds the models that its episodes use."""
from __future__ import annotations

from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Scene
from .. import motion
from .._reader import Reader
from ..brachy._obstacles import Embedding

Array = npt.NDArray[np.float64]
Range = tuple[float, float]

TASKS = ("reach", "avoid", "implant")
MOST_STIFFNESSES = 64    # maximum number of stiffnesses; there is one model in memory for each
FARTHEST = 1.0           # m, how far ahead of the tip to look for the point where the needle's line enters the tissue


class BadTask(Exception):
    """Raised if a task file cannot be used. The message gives the file and line and says how to fix it."""


@dataclass(frozen=True)
class Stiffness:
    """A model and the data derived from its mesh. Episodes that differ only in other parameters share it."""

    model: Model
    embedding: Embedding
    borders: npt.NDArray[np.int32]        # (n, 3) faces between regions and on the tissue's surface

    @classmethod
    def of(cls, scene: Scene) -> Stiffness:
        """Builds the model of a scene."""
        model = Model(scene)
        return cls(model, Embedding(model), _borders(model))


@dataclass(frozen=True)
class Episode:
    """The random choices of one episode."""

    model: Model
    target: Array                         # (3,) m, position in the tissue at rest
    target_nodes: npt.NDArray[np.int32]   # (4,) corners of the tetrahedron that contains the target
    target_weights: Array                 # (4,) barycentric weights of the target
    borders: npt.NDArray[np.int32]        # (n, 3) faces between regions and on the tissue's surface
    region_nodes: npt.NDArray[np.int32]   # nodes of the region that contains the target
    obstacle_nodes: npt.NDArray[np.int32] # (4,) corners of the tetrahedron that contains the obstacle's centre
    obstacle_weights: Array               # (4,) barycentric weights of the obstacle's centre
    obstacle: Array                       # (3,) m, centre of the obstacle, a sphere, in the tissue at rest
    radius: float                         # m, radius of the obstacle; 0 if the task has none


@dataclass
class Task:
    """A task, as described in its file. A Range holds the lower and upper limit of a uniform distribution."""

    name: str                                                     # one of TASKS
    path: str
    scene: Scene
    target: dict[str, Range]                                      # x, y, depth: m from the entry point, along the needle's initial axes
    obstacle: dict[str, Range] = field(default_factory=dict)      # along: fraction of the way to the target; x, y: m from the line to it; radius: m
    randomise: dict[str, Range] = field(default_factory=dict)     # scene keys to draw at random for each episode, and their ranges
    stiffnesses: int = 8          # number of models with different elastic moduli
    speed: float = 0.05           # m/s, largest speed of the base along the needle
    roll_rate: float = 12.0       # rad/s, largest roll rate of the base
    interval: float = 0.02        # s, duration of one action
    tolerance: float = 1e-3       # m, an episode succeeds if its error is at most this
    displacement_cost: float = 5.0    # 1/s, weight of the tissue's displacement in the reward
    start: Array = field(default_factory=lambda: np.zeros(7))     # (7,) pose of the base before the insertion
    axes: Array = field(default_factory=lambda: np.eye(3))        # (3, 3) the needle's axes at `start`, one unit vector per row; +z points from base to tip
    entry: Array = field(default_factory=lambda: np.zeros(3))     # (3,) m, point at which the needle's line enters the tissue
    _stiffnesses: list[Stiffness] = field(default_factory=list)
    _cheap: list[str] = field(default_factory=list)               # keys of `randomise` that can change without a new inverse

    def draw(self, random: np.random.Generator) -> Episode:
        """Draws a random episode. Do not change the order in which numbers are drawn: a seed must always give the same episode."""
        chosen = self._stiffnesses[random.integers(len(self._stiffnesses))]
        model = chosen.model
        if self._cheap:
            model = model.derive(**{key: random.uniform(*self.randomise[key]) for key in self._cheap})
        x, y, depth = (random.uniform(*self.target[key]) for key in ("x", "y", "depth"))
        target = self.entry + np.array([x, y, depth]) @ self.axes
        obstacle, radius = target, 0.0
        if self.obstacle:
            along, aside, above, radius = (random.uniform(*self.obstacle[key]) for key in ("along", "x", "y", "radius"))
            obstacle = self.entry + along * (target - self.entry) + np.array([aside, above]) @ self.axes[:2]
        nodes, weights = chosen.embedding.locate(np.stack([target, obstacle]))
        region = chosen.model.tet_regions[np.isin(chosen.model.tets, nodes[0]).sum(axis=1).argmax()]
        around = np.unique(chosen.model.tets[chosen.model.tet_regions == region])
        return Episode(model, target, nodes[0], weights[0], chosen.borders, around, nodes[1], weights[1], obstacle, radius)


def _borders(model: Model) -> npt.NDArray[np.int32]:
    """Returns the faces (n, 3) between different regions and on the tissue's surface."""
    faces = np.sort(np.concatenate([np.delete(model.tets, corner, axis=1) for corner in range(4)]), axis=1)
    regions = np.tile(model.tet_regions, 4)
    unique, which = np.unique(faces, axis=0, return_inverse=True)
    which = which.reshape(-1)    # NumPy 2.0 returned a column here
    count, total = np.bincount(which), np.bincount(which, regions)
    square = np.bincount(which, regions.astype(float) ** 2)
    return unique[(count == 1) | (2.0 * square > total ** 2)].astype(np.int32)    # two different regions a and b: 2 (a^2 + b^2) > (a + b)^2


# ---- reading ------------------------------------------------------------------------------------------------------------------------------


class _TaskReader(Reader):
    def range(self, node: Any, place: str) -> Range:
        low, high = self.numbers(node, place, 2)
        if high < low:
            raise self.fail(node, f"{place}: {high:g} is below {low:g}: write the lower limit, then the upper one")
        return low, high

    def ranges(self, node: Any, place: str, keys: tuple[str, ...]) -> dict[str, Range]:
        given = self.mapping(node, place, keys)
        return {key: self.range(given[key], f"{place}.{key}") for key in keys}

    def scene(self, given: dict[str, Any]) -> Scene:
        try:
            return Scene.load(Path(self.path).parent / self.text(given["scene"], "scene"))
        except Error as error:
            raise self.fail(given["scene"], f"scene: {error}") from error

    def keys_of(self, node: Any, place: str) -> list[tuple[Any, str, Any]]:
        """Returns (key node, key, value node) for each entry of a mapping from scene keys to values."""
        if not isinstance(node, self.yaml.MappingNode):
            raise self.fail(node, f"{place}: write keys of the scene, and their values")
        return [(key, str(key.value), value) for key, value in node.value]

    def try_key(self, node: Any, scene: Scene, key: str, value: float | str, place: str) -> None:
        try:
            scene[key]    # an assignment would append an unknown name to its list; reading it raises Error
            scene[key] = value
        except Error as error:
            raise self.fail(node, f"{place}: {error}") from error


_NUMBERS = ("speed", "roll_rate", "interval", "tolerance", "displacement_cost")


def read(name: str, path: str | PathLike[str] | None = None) -> Task:
    """Reads the file of a task (one of TASKS) and builds its models, which takes a few tenths of a second for each stiffness. path: the task file, or
    None for the one that comes with the package. Raises BadTask."""
    if name not in TASKS:
        raise BadTask(f"no task \"{name}\": there are {', '.join(TASKS)}")
    where = fspath(path) if path is not None else str(Path(__file__).with_name(name + ".yaml"))
    required = ("scene", "target", "obstacle") if name == "avoid" else ("scene", "target")
    reader = _TaskReader(where, "task", BadTask, "scene, target, and optionally set, randomise and others")
    given = reader.mapping(reader.root, "", required, ("set", "randomise", "stiffnesses", *_NUMBERS))
    scene = reader.scene(given)
    for node, key, value in reader.keys_of(given["set"], "set") if "set" in given else []:
        reader.try_key(node, scene, key, reader.text(value, f"set.{key}"), f"set.{key}")
    task = Task(name, where, scene, reader.ranges(given["target"], "target", ("x", "y", "depth")))
    if "obstacle" in given:
        task.obstacle = reader.ranges(given["obstacle"], "obstacle", ("along", "x", "y", "radius"))
        if task.obstacle["radius"][0] <= 0.0:
            raise reader.fail(given["obstacle"], "obstacle.radius: write radii above 0, in m")
    for number in _NUMBERS:
        if number in given:
            setattr(task, number, reader.number(given[number], number, inclusive=number == "displacement_cost"))
    if "stiffnesses" in given:
        task.stiffnesses = reader.count(given["stiffnesses"], "stiffnesses", MOST_STIFFNESSES)
    for node, key, value in reader.keys_of(given["randomise"], "randomise") if "randomise" in given else []:
        place = f"randomise.{key}"
        task.randomise[key] = reader.range(value, place)
        if key.startswith("needle.start.") or key in ("needle.length", "needles"):
            raise reader.fail(node, f"{place}: write keys of the tissue, or of the needle except for its start and length")
        for end in task.randomise[key]:
            reader.try_key(node, scene.copy(), key, end, place)
    _build(task, reader, given)
    return task


def _build(task: Task, reader: _TaskReader, given: dict[str, Any]) -> None:
    """Builds the task's models, and determines the needle's start pose and entry point."""
    try:
        nominal = Stiffness.of(task.scene)
        model, stiff = nominal.model, []
        for key, (low, high) in task.randomise.items():
            try:
                model.derive(**{key: high if float(task.scene[key]) != high else low})
                task._cheap.append(key)
            except Error:
                stiff.append(key)
        task._stiffnesses.append(nominal)
        if stiff:
            random = np.random.default_rng(0)    # fixed seed: the task always has the same models, and each episode uses one of them
            task._stiffnesses.clear()
            for _ in range(task.stiffnesses):
                scene = task.scene.copy()
                for key in stiff:
                    scene[key] = random.uniform(*task.randomise[key])
                task._stiffnesses.append(Stiffness.of(scene))
    except Error as error:
        raise BadTask(f"{task.path}: {error}") from error
    task.start = motion.START if model.start is None else model.start
    task.axes = np.stack([motion.rotate(task.start[3:], axis) for axis in np.eye(3)])
    tip = task.start[:3] + model.needle_length * task.axes[2]
    entry = model.entry(tip, tip + FARTHEST * task.axes[2])
    if entry is None:
        raise BadTask(f"{task.path}: the needle's line misses the tissue: set needle.start.position and needle.start.orientation")
    task.entry = entry
    lengths = [task.target[key] for key in ("x", "y", "depth")]
    corners = entry + np.stack(np.meshgrid(*lengths, indexing="ij"), axis=-1).reshape(-1, 3) @ task.axes
    nodes, weights = task._stiffnesses[0].embedding.locate(corners)
    if not np.allclose(np.einsum("nk,nki->ni", weights, model.nodes[nodes]), corners, rtol=0.0, atol=1e-9):
        raise reader.fail(given["target"], "target: a corner of the ranges is outside the tissue: write metres from the needle's entry, depth along it")
