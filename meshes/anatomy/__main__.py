"""Makes a mesh, a scene and a quality report from a patient's outlines (DICOM RT Structure Set, CSV) or surfaces (STL, PLY).

The first region is the gland: its surface is the membrane `capsule`. Regions that touch share their surface; overlaps
belong to the smaller region. Outlines and surfaces are in DICOM's patient coordinates, millimetres.
"""
import argparse
import os
import re
import sys

from . import contours, limits, picture, pipeline, quality, reading, scene


def parse_arguments(arguments):
    parser = argparse.ArgumentParser("anatomy", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("input", nargs="+", help="one file of outlines (.dcm, .csv), or surfaces (.stl, .ply), one per region, named after the file")
    parser.add_argument("--list", action="store_true", help="list the regions of interest and exit")
    parser.add_argument("--roi", action="append", default=[], metavar="NAME", help="soft region, the gland first; may be repeated")
    parser.add_argument("--bone", action="append", default=[], metavar="NAME", help="region that no needle enters; may be repeated")
    parser.add_argument("--output", default="patient", metavar="PREFIX", help="writes PREFIX.msh, .yaml, -quality.md, -quality.svg (default: patient)")
    parser.add_argument("--nodes", type=int, default=570, help="number of nodes, reached within 10 %% (default 570)")
    parser.add_argument("--corridor", type=float, nargs=3, metavar=("X", "Y", "RADIUS"),
                        help="mm: elements of half the size around this line along z, in the mesh's frame")
    parser.add_argument("--crop", action="store_true", help="a box around the gland and the bones only; what lies outside is cut off and reported")
    parser.add_argument("--time-limit", type=float, default=limits.SECONDS, metavar="SECONDS",
                        help="processor time for each stage; longer ones are stopped (default %(default)g)")
    parser.add_argument("--unit", choices=("mm", "cm", "m"), default="mm", help="of STL and PLY (default mm)")
    parser.add_argument("--picture", metavar="FILE.svg", help="draw the outlines as read and as interpreted, even if they cannot be used")
    given = parser.parse_args(arguments)
    if not given.time_limit > 0:
        parser.error("--time-limit must be positive")
    if given.nodes < 200:
        parser.error("--nodes must be at least 200")
    if given.corridor and given.corridor[2] <= 0:
        parser.error("--corridor: the radius must be positive")
    return given


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
    limits.end_on_signals()
    try:
        run(parse_arguments(sys.argv[1:]))
    except (reading.BadFile, contours.Unusable, limits.TooLong, limits.Crashed, OSError) as error:
        print(f"anatomy: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
