"""Writes label maps in every supported file format, for tests and for the tables in docs/results/anatomy."""
import numpy as np
import pydicom
import shapely.geometry
import shapely.vectorized
import vtk
from pydicom.dataset import Dataset, FileDataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, SegmentationStorage
from vtk.util.numpy_support import numpy_to_vtk

from ..shapes import shells
from . import patient, shipped

NAMES = {1: "Prostate", 2: "Urethra", 3: "Rectum", 4: "Bladder", 5: "Pubic arch", 6: "Body"}
SNOMED = {1: ("41216001", "Prostate"), 2: ("13648007", "Urethra"), 3: ("34402009", "Rectum"), 4: ("89837001", "Bladder")}
SEGMENTATION_UID = shipped.UID + ".4"


def pelvis(spacing=(1.0, 1.0, 1.5), urethra=True):
    """Returns the synthetic patient's labels (see NAMES) as an array (k, j, i), and the transform (4, 4) from voxels to mm, LPS. The body has elliptical cross
    sections and is rounded at the perineum."""
    gland = patient.Gland()
    low, high = np.array([-95.0, -75.0, -62.0]), np.array([95.0, 75.0, 80.0])
    x, y, z = (np.arange(a, b, s) for a, b, s in zip(low, high, spacing))
    plane = np.stack(np.meshgrid(x, y), axis=-1)
    labels = np.zeros((len(z), len(y), len(x)), np.uint8)
    section, (_, b, c) = patient.Section(gland, gland.half), gland.half
    middle_x, middle_y = plane[..., 0], plane[..., 1]

    def within(centre_x, centre_y, radius):
        return (middle_x - centre_x) ** 2 + (middle_y - centre_y) ** 2 < radius ** 2
    for k, height in enumerate(z):
        below = np.clip((height + 58) / 22, 0, 1)      # rounded toward the perineum
        if below > 0:
            wide = np.sqrt(1 - (1 - below) ** 2)
            labels[k][(middle_x / (85 * wide)) ** 2 + (middle_y / (68 * wide)) ** 2 < 1] = 6
        inside = labels[k] > 0
        top = height - (c + 14)
        if abs(top) < 17:
            labels[k][within(0, -6 + gland.tilt * c, 1.6 * np.sqrt(18 ** 2 - top ** 2)) & inside] = 4
        labels[k][within(0, b * (1 - gland.dent) + 12.0 + max(gland.tilt, 0) * c + 0.004 * height ** 2, 11.0) & inside & (height > -50)] = 3
        ring = section.outline(height)
        if len(ring):
            labels[k][shapely.vectorized.contains(shapely.geometry.Polygon(ring), middle_x, middle_y)] = 1
        if urethra and abs(height) < c + 8:
            labels[k][within(gland.lean * height, gland.tilt * height - 0.1 * b + 0.004 * height ** 2, 3.0) & inside] = 2
        labels[k][(patient.arch_depth(gland, middle_x, middle_y, np.full(middle_x.shape, height)) < 0) & inside] = 5
    place = np.diag([*map(float, spacing), 1.0])
    place[:3, 3] = x[0], y[0], z[0]
    return labels, place


def turned(place, degrees):
    """Rotates an image's transform about the axis from feet to head, as in a tilted scan."""
    turn = np.eye(4)
    a = np.radians(degrees)
    turn[:3, :3] = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    return turn @ place


def label_table(names):
    """Returns the XML that TotalSegmentator puts into a header extension: a label table like Connectome Workbench's, but with the names as CDATA."""
    rows = "".join(f'<Label Key="{value}" Red="{value % 3 / 2}" Green="{value % 5 / 4}" Blue="0.0" Alpha="1"><![CDATA[{name}]]></Label>\n'
                   for value, name in names.items())
    return ('<?xml version="1.0" encoding="UTF-8"?> <CaretExtension>  <Date><![CDATA[2013-07-14T05:45:09]]></Date>   <VolumeInformation Index="0">   '
            f'<LabelTable>\n{rows}\n  </LabelTable>  <StudyMetaDataLinkSet>  </StudyMetaDataLinkSet>  <VolumeType><![CDATA[Label]]></VolumeType>   '
            '</VolumeInformation></CaretExtension>\n              ')


def write_nifti(path, labels, place, kind=np.uint8, names=None):
    """Writes a NIfTI file. `names`: label -> name, written into the header as TotalSegmentator does."""
    import nibabel      # imported here so that the other writers work without it
    image = nibabel.Nifti1Image(labels.T.astype(kind), np.diag([-1.0, -1.0, 1.0, 1.0]) @ place)
    image.header.set_xyzt_units("mm")
    if names:
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension(0, label_table(names).encode()))
    nibabel.save(image, path)


def write_seg(path, labels, place, names):
    """Writes a binary DICOM segmentation with one segment per label. As is usual, planes in which a segment has no voxels are left out."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = SegmentationStorage, SEGMENTATION_UID
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data = FileDataset(path, {}, file_meta=meta, preamble=b"\0" * 128)
    data.is_little_endian, data.is_implicit_VR = True, False
    data.SOPClassUID, data.SOPInstanceUID, data.Modality = SegmentationStorage, SEGMENTATION_UID, "SEG"
    data.PatientName, data.PatientID = "Synthetic^Prostate", "SYNTHETIC"
    data.Rows, data.Columns = labels.shape[1:]
    data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelRepresentation = 1, "MONOCHROME2", 0
    data.BitsAllocated = data.BitsStored = 1
    data.HighBit, data.SegmentationType = 0, "BINARY"
    spacing = np.linalg.norm(place[:3, :3], axis=0)
    measures, directions, shared = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing, measures.SliceThickness = [f"{spacing[1]:.9g}", f"{spacing[0]:.9g}"], f"{spacing[2]:.9g}"
    directions.ImageOrientationPatient = [f"{v:.9g}" for v in np.concatenate([place[:3, 0] / spacing[0], place[:3, 1] / spacing[1]])]
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = Sequence([measures]), Sequence([directions])
    data.SharedFunctionalGroupsSequence = Sequence([shared])
    described, frames, bits = [], [], []
    for value, name in names.items():
        item = Dataset()
        item.SegmentNumber, item.SegmentLabel, item.SegmentAlgorithmType = value, name, "AUTOMATIC"
        if value in SNOMED:
            code = Dataset()
            code.CodeValue, code.CodingSchemeDesignator, code.CodeMeaning = SNOMED[value][0], "SCT", SNOMED[value][1]
            item.SegmentedPropertyTypeCodeSequence = Sequence([code])
        described.append(item)
        for k in np.flatnonzero((labels == value).any(axis=(1, 2))):
            frame, position, which = Dataset(), Dataset(), Dataset()
            position.ImagePositionPatient = [f"{v:.9g}" for v in place[:3] @ [0, 0, k, 1]]
            which.ReferencedSegmentNumber = value
            frame.PlanePositionSequence, frame.SegmentIdentificationSequence = Sequence([position]), Sequence([which])
            frames.append(frame)
            bits.append(labels[k] == value)
    data.SegmentSequence, data.PerFrameFunctionalGroupsSequence = Sequence(described), Sequence(frames)
    data.NumberOfFrames = len(frames)
    packed = np.packbits(np.stack(bits).ravel(), bitorder="little").tobytes()
    data.PixelData = packed + b"\0" * (len(packed) % 2)
    pydicom.dcmwrite(path, data, write_like_original=False)


def write_surface(path, shell, frame="LPS"):
    """Writes a surface in the format given by the extension: .stl, .ply, .obj, .vtp or .vtk. Points are written in LPS or, as in old versions of 3D Slicer,
    in RAS."""
    if frame == "RAS":
        shell = shells.Shell(shell.points * [-1, -1, 1], shell.triangles)
    writer = {".stl": vtk.vtkSTLWriter, ".ply": vtk.vtkPLYWriter, ".obj": vtk.vtkOBJWriter, ".vtp": vtk.vtkXMLPolyDataWriter,
              ".vtk": vtk.vtkPolyDataWriter}[path[-4:]]()
    writer.SetFileName(path)
    writer.SetInputData(shells.to_vtk(shell))
    if path.endswith(".vtk"):
        writer.SetHeader(f"3D Slicer output. SPACE={frame}")
    writer.Write()


def write_cells(path, mesh, array="Label"):
    """Writes a quality.Mesh as .vtu or .vtk, with regions numbered from 1."""
    grid, points, cells = vtk.vtkUnstructuredGrid(), vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(mesh.points), deep=True))
    for tet in mesh.tets.tolist():
        cells.InsertNextCell(4, tet)
    grid.SetPoints(points)
    grid.SetCells(vtk.VTK_TETRA, cells)
    values = numpy_to_vtk(mesh.region.astype(np.int32) + 1, deep=True)
    values.SetName(array)
    grid.GetCellData().AddArray(values)
    writer = vtk.vtkXMLUnstructuredGridWriter() if path.endswith(".vtu") else vtk.vtkUnstructuredGridWriter()
    writer.SetFileName(path)
    writer.SetInputData(grid)
    writer.Write()
