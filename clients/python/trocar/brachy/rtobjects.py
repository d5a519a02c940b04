"""Makes the RT Dose and the RT Structure Set of an implant, with pydicom. `trocar.brachy.rtplan` makes its RT Plan."""
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
LEVELS = 2**16 - 1       # number of steps, of a few hundredths of a Gy, in which doses are stored: 16 bits, because dicom3tools (dciodvfy) cannot read 32
BINS = 400               # of a histogram
COLOURS = {"gland": [213, 94, 0], "urethra": [0, 114, 178], "rectum": [138, 90, 0]}    # as in the report
SEEDS = [0, 127, 95]


def _uids(*content: object) -> Callable[[str], str]:
    """Returns a function that makes reproducible UIDs: equal content always gives equal UIDs."""
    text = repr(content)
    return lambda what: generate_uid(entropy_srcs=["trocar", what, text])


def _now(date: datetime.date | None) -> tuple[str, str]:
    return (date or datetime.date.today()).strftime("%Y%m%d"), "000000"


def _contour(kind: str, points: Array) -> Dataset:
    return _item(ContourGeometricType=kind, NumberOfContourPoints=len(points), ContourData=[f"{value + 0.0:.3f}" for value in points.ravel()])


def structure_set(given: Dataset, organs: Mapping[str, Organ], seeds: Mapping[str, Array], date: datetime.date | None = None) -> FileDataset:
    """Returns an RT Structure Set with the organs as contours and the seeds as points. seeds: centres (n, 3) mm in patient coordinates, by the name of their
    region of interest. given: the structure set from which the organs were read; the new one gets the same patient, study and frame of reference. date: today
    by default."""
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
    """Describes the histogram of region `number`, as pairs of a bin's width (Gy) and the volume (cm^3) that receives at least the dose at its lower edge."""
    edges = np.linspace(0.0, dvh.dose(0.0) * (1.0 + 1e-9), BINS, endpoint=False)
    volumes = [1e6 * dvh.voxel * len(dvh.doses) * dvh.volume(float(edge)) for edge in edges]
    width = float(edges[1])
    return _item(DVHReferencedROISequence=Items([_item(ReferencedROINumber=number, DVHROIContributionType="INCLUDED")]), DVHType="CUMULATIVE", DoseUnits="GY",
                 DoseType="PHYSICAL", DVHDoseScaling="1", DVHVolumeUnits="CM3", DVHNumberOfBins=BINS,
                 DVHData=[text for volume in volumes for text in (f"{width:.8g}", f"{volume:.8g}")], DVHMinimumDose=f"{dvh.doses[-1]:.8g}",
                 DVHMaximumDose=f"{dvh.doses[0]:.8g}", DVHMeanDose=f"{dvh.doses.mean():.8g}")


def dose(values: Array, origin: Sequence[float], spacing: float, plan: Dataset, structures: Dataset, histograms: Mapping[str, DVH], what: str,
         date: datetime.date | None = None) -> FileDataset:
    """Returns an RT Dose: doses (nx, ny, nz) Gy on a grid along the patient's axes, with the centre of the first voxel at `origin` (3,) mm and `spacing` mm
    between voxels. plan: the RT Plan with the seeds; structures: the RT Structure Set with the organs; histograms: by the names of its regions of interest;
    what: a few words for the description, such as "planned"; date: today by default."""
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
    scale = f"{max(float(frames.max()), 1e-6) / LEVELS:.9e}"    # rounded to fit a DICOM decimal string (16 characters), so that readers use the same number
    data.DoseUnits, data.DoseType, data.DoseSummationType, data.DoseComment = "GY", "PHYSICAL", "PLAN", f"{NOT_FOR_TREATMENT}: {what}"[:64]
    data.DoseGridScaling, data.TissueHeterogeneityCorrection = scale, "WATER"
    data.PixelData = np.minimum(np.rint(frames / float(scale)), LEVELS).astype("<u2").tobytes()
    data.ReferencedRTPlanSequence = Items([_item(ReferencedSOPClassUID=RT_PLAN, ReferencedSOPInstanceUID=plan.SOPInstanceUID)])
    data.ReferencedStructureSetSequence = Items([_item(ReferencedSOPClassUID=RT_STRUCTURES, ReferencedSOPInstanceUID=structures.SOPInstanceUID)])
    numbers = {str(item.ROIName): int(item.ROINumber) for item in structures.StructureSetROISequence}
    data.DVHSequence = Items(_histogram(numbers[name], dvh) for name, dvh in histograms.items())
    return data
