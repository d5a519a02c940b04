"""Parses the command line. Uses only the standard library, so that --help works even if packages that the program needs are missing."""
import argparse
import math

from . import limits

DEFAULT = "patient"      # prefix of the file names

DESCRIPTION = """\
Makes a mesh, a scene and a quality report from a patient's contours (DICOM RT Structure Set, CSV), label maps (NIfTI, NRRD, DICOM SEG),
surfaces (STL, PLY, OBJ, VTK) or volume meshes with labels (VTK, Gmsh). A folder stands for the structure set or the segmentations in it.

The first region is the one that the needle is aimed at. Regions that touch share their surface; where two overlap, the smaller one gets
the volume. Positions are DICOM patient coordinates in millimetres: to the patient's left, back and head.
"""


def point(text):
    values = [float(value) for value in text.split(",")]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise argparse.ArgumentTypeError(f"{text}: expected X,Y,Z")
    return values


def template(text):
    """Parses a position and an optional direction. Returns the direction as a unit vector."""
    values = text.split(",")
    if len(values) not in (3, 6):
        raise argparse.ArgumentTypeError(f"{text}: expected X,Y,Z or X,Y,Z,NX,NY,NZ")
    origin, normal = point(",".join(values[:3])), point(",".join(values[3:] or ["0", "0", "1"]))
    length = math.hypot(*normal)
    if length < 1e-6:
        raise argparse.ArgumentTypeError(f"{text}: the direction has no length")
    return origin, [value / length for value in normal]


def parse(arguments, version=None):
    """Returns the arguments as a namespace. Like argparse, exits with status 2 if they are wrong."""
    parser = argparse.ArgumentParser("trocar-anatomy", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("input", nargs="+", metavar="FILE", help="one file of contours (DICOM, .csv) or a volume mesh (.vtu, .vtk, .msh); any number of label maps on the same grid (DICOM, .nii, .nii.gz, .nrrd, .nhdr); "
        "any number of surfaces, named after the file (.stl, .ply, .obj, .vtp, .vtk); or a folder of one of these kinds")
    add("--list", action="store_true", help="list the regions of interest and exit")
    add("--roi", action="append", default=[], metavar="NAME", help="soft region, the one of interest first; may be repeated. NAME may be a label's number, or a pattern such as 'lung_*'")
    add("--bone", action="append", default=[], metavar="NAME", help="region, or pattern of regions, that no needle can enter; may be repeated")
    add("--all", action="store_true", help="also use all other regions: those named like bones as bones, the body as the skin")
    add("--output", default=DEFAULT, metavar="PREFIX", help=f"write PREFIX.msh, .yaml, -quality.md and -quality.svg (default {DEFAULT}); a folder: write {DEFAULT}.msh into it, and so on")
    add("--nodes", type=int, default=570, metavar="N", help="desired number of nodes, reached within 10 %% if the anatomy allows it (default 570)")
    add("--corridor", type=float, nargs="+", metavar="MM",
        help="halve the element size in a cylinder along z; mm, in the mesh's frame. One number: RADIUS around the needle's path")
    add("--crop", action="store_true", help="limit the box to the first region and the bones; parts outside the box are cut off and reported")
    add("--skip-small", action="store_true", help="leave out regions that are too small or too thin for the number of nodes, and say which (default: refuse them)")
    add("--time-limit", type=float, metavar="SECONDS",
        help=f"stop a stage that takes more processor time (default {limits.DEFAULT:g}, and proportionally more above {limits.NODES} nodes)")
    add("--unit", choices=("mm", "cm", "m"), help="unit of the file's lengths (default: as specified in the file, otherwise mm)")
    add("--frame", choices=("LPS", "RAS"), help="axes of the file: to the left, back and head, or right, front and head (default: as "
        "specified in the file, otherwise LPS)")
    add("--names", metavar="FILE", help="names of the labels: nnU-Net's dataset.json, or lines that consist of a number and a name")
    add("--labels", metavar="ARRAY", help="the array of a volume mesh's cells that holds the labels")
    add("--skin", metavar="NAME", help="region whose surface is the skin, such as BODY; it is cut to a block around the others (default: the face of a box)")
    add("--entry", type=point, metavar="X,Y,Z", help="point at which the needle enters the skin (default: the nearest point without bone in the way)")
    add("--target", type=point, metavar="X,Y,Z", help="point that the needle should reach (default: the middle of the first region)")
    add("--template", type=template, metavar="X,Y,Z[,NX,NY,NZ]",
        help="a template of 13 x 13 holes, 5 mm apart: the centre of the hole pattern on the face where "
        "needles enter, and the direction in which they pass (default 0,0,1: to the head); the needle starts in the hole nearest to the target")
    add("--margin", type=float, default=25.0, metavar="MM",
        help="thickness of the tissue around the first region; with --skin, around all regions (default 25)")
    add("--materials", metavar="FILE.csv", help="materials of regions by name, in place of the built-in ones: see PARAMETERS.md")
    add("--quiet", action="store_true", help="do not print the name of each stage on stderr")
    add("--progress", action="store_true", help=argparse.SUPPRESS)      # has no effect: progress is printed by default
    add("--picture", metavar="FILE.svg", help="draw the regions, slice by slice, as read and as interpreted; contours even if they cannot be used")
    if version:
        add("--version", action="version", version=f"trocar-anatomy {version}")
    given = parser.parse_args(arguments)
    if given.nodes < 200:
        parser.error("--nodes must be at least 200")
    if given.time_limit is None:
        given.time_limit = limits.seconds_for(given.nodes)
    if not given.time_limit > 0:
        parser.error("--time-limit must be positive")
    if given.corridor and len(given.corridor) not in (1, 3):
        parser.error("--corridor: expected RADIUS, or X Y RADIUS")
    if given.corridor and given.corridor[-1] <= 0:
        parser.error("--corridor: the radius must be positive")
    if not 5 <= given.margin <= 500:
        parser.error("--margin must be from 5 to 500 mm")
    if given.entry and given.target and math.dist(given.entry, given.target) < 1:
        parser.error("--entry and --target are the same point")
    if given.entry and given.template:
        parser.error("--entry and --template both define where the needle enters: give only one of them")
    return given
