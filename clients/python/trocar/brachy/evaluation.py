"""Computes the dose of an implant to the patient's organs: as planned, with the tissue displaced by the needles, after the needles are removed, and as
delivered while the gland swells and shrinks."""
from __future__ import annotations

import datetime
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import NamedTuple, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model
from .._files import replacing
from ._dose import DVH, Dose, Source
from ._goals import FIGURES, Figure, figures
from .organs import Displaced, Organ
from .plan import HALF_LIFE, BadPlan, Frame, Misplacement, Placed, Plan, compare, planned_seeds
from .swelling import Swelling, Swollen, delivered

Array = npt.NDArray[np.float64]
Seeds = list[tuple[Array, Array]]    # positions (3,) m and directions (3,), in mesh coordinates

__all__ = ["Dosimetry", "State", "evaluate", "planned_state", "seed_model", "source_of", "write_dicom"]

HALF_LIVES = 0.01    # largest relative difference allowed between the half-life in a table and that of the plan's isotope
AROUND = 10.0        # mm, margin around the organs in the RT Dose grid

PLANNED, DISPLACED, OUT, DELIVERED = "planned", "at the last seed", "needles out", "after swelling"


class State(NamedTuple):
    """The implant at one point in time."""

    name: str
    words: str
    histograms: dict[str, DVH]    # dose-volume histograms, by organ role
    figures: dict[str, float]     # dose-volume figures, by name: Gy, fractions or cm^3


@dataclass
class Dosimetry:
    """The dosimetry of an implant: the plan, the seeds actually placed, and the doses."""

    model: Model
    plan: Plan
    source: Source
    organs: dict[str, Organ]
    placed: list[Placed]
    states: list[State]
    misplacement: list[Misplacement]
    swelling: Swelling
    goals: Sequence[Figure]    # the dose-volume figures, with their limits


def source_of(plan: Plan, table: str | PathLike[str] | None = None) -> Source:
    """Returns the plan's seed model, built in or from a table file. Raises BadPlan if the plan has no source or prescription, if the model is unknown, or if
    the table is for a different model."""
    if plan.source is None or plan.prescription is None:
        raise BadPlan(f"{plan.path}: without \"{'source' if plan.source is None else 'prescription'}\", which the dose needs: add it")
    return seed_model(f"{plan.source.isotope} {plan.source.model}", table, plan.path)


def seed_model(name: str, table: str | PathLike[str] | None, path: str) -> Source:
    """Returns a seed model by name, built in or from a table file. path: the file that names the model, for messages. Raises BadPlan."""
    try:
        source = Source.load(table) if table else Source(name)
    except Error as error:
        raise BadPlan(str(error) if table else f"{path}: {error}, with --seed-table") from error
    isotope = name.partition(" ")[0]
    if source.name != name:
        raise BadPlan(f"{fspath(table or path)}: the table is of the seed \"{source.name}\", not of \"{name}\", which {path} asks for: choose the table of that seed")
    if isotope not in HALF_LIFE:
        raise BadPlan(f"{fspath(table or path)}: \"{name}\" does not begin with {' or '.join(HALF_LIFE)}")
    days = source.half_life / 86400.0
    if abs(days / HALF_LIFE[isotope] - 1.0) > HALF_LIVES:
        raise BadPlan(f"{fspath(table or path)}: a half-life of {days:g} days, {isotope} has {HALF_LIFE[isotope]:g}: check the table of \"{name}\"")
    return source


def dose_at(source: Source, seeds: Seeds, strength: float, points: Array) -> Array:
    """Returns the dose (n,) Gy at points (n, 3) m."""
    dose = Dose.at(source, points)
    for position, direction in seeds:
        dose.add(position, direction, strength)
    return dose.values


def _state(name: str, words: str, doses: dict[str, Array], organs: dict[str, Organ], prescription: float) -> State:
    histograms = {role: DVH(dose, organs[role].voxel) for role, dose in doses.items()}
    return State(name, words, histograms, figures(histograms, prescription))


def planned_state(plan: Plan, model: Model, source: Source, organs: dict[str, Organ]) -> State:
    """Computes the doses of the planned seeds, in the tissue at rest."""
    seeds = [(seed.position, seed.direction) for seed in planned_seeds(plan, model)]
    return _state(PLANNED, "the plan, in the tissue at rest", {role: dose_at(source, seeds, plan.source.strength, organ.points) for role, organ in organs.items()},
                  organs, plan.prescription)


def evaluate(model: Model, plan: Plan, organs: dict[str, Organ], placed: Sequence[Placed], source: Source, field: Array | None = None,
             swelling: Swelling = Swelling(), goals: Sequence[Figure] = FIGURES) -> Dosimetry:
    """Computes the doses of a plan and of the seeds actually left in the tissue. field: displacements (nodes, 3) m of the mesh nodes when the last seed was
    left, or None if unknown. Raises BadPlan if there are no seeds or the field belongs to another mesh."""
    if not placed:
        raise BadPlan(f"{plan.path}: no seeds were left in the tissue")
    if field is not None and field.shape != model.nodes.shape:
        raise BadPlan(f"displacements of {len(field)} nodes; the scene's mesh has {len(model.nodes)}: choose those of this scene")
    strength, prescription = plan.source.strength, plan.prescription
    seeds = [(seed.position, seed.direction) for seed in placed]
    states = [planned_state(plan, model, source, organs)]
    if field is not None:
        tissue = Displaced(model, field)
        moved = tissue.seeds(seeds, model.seed_size.length)
        states.append(_state(DISPLACED, "the seeds in the tissue displaced by the needles, when the last seed is left",
                             {role: dose_at(source, moved, strength, tissue.points(organ.points)) for role, organ in organs.items()}, organs, prescription))
    states.append(_state(OUT, "the seeds at their final positions, in the tissue at rest", {role: dose_at(source, seeds, strength, o.points) for role, o in organs.items()},
                         organs, prescription))
    swollen = Swollen(organs["gland"].points)
    states.append(_state(DELIVERED, f"delivered: {swelling.words()}",
                         {role: delivered(source, seeds, strength, o.points, swollen, swelling) for role, o in organs.items()}, organs, prescription))
    return Dosimetry(model, plan, source, organs, list(placed), states, compare(plan, model, placed), swelling, goals)


def _grid(done: Dosimetry, seeds: Seeds, spacing: float) -> tuple[Array, Array]:
    """Computes the dose (nx, ny, nz), in Gy, on a grid around the organs along the patient's axes, `spacing` mm apart. Also returns the centre (3,) mm of
    the first voxel."""
    frame = Frame(done.model)
    outlines = np.concatenate([outline for organ in done.organs.values() if organ.role != "rectum" for outline in organ.outlines])
    low, high = outlines.min(axis=0) - AROUND, outlines.max(axis=0) + AROUND
    origin = spacing * np.floor(low / spacing)
    counts = np.ceil((high - origin) / spacing).astype(int) + 1
    dose = Dose(done.source, 1e-3 * origin, 1e-3 * spacing, (int(counts[0]), int(counts[1]), int(counts[2])))
    for position, direction in seeds:
        dose.add(1e-3 * frame.position(position), 1e-3 * frame.vector(direction), done.plan.source.strength)
    return dose.values, origin


def write_dicom(done: Dosimetry, structures: str, folder: Path, spacing: float = 1.0, date: datetime.date | None = None) -> list[str]:
    """Writes structures.dcm, and an RT Plan and an RT Dose each for the planned seeds (planned-plan.dcm, planned-dose.dcm) and for the seeds left in the
    tissue. structures: the RT Structure Set that the organs were read from; spacing: of the dose grid, mm. Creates the folder if needed. Returns the file
    names. If it raises BadPlan, nothing has been written."""
    from . import rtplan
    from . import rtobjects
    frame, planned = Frame(done.model), planned_seeds(done.plan, done.model)
    given = rtplan._structures_of(structures)
    sets = {"seeds, planned": frame.position([seed.position for seed in planned]), "seeds, implanted": frame.position([seed.position for seed in done.placed])}
    objects = {"structures.dcm": rtobjects.structure_set(given, done.organs, sets, date)}
    for name, placed, state in (("planned", None, PLANNED), ("implanted", done.placed, OUT)):
        plan = rtplan.dataset(done.plan, done.model, objects["structures.dcm"], date, placed)
        values, origin = _grid(done, [(seed.position, seed.direction) for seed in placed or planned], spacing)
        histograms = next(s.histograms for s in done.states if s.name == state)
        objects[f"{name}-plan.dcm"] = plan
        objects[f"{name}-dose.dcm"] = rtobjects.dose(values, origin.tolist(), spacing, plan, objects["structures.dcm"],
                                                     {done.organs[role].name: dvh for role, dvh in histograms.items()}, name, date)
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in objects.items():
        with replacing(folder / name) as temporary:
            data.save_as(str(temporary), write_like_original=False)
    return list(objects)
