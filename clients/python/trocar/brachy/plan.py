"""Implant plans. Needles are given in template coordinates, and seeds by their distance back from the needle tip.

A plan is a YAML file:

    template: template             # name of the guide in the scene; its holes follow
    columns: 13
    rows: 13
    spacing: 5e-3                  # m
    source: {isotope: I-125, model: "6711", strength: 0.5}    # the same for all seeds; air-kerma strength in U; optional
    prescription: 145              # Gy, minimum dose to the target; optional
    needles:
      - hole: C3.5                 # a letter for the column, from A; a number for the row, from 1 in steps of 0.5
        depth: 0.115               # m, from the template's entry face to the tip
        seeds: [2.25e-3, 12.25e-3] # m, from the tip back to each seed's centre
        roll: 1.57                 # rad, rotation of the needle about its axis; optional
        turn: {depth: 0.08, by: 3.14159}    # turn the needle by this angle (rad) at this depth (m); optional
      - name: T1                   # optional
        entry: [0.01, 0, -5e-3]    # m, mesh coordinates; instead of a hole, for a needle without seeds; depths are measured from here
        direction: [0, 0.1, 1]     # need not be a unit vector; optional, default [0, 0, 1]
        depth: 0.06

A plan whose needles all have entry points needs no template, columns, rows or spacing. At roll 0, the bevel faces where +y ends up after the shortest
rotation from +z to the needle's direction (`trocar.motion.towards`).

Command line:

    python3 -m trocar.brachy.plan show | check | export | import | compare ...    --help says more
"""
from __future__ import annotations

import csv
import math
import re
import sys
from dataclasses import dataclass, field
from os import PathLike, fspath
from typing import Any, Iterable, NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Guide, Model, Sim
from .._files import open_input
from .._locate import locate
from .._lcm_messages import Seeds
from .._reader import Reader

__all__ = ["BadPlan", "Frame", "Misplacement", "Needle", "Plan", "Planned", "Placed", "Source", "Turn", "compare", "guide_of", "hole_axis", "hole_name",
           "hole_number", "needle_axis", "planned_seeds", "read", "read_seeds", "seeds_of", "seeds_of_message", "summary", "without_steering", "write"]

HALF_LIFE = {"I-125": 59.40, "Pd-103": 16.991, "Cs-131": 9.69}  # days, from TG-43U1 and its supplement S1; a plan may use only these isotopes
_SPACING_TOLERANCE = 1e-6  # m
_GAP = 1e-9                # m, tolerance for rounding errors in sums of lengths


class BadPlan(Exception):
    """Raised if a plan or seed table cannot be used. The message gives the file and line and says how to fix it."""


@dataclass
class Source:
    """Model and strength of a plan's seeds; all seeds are the same."""

    isotope: str     # a key of HALF_LIFE
    model: str       # the manufacturer's name for the model
    strength: float  # U (uGy m^2/h), air-kerma strength of one seed at the time of the implant


class Turn(NamedTuple):
    """A rotation of the needle about its axis partway through the insertion. The insertion pauses meanwhile."""

    depth: float        # m, tip depth at which the needle is turned, measured like `Needle.depth`
    by: float           # rad


@dataclass
class Needle:
    """One needle of a plan."""

    hole: str           # name of the hole, such as C3.5; "" if the needle has an entry point instead
    depth: float        # m, distance from the template's entry face, or from the entry point, to the tip
    seeds: list[float]  # m, distances from the tip back to each seed's centre, in ascending order
    line: int = 0       # line number in the file; 0 if unknown
    name: str = ""
    roll: float = 0.0   # rad
    turn: Turn | None = None
    entry: tuple[float, ...] | None = None               # (3) m, entry point in mesh coordinates
    direction: tuple[float, ...] = (0.0, 0.0, 1.0)       # unit vector, for a needle with an entry point

    @property
    def title(self) -> str:
        """The needle's name or hole, for use in messages."""
        return self.name or self.hole or "without a name"


@dataclass
class Plan:
    """An implant plan, as read from its file."""

    template: str   # name of the scene's guide; "" if no needle uses a hole
    columns: int
    rows: int
    spacing: float  # m
    needles: list[Needle] = field(default_factory=list)
    source: Source | None = None
    path: str = "plan"
    line: int = 0   # line of the `template` key in the file; 0 if unknown
    prescription: float | None = None                    # Gy
    remarks: list[str] = field(default_factory=list)     # what the reader had to change, in words


class Planned(NamedTuple):
    """A planned seed, with its position in the tissue at rest."""

    hole: str
    number: int                          # position of the seed in its needle, counted from 1 at the distal end
    position: npt.NDArray[np.float64]    # (3,) m, the seed's centre in mesh coordinates
    direction: npt.NDArray[np.float64]   # (3,) unit vector from template to tip


class Placed(NamedTuple):
    """A seed left in the tissue, as read from the table written by trocar-replay --seeds or taken from a simulation."""

    number: int                          # number of the seed's row in the table, counted from 1
    guide: str                           # name of the guide that the needle was in, or ""
    hole: str
    position: npt.NDArray[np.float64]    # (3,) m, the seed's centre in mesh coordinates
    direction: npt.NDArray[np.float64]   # (3,) unit vector towards the seed's distal end


class Misplacement(NamedTuple):
    """A planned seed and its placed counterpart. One of the two is None if there is no counterpart."""

    hole: str
    planned: Planned | None
    placed: Placed | None
    offset: npt.NDArray[np.float64] | None  # (3,) mm, placed minus planned position, in the axes of `Frame`
    along: float | None                     # mm, offset along the planned needle, positive if the seed is too deep
    across: float | None                    # mm


# ---- holes --------------------------------------------------------------------------------------------------------------------


def hole_name(column: int, row: int) -> str:
    """Returns the name of the hole in a column and row, both counted from 0: hole_name(2, 5) is "C3.5". Columns after Z are called AA, AB and so on."""
    letters = chr(65 + column) if column < 26 else chr(64 + column // 26) + chr(65 + column % 26)
    return f"{letters}{1 + row // 2}{'.5' if row % 2 else ''}"


def hole_number(name: str) -> tuple[int, int] | None:
    """Inverse of `hole_name`, ignoring case: returns (column, row), or None if `name` is not a valid hole name."""
    match = re.fullmatch(r"([A-Z]{1,2})([1-9]\d?)(?:\.([05]))?", name.upper())
    if not match:
        return None
    column = 0
    for letter in match[1]:
        column = 26 * column + ord(letter) - 64
    return column - 1, 2 * (int(match[2]) - 1) + (match[3] == "5")


def _grid_words(columns: int, rows: int) -> str:
    return f"columns A to {re.sub('[0-9.]', '', hole_name(columns - 1, 0))}, rows 1 to {hole_name(0, rows - 1)[1:]} in halves"


# ---- reading and writing --------------------------------------------------------------------------------------------------------


def _read_hole(reader: Reader, node: Any, place: str, plan: Plan, seedless: bool) -> str:
    name = reader.text(node, place)
    if not plan.template:
        raise reader.fail(node, f"{place}: the plan has no template: write template, columns, rows and spacing, or an entry instead of the hole")
    at = hole_number(name)
    if at is None or at[0] >= plan.columns or at[1] >= plan.rows:
        raise reader.fail(node, f"{place}: no hole \"{name}\": the template has {_grid_words(plan.columns, plan.rows)}, as in "
                          f"{hole_name(plan.columns // 2, plan.rows // 2)}")
    name = hole_name(*at)
    for other in plan.needles:
        if other.hole == name and not (seedless and not other.seeds):
            raise reader.fail(node, f"{place}: {name} is taken by the needle in line {other.line}: a hole has one needle with seeds")
    return name


def _read_direction(reader: Reader, node: Any, place: str) -> tuple[float, ...]:
    vector = reader.numbers(node, place, 3)
    length = math.hypot(*vector)
    if length < 1e-9:
        raise reader.fail(node, f"{place}: it has no length: write a vector from the entry into the tissue")
    return tuple(x / length for x in vector)


def _read_needle(reader: Reader, node: Any, place: str, plan: Plan) -> Needle:
    keys = reader.mapping(node, place, ("depth",), ("name", "hole", "entry", "direction", "seeds", "roll", "turn"))
    if ("hole" in keys) == ("entry" in keys):
        raise reader.fail(node, f"{place}: write a hole or an entry: a hole of the template, or a point x, y, z")
    if "seeds" not in keys and "hole" in keys:
        raise reader.fail(node, f"{place}: missing key \"seeds\": write [] for a needle without seeds")
    items = reader.items(keys["seeds"], f"{place}.seeds") if "seeds" in keys else []
    if items and "entry" in keys:
        raise reader.fail(keys["seeds"], f"{place}.seeds: only of a needle in a hole")
    if "direction" in keys and "hole" in keys:
        raise reader.fail(keys["direction"], f"{place}.direction: only with an entry: a hole has its axis")
    needle = Needle(_read_hole(reader, keys["hole"], f"{place}.hole", plan, not items) if "hole" in keys else "",
                    reader.number(keys["depth"], f"{place}.depth"), [], reader.line(node))
    if "entry" in keys:
        needle.entry = tuple(reader.numbers(keys["entry"], f"{place}.entry", 3))
    if "direction" in keys:
        needle.direction = _read_direction(reader, keys["direction"], f"{place}.direction")
    if "name" in keys:
        needle.name = reader.text(keys["name"], f"{place}.name")
    if "roll" in keys:
        needle.roll = reader.number(keys["roll"], f"{place}.roll", -math.inf)
    if "turn" in keys:
        turn = reader.mapping(keys["turn"], f"{place}.turn", ("depth", "by"))
        needle.turn = Turn(reader.number(turn["depth"], f"{place}.turn.depth"), reader.number(turn["by"], f"{place}.turn.by", -math.inf))
        if needle.turn.depth >= needle.depth:
            raise reader.fail(turn["depth"], f"{place}.turn.depth: {needle.turn.depth:g} m is not before the needle's depth, {needle.depth:g} m")
    for i, item in enumerate(items):
        seed = reader.number(item, f"{place}.seeds[{i}]")
        if needle.seeds and seed <= needle.seeds[-1]:
            raise reader.fail(item, f"{place}.seeds[{i}]: {seed:g} m is not behind the one before, {needle.seeds[-1]:g} m: list them from the tip back")
        if seed >= needle.depth:
            raise reader.fail(item, f"{place}.seeds[{i}]: {seed:g} m behind the tip is outside of the template's face, which is {needle.depth:g} m behind it; "
                              "lengths are in metres")
        needle.seeds.append(seed)
    return needle


def _all_have_entries(reader: Reader, node: Any) -> bool:
    keys = [[str(key.value) for key, _ in item.value] if isinstance(item, reader.yaml.MappingNode) else [] for item in reader.items(node, "needles")]
    return bool(keys) and all("entry" in there for there in keys)


def read(path: str | PathLike[str]) -> Plan:
    """Reads a plan. Raises BadPlan if the file contains anything that is not part of the format."""
    of_template = ("template", "columns", "rows", "spacing")
    reader = Reader(fspath(path), "plan", BadPlan, "template, columns, rows, spacing and needles")
    others = ("source", "prescription")
    keys = reader.mapping(reader.root, "", (), (*of_template, "needles", *others))
    plan = Plan("", 0, 0, 0.0, path=fspath(path))
    if "needles" not in keys or any(key in keys for key in of_template) or not _all_have_entries(reader, keys["needles"]):
        keys = reader.mapping(reader.root, "", (*of_template, "needles"), others)
        plan.template, plan.line = reader.text(keys["template"], "template"), reader.line(keys["template"])
        plan.columns, plan.rows = reader.count(keys["columns"], "columns"), reader.count(keys["rows"], "rows")
        plan.spacing = reader.number(keys["spacing"], "spacing")
    if "source" in keys:
        given = reader.mapping(keys["source"], "source", ("isotope", "model", "strength"))
        isotope = reader.text(given["isotope"], "source.isotope")
        if isotope not in HALF_LIFE:
            raise reader.fail(given["isotope"], f"source.isotope: \"{isotope}\": there are {', '.join(HALF_LIFE)}")
        plan.source = Source(isotope, reader.text(given["model"], "source.model"), reader.number(given["strength"], "source.strength"))
    if "prescription" in keys:
        plan.prescription = reader.number(keys["prescription"], "prescription")
    for i, node in enumerate(reader.items(keys["needles"], "needles")):
        plan.needles.append(_read_needle(reader, node, f"needles[{i}]", plan))
    if not plan.needles:
        raise reader.fail(keys["needles"], "needles: empty: a plan has at least one")
    return plan


def write(plan: Plan, path: str | PathLike[str], comment: str = "") -> None:
    """Writes a plan in the format that `read` expects."""
    number = lambda value: f"{value:.9g}"
    numbers = lambda values: f"[{', '.join(map(number, values))}]"
    quoted = lambda text: "\"" + text.replace("\\", "\\\\").replace("\"", "\\\"") + "\""
    lines = [f"# {line}" for line in comment.splitlines()]
    if plan.template:
        lines += [f"template: {quoted(plan.template)}", f"columns: {plan.columns}", f"rows: {plan.rows}", f"spacing: {number(plan.spacing)}    # m"]
    if plan.source:
        lines.append(f"source: {{isotope: {plan.source.isotope}, model: {quoted(plan.source.model)}, strength: {number(plan.source.strength)}}}")
    if plan.prescription is not None:
        lines.append(f"prescription: {number(plan.prescription)}    # Gy")
    lines.append("needles:    # m: depth of the tip behind the template's face, or the entry; seeds from the tip back to their centres; rad: roll, turn.by")
    for needle in plan.needles:
        cells = [f"name: {quoted(needle.name)}"] if needle.name else []
        cells += [f"hole: {needle.hole}"] if needle.entry is None else [f"entry: {numbers(needle.entry)}", f"direction: {numbers(needle.direction)}"]
        cells.append(f"depth: {number(needle.depth)}")
        if needle.roll:
            cells.append(f"roll: {number(needle.roll)}")
        if needle.turn:
            cells.append(f"turn: {{depth: {number(needle.turn.depth)}, by: {number(needle.turn.by)}}}")
        if needle.entry is None:
            cells.append(f"seeds: {numbers(needle.seeds)}")
        lines.append(f"  - {{{', '.join(cells)}}}")
    with open(path, "w", encoding="utf-8") as file:
        file.write("\n".join(lines) + "\n")


# ---- a plan in a scene ------------------------------------------------------------------------------------------------------------


class Frame:
    """The coordinate system for printing positions: patient coordinates (mm towards the left, the back and the head) if the scene defines them, otherwise
    mesh axes, also in mm."""

    def __init__(self, model: Model):
        matrix = model.patient_to_mesh
        self.is_patient = matrix is not None
        self.names = ("left", "posterior", "superior") if self.is_patient else ("x", "y", "z")
        self._from_mesh = np.linalg.inv(matrix) if matrix is not None else np.diag([1e3, 1e3, 1e3, 1.0])

    def position(self, point: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Converts positions (..., 3) from mesh coordinates (m) to this frame (mm)."""
        return np.asarray(point) @ self._from_mesh[:3, :3].T + self._from_mesh[:3, 3]

    def vector(self, vector: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Converts vectors (..., 3), such as differences between positions, from mesh coordinates (m) to this frame (mm)."""
        return np.asarray(vector) @ self._from_mesh[:3, :3].T

    def to_mesh(self, point: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Converts positions (..., 3) from this frame (mm) to mesh coordinates (m)."""
        to_mesh = np.linalg.inv(self._from_mesh)
        return np.asarray(point) @ to_mesh[:3, :3].T + to_mesh[:3, 3]


def guide_of(plan: Plan, model: Model) -> Guide:
    """Returns the guide in the scene that is the plan's template. Raises BadPlan if the scene has no such guide."""
    place = f"{plan.path}:{plan.line}" if plan.line else plan.path
    if not plan.template:
        raise BadPlan(f"{place}: the plan has no template: its needles have entries instead of holes")
    guides = model.guides
    guide = next((g for g in guides if g.name == plan.template), None)
    if guide is None:
        there = ", ".join(g.name for g in guides)
        raise BadPlan(f"{place}: the plan is for the template \"{plan.template}\"; the scene has {there or 'none'}: choose that scene, or make a new plan")
    if (guide.columns, guide.rows) != (plan.columns, plan.rows) or abs(guide.spacing - plan.spacing) > _SPACING_TOLERANCE:
        raise BadPlan(f"{place}: the plan's template \"{plan.template}\" has {plan.columns} x {plan.rows} holes, {1e3 * plan.spacing:g} mm apart; the scene's has "
                      f"{guide.columns} x {guide.rows}, {1e3 * guide.spacing:g} mm apart: choose that scene, or make a new plan")
    return guide


def hole_axis(guide: Guide, hole: str) -> npt.NDArray[np.float64]:
    """Returns the point (3,) m where a hole's axis meets the guide's front face, on the side where needles enter."""
    column, row = hole_number(hole)
    aside = [guide.spacing * (index - 0.5 * (count - 1)) for index, count in ((column, guide.columns), (row, guide.rows))]
    return guide.origin + aside[0] * guide.across[0] + aside[1] * guide.across[1]


def needle_axis(plan: Plan, needle: Needle, model: Model) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Returns the point (3,) m from which the needle's depth is measured, and its direction (3,), a unit vector. Raises BadPlan like `guide_of`."""
    if needle.entry is not None:
        return np.array(needle.entry), np.array(needle.direction) / np.linalg.norm(needle.direction)
    guide = guide_of(plan, model)
    return hole_axis(guide, needle.hole), guide.normal


def planned_seeds(plan: Plan, model: Model) -> list[Planned]:
    """Computes where the plan puts its seeds in the tissue at rest: on the hole axes. Raises BadPlan if the template in the scene differs from the plan's,
    if the scene's needle is too short, or if seeds would overlap."""
    length, reach = model.seed_size.length, model.needle_length
    found = []
    for needle in plan.needles:
        face, direction = needle_axis(plan, needle, model)
        place = f"{plan.path}:{needle.line}: needle {needle.title}" if needle.line else f"{plan.path}: needle {needle.title}"
        if needle.depth >= reach:
            raise BadPlan(f"{place}: its depth of {needle.depth:g} m does not leave its base in front of the {'template' if needle.hole else 'entry'}: the scene's "
                          f"needle is {reach:g} m long; lengths are in metres")
        if needle.seeds and needle.seeds[0] < 0.5 * length - _GAP:
            raise BadPlan(f"{place}: the first seed's centre is {1e3 * needle.seeds[0]:g} mm behind the tip, less than half of its length of {1e3 * length:g} mm")
        for before, after in zip(needle.seeds, needle.seeds[1:]):
            if after - before < length - _GAP:
                raise BadPlan(f"{place}: seeds of {1e3 * length:g} mm at {1e3 * before:g} and {1e3 * after:g} mm behind the tip overlap")
        for i, seed in enumerate(needle.seeds):
            found.append(Planned(needle.hole, i + 1, face + (needle.depth - seed) * direction, direction))
    return found


def _regions_at(model: Model, points: npt.NDArray[np.float64]) -> list[str | None]:
    """Returns the region that contains each point (k, 3), or None outside the tissue. A region that is part of another is reported as that other region."""
    names, wholes = model.groups, model.part_of
    return [names[wholes[model.tet_regions[tet]]] if tet >= 0 else None for tet in locate(model, points)[0]]


def check(plan: Plan, model: Model) -> dict[str, int]:
    """Counts the plan's seeds by region, where a region includes its parts. Raises BadPlan like `planned_seeds`, and also if a seed is not entirely inside
    the tissue."""
    seeds, half = planned_seeds(plan, model), 0.5 * model.seed_size.length
    if not seeds:
        return {}
    ends = np.array([s.position + end * half * s.direction for s in seeds for end in (-1, 0, 1)])
    regions, counts = _regions_at(model, ends), {}
    for i, seed in enumerate(seeds):
        if None in regions[3 * i:3 * i + 3]:
            needle = next(n for n in plan.needles if n.hole == seed.hole)
            raise BadPlan(f"{plan.path}:{needle.line}: needle {seed.hole}: seed {seed.number}, {1e3 * needle.seeds[seed.number - 1]:g} mm behind the tip, is not "
                          "in the tissue")
        counts[regions[3 * i + 1]] = counts.get(regions[3 * i + 1], 0) + 1
    return counts


# ---- what was achieved --------------------------------------------------------------------------------------------------------------


def read_seeds(path: str | PathLike[str], model: Model, now: bool = False) -> list[Placed]:
    """Reads the table written by `trocar-replay --seeds`. now: use the positions at the end of the replay instead of those in the tissue at rest."""
    name, prefix, frame = fspath(path), "" if now else "rest_", Frame(model)
    try:
        with open_input(path, newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except OSError as error:
        raise BadPlan(f"{name}: cannot be opened: {error.strerror}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadPlan(f"{name}: not a table: {error}") from error
    header = rows[0] if rows else []
    unit = next((u for u in ("m", "mm") if f"rest_x [{u}]" in header), None)
    needed = ["seed", "guide", "hole", *(f"{prefix}{axis} [{unit}]" for axis in "xyz"), *(f"{prefix}along_{axis}" for axis in "xyz")]
    if unit is None or any(column not in header for column in needed):
        raise BadPlan(f"{name}:1: not a table of seeds: write one with trocar-replay --seeds")
    if unit == "mm" and not frame.is_patient:
        raise BadPlan(f"{name}:1: in the patient's coordinates, which the scene does not have: replay without --patient, or choose the scene that it was made with")
    seeds = []
    for line, row in enumerate(rows[1:], 2):
        if len(row) != len(header):
            raise BadPlan(f"{name}:{line}: {len(row)} columns, not {len(header)}")
        value = dict(zip(header, row))
        try:
            position, direction = np.array([float(value[column]) for column in needed[3:]]).reshape(2, 3)
            number = int(value["seed"])
        except ValueError as error:
            raise BadPlan(f"{name}:{line}: {error}") from error
        if not np.isfinite([position, direction]).all():
            raise BadPlan(f"{name}:{line}: a number is not finite")
        if abs(np.linalg.norm(direction) - 1) > 1e-3:
            raise BadPlan(f"{name}:{line}: along_x, along_y and along_z are not a unit vector")
        if unit == "mm":
            position, ahead = frame.to_mesh([position, position + direction])
            direction = 1e3 * (ahead - position)
        seeds.append(Placed(number, value["guide"], value["hole"], position, direction))
    return seeds


def _placed(number: int, guides: Sequence[Guide], index: int | None, hole: int | None, place: npt.NDArray[np.float64], along: npt.NDArray[np.float64]) -> Placed:
    """Returns a seed that a needle in this guide and hole left; each is None or below 0 if there is none."""
    known = index is not None and 0 <= index < len(guides) and hole is not None and hole >= 0
    guide = guides[index] if known else None
    return Placed(number, guide.name if guide else "", hole_name(hole % guide.columns, hole // guide.columns) if guide else "", place, along)


def seeds_of_message(seeds: Seeds, model: Model, now: bool = False) -> list[Placed]:
    """Returns the seeds of a message on TROCAR_SEEDS. now: use their positions in the displaced tissue instead of those in the tissue at rest."""
    places, directions = (seeds.position, seeds.direction) if now else (seeds.rest, seeds.rest_direction)
    guides = model.guides
    return [_placed(i + 1, guides, *row) for i, row in enumerate(zip(seeds.guide.tolist(), seeds.hole.tolist(), places, directions))]


def seeds_of(sim: Sim, now: bool = False) -> list[Placed]:
    """Returns the seeds left in a simulation. now: use their current positions, in the displaced tissue, instead of those in the tissue at rest."""
    seeds, guides = sim.seeds(), sim.model.guides
    places, directions = sim.model.displaced_seeds(seeds, sim.displacements()) if now else ([s.position for s in seeds], [s.direction for s in seeds])
    return [_placed(i + 1, guides, seed.guide, seed.hole, place, along) for i, (seed, place, along) in enumerate(zip(seeds, places, directions))]


def _pairs(planned: Sequence[float], placed: Sequence[float]) -> list[tuple[int | None, int | None]]:
    """Matches the planned and placed seeds of one needle, both given in order of depth, without changing that order. Makes as many pairs as possible and
    minimises the sum of their distances."""
    few, many = sorted((planned, placed), key=len)
    cost = np.full((len(few) + 1, len(many) + 1), np.inf)
    cost[0] = 0.0
    for i in range(1, len(few) + 1):
        for k in range(i, len(many) + 1):
            cost[i, k] = min(cost[i, k - 1], cost[i - 1, k - 1] + abs(few[i - 1] - many[k - 1]))
    partner: list[int | None] = [None] * len(many)
    i = len(few)
    for k in range(len(many), 0, -1):
        if i > 0 and cost[i, k] < cost[i, k - 1]:
            i -= 1
            partner[k - 1] = i
    pairs = [(p, k) for k, p in enumerate(partner)]
    return pairs if few is planned else [(k, p) for p, k in pairs]


def compare(plan: Plan, model: Model, placed: Iterable[Placed]) -> list[Misplacement]:
    """Returns each seed's misplacement relative to the plan. Seeds in the same hole are paired in order along the needle. Planned seeds that were not
    placed, and placed seeds that were not planned, have no counterpart."""
    frame, planned, placed = Frame(model), planned_seeds(plan, model), list(placed)
    normal = guide_of(plan, model).normal
    own = lambda seed: seed.guide == plan.template
    rows: list[Misplacement] = []
    for hole in dict.fromkeys([s.hole for s in planned] + [s.hole for s in placed if own(s)]):
        wanted = [s for s in planned if s.hole == hole]
        there = sorted((s for s in placed if own(s) and s.hole == hole), key=lambda s: -(s.position @ normal))
        for p, k in _pairs([-(s.position @ normal) for s in wanted], [-(s.position @ normal) for s in there]):
            if p is None or k is None:
                rows.append(Misplacement(hole, None if p is None else wanted[p], None if k is None else there[k], None, None, None))
                continue
            off, axis = frame.vector(there[k].position - wanted[p].position), frame.vector(wanted[p].direction)
            along = float(off @ axis / np.linalg.norm(axis))
            across = math.sqrt(max(off @ off - along * along, 0.0))
            rows.append(Misplacement(hole, wanted[p], there[k], off, along, across))
    return rows + [Misplacement(s.hole, None, s, None, None, None) for s in placed if not own(s)]


def summary(rows: Sequence[Misplacement]) -> dict[str, float]:
    """Summarises the seeds that have a counterpart. `count` is their number. The rest are means in mm: `distance`; the absolute offset along each axis (`0`,
    `1`, `2`); `along`, of absolute values; `across`; and `deeper`, the signed mean of `along`."""
    both = [r for r in rows if r.offset is not None]
    if not both:
        return {"count": 0}
    offsets, along = np.array([r.offset for r in both]), np.array([r.along for r in both])
    return {"count": len(both), "distance": float(np.linalg.norm(offsets, axis=1).mean()),
            **{str(i): float(value) for i, value in enumerate(np.abs(offsets).mean(axis=0))},
            "along": float(np.abs(along).mean()), "across": float(np.mean([r.across for r in both])), "deeper": float(along.mean())}


def without_steering(plan: Plan, what: str) -> Plan:
    """Returns the plan as it is, but raises BadPlan if it has needles with a roll or turn, which the format `what` cannot express."""
    for needle in plan.needles:
        if needle.roll or needle.turn:
            raise BadPlan(f"{plan.path}:{needle.line}: needle {needle.title}: {what} cannot express a roll or turn: carry the plan out with "
                          "trocar.brachy.implant.Implant")
    return plan


if __name__ == "__main__":
    from ._plan_command import main

    sys.exit(main())
