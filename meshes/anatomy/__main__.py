"""Makes a mesh, a scene and a quality report from a patient's contours, label maps or surfaces. For the options, see options.py."""
import os
import re
import signal
import sys
import tempfile

import numpy as np

from . import approach, check, limits, materials, meshing, options, organ as organs_in, picture, pipeline, quality, scene, sources
from .shapes import contours, voxels
from .trouble import BadFile

MOST_GROUPS = 32            # maximum number of physical groups (of all dimensions) in a mesh
SPARE_GROUPS = 4            # groups reserved for surrounding tissue, skin, bone and fixed nodes
ENDINGS = (".msh", ".yaml", "-quality.md", "-quality.svg")


def organs_of(given, found):
    """Returns the organs, region of interest first; and the body if its surface serves as the skin, else None."""
    choice = sources.choose(given, found)
    body = [choice.body] if choice.body else []
    inner = [choice.soft[0], *choice.bones, *choice.soft[1:]]
    names = organs_in.region_names([*inner, *body])
    came = dict(found.regions)
    if found.map:
        shapes = limits.run(f"surfaces of {limits.few(inner)}", voxels.outlined, found.map, inner)
        segments = found.map.segments
        came.update({name: (shapes[name], segments[name].code, segments[name].layer) for name in inner})
        came.update({name: (limits.run(f"surface of {name}", voxels.body_of, found.map, name),) for name in body})
    organs = [limits.run(f"region \"{name}\"", organ_of, name, names[name], name in choice.bones, came[name]) for name in [*inner, *body]]
    organs_in.check_sizes(organs, found.in_mm)
    organs[0].notes[:0] = found.notes
    skin = organs.pop() if body else None
    if skin:
        skin.shells = limits.run(f"surface of \"{skin.roi}\"", pipeline.skin_surfaces, skin)
    organs = organs_in.merged(organs, MOST_GROUPS - SPARE_GROUPS)
    for organ in organs:
        if organ.name != re.sub(r"\W+", "_", organ.roi.lower()).strip("_"):
            organ.note(f"is called {organ.name} in mesh and scene")
    return sorted(organs, key=lambda organ: (organ is not organs[0], not organ.bone, -organ.volume)), skin


def organ_of(roi, name, bone, came):
    if isinstance(came, list):
        return organs_in.of_rings(roi, name, bone, came)
    if isinstance(came[0], voxels.Outlined):
        return organs_in.of_label(roi, name, bone, *came)
    return organs_in.of_surface(roi, name, bone, *came)


def prefix_of(given):
    """Returns the path prefix of the output files. If --output is a folder, file names begin with "patient"."""
    path = os.path.join(given.output, options.DEFAULT) if given.output.endswith(os.sep) or os.path.isdir(given.output) else given.output
    folder = os.path.dirname(path) or "."
    if not (os.path.isdir(folder) and os.access(folder, os.W_OK)):
        raise BadFile(f"{given.output}: the folder {folder} does not exist, or cannot be written to")
    return path


def run(given):
    """Runs the program. Returns the organs, the mesh, the domain and the volumes enclosed by the contours; None with --list."""
    limits.SECONDS, limits.TELL = given.time_limit, not given.quiet
    prefix = None if given.list else prefix_of(given)
    own = materials.read(given.materials) if given.materials else {}
    found = sources.read_all(given)
    if given.list:
        print("\n".join(found.regions))
        return None
    try:
        organs, skin = organs_of(given, found)
    except contours.Unusable as error:
        if given.picture:
            picture.draw_problem(error, given.picture)
        raise
    if given.picture:
        limits.run("picture", picture.draw, organs + ([skin] if skin else []), found.regions, given.picture)
    # work in a temporary folder, so as not to leave incomplete files behind
    with tempfile.TemporaryDirectory(prefix=".anatomy-", dir=os.path.dirname(prefix) or ".") as folder:
        made = make(given, organs, skin, own, os.path.join(folder, os.path.basename(prefix)))
        check.load(os.path.join(folder, os.path.basename(prefix) + ".yaml"), len(made[1].points))
        for ending in ENDINGS:
            os.replace(os.path.join(folder, os.path.basename(prefix) + ending), prefix + ending)
    return made


def make(given, organs, skin, own, prefix):
    entry, target = (None if point is None else np.array(point) for point in (given.entry, given.target))
    along_z, tube = (None, given.corridor[0]) if given.corridor and len(given.corridor) == 1 else (given.corridor, None)
    plate = given.template and approach.Template(*map(np.array, given.template))
    plan = pipeline.Plan(given.margin, entry, target, tube, skin, plate, given.skip_small)
    quiet = quiet_walls(organs, own)
    mesh, domain, outlined, parts = pipeline.mesh_of(organs, given.nodes, along_z and [v * 1e-3 for v in along_z], prefix + ".msh", given.crop, plan, quiet)
    start = approach.start_in(mesh, *domain.path, organs[0].name, domain.plate)
    entered = pipeline.patient(start.entry, domain.origin)
    if plate:
        approach.check_template(plate, entered)
    elif entry is not None and np.linalg.norm(entered - entry) > approach.MOVED:
        organs[0].note(f"the needle enters the skin {np.linalg.norm(entered - entry):.1f} mm from --entry, on the line from there to the target")
    write_texts(given, own, [*organs, *([skin] if skin else [])], domain, (prefix, mesh, outlined, start, plate, parts))
    return organs, mesh, domain, outlined


def quiet_walls(organs, own):
    """Returns the names of surfaces to leave without a group of their own if there are too many for a mesh: those that offer a needle no resistance."""
    soft = [organ for organ in organs if not organ.bone]
    felt = [organ for organ in soft if materials.find(organ.roi, organ.kind, own).material.wall is not None]
    free = MOST_GROUPS - SPARE_GROUPS - len(soft) - len(felt)
    if free < 0:
        raise contours.Unusable(organs[0].roi, f"{len(soft)} soft regions, of which {len(felt)} have a wall: more than the {MOST_GROUPS} groups that a mesh may have: choose fewer")
    others = [organ for organ in soft if organ not in felt]
    return {pipeline.surface_name(organ, organs) for organ in others[free:]}


def write_texts(given, own, organs, domain, made):
    """Writes the scene and the quality report, and prints the report. organs: all organs, including the body. made: tuple of the path prefix, the mesh, the
    contours' volumes, the needle's start, the template or None, and the losses.Row of each part."""
    prefix, mesh, outlined, start, plate, parts = made
    organs, skin = [organ for organ in organs if organ.name in outlined], [organ for organ in organs if organ.name not in outlined]
    title = os.path.basename(prefix)
    soft, bones = [organ.name for organ in organs if not organ.bone], any(organ.bone for organ in organs)
    walls = sorted(set(mesh.surfaces) - {"skin", "fixed", "capsule", "bone"})
    source = f"{title}: made by scripts/anatomy from {', '.join(os.path.basename(os.path.normpath(path)) for path in given.input)}"
    distances = limits.run("distances to the input", pipeline.distances_to_outlines, organs, domain, mesh, outlined)
    rows = quality.table(mesh, outlined, distances)
    found = {organ.name: materials.find(organ.roi, organ.kind, own) for organ in organs if not organ.bone}
    found["surrounding"] = materials.find(skin[0].roi if skin else "surrounding", "", own)
    matrix = pipeline.patient_to_mesh(domain.origin)
    write(prefix + ".yaml", scene.text(source, title + ".msh", soft, bones, walls, found=found, matrix=matrix, start=start, template=plate,
                                       wall_of={organ.name: pipeline.surface_name(organ, organs) for organ in organs}))
    quality.draw(mesh, prefix + "-quality.svg")
    notes = [f"needle: {start.remark}"] if start.misses else []
    notes += meshing.remarks_on_number(mesh, given.nodes) + [note for organ in organs + skin for note in organ.notes]
    notes += remarks_on_materials(found)
    entered = ", ".join(f"{value:.1f}" for value in pipeline.patient(start.entry, domain.origin))
    rows.append(("needle", f"enters at ({entered}) mm, {start.remark}", ""))
    losses = quality.mended(organs, mesh, outlined, parts, domain)
    write(prefix + "-quality.md", quality.markdown(f"Quality of {title}.msh", rows, notes, title + "-quality.svg",
                                                   losses + quality.used(found) + quality.transform(matrix)))
    for what, value, paper in rows:
        print(f"{what:52} {value:40} {paper}".rstrip())
    print("\n".join([*losses, *quality.used(found)]))
    for note in notes:
        print(f"anatomy: {note}", file=sys.stderr)
    if mesh.badness() > 1:
        print("anatomy: some dihedral angles exceed the range of the paper's mesh: try another --nodes", file=sys.stderr)


def remarks_on_materials(found):
    guessed = [name for name, each in found.items() if each.basis == materials.GUESS]
    unknown = [name for name in guessed if found[name].row == "any other"]
    notes = [f"material of {limits.few(guessed)}: a guess; --materials takes your own"] if guessed else []
    return notes + ([f"no material is known for {limits.few(unknown)}: the values are those of the tissue around"] if unknown else [])


def write(path, content):
    with open(path, "w", encoding="utf-8") as file:
        file.write(content)


def main():
    given = options.parse(sys.argv[1:])
    limits.end_on_signals()
    try:
        run(given)
    except limits.Crashed as error:
        memory = ": the system ended it, probably because memory did not suffice: choose fewer regions or nodes" if error.number == signal.SIGKILL else ""
        print(f"anatomy: {error}{memory}", file=sys.stderr)
        sys.exit(2)
    except MemoryError as error:
        print(f"anatomy: {str(error) or 'too little memory'}", file=sys.stderr)
        sys.exit(2)
    except (BadFile, contours.Unusable, limits.TooLong, OSError) as error:
        print(f"anatomy: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
