"""Keeps account of the volume of each part of each region: as read; as used, without what is lost to overlaps and outside the box; and in the mesh."""
import dataclasses

import numpy as np

from . import meshing
from .shapes import labels
from .shapes.contours import Unusable
from .shapes.label_image import OUTSIDE
from .organ import in_ml, note_left_out, placed

MOST_LOSS = 0.10        # of a region's volume: reject meshes with a larger error
PART_LOSS = 0.05        # of a part's volume: name parts with a larger error in the report
SEEN = 5e-4             # of a region's volume: don't mention smaller overlaps
TOLD = 0.01             # of a bone's surface: report a larger missing fraction; above MOST_LOSS, reject the mesh
MISSING = 5.0           # mm: a point on a bone counts as missing if it is farther than this from the bone in the mesh
NARROW = "they are too small or too thin for this number of nodes"


@dataclasses.dataclass
class Row:
    """The volumes (m^3) of a part of a region, or of several parts that have merged."""
    name: str            # name of the region
    place: np.ndarray    # centre of the part in the mesh frame, m
    parts: int           # number of parts in the row
    read: float          # volume as read
    used: float          # volume left after losses to overlapping regions and outside the box
    mesh: float          # volume in the mesh; None if the region is hollow
    gone: str = ""       # reason why the part has vanished
    each: list = dataclasses.field(default_factory=list)     # volumes, as read, of the parts in the row


def rows_of(domain, made):
    """Returns a Row for each part. made: the meshing.Attempt."""
    if not domain.regions:
        return [Row(body.name, body.shell.centre(), 1, body.volume, body.volume, None if body.hollow else held)
                for body, held in zip(domain.bodies, made.held)]
    _, pieces, lost = domain.image
    parts, rows, found = domain.parts(), [], set()
    for members, into in labels.groups_of(pieces):
        members = sorted(members)
        region = parts[members[0]][0]
        held = sum(made.held[piece] for piece in into)
        if all(made.missed[piece] == 1.0 for piece in into):
            continue
        found |= set(members)
        rows.append(row_of(region, [parts[part][1] for part in members], [taken(lost, part) for part in members], None if region.hollow else held))
    for part, (region, n) in enumerate(parts):
        if part not in found:
            reason = "other regions occupy its place" if taken(lost, part) > 0.5 else NARROW
            rows.append(dataclasses.replace(row_of(region, [n], [taken(lost, part)], 0.0), gone=reason))
    order = {region.name: k for k, region in enumerate(domain.regions)}
    return sorted((row for row in rows if row.read is not None), key=lambda row: (order[row.name], -row.read))


def row_of(region, numbers, shares, held):
    volumes = [region.sizes[n] for n in numbers]
    largest = region.shells[max(numbers, key=lambda n: region.shells[n].volume())]
    if None in volumes:
        return Row(region.name, largest.centre(), len(numbers), None, None, held)
    used = sum(volume * (1 - share) for volume, share in zip(volumes, shares))
    return Row(region.name, largest.centre(), len(numbers), sum(volumes), used, held, each=sorted(volumes, reverse=True))


def taken(lost, part):
    return sum(share for (loser, _), share in lost.items() if loser == part)


def note(organs, domain, rows, outlined, skip=False):
    """Adds remarks about losses to the organs. outlined: region name -> volume that the region must have in the mesh, m^3; losses to other regions are
    subtracted from it. skip: subtract parts that have vanished too, instead of rejecting the mesh because of them."""
    called = {organ.name: organ for organ in organs}
    if domain.regions:
        note_overlaps(called, domain, outlined)
    for organ in organs:
        mine = [row for row in rows if row.name == organ.name]
        for reason in {row.gone for row in mine if row.gone}:
            gone = [row for row in mine if row.gone == reason]
            note_left_out(organ, [(row.read * 1e9, in_patient(domain, row.place)) for row in gone], reason.replace("they are", "it is") if len(gone) == 1 else reason)
            if skip:
                outlined[organ.name] -= sum(row.used for row in gone)
        for row in mine:
            if row.parts > 1 and not row.gone and row.mesh is not None:
                named = ", ".join(in_ml(volume * 1e9) for volume in row.each)
                organ.note(f"{row.parts} of its parts, of {named}, around {placed(in_patient(domain, row.place))}, lie so close to each other that they are one in the mesh")
            if not row.gone and row.mesh is not None and abs(row.mesh / row.used - 1) > PART_LOSS:
                which = f"its part of {in_ml(row.used * 1e9)} at {placed(in_patient(domain, row.place))}" if len(mine) > 1 else "it"
                organ.note(f"{which} has {in_ml(row.mesh * 1e9)} in the mesh ({100 * (row.mesh / row.used - 1):+.0f} %)")


def in_patient(domain, point):
    return point * [-1e3, -1e3, 1e3] + domain.origin


def note_overlaps(called, domain, outlined):
    _, _, lost = domain.image
    parts, shares = domain.parts(), {}
    for (part, winner), share in lost.items():
        region, n = parts[part]
        if region.sizes[n] is not None:
            key = region.name, winner
            shares[key] = shares.get(key, 0.0) + share * region.sizes[n]
    for (name, winner), volume in shares.items():
        if name not in called:
            continue
        organ = called[name]
        share = volume * 1e9 / organ.volume
        outlined[name] -= volume
        if winner == OUTSIDE:
            organ.note(f"{100 * share:.1f} % of it lie outside the mesh's box and are left out")
        elif share >= SEEN:
            other = called.get(domain.regions[winner].name)
            organ.note(f"{100 * share:.1f} % of it overlap {other.roi if other else 'the body'} and are assigned to it")


def note_missed(organs, domain, made):
    if not domain.regions:
        return
    _, pieces, _ = domain.image
    weight = pieces.voxels() ** (2 / 3)
    for organ in organs:
        mine = [piece for piece, k in enumerate(pieces.regions) if k != OUTSIDE and domain.regions[k].name == organ.name and made.missed[piece] < 1]
        share = np.average([made.missed[piece] for piece in mine], weights=weight[mine]) if mine else 0
        if share > meshing.MOST_MISSED:
            organ.note(f"{100 * share:.0f} % of its surface is missing in the mesh, where it is too thin for this number of nodes: try more --nodes")


def check_volumes(organs, mesh, outlined):
    for organ in organs:
        if not organ.bone and abs(mesh.region_volume(organ.name) / outlined[organ.name] - 1) > MOST_LOSS:
            raise Unusable(organ.roi, f"the mesh holds {mesh.region_volume(organ.name) * 1e6:.2f} ml of {outlined[organ.name] * 1e6:.2f} ml "
                           f"({100 * (mesh.region_volume(organ.name) / outlined[organ.name] - 1):+.1f} %): raise --nodes, or leave it out")


def check_bones(organs, distances):
    """Checks how much of each bone's surface is missing. Bones are hollow in the mesh, so their volumes cannot be compared."""
    for organ in organs:
        far = distances[organ.name] > MISSING if organ.bone and organ.name in distances else np.zeros(1, bool)
        text = (f"{100 * np.mean(far):.1f} % of its surface lie more than {MISSING:g} mm from the mesh's bone "
                f"(at most {distances[organ.name].max():.0f} mm)") if far.any() else ""
        if np.mean(far) > MOST_LOSS:
            raise Unusable(organ.roi, f"{text}: raise --nodes, or leave it out")
        if np.mean(far) > TOLD:
            organ.note(f"{text}: parts of it are missing; try more --nodes")
