"""Reads contours, label maps, surfaces and volume meshes. Results are in DICOM patient coordinates (LPS), in mm."""
import collections
import csv
import os
import re
import struct

import numpy as np
import pydicom
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from . import dicom, quality, session
from .shapes import shells, voxels
from .shapes.contours import Rings, Unusable
from .trouble import BadFile

OUTLINES, IMAGES, SURFACES = (".dcm", ".csv"), (".nii", ".nii.gz", ".nrrd", ".nhdr"), (".stl", ".ply", ".obj", ".vtp")
MESHES = (".vtk", ".vtu", ".msh")                           # a .vtk file may also contain a surface
UNITS = {"mm": 1.0, "cm": 10.0, "m": 1e3}                   # mm
CELL_LABELS = ("label", "labels", "region", "regions", "regionid", "material", "materialids", "medit:ref", "gmsh:physical", "cellentityids", "segment")
MOST_LABELS = 500                                           # an array with more distinct values than this does not contain labels
COLUMNS = ["roi", "outline", "x_mm", "y_mm", "z_mm"]
CLOSED, EXCLUSIVE, OPEN = "CLOSED_PLANAR", "CLOSEDPLANAR_XOR", "OPEN_PLANAR"


DICOM_MARK = 128, b"DICM"       # offset and content of the DICOM file marker
PLY_SIZES = {"char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "int": 4, "uint": 4, "int32": 4, "uint32": 4,
             "float": 4, "float32": 4, "double": 8, "float64": 8}


def kind_of(path):
    """Returns the file's extension if it is supported, or .dcm for a DICOM file of any name."""
    every = OUTLINES + IMAGES + SURFACES + MESHES
    for extension in every:
        if path.lower().endswith(extension):
            return extension
    if is_dicom(path):
        return ".dcm"
    raise BadFile(f"{path}: unknown file type; expected {', '.join(every)}")


def is_dicom(path):
    try:
        with open(path, "rb") as file:
            file.seek(DICOM_MARK[0])
            return file.read(len(DICOM_MARK[1])) == DICOM_MARK[1]
    except OSError:
        return False


def files_in(folder):
    """Returns the files in a folder to read regions from: its DICOM structure sets and segmentations, else its label maps, else its surfaces."""
    paths = sorted(os.path.join(folder, name) for name in os.listdir(folder) if os.path.isfile(os.path.join(folder, name)))
    dicom = [path for path in paths if is_dicom(path)]
    found = [path for path in dicom if modality_of(path) in ("RTSTRUCT", "SEG")]
    for extensions in (IMAGES, SURFACES):
        found = found or [path for path in paths if path.lower().endswith(extensions)]
    if not found:
        other = sorted({modality_of(path) for path in dicom})
        raise BadFile(f"{folder}: has no structure set, segmentation, label map or surface"
                      + (f"; its {len(dicom)} DICOM files are {', '.join(other)}: export the structure set or the segmentation" if dicom else ""))
    return found


def modality_of(path):
    try:
        return str(pydicom.dcmread(path, specific_tags=["Modality"], stop_before_pixels=True).get("Modality", "without a modality"))
    except (pydicom.errors.InvalidDicomError, OSError, EOFError, ValueError):
        return "damaged"


def stem_of(path):
    """Returns the name of the file without folder or extension."""
    name, extension = os.path.basename(path), kind_of(path)
    return re.sub(r"\.seg$", "", name[:-len(extension)] if name.lower().endswith(extension) else name)


def read_image(path, unit=None, names=None, frame=None):
    """Reads a label map. unit: its unit of length, or None to go by the file; names: label number -> name; frame: LPS, RAS or None."""
    if not os.path.exists(path):
        raise BadFile(f"{path}: no such file")
    scale = UNITS[unit] if unit else None
    if kind_of(path) in (".nrrd", ".nhdr"):
        return voxels.named_after_file(path, voxels.read_nrrd(path, scale, names or {}, frame))
    if frame == "LPS":
        raise BadFile(f"{path}: NIfTI is always RAS: leave --frame out")
    return voxels.named_after_file(path, voxels.read_nifti(path, scale, names or {}))


def read_outlines(path):
    """Reads contours. Returns ROI name -> list of rings (n, 3), or a label map if the file is a DICOM segmentation."""
    rois = read_dicom(path) if kind_of(path) == ".dcm" else read_csv(path)
    if isinstance(rois, voxels.LabelMap):
        return rois
    if not any(rois.values()):
        raise BadFile(f"{path}: contains no outlines")
    return rois


def read_dicom(path):
    try:
        data = dicom.read(path)
    except EOFError as error:
        raise BadFile(str(error)) from error
    except OSError as error:
        raise BadFile(f"{path}: cannot be opened: {error.strerror}") from error
    except (pydicom.errors.InvalidDicomError, ValueError) as error:
        raise BadFile(f"{path}: not a DICOM file: {error}") from error
    if data.get("Modality") == "SEG":
        return voxels.read_seg(path, data)
    if data.get("Modality") != "RTSTRUCT":
        raise BadFile(f"{path}: its modality is {data.get('Modality', 'not given')}, not RTSTRUCT or SEG: export the structure set")
    try:  # pydicom parses sequences only when they are accessed
        return rois_of(data)
    except (AttributeError, EOFError, KeyError, OSError, TypeError, ValueError, struct.error) as error:
        raise BadFile(f"{path}: damaged or truncated: {error}") from error


def rois_of(data):
    """Returns ROI name -> list of rings, from an RT Structure Set."""
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
    """Returns ROI number -> name. The number stands in for a missing name, and is appended to a name that is not unique."""
    given = {roi.ROINumber: str(roi.get("ROIName") or "").strip() for roi in sequence}
    often = collections.Counter(given.values())
    return {number: name if name and often[name] == 1 else f"{name} (ROI {number})".strip() for number, name in given.items()}


def points_of(contour, roi):
    values = np.array([float(v) for v in contour.get("ContourData", None) or []])
    if len(values) % 3:
        raise ValueError(f"ROI \"{roi}\": an outline has {len(values)} coordinates, not three per point")
    return values.reshape(-1, 3)


def read_csv(path):
    """Reads contours from a CSV file with the header COLUMNS and one point per row. Rows with the same `roi` and `outline` form one contour."""
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


def frame_of(path, given):
    """Returns a surface's frame, LPS or RAS: from the option if given, else from the header as written by 3D Slicer, else DICOM's LPS."""
    with open(path, "rb") as file:
        said = re.search(rb"SPACE=(LPS|RAS)", file.read(4096))
    return given or (said[1].decode() if said else "LPS")


def check_length(path):
    """Rejects an STL or PLY file that is shorter than its header says. VTK would silently read what is there."""
    with open(path, "rb") as file:
        content = file.read()
    said, found = length_of_stl(content) if kind_of(path) == ".stl" else length_of_ply(content)
    if found < said:
        raise BadFile(f"{path}: cut off: it has {found} of {said} bytes" if said > 1 else f"{path}: cut off: it does not end with endsolid")


def length_of_stl(content):
    """For a binary file, returns its size in bytes according to its header, and its actual size. For a text file, returns 1 and whether it is complete."""
    if content[:5] == b"solid" and b"facet" in content[:1000]:
        return 1, int(b"endsolid" in content[-200:] or b"facet" not in content)
    return (84 + 50 * int.from_bytes(content[80:84], "little"), len(content)) if len(content) >= 84 else (84, len(content))


def length_of_ply(content):
    """Returns the minimum size of a PLY file according to its header, and its actual size, both in bytes."""
    header, end, data = content.partition(b"end_header")
    if not end:
        return len(content) + 1, len(content)
    least, count, text = 0, 0, b"format ascii" in header
    for words in (line.split() for line in header.decode("ascii", "replace").splitlines()):
        if words[:1] == ["element"] and len(words) == 3:
            count = int(words[2])
            least += 2 * count if text else 0
        elif words[:2] == ["property", "list"] and len(words) == 5:
            least += 0 if text else count * (PLY_SIZES.get(words[2], 1) + 3 * PLY_SIZES.get(words[3], 1))
        elif words[:1] == ["property"] and len(words) == 3:
            least += 0 if text else count * PLY_SIZES.get(words[1], 1)
    return len(header) + len(end) + least, len(content)


def data_of(path):
    """Returns a surface or volume mesh as a VTK data set."""
    if not os.path.exists(path):
        raise BadFile(f"{path}: no such file")
    readers = {".stl": vtk.vtkSTLReader, ".ply": vtk.vtkPLYReader, ".obj": vtk.vtkOBJReader, ".vtp": vtk.vtkXMLPolyDataReader,
               ".vtk": vtk.vtkDataSetReader, ".vtu": vtk.vtkXMLUnstructuredGridReader}
    reader = readers[kind_of(path)]()
    reader.SetFileName(path)
    reader.GlobalWarningDisplayOff()
    reader.Update()
    return reader.GetOutput()


def is_surface(path):
    if kind_of(path) != ".vtk":
        return kind_of(path) in SURFACES
    return isinstance(data_of(path), vtk.vtkPolyData)


def read_mesh(path, unit=None, frame=None, array=None, names=None):
    """Reads a volume mesh. Returns region name -> (surface of its tetrahedra in mm, remarks). array: name of the cell array that holds the labels. Meshes made
    by this program contain a transform from patient coordinates, which is ignored if `unit` or `frame` is given."""
    if not os.path.exists(path):
        raise BadFile(f"{path}: no such file")
    mesh = gmsh_mesh(path) if kind_of(path) == ".msh" else vtk_mesh(path, array, names or {})
    to_mesh = transform_in(path) if kind_of(path) == ".msh" and not unit and not frame else None
    if to_mesh is None:
        sign = [1, 1, 1] if frame_of(path, frame) == "LPS" else [-1, -1, 1]
        mesh.points = mesh.points * sign * UNITS[unit or "mm"]
    else:
        mesh.points = (mesh.points - to_mesh[:3, 3]) @ np.linalg.inv(to_mesh[:3, :3]).T
    found = {}
    for name in mesh.regions:
        shell = mesh.boundary(name)
        used, numbers = np.unique(shell.triangles, return_inverse=True)
        outward = shells.oriented(shells.Shell(mesh.points[used], numbers.reshape(-1, 3)))
        found[name] = outward, []
    return found


def says_where(path):
    """Whether a mesh contains a transform from patient coordinates, as meshes made by this program do."""
    return kind_of(path) == ".msh" and transform_in(path) is not None


def transform_in(path):
    """Returns the transform (4, 4) from the comments at the end of a mesh (see pipeline.write_transform), or None."""
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - 4096))
        said = re.search(rb"\npatient_to_mesh\s+([-+.\deE\s]+)\$EndComments", file.read())
    values = [float(value) for value in said[1].split()] if said else []
    matrix = np.array(values).reshape(4, 4) if len(values) == 16 else None
    return matrix if matrix is not None and abs(np.linalg.det(matrix)) > 0 else None


def gmsh_mesh(path):
    session.start()
    try:
        return session.read(path)
    except MemoryError:
        raise
    except Exception as error:  # Gmsh raises no more specific class
        raise BadFile(f"{path}: Gmsh cannot read it as tetrahedra in named groups: {error}") from error


def vtk_mesh(path, array, names):
    grid = data_of(path)
    if not isinstance(grid, vtk.vtkUnstructuredGrid) or grid.GetNumberOfCells() == 0:
        raise BadFile(f"{path}: contains no cells of a volume mesh")
    check_points(path, grid)
    split = shells.pipe(grid, shells.configured(vtk.vtkDataSetTriangleFilter(), TetrahedraOnly=True))
    if split.GetNumberOfCells() == 0:
        raise BadFile(f"{path}: contains no tetrahedra or other volumes")
    values = cell_labels(path, split.GetCellData(), array)
    numbers, region = np.unique(values, return_inverse=True)
    tets = vtk_to_numpy(split.GetCells().GetConnectivityArray()).reshape(-1, 4)
    points, same = np.unique(vtk_to_numpy(split.GetPoints().GetData()).astype(float), axis=0, return_inverse=True)     # merge points that cells share
    return quality.Mesh(points, same.reshape(-1)[tets], region.reshape(-1), [names.get(int(n), str(int(n))) for n in numbers])


def cell_labels(path, data, array):
    """Finds the cell array that holds the labels: the one named `array` if given, else one with a usual name, else the only one that contains integers."""
    arrays = {data.GetArrayName(n): vtk_to_numpy(data.GetArray(n)) for n in range(data.GetNumberOfArrays())}
    whole = [name for name, values in arrays.items()
             if values.ndim == 1 and np.all(np.isfinite(values)) and np.all(values == np.rint(values)) and len(np.unique(values)) <= MOST_LABELS]
    if array and array not in whole:
        raise BadFile(f"{path}: its cells have no labels \"{array}\"; they have: {', '.join(whole) or 'none'}")
    usual = [name for name in whole if name.lower() in CELL_LABELS]
    chosen = [array] if array else usual if len(usual) == 1 else whole
    if len(chosen) != 1:
        raise BadFile(f"{path}: its cells have {', '.join(whole) or 'no array of labels'}" + (": choose the labels with --labels" if whole else ""))
    return arrays[chosen[0]]


def check_points(path, data):
    if data.GetNumberOfPoints() and not np.all(np.isfinite(vtk_to_numpy(data.GetPoints().GetData()))):
        raise BadFile(f"{path}: some of its points have coordinates that are not finite numbers")


def read_surface(path, scale, frame=None):
    """Reads and repairs a closed surface. Returns it in mm, with remarks on the repairs. scale: mm per unit of the file; frame: LPS, RAS or None."""
    if kind_of(path) in (".stl", ".ply"):
        check_length(path)
    surface = data_of(path)
    check_points(path, surface)
    if surface.GetNumberOfPolys() + surface.GetNumberOfStrips() < 4:
        raise BadFile(f"{path}: contains {surface.GetNumberOfPolys()} triangles: is it a surface of triangles?")
    scaled, sign = vtk.vtkTransform(), 1 if frame_of(path, frame) == "LPS" else -1
    scaled.Scale(sign * scale, sign * scale, scale)
    move = vtk.vtkTransformPolyDataFilter()
    move.SetTransform(scaled)
    surface, notes = shells.mended(shells.pipe(surface, move))
    if shells.open_edges(surface):
        raise Unusable(stem_of(path),
                       f"the surface of {path} has holes that are too large to be filled ({shells.open_edges(surface)} open edges)")
    return shells.from_vtk(surface), notes
