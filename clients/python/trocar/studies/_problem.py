"""Reads the definition of a planning problem from its file."""
from __future__ import annotations

import math
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Scene
from ..brachy import plan as plans
from ._definition import BadStudy, Study, _scene_keys, _StudyReader
from ..brachy._obstacles import BadContours, Obstacle, contour_points, read_contours, region_points, spacing_of, surface_points
from .._locate import locate
from .._reader import Reader
from ._rehearsal import Target
from ..brachy.implant import Implant
from ..brachy.plan import BadPlan, Frame, Plan

Array = npt.NDArray[np.float64]

OBJECTIVES = ("nominal", "mean", "worst")
METHODS = ("sobol", "latin hypercube", "random", "grid")
MOST_SAMPLES = 64    # maximum number of samples; there is one model in memory for each
MOST_POINTS = 2e6    # maximum number of points in an obstacle
LONGEST = 0.1        # m, maximum clearance or tolerance that a problem may specify
LONGEST_REST = 60.0  # s
IN_FRONT = 1e-3      # m, test for tissue this far in front of the entry rectangle, because rounding can put one that lies on the skin slightly inside
SLOWEST = 1e-3       # m/s


class BadProblem(BadStudy):
    """Raised if a planning problem cannot be used. The message gives the file and line and says how to fix it."""


@dataclass
class Area:
    """A rectangle through which needles may enter. Needles point in the area's direction, tilted about each of two axes."""

    origin: Array       # (3,) m, position of a corner
    edges: Array        # (2, 3) m
    direction: Array    # (3,) unit vector


@dataclass
class Problem:
    """A planning problem, as read from its file."""

    path: str
    study: Study                          # the scene, its settings and the samples
    hand: Implant                         # gives the speed and pauses with which needles are moved
    targets: list[tuple[str, Array]] = field(default_factory=list)    # target names, and positions (3,) m in the tissue at rest
    plan: Plan | None = None              # a plan whose seeds should end up at their planned positions; None if there are `targets`
    area: Area | None = None
    template: str = ""                    # name of the template; empty if needles enter through `area`
    holes: list[str] = field(default_factory=list)    # template holes that may be used
    tilt: float = 0.0                     # rad, maximum tilt about each of the two axes
    roll: float | None = None             # rad; None: the planner may choose it
    turn: bool = False                    # true if the needle may be given half a turn during the insertion
    tolerance: float = 0.3e-3             # m
    obstacles: list[Obstacle] = field(default_factory=list)
    objective: str = "nominal"
    bevelled: bool = False
    nominal: Array = field(default_factory=lambda: np.zeros(0))    # (parameters,) the scene's own values of the parameters

    def scene(self, values: npt.NDArray[np.float64] | None = None) -> Scene:
        """Returns the scene for a sample, by default for the scene's own values. All calls share one object, so the next call changes it."""
        return self.study.run_scene(self.nominal if values is None else values)

    def samples(self) -> npt.NDArray[np.float64]:
        """Returns the samples (samples, parameters), or an array of shape (0, 0) if there are no parameters."""
        return self.study.samples() if self.study.parameters else np.empty((0, 0))


class _ProblemReader(_StudyReader):
    def __init__(self, path: str):
        self.reader = Reader(path, "problem", BadProblem, "scene, targets and entry, or scene and plan")
        self.folder = Path(path).parent

    def uncertainty(self, node: Any, scene: Scene, problem: Problem) -> None:
        reader, study = self.reader, problem.study
        given = reader.mapping(node, "uncertainty", ("samples", "parameters"), ("objective",))
        problem.objective = reader.text(given["objective"], "uncertainty.objective") if "objective" in given else "worst"
        if problem.objective not in OBJECTIVES:
            raise reader.fail(given["objective"], f"uncertainty.objective: \"{problem.objective}\": there are {', '.join(OBJECTIVES)}")
        samples = reader.mapping(given["samples"], "samples", ("method",), ("count", "seed"))
        study.method = reader.text(samples["method"], "samples.method")
        if study.method not in METHODS:
            raise reader.fail(samples["method"], f"samples.method: \"{study.method}\": there are {', '.join(METHODS)}")
        known = _scene_keys()
        for key, value in self.pairs(given["parameters"], "parameters"):
            place = f"parameters.{key.value}"
            if any(parameter.name == key.value for parameter in study.parameters):
                raise reader.fail(key, f"parameters: \"{key.value}\" is given twice: remove one")
            if str(key.value).startswith(("motion.", "needle.start.", "guides[")) or key.value in ("needle.length", "needle.outer_diameter", "needles", "rate_hz"):
                raise reader.fail(key, f"{place}: not of a plan: write keys of the tissue, or of the needle except for its length and outer diameter")
            study.parameters.append(self.parameter(key.value, value, place, reader.line(key), scene, None, known, study.method == "grid"))
        if not study.parameters:
            raise reader.fail(given["parameters"], "parameters: empty: write at least one")
        self.samples(samples, study, given["samples"])
        if study.count > MOST_SAMPLES:
            raise reader.fail(given["samples"], f"samples: {study.count} of them: write at most {MOST_SAMPLES}, as a model of each is kept in memory, and simulated at each step of the search")

    def targets(self, node: Any, frame: Frame, patient: bool, model: Model, problem: Problem) -> None:
        reader = self.reader
        for i, item in enumerate(reader.items(node, "targets")):
            place = f"targets[{i}]"
            keys = reader.mapping(item, place, ("name", "at"))
            name, point = reader.text(keys["name"], f"{place}.name"), self.point(keys["at"], f"{place}.at", frame, patient)
            if "|" in name or not name.isprintable():    # names go into a Markdown table and into a plan
                raise reader.fail(keys["name"], f"{place}.name: write one line without |")
            if name in [other for other, _ in problem.targets]:
                raise reader.fail(keys["name"], f"{place}.name: \"{name}\" is another target's: choose another one")
            try:
                Target(point, model)
            except ValueError:
                raise self.not_in_tissue(keys["at"], f"{place}.at", patient) from None
            problem.targets.append((name, point))
        if not problem.targets:
            raise reader.fail(node, "targets: empty: write at least one")

    def length(self, node: Any, place: str, inclusive: bool = False) -> float:
        value = self.reader.number(node, place, inclusive=inclusive)
        if value > LONGEST:
            raise self.reader.fail(node, f"{place}: {value:g} m: write at most {LONGEST:g}; lengths are in metres")
        return value

    def limits(self, node: Any, place: str) -> tuple[float, float]:
        low, high = self.reader.numbers(node, place, 2)
        if high <= low:
            raise self.reader.fail(node, f"{place}: {high:g} is not above {low:g}: write the lower limit, then the upper one")
        return low, high

    def area(self, node: Any, keys: dict[str, Any], frame: Frame, patient: bool) -> Area:
        """Reads the entry rectangle: a range for two of the axes and a number for the third, in mesh or patient coordinates."""
        reader = self.reader
        missing = [axis for axis in "xyz" if axis not in keys]
        if missing:
            raise reader.fail(node, f"entry: missing key \"{missing[0]}\": write x, y and z, two of them as [from, to], or a template")
        ranges = {axis: self.limits(keys[axis], f"entry.{axis}") for axis in "xyz" if isinstance(keys[axis], reader.yaml.SequenceNode)}
        if len(ranges) != 2:
            raise reader.fail(node, "entry: write two of x, y and z as [from, to], and one as a number: a rectangle")
        corner = np.array([ranges[axis][0] if axis in ranges else reader.number(keys[axis], f"entry.{axis}", -math.inf) for axis in "xyz"])
        edges = np.array([(ranges[axis][1] - ranges[axis][0]) * np.eye(3)["xyz".index(axis)] for axis in "xyz" if axis in ranges])
        flat = next(axis for axis in "xyz" if axis not in ranges)
        towards_ = np.array(reader.numbers(keys["direction"], "entry.direction", 3)) if "direction" in keys else np.eye(3)["xyz".index(flat)]
        if patient:
            origin = frame.to_mesh(corner)
            edges, towards_ = frame.to_mesh(corner + edges) - origin, frame.to_mesh(corner + towards_) - origin
        else:
            origin = corner
        normal = np.cross(*edges)
        if np.linalg.norm(towards_) == 0.0 or abs(towards_ @ normal) < 0.2 * np.linalg.norm(towards_) * np.linalg.norm(normal):
            raise reader.fail(keys["direction"], "entry.direction: it does not pass through the rectangle: write a vector into the tissue")
        return Area(origin, edges, towards_ / np.linalg.norm(towards_))

    def check_area(self, node: Any, model: Model, problem: Problem) -> None:
        """Checks that the entry rectangle is outside the tissue and that all targets lie beyond it."""
        area, part = problem.area, np.linspace(0.0, 1.0, 4)
        before = [area.origin + s * area.edges[0] + t * area.edges[1] - IN_FRONT * area.direction for s in part for t in part]
        if (locate(model, before)[0] >= 0).any():
            raise self.reader.fail(node, "entry: the rectangle is in the tissue: write one on the skin or in front of it, and the direction from there into the tissue")
        normal, corners = np.cross(*area.edges), [area.origin + s * area.edges[0] + t * area.edges[1] for s in (0, 1) for t in (0, 1)]
        for name, point in problem.targets:
            if ((point - area.origin) @ normal) / (area.direction @ normal) <= 0.0:
                raise self.reader.fail(node, f"entry: target \"{name}\" is in front of the rectangle: write the direction from there into the tissue")
            if all((point - corner) @ area.direction <= 0.0 for corner in corners):
                raise self.reader.fail(node, f"entry: the direction points away from target \"{name}\" from everywhere in the rectangle: write one that points to it")

    def entry(self, node: Any, frame: Frame, patient: bool, model: Model, problem: Problem) -> None:
        reader = self.reader
        keys = reader.mapping(node, "entry", (), ("template", "holes", "x", "y", "z", "direction", "tilt"))
        if "tilt" in keys:
            problem.tilt = reader.number(keys["tilt"], "entry.tilt", inclusive=True)
            if problem.tilt > 1.0:
                raise reader.fail(keys["tilt"], f"entry.tilt: {problem.tilt:g}: write an angle of at most 1 rad")
        if "template" not in keys:
            if "holes" in keys:
                raise reader.fail(keys["holes"], "entry.holes: only of a template")
            problem.area = self.area(node, keys, frame, patient)
            self.check_area(node, model, problem)
            return
        for key in ("x", "y", "z", "direction", "tilt"):
            if key in keys:
                raise reader.fail(keys[key], f"entry.{key}: not with a template: its holes determine where needles enter and in which direction")
        problem.template = reader.text(keys["template"], "entry.template")
        guides = {guide.name: guide for guide in model.guides}
        if problem.template not in guides:
            raise reader.fail(keys["template"], f"entry.template: no guide \"{problem.template}\": the scene has {', '.join(guides) or 'none'}")
        guide = guides[problem.template]
        there = [plans.hole_name(column, row) for row in range(guide.rows) for column in range(guide.columns)]
        for i, item in enumerate(reader.items(keys["holes"], "entry.holes") if "holes" in keys else []):
            number = plans.hole_number(reader.text(item, f"entry.holes[{i}]"))
            if number is None or plans.hole_name(*number) not in there:
                raise reader.fail(item, f"entry.holes[{i}]: no hole \"{item.value}\": there are {there[0]} to {there[-1]}")
            if plans.hole_name(*number) in problem.holes:
                raise reader.fail(item, f"entry.holes[{i}]: {plans.hole_name(*number)} is given twice: remove one")
            problem.holes.append(plans.hole_name(*number))
        if "holes" in keys and not problem.holes:
            raise reader.fail(keys["holes"], "entry.holes: empty: write at least one, or leave it out for all holes")
        problem.holes = problem.holes or there

    def avoid(self, node: Any, model: Model, frame: Frame, problem: Problem) -> None:
        reader = self.reader
        for i, item in enumerate(reader.items(node, "avoid")):
            place = f"avoid[{i}]"
            keys = reader.mapping(item, place, ("clearance",), ("surface", "region", "contours", "roi"))
            kinds = [kind for kind in ("surface", "region", "contours") if kind in keys]
            if len(kinds) != 1:
                raise reader.fail(item, f"{place}: write one of surface, region and contours")
            kind = kinds[0]
            if ("roi" in keys) != (kind == "contours"):
                raise reader.fail(item, f"{place}: \"roi\", the name of a region of interest in the file, is required with contours and allowed only there")
            clearance = self.length(keys["clearance"], f"{place}.clearance", inclusive=True)
            spacing = spacing_of(clearance)
            if kind == "contours":
                path, name = self.file(keys["contours"], f"{place}.contours"), reader.text(keys["roi"], f"{place}.roi")
                if not frame.is_patient:
                    raise reader.fail(keys["contours"], f"{place}.contours: contours are in the patient's coordinates, and the scene has no patient_to_mesh: add it")
                try:
                    points = contour_points(read_contours(path, name), frame.to_mesh, spacing)
                except BadContours as error:
                    raise reader.fail(keys["roi"], f"{place}: {error}") from error
            else:
                name = reader.text(keys[kind], f"{place}.{kind}")
                if name not in model.groups:
                    raise reader.fail(keys[kind], f"{place}.{kind}: no {kind} \"{name}\": the mesh has {', '.join(model.groups)}")
                try:
                    points = (surface_points if kind == "surface" else region_points)(model, name, spacing, MOST_POINTS)
                except ValueError as error:
                    remedy = "write its surface, or a larger clearance" if kind == "region" else "write a larger clearance"
                    raise reader.fail(keys[kind], f"{place}.{kind}: \"{name}\" is too large: {error}; at most {MOST_POINTS:.0e} are kept: {remedy}") from None
            if not len(points):
                raise reader.fail(keys[kind], f"{place}.{kind}: \"{name}\" is not a {kind}, or is empty")
            problem.obstacles.append(Obstacle(name, clearance, points))

    def steering(self, given: dict[str, Any], problem: Problem) -> None:
        reader = self.reader
        if "roll" in given and reader.text(given["roll"], "roll") != "free":
            problem.roll = reader.number(given["roll"], "roll", -math.inf)
        problem.turn = problem.bevelled and bool(problem.template)
        if "turn" in given:
            word = reader.text(given["turn"], "turn")
            if word not in ("true", "false"):
                raise reader.fail(given["turn"], "turn: write true or false")
            if word == "true" and not problem.bevelled:
                raise reader.fail(given["turn"], "turn: the scene's needle has no bevel: set needle.bevel_slope, or leave it out")
            problem.turn = word == "true"
        if problem.roll is None and not problem.bevelled:
            problem.roll = 0.0

    def read(self) -> Problem:
        reader = self.reader
        given = reader.mapping(reader.root, "", ("scene",), ("set", "coordinates", "targets", "plan", "entry", "roll", "turn", "tolerance", "speed", "settle", "avoid",
                                                          "uncertainty"))
        if ("plan" in given) == ("targets" in given):
            raise reader.fail(reader.root, "write targets, or a plan whose seeds are the targets")
        study = Study(reader.path, "", {}, None, [], "sobol", 0, 0, [])
        problem = Problem(reader.path, study, Implant())
        scene = self.load(given, study)
        self.settings(given, study, scene)
        scene["needles"] = 1.0    # needles are planned one at a time
        problem.bevelled = float(scene["needle.bevel_slope"]) != 0.0
        number = lambda key, standard, **limit: reader.number(given[key], key, **limit) if key in given else standard
        problem.hand = Implant(speed=number("speed", problem.hand.speed, least=SLOWEST, inclusive=True), settle=number("settle", problem.hand.settle, inclusive=True))
        if problem.hand.settle > LONGEST_REST:
            raise reader.fail(given["settle"], f"settle: {problem.hand.settle:g} s: write at most {LONGEST_REST:g}")
        if "tolerance" in given:
            problem.tolerance = self.length(given["tolerance"], "tolerance")
        try:
            model = Model(scene, mesh_only=True)
        except Error as error:
            raise BadProblem(str(error)) from error
        frame = Frame(model)
        patient = self.in_patient(given, "coordinates", frame.is_patient)
        if "plan" in given:
            for key in ("entry", "roll", "turn", "avoid", "coordinates"):
                if key in given:
                    raise reader.fail(given[key], f"{key}: not with a plan: its needles stay in their holes, and only depths are found")
            path = self.file(given["plan"], "plan")
            try:
                problem.plan = plans.read(path)
                if not sum(plans.check(problem.plan, model).values()):
                    raise reader.fail(given["plan"], f"plan: {path} has no seeds: write targets")
            except BadPlan as error:
                raise BadProblem(str(error)) from error
        else:
            if "entry" not in given:
                raise reader.fail(reader.root, "missing key \"entry\"")
            self.targets(given["targets"], frame, patient, model, problem)
            self.entry(given["entry"], frame, patient, model, problem)
            self.steering(given, problem)
            if "avoid" in given:
                self.avoid(given["avoid"], model, frame, problem)
        if "uncertainty" in given:
            self.uncertainty(given["uncertainty"], scene, problem)
        problem.nominal = np.array([float(scene[parameter.name]) for parameter in study.parameters])
        return problem


def read(path: str | PathLike[str]) -> Problem:
    """Reads a planning problem. Raises BadProblem if the file contains anything that is not part of the format."""
    return _ProblemReader(fspath(path)).read()
