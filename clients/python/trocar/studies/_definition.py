"""Defines a study: reads its file, generates its samples and determines what it records."""
from __future__ import annotations

import hashlib
import itertools
import math
import re
from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import Error, Key, Model, Scene, __version__, keys
from .. import motion as motions
from .._locate import locate
from ._quantities import QUANTITIES, Quantity
from .._reader import Reader
from ..brachy.implant import Implant
from ..brachy.plan import BadPlan, Frame, Plan
from ..brachy.virtual_operator import Operator

METHODS = ("sobol", "latin hypercube", "random", "saltelli", "grid")
MOST_RUNS = 10_000_000

_STIFFNESS = re.compile(r"regions\[[^]]*\]\.(youngs_modulus|poisson_ratio)|membranes\[[^]]*\]\.(stiffness|poisson_ratio)")


def affects_stiffness(key: str) -> bool:
    """Whether a scene key affects the tissue's stiffness. If it does, runs with different values cannot share an inverse."""
    return _STIFFNESS.fullmatch(key) is not None


class BadStudy(Exception):
    """Raised if a study cannot be used. The message gives the file and line and says how to fix it."""


@dataclass
class Parameter:
    """A varied parameter: a scene key, or "motion." and a property of the motion."""

    name: str
    unit: str
    kind: str                 # uniform, log_uniform, normal or values
    numbers: list[float]      # limits, or mean and standard deviation, or the values themselves
    within: tuple[float, float] | None = None    # limits of a truncated normal distribution
    steps: int = 0            # number of values on a grid
    line: int = 0

    def quantile(self, u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Inverse distribution function: returns the values at probabilities u (0 to 1)."""
        if self.kind == "values":
            return np.asarray(self.numbers)[np.minimum((u * len(self.numbers)).astype(int), len(self.numbers) - 1)]
        a, b = self.numbers
        if self.kind == "uniform":
            return a + (b - a) * u
        if self.kind == "log_uniform":
            return a * (b / a) ** u
        from scipy.stats import norm, truncnorm
        u = np.clip(u, 2.0 ** -54, 1.0 - 2.0 ** -53)    # Sobol points can have coordinates that are exactly 0
        if self.within is None:
            return a + b * norm.ppf(u)
        low, high = self.within
        return np.clip(truncnorm.ppf(u, (low - a) / b, (high - a) / b, loc=a, scale=b), low, high)    # truncnorm.ppf is accurate even far from the mean

    def levels(self) -> list[float]:
        """Returns the values that the parameter takes in a grid study."""
        return self.numbers if self.kind == "values" else self.quantile(np.linspace(0.0, 1.0, self.steps)).tolist()

    def extremes(self) -> list[float]:
        return list(self.within or ()) if self.kind == "normal" else [min(self.numbers), max(self.numbers)]


@dataclass
class Measure:
    """A recorded quantity, which has one or more columns."""

    name: str                 # name of the quantity
    quantity: Quantity
    option: Any = None        # name of a membrane or region; or (3,) m, position of a target
    at: float | None = None   # s, when to take the quantity; None: at the end of the motion, or over the whole motion

    def columns(self) -> list[str]:
        about = f"({self.option})" if isinstance(self.option, str) else ""
        when = "" if self.at is None else f"@{self.at:g}"
        return [f"{self.name}{about}{'.' + part if part else ''}{when} [{self.quantity.unit}]" for part in self.quantity.parts]


@dataclass
class Study:
    """A study, as read from its file."""

    path: str
    scene_path: str
    settings: dict[str, str]            # scene keys that the study sets, the same for all runs
    motion: Any                         # the motion, from trocar.motion
    parameters: list[Parameter]
    method: str
    count: int
    seed: int
    measures: list[Measure]
    frames_every: float = 0.0           # s, interval between frames; 0 for no frames
    plan: Plan | None = None
    digests: dict[str, str] = field(default_factory=dict)    # SHA-256 of each file that was read, by the file's role
    described: str = ""                 # describes the motion and other settings; goes into the manifest
    inverse: str = "auto"               # the scene's inverse
    text: str = ""                      # contents of the study's file
    _scene: Scene | None = None         # the scene with `settings` applied; kept in memory, so that later changes to its file have no effect

    def samples(self) -> npt.NDArray[np.float64]:
        """Returns the parameter values of all runs, (runs, parameters)."""
        p = len(self.parameters)
        if self.method == "grid":
            return np.array(list(itertools.product(*(parameter.levels() for parameter in self.parameters))))
        if self.method == "saltelli":
            from .sensitivity import design
            unit = design(p, self.count, self.seed)
        elif self.method == "random":
            unit = np.random.default_rng(self.seed).random((self.count, p))
        else:
            from scipy.stats import qmc
            sampler = qmc.Sobol(p, scramble=True, seed=self.seed) if self.method == "sobol" else qmc.LatinHypercube(p, seed=self.seed)
            unit = sampler.random(self.count)
        return np.stack([parameter.quantile(column) for parameter, column in zip(self.parameters, unit.T)], axis=1)

    def run_scene(self, values: npt.NDArray[np.float64], sparse: bool = False) -> Scene:
        """Returns the scene for one run. All runs share one object, so the next call changes it."""
        scene = self._scene
        for parameter, value in zip(self.parameters, values):
            if not parameter.name.startswith("motion."):
                scene[parameter.name] = float(value)
        scene["inverse"] = "sparse" if sparse else self.inverse
        return scene

    def run_motion(self, values: npt.NDArray[np.float64]) -> Any:
        """Returns the motion for one run."""
        by = {parameter.name.removeprefix("motion."): float(value) for parameter, value in zip(self.parameters, values) if parameter.name.startswith("motion.")}
        return self.motion.adjusted(**by)

    def stiffness_columns(self) -> list[int]:
        """Returns the indices of the parameters that affect the tissue's stiffness."""
        return [i for i, parameter in enumerate(self.parameters) if affects_stiffness(parameter.name)]

    def possible_stiffnesses(self) -> float:
        """Returns an upper bound, independent of the number of runs, on how many different stiffnesses can occur."""
        varied = [self.parameters[i] for i in self.stiffness_columns()]
        return math.prod(len(p.numbers) if p.kind == "values" else math.inf for p in varied)

    def parameter_columns(self) -> list[str]:
        return [f"{p.name} [{p.unit}]" if p.unit else p.name for p in self.parameters]

    def result_columns(self) -> list[str]:
        return [column for measure in self.measures for column in measure.columns()]

    def manifest(self) -> dict[str, str]:
        """Returns a dict of everything that the results depend on. Two studies are the same if their manifests are equal."""
        version = f"trocar {__version__}"
        if self.method in ("sobol", "latin hypercube", "saltelli") or any(p.kind == "normal" for p in self.parameters):
            import scipy    # the samples depend on its version
            version += f", scipy {scipy.__version__}"
        found = {**self.digests, "version": version, "settings": repr(sorted(self.settings.items())), "motion": self.described,
                 "samples": f"{self.method}, {'any number' if self.method == 'random' else self.count}, seed {self.seed}", "record": "; ".join(self.result_columns()) + repr([np.asarray(m.option).tolist() for m in self.measures]),
                 "frames": f"every {self.frames_every:g} s" if self.frames_every else "none"}
        for p in self.parameters:
            found[f"parameter {p.name}"] = f"{p.kind} {p.numbers} {p.within or ''} {p.steps or ''}"
        return found


# ---- reading ------------------------------------------------------------------------------------------------------------------------------


def _digest_of(said: Any) -> str:
    """Returns the SHA-256 of data read from a file. Hashing the data rather than the file makes the digest independent of path and layout."""
    return hashlib.sha256(repr(said).encode()).hexdigest()


def _scene_keys() -> dict[str, Key]:
    return {key.key: key for key in keys()}


_MOTION_UNITS = {"x": "m", "y": "m", "z": "m", "tilt_x": "rad", "tilt_y": "rad", "roll": "rad", "depth": "m", "speed": "m/s", "seed": "",
                 "image_error": "m", "splay": "rad", "speed_spread": ""}
_OF_OPERATOR = ("seed", "image_error", "splay", "speed_spread", "strands", "stabilise")    # keys that are allowed only with `operator`


class _StudyReader:
    def __init__(self, path: str):
        self.reader = Reader(path, "study", BadStudy, "scene, motion, samples, parameters and record")
        self.folder = Path(path).parent

    def file(self, node: Any, place: str) -> str:
        name = str(self.folder / self.reader.text(node, place))
        if not Path(name).is_file():
            raise self.reader.fail(node, f"{place}: no file {name}: paths are relative to the study's file")
        return name

    def digest(self, study: Study, what: str, path: str) -> None:
        try:
            study.digests[what] = hashlib.sha256(Path(path).read_bytes()).hexdigest()
        except OSError as error:
            raise BadStudy(f"{path}: cannot be read: {error.strerror}") from error

    def digest_scene(self, study: Study, scene: Scene) -> None:
        """Adds a digest of the scene's values, so that comments, order and units in its file do not matter. Leaves out the mesh, which has its own digest,
        and the `device` keys, which do not affect results."""
        said = {key: scene[key] for key in scene if key not in ("mesh", "cache") and not key.startswith("device.")}
        study.digests["scene"] = _digest_of(sorted(said.items()))

    def setting(self, scene: Scene, node: Any, key: str, value: float | str, place: str) -> None:
        """Sets a scene key; it is an error if the scene has no such key."""
        try:
            scene[key]
            scene[key] = value
        except Error as error:
            raise self.reader.fail(node, f"{place}: {error}") from error

    def in_patient(self, given: dict[str, Any], place: str, known: bool) -> bool:
        """Whether positions in a section are in patient coordinates (mm), according to its "coordinates" key. known: whether the scene defines patient
        coordinates."""
        word = self.reader.text(given["coordinates"], place) if "coordinates" in given else "mesh"
        if word not in ("mesh", "patient"):
            raise self.reader.fail(given["coordinates"], f"{place}: \"{word}\": write mesh (m) or patient (mm)")
        if word == "patient" and not known:
            raise self.reader.fail(given["coordinates"], f"{place}: the scene has no patient_to_mesh: add it, or write mesh")
        return word == "patient"

    def point(self, node: Any, place: str, frame: Frame, patient: bool) -> npt.NDArray[np.float64]:
        """Reads a point, in patient coordinates (mm) if `patient`, and returns it in mesh coordinates, (3,) m."""
        numbers = np.array(self.reader.numbers(node, place, 3))
        return frame.to_mesh(numbers) if patient else numbers

    def not_in_tissue(self, node: Any, place: str, patient: bool) -> Exception:
        unit = "mm in the patient's coordinates: left, posterior, superior" if patient else "metres in the mesh"
        return self.reader.fail(node, f"{place}: not in the tissue at rest: write x, y, z in {unit}")

    def load(self, given: dict[str, Any], study: Study) -> Scene:
        """Loads the scene file, without the keys that the study sets."""
        study.scene_path = self.file(given["scene"], "scene")
        try:
            study._scene = Scene.load(study.scene_path)
        except Error as error:
            raise self.reader.error(str(error)) from error
        return study._scene

    def settings(self, given: dict[str, Any], study: Study, scene: Scene) -> None:
        """Applies the scene keys under "set"."""
        reader = self.reader
        for key, value in self.pairs(given["set"], "set") if "set" in given else []:
            if not isinstance(value, reader.yaml.ScalarNode):
                raise reader.fail(value, f"set.{key.value}: write a number or a word")
            if key.value in study.settings:
                raise reader.fail(key, f"set: \"{key.value}\" is given twice: remove one")
            self.setting(scene, value, key.value, value.value, f"set.{key.value}")
            study.settings[key.value] = value.value
        study.inverse = str(scene["inverse"])

    def start(self, given: dict[str, Any], scene: Scene) -> npt.NDArray[np.float64] | None:
        """Reads the start pose of the base; None if the motion has none. The file gives either a position and a quaternion, or only x, y, z, in which case
        the orientation comes from the scene's needle.start. Positions are in mesh coordinates (m) or, for x, y, z with `coordinates: patient`, in patient
        coordinates (mm)."""
        if "start" not in given:
            if "coordinates" in given:
                raise self.reader.fail(given["coordinates"], "motion.coordinates: allowed only with start: write start too, or leave it out")
            return None
        pose = self.pose(given["start"], "motion.start", scene["needle.start.orientation"])
        matrix = np.array(scene["patient_to_mesh"])
        if not self.in_patient(given, "motion.coordinates", len(matrix) > 0):
            return pose
        if len(self.reader.items(given["start"], "motion.start")) == 7:
            raise self.reader.fail(given["start"], "motion.start: in the patient's coordinates, write three numbers")
        pose[:3] = matrix.reshape(4, 4)[:3] @ np.append(pose[:3], 1.0)
        return pose

    def pose(self, node: Any, place: str, orientation: list[float]) -> npt.NDArray[np.float64]:
        items = self.reader.items(node, place)
        numbers = self.reader.numbers(node, place, 7 if len(items) == 7 else 3)
        if len(numbers) == 7 and abs(math.hypot(*numbers[3:]) - 1.0) > 1e-3:
            raise self.reader.fail(node, f"{place}: the quaternion has length {math.hypot(*numbers[3:]):.4g}: write w, x, y, z of length 1")
        return np.array(numbers if len(numbers) == 7 else [*numbers, *orientation])

    def motion(self, node: Any, study: Study, scene: Scene) -> Any:
        kinds = ("script", "straight", "poses", "plan")
        given = self.reader.mapping(node, "motion", (), (*kinds, "start", "coordinates", "speed", "operator", *_OF_OPERATOR))
        chosen = [kind for kind in kinds if kind in given]
        if len(chosen) != 1:
            raise self.reader.fail(node, f"motion: write one of {', '.join(kinds)}")
        kind = chosen[0]
        allowed = {"script": ("start", "coordinates", "speed"), "straight": ("start", "coordinates"), "poses": (), "plan": ("speed", "operator", *_OF_OPERATOR)}[kind]
        for key in ("start", "coordinates", "speed", "operator", *_OF_OPERATOR):
            if key in given and key not in allowed:
                raise self.reader.fail(given[key], f"motion.{key}: not with \"{kind}\"{': write it below straight' if kind == 'straight' else ''}")
        start = self.start(given, scene)
        speed = self.reader.number(given["speed"], "motion.speed") if "speed" in given else None
        if kind == "script":
            name = self.reader.text(given[kind], "motion.script")
            if name not in motions.SCRIPTS:
                raise self.reader.fail(given[kind], f"motion.script: no script \"{name}\": there are {', '.join(motions.SCRIPTS)}")
            found = motions.script(name, speed or 1.0, start).to_depth(float(scene["needle.start.depth"]))
        elif kind == "straight":
            keys_ = self.reader.mapping(given[kind], "motion.straight", ("depth", "speed"), ("hold", "back"))
            number = lambda key, **limit: self.reader.number(keys_[key], f"motion.straight.{key}", **limit)
            found = motions.Straight(start=start, depth=number("depth"), speed=number("speed"), hold=number("hold", inclusive=True) if "hold" in keys_ else 0.0,
                                     back=self.truth(keys_, "back", "motion.straight"))
        else:
            path = self.file(given[kind], f"motion.{kind}")
            try:
                if kind == "poses":
                    self.digest(study, kind, path)
                    found = motions.Table.read(path)
                else:
                    from ..brachy import plan as plans
                    study.plan = plans.read(path)
                    study.digests[kind] = _digest_of([replace(study.plan, path="", line=0, needles=[]), *(replace(needle, line=0) for needle in study.plan.needles)])
                    found = self.operator(given, study.plan, speed)
            except (motions.BadMotion, BadPlan) as error:
                raise BadStudy(str(error)) from error
        study.described = f"{kind} {given[kind].value if kind in ('script', 'poses', 'plan') else found} start {None if start is None else start.tolist()} speed {speed}"
        if isinstance(found, Operator):
            study.described += f" operator {replace(found, plan=None)}"
        return found

    def truth(self, given: dict[str, Any], key: str, place: str) -> bool:
        """Returns the value of a key that is true or false; false if it is missing."""
        text = self.reader.text(given[key], f"{place}.{key}") if key in given else "false"
        if text not in ("true", "false"):
            raise self.reader.fail(given[key], f"{place}.{key}: write true or false")
        return text == "true"

    def operator(self, given: dict[str, Any], plan: Plan, speed: float | None) -> Any:
        """Returns the motion that carries out a plan: one needle after another, or all of them by a virtual operator."""
        if "operator" not in given:
            for key in _OF_OPERATOR:
                if key in given:
                    raise self.reader.fail(given[key], f"motion.{key}: only with operator: write operator: marks or image, or leave it out")
            return Implant(plan=plan, **({"speed": speed} if speed else {}))
        kind = self.reader.text(given["operator"], "motion.operator")
        if kind not in ("marks", "image"):
            raise self.reader.fail(given["operator"], f"motion.operator: no operator \"{kind}\": expected marks or image")
        numbers = {key: self.reader.number(given[key], f"motion.{key}", inclusive=True) for key in ("image_error", "splay", "speed_spread") if key in given}
        seed = {"seed": self.reader.count(given["seed"], "motion.seed", MOST_RUNS)} if "seed" in given else {}
        holes = [self.reader.text(item, f"motion.stabilise[{i}]") for i, item in enumerate(self.reader.items(given["stabilise"], "motion.stabilise"))] if "stabilise" in given else []
        strands = self.truth(given, "strands", "motion")
        return Operator(plan=plan, follows_image=kind == "image", speed=speed, strands=strands, stabilise=tuple(holes), **numbers, **seed)

    def parameter(self, name: str, node: Any, place: str, line: int, scene: Scene, motion: Any, known: dict[str, Key], grid: bool) -> Parameter:
        kinds = ("uniform", "log_uniform", "normal", "values")
        given = self.reader.mapping(node, place, (), (*kinds, "within", "steps"))
        chosen = [kind for kind in kinds if kind in given]
        if len(chosen) != 1:
            raise self.reader.fail(node, f"{place}: write one of {', '.join(kinds)}")
        kind = chosen[0]
        if kind == "values":
            numbers = [self.reader.number(item, f"{place}.values[{i}]", -math.inf) for i, item in enumerate(self.reader.items(given[kind], f"{place}.values"))]
            if not numbers:
                raise self.reader.fail(given[kind], f"{place}.values: empty: write at least one")
        else:
            numbers = self.reader.numbers(given[kind], f"{place}.{kind}", 2)
            if kind == "normal" and numbers[1] <= 0.0:
                raise self.reader.fail(given[kind], f"{place}.normal: standard deviation {numbers[1]:g}: write the mean, and one above 0")
            if kind != "normal" and numbers[1] <= numbers[0]:
                raise self.reader.fail(given[kind], f"{place}.{kind}: {numbers[1]:g} is not above {numbers[0]:g}: write the lower limit, then the upper one")
            if kind == "log_uniform" and numbers[0] <= 0.0:
                raise self.reader.fail(given[kind], f"{place}.log_uniform: {numbers[0]:g}: write limits above 0")
        within = None
        if "within" in given:
            if kind != "normal":
                raise self.reader.fail(given["within"], f"{place}.within: only with normal: {kind} has limits")
            low, high = self.reader.numbers(given["within"], f"{place}.within", 2)
            if high <= low:
                raise self.reader.fail(given["within"], f"{place}.within: {high:g} is not above {low:g}: write the lower limit, then the upper one")
            within = (low, high)
        steps = self.reader.count(given["steps"], f"{place}.steps", 100_000, 2) if "steps" in given else 0
        if steps and not grid:
            raise self.reader.fail(given["steps"], f"{place}.steps: only with samples: {{method: grid}}")
        if grid and kind == "normal":
            raise self.reader.fail(node, f"{place}: a grid has no normal distribution: write values, or uniform and steps")
        if grid and kind != "values" and not steps:
            raise self.reader.fail(node, f"{place}: missing key \"steps\", of the grid")
        if name.startswith("needle.start."):
            raise BadStudy(f"{self.reader.path}:{line}: {place}: the motion's start and depth are read once, for all runs: vary "
                           f"{', '.join('motion.' + key for key in motion.adjustable)}")
        parameter = Parameter(name, "", kind, numbers, within, steps, line)
        if name.startswith("motion."):
            which = name.removeprefix("motion.")
            if which not in motion.adjustable:
                raise BadStudy(f"{self.reader.path}:{line}: {place}: this motion has no \"{which}\": there are {', '.join('motion.' + key for key in motion.adjustable)}")
            parameter.unit = "" if which == "speed" and isinstance(motion, motions.Script) else _MOTION_UNITS[which]
            if which in ("depth", "speed") and (not parameter.extremes() or min(parameter.extremes()) <= 0.0):
                raise self.reader.fail(node, f"{place}: it could be 0 or negative: write limits above 0")
            return parameter
        bracketed = "".join("[]" if i % 2 else part for i, part in enumerate(name.replace("]", "[").split("[")))
        key = known.get(bracketed)
        parameter.unit = key.unit if key else ""
        if key and key.accepts.startswith("a whole number"):
            possible = parameter.levels() if grid else numbers if kind == "values" else []
            if not possible or any(value != int(value) for value in possible):
                raise self.reader.fail(node, f"{place}: the key takes {key.accepts}: write values: [...]")
        try:
            before = scene[name]
        except Error as error:
            raise BadStudy(f"{self.reader.path}:{line}: {place}: {error}") from error
        for value in (*parameter.extremes(), before):
            self.setting(scene, node, name, value, place)
        return parameter

    def measures(self, node: Any, model: Model, scene: Scene, study: Study, fixed_length: bool) -> list[Measure]:
        found: list[Measure] = []
        duration = study.motion.duration()
        for i, item in enumerate(self.reader.items(node, "record")):
            place = f"record[{i}]"
            options: dict[str, Any] = {}
            if isinstance(item, self.reader.yaml.MappingNode):
                named = self.reader.mapping(item, place, (), tuple(QUANTITIES))
                if len(named) != 1:
                    raise self.reader.fail(item, f"{place}: write one quantity in each entry of the list")
                (name, below), = named.items()
            else:
                name, below = self.reader.text(item, place), None
            if name not in QUANTITIES:
                raise self.reader.fail(item, f"{place}: no quantity \"{name}\": there are {', '.join(QUANTITIES)}")
            quantity, place = QUANTITIES[name], f"record[{i}].{name}"
            needed = (quantity.option,) if quantity.option else ()
            if below is not None:
                options = self.reader.mapping(below, place, needed, (*(("at",) if quantity.instant else ()), *(("coordinates",) if quantity.option == "target" else ())))
            elif needed:
                raise self.reader.fail(item, f"{place}: missing key \"{quantity.option}\": write {{{name}: {{{quantity.option}: ...}}}}")
            if quantity.of_plan and not study.plan:
                raise self.reader.fail(item, f"{place}: only where the motion is a plan")
            if quantity.of_operator and not isinstance(study.motion, Operator):
                raise self.reader.fail(item, f"{place}: only where the motion has an operator")
            option = self.option(quantity.option, options, place, model, scene) if needed else None
            times: list[float | None] = [None]
            if "at" in options:
                given = options["at"].value if isinstance(options["at"], self.reader.yaml.SequenceNode) else [options["at"]]
                times = [self.reader.number(time, f"{place}.at", inclusive=True) for time in given]
                for time in times:
                    if duration is not None and fixed_length and time > duration + 1e-9:
                        raise self.reader.fail(options["at"], f"{place}.at: {time:g} s is after the motion's end, {duration:g} s")
            found += [Measure(name, quantity, option, time) for time in times]
        if not found:
            raise self.reader.fail(node, f"record: empty: write at least one of {', '.join(QUANTITIES)}")
        columns = [column for measure in found for column in measure.columns()]
        twice = next((column for column in columns if columns.count(column) > 1), None)
        if twice:
            raise self.reader.fail(node, f"record: \"{twice}\" is given twice: remove one")
        return found

    def option(self, kind: str, options: dict[str, Any], place: str, model: Model, scene: Scene) -> Any:
        node = options[kind]
        if kind == "target":
            frame = Frame(model)
            patient = self.in_patient(options, f"{place}.coordinates", frame.is_patient)
            point = self.point(node, f"{place}.target", frame, patient)
            if locate(model, [point])[0][0] < 0:
                raise self.not_in_tissue(node, f"{place}.target", patient)
            return point
        name, there = self.reader.text(node, f"{place}.{kind}"), scene.names(f"{kind}s")
        if name not in there:
            raise self.reader.fail(node, f"{place}.{kind}: no {kind} \"{name}\": the scene has {', '.join(there) or 'none'}")
        return name

    def read(self, frames_wanted: bool) -> Study:
        reader = self.reader
        given = reader.mapping(reader.root, "", ("scene", "motion", "samples", "parameters", "record"), ("set", "frames"))
        study = Study(reader.path, "", {}, None, [], "", 0, 0, [], text=reader.source)
        scene = self.load(given, study)
        self.digest_scene(study, scene)
        self.settings(given, study, scene)
        self.digest(study, "mesh", str(scene["mesh"]))
        study.motion = self.motion(given["motion"], study, scene)
        samples = reader.mapping(given["samples"], "samples", ("method",), ("count", "seed"))
        study.method = reader.text(samples["method"], "samples.method")
        if study.method not in METHODS:
            raise reader.fail(samples["method"], f"samples.method: \"{study.method}\": there are {', '.join(METHODS)}")
        grid, known = study.method == "grid", _scene_keys()
        for key, value in self.pairs(given["parameters"], "parameters"):
            if any(parameter.name == key.value for parameter in study.parameters):
                raise reader.fail(key, f"parameters: \"{key.value}\" is given twice: remove one")
            study.parameters.append(self.parameter(key.value, value, f"parameters.{key.value}", reader.line(key), scene, study.motion, known, grid))
        if not study.parameters:
            raise reader.fail(given["parameters"], "parameters: empty: write at least one")
        self.samples(samples, study, given["samples"])
        if study.plan and any(p.name.startswith("guides[") for p in study.parameters):
            raise reader.fail(given["parameters"], "parameters: a plan is made for one template: leave guides as they are")
        try:
            model = Model(scene, mesh_only=True)
            if study.plan:
                from ..brachy import plan as plans
                plans.check(study.plan, model)
        except (Error, BadPlan) as error:
            raise BadStudy(str(error)) from error
        fixed_length = not any(p.name in ("motion.speed", "motion.depth") for p in study.parameters)
        study.measures = self.measures(given["record"], model, scene, study, fixed_length)
        if "frames" in given:
            study.frames_every = reader.number(reader.mapping(given["frames"], "frames", ("every",))["every"], "frames.every")
        elif frames_wanted:
            study.frames_every = 0.02
        if study.frames_every and study.frames_every * model.rate_hz < 1.0 - 1e-9:
            raise reader.fail(given.get("frames", reader.root), f"frames.every: {study.frames_every:g} s is less than a step: write at least {1.0 / model.rate_hz:g}")
        if study.frames_every and not fixed_length:
            raise reader.fail(given.get("frames", reader.root), "frames: the runs would differ in length: leave motion.speed and motion.depth out of the parameters")
        if study.frames_every and study.plan:
            raise reader.fail(given.get("frames", reader.root), "frames: not available for a plan")
        return study

    def pairs(self, node: Any, place: str) -> list[tuple[Any, Any]]:
        if not isinstance(node, self.reader.yaml.MappingNode):
            raise self.reader.fail(node, f"{place}: write keys of the scene and values")
        return [(key, value) for key, value in node.value]

    def samples(self, given: dict[str, Any], study: Study, node: Any) -> None:
        reader = self.reader
        if study.method == "grid":
            for key in ("count", "seed"):
                if key in given:
                    raise reader.fail(given[key], f"samples.{key}: not with a grid: its parameters have steps or values")
            study.count = math.prod(len(p.numbers) if p.kind == "values" else p.steps for p in study.parameters)
        else:
            for key in ("count", "seed"):
                if key not in given:
                    raise reader.fail(node, f"samples: missing key \"{key}\"")
            study.seed = reader.count(given["seed"], "samples.seed", 2 ** 32 - 1, 0)
            study.count = reader.count(given["count"], "samples.count", MOST_RUNS)
            if study.method in ("sobol", "saltelli") and study.count & (study.count - 1):
                low = 1 << (study.count.bit_length() - 1)
                raise reader.fail(given["count"], f"samples.count: {study.count} is not a power of 2: Sobol points are balanced only then; write {low} or {2 * low}")
        runs = study.count * (len(study.parameters) + 2) if study.method == "saltelli" else study.count
        if runs > MOST_RUNS:
            raise reader.fail(node, f"samples: {runs} runs: write a study of at most {MOST_RUNS}")


def read(path: str | PathLike[str], frames: bool = False) -> Study:
    """Reads a study. Raises BadStudy if the file contains anything that is not part of the format. frames: record frames even if the file doesn't ask
    for them."""
    return _StudyReader(fspath(path)).read(frames)
