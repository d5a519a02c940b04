"""Reads the definition of a fit from its file: scene, recordings, noise and parameters."""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Scene
from .._locate import locate
from .._reader import Reader
from ..brachy.plan import Frame
from ._definition import BadStudy, Study, _scene_keys, _StudyReader, affects_stiffness
from ._measurements import BadRecording, Recording, read_forces, read_log, read_points, read_poses

Array = npt.NDArray[np.float64]

EVERY = 0.02    # s, default averaging interval for samples


class BadFit(BadStudy):
    """Raised if a fit cannot be done. The message gives the file and line and says how to fix it."""


@dataclass(frozen=True)
class Unknown:
    """A scene key whose value is to be estimated. If its lower bound is above 0, its logarithm is fitted instead."""

    key: str
    unit: str
    start: float
    low: float
    high: float
    prior: tuple[float, float] | None = None    # mean and standard deviation

    @property
    def logarithmic(self) -> bool:
        return self.low > 0.0

    def value(self, scaled: float) -> float:
        """Converts a scaled value, which is 0 at the lower bound and 1 at the upper bound, to the key's value."""
        return self.low * (self.high / self.low) ** scaled if self.logarithmic else self.low + (self.high - self.low) * scaled

    def scaled(self, value: float) -> float:
        return math.log(value / self.low) / math.log(self.high / self.low) if self.logarithmic else (value - self.low) / (self.high - self.low)

    def prior_scaled(self) -> tuple[float, float] | None:
        """Converts the prior's mean and standard deviation to scaled values."""
        if self.prior is None:
            return None
        mean, spread = self.prior
        width = mean * math.log(self.high / self.low) if self.logarithmic else self.high - self.low
        return self.scaled(mean), spread / width


@dataclass
class FitProblem:
    """A fit, as read from its file."""

    path: str
    study: Study                        # the scene and its settings
    recordings: list[Recording] = field(default_factory=list)
    points: dict[str, Array] = field(default_factory=dict)    # (3,) m, tracked points in the tissue at rest
    noise: dict[str, float] = field(default_factory=dict)     # standard deviation of one sample, by kind: N, N m, m; and "time", s
    every: float = EVERY                # s, averaging interval
    unknowns: list[Unknown] = field(default_factory=list)
    tets: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))    # (points,) index of the tetrahedron that contains each point
    weights: Array = field(default_factory=lambda: np.zeros((0, 4)))                    # (points, 4) barycentric weights in that tetrahedron

    def is_stiffness(self, index: int) -> bool:
        """Whether a change to this parameter requires a new inverse."""
        return affects_stiffness(self.unknowns[index].key)

    def scene(self, values: Array) -> Scene:
        """Returns the scene with these parameter values. All calls share one object, so the next call changes it."""
        scene = self.study._scene
        assert scene is not None
        for unknown, value in zip(self.unknowns, values):
            scene[unknown.key] = float(value)
        return scene

    def start(self) -> Array:
        return np.array([unknown.start for unknown in self.unknowns])

    def values(self, scaled: Array) -> Array:
        return np.array([unknown.value(float(x)) for unknown, x in zip(self.unknowns, scaled)])

    def scaled(self, values: Array) -> Array:
        return np.array([unknown.scaled(float(x)) for unknown, x in zip(self.unknowns, values)])


class _FitReader(_StudyReader):
    def __init__(self, path: str):
        self.reader = Reader(path, "fit", BadFit, "scene, recordings, noise and parameters")
        self.folder = Path(path).parent

    def recording(self, node: Any, place: str, problem: FitProblem) -> Recording:
        reader, kinds = self.reader, list(problem.noise)
        given = reader.mapping(node, place, (), ("poses", "log", "forces", "points"))
        if ("poses" in given) == ("log" in given):
            raise reader.fail(node, f"{place}: write poses, a CSV file, or log, an LCM log")
        path = {key: Path(self.file(value, f"{place}.{key}")) for key, value in given.items()}
        found = read_log(path["log"], problem.every, kinds) if "log" in path else Recording(path["poses"].name, read_poses(path["poses"]), [])
        if "forces" in path:
            found.channels = read_forces(path["forces"], found.motion, problem.every, kinds)
        if "points" in path:
            if not problem.points or "position" not in kinds:
                raise reader.fail(given["points"], f"{place}.points: write the points' places at rest below \"points\", and noise.position")
            found.channels = found.channels + read_points(path["points"], found.motion, problem.every, list(problem.points))
        if not found.channels:
            raise reader.fail(node, f"{place}: nothing measured: add forces or points{', as the log has no wrenches' if 'log' in path else ''}")
        return found

    def unknown(self, key: Any, node: Any, scene: Scene) -> Unknown:
        reader, name = self.reader, str(key.value)
        place = f"parameters.{name}"
        given = reader.mapping(node, place, ("within",), ("start", "prior"))
        pattern = "".join("[]" if i % 2 else part for i, part in enumerate(name.replace("]", "[").split("[")))
        row = _scene_keys().get(pattern)
        try:
            own = scene[name]
        except Error as error:
            raise reader.fail(key, f"{place}: {error}") from error
        if row is None or row.kind != "number" or row.accepts.startswith("a whole number") or not pattern.startswith(
                ("regions[]", "membranes[]", "relaxation[]", "needle.", "contact.", "tracks.", "guides[]")) or pattern.startswith("needle.start") \
                or pattern in ("needle.length", "contact.spacing"):
            raise reader.fail(key, f"{place}: not a property that can be fitted: write a number of a region, a membrane, the relaxation or the needle's bevel")
        low, high = reader.numbers(given["within"], f"{place}.within", 2)
        if high <= low:
            raise reader.fail(given["within"], f"{place}.within: {high:g} is not above {low:g}: write the lower bound, then the upper one")
        for bound in (low, high):
            self.setting(scene, given["within"], name, bound, f"{place}.within")
        self.setting(scene, key, name, own, place)
        start = reader.number(given["start"], f"{place}.start", -math.inf) if "start" in given else float(own)
        if not low <= start <= high:
            whose = given.get("start", key)
            raise reader.fail(whose, f"{place}: {start:g}{'' if 'start' in given else ', as in the scene,'} is not within {low:g} to {high:g}: write another start")
        prior = None
        if "prior" in given:
            mean, spread = reader.numbers(given["prior"], f"{place}.prior", 2)
            if spread <= 0.0 or not low <= mean <= high:
                raise reader.fail(given["prior"], f"{place}.prior: write the mean, within the bounds, and a standard deviation above 0")
            prior = (mean, spread)
        return Unknown(name, row.unit, start, low, high, prior)

    def read_fit(self) -> FitProblem:
        reader = self.reader
        given = reader.mapping(reader.root, "", ("scene", "recordings", "noise", "parameters"), ("set", "points", "coordinates", "every"))
        study = Study(reader.path, "", {}, None, [], "", 0, 0, [])
        problem = FitProblem(reader.path, study)
        scene = self.load(given, study)
        self.settings(given, study, scene)
        try:
            model = Model(scene, mesh_only=True)
        except Error as error:
            raise BadFit(str(error)) from error
        frame = Frame(model)
        patient = self.in_patient(given, "coordinates", frame.is_patient)
        noise = reader.mapping(given["noise"], "noise", (), ("force", "torque", "position", "time"))
        problem.noise = {kind: reader.number(node, f"noise.{kind}", inclusive=kind == "time") for kind, node in noise.items() if kind != "time"}
        if not problem.noise:
            raise reader.fail(given["noise"], "noise: write the standard deviation of one sample: force (N), torque (N m) or position (m)")
        time = reader.number(noise["time"], "noise.time", inclusive=True) if "time" in noise else 1.0 / model.rate_hz
        problem.every = reader.number(given["every"], "every") if "every" in given else EVERY
        if problem.every * model.rate_hz < 1.0 - 1e-9:
            raise reader.fail(given["every"], f"every: {problem.every:g} s is less than a step: write at least {1.0 / model.rate_hz:g}")
        for key, value in self.pairs(given["points"], "points") if "points" in given else []:
            problem.points[str(key.value)] = self.point(value, f"points.{key.value}", frame, patient)
        if problem.points:
            problem.tets, problem.weights = locate(model, list(problem.points.values()))
            for (key, value), tet in zip(self.pairs(given["points"], "points"), problem.tets):
                if tet < 0:
                    raise self.not_in_tissue(value, f"points.{key.value}", patient)
        try:
            problem.recordings = [self.recording(item, f"recordings[{i}]", problem) for i, item in enumerate(reader.items(given["recordings"], "recordings"))]
        except BadRecording as error:
            raise BadFit(str(error)) from error
        if not problem.recordings:
            raise reader.fail(given["recordings"], "recordings: empty: write at least one")
        problem.noise["time"] = time
        for key, value in self.pairs(given["parameters"], "parameters"):
            if any(unknown.key == key.value for unknown in problem.unknowns):
                raise reader.fail(key, f"parameters: \"{key.value}\" is given twice: remove one")
            problem.unknowns.append(self.unknown(key, value, scene))
        if not problem.unknowns:
            raise reader.fail(given["parameters"], "parameters: empty: write at least one")
        if study.inverse == "auto" and any(problem.is_stiffness(i) for i in range(len(problem.unknowns))):
            scene["inverse"] = "sparse"    # a sparse inverse is faster to build, which matters because few simulations share a stiffness
        return problem


def read(path: str | PathLike[str]) -> FitProblem:
    """Reads the file of a fit and its recordings. Raises BadFit if the file contains anything that is not part of the format."""
    return _FitReader(fspath(path)).read_fit()
