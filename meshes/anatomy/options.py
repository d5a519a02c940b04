"""The command line. Needs only Python's standard library, so that --help works where the packages for the work itself are missing."""
import argparse

from . import limits

DESCRIPTION = """\
Makes a mesh, a scene and a quality report from a patient's contours (DICOM RT Structure Set, CSV) or surfaces (STL, PLY).

The first region is the gland; its surface becomes the membrane `capsule`. Regions that touch share their surface; where two
overlap, the smaller one gets the volume. Coordinates are DICOM patient coordinates in millimetres.
"""


def parse(arguments, version=None):
    """Arguments as a namespace. Ends the program with status 2 if they are wrong, as argparse does."""
    parser = argparse.ArgumentParser("trocar-anatomy", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add("input", nargs="+", metavar="FILE", help="one file of contours (.dcm, .csv), or surfaces (.stl, .ply), one per region, named after the file")
    add("--list", action="store_true", help="list the regions of interest and exit")
    add("--roi", action="append", default=[], metavar="NAME", help="soft region, the gland first; may be repeated")
    add("--bone", action="append", default=[], metavar="NAME", help="region that no needle can enter; may be repeated")
    add("--output", default="patient", metavar="PREFIX", help="write PREFIX.msh, .yaml, -quality.md and -quality.svg (default patient)")
    add("--nodes", type=int, default=570, metavar="N", help="number of nodes, met within 10 %% (default 570)")
    add("--corridor", type=float, nargs=3, metavar=("X", "Y", "RADIUS"),
        help="halve the element size in a cylinder along z; mm, in the mesh's frame")
    add("--crop", action="store_true", help="limit the box to the gland and the bones; what sticks out is cut off and reported")
    add("--time-limit", type=float, default=limits.SECONDS, metavar="SECONDS", help="stop a stage that takes more processor time (default %(default)g)")
    add("--unit", choices=("mm", "cm", "m"), default="mm", help="unit of STL and PLY files (default mm)")
    add("--picture", metavar="FILE.svg", help="draw the contours as read and as interpreted, even if they cannot be used")
    if version:
        add("--version", action="version", version=f"trocar-anatomy {version}")
    given = parser.parse_args(arguments)
    if not given.time_limit > 0:
        parser.error("--time-limit must be positive")
    if given.nodes < 200:
        parser.error("--nodes must be at least 200")
    if given.corridor and given.corridor[2] <= 0:
        parser.error("--corridor: the radius must be positive")
    return given
