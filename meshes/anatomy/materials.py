"""Materials by organ. The sources are in meshes/PARAMETERS.md."""
import csv
import dataclasses
import re

from .trouble import BadFile


@dataclasses.dataclass(frozen=True)
class Material:
    modulus: float           # Pa
    cutting: float           # N
    static: float            # N/m, friction
    kinetic: float           # N/m
    wall: float = None       # N, puncture force of its surface; None: no resistance
    poisson: float = 0.45
    viscosity: float = 1.0   # N s/m
    viscous: float = 100.0   # N s/m^2


PROSTATE = Material(60e3, 0.3, 15, 9, 0.9)
OTHER = Material(30e3, 0.25, 12, 7)
# Name in the table of sources: material, beginnings of words in the region's name, SNOMED CT codes.
TABLE = {
    "prostate": (PROSTATE, ("prostate", "prostata"), ("41216001", "181422007")),
    "urethra": (OTHER, ("urethra",), ("13648007",)),
    "rectum": (Material(20e3, 0.25, 12, 7), ("rectum", "anorectum"), ("34402009",)),
    "bladder": (Material(10e3, 0.25, 12, 7), ("bladder", "urinary_bladder", "gallbladder"), ("89837001",)),
    "liver": (Material(4.5e3, 0.25, 12, 7, 0.9), ("liver", "hepatic"), ("10200004",)),
    "kidney": (Material(5e3, 0.25, 12, 7, 0.9), ("kidney", "renal"), ("64033007",)),
    "spleen": (Material(2.9e3, 0.25, 12, 7, 0.9), ("spleen",), ("78961009",)),
    "pancreas": (Material(4.8e3, 0.25, 12, 7), ("pancreas",), ("15776009",)),
    "muscle": (Material(11e3, 0.25, 12, 7), ("muscle", "gluteus", "iliopsoas", "autochthon", "levator", "obturator", "psoas"), ("91727004",)),
}
ALSO = {"gland": "prostate"}     # whole names
COLUMNS = {"name": None, "youngs_modulus": "modulus", "poisson_ratio": "poisson", "cutting_force": "cutting", "cutting_viscosity": "viscosity",
           "friction_static": "static", "friction_kinetic": "kinetic", "friction_viscous": "viscous", "puncture_force": "wall"}
POSITIVE = ("modulus",)


def words_of(name):
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def known(name, kind=""):
    """The row of TABLE for a region's name, or for what its file says it is; None: there is none."""
    codes, plain = set(words_of(kind)), "_".join(words_of(name))
    if plain in ALSO:
        return ALSO[plain]
    for row, (_, _, snomed) in TABLE.items():
        if codes & set(snomed):
            return row
    for text in (plain, "_".join(words_of(kind))):
        for row, (_, words, _) in TABLE.items():
            if any(re.search(rf"(^|_){word}", text) for word in words):
                return row
    return None


def find(name, kind="", own=None):
    """`own`: what read() returns."""
    for called, material in (own or {}).items():
        if words_of(called) == words_of(name):
            return material
    row = known(name, kind)
    return TABLE[row][0] if row else OTHER


def read(path):
    """Region name -> Material, of a CSV file with the columns COLUMNS, of which only the name is required."""
    found = {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file, skipinitialspace=True)
            strange = [name for name in rows.fieldnames or [""] if name.strip() not in COLUMNS]
            if strange or "name" not in [name.strip() for name in rows.fieldnames]:
                raise BadFile(f"{path}:1: the header must have name, and may have {', '.join(list(COLUMNS)[1:])}")
            for row in rows:
                name = (row.pop("name") or "").strip()
                found[name] = changed(find(name), row, f"{path}:{rows.line_num}")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadFile(f"{path}: {error}") from error
    return found


def changed(material, row, place):
    values = {}
    for column, text in row.items():
        if column is None or text is None:
            raise BadFile(f"{place}: the number of columns is not that of the header")
        if not text.strip():
            continue
        try:
            number = float(text)
        except ValueError as error:
            raise BadFile(f"{place}: {column}: {error}") from error
        if not number >= 0 or number == 0 and COLUMNS[column.strip()] in POSITIVE:
            raise BadFile(f"{place}: {column}: {text} is too small")
        values[COLUMNS[column.strip()]] = number
    material = dataclasses.replace(material, **values)
    if material.poisson >= 0.5 or material.kinetic > material.static:
        raise BadFile(f"{place}: a Poisson's ratio must be below 0.5, and kinetic friction at most the static")
    return material
