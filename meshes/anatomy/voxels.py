"""Label maps: NIfTI, NRRD and DICOM SEG. Their labels become closed surfaces in DICOM's patient coordinates, mm.

Between two slices shapes are interpolated by their signed distances (Raya and Udupa 1990). A surface between two labels is where their distances
are equal, so that labels which touch in the image share it.
"""
import bz2
import dataclasses
import gzip
import io
import json
import os
import re
import struct
import zlib

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

from . import shells
from .contours import Unusable
from .shells import Shell, configured, pipe
from .trouble import BadFile, needed

MOST_VOXELS = 6e6      # in which surfaces are sought: larger images are thinned out
MOST_SIZE = 2 ** 31    # voxels of a file
ELONGATED = 1.5        # ratio of a voxel's sides, above which slices are added between the others
AROUND = 3             # voxels around the labels
PASS_BAND = 0.1        # of the smoothing filter, of 2: removes waves shorter than about six voxels
SMOOTHED = 0.05        # change of a part's volume by smoothing, above which it stays as it was: it is a few voxels thin
MOST_CHECKED = 4000    # points on a label's surface, to which the mesh's distance is measured
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])   # from RAS, and back


@dataclasses.dataclass
class Segment:
    layer: int               # of the map
    value: int
    code: str = ""           # what the file says it is, for its material


@dataclasses.dataclass
class LabelMap:
    layers: list             # (k, j, i) arrays of whole numbers
    place: np.ndarray        # (4, 4) from voxel (i, j, k) to mm, LPS
    segments: dict           # name -> Segment
    notes: list = dataclasses.field(default_factory=list)

    def mask(self, name):
        segment = self.segments[name]
        return self.layers[segment.layer] == segment.value

    def voxel(self):
        """mm^3"""
        return abs(np.linalg.det(self.place[:3, :3]))


# ---- files -------------------------------------------------------------------------------------------------------------------

def numbered(values, names):
    """name -> Segment for each value other than 0 in the first layer."""
    found = np.unique(np.concatenate([np.unique(plane) for plane in values]))      # plane by plane: sorting needs memory
    segments = {}
    for value in map(int, found[found > 0]):
        segments[unique(names.get(value, str(value)), segments)] = Segment(0, value)
    return segments


def whole(path, values):
    """An array of labels (k, j, i), from one of any type (i, j, k)."""
    if values.ndim == 4 and values.shape[3] == 1:
        values = values[..., 0]
    if values.ndim != 3 or min(values.shape) < 2:
        raise BadFile(f"{path}: its size is {' x '.join(map(str, values.shape))}: a label map has three axes of at least two voxels")
    if values.dtype.kind == "f":
        if not np.all(np.isfinite(values)) or np.any(values != np.rint(values)):
            raise BadFile(f"{path}: its values are not whole numbers: is it an image or a map of probabilities instead of labels?")
    elif values.dtype.kind not in "iub":
        raise BadFile(f"{path}: its values are no numbers")
    if values.size and (values.min() < 0 or values.max() > 65535):
        raise BadFile(f"{path}: its values reach from {values.min()} to {values.max()}: labels are 0 to 65535")
    if not values.any():
        raise BadFile(f"{path}: has no label: all voxels are 0")
    return np.ascontiguousarray(values.T, np.uint8 if values.max() < 256 else np.uint16)


def check_place(path, place):
    sides = np.linalg.norm(place[:3, :3], axis=0)
    if not np.all(np.isfinite(place)) or np.any(sides <= 0) or abs(np.linalg.det(place[:3, :3])) < 1e-3 * np.prod(sides):
        raise BadFile(f"{path}: it does not say how large its voxels are, or where they lie")
    return place


def read_nifti(path, unit, names):
    """`unit`: mm per unit of the file, or None: what the file says. `names`: label number -> name."""
    nibabel = needed("nibabel", "python3-nibabel", path)
    try:
        image = nibabel.load(path)
        values = np.asanyarray(image.dataobj)
        given = image.header.get_xyzt_units()[0] if hasattr(image.header, "get_xyzt_units") else "mm"
    except MemoryError:
        raise
    except Exception as error:  # of several kinds, as of damaged compression
        raise BadFile(f"{path}: damaged, or not NIfTI: {error}") from error
    scale = unit or {"meter": 1e3, "micron": 1e-3}.get(given, 1.0)
    notes = []
    if "sform_code" in image.header and not image.header["sform_code"] and not image.header["qform_code"]:
        notes.append("the file does not say where the patient's left is: its axes are taken for right, front and head")
    for extension in getattr(image.header, "extensions", []):     # of Connectome Workbench and TotalSegmentator
        text = extension.get_content()
        text = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
        names = {**{int(key): name.strip() for key, name in re.findall(r'<Label\s[^>]*?Key="(\d+)"[^>]*>([^<]+)<', text)}, **names}
    labels = whole(path, values)
    place = check_place(path, LPS @ np.diag([scale] * 3 + [1.0]) @ np.asarray(image.affine, float))
    return LabelMap([labels], place, numbered(labels, names), notes)


NRRD_TYPES = {"signed char": "i1", "int8": "i1", "int8_t": "i1", "uchar": "u1", "unsigned char": "u1", "uint8": "u1", "uint8_t": "u1",
              "short": "i2", "short int": "i2", "signed short": "i2", "int16": "i2", "int16_t": "i2", "ushort": "u2", "unsigned short": "u2",
              "unsigned short int": "u2", "uint16": "u2", "uint16_t": "u2", "int": "i4", "signed int": "i4", "int32": "i4", "int32_t": "i4",
              "uint": "u4", "unsigned int": "u4", "uint32": "u4", "uint32_t": "u4", "float": "f4", "double": "f8"}
NRRD_SPACES = {"left-posterior-superior": 1, "lps": 1, "right-anterior-superior": -1, "ras": -1}


def nrrd_header(path, file):
    """Fields of a NRRD file's header; a detached one ends with its file."""
    if not file.readline(16).startswith(b"NRRD"):
        raise BadFile(f"{path}: not a NRRD file")
    fields = {}
    for line in iter(lambda: file.readline(1 << 20), b""):
        text = line.decode("utf-8", "replace").strip()
        if not text:
            return fields
        if text.startswith("#"):
            continue
        key, sign, value = text.partition(":=") if ":=" in text and ": " not in text.partition(":=")[0] else text.partition(":")
        if sign:
            fields[key.strip().lower() if sign == ":" else key.strip()] = value.strip()
    if "data file" in fields or "datafile" in fields:
        return fields
    raise BadFile(f"{path}: its header has no end")


def nrrd_data(path, fields, rest, size):
    """The values as bytes. `size`: their number of bytes."""
    encoding = fields.get("encoding", "").lower()
    if encoding in ("gzip", "gz"):
        return gzip.GzipFile(fileobj=io.BytesIO(rest)).read(size)       # of any number of streams
    if encoding in ("bzip2", "bz2"):
        return bz2.BZ2File(io.BytesIO(rest)).read(size)
    if encoding == "raw":
        return rest
    raise BadFile(f"{path}: its encoding is {encoding or 'not given'}: save it with gzip, bzip2 or raw")


def nrrd_beside(path, fields):
    """The bytes of a file that a header names in place of its own."""
    named = fields.get("data file", fields.get("datafile"))
    beside = os.path.join(os.path.dirname(path), named)
    several = not os.path.isfile(beside) and re.match(r"LIST\b|.*%", named)
    if several or any(float(fields.get(key, 0)) for key in ("line skip", "lineskip", "byte skip", "byteskip")):
        raise BadFile(f"{path}: its data are in several files, or after other data: save it as one file (.nrrd)")
    try:
        with open(beside, "rb") as file:
            return file.read()
    except OSError as error:
        raise BadFile(f"{path}: its data should be in {named}, beside it: {error.strerror}") from error


def read_nrrd(path, unit, names, frame):
    """`frame`: "LPS" or "RAS" where the file does not say it, or None."""
    with open(path, "rb") as file:
        fields, rest = nrrd_header(path, file), file.read()
    try:
        sizes = [int(v) for v in fields["sizes"].split()]
        kind = np.dtype(NRRD_TYPES[fields["type"].lower()]).newbyteorder(">" if fields.get("endian", "little").lower() == "big" else "<")
        vectors = re.findall(r"none|\(([^)]*)\)", fields.get("space directions", ""))
        vectors = [np.array([float(v) for v in text.split(",")]) for text in vectors if text]
        if not vectors and "spacings" in fields:
            vectors = list(np.diag([float(v) for v in fields["spacings"].split()][-3:]))
        origin = np.array([float(v) for v in fields.get("space origin", "(0,0,0)").strip("() ").split(",")])
        if "data file" in fields or "datafile" in fields:
            rest = nrrd_beside(path, fields)
    except (KeyError, ValueError, TypeError) as error:
        raise BadFile(f"{path}: its header is incomplete, or of an unknown kind: {error}") from error
    if len(vectors) != 3 or any(v.shape != (3,) for v in vectors) or origin.shape != (3,):
        raise BadFile(f"{path}: it does not say the directions of three axes (space directions)")
    if len(sizes) not in (3, 4) or min(sizes) < 1 or np.prod(sizes, dtype=float) > MOST_SIZE:
        raise BadFile(f"{path}: its size is {' x '.join(map(str, sizes))}: expected three axes, or four with layers")
    count = int(np.prod(sizes)) * kind.itemsize
    try:
        data = nrrd_data(path, fields, rest, count)
    except EOFError as error:
        raise BadFile(f"{path}: cut off: {error}") from error
    except (zlib.error, OSError) as error:      # OSError: neither gzip nor bzip2
        raise BadFile(f"{path}: damaged: {error}") from error
    if len(data) < count:
        raise BadFile(f"{path}: cut off: it has {len(data)} of {count} bytes")
    values = np.frombuffer(data, kind, count // kind.itemsize).reshape(sizes, order="F")
    layers = [values[n] for n in range(sizes[0])] if len(sizes) == 4 else [values]
    sign = NRRD_SPACES.get(fields.get("space", "").lower(), 0) or {"LPS": 1, "RAS": -1, None: 0}[frame]
    notes = [] if sign else ["the file does not say its space: taken for LPS (--frame)"]
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = np.column_stack(vectors), origin
    place = (LPS if sign < 0 else np.eye(4)) @ np.diag([unit or 1.0] * 3 + [1.0]) @ place
    filled = [layer for layer in layers if layer.any()]
    if not filled:
        raise BadFile(f"{path}: has no label: all voxels are 0")
    found = [whole(path, layer) if layer.any() else np.zeros(layer.T.shape, np.uint16) for layer in layers]
    return LabelMap(found, check_place(path, place), nrrd_segments(fields, found, names), notes)


def nrrd_segments(fields, layers, names):
    """name -> Segment, by what 3D Slicer writes into .seg.nrrd, else by number."""
    segments = {}
    for n in sorted({int(match[1]) for match in map(re.compile(r"Segment(\d+)_").match, fields) if match}):
        value, layer = int(fields.get(f"Segment{n}_LabelValue", 1)), int(fields.get(f"Segment{n}_Layer", 0))
        name = fields.get(f"Segment{n}_Name") or f"Segment {n}"
        code = re.search(r"TerminologyEntry:[^~]*~[^~]*~([^~|]*)", fields.get(f"Segment{n}_Tags", ""))
        if layer < len(layers) and np.any(layers[layer] == value):
            segments[unique(names.get(value, name), segments)] = Segment(layer, value, code[1].replace("^", " ") if code else "")
    if segments:
        return segments
    if len(layers) == 1:
        return numbered(layers[0], names)
    return {unique(f"{n}: {value}", segments): Segment(n, int(value)) for n, layer in enumerate(layers) for value in np.unique(layer) if value}


def unique(name, taken):
    number = 1
    while (name if number == 1 else f"{name} ({number})") in taken:
        number += 1
    return name if number == 1 else f"{name} ({number})"


def read_seg(path, data):
    """A DICOM segmentation that pydicom has read."""
    try:
        frames = data.pixel_array
    except MemoryError:
        raise
    except Exception as error:  # of several kinds
        raise BadFile(f"{path}: its pixels cannot be read: {error}") from error
    try:
        if "PerFrameFunctionalGroupsSequence" not in data:
            raise BadFile(f"{path}: does not say where its frames are, as those of a microscope often do not: expected a segmentation of CT or MR")
        return map_of_frames(path, data, frames.reshape(-1, data.Rows, data.Columns))
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, struct.error) as error:
        raise BadFile(f"{path}: damaged or incomplete: {error}") from error


def has_group(data, frame, name):
    return any(groups.get(name) for groups in (frame, data.get("SharedFunctionalGroupsSequence", [{}])[0]))


def group(data, frame, name):
    """An item of a frame's or of the shared functional groups."""
    for groups in (frame, data.SharedFunctionalGroupsSequence[0]):
        if name in groups:
            return groups[name][0]
    raise ValueError(f"no {name}")


def step_between(apart, measures):
    """mm between planes. Planes without a label may be left out, so the gaps between the others (apart) may all be wider."""
    said = float(measures.get("SpacingBetweenSlices") or 0)
    if not len(apart):
        return said or float(measures.SliceThickness)
    fits = said > 0 and np.all(np.abs(apart / said - np.rint(apart / said)) < 0.1)
    return said if fits and apart.min() > 0.9 * said else float(apart.min())


def map_of_frames(path, data, frames):
    each = data.PerFrameFunctionalGroupsSequence
    if len(each) != len(frames):
        raise ValueError(f"{len(frames)} frames, but {len(each)} entries about them")
    if not (has_group(data, each[0], "PixelMeasuresSequence") and has_group(data, each[0], "PlaneOrientationSequence")
            and has_group(data, each[0], "PlanePositionSequence")):
        raise BadFile(f"{path}: its frames have no place in the patient, as those of a projection or of a microscope: expected a segmentation of CT or MR")
    by_value = data.get("SegmentationType") == "LABELMAP"       # a pixel is its segment's number, and no frame belongs to one segment
    measures = group(data, each[0], "PixelMeasuresSequence")
    right, down = np.array(group(data, each[0], "PlaneOrientationSequence").ImageOrientationPatient, float).reshape(2, 3)
    normal = np.cross(right, down)
    corners = np.array([group(data, frame, "PlanePositionSequence").ImagePositionPatient for frame in each], float)
    heights = corners @ normal
    apart = np.diff(np.unique(np.round(heights, 3)))
    step = step_between(apart, measures)
    planes = np.rint((heights - heights.min()) / step).astype(int)
    uneven = np.abs(heights - heights.min() - planes * step).max()
    if uneven > 0.25 * step or planes.max() > 5000:
        raise BadFile(f"{path}: its planes are not evenly spaced")
    first = corners[np.argmin(heights)]
    place = np.eye(4)
    rows, columns = (float(v) for v in measures.PixelSpacing)
    place[:3] = np.column_stack([right * columns, down * rows, normal * step, first])
    level = 0.5 * int(data.MaximumFractionalValue) if data.get("SegmentationType") == "FRACTIONAL" else 0
    described = {int(item.SegmentNumber): item for item in data.SegmentSequence}
    layers, segments = {}, {}
    for n, frame in enumerate(each):
        numbers = [int(v) for v in np.unique(frames[n]) if v] if by_value else [
            int(group(data, frame, "SegmentIdentificationSequence").ReferencedSegmentNumber)]
        for number in numbers:
            if number not in described:
                raise ValueError(f"a frame of segment {number}, which is not described")
            layer = layers.setdefault(number, np.zeros((int(planes.max()) + 1, *frames.shape[1:]), np.uint8))
            layer[planes[n]] |= (frames[n] == number if by_value else frames[n] > level).astype(np.uint8)
    kept = [number for number in sorted(layers) if layers[number].any()]
    if not kept:
        raise BadFile(f"{path}: all its segments are empty")
    for position, number in enumerate(kept):
        code = (described[number].get("SegmentedPropertyTypeCodeSequence") or [{}])[0]
        label = str(described[number].get("SegmentLabel") or f"Segment {number}").strip()
        segments[unique(label, segments)] = Segment(position, 1, f"{code.get('CodeValue', '')} {code.get('CodeMeaning', '')}".strip())
    return LabelMap([layers[number] for number in kept], check_place(path, place), segments)


def read_names(path):
    """Label number -> name, from nnU-Net's dataset.json, or lines of a number and a name, as ITK-SNAP and many others write them."""
    try:
        with open(path, encoding="utf-8-sig") as file:
            text = file.read()
    except (OSError, UnicodeDecodeError) as error:
        raise BadFile(f"{path}: {error}") from error
    if path.lower().endswith(".json"):
        try:
            listed = json.loads(text)
            listed = listed.get("labels", listed)
            pairs = [(key, value) if str(key).isdigit() else (value, key) for key, value in listed.items()]
            return {int(number): str(name) for number, name in pairs if not isinstance(number, list)}
        except (ValueError, AttributeError, TypeError) as error:
            raise BadFile(f"{path}: expected {{\"labels\": {{\"background\": 0, \"prostate\": 1}}}}: {error}") from error
    found = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = re.match(r'\s*(\d+)[\s,;:]+(?:(?:[\d.]+\s+)+)?"?([^",;]+?)"?\s*([,;].*)?$', line)
        if words:
            found[int(words[1])] = words[2]
        elif line.strip() and not line.lstrip().startswith("#") and number > 1:
            raise BadFile(f"{path}:{number}: expected a number and a name")
    return found


def together(maps):
    """One map of several files with one label each, on one grid, as TotalSegmentator writes them. `maps`: name -> map."""
    (first_name, first), *others = maps.items()
    joined = LabelMap([], first.place, {}, [])
    for name, each in maps.items():
        if each.layers[0].shape != first.layers[0].shape or not np.allclose(each.place, first.place, atol=1e-3):
            raise BadFile(f"{name}: its voxels are not those of {first_name}: save all on one grid")
        if len(each.segments) > 1:
            raise BadFile(f"{name}: has {len(each.segments)} labels: give either one file of labels, or any number of files with one each")
        (segment,) = each.segments.values()
        stem = re.sub(r"(\.seg)?\.(nii|nii\.gz|nrrd|nhdr)$", "", os.path.basename(name), flags=re.I)
        joined.segments[unique(stem, joined.segments)] = Segment(len(joined.layers), segment.value)
        joined.layers.append(each.layers[segment.layer])
        joined.notes += [note for note in each.notes if note not in joined.notes]
    return joined


# ---- surfaces ---------------------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Outlined:
    """The surface of a label."""
    shells: list             # closed, DICOM mm
    points: np.ndarray       # on the faces between voxels in and out of the label, DICOM mm
    volume: float            # of its voxels, mm^3
    notes: list


def signed_distance(mask, spacing):
    """Distance of each voxel to a mask's border, mm, negative inside."""
    def to(inside):
        source = vtk.vtkImageData()
        source.SetDimensions(*mask.shape[::-1])
        source.SetSpacing(*spacing)
        source.GetPointData().SetScalars(numpy_to_vtk(np.where(inside, 0, 1).astype(np.uint8).ravel(), deep=True))
        squared = configured(vtk.vtkImageEuclideanDistance(), ConsiderAnisotropy=True, MaximumDistance=1e9)
        squared.SetInputData(source)
        squared.Update()
        return np.sqrt(vtk_to_numpy(squared.GetOutput().GetPointData().GetScalars()).reshape(mask.shape)).astype(np.float32)
    return to(mask) - to(~mask)


def refined(values, factors):
    """Linear interpolation with so many steps for each, along (z, y, x)."""
    for axis, factor in enumerate(factors):
        if factor > 1:
            count = values.shape[axis]
            at = np.arange((count - 1) * factor + 1) / factor
            low = np.minimum(at.astype(int), count - 2)
            share = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
            values = (1 - share) * np.take(values, low, axis) + share * np.take(values, low + 1, axis)
    return values


def zero_surface(values, spacing):
    """The smooth closed surfaces where a field (z, y, x) is zero, and its volume without smoothing."""
    image = vtk.vtkImageData()
    image.SetSpacing(*spacing)
    image.SetDimensions(*values.shape[::-1])
    image.GetPointData().SetScalars(numpy_to_vtk(np.ascontiguousarray(values, np.float32).ravel(), deep=True))
    zero = vtk.vtkFlyingEdges3D()
    zero.SetValue(0, 0.0)
    rough = pipe(image, zero)
    if rough.GetNumberOfPolys() < 4:
        return []
    smooth = configured(vtk.vtkWindowedSincPolyDataFilter(), NumberOfIterations=30, PassBand=PASS_BAND, NonManifoldSmoothing=True,
                        NormalizeCoordinates=True)
    found = []
    for part in shells.all_parts(shells.from_vtk(rough)):
        smoother = shells.from_vtk(pipe(shells.to_vtk(part), smooth))
        change = smoother.volume() / max(part.volume(), 1e-12) - 1
        found.append(smoother if abs(change) < SMOOTHED else part)
    return found


def face_points(mask):
    """Middles of the faces between voxels in and out of a mask, in voxels (i, j, k)."""
    found = []
    for axis in range(3):
        at = np.argwhere(np.diff(mask.astype(np.int8), axis=axis)).astype(float)
        at[:, axis] += 0.5
        found.append(at[:, ::-1])
    found = np.vstack(found)
    return found[::1 + len(found) // MOST_CHECKED]


def body_of(map_, name):
    """Outlined, of the body: the segment of this name and all others, which labels of one layer leave out of it."""
    every = np.zeros(map_.layers[0].shape, bool)
    for segment in map_.segments.values():
        every |= map_.layers[segment.layer] == segment.value
    whole_map = LabelMap([every.astype(np.uint8)], map_.place, {name: Segment(0, 1)}, map_.notes)
    return outlined(whole_map, [name])[name]


def outlined(map_, names):
    """name -> Outlined, of these segments together: they share surfaces where they touch, unless they overlap."""
    masks = {name: map_.mask(name) for name in names}
    for name, mask in masks.items():
        if not mask.any():
            raise Unusable(name, "it has no voxels")
    used = np.any(list(masks.values()), axis=0)
    bounds = [np.flatnonzero(used.any(axis=tuple(a for a in range(3) if a != axis)))[[0, -1]] for axis in range(3)]
    size = np.array(used.shape)
    low = np.array([b[0] for b in bounds])
    high = np.array([b[1] + 1 for b in bounds])
    stride = max(1, int(np.ceil((np.prod((high - low).astype(float)) / MOST_VOXELS) ** (1 / 3))))
    window = tuple(slice(a, b) for a, b in zip(low, high))
    spacing = stride * np.linalg.norm(map_.place[:3, :3], axis=0)     # x, y, z
    factors = [max(1, int(round(s / spacing.min()))) if s > ELONGATED * spacing.min() else 1 for s in spacing[::-1]]
    while np.prod((high - low) / stride * factors) > 2 * MOST_VOXELS and max(factors) > 1:
        factors[int(np.argmax(factors))] -= 1
    small = {name: np.pad(mask[window][::stride, ::stride, ::stride], AROUND) for name, mask in masks.items()}
    distances = {name: signed_distance(mask, spacing) if mask.any() else None for name, mask in small.items()}
    found = {}
    for name in names:
        notes = list(map_.notes)
        if stride > 1:
            notes.append(f"every {stride}. voxel along each axis is used for its shape, and all for its volume")
        at_border = [axis for axis, b in zip("zyx", range(3)) if masks[name].take(0, b).any() or masks[name].take(size[b] - 1, b).any()]
        if at_border:
            notes.append("reaches the image's border and may be cut off there")
        surfaces = []
        if distances[name] is not None:
            field = distances[name]
            for other in names:
                if other != name and distances[other] is not None and not np.any(small[name] & small[other]):
                    field = np.maximum(field, (distances[name] - distances[other]) / 2)
            surfaces = zero_surface(refined(field, factors), spacing / np.array(factors[::-1]))
        offset = map_.place[:3] @ np.append(low[::-1] - stride * AROUND, 1.0)
        turn = map_.place[:3, :3] * stride / spacing
        surfaces = shells.solids([shells.oriented(Shell(s.points @ turn.T + offset, s.triangles)) for s in surfaces])
        points = (face_points(np.pad(masks[name][window], 1)) + low[::-1] - 1) @ map_.place[:3, :3].T + map_.place[:3, 3]
        found[name] = Outlined(surfaces, points, np.count_nonzero(masks[name]) * map_.voxel(), notes)
    return found
