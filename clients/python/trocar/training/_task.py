"""Tasks and courses, read from YAML files. docs/training/tasks.md describes the keys."""
from __future__ import annotations

import re
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Scene
from .._locate import locate
from .._reader import Reader
from ..brachy import plan as plans
from ._measures import MEASURES
from ._words import ENGLISH, languages

ROLES = ("gland", "urethra", "rectum")


class BadTask(Exception):
    """Raised if a task or course cannot be used. The message gives the file and line and says how to fix it."""


@dataclass(frozen=True)
class Target:
    """A point that a needle tip is to reach."""

    name: str
    position: npt.NDArray[np.float64]    # (3,) m, position in the tissue at rest
    hole: str = ""                       # template hole to reach it through, or ""


@dataclass(frozen=True)
class Criterion:
    """A limit on a measure, either `least` or `most`; the other is None."""

    measure: str             # a key of MEASURES
    least: float | None      # SI units, Gy or a fraction
    most: float | None
    source: str              # where the limit comes from

    def met(self, value: float | None) -> bool:
        """Whether the value is within the limit. A value that could not be determined (None) is not."""
        return value is not None and (self.least is None or value >= self.least) and (self.most is None or value <= self.most)


@dataclass(frozen=True)
class Texts:
    """A task's texts in one language."""

    title: str
    text: str                # what to do
    hints: list[str]
    sources: list[str]       # where each criterion comes from


@dataclass
class Task:
    """What a trainee is to do, and how it is judged."""

    name: str                # the file's name without its extension; identifies the task in a folder of earlier runs
    title: str
    text: str                # what to do
    path: str
    scene: str               # path of the scene
    model: Model             # its mesh
    has_probe: bool = False  # whether the scene has an ultrasound probe
    targets: list[Target] = field(default_factory=list)
    plan: plans.Plan | None = None
    plan_path: str = ""
    organs: dict[str, list[str]] = field(default_factory=dict)    # mesh regions (including their parts) that make up each organ, by role (one of ROLES)
    avoid: list[str] = field(default_factory=list)                # regions that no needle is to enter, and surfaces that none is to touch
    surfaces: list[str] = field(default_factory=list)             # the surfaces in `avoid`
    criteria: list[Criterion] = field(default_factory=list)
    hints: list[str] = field(default_factory=list)
    reference: str = ""      # path of the report (JSON) of a reference run; "" if there is none
    translations: dict[str, Texts] = field(default_factory=dict)  # by language

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Task:
        """Reads a task, along with its plan and the mesh of its scene. Raises BadTask."""
        return _read_task(fspath(path))

    def texts(self, language: str) -> Texts:
        """Returns the texts in a language, falling back to those in the task file if there is no translation."""
        return self.translations.get(language) or Texts(self.title, self.text, self.hints, [criterion.source for criterion in self.criteria])

    def tets_of(self, role: str) -> npt.NDArray[np.int32]:
        """Returns the tetrahedra of an organ as node indices (k, 4). Empty if the task names no regions for it."""
        return np.concatenate([self.model.tets[:0], *(self.model.tets_of(name) for name in self.organs.get(role, []))])


@dataclass
class Course:
    """A titled list of tasks."""

    title: str
    path: str
    tasks: list[str]         # paths

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Course:
        """Reads a course and checks its tasks. Raises BadTask."""
        reader = Reader(fspath(path), "course", BadTask, "title and tasks")
        keys = reader.mapping(reader.root, "", ("title", "tasks"))
        files = [_file(reader, node, f"tasks[{i}]") for i, node in enumerate(reader.items(keys["tasks"], "tasks"))]
        if not files:
            raise reader.fail(keys["tasks"], "tasks: empty: a course has at least one")
        names = [Path(file).stem for file in files]
        for i, node in enumerate(reader.items(keys["tasks"], "tasks")):
            if names[i] in names[:i]:
                raise reader.fail(node, f"tasks[{i}]: a task \"{names[i]}\" is in the list already: runs are kept by this name; remove or rename one")
            Task.read(files[i])
        return cls(reader.text(keys["title"], "title"), fspath(path), files)


def _file(reader: Reader, node: Any, place: str) -> str:
    """Reads a file name and returns its path. Names are relative to the folder of the file that contains them."""
    path = Path(reader.path).parent / reader.text(node, place)
    if not path.is_file():
        raise reader.fail(node, f"{place}: no file {path}: write its path relative to this file")
    return str(path)


def _read_target(reader: Reader, node: Any, place: str, model: Model) -> Target:
    keys = reader.mapping(node, place, ("name", "position"), ("hole",))
    position = np.array(reader.numbers(keys["position"], f"{place}.position", 3))
    if locate(model, [position])[0][0] < 0:
        raise reader.fail(keys["position"], f"{place}.position: {', '.join(f'{x:g}' for x in position)} m is outside the tissue: write x, y, z in the mesh, in metres")
    hole = reader.text(keys["hole"], f"{place}.hole") if "hole" in keys else ""
    if hole:
        at = plans.hole_number(hole)
        if at is None or not any(at[0] < guide.columns and at[1] < guide.rows for guide in model.guides):
            raise reader.fail(keys["hole"], f"{place}.hole: no guide of the scene has a hole \"{hole}\"")
        hole = plans.hole_name(*at)
    return Target(reader.text(keys["name"], f"{place}.name"), position, hole)


def _names(reader: Reader, node: Any, place: str, known: list[str], kind: str = "region") -> list[str]:
    names = [reader.text(item, f"{place}[{i}]") for i, item in enumerate(reader.items(node, place))]
    for name, item in zip(names, reader.items(node, place)):
        if name not in known:
            raise reader.fail(item, f"{place}: the scene has no {kind} \"{name}\": there are {', '.join(known)}")
    if not names:
        raise reader.fail(node, f"{place}: empty: write at least one name, or remove the key")
    return names


def _wholes(model: Model, names: list[str]) -> list[str]:
    """Removes from the list regions that are part of another region in the list."""
    whole = dict(zip(model.groups, (model.groups[i] for i in model.part_of)))
    return [name for name in names if whole[name] == name or whole[name] not in names]


def _read_criterion(reader: Reader, node: Any, place: str, task: Task) -> Criterion:
    keys = reader.mapping(node, place, ("measure", "source"), ("least", "most"))
    name = reader.text(keys["measure"], f"{place}.measure")
    if name not in MEASURES:
        raise reader.fail(keys["measure"], f"{place}.measure: unknown measure \"{name}\": there are {', '.join(MEASURES)}")
    if ("least" in keys) == ("most" in keys):
        raise reader.fail(node, f"{place}: write either least or most")
    measure, missing = MEASURES[name], ""
    if name == "tip_error" and not task.targets:
        missing = "targets"
    elif measure.of_plan and not task.plan:
        missing = "plan"
    elif measure.of_dose and not (task.plan and task.plan.source and task.plan.prescription):
        missing = "source and prescription in its plan"
    elif name == "organs_touched" and not task.avoid:
        missing = "avoid"
    elif name == "probe_force" and not task.has_probe:
        missing = "probe in its scene"
    else:
        role = {"D90": "gland", "V100": "gland", "V150": "gland", "rectum_D2cc": "rectum", "urethra_D10": "urethra"}.get(name)
        if role and role not in task.organs:
            missing = f"organs.{role}"
    if missing:
        raise reader.fail(keys["measure"], f"{place}.measure: {name} cannot be computed: the task has no {missing}")
    least, most = (reader.number(keys[key], f"{place}.{key}", 0.0, True) if key in keys else None for key in ("least", "most"))
    return Criterion(name, least, most, reader.text(keys["source"], f"{place}.source"))


def _read_task(path: str) -> Task:
    required, optional = ("title", "text", "scene", "criteria"), ("targets", "plan", "organs", "avoid", "hints", "reference")
    reader = Reader(path, "task", BadTask, ", ".join((*required, *optional)))
    keys = reader.mapping(reader.root, "", required, optional)
    name = Path(path).stem
    if not re.fullmatch(r"[\w-]+", name, re.ASCII):
        raise BadTask(f"{path}: name the file with letters, digits, - and _ only: a folder of runs is named after it")
    scene = _file(reader, keys["scene"], "scene")
    try:
        loaded = Scene.load(scene)
        model = Model(loaded, mesh_only=True)
    except Error as error:
        raise reader.fail(keys["scene"], f"scene: {error}") from error
    task = Task(name, reader.text(keys["title"], "title"), reader.text(keys["text"], "text"), path, scene, model, "probe.surface" in loaded)
    if ("targets" in keys) == ("plan" in keys):
        raise reader.fail(reader.root, "write either targets, which tips of needles are to reach, or a plan, whose seeds are to be left in the tissue")
    if "targets" in keys:
        task.targets = [_read_target(reader, node, f"targets[{i}]", model) for i, node in enumerate(reader.items(keys["targets"], "targets"))]
        if not task.targets:
            raise reader.fail(keys["targets"], "targets: empty: a task has at least one")
    else:
        task.plan_path = _file(reader, keys["plan"], "plan")
        try:
            task.plan = plans.read(task.plan_path)
            plans.check(task.plan, model)
        except plans.BadPlan as error:
            raise reader.fail(keys["plan"], f"plan: {error}") from error
    known = [model.groups[i] for i in np.unique(model.tet_regions)]
    if "organs" in keys:
        for role, node in reader.mapping(keys["organs"], "organs", (), ROLES).items():
            task.organs[role] = _wholes(model, _names(reader, node, f"organs.{role}", known))
    if "avoid" in keys:
        solid = loaded.impenetrable()
        task.avoid = _names(reader, keys["avoid"], "avoid", [*known, *solid], "region or impenetrable surface")
        task.surfaces = [name for name in task.avoid if name in solid]
    task.criteria = [_read_criterion(reader, node, f"criteria[{i}]", task) for i, node in enumerate(reader.items(keys["criteria"], "criteria"))]
    if not task.criteria:
        raise reader.fail(keys["criteria"], "criteria: empty: a task has at least one")
    if "hints" in keys:
        task.hints = [reader.text(node, f"hints[{i}]") for i, node in enumerate(reader.items(keys["hints"], "hints"))]
    if "reference" in keys:
        task.reference = _file(reader, keys["reference"], "reference")
    task.translations = {language: _read_texts(file, task) for language in languages() if language != ENGLISH and (file := Path(path).with_suffix(f".{language}.yaml")).is_file()}
    return task


def _read_texts(path: Path, task: Task) -> Texts:
    """Reads a translation of a task: NAME.LANGUAGE.yaml beside NAME.yaml."""
    own = task.texts(ENGLISH)
    reader = Reader(str(path), "translation", BadTask, "title, text, hints, sources")
    keys = reader.mapping(reader.root, "", ("title", "text"), ("hints", "sources"))
    lists = {"hints": own.hints, "sources": own.sources}
    for name, texts in lists.items():
        if name in keys:
            lists[name] = [reader.text(node, f"{name}[{i}]") for i, node in enumerate(reader.items(keys[name], name))]
            if len(lists[name]) != len(texts):
                raise reader.fail(keys[name], f"{name}: {len(lists[name])} texts, the task has {len(texts)}: translate each of them, in the same order")
    return Texts(reader.text(keys["title"], "title"), reader.text(keys["text"], "text"), lists["hints"], lists["sources"])
