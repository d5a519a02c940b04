"""Quality of a tetrahedral mesh, compared with the mesh of Goksel, Salcudean and DiMaio (2006)."""
import dataclasses
import itertools
import logging

import numpy as np

logging.getLogger("matplotlib").setLevel(logging.ERROR)      # hide the warning about an unwritable home folder, which does not matter
import matplotlib  # noqa: E402

matplotlib.use("svg")
matplotlib.rcParams["svg.fonttype"] = "none"      # store text as text instead of outlines
matplotlib.rcParams["svg.hashsalt"] = "trocar"    # reproducible output
import matplotlib.pyplot as plt  # noqa: E402

from .shapes.shells import Shell  # noqa: E402

LEAST_ANGLE, GREATEST_ANGLE = 9.94, 159.49        # deg, range of angles in the paper's mesh, which a new mesh should not exceed
PAPER = {"nodes": "570", "tetrahedra": "2801", "edges, mm": "3.06 to 24.04", "dihedral angles, deg": "9.94 to 159.49",
         "tetrahedra around a node, at most": "40"}


@dataclasses.dataclass
class Mesh:
    points: np.ndarray     # (n, 3) m
    tets: np.ndarray       # (m, 4)
    region: np.ndarray     # (m,) index into `regions` for each tetrahedron
    regions: list          # names
    surfaces: dict = dataclasses.field(default_factory=dict)    # name -> Shell

    def volumes(self):
        a, b, c, d = (self.points[self.tets[:, k]] for k in range(4))
        return np.abs(np.einsum("ij,ij->i", b - a, np.cross(c - a, d - a))) / 6

    def region_volume(self, name):
        return float(self.volumes()[self.region == self.regions.index(name)].sum())

    def boundary(self, name=None):
        """Returns the triangles around a region (including those it shares with other regions), or around all regions, with outward normals."""
        tets = self.tets if name is None else self.tets[self.region == self.regions.index(name)]
        faces = np.concatenate([tets[:, [n for n in range(4) if n != k]] for k in range(4)])
        a, b, c, opposite = (self.points[corner] for corner in (*faces.T, tets.T.ravel()))
        inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), opposite - a) > 0
        faces[inward] = faces[inward, ::-1]
        _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
        return Shell(self.points, faces[first[count == 1]])

    def torn(self):
        """Returns the names of surfaces that have triangles which are not faces of tetrahedra."""
        def keys(faces):
            return np.sort(faces, axis=1) @ (len(self.points) ** np.arange(3, dtype=np.int64))
        faces = np.concatenate([keys(self.tets[:, [n for n in range(4) if n != k]]) for k in range(4)])
        return [name for name, surface in self.surfaces.items() if not np.all(np.isin(keys(surface.triangles), faces))]

    def edges(self):
        pairs = np.concatenate([self.tets[:, pair] for pair in itertools.combinations(range(4), 2)])
        pairs = np.unique(np.sort(pairs, axis=1), axis=0)
        return np.linalg.norm(self.points[pairs[:, 0]] - self.points[pairs[:, 1]], axis=1)

    def dihedral_angles(self):
        """Returns the dihedral angles (m, 6) of the tetrahedra, deg."""
        angles = []
        for i, j in itertools.combinations(range(4), 2):
            k, l = (n for n in range(4) if n not in (i, j))
            edge = self.points[self.tets[:, j]] - self.points[self.tets[:, i]]
            p = np.cross(edge, self.points[self.tets[:, k]] - self.points[self.tets[:, i]])
            q = np.cross(edge, self.points[self.tets[:, l]] - self.points[self.tets[:, i]])
            cosine = np.einsum("ij,ij->i", p, q) / np.sqrt(np.einsum("ij,ij->i", p, p) * np.einsum("ij,ij->i", q, q))
            angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        return np.column_stack(angles)

    def valence(self):
        return np.bincount(self.tets.ravel(), minlength=len(self.points))

    def badness(self):
        """Rates the angles; lower is better. Below 1, all dihedral angles are within the range of the paper's mesh."""
        angles = self.dihedral_angles()
        return max(LEAST_ANGLE / max(angles.min(), 1e-6), (180 - GREATEST_ANGLE) / max(180 - angles.max(), 1e-6))


def table(mesh, outlined, distances):
    """Returns rows (quantity, value, the paper's value). outlined: region name -> volume of its contours, m^3; distances: region name -> distances from
    the contours' points to the region's surface, mm."""
    edges, angles, valence = mesh.edges() * 1e3, mesh.dihedral_angles(), mesh.valence()
    values = {"nodes": str(len(mesh.points)), "tetrahedra": str(len(mesh.tets)), "edges, mm": f"{edges.min():.2f} to {edges.max():.2f}",
              "dihedral angles, deg": f"{angles.min():.2f} to {angles.max():.2f}",
              "tetrahedra around a node, at most": str(valence.max())}
    rows = [(what, value, PAPER[what]) for what, value in values.items()]
    rows.append(("tetrahedra with an angle below 15 or above 150 deg",
                 str(np.count_nonzero((angles.min(axis=1) < 15) | (angles.max(axis=1) > 150))), ""))
    for name in mesh.regions:
        volume = mesh.region_volume(name)
        text = f"{volume * 1e6:.2f}"
        if name in outlined:
            text += f", outlines {outlined[name] * 1e6:.2f} ({100 * (volume / outlined[name] - 1):+.1f} %)"
        rows.append((f"volume of {name}, ml", text, ""))
    for name, off in distances.items():
        rows.append((f"from the outlines' points to the surface of {name}, mm", f"mean {off.mean():.2f}, at most {off.max():.2f}", ""))
    return rows


def mended(organs, mesh, outlined, rows=(), domain=None):
    """Returns a table, as lines, with each region's volume as read, after repair, after losses to overlaps and outside the box, and in the mesh; and the same
    for its parts, if it has several. rows: losses.Row."""
    lines = ["", "Volumes, ml; a bone is hollow in the mesh:", "", "| region | as read | mended | used | mesh | mesh to used |", "|---|---|---|---|---|---|"]
    for organ in organs:
        read, used = organ.volume if organ.read is None else organ.read, outlined[organ.name] * 1e9
        held = None if organ.bone else mesh.region_volume(organ.name) * 1e9
        lines.append(f"| {organ.roi} | {read * 1e-3:.2f} | {organ.volume * 1e-3:.2f} ({100 * (organ.volume / read - 1):+.1f} %) | {used * 1e-3:.2f} "
                     f"({100 * (used / organ.volume - 1):+.1f} %) | " + (f"{held * 1e-3:.2f} | {100 * (held / used - 1):+.2f} % |" if held else " | |"))
        mine = [row for row in rows if row.name == organ.name]
        lines += [part_line(organ, row, domain) for row in mine] if len(mine) > 1 else []
    return lines


def part_line(organ, row, domain):
    place = ", ".join(f"{value + 0.0:.0f}" for value in row.place * [-1e3, -1e3, 1e3] + domain.origin)
    kind = "part" if row.parts == 1 else f"{row.parts} parts in one"
    start = f"| {organ.roi}: {kind} at ({place}) mm | {row.read * 1e6:.3f} | | {row.used * 1e6:.3f} ({100 * (row.used / row.read - 1):+.1f} %) | "
    if row.gone:
        return start + "0 | left out |"
    return start + (f"{row.mesh * 1e6:.3f} | {100 * (row.mesh / row.used - 1):+.2f} % |" if row.mesh is not None and row.used else " | |")


def used(found):
    """Returns a table, as lines, with each region's material and its source. found: name -> materials.Found."""
    lines = ["", "Materials (sources: meshes/PARAMETERS.md):", "", "| region | material | modulus, kPa | cutting, N | wall, N | basis | published force on a needle |", "|" + 7 * "---|"]
    for name, each in found.items():
        m = each.material
        wall = "" if m.wall is None else f"{m.wall:g}"
        lines.append(f"| {name} | {each.row} | {m.modulus / 1e3:g} | {m.cutting:g} | {wall} | {each.basis}: {each.source} | {each.force or 'none found'} |")
    unchecked = [name for name, each in found.items() if not each.force]
    return lines + (["", f"No published force on a needle was found for {', '.join(unchecked)}: what is felt there is not checked."] if unchecked else [])


def transform(matrix):
    """Returns lines that describe a transform (4, 4) from patient coordinates."""
    return ["", "From DICOM's patient coordinates (mm) to the mesh's (m):", "", "```text",
            *(" ".join(f"{value + 0.0:12.6g}" for value in row) for row in matrix), "```"]


def markdown(title, rows, notes, histogram, more=()):
    lines = [f"# {title}", "", "Beside the mesh of Goksel, Salcudean and DiMaio (2006).", "", "| | this mesh | 2006 |", "|---|---|---|"]
    lines += [f"| {what} | {value} | {paper} |" for what, value, paper in rows]
    lines += more
    lines += ["", f"![Dihedral angles, edges, tetrahedra around a node]({histogram})"]
    if notes:
        lines += ["", "Remarks:", ""] + [f"- {note}" for note in notes]
    return "\n".join(lines) + "\n"


def draw(mesh, path):
    figure, axes = plt.subplots(1, 3, figsize=(9, 2.6), layout="constrained")
    for axis, values, bins, label, limits in (
            (axes[0], mesh.dihedral_angles().ravel(), np.arange(0, 181, 5), "dihedral angle (deg)", (LEAST_ANGLE, GREATEST_ANGLE)),
            (axes[1], mesh.edges() * 1e3, 30, "edge (mm)", (3.06, 24.04)),
            (axes[2], mesh.valence(), np.arange(0, mesh.valence().max() + 2) - 0.5, "tetrahedra around a node", (40,))):
        axis.hist(values, bins=bins, color="#0072B2")
        for limit in limits:
            axis.axvline(limit, color="#D55E00", linewidth=0.8, linestyle="--")
        axis.set_xlabel(label)
    axes[0].set_ylabel("count")
    figure.suptitle("dashed: extremes of the mesh of 2006", fontsize=8)
    figure.savefig(path, metadata={"Date": None, "Title": "Quality of the mesh"})
    plt.close(figure)
