"""Gmsh's session."""
import gmsh


def start():
    """So that the same input gives the same mesh."""
    gmsh.initialize()
    for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.MshFileVersion", 2.2), ("Geometry.Tolerance", 1e-9),
                          ("Mesh.RandomSeed", 1), ("Mesh.OptimizeThreshold", 0.7), ("Mesh.MeshSizeExtendFromBoundary", 0), ("Mesh.MeshSizeFromPoints", 0),
                          ("Mesh.MeshSizeFromCurvature", 0)):
        gmsh.option.setNumber(option, value)


def restart():
    """After a failure: Gmsh stays locked, and would make empty meshes from then on."""
    gmsh.finalize()
    start()
