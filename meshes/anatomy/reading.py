"""Reads outlines and surfaces: DICOM RT Structure Sets, CSV, STL, PLY. Results are in DICOM's patient coordinates, mm."""
import collections
import csv
import os
import struct

import numpy as np
import pydicom
import vtk

from . import shells
from .contours import Rings, Unusable

OUTLINES, SURFACES = (".dcm", ".csv"), (".stl", ".ply")
COLUMNS = ["roi", "outline", "x_mm", "y_mm", "z_mm"]
CLOSED, EXCLUSIVE, OPEN = "CLOSED_PLANAR", "CLOSEDPLANAR_XOR", "OPEN_PLANAR"


class BadFile(Exception):
    """The text names the file and, if possible, the place in it."""


def kind_of(path):
    extension = os.path.splitext(path)[1].lower()
    if extension in OUTLINES + SURFACES:
        return extension
    raise BadFile(f"{path}: unknown file type; expected {', '.join(OUTLINES + SURFACES)}")


def read_outlines(path):
    """ROI name -> list of rings (n, 3)."""
    rois = read_rtstruct(path) if kind_of(path) == ".dcm" else read_csv(path)
    if not any(rois.values()):
        raise BadFile(f"{path}: contains no outlines")
    return rois


def read_rtstruct(path):
    try:
        data = pydicom.dcmread(path, specific_tags=["Modality", "StructureSetROISequence", "ROIContourSequence"])
    except (pydicom.errors.InvalidDicomError, OSError, EOFError, ValueError) as error:
        raise BadFile(f"{path}: not a DICOM file: {error}") from error
    if data.get("Modality") != "RTSTRUCT":
        raise BadFile(f"{path}: its modality is {data.get('Modality', 'not given')}, not RTSTRUCT: export the structure set")
    try:  # pydicom reads sequences on access
        return rois_of(data)
    except (AttributeError, EOFError, KeyError, OSError, TypeError, ValueError, struct.error) as error:
        raise BadFile(f"{path}: damaged or truncated: {error}") from error


def rois_of(data):
    """ROI name -> list of rings, of an RT Structure Set."""
    names = roi_names(data.get("StructureSetROISequence", []))
    rois = {name: Rings() for name in names.values()}
    for item in data.get("ROIContourSequence", []):
        if item.ReferencedROINumber not in names:
            raise ValueError(f"outlines of ROI number {item.ReferencedROINumber}, which has no name")
        name = names[item.ReferencedROINumber]
        for contour in item.get("ContourSequence", []):
            kind = contour.get("ContourGeometricType", "CLOSED_PLANAR")
            if kind == EXCLUSIVE:
                rois[name].exclusive = True
            points = points_of(contour, name)
            if kind == OPEN:
                rois[name].left_open.append(points)
            elif kind in (CLOSED, EXCLUSIVE):
                rois[name].append(points)
    return rois


def roi_names(sequence):
    """ROI number -> name; includes the number if the name is missing or not unique."""
    given = {roi.ROINumber: str(roi.get("ROIName") or "").strip() for roi in sequence}
    often = collections.Counter(given.values())
    return {number: name if name and often[name] == 1 else f"{name} (ROI {number})".strip() for number, name in given.items()}


def points_of(contour, roi):
    values = np.array([float(v) for v in contour.get("ContourData", None) or []])
    if len(values) % 3:
        raise ValueError(f"ROI \"{roi}\": an outline has {len(values)} coordinates, not three per point")
    return values.reshape(-1, 3)


def read_csv(path):
    """One point per row under the header COLUMNS; a new number in `outline` starts a new outline."""
    rois = {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file)
            header = [name.strip().lower() for name in next(rows, [])]
            if header != COLUMNS:
                raise BadFile(f"{path}:1: the header must be {','.join(COLUMNS)}")
            for row in rows:
                if row:
                    add_point(rois, row, f"{path}:{rows.line_num}")
    except (UnicodeDecodeError, csv.Error) as error:
        raise BadFile(f"{path}: {error}") from error
    return {roi: [np.array(points) for points in outlines.values()] for roi, outlines in rois.items()}


def add_point(rois, row, place):
    if len(row) != len(COLUMNS):
        raise BadFile(f"{place}: {len(row)} columns, not {len(COLUMNS)}")
    try:
        point = [float(value) for value in row[2:]]
    except ValueError as error:
        raise BadFile(f"{place}: {error}") from error
    rois.setdefault(row[0].strip(), {}).setdefault(row[1].strip(), []).append(point)


def read_surface(path, scale):
    """A closed, repaired surface in mm, and remarks on the repairs; `scale`: mm per unit of the file."""
    if not os.path.exists(path):
        raise BadFile(f"{path}: no such file")
    reader = vtk.vtkSTLReader() if kind_of(path) == ".stl" else vtk.vtkPLYReader()
    reader.SetFileName(path)
    reader.GlobalWarningDisplayOff()
    reader.Update()
    surface = reader.GetOutput()
    if surface.GetNumberOfPolys() < 4:
        raise BadFile(f"{path}: contains {surface.GetNumberOfPolys()} triangles: is it a surface of triangles?")
    scaled = vtk.vtkTransform()
    scaled.Scale(scale, scale, scale)
    move = vtk.vtkTransformPolyDataFilter()
    move.SetTransform(scaled)
    surface, notes = shells.mended(shells.pipe(surface, move))
    if shells.open_edges(surface):
        raise Unusable(os.path.splitext(os.path.basename(path))[0],
                       f"the surface of {path} has holes that are too large to be filled ({shells.open_edges(surface)} open edges)")
    return shells.from_vtk(surface), notes
