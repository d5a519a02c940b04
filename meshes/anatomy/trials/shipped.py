"""Writes the outlines that the repository contains: a synthetic patient, as an RT Structure Set and as CSV.

usage: python3 -m anatomy.trials.shipped FOLDER
"""
import csv
import os
import sys

import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, RTStructureSetStorage

from .. import reading
from . import patient

# A fixed UID derived from a UUID: it is not a real patient's, and is the same in each run.
UID = "2.25.113059749145936325402354257176981405696"


def write_csv(path, rois):
    with open(path, "w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(reading.COLUMNS)
        for roi, rings in rois.items():
            for number, ring in enumerate(rings):
                rows.writerows([roi, number, *(f"{v:.2f}" for v in point)] for point in ring)


def contour(ring):
    item = Dataset()
    item.ContourGeometricType = "CLOSED_PLANAR"
    item.NumberOfContourPoints = len(ring)
    item.ContourData = [f"{v:.2f}" for v in ring.ravel()]
    return item


def write_rtstruct(path, rois):
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = RTStructureSetStorage
    meta.MediaStorageSOPInstanceUID = UID
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    meta.ImplementationClassUID = UID
    data = FileDataset(path, {}, file_meta=meta, preamble=b"\0" * 128)
    data.is_little_endian, data.is_implicit_VR = True, False
    data.SOPClassUID, data.SOPInstanceUID, data.Modality = RTStructureSetStorage, UID, "RTSTRUCT"
    data.StudyInstanceUID, data.SeriesInstanceUID = UID + ".1", UID + ".2"
    data.PatientName, data.PatientID, data.StructureSetLabel = "Synthetic^Prostate", "SYNTHETIC", "SYNTHETIC"
    data.StructureSetDescription = "Made from a few lengths, not measured on a person"
    data.StructureSetROISequence, data.ROIContourSequence = Sequence(), Sequence()
    for number, (roi, rings) in enumerate(rois.items(), 1):
        name, outlines = Dataset(), Dataset()
        name.ROINumber, name.ReferencedFrameOfReferenceUID, name.ROIName, name.ROIGenerationAlgorithm = number, UID + ".3", roi, "AUTOMATIC"
        outlines.ReferencedROINumber, outlines.ContourSequence = number, Sequence(contour(ring) for ring in rings)
        data.StructureSetROISequence.append(name)
        data.ROIContourSequence.append(outlines)
    pydicom.dcmwrite(path, data, write_like_original=False)


def main():
    rois = patient.outlines(patient.Gland())
    write_csv(os.path.join(sys.argv[1], "synthetic.csv"), rois)
    write_rtstruct(os.path.join(sys.argv[1], "synthetic.dcm"), rois)


if __name__ == "__main__":
    main()
