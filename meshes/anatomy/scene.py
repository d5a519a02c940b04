"""The scene that goes with a mesh."""

MATERIALS = {  # Pa; N; N/m static and kinetic: assumptions, see meshes/PARAMETERS.md
    "prostate": (60e3, 0.3, 15, 9), "urethra": (30e3, 0.25, 12, 7), "rectum": (20e3, 0.25, 12, 7), "bladder": (10e3, 0.25, 12, 7)}
OTHER = (30e3, 0.25, 12, 7)


def region(name, material):
    modulus, cutting, static, kinetic = material
    return [f"  - name: {name}", f"    youngs_modulus: {modulus / 1e3:g}e3       # Pa", "    poisson_ratio: 0.45",
            f"    cutting_force: {cutting:g}         # N", "    cutting_viscosity: 1        # N s/m",
            f"    friction: {{static: {static}, kinetic: {kinetic}, viscous: 100}}   # N/m, N/m, N s/m^2"]


def text(title, mesh, soft, bones, walls):
    """`soft`: names of regions, the gland first; `bones`: whether there are any; `walls`: names of surfaces without resistance."""
    lines = [f"# {title}", "# All values are in SI units, and assumptions; a key that is left out has its default (docs/reference/scene.md).", "",
             f"mesh: {mesh}", "", "regions:"]
    lines += region(soft[0], MATERIALS["prostate"])
    for name in soft[1:] + ["surrounding"]:
        lines += region(name, MATERIALS.get(name, OTHER))
    lines += ["", "membranes:", "  - name: skin", "    puncture_force: 0.6         # N", "  - name: capsule", "    puncture_force: 0.9"]
    if bones:
        lines += ["  - name: bone", "    puncture_force: .inf        # stops the tip"]
    if walls:
        lines += [f"# surfaces without resistance: {', '.join(walls)}"]
    lines += ["", "fixed: [fixed, bone]            # bone holds the tissue around it; leave it out, and the tissue moves along it" if bones else "fixed: [fixed]"]
    lines += ["", "needle: {}                      # 18 G, 200 mm"]
    return "\n".join(lines) + "\n"
