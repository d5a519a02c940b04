"""Makes a mesh, a scene and a quality report from a patient's outlines, label maps or surfaces; options.py has the options."""
import os
import re
import signal
import sys

import numpy as np

from . import approach, contours, limits, materials, meshing, options, picture, pipeline, quality, reading, scene, voxels

DAMAGED = "damaged, or not what its name says"


def pick(name, available, path):
    alike = [key for key in available if key.strip().lower() == name.strip().lower()]
    if alike:
        return name if name in alike else alike[0]
    raise reading.BadFile(f"{path}: has no region \"{name}\"; it has: {', '.join(available)}")


def read(path, work, *arguments):
    """work(path, *arguments), as a stage. A library raises whatever it likes on a damaged file, or crashes: the file is named. The system
    ends a process with SIGKILL if there is too little memory."""
    try:
        return limits.run(f"reading {path}", work, path, *arguments)
    except (reading.BadFile, contours.Unusable, limits.TooLong):
        raise
    except limits.Crashed as error:
        causes = "damaged, not what its name says, or too little memory" if error.number == signal.SIGKILL else DAMAGED
        raise reading.BadFile(f"{path}: {causes}: {error}") from error
    except MemoryError as error:
        raise reading.BadFile(f"{path}: too large for this machine's memory") from error
    except Exception as error:  # of any kind
        if isinstance(error, OSError) and error.filename:
            raise
        raise reading.BadFile(f"{path}: {DAMAGED}: {type(error).__name__}: {error}") from error


def refuse_options(given, *names):
    """Refuses these options if they are given: this kind of file has no use for them."""
    for name in names:
        if getattr(given, name):
            raise reading.BadFile(f"{given.input[0]}: --{name} has no meaning for this kind of file: leave it out")


def read_all(given):
    """ROI name -> rings, (surface, remarks), or what its code says; in the files' order. And the label map, or None."""
    kinds, first = {reading.kind_of(path) for path in given.input}, given.input[0]
    for path in given.input:
        if not os.path.isfile(path):
            raise reading.BadFile(f"{path}: no such file")
        if not os.access(path, os.R_OK):
            raise reading.BadFile(f"{path}: no permission to read it")
    names = voxels.read_names(given.names) if given.names else {}
    if kinds <= set(reading.IMAGES):
        refuse_options(given, "labels")
        maps = {path: read(path, reading.read_image, given.unit, names, given.frame) for path in given.input}
        found = voxels.together(maps) if len(maps) > 1 else maps[first]
        return {name: segment.code for name, segment in found.segments.items()}, found
    unit = given.unit or "mm"
    if len(given.input) == 1 and kinds <= set(reading.MESHES) and not read(first, reading.is_surface):
        if reading.kind_of(first) == ".msh":
            refuse_options(given, "names", "labels")
        return read(first, reading.read_mesh, given.unit, given.frame, given.labels, names), None
    if kinds <= {*reading.SURFACES, ".vtk"}:
        refuse_options(given, "names", "labels")
        paths = {}
        for path in given.input:
            stem = reading.stem_of(path)
            if stem in paths:
                raise reading.BadFile(f"{path}: its region would have the same name as that of {paths[stem]}: rename one of the files")
            paths[stem] = path
        return {stem: read(path, reading.read_surface, reading.UNITS[unit], given.frame) for stem, path in paths.items()}, None
    if len(given.input) > 1:
        raise reading.BadFile("give either one file of outlines, labels or a volume mesh, or any number of surfaces or of label maps")
    refuse_options(given, "unit", "frame", "names", "labels")
    found = read(first, reading.read_outlines)
    if isinstance(found, voxels.LabelMap):
        return {name: segment.code for name, segment in found.segments.items()}, found
    return found, None


def organs_of(given, available, labels):
    """The regions, the first of interest first, and the body, if its surface is the skin, or None."""
    soft, bones = ([pick(name, available, given.input[0]) for name in names] for names in (given.roi, given.bone))
    body = [pick(given.skin, available, given.input[0])] if given.skin else []
    if not soft:
        soft = [name for name in available if name not in bones + body]
        if len(soft) != 1:
            raise reading.BadFile(f"{given.input[0]}: choose the regions with --roi, the one of interest first; it has: {', '.join(available)}")
    chosen = [soft[0], *bones, *soft[1:], *body]
    for name in chosen:
        if chosen.count(name) > 1:
            raise reading.BadFile(f"{given.input[0]}: region \"{name}\" is chosen twice")
    names = pipeline.region_names(chosen)
    came = available
    if labels:
        came = {}
        inner = chosen[:len(chosen) - len(body)]
        found = limits.run(f"surfaces of {', '.join(inner)}", voxels.outlined, labels, inner)
        came.update({name: (found[name], labels.segments[name].code) for name in inner})
        came.update({name: (limits.run(f"surface of {name}", voxels.body_of, labels, name), "") for name in body})
    organs = [limits.run(f"region \"{name}\"", organ_of, name, names[name], name in bones, came[name]) for name in chosen]
    always_mm = reading.kind_of(given.input[0]) in reading.OUTLINES
    pipeline.check_sizes(organs, "mm" if always_mm else given.unit)
    skin = organs.pop() if body else None
    if skin:
        skin.shells = limits.run(f"surface of \"{skin.roi}\"", pipeline.skin_surfaces, skin)
    for organ in organs:
        if organ.name != re.sub(r"\W+", "_", organ.roi.lower()).strip("_"):
            organ.note(f"is called {organ.name} in mesh and scene")
    return sorted(organs, key=lambda organ: (organ is not organs[0], not organ.bone, -organ.volume)), skin


def organ_of(roi, name, bone, came):
    if isinstance(came, list):
        return pipeline.organ_of_rings(roi, name, bone, came)
    if isinstance(came[0], voxels.Outlined):
        return pipeline.organ_of_label(roi, name, bone, *came)
    return pipeline.organ_of_surface(roi, name, bone, *came)


def run(given):
    """What was made: the organs, the mesh, the domain, the outlines' volumes; None if only the regions were listed."""
    limits.SECONDS, limits.TELL = given.time_limit, given.progress
    folder = os.path.dirname(given.output) or "."
    if not given.list and not (os.path.isdir(folder) and os.access(folder, os.W_OK)):
        raise reading.BadFile(f"{given.output}: the folder {folder} does not exist, or cannot be written to")
    own = materials.read(given.materials) if given.materials else {}
    available, labels = read_all(given)
    if given.list:
        print("\n".join(available))
        return None
    try:
        organs, skin = organs_of(given, available, labels)
    except contours.Unusable as error:
        if given.picture:
            picture.draw_problem(error, given.picture)
        raise
    if given.picture and organs[0].stack:
        picture.draw([organ.stack for organ in organs], available, given.picture)
    elif given.picture:
        print("anatomy: --picture shows outlines, which surfaces do not have: no picture is written", file=sys.stderr)
    entry, target = (None if point is None else np.array(point) for point in (given.entry, given.target))
    along_z, tube = (None, given.corridor[0]) if given.corridor and len(given.corridor) == 1 else (given.corridor, None)
    plate = given.template and approach.Template(*map(np.array, given.template))
    plan = pipeline.Plan(given.margin, entry, target, tube, skin, plate)
    path = given.output + ".msh"
    mesh, domain, outlined = pipeline.mesh_of(organs, given.nodes, along_z and [v * 1e-3 for v in along_z], path, given.crop, plan)
    try:
        start = approach.start_in(mesh, *domain.path, organs[0].name, domain.plate)
        if plate:
            approach.check_template(plate, pipeline.patient(start.entry, domain.origin))
    except contours.Unusable:
        os.remove(path)
        raise
    write_texts(given, own, [*organs, *([skin] if skin else [])], domain, (mesh, outlined, start, plate))
    return organs, mesh, domain, outlined


def write_texts(given, own, organs, domain, made):
    """`organs`: with the body. made: the mesh, the outlines' volumes, the needle's start, and the template or None."""
    mesh, outlined, start, plate = made
    organs, skin = [organ for organ in organs if organ.name in outlined], [organ for organ in organs if organ.name not in outlined]
    title = os.path.basename(given.output)
    soft, bones = [organ.name for organ in organs if not organ.bone], any(organ.bone for organ in organs)
    walls = sorted(set(mesh.surfaces) - {"skin", "fixed", "capsule", "bone"})
    source = f"{title}: made by scripts/anatomy from {', '.join(os.path.basename(path) for path in given.input)}"
    distances = limits.run("distances to the input", pipeline.distances_to_outlines, organs, domain, mesh, outlined)
    rows = quality.table(mesh, outlined, distances)
    found = {organ.name: materials.find(organ.roi, organ.kind, own) for organ in organs}
    found["surrounding"] = materials.find(skin[0].roi if skin else "surrounding", "", own)
    matrix = pipeline.patient_to_mesh(domain.origin)
    write(given.output + ".yaml", scene.text(source, title + ".msh", soft, bones, walls, found=found, matrix=matrix, start=start, template=plate,
                                             wall_of={organ.name: pipeline.surface_name(organ, organs) for organ in organs}))
    quality.draw(mesh, given.output + "-quality.svg")
    notes = [f"needle: {start.remark}"] if start.misses else []
    notes += meshing.remarks_on_number(mesh, given.nodes) + [note for organ in organs + skin for note in organ.notes]
    entered = ", ".join(f"{value:.1f}" for value in pipeline.patient(start.entry, domain.origin))
    rows.append(("needle", f"enters at ({entered}) mm, {start.remark}", ""))
    write(given.output + "-quality.md", quality.markdown(f"Quality of {title}.msh", rows, notes, title + "-quality.svg",
                                                         quality.mended(organs, mesh, outlined) + quality.transform(matrix)))
    for what, value, paper in rows:
        print(f"{what:52} {value:40} {paper}".rstrip())
    for note in notes:
        print(f"anatomy: {note}", file=sys.stderr)
    if mesh.badness() > 1:
        print("anatomy: some dihedral angles exceed the range of the paper's mesh: try another --nodes", file=sys.stderr)


def write(path, content):
    with open(path, "w", encoding="utf-8") as file:
        file.write(content)


def main():
    given = options.parse(sys.argv[1:])
    limits.end_on_signals()
    try:
        run(given)
    except (reading.BadFile, contours.Unusable, limits.TooLong, limits.Crashed, OSError) as error:
        print(f"anatomy: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
