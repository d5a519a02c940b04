"""Builds the RT Dose and RT Structure Set of an implant with pydicom. For the RT Plan, see `trocar.brachy.rtplan`."""
from __future__ import annotations

import datetime
from typing import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ._dose import DVH
from .organs import Organ
from .rtplan import NOT_FOR_TREATMENT, RT_PLAN, RT_STRUCTURES, Dataset, FileDataset, _frame_of_reference, _item, generate_uid, new_object
from .rtplan import Sequence as Items

Array = npt.NDArray[np.float64]

__all__ = ["dose", "structure_set"]

RT_DOSE = "1.2.840.10008.5.1.4.1.1.481.2"
LEVELS = 2**16 - 1       # doses are stored in 16 bits, in steps of a few hundredths of a Gy, because dciodvfy (dicom3tools) cannot read 32 bits
BINS = 400               # number of histogram bins
COLOURS = {"gland": [213, 94, 0], "urethra": [0, 114, 178], "rectum": [138, 90, 0]}    # as in the report
SEEDS = [0, 127, 95]


def _uids(*content: object) -> Callable[[str], str]:
    """Returns a function that generates UIDs reproducibly: the same content always gives the same UIDs."""
    text = repr(content)
    return lambda what: generate_uid(entropy_srcs=["trocar", what, text])


def _now(date: datetime.date | None) -> tuple[str, str]:
    return (date or datetime.date.today()).strftime("%Y%m%d"), "000000"


def _contour(kind: str, points: Array) -> Dataset:
    return _item(ContourGeometricType=kind, NumberOfContourPoints=len(points), ContourData=[f"{value + 0.0:.3f}" for value in points.ravel()])


def structure_set(given: Dataset, organs: Mapping[str, Organ], seeds: Mapping[str, Array], date: datetime.date | None = None) -> FileDataset:
    """Builds an RT Structure Set with the organs as contours and the seeds as points. seeds: seed centres (n, 3) mm in patient coordinates, for each region of
    interest by name. given: the structure set that the organs were read from; patient, study and frame of reference are copied from it. date: default
    today."""
    uid = _uids("structures", given.get("SOPInstanceUID"), [(o.role, o.name) for o in organs.values()], [(name, points.round(3).tolist()) for name, points in seeds.items()])
    data = new_object(RT_STRUCTURES, "RTSTRUCT", uid, given)
    frame = _frame_of_reference(given) or uid("frame")
    data.StructureSetLabel, data.StructureSetDescription = "implant", NOT_FOR_TREATMENT
    data.StructureSetDate, data.StructureSetTime = _now(date)
    data.FrameOfReferenceUID, data.PositionReferenceIndicator = frame, ""
    data.ReferencedFrameOfReferenceSequence = Items([_item(FrameOfReferenceUID=frame)])
    rois = [(o.name, "ORGAN", COLOURS[o.role], [_contour("CLOSED_PLANAR", outline) for outline in o.outlines]) for o in organs.values()]
    rois += [(name, "", SEEDS, [_contour("POINT", point) for point in points]) for name, points in seeds.items()]
    data.StructureSetROISequence = Items(_item(ROINumber=i, ReferencedFrameOfReferenceUID=frame, ROIName=name, ROIGenerationAlgorithm="") for i, (name, *_) in enumerate(rois, 1))
    data.ROIContourSequence = Items(_item(ROIDisplayColor=colour, ContourSequence=Items(contours), ReferencedROINumber=i) for i, (_, _, colour, contours) in enumerate(rois, 1))
    data.RTROIObservationsSequence = Items(_item(ObservationNumber=i, ReferencedROINumber=i, RTROIInterpretedType=kind, ROIInterpreter="") for i, (_, kind, *_) in enumerate(rois, 1))
    data.ApprovalStatus = "UNAPPROVED"
    return data


def _histogram(number: int, dvh: DVH) -> Dataset:
    """Builds the DVH item for region `number`: for each bin, its width (Gy) and the volume (cm^3) that receives at least the dose at its lower edge."""
    edges = np.linspace(0.0, dvh.dose(0.0) * (1.0 + 1e-9), BINS, endpoint=False)
    volumes = [1e6 * dvh.voxel * len(dvh.doses) * dvh.volume(float(edge)) for edge in edges]
    width = float(edges[1])
    return _item(DVHReferencedROISequence=Items([_item(ReferencedROINumber=number, DVHROIContributionType="INCLUDED")]), DVHType="CUMULATIVE", DoseUnits="GY",
                 DoseType="PHYSICAL", DVHDoseScaling="1", DVHVolumeUnits="CM3", DVHNumberOfBins=BINS,
                 DVHData=[text for volume in volumes for text in (f"{width:.8g}", f"{volume:.8g}")], DVHMinimumDose=f"{dvh.doses[-1]:.8g}",
                 DVHMaximumDose=f"{dvh.doses[0]:.8g}", DVHMeanDose=f"{dvh.doses.mean():.8g}")


def dose(values: Array, origin: Sequence[float], spacing: float, plan: Dataset, structures: Dataset, histograms: Mapping[str, DVH], what: str,
         date: datetime.date | None = None) -> FileDataset:
    """Builds an RT Dose from doses (nx, ny, nz) Gy on a grid along the patient's axes, with `spacing` mm between voxels and the centre of the first one at
    `origin` (3,) mm. plan: the RT Plan that contains the seeds; structures: the RT Structure Set that contains the organs; histograms: by name of the region
    of interest; what: a word for the description, such as "planned"; date: default today."""
    uid = _uids("dose", plan.SOPInstanceUID, structures.SOPInstanceUID, what, list(origin), spacing, values.shape, float(values.sum()))
    data = new_object(RT_DOSE, "RTDOSE", uid, structures)
    data.FrameOfReferenceUID, data.PositionReferenceIndicator = structures.FrameOfReferenceUID, ""
    data.SeriesDescription = f"{NOT_FOR_TREATMENT}: {what}"[:64]
    data.InstanceNumber, (data.ContentDate, data.ContentTime) = 1, _now(date)
    frames = np.ascontiguousarray(values.transpose(2, 1, 0))    # frames from feet to head, rows from front to back, columns from right to left
    data.ImagePositionPatient, data.ImageOrientationPatient = [f"{value:.4f}" for value in origin], ["1", "0", "0", "0", "1", "0"]
    data.PixelSpacing, data.SliceThickness = [f"{spacing:.6g}"] * 2, f"{spacing:.6g}"
    data.NumberOfFrames, data.Rows, data.Columns = frames.shape
    data.FrameIncrementPointer = 0x3004000C
    data.GridFrameOffsetVector = [f"{spacing * i:.6g}" for i in range(len(frames))]
    data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelRepresentation = 1, "MONOCHROME2", 0
    data.BitsAllocated, data.BitsStored, data.HighBit = 16, 16, 15
    scale = f"{max(float(frames.max()), 1e-6) / LEVELS:.9e}"    # rounded to fit a DICOM decimal string (16 characters), so that doses are encoded with the very number that readers will use
    data.DoseUnits, data.DoseType, data.DoseSummationType, data.DoseComment = "GY", "PHYSICAL", "PLAN", f"{NOT_FOR_TREATMENT}: {what}"[:64]
    data.DoseGridScaling, data.TissueHeterogeneityCorrection = scale, "WATER"
    data.PixelData = np.minimum(np.rint(frames / float(scale)), LEVELS).astype("<u2").tobytes()
    data.ReferencedRTPlanSequence = Items([_item(ReferencedSOPClassUID=RT_PLAN, ReferencedSOPInstanceUID=plan.SOPInstanceUID)])
    data.ReferencedStructureSetSequence = Items([_item(ReferencedSOPClassUID=RT_STRUCTURES, ReferencedSOPInstanceUID=structures.SOPInstanceUID)])
    numbers = {str(item.ROIName): int(item.ROINumber) for item in structures.StructureSetROISequence}
    data.DVHSequence = Items(_histogram(numbers[name], dvh) for name, dvh in histograms.items())
    return data
