#!/usr/bin/python3
"""Mesh independence: a rigid needle on meshes of every size against one whose surface is resolved (resolved_needle.json)."""
import json
import subprocess
import sys

from rows import REPOSITORY, SKIPPED, Rows

try:
    import gmsh
except ImportError:
    print("skipped: python3-gmsh is not installed")
    sys.exit(SKIPPED)

LIMIT = 0.07  # just noticeable difference of force (Pang, Tan and Durlach 1991)
TICK_LIMIT = 0.002  # cross-coupling between directions, which rigid_needle.c neglects
ABREAST = "the sum of springs neglects cross-coupling between directions"
BESIDE = "too stiff: elements of 12 mm, 10 mm from a free side; 3000 nodes are enough"
BY_TICK = 6  # number of meshes on which the tick is used; on finer ones, the sum of springs
COARSE = 4  # number of meshes on which both are compared
SIZES = {"short": (0.0155, 0.0125), "full": (0.0155, 0.0125, 0.0125 * 1.001, 0.0125 * 0.999, 0.0078, 0.0053, 0.0040, 0.0030)}


def block(path, size, layered):
    """120 x 120 x 100 mm, `fixed` at z = 0; two regions with a face at z = 50 mm between them if layered."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    heights = (0.05, 0.05) if layered else (0.1,)
    boxes = [(3, occ.addBox(-0.06, -0.06, sum(heights[:i]), 0.12, 0.12, height)) for i, height in enumerate(heights)]
    if layered:
        occ.fragment(boxes[:1], boxes[1:])
    occ.synchronize()
    for tag, name in zip((tag for _, tag in gmsh.model.getEntities(3)), ("lower", "upper")):
        gmsh.model.addPhysicalGroup(3, [tag], tag)
        gmsh.model.setPhysicalName(3, tag, name if layered else "upper")
    floor = [tag for _, tag in gmsh.model.getEntities(2) if abs(occ.getCenterOfMass(2, tag)[2]) < 1e-9]
    gmsh.model.addPhysicalGroup(2, floor, 9)
    gmsh.model.setPhysicalName(2, 9, "fixed")
    for option in ("MeshSizeMin", "MeshSizeMax"):
        gmsh.option.setNumber("Mesh." + option, size)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("")
    gmsh.write(str(path))
    gmsh.finalize()


def rigid_needle(rows, mesh, case):
    """Nodes, contacts and the three forces by the project's contact nodes; sideways and axial again by the tick."""
    tip = case["tip"]
    command = [rows.build / "tests/verification/rigid_needle", mesh, case["radius"], case["poisson_ratio"], *case["axis"], tip,
               case["youngs_modulus_above"], case["youngs_modulus_below"]]
    printed = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True).stdout.split()
    return int(printed[0]), int(printed[1]), *map(float, printed[2:])


def compare(rows, name, case, meshes):
    """The needle by the tick (on the two finest meshes by the sum of springs); the tip's disc, whose shaft slides, by its own spring."""
    for index, mesh in enumerate(meshes):
        nodes, contacts, sideways, along, tip, tick_sideways, tick_along = rigid_needle(rows, mesh, case)
        if index < BY_TICK:
            sideways, along = tick_sideways, tick_along
        note = f"{nodes} nodes, {contacts} contacts" + ("" if index < BY_TICK or case["kind"] == "disc" else ", sum of springs")
        for direction, value in (("sideways", sideways), ("axial", tip if case["kind"] == "disc" else along)):
            if direction in case["force"]:
                expected = case["force"][direction]
                reason = f"; {BESIDE}" if name == "side" and abs(value / expected - 1) > LIMIT else ""
                rows.compare(f"{name}, {direction}, {nodes} nodes", "needle's surface resolved, CalculiX C3D10", value, expected, LIMIT, "N", note + reason)


def compare_with_tick(rows, name, case, meshes):
    """Compares rigid_needle.c, which adds the springs of each direction separately, with the tick, which solves all directions together."""
    apart = 0.0
    for mesh in meshes:
        _, _, sideways, along, _, tick_sideways, tick_along = rigid_needle(rows, mesh, case)
        apart = max(apart, abs(sideways / tick_sideways - 1), abs(along / tick_along - 1))
    rows.error(f"{name}: the springs' forces above against the tick's, worst of {len(meshes)} coarse meshes", "wrench of insertion_tick", apart, TICK_LIMIT,
               ABREAST if apart > TICK_LIMIT else "")


def main():
    rows = Rows.from_arguments(__doc__, "Mesh independence: force for 1 mm")
    reference = json.loads((REPOSITORY / "tests/verification/resolved_needle.json").read_text())
    sizes = SIZES["short" if rows.short_form else "full"]
    meshes = {False: [], True: []}
    for layered in meshes:
        for i, size in enumerate(() if layered and rows.short_form else sizes):
            path = rows.folder / f"block-{'layers-' if layered else ''}{i}.msh"
            block(path, size, layered)
            meshes[layered].append(path)
    for name, case in reference["cases"].items():
        if name.startswith("skin_disc") or (rows.short_form and name != "depth_r0.635_nu0.45"):
            continue # the disc on the skin is checked in tests/test_local_compliance.c
        compare(rows, name, case, meshes[name == "layers"])
        if case["kind"] != "disc":
            compare_with_tick(rows, name, case, meshes[name == "layers"][:COARSE])
    sys.exit(rows.end())


if __name__ == "__main__":
    main()
