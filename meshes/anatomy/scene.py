"""Writes the scene file for a mesh."""
import math

import numpy as np

from . import approach, materials


def number(value):
    return ".inf" if math.isinf(value) else f"{value:g}"


def region(name, found):
    m = found.material
    return [f"  - name: {name}               # {found.text()}", f"    youngs_modulus: {m.modulus / 1e3:g}e3       # Pa", f"    poisson_ratio: {m.poisson:g}",
            f"    cutting_force: {number(m.cutting)}         # N", f"    cutting_viscosity: {m.viscosity:g}        # N s/m",
            *([f"    stiffening: {m.stiffening:g}"] if m.stiffening else []),
            f"    friction: {{static: {m.static:g}, kinetic: {m.kinetic:g}, viscous: {m.viscous:g}}}   # N/m, N/m, N s/m^2"]


def listed(values):
    return ", ".join(f"{value + 0.0:.9g}" for value in values)     # + 0.0 turns -0 into 0


def place(matrix, start):
    """Returns two lists of lines: the transform (4, 4) from patient coordinates, and the needle."""
    rows = [listed(row) for row in matrix]
    deep = f", depth: {start.depth:.4f}"
    return ["", "patient_to_mesh: [" + rows[0] + ",    # from DICOM's patient coordinates, mm"] + [
        " " * 18 + row + end for row, end in zip(rows[1:], (",", ",", "]"))], [
        "", f"needle:                         # 18 G, {1e3 * start.length:g} mm",
        *([f"  length: {start.length:g}                # m"] if start.length > approach.NEEDLE else []),
        f"  start: {{position: [{listed(start.position)}], orientation: [{listed(start.orientation)}]{deep}}}    # m, the tip is 1 mm before the skin; depth: to the target"]


def guide(template, matrix):
    """Returns the lines that describe a template with holes for a 1.27 mm needle."""
    turn = matrix[:3, :3] / np.linalg.norm(matrix[:3, 0])
    origin = matrix[:3] @ np.append(template.origin, 1.0)
    return ["", "needles: 16                     # maximum number in the tissue at once", "", "guides:", "  - name: template",
            f"    origin: [{listed(origin)}]    # m, middle of the holes, on the face where needles enter",
            f"    normal: [{listed(turn @ template.normal)}]",
            f"    along: [{listed(turn @ template.along())}]         # columns are counted in this direction: A is on the patient's right, the operator's left",
            f"    rows_along: [{listed(turn @ template.rows_along())}]    # and rows in this one: 1 is at the patient's back",
            f"    columns: {approach.HOLES}", f"    rows: {approach.HOLES}", f"    spacing: {1e-3 * approach.HOLE_SPACING:g}",
            "    hole_diameter: 1.5e-3", f"    thickness: {1e-3 * approach.THICKNESS:g}"]


def text(title, mesh, soft, bones, walls, **more):
    """Returns the text of the scene file. soft: region names, region of interest first; bones: whether there are bones; walls: names of the other surfaces.
    more: `found` (name -> materials.Found, including "surrounding"), `wall_of` (region name -> name of its surface), `matrix` and `start` (see place), and
    `template` or None."""
    found = more.get("found") or {name: materials.find(name) for name in [*soft, "surrounding"]}
    wall_of = more.get("wall_of") or {}
    lines = [f"# {title}", "# All values are in SI units, and assumptions; a key that is left out has its default (docs/reference/scene.csv).", "",
             f"mesh: {mesh}"]
    patient, needle = place(more["matrix"], more["start"]) if "matrix" in more else ([], ["", "needle: {}                      # 18 G, 200 mm"])
    lines += [*patient, "", "regions:"]
    for name in soft + ["surrounding"]:
        lines += region(name, found[name])
    lines += ["", "membranes:", "  - name: skin", "    puncture_force: 0.6         # N"]
    felt = {wall_of.get(name, name + "_wall"): found[name].material.wall for name in soft if found[name].material.wall is not None}
    felt = {name: force for name, force in felt.items() if name == "capsule" or name in walls}
    for name, force in felt.items():
        lines += [f"  - name: {name}", f"    puncture_force: {number(force)}"]
    if bones:
        lines += ["  - name: bone", "    puncture_force: .inf        # stops the tip"]
    quiet = [name for name in walls if name not in felt]
    if quiet:
        lines += [f"# surfaces without resistance: {', '.join(quiet)}"]
    lines += ["", "fixed: [fixed, bone]            # bone holds the tissue around it; leave it out, and the tissue can move along it" if bones else "fixed: [fixed]"]
    plate = guide(more["template"], more["matrix"]) if more.get("template") else []
    return "\n".join([*lines, *needle, *plate]) + "\n"
