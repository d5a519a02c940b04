"""Reads label maps (NIfTI, NRRD and DICOM SEG) and turns their labels into closed surfaces in DICOM patient coordinates, mm.

Between slices, shapes are interpolated by their signed distances (Raya and Udupa 1990). The surface between two labels lies where their distances are equal,
so labels that touch in the image share a surface.
"""
import bz2
import dataclasses
import gzip
import html
import io
import json
import os
import re
import struct
import zlib

import numpy as np
import vtk
from vtk.util.numpy_support import vtk_to_numpy

from . import shells
from .contours import Unusable
from .label_image import box_of, connected_in, drawn, image_data
from .shells import Shell, configured, pipe
from ..trouble import BadFile, Empty, needed

MOST_VOXELS = 6e6      # subsample images with more voxels than this before extracting surfaces
MOST_SIZE = 2 ** 31    # maximum number of voxels in a file
ELONGATED = 1.5        # interpolate additional slices if a voxel's sides differ by more than this factor
AROUND = 3             # number of empty voxels to add around the labels
PASS_BAND = 0.1        # pass band (0 to 2) of the smoothing filter: removes waves shorter than about six voxels
SMOOTHED = 0.05        # if smoothing changes a part's volume by more than this fraction, it is only a few voxels thin and is not smoothed
# Interpolation makes parts that are only one slice thick too thin. Thicken them if their volume is off by more than this fraction.
OFF_VOLUME = 0.05
MOST_CHECKED = 4000    # measure the distance to the mesh at no more than this many points on a label's surface
ROUNDING = 1e-3        # labels may differ from whole numbers by this much, for example after scaling
APART = 1.0            # mm: report it if the two transforms in a file put the image's corners farther apart than this
OFF_LATTICE = 0.05     # voxels: maps with a larger offset do not have the same lattice
LPS = np.diag([-1.0, -1.0, 1.0, 1.0])   # converts RAS to LPS, and back


@dataclasses.dataclass
class Segment:
    layer: int               # index of its layer in the map
    value: int
    code: str = ""           # the file's description of the segment, used to choose its material
    also: tuple = ()         # other names by which a user may refer to it


@dataclasses.dataclass
class LabelMap:
    layers: list             # integer arrays (k, j, i)
    place: np.ndarray        # (4, 4) from voxel (i, j, k) to mm, LPS
    segments: dict           # name -> Segment
    notes: list = dataclasses.field(default_factory=list)

    def mask(self, name):
        segment = self.segments[name]
        return self.layers[segment.layer] == segment.value

    def voxel(self):
        """Returns the volume of a voxel, mm^3."""
        return abs(np.linalg.det(self.place[:3, :3]))


# ---- files -------------------------------------------------------------------------------------------------------------------

def numbered(values, names):
    """Returns name -> Segment for each value other than 0 in the first layer."""
    found = np.unique(np.concatenate([np.unique(plane) for plane in values]))      # plane by plane, because sorting takes memory
    segments = {}
    for value in map(int, found[found > 0]):
        segments[unique(names.get(value, str(value)), segments)] = Segment(0, value, also=(str(value),))
    return segments


def whole(path, values):
    """Converts an array (i, j, k) of any type to integer labels (k, j, i)."""
    while values.ndim > 3 and values.shape[-1] == 1:
        values = values[..., 0]
    if values.ndim != 3 or min(values.shape) < 2:
        raise BadFile(f"{path}: its size is {' x '.join(map(str, values.shape))}: a label map has three axes of at least two voxels")
    if values.dtype.kind == "f":
        if not np.all(np.isfinite(values)) or np.any(np.abs(values - np.rint(values)) > ROUNDING):
            raise BadFile(f"{path}: its values are not whole numbers: is it an image or a map of probabilities instead of labels?")
        values = np.rint(values)
    elif values.dtype.kind not in "iub":
        raise BadFile(f"{path}: its values are not numbers")
    if values.size and (values.min() < 0 or values.max() > 65535):
        raise BadFile(f"{path}: its values reach from {values.min()} to {values.max()}: labels are 0 to 65535")
    if not values.any():
        raise Empty(f"{path}: has no label: all voxels are 0")
    return np.ascontiguousarray(values.T, np.uint8 if values.max() < 256 else np.uint16)


def check_place(path, place):
    sides = np.linalg.norm(place[:3, :3], axis=0)
    if not np.all(np.isfinite(place)) or np.any(sides <= 0) or abs(np.linalg.det(place[:3, :3])) < 1e-3 * np.prod(sides):
        raise BadFile(f"{path}: it does not say how large its voxels are, or where they lie")
    return place


def check_compressed(path):
    """Raises EOFError or OSError if a compressed file is truncated or has a wrong checksum. nibabel would not notice, because it reads no further than the last
    voxel."""
    if not path.lower().endswith(".gz"):
        return
    with gzip.open(path) as file:
        while file.read(1 << 24):
            pass


def read_nifti(path, unit, names):
    """Reads a NIfTI file. unit: mm per unit of the file, or None to go by the file; names: label number -> name."""
    nibabel = needed("nibabel", "python3-nibabel", path)
    try:
        check_compressed(path)
        image = nibabel.load(path)
        values = np.asanyarray(image.dataobj)
        given = image.header.get_xyzt_units()[0] if hasattr(image.header, "get_xyzt_units") else "mm"
    except MemoryError:
        raise
    except Exception as error:  # several kinds of exception, for example for damaged compression
        raise BadFile(f"{path}: damaged, or not NIfTI: {error}") from error
    scale = unit or {"meter": 1e3, "micron": 1e-3}.get(given, 1.0)
    notes = []
    if "sform_code" in image.header and not image.header["sform_code"] and not image.header["qform_code"]:
        notes.append("the file does not define where the patient's left is: its axes are assumed to point to the right, front and head")
    names = {**names_in(image), **names}
    labels = whole(path, values)
    notes += apart_transforms(image, labels.shape, scale)
    place = check_place(path, LPS @ np.diag([scale] * 3 + [1.0]) @ np.asarray(image.affine, float))
    return LabelMap([labels], place, numbered(labels, names), notes)


def names_in(image):
    """Returns label -> name from a header extension written by Connectome Workbench or TotalSegmentator. It is XML, with the names as CDATA in files by
    TotalSegmentator."""
    found = {}
    for extension in getattr(image.header, "extensions", []):
        content = extension.get_content()
        text = content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        for attributes, data, plain in re.findall(r"<Label\s([^>]*)>\s*(?:<!\[CDATA\[(.*?)\]\]>|([^<]*))\s*</Label>", text, re.S):
            key = re.search(r"""\bKey\s*=\s*["'](\d+)["']""", attributes)
            name = (data or html.unescape(plain)).strip()
            if key and name:
                found[int(key[1])] = name
    return found


def apart_transforms(image, shape, scale):
    """Returns a list with a remark if the file's two transforms, sform and qform, disagree."""
    if not hasattr(image, "get_sform") or not image.header["sform_code"] or not image.header["qform_code"]:
        return []
    corners = np.array([[i, j, k, 1.0] for i in (0, shape[2] - 1) for j in (0, shape[1] - 1) for k in (0, shape[0] - 1)])
    apart = scale * np.abs(np.linalg.norm((image.get_sform() - image.get_qform())[:3] @ corners.T, axis=0)).max()
    return [f"its two transforms, sform and qform, place it up to {apart:.1f} mm apart: the sform is used"] if apart > APART else []


NRRD_TYPES = {"signed char": "i1", "int8": "i1", "int8_t": "i1", "uchar": "u1", "unsigned char": "u1", "uint8": "u1", "uint8_t": "u1",
              "short": "i2", "short int": "i2", "signed short": "i2", "int16": "i2", "int16_t": "i2", "ushort": "u2", "unsigned short": "u2",
              "unsigned short int": "u2", "uint16": "u2", "uint16_t": "u2", "int": "i4", "signed int": "i4", "int32": "i4", "int32_t": "i4",
              "uint": "u4", "unsigned int": "u4", "uint32": "u4", "uint32_t": "u4", "float": "f4", "double": "f8"}
NRRD_SPACES = {"left-posterior-superior": (1, 1, 1), "lps": (1, 1, 1), "right-anterior-superior": (-1, -1, 1), "ras": (-1, -1, 1),
               "left-anterior-superior": (1, -1, 1), "las": (1, -1, 1)}


def nrrd_header(path, file):
    """Reads the header fields of a NRRD file. A detached header ends at the end of the file."""
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
    """Returns the values as bytes. `size`: the number of bytes."""
    encoding = fields.get("encoding", "").lower()
    if encoding in ("gzip", "gz"):
        # There may be several streams. Asking for one more byte makes gzip verify the last checksum.
        return gzip.GzipFile(fileobj=io.BytesIO(rest)).read(size + 1)[:size]
    if encoding in ("bzip2", "bz2"):
        return bz2.BZ2File(io.BytesIO(rest)).read(size + 1)[:size]
    if encoding == "raw":
        return rest
    raise BadFile(f"{path}: its encoding is {encoding or 'not given'}: save it with gzip, bzip2 or raw")


def nrrd_beside(path, fields):
    """Returns the bytes of the separate data file named in a header."""
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


def nrrd_axes(fields, sizes):
    """Returns the directions of the three spatial axes, the origin, and the index of the layer axis (or None); None if the header does not define three spatial
    axes. A fourth axis, for layers or time, may come at any position. Its direction is "none" or, in files written by ITK, outside the first three
    coordinates."""
    said = [None if text == "none" else np.array([float(v) for v in text[1:-1].split(",")])
            for text in re.findall(r"none|\([^)]*\)", fields.get("space directions", ""))]
    origin = np.array([float(v) for v in fields.get("space origin", "(0,0,0)").strip("() ").split(",")])
    if not said and "spacings" in fields:
        spacings = [float(v) for v in fields["spacings"].split()]
        said = [None] * (len(spacings) - 3) + list(np.diag(spacings[-3:]))
    if len(said) == 3 and len(sizes) == 4:      # the layer axis has no entry
        said = [None, *said]
    spatial = [n for n, v in enumerate(said) if v is not None and len(v) >= 3 and not np.any(v[3:] != 0)]
    others = [n for n in range(len(said)) if n not in spatial]
    if len(said) != len(sizes) or len(spatial) != 3 or len(others) > 1 or len(origin) < 3:
        return None
    return [said[n][:3] for n in spatial], origin[:3], others[0] if others else None


def nrrd_start(fields, sizes):
    """Returns the index of the first voxel along each spatial axis, and remarks. It is not always 0, because 3D Slicer before 4.7 stored the position of
    voxel 0 instead of the first voxel's."""
    extent = fields.get("Segmentation_Extent")
    if extent is None or "Segmentation_ReferenceImageExtentOffset" in fields:
        return np.zeros(3), []
    bounds = np.array([int(v) for v in extent.split()]).reshape(3, 2)
    if np.any(bounds[:, 1] - bounds[:, 0] + 1 != sizes):
        return np.zeros(3), ["its Segmentation_Extent does not fit the size of its data and is ignored: check where its regions lie"]
    return bounds[:, 0].astype(float), []


def read_nrrd(path, unit, names, frame):
    """Reads a NRRD file. frame: "LPS" or "RAS", for files that do not define it, or None."""
    with open(path, "rb") as file:
        fields, rest = nrrd_header(path, file), file.read()
    try:
        sizes = [int(v) for v in fields["sizes"].split()]
        kind = np.dtype(NRRD_TYPES[fields["type"].lower()]).newbyteorder(">" if fields.get("endian", "little").lower() == "big" else "<")
        axes = nrrd_axes(fields, sizes)
        if "data file" in fields or "datafile" in fields:
            rest = nrrd_beside(path, fields)
    except (KeyError, ValueError, TypeError) as error:
        raise BadFile(f"{path}: its header is incomplete, or of an unknown kind: {error}") from error
    if len(sizes) not in (3, 4) or min(sizes) < 1 or np.prod(sizes, dtype=float) > MOST_SIZE:
        raise BadFile(f"{path}: its size is {' x '.join(map(str, sizes))}: expected three axes, or four with layers")
    if not axes:
        raise BadFile(f"{path}: it does not say the directions of three axes (space directions)")
    vectors, origin, layer_axis = axes
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
    layers = [values] if layer_axis is None else list(np.moveaxis(values, layer_axis, 0))
    space = re.sub(r"-time$", "", fields.get("space", "").lower())
    space = space[:-1] if space in ("rast", "lpst", "last") else space
    signs = NRRD_SPACES.get(space) or {"LPS": (1, 1, 1), "RAS": (-1, -1, 1), None: None}[frame]
    notes = [] if signs else ["the file does not define its space: LPS is assumed (--frame)"]
    try:
        start, more = nrrd_start(fields, layers[0].shape)
    except ValueError as error:
        raise BadFile(f"{path}: its Segmentation_Extent is not six whole numbers: {error}") from error
    place = np.eye(4)
    place[:3, :3] = np.column_stack(vectors)
    place[:3, 3] = origin + place[:3, :3] @ start
    place = np.diag([*(signs or (1, 1, 1)), 1.0]) @ np.diag([unit or 1.0] * 3 + [1.0]) @ place
    if not any(layer.any() for layer in layers):
        raise Empty(f"{path}: has no label: all voxels are 0")
    found = [whole(path, layer) if layer.any() else np.zeros(layer.T.shape, np.uint16) for layer in layers]
    return LabelMap(found, check_place(path, place), nrrd_segments(fields, found, names), notes + more)


def nrrd_segments(fields, layers, names):
    """Returns name -> Segment, with names from the .seg.nrrd fields that 3D Slicer writes, or numbers if there are none."""
    segments = {}
    # in older files, each segment has its own layer
    several = len(layers) > 1 and not any(key.endswith("_Layer") for key in fields)
    for n in sorted({int(match[1]) for match in map(re.compile(r"Segment(\d+)_").match, fields) if match}):
        value, layer = int(fields.get(f"Segment{n}_LabelValue", 1)), int(fields.get(f"Segment{n}_Layer", n if several else 0))
        name = fields.get(f"Segment{n}_Name") or f"Segment {n}"
        code = re.search(r"TerminologyEntry:[^~]*~[^~]*~([^~|]*)", fields.get(f"Segment{n}_Tags", ""))
        if layer < len(layers) and np.any(layers[layer] == value):
            segments[unique(names.get(value, name), segments)] = Segment(layer, value, code[1].replace("^", " ") if code else "", (str(value),))
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
    """Converts a DICOM segmentation that pydicom has read."""
    try:
        frames = data.pixel_array
    except MemoryError:
        raise
    except Exception as error:  # several kinds of exception
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
    """Looks an item up in a frame's functional groups, then in the shared ones."""
    for groups in (frame, data.SharedFunctionalGroupsSequence[0]):
        if name in groups:
            return groups[name][0]
    raise ValueError(f"no {name}")


def step_between(apart, measures):
    """Returns the distance between planes, mm. It may be smaller than all gaps `apart` between the planes in the file, because planes without a label can be
    missing."""
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
    # in a label map, pixel values are segment numbers, and a frame does not belong to a single segment
    by_value = data.get("SegmentationType") == "LABELMAP"
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
    """Reads label number -> name from nnU-Net's dataset.json, or from lines with a number and a name, as written by ITK-SNAP and many other programs."""
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


NUMBER, UNNAMED = re.compile(r"\d+"), re.compile(r"\d+|Segment[ _]?\d*", re.I)


def named_after_file(path, map_, unnamed=NUMBER):
    """Names an unnamed label after the file if it is the only label in the map. Returns the map."""
    stem = re.sub(r"(\.seg)?\.(nii|nii\.gz|nrrd|nhdr|dcm)$", "", os.path.basename(path), flags=re.I)
    if len(map_.segments) == 1:
        (name, segment), = map_.segments.items()
        map_.segments = {stem if unnamed.fullmatch(name) else name: dataclasses.replace(segment, also=(*segment.also, name, stem))}
    return map_


def canonical(map_):
    """Reorders and flips a map's axes to be as close to LPS as possible, so that maps stored in different orders can be compared."""
    unit = map_.place[:3, :3] / np.linalg.norm(map_.place[:3, :3], axis=0)
    order, free = [], {0, 1, 2}
    for row in range(3):
        best = max(free, key=lambda axis, row=row: abs(unit[row, axis]))
        order.append(best)
        free.discard(best)
    place, layers = map_.place.copy(), map_.layers
    place[:3, :3] = place[:3, order]
    layers = [layer.transpose([2 - order[2 - axis] for axis in range(3)]) for layer in layers]
    for axis in range(3):
        if place[axis, axis] < 0:
            count = layers[0].shape[2 - axis]
            place[:3, 3] += (count - 1) * place[:3, axis]
            place[:3, axis] *= -1
            layers = [np.flip(layer, 2 - axis) for layer in layers]
    return dataclasses.replace(map_, layers=layers, place=place)


def together(maps):
    """Merges the maps of several files into one. They must have the same lattice, but may cover different parts of it. maps: path -> map."""
    if len(maps) == 1:
        return next(iter(maps.values()))
    maps = {path: canonical(named_after_file(path, map_, UNNAMED)) for path, map_ in maps.items()}
    first_path, first = next(iter(maps.items()))
    starts = {}
    for path, each in maps.items():
        offset = np.linalg.solve(first.place[:3, :3], each.place[:3, 3] - first.place[:3, 3])
        size = np.array(each.layers[0].shape[::-1])
        drift = np.abs(np.linalg.solve(first.place[:3, :3], each.place[:3, :3]) - np.eye(3)) @ size
        if np.abs(offset - np.rint(offset)).max() > OFF_LATTICE or drift.max() > OFF_LATTICE:
            raise BadFile(f"{path}: its voxels are not those of {first_path}: save all on one grid")
        starts[path] = np.rint(offset).astype(int)
    low = np.min(list(starts.values()), axis=0)
    high = np.max([start + maps[path].layers[0].shape[::-1] for path, start in starts.items()], axis=0)
    place = first.place.copy()
    place[:3, 3] += place[:3, :3] @ low
    joined = LabelMap([], place, {}, [])
    for path, each in maps.items():
        before, shape = starts[path] - low, np.array(each.layers[0].shape[::-1])
        margins = [(int(a), int(b)) for a, b in zip(before, high - low - before - shape)][::-1]
        for name, segment in each.segments.items():
            joined.segments[unique(name, joined.segments)] = dataclasses.replace(segment, layer=segment.layer + len(joined.layers))
        joined.layers += [np.pad(layer, margins) if any(map(any, margins)) else layer for layer in each.layers]
        joined.notes += [note for note in each.notes if note not in joined.notes]
    return joined


# ---- surfaces ---------------------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Border:
    """The faces of an image that cut off a label, in an arbitrary frame and unit."""
    normals: np.ndarray      # (k, 3) outward unit normals of the faces
    offsets: np.ndarray      # (k,) positions of the faces along their normals

    def __call__(self, points):
        """Returns the distances from points (n, 3) to the nearest face."""
        return (self.offsets - points @ self.normals.T).min(axis=1)

    def seen_from(self, origin):
        """Converts the border to the frame (m) of a mesh whose origin is at this position (DICOM mm)."""
        return Border(self.normals * [-1, -1, 1], 1e-3 * (self.offsets - self.normals @ origin))


@dataclasses.dataclass
class Outlined:
    """The surfaces of a label's connected components ("parts")."""
    shells: list             # one closed surface for each part that has a surface, DICOM mm
    volumes: list            # volumes of these parts, computed from their voxels, mm^3
    points: np.ndarray       # points on the faces between voxels inside and outside the label, DICOM mm
    volume: float            # total volume of the label's voxels, mm^3
    voxel: float             # volume of one voxel, mm^3
    notes: list
    border: Border = None
    gone: list = dataclasses.field(default_factory=list)     # (volume, position) of parts that have no surface, in mm^3 and DICOM mm
    joined: list = dataclasses.field(default_factory=list)   # (volumes of the parts that share a surface, centre of that surface), in the same units


def signed_distance(mask, spacing):
    """Returns the distance (mm) from each voxel to the border of a mask, negative inside the mask."""
    def to(inside):
        source = image_data(np.where(inside, 0, 1).astype(np.uint8))
        source.SetSpacing(*spacing)
        squared = configured(vtk.vtkImageEuclideanDistance(), ConsiderAnisotropy=True, MaximumDistance=1e9)
        squared.SetInputData(source)
        squared.Update()
        return np.sqrt(vtk_to_numpy(squared.GetOutput().GetPointData().GetScalars()).reshape(mask.shape)).astype(np.float32)
    return to(mask) - to(~mask)


def refined(values, factors):
    """Interpolates linearly, with this many steps per voxel along (z, y, x)."""
    for axis, factor in enumerate(factors):
        if factor > 1:
            count = values.shape[axis]
            at = np.arange((count - 1) * factor + 1) / factor
            low = np.minimum(at.astype(int), count - 2)
            share = (at - low).astype(np.float32).reshape([-1 if a == axis else 1 for a in range(3)])
            values = (1 - share) * np.take(values, low, axis) + share * np.take(values, low + 1, axis)
    return values


def zero_surface(values, spacing):
    """Returns the zero level set of a field (z, y, x) as smooth closed surfaces."""
    image = image_data(np.ascontiguousarray(values, np.float32))
    image.SetSpacing(*spacing)
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
    """Returns the centres of the faces between voxels inside and outside a mask, in voxels (i, j, k)."""
    found = []
    for axis in range(3):
        at = np.argwhere(np.diff(mask.astype(np.int8), axis=axis)).astype(float)
        at[:, axis] += 0.5
        found.append(at[:, ::-1])
    found = np.vstack(found)
    return found[::1 + len(found) // MOST_CHECKED]


def body_of(map_, name):
    """Outlines the body. Includes all other segments, because voxels of other segments in the same layer are missing from the body's own segment."""
    every = np.zeros(map_.layers[0].shape, bool)
    for segment in map_.segments.values():
        every |= map_.layers[segment.layer] == segment.value
    whole_map = LabelMap([every.astype(np.uint8)], map_.place, {name: Segment(0, 1)}, map_.notes)
    return outlined(whole_map, [name])[name]


def outlined(map_, names):
    """Outlines several segments together, so that they share surfaces where they touch, unless they overlap. Returns name -> Outlined."""
    masks = {}
    for name in names:
        mask = map_.mask(name)
        window = box_of(mask, 0)
        if window is None:
            raise Unusable(name, "it has no voxels")
        masks[name] = window, np.ascontiguousarray(mask[window])
    return {name: outlined_one(map_, name, masks) for name in names}


def others_beside(name, masks, window):
    """Returns the mask of other labels' voxels in a window, leaving out labels that overlap this one."""
    mine, others = masks[name][0], np.zeros([each.stop - each.start for each in window], bool)
    for other, (place, mask) in masks.items():
        if other == name:
            continue
        common = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(window, place))
        if any(each.start >= each.stop for each in common):
            continue
        found = mask[moved(common, place)]
        both = tuple(slice(max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(common, mine))
        if all(each.start < each.stop for each in both) and np.any(mask[moved(both, place)] & masks[name][1][moved(both, mine)]):
            continue
        others[moved(common, window)] |= found
    return others


def moved(window, origin):
    """Converts slices of the image to slices of one of its sections."""
    return tuple(slice(each.start - start.start, each.stop - start.start) for each, start in zip(window, origin))


def outlined_one(map_, name, masks):
    """Outlines one label. masks: for all labels outlined together, name -> section of the image, and the label's mask in it."""
    tight, mask = masks[name]
    notes, size = list(map_.notes), map_.layers[0].shape
    stride = max(1, int(np.ceil((np.prod(mask.shape) / MOST_VOXELS) ** (1 / 3))))
    if stride > 1:
        notes.append(f"one voxel in {stride} along each axis is used for its shape, and all for its volume")
    border = border_of(map_, tight)
    if border:
        notes.append("reaches the image's border and may be cut off there")
    margin = AROUND * stride
    first = np.array([each.start for each in tight]) - margin          # index of the section's first voxel; may be negative
    window = tuple(slice(max(0, each.start - margin), min(count, each.stop + margin)) for each, count in zip(tight, size))
    beside = np.pad(others_beside(name, masks, window),
                    [(inner.start - start, start + each.stop - each.start + 2 * margin - inner.stop) for inner, start, each in zip(window, first, tight)])
    mine, voxel = np.pad(mask, margin), np.linalg.norm(map_.place[:3, :3], axis=0)         # x, y, z
    place = np.column_stack([map_.place[:3, :3] / voxel, map_.place[:3] @ np.append(first[::-1], 1.0)])
    outlined_ = Outlined([], [], (face_points(mine) + first[::-1]) @ map_.place[:3, :3].T + map_.place[:3, 3],
                         np.count_nonzero(mask) * map_.voxel(), map_.voxel(), notes, border)
    for surface, counts, at in parts_in(mine, shape_of(mine, beside, stride, voxel), voxel):
        volume = sum(counts) * map_.voxel()
        if surface is None:
            outlined_.gone.append((volume, place @ np.append(at, 1.0)))
        else:
            placed = Shell(surface.points @ place[:, :3].T + place[:, 3], surface.triangles).facing_outward()
            if len(counts) > 1:
                outlined_.joined.append(([count * map_.voxel() for count in counts], placed.centre()))
            outlined_.shells.append(placed.holding(volume) if abs(placed.volume() / volume - 1) > OFF_VOLUME else placed)
            outlined_.volumes.append(volume)
    return outlined_


def border_of(map_, tight):
    """Returns the faces of the image that a label in this section touches, or None."""
    normals, offsets, inverse = [], [], np.linalg.inv(map_.place[:3, :3])
    for axis, (each, count) in enumerate(zip(tight[::-1], map_.layers[0].shape[::-1])):      # x, y, z
        for side, at, reached in ((-1, -0.5, each.start == 0), (1, count - 0.5, each.stop == count)):
            if reached:
                normal = side * inverse[axis] / np.linalg.norm(inverse[axis])
                normals.append(normal)
                offsets.append(normal @ (map_.place[:3, :3] @ (np.eye(3)[axis] * at) + map_.place[:3, 3]))
    return Border(np.array(normals), np.array(offsets)) if normals else None


def shape_of(mine, beside, stride, voxel):
    """Returns smooth surfaces of a mask's parts, which extend halfway to other labels, in mm from the mask's first voxel along its axes."""
    spacing = stride * voxel
    factors = [max(1, int(round(s / spacing.min()))) if s > ELONGATED * spacing.min() else 1 for s in spacing[::-1]]
    while mine.size / stride ** 3 * np.prod(factors) > 2 * MOST_VOXELS and max(factors) > 1:
        factors[int(np.argmax(factors))] -= 1
    mine, beside = (each[::stride, ::stride, ::stride] for each in (mine, beside))
    if not mine.any():
        return []
    field = signed_distance(mine, spacing)
    if beside.any():
        field = np.maximum(field, (field - signed_distance(beside, spacing)) / 2)
    return shells.solids(list(map(shells.oriented, zero_surface(refined(field, factors), spacing / np.array(factors[::-1])))))


def parts_in(mask, surfaces, spacing):
    """Matches the connected components of a mask with their surfaces. Returns a list of (surface, voxel counts, position of a voxel), with positions in the
    coordinates of the surfaces. Components inside the same surface form one entry with several voxel counts; the surface is None if there is none."""
    numbers, sizes = connected_in(mask)
    free, found = np.append(False, np.ones(len(sizes), bool)), []
    for surface in sorted(surfaces, key=lambda each: -each.volume()):
        inside, window = drawn(surface, np.zeros(3), spacing, mask.shape)
        held = np.bincount(numbers[window][inside], minlength=len(sizes) + 1)[1:]
        mine = 1 + np.flatnonzero((2 * held > sizes) & free[1:])
        if len(mine):
            free[mine] = False
            found.append((surface, [int(size) for size in sizes[mine - 1]], None))
    _, index = np.unique(numbers, return_index=True)
    for number in np.flatnonzero(free):
        found.append((None, [int(sizes[number - 1])], np.array(np.unravel_index(index[number], mask.shape))[::-1] * spacing))
    return found
