"""Reads the user's files and selects regions in them."""
import dataclasses
import difflib
import fnmatch
import os
import signal

import numpy as np

from . import limits, materials, organ, reading
from .shapes import contours, voxels
from .trouble import BadFile, Empty

DAMAGED = "damaged, or not what its name says"
PLAUSIBLE = 50.0        # mm: if an image, or all surfaces together, are at least this long, assume that the unit is mm
MOST_NAMED = 30         # maximum number of regions that a message lists


@dataclasses.dataclass
class Sources:
    regions: dict                   # name -> rings, (surface, remarks), or a label's code, in the order of the files
    map: voxels.LabelMap = None
    in_mm: bool = False             # true if the unit of length is certain
    notes: list = dataclasses.field(default_factory=list)


def read(path, work, *arguments):
    """Runs work(path, *arguments) as a stage. If a library crashes or raises an exception because the file is damaged, the error names the file. SIGKILL is
    taken to mean that the system ran out of memory."""
    try:
        return limits.run(f"reading {path}", work, path, *arguments)
    except (BadFile, contours.Unusable, limits.TooLong):
        raise
    except limits.Crashed as error:
        causes = "damaged, not what its name says, or too little memory" if error.number == signal.SIGKILL else DAMAGED
        raise BadFile(f"{path}: {causes}: {error}") from error
    except MemoryError as error:
        raise BadFile(f"{path}: too large for this machine's memory") from error
    except Exception as error:  # libraries raise exceptions of any kind
        if isinstance(error, OSError) and error.filename:
            raise
        raise BadFile(f"{path}: {DAMAGED}: {type(error).__name__}: {error}") from error


def refuse_options(given, *names):
    """Raises BadFile if any of these options were given: they make no sense for this kind of file."""
    for name in names:
        if getattr(given, name):
            raise BadFile(f"{given.input[0]}: --{name} has no meaning for this kind of file: leave it out")


def paths_of(given):
    paths = []
    for path in given.input:
        if os.path.isdir(path):
            paths += reading.files_in(path)
            continue
        if not os.path.isfile(path):
            raise BadFile(f"{path}: no such file")
        if not os.access(path, os.R_OK):
            raise BadFile(f"{path}: no permission to read it")
        paths.append(path)
    return paths


def read_all(given):
    """Reads all files given on the command line; returns their Sources."""
    paths = paths_of(given)
    kinds, first = {reading.kind_of(path) for path in paths}, paths[0]
    names = voxels.read_names(given.names) if given.names else {}
    images = [path for path in paths if reading.kind_of(path) in reading.IMAGES]
    dicom = [path for path in paths if reading.kind_of(path) == ".dcm"]
    if images and len(images) + len(dicom) == len(paths):
        refuse_options(given, "labels")
        return of_maps([(path, lambda path: read(path, reading.read_image, given.unit, names, given.frame)) for path in images]
                       + [(path, lambda path: read(path, reading.read_outlines)) for path in dicom], bool(given.unit))
    unit = given.unit or "mm"
    if len(paths) == 1 and kinds <= set(reading.MESHES) and not read(first, reading.is_surface):
        if reading.kind_of(first) == ".msh":
            refuse_options(given, "names", "labels")
        found = read(first, reading.read_mesh, given.unit, given.frame, given.labels, names)
        return Sources(found, in_mm=bool(given.unit) or reading.says_where(first) and not given.frame or is_large(found))
    if kinds <= {*reading.SURFACES, ".vtk"}:
        refuse_options(given, "names", "labels")
        found = {}
        for path, stem in stems(paths).items():
            found[stem] = read(path, reading.read_surface, reading.UNITS[unit], given.frame)
        return Sources(found, in_mm=bool(given.unit) or is_large(found))
    if len(dicom) == len(paths) > 1:
        refuse_options(given, "unit", "frame", "names", "labels")
        return of_maps([(path, lambda path: read(path, reading.read_outlines)) for path in dicom], True)
    if len(paths) > 1:
        raise BadFile("give either one file of outlines or a volume mesh, or any number of surfaces or of label maps")
    refuse_options(given, "unit", "frame", "names", "labels")
    found = read(first, reading.read_outlines)
    if isinstance(found, voxels.LabelMap):
        return of_map(found, True)
    return Sources(found, in_mm=True)


def stems(paths):
    """Returns path -> name of its region."""
    found = {}
    for path in paths:
        stem = reading.stem_of(path)
        if stem in found.values():
            other = next(each for each, name in found.items() if name == stem)
            raise BadFile(f"{path}: its region would have the same name as that of {other}: rename one of the files")
        found[path] = stem
    return found


def of_maps(readers, in_mm):
    """Reads label maps, [(path, function that reads it)]. Ignores empty maps unless all of them are empty."""
    maps, empty = {}, []
    for path, reader in readers:
        try:
            maps[path] = reader(path)
        except Empty as error:
            if len(readers) == 1:
                raise
            empty.append(error)
            continue
        if not isinstance(maps[path], voxels.LabelMap):
            raise BadFile(f"{path}: is a structure set: give it alone, or only segmentations and label maps")
    if not maps:
        raise BadFile(f"{empty[0]}; so are the other {len(empty) - 1}")
    found = of_map(voxels.together(maps), in_mm)
    if empty:
        found.notes.append(f"{len(empty)} of the {len(readers)} files have no label and are left out: {', '.join(os.path.basename(str(each).split(':')[0]) for each in empty[:4])}"
                           + (" and others" if len(empty) > 4 else ""))
    return found


def of_map(map_, in_mm):
    lengths = np.linalg.norm(map_.place[:3, :3], axis=0) * map_.layers[0].shape[::-1]
    return Sources({name: segment.code for name, segment in map_.segments.items()}, map_, in_mm or PLAUSIBLE <= lengths.max() <= organ.LARGE)


def is_large(surfaces):
    """Whether several surfaces together are the size of body regions in mm. A small surface among them is then taken to be a lesion."""
    points = np.vstack([surface.points for surface, _ in surfaces.values()])
    return len(surfaces) > 1 and PLAUSIBLE <= np.ptp(points, axis=0).max() <= organ.LARGE


# ---- selection of regions ----------------------------------------------------------------------------------------------------------------

@dataclasses.dataclass
class Choice:
    """The names of the chosen regions."""
    soft: list               # soft regions, with the region of interest first
    bones: list
    body: str = None


def listed(names):
    names = list(names)
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more (--list)" if len(names) > MOST_NAMED else "")


def pick(wanted, sources, path):
    """Returns the regions that a command-line argument selects: one by its name or number, or all that match a pattern."""
    plain = wanted.strip().lower()
    alike = [name for name in sources.regions if name.strip().lower() == plain]
    if alike:
        return [wanted if wanted in alike else alike[0]]
    if sources.map:
        also = [name for name, segment in sources.map.segments.items() if plain in (each.lower() for each in segment.also)]
        if len(also) == 1:
            return also
    found = [name for name in sources.regions if fnmatch.fnmatchcase(name.strip().lower(), plain)] if set("*?[") & set(plain) else []
    if found:
        return found
    near = difflib.get_close_matches(plain, [name.lower() for name in sources.regions], 3)
    raise BadFile(f"{path}: has no region \"{wanted}\"" + (f" (perhaps {' or '.join(near)})" if near else "") + f"; it has: {listed(sources.regions)}")


def choose(given, sources):
    """Chooses the regions. Patterns do not match regions that are named elsewhere on the command line."""
    path = given.input[0]
    words = [("soft", word) for word in given.roi] + [("bones", word) for word in given.bone] + [("body", word) for word in ([given.skin] if given.skin else [])]
    meant = [(kind, pick(word, sources, path), bool(set("*?[") & set(word)) and word not in sources.regions) for kind, word in words]
    named = [name for _, names, pattern in meant for name in names if not pattern]
    for name in named:
        if named.count(name) > 1:
            raise BadFile(f"{path}: region \"{name}\" is chosen twice")
    found, taken = {"soft": [], "bones": [], "body": []}, set(named)
    for kind, names, pattern in meant:
        found[kind] += [name for name in names if not pattern or name not in taken]
        taken.update(names)
    choice = Choice(found["soft"], found["bones"], found["body"][0] if found["body"] else None)
    if given.all:
        choose_rest(given, sources, choice)
    if not choice.soft:
        choice.soft = [name for name in sources.regions if name not in choice.bones and name != choice.body]
        if len(choice.soft) != 1:
            raise BadFile(f"{path}: choose the regions with --roi, the one of interest first; it has: {listed(sources.regions)}")
    return choice


def choose_rest(given, sources, found):
    """Adds all remaining regions, recognising bones and the body by name."""
    if not found.soft:
        raise BadFile(f"{given.input[0]}: choose the region of interest with --roi; --all adds the others; it has: {listed(sources.regions)}")
    for name in sources.regions:
        if name in found.soft or name in found.bones or name == found.body:
            continue
        if materials.is_body(name):
            found.body = found.body or name
        else:
            (found.bones if materials.is_bone(name) else found.soft).append(name)
