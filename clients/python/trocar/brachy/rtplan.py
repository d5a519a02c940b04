"""Reads and writes plans as DICOM RT Plans for permanent brachytherapy, with pydicom.

Each seed is a channel, as the standard requires for manually placed sources. The channel has two control points at the seed's centre, in patient
coordinates (mm towards the left, the back and the head), which also give the insertion direction. The applicator ID is the needle's hole; the control
points' relative position is the seed's distance behind the most distal seed position in its needle.
"""
from __future__ import annotations

import contextlib
import datetime
import math
import re
import struct
from os import PathLike, fspath
from typing import Any, Callable, Iterator, NamedTuple

import numpy as np

from .. import Guide, Model, __version__
from .plan import HALF_LIFE, BadPlan, Frame, Needle, Placed, Plan, Source, guide_of, hole_name, hole_number, planned_seeds

try:
    import pydicom
    from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
    from pydicom.sequence import Sequence
    from pydicom.uid import ExplicitVRLittleEndian, generate_uid

    from . import _dicom
except ImportError as missing:
    raise BadPlan(f"DICOM files need Debian's python3-pydicom: {missing}") from missing

__all__ = ["export", "read", "read_seeds"]

RT_PLAN = "1.2.840.10008.5.1.4.1.1.481.5"
RT_STRUCTURES = "1.2.840.10008.5.1.4.1.1.481.3"
# m, a seed farther from its hole's axis than this cannot have been planned for this template
FROM_AXIS = 0.5e-3
NOT_FOR_TREATMENT = "Not for treatment: simulated by trocar"
ON_AXIS = 0.01e-3                               # m, rounding tolerance: seeds farther from the axis than this are moved onto it, with a remark


# ---- writing ------------------------------------------------------------------------------------------------------------------------


def _item(**values: Any) -> Dataset:
    item = Dataset()
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def _decimals(values: Any) -> list[str]:
    return [f"{value + 0.0:.4f}" for value in np.asarray(values)]


def _read_file(path: str) -> Dataset:
    try:
        return _dicom.read(path)
    except EOFError as error:
        raise BadPlan(str(error)) from error
    except OSError as error:
        raise BadPlan(f"{path}: cannot be opened: {error.strerror}") from error
    except (pydicom.errors.InvalidDicomError, ValueError) as error:
        raise BadPlan(f"{path}: not a DICOM file: {error}") from error


def _structures_of(path: str) -> Dataset:
    data = _read_file(path)
    if data.get("Modality") != "RTSTRUCT":
        raise BadPlan(f"{path}: its modality is {data.get('Modality', 'not given')}, not RTSTRUCT: give the structure set that the scene was made from")
    return data


def _frame_of_reference(structures: Dataset) -> str | None:
    if "FrameOfReferenceUID" in structures:
        return structures.FrameOfReferenceUID
    frames = structures.get("ReferencedFrameOfReferenceSequence") or []
    rois = structures.get("StructureSetROISequence") or []
    return next(iter([frame.get("FrameOfReferenceUID") for frame in frames] + [roi.get("ReferencedFrameOfReferenceUID") for roi in rois]), None)


def _source_sequence(source: Source, date: str) -> Sequence:
    return Sequence([_item(SourceNumber=1, SourceType="LINE", SourceManufacturer="", SourceModelID=source.model, SourceDescription=f"{source.isotope} {source.model}",
                           SourceIsotopeName=source.isotope, SourceIsotopeHalfLife=f"{HALF_LIFE[source.isotope]:g}", SourceStrengthUnits="AIR_KERMA_RATE",
                           SourceStrength=f"{source.strength:.6g}", ReferenceAirKermaRate=f"{source.strength:.6g}", SourceStrengthReferenceDate=date, SourceStrengthReferenceTime="000000")])


def _channel(number: int, hole: str, position: Any, direction: Any, behind: float, needle_length: float, lifetime: float) -> Dataset:
    """Builds the channel for one seed. behind: mm behind the most distal seed position in its needle."""
    point = lambda index, weight: _item(ControlPointIndex=index, ControlPointRelativePosition=f"{behind + 0.0:.4f}", ControlPoint3DPosition=_decimals(position),
                                        ControlPointOrientation=[float(v) for v in direction], CumulativeTimeWeight=weight)
    return _item(ChannelNumber=number, ChannelLength=f"{needle_length:.4f}", ChannelTotalTime=f"{lifetime:.6g}", SourceMovementType="FIXED",
                 SourceApplicatorNumber=number, SourceApplicatorID=hole, SourceApplicatorType="RIGID", SourceApplicatorName=f"needle {hole}",
                 SourceApplicatorLength=f"{needle_length:.4f}", ReferencedROINumber=None, TransferTubeNumber=None, ReferencedSourceNumber=1, NumberOfControlPoints=2,
                 FinalCumulativeTimeWeight="1", BrachyControlPointSequence=Sequence([point(0, "0"), point(1, "1")]))


def _behind(placed: list[Placed], axis: np.ndarray) -> list[float]:
    """Returns each seed's distance (mm) behind the most distal seed in its hole."""
    depth = [1e3 * float(seed.position @ axis) for seed in placed]
    return [max(d for d, other in zip(depth, placed) if (other.guide, other.hole) == (seed.guide, seed.hole)) - own for own, seed in zip(depth, placed)]


def new_object(kind: str, modality: str, uid: Callable[[str], str], of: Dataset) -> FileDataset:
    """Creates a data set with the patient and study of the data set `of`, or with new ones if `of` is empty. kind: SOP class UID; uid: function that returns a
    UID for each purpose."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID, meta.TransferSyntaxUID = kind, uid(modality), ExplicitVRLittleEndian
    meta.ImplementationClassUID = pydicom.uid.PYDICOM_IMPLEMENTATION_UID
    data = FileDataset("", Dataset(), file_meta=meta, preamble=b"\0" * 128)
    data.is_little_endian, data.is_implicit_VR = True, False
    data.SpecificCharacterSet = "ISO_IR 192"
    data.SOPClassUID, data.SOPInstanceUID = kind, meta.MediaStorageSOPInstanceUID
    for keyword in ("PatientName", "PatientID", "PatientBirthDate", "PatientSex", "StudyDate", "StudyTime", "ReferringPhysicianName", "StudyID", "AccessionNumber"):
        setattr(data, keyword, of.get(keyword, "") or "")
    data.StudyInstanceUID = of.get("StudyInstanceUID") or uid("study")
    data.Modality, data.SeriesInstanceUID, data.SeriesNumber, data.OperatorsName = modality, uid(f"series of {modality}"), None, ""
    data.SeriesDescription = NOT_FOR_TREATMENT
    data.Manufacturer, data.ManufacturerModelName, data.SoftwareVersions = "trocar", "trocar", __version__
    return data


def dataset(plan: Plan, model: Model, structures: Dataset | None = None, date: datetime.date | None = None, placed: list[Placed] | None = None) -> FileDataset:
    """Builds an RT Plan of the planned seeds or, if `placed` is given, of the seeds left in the tissue. structures: the RT Structure Set that the scene was
    made from. date: date of the implant, default today. Raises BadPlan if the scene has no patient coordinates or the plan has no source."""
    frame, guide = Frame(model), guide_of(plan, model)
    if not frame.is_patient:
        raise BadPlan(f"{plan.path}: the scene has no patient_to_mesh, which DICOM's coordinates need: trocar-anatomy writes it")
    if plan.source is None:
        raise BadPlan(f"{plan.path}: without \"source\", which a DICOM plan needs: add source: {{isotope: I-125, model: \"6711\", strength: 0.5}} with your seeds' values")
    seeds = planned_seeds(plan, model) if placed is None else placed
    if not seeds:
        raise BadPlan(f"{plan.path}: no seeds")
    day = (date or datetime.date.today()).strftime("%Y%m%d")
    lifetime = HALF_LIFE[plan.source.isotope] / math.log(2)  # days, mean lifetime
    half = 0.5 * model.seed_size.length
    behind = [1e3 * (s - half) for n in plan.needles for s in n.seeds] if placed is None else _behind(placed, guide.normal)
    channels = [_channel(i + 1, s.hole, frame.position(s.position), frame.vector(s.direction) / np.linalg.norm(frame.vector(s.direction)),
                         behind[i], 1e3 * model.needle_length, 86400 * lifetime) for i, s in enumerate(seeds)]
    content = repr((plan.template, plan.source, day, placed is None, [(s.hole, s.number, _decimals(frame.position(s.position))) for s in seeds]))
    uid = lambda what: generate_uid(entropy_srcs=["trocar", what, content])

    of = structures if structures is not None else Dataset()
    data = new_object(RT_PLAN, "RTPLAN", uid, of)
    data.FrameOfReferenceUID, data.PositionReferenceIndicator = _frame_of_reference(of) or uid("frame"), ""
    data.RTPlanLabel, data.RTPlanName, data.RTPlanDate, data.RTPlanTime = "planned" if placed is None else "implanted", plan.template, day, ""
    data.RTPlanDescription, data.PlanIntent = NOT_FOR_TREATMENT, "RESEARCH"
    data.RTPlanGeometry = "PATIENT" if structures is not None else "TREATMENT_DEVICE"
    if structures is not None:
        data.ReferencedStructureSetSequence = Sequence([_item(ReferencedSOPClassUID=of.get("SOPClassUID", RT_STRUCTURES), ReferencedSOPInstanceUID=of.SOPInstanceUID)])
    data.FractionGroupSequence = Sequence([_item(FractionGroupNumber=1, NumberOfFractionsPlanned=1, NumberOfBeams=0, NumberOfBrachyApplicationSetups=1,
                                                 ReferencedBrachyApplicationSetupSequence=Sequence([_item(ReferencedBrachyApplicationSetupNumber=1)]))])
    if plan.prescription is not None:
        data.DoseReferenceSequence = Sequence([_item(DoseReferenceNumber=1, DoseReferenceStructureType="SITE", DoseReferenceDescription="target", DoseReferenceType="TARGET",
                                                     TargetPrescriptionDose=f"{plan.prescription:.6g}")])
    data.BrachyTreatmentTechnique, data.BrachyTreatmentType = "PERMANENT", "MANUAL"
    data.TreatmentMachineSequence = Sequence([_item(TreatmentMachineName="", Manufacturer="", InstitutionName="", ManufacturerModelName="", DeviceSerialNumber="")])
    data.SourceSequence = _source_sequence(plan.source, day)
    kerma = len(seeds) * plan.source.strength * 24 * lifetime
    data.ApplicationSetupSequence = Sequence([_item(ApplicationSetupType="PERINEAL", ApplicationSetupNumber=1, ApplicationSetupName=plan.template, TemplateNumber=1,
                                                    TemplateType=_template_type(guide), TemplateName=plan.template, TotalReferenceAirKerma=f"{kerma:.6g}",
                                                    ChannelSequence=Sequence(channels))])
    data.ApprovalStatus = "UNAPPROVED"
    return data


def _template_type(guide: Guide) -> str:
    return f"{guide.columns}x{guide.rows} {1e3 * guide.spacing:g} mm"  # DICOM allows at most 16 characters here


def export(plan: Plan, model: Model, path: str | PathLike[str], structures: str | PathLike[str] | None = None,
           placed: list[Placed] | None = None, date: datetime.date | None = None) -> None:
    """Writes what `dataset` builds to a file. structures: path of the RT Structure Set; the other arguments are those of `dataset`."""
    data = dataset(plan, model, _structures_of(fspath(structures)) if structures else None, date, placed)
    data.save_as(fspath(path), write_like_original=False)


# ---- reading ------------------------------------------------------------------------------------------------------------------------


def _guide_named(path: str, setup: Dataset, model: Model, template: str | None) -> Guide:
    guides, name = model.guides, str(template or setup.get("TemplateName") or "").strip()
    there = ", ".join(g.name for g in guides) or "none"
    guide = next((g for g in guides if g.name == name), None)
    if guide is None and not name and len(guides) == 1:
        guide = guides[0]
    if guide is None:
        words = f"its template is \"{name}\"" if name else "it does not name its template"
        raise BadPlan(f"{path}: {words}; the scene has {there}: choose that scene, or say with --template which of its guides to use")
    kind = re.fullmatch(r"\d+x\d+ [0-9.]+ mm", str(setup.get("TemplateType") or ""))
    if kind and _template_type(guide) != kind[0]:
        raise BadPlan(f"{path}: its template \"{name}\" has {kind[0]} of holes; the scene's has {_template_type(guide)}: choose the scene that the plan was made for")
    return guide


def _source_of(path: str, data: Dataset) -> Source | None:
    found = set()
    for item in data.get("SourceSequence") or []:
        given = str(item.get("SourceIsotopeName") or "")
        symbol = re.sub("cesium|caesium", "cs", re.sub(r"\W", "", given).lower().replace("iodine", "i").replace("palladium", "pd"))
        isotope = next((name for name in HALF_LIFE if name.replace("-", "").lower() in symbol), None)
        if isotope is None:
            raise BadPlan(f"{path}: seeds of \"{given}\": there are {', '.join(HALF_LIFE)}")
        model = str(item.get("SourceModelID") or item.get("SourceDescription") or "unknown").strip()
        found.add((isotope, model, float(item.get("ReferenceAirKermaRate") or 0.0)))
    if len(found) > 1:
        raise BadPlan(f"{path}: {len(found)} kinds of seeds or strengths: a plan has one")
    isotope, model, strength = found.pop() if found else ("", "", 0.0)
    return Source(isotope, model, strength) if strength > 0 else None


class _Seed(NamedTuple):
    channel: int
    place: np.ndarray      # (3,) mm, the seed's centre in patient coordinates
    behind: float          # mm, distance behind the most distal seed position in its needle
    along: np.ndarray      # (3,) unit vector towards the seed's distal end, in patient coordinates; zero if the file does not give it
    hole: str              # the applicator ID from the file


def _seeds_of(path: str, setup: Dataset) -> list[_Seed]:
    """Returns the seeds in a channel: one for each distinct control-point position."""
    seeds = []
    for channel in setup.get("ChannelSequence") or []:
        number, places = int(channel.get("ChannelNumber", 0)), []
        for point in channel.get("BrachyControlPointSequence") or []:
            at = point.get("ControlPoint3DPosition")
            if not at or len(at) != 3:
                raise BadPlan(f"{path}: channel {number}: a control point has no position (300A,02D4): export the plan with 3D positions")
            place = np.array([float(v) for v in at])
            if not np.isfinite(place).all():
                raise BadPlan(f"{path}: channel {number}: a position is not finite")
            if not any(np.array_equal(place, other) for other in places):
                places.append(place)
                along = np.array([float(v) for v in point.get("ControlPointOrientation") or (0.0, 0.0, 0.0)])
                seeds.append(_Seed(number, place, float(point.get("ControlPointRelativePosition") or 0.0), along, str(channel.get("SourceApplicatorID") or "").strip()))
    return seeds


def _hole_at(off: np.ndarray, guide: Guide) -> tuple[int, int, np.ndarray]:
    """Finds the hole whose axis is closest to a position, which is given relative to the guide's origin, in m. Returns its column and row, and the
    position's offset (2,) m from that axis."""
    grid = np.array([off @ guide.across[a] / guide.spacing + 0.5 * (count - 1) for a, count in enumerate((guide.columns, guide.rows))])
    column, row = (min(max(round(g), 0), count - 1) for g, count in zip(grid, (guide.columns, guide.rows)))
    return column, row, guide.spacing * (grid - [column, row])


def _needles_of(path: str, seeds: list[_Seed], guide: Guide, model: Model) -> tuple[list[Needle], list[str]]:
    """Groups the seeds into needles, in the order of the file's channels. Also returns remarks on what had to be changed."""
    frame, length = Frame(model), model.seed_size.length
    holes: dict[tuple[int, int], list[tuple[float, float]]] = {}
    moved = []
    for seed in seeds:
        off = frame.to_mesh(seed.place) - guide.origin
        column, row, aside = _hole_at(off, guide)
        where = ", ".join(f"{v:.1f}" for v in seed.place)
        if np.linalg.norm(aside) > FROM_AXIS:
            raise BadPlan(f"{path}: channel {seed.channel}: the seed at ({where}) mm is {1e3 * np.linalg.norm(aside):.1f} mm from the axis of the closest hole, "
                          f"{hole_name(column, row)}: was the plan made for this scene's template and its place? Positions where seeds were left are not a plan: read them with --seeds")
        depth = float(off @ guide.normal)
        if depth <= 0:
            raise BadPlan(f"{path}: channel {seed.channel}: the seed at ({where}) mm is in front of the template")
        moved.append(aside)
        holes.setdefault((column, row), []).append((depth, max(seed.behind, 0.0) * 1e-3))
    needles = []
    for (column, row), found in holes.items():
        tip = round(max(depth + behind for depth, behind in found) + 0.5 * length, 7)
        needles.append(Needle(hole_name(column, row), tip, sorted(round(tip - depth, 7) for depth, _ in found)))
    return needles, _remarks_on(np.array(moved), guide)


def _remarks_on(moved: np.ndarray, guide: Guide) -> list[str]:
    """Returns remarks on how far (m) seeds had to be moved to lie on the axes of their holes."""
    far = np.linalg.norm(moved, axis=1)
    if far.max() <= ON_AXIS:
        return []
    mean = 1e3 * moved.mean(axis=0)
    all_alike = np.linalg.norm(moved - moved.mean(axis=0), axis=1).max() <= ON_AXIS
    words = f"all by the same {1e3 * far.max():.2f} mm ({mean[0]:+.2f} along columns, {mean[1]:+.2f} along rows): check the template's place" if all_alike else \
            f"by {1e3 * far.max():.2f} mm at most, {1e3 * far.mean():.2f} on average"
    return [f"{int(np.sum(far > ON_AXIS))} of {len(far)} seeds were off the axes of their holes and have been moved onto them, {words}"]


def _prescription_of(data: Dataset) -> float | None:
    """Returns the prescription in Gy, or None unless the file has exactly one."""
    found = {float(item.TargetPrescriptionDose) for item in data.get("DoseReferenceSequence") or [] if item.get("DoseReferenceType") == "TARGET" and item.get("TargetPrescriptionDose")}
    return found.pop() if len(found) == 1 else None


def _open(name: str, model: Model, template: str | None) -> tuple[Dataset, Guide, list[_Seed]]:
    data = _read_file(name)
    if data.get("Modality") != "RTPLAN" or "ApplicationSetupSequence" not in data:
        raise BadPlan(f"{name}: its modality is {data.get('Modality', 'not given')}, {'without seeds' if data.get('Modality') == 'RTPLAN' else 'not RTPLAN'}: "
                      "export the plan of a brachytherapy")
    if not Frame(model).is_patient:
        raise BadPlan(f"{name}: the scene has no patient_to_mesh, which DICOM's coordinates need: trocar-anatomy writes it")
    if data.get("BrachyTreatmentTechnique") != "PERMANENT":
        raise BadPlan(f"{name}: its technique is {data.get('BrachyTreatmentTechnique', 'not given')}, not PERMANENT: it has no seeds that remain in the patient")
    setups = list(data.ApplicationSetupSequence)
    if not setups:
        raise BadPlan(f"{name}: no application setup")
    guide = _guide_named(name, setups[0], model, template)
    seeds = [seed for setup in setups for seed in _seeds_of(name, setup)]
    if not seeds:
        raise BadPlan(f"{name}: no seeds")
    return data, guide, seeds


@contextlib.contextmanager
def _damage(name: str) -> Iterator[None]:
    """Turns the various exceptions that pydicom raises when it comes across damage in a file, even as late as on access to a sequence, into BadPlan."""
    try:
        yield
    except (AttributeError, EOFError, KeyError, OSError, TypeError, ValueError, struct.error) as error:
        raise BadPlan(f"{name}: damaged: {error}") from error


def read(path: str | PathLike[str], model: Model, template: str | None = None) -> Plan:
    """Reads an RT Plan with permanent seeds as a plan for the template in this scene. template: name of the guide, if it isn't the one in the file. Needles
    come in the order of the file's channels. Seeds up to half a millimetre off a hole's axis are moved onto it, with a note in `Plan.remarks`. Raises
    BadPlan if the file is not such a plan, or was made for a different template."""
    name = fspath(path)
    with _damage(name):
        data, guide, seeds = _open(name, model, template)
        needles, remarks = _needles_of(name, seeds, guide, model)
        return Plan(guide.name, guide.columns, guide.rows, guide.spacing, needles, _source_of(name, data), name, prescription=_prescription_of(data), remarks=remarks)


def read_seeds(path: str | PathLike[str], model: Model, template: str | None = None) -> list[Placed]:
    """Reads the seeds of an RT Plan as seeds left in the tissue. They keep their positions, however far these are from the template's axes, and their holes
    are those named in the file, if any. Raises BadPlan like `read`."""
    name, frame = fspath(path), Frame(model)
    with _damage(name):
        _, guide, seeds = _open(name, model, template)
        found = []
        for i, seed in enumerate(seeds):
            at, ahead = frame.to_mesh([seed.place, seed.place + seed.along])
            along = 1e3 * (ahead - at) if np.any(seed.along) else guide.normal
            hole = hole_number(seed.hole)
            known = hole is not None and hole[0] < guide.columns and hole[1] < guide.rows
            found.append(Placed(i + 1, guide.name if known else "", hole_name(*hole) if hole is not None and known else "", at, along))
        return found
