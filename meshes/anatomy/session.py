"""Gmsh's session."""
import gmsh

_running = False


def start():
    """Starts a new session with settings for reproducible meshes. After a failure an old one would stay locked and make empty meshes."""
    global _running
    if _running:
        gmsh.finalize()
    gmsh.initialize()
    _running = True
    for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.MshFileVersion", 2.2), ("Geometry.Tolerance", 1e-9),
                          ("Mesh.RandomSeed", 1), ("Mesh.OptimizeThreshold", 0.7), ("Mesh.MeshSizeExtendFromBoundary", 0), ("Mesh.MeshSizeFromPoints", 0),
                          ("Mesh.MeshSizeFromCurvature", 0)):
        gmsh.option.setNumber(option, value)
