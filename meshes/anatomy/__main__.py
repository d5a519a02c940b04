"""Makes a mesh, a scene and a quality report from a patient's outlines or surfaces; options.py has the options."""
import os
import re
import sys

from . import contours, limits, options, picture, pipeline, quality, reading, scene


def pick(name, available, path):
    alike = [key for key in available if key.strip().lower() == name.strip().lower()]
    if alike:
        return name if name in alike else alike[0]
    raise reading.BadFile(f"{path}: has no region \"{name}\"; it has: {', '.join(available)}")


def read_all(given):
    """ROI name -> rings or surface, in the files' order."""
    kinds = {reading.kind_of(path) for path in given.input}
    if kinds <= set(reading.SURFACES):
        scale = {"mm": 1.0, "cm": 10.0, "m": 1e3}[given.unit]
        paths = {}
        for path in given.input:
            stem = os.path.splitext(os.path.basename(path))[0]
            if stem in paths:
                raise reading.BadFile(f"{path}: its region would have the same name as that of {paths[stem]}: rename one of the files")
            paths[stem] = path
        return {stem: limits.run(f"reading {path}", reading.read_surface, path, scale) for stem, path in paths.items()}
    if len(given.input) > 1:
        raise reading.BadFile("give either one file of outlines or any number of surfaces")
    return limits.run(f"reading {given.input[0]}", reading.read_outlines, given.input[0])


def organs_of(given, available):
    soft, bones = ([pick(name, available, given.input[0]) for name in names] for names in (given.roi, given.bone))
    if not soft:
        soft = [name for name in available if name not in bones]
        if len(soft) != 1:
            raise reading.BadFile(f"{given.input[0]}: choose the gland with --roi; it has: {', '.join(available)}")
    chosen = [soft[0], *bones, *soft[1:]]
    for name in chosen:
        if chosen.count(name) > 1:
            raise reading.BadFile(f"{given.input[0]}: region \"{name}\" is chosen twice")
    names = pipeline.region_names(chosen)
    organs = [limits.run(f"region \"{name}\"", organ_of, name, names[name], name in bones, available[name]) for name in chosen]
    for organ in organs:
        if organ.name != re.sub(r"\W+", "_", organ.roi.lower()).strip("_"):
            organ.note(f"is called {organ.name} in mesh and scene")
    return sorted(organs, key=lambda organ: (organ is not organs[0], not organ.bone, -organ.volume))


def organ_of(roi, name, bone, came):
    if isinstance(came, list):
        return pipeline.organ_of_rings(roi, name, bone, came)
    return pipeline.organ_of_surface(roi, name, bone, *came)


def run(given):
    limits.SECONDS = given.time_limit
    available = read_all(given)
    if given.list:
        print("\n".join(available))
        return
    try:
        organs = organs_of(given, available)
    except contours.Unusable as error:
        if given.picture:
            picture.draw_problem(error, given.picture)
        raise
    if given.picture and organs[0].stack:
        picture.draw([organ.stack for organ in organs], available, given.picture)
    elif given.picture:
        print("anatomy: --picture shows outlines, which surfaces do not have: no picture is written", file=sys.stderr)
    mesh, domain, outlined = pipeline.mesh_of(organs, given.nodes, given.corridor and [v * 1e-3 for v in given.corridor], given.output + ".msh",
                                              given.crop)
    write_texts(given, organs, domain, mesh, outlined)


def write_texts(given, organs, domain, mesh, outlined):
    title = os.path.basename(given.output)
    soft, bones = [organ.name for organ in organs if not organ.bone], any(organ.bone for organ in organs)
    walls = sorted(set(mesh.surfaces) - {"skin", "fixed", "capsule", "bone"})
    source = f"{title}: made by scripts/anatomy from {', '.join(os.path.basename(path) for path in given.input)}"
    distances = pipeline.distances_to_outlines(organs, domain, mesh, outlined)
    rows = quality.table(mesh, outlined, distances)
    write(given.output + ".yaml", scene.text(source, title + ".msh", soft, bones, walls))
    quality.draw(mesh, given.output + "-quality.svg")
    notes = [note for organ in organs for note in organ.notes]
    write(given.output + "-quality.md", quality.markdown(f"Quality of {title}.msh", rows, notes, title + "-quality.svg"))
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
