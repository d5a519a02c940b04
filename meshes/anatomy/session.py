"""Starts Gmsh sessions, and reads meshes from them."""
import gmsh
import numpy as np

from . import quality
from .shapes.shells import Shell

_running = False


def start():
    """Starts a new session with settings that make meshes reproducible. A new one is needed after a failure, because the old one would stay locked and
    produce empty meshes."""
    global _running
    if _running:
        gmsh.finalize()
    gmsh.initialize()
    _running = True
    for option, value in (("General.Terminal", 0), ("General.NumThreads", 1), ("Mesh.MshFileVersion", 2.2), ("Geometry.Tolerance", 1e-9),
                          ("Mesh.RandomSeed", 1), ("Mesh.OptimizeThreshold", 0.7), ("Mesh.MeshSizeExtendFromBoundary", 0), ("Mesh.MeshSizeFromPoints", 0),
                          ("Mesh.MeshSizeFromCurvature", 0)):
        gmsh.option.setNumber(option, value)


def current_mesh():
    """Returns the mesh of Gmsh's current model, with its named groups, and the volume tag of each tetrahedron."""
    tags, flat, _ = gmsh.model.mesh.getNodes()
    at = np.zeros(int(tags.max()) + 1, int)
    at[tags] = np.arange(len(tags))
    regions, tets, region, volumes = [], [], [], []
    for _, group in gmsh.model.getPhysicalGroups(3):
        for volume in gmsh.model.getEntitiesForPhysicalGroup(3, group):
            corners = at[gmsh.model.mesh.getElementsByType(4, volume)[1]].reshape(-1, 4)
            tets.append(corners)
            region.append(np.full(len(corners), len(regions)))
            volumes.append(np.full(len(corners), volume))
        regions.append(gmsh.model.getPhysicalName(3, group))
    points = flat.reshape(-1, 3)
    surfaces = {gmsh.model.getPhysicalName(2, group): Shell(points, np.concatenate(
        [at[gmsh.model.mesh.getElementsByType(2, surface)[1]].reshape(-1, 3) for surface in gmsh.model.getEntitiesForPhysicalGroup(2, group)]))
        for _, group in gmsh.model.getPhysicalGroups(2)}
    return quality.Mesh(points, np.concatenate(tets), np.concatenate(region), regions, surfaces), np.concatenate(volumes)


def read(path):
    """Reads a mesh file. Unnamed groups are named by their number."""
    gmsh.open(path)
    gmsh.model.mesh.setOrder(1)
    if len(gmsh.model.mesh.getElementsByType(4)[0]) == 0:
        raise ValueError("it has none")
    if not gmsh.model.getPhysicalGroups(3):
        for _, volume in gmsh.model.getEntities(3):
            gmsh.model.addPhysicalGroup(3, [volume], volume)
    for _, group in gmsh.model.getPhysicalGroups(3):
        if not gmsh.model.getPhysicalName(3, group):
            gmsh.model.setPhysicalName(3, group, str(group))
    return current_mesh()[0]
