#!/usr/bin/env python3
"""Writes a synthetic patient as an RT Structure Set: a gland of 14 cm^3 with its urethra, and the rectum behind it. Nothing in it was measured on a person.

usage: structures.py FILE.dcm
"""
import sys

import numpy as np
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, RTStructureSetStorage, generate_uid

HALF_AXES = np.array([17.0, 13.0, 15.5])     # mm, semi-axes of the gland: to the left, back and head
SLICES = np.arange(-15.0, 15.1, 2.5)         # mm, heights; the gland's middle is at 0
uid = lambda what: generate_uid(entropy_srcs=["trocar example", what])


def ring(centre, radii, height):
    """Returns an ellipse (n, 3) mm on an axial slice."""
    angle = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    return np.column_stack([centre[0] + radii[0] * np.cos(angle), centre[1] + radii[1] * np.sin(angle), np.full(48, height)])


def item(**values):
    made = Dataset()
    for keyword, value in values.items():
        setattr(made, keyword, value)
    return made


rois = {"Prostate": [ring((0, 0), HALF_AXES[:2] * np.sqrt(1 - (z / HALF_AXES[2]) ** 2), z) for z in SLICES],
        "Urethra": [ring((0, -2), (2.5, 2.5), z) for z in SLICES],
        "Rectum": [ring((0, 28), (12, 12), z) for z in SLICES]}

meta = FileMetaDataset()
meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID, meta.TransferSyntaxUID = RTStructureSetStorage, uid("set"), ExplicitVRLittleEndian
data = FileDataset(sys.argv[1], {}, file_meta=meta, preamble=b"\0" * 128)
data.is_little_endian, data.is_implicit_VR = True, False
data.SOPClassUID, data.SOPInstanceUID, data.Modality = RTStructureSetStorage, uid("set"), "RTSTRUCT"
data.PatientName, data.PatientID, data.StructureSetLabel = "Synthetic^Implant", "SYNTHETIC", "synthetic"
data.StudyInstanceUID, data.SeriesInstanceUID = uid("study"), uid("series")
data.ReferencedFrameOfReferenceSequence = Sequence([item(FrameOfReferenceUID=uid("frame"))])
data.StructureSetROISequence = Sequence(item(ROINumber=i, ReferencedFrameOfReferenceUID=uid("frame"), ROIName=name, ROIGenerationAlgorithm="AUTOMATIC")
                                        for i, name in enumerate(rois, 1))
data.ROIContourSequence = Sequence(item(ReferencedROINumber=i, ContourSequence=Sequence(
    item(ContourGeometricType="CLOSED_PLANAR", NumberOfContourPoints=len(points), ContourData=[f"{v:.2f}" for v in points.ravel()]) for points in rings))
    for i, rings in enumerate(rois.values(), 1))
data.save_as(sys.argv[1], write_like_original=False)
