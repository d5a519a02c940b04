"""Materials by organ. For the sources, see meshes/PARAMETERS.md; materials.md shows what an insertion into each material gives."""
import csv
import dataclasses
import re

from .trouble import BadFile

CITED, ASSUMED, GUESS = "cited", "assumed", "guess"


@dataclasses.dataclass(frozen=True)
class Material:
    modulus: float           # Pa
    cutting: float           # N
    static: float            # N/m, friction
    kinetic: float           # N/m
    wall: float = None       # N, puncture force of the region's surface, or None if it offers no resistance
    stiffening: float = 0.0
    poisson: float = 0.45
    viscosity: float = 1.0   # N s/m
    viscous: float = 100.0   # N s/m^2


@dataclasses.dataclass(frozen=True)
class Row:
    """A material and the regions to use it for. words: how words in a region's name begin (regular expressions); codes: SNOMED CT codes; basis: where the
    modulus comes from (CITED, ASSUMED or GUESS); force: source of a published needle force in this organ, for comparison in materials.md, or ""."""
    material: Material
    basis: str
    source: str
    words: tuple = ()
    codes: tuple = ()
    spare: bool = False      # true if needles on their way to other regions should avoid this organ
    force: str = ""


LIVER_FIT = 31e3             # Pa; fitted, together with STIFFENING, to needle forces in liver with its capsule
STIFFENING = 0.165
ENCLOSED = "as liver's, in the ratio of their moduli by shear waves"
SURROUNDING = Row(Material(30e3, 0.25, 12, 7), ASSUMED, "half of figure 8's prostate")
OTHER = Row(Material(30e3, 0.25, 12, 7), GUESS, "as figure 8's surrounding")
# In order of precedence: if a name matches several rows, the first one counts.
TABLE = {
    "tumour": Row(Material(60e3, 0.25, 12, 7), GUESS, "twice what surrounds it",
                  ("tumor", "tumour", "lesion", "metasta", "carcinoma", "cancer", "nodule", "neoplasm", "mass(_|$)", "gtv"), ("108369006", "52988006", "4147007")),
    "fluid": Row(Material(3e3, 0.05, 4, 2), GUESS, "soft: a solid cannot flow", ("cyst", "effusion", "hemorrhage", "bleed", "abscess"), ()),
    "blood vessel": Row(Material(30e3, 0.25, 12, 7), GUESS, "as figure 8's surrounding",
                        ("artery", "arteries", "vein", "vena", "vessel", "aorta", "aortic", "trunk", "portal", "vascul", "atrial_appendage"),
                        ("15825003", "59820001", "32764006", "29092000", "51114001"), True),
    "nerve": Row(Material(30e3, 0.25, 12, 7), GUESS, "as figure 8's surrounding", ("nerve", "spinal_cord", "spinal_canal", "plexus"), ("3057000", "2748008"), True),
    "gallbladder": Row(Material(10e3, 0.25, 12, 7), GUESS, "as bladder's", ("gallbladder", "bile", "gall"), ("28231008",), True),
    "adrenal gland": Row(Material(30e3, 0.25, 12, 7), GUESS, "as figure 8's surrounding", ("adrenal", "suprarenal"), ("23451007",)),
    "prostate": Row(Material(60e3, 0.3, 15, 9, 0.9), ASSUMED, "as figure 8's", ("prostate", "prostata"), ("41216001", "181422007"),
                    force="patients, Podder et al. 2006"),
    "urethra": Row(Material(30e3, 0.25, 12, 7), ASSUMED, "equal to its surroundings", ("urethra",), ("13648007",), True),
    "rectum": Row(Material(20e3, 0.25, 12, 7), ASSUMED, "softer than its surroundings", ("rectum", "anorectum"), ("34402009",), True),
    "bladder": Row(Material(10e3, 0.25, 12, 7), ASSUMED, "filled with fluid, the softest of the pelvis", ("bladder", "urinary_bladder"), ("89837001",), True),
    "liver": Row(Material(LIVER_FIT, 0.25, 12, 7, 0.9, STIFFENING), CITED, "fitted to needles in bovine liver", ("liver", "hepat", "hepar", "leber"), ("10200004",),
                 force="bovine, Okamura et al. 2004"),
    "kidney": Row(Material(34e3, 0.25, 12, 7, 0.9, STIFFENING), ASSUMED, ENCLOSED, ("kidney", "renal", "niere", "nephr"), ("64033007",),
                  force="the whole way in cadavers, doi:10.1089/end.2016.0342"),
    "spleen": Row(Material(20e3, 0.25, 12, 7, 0.9, STIFFENING), ASSUMED, ENCLOSED, ("spleen", "splenic", "milz"), ("78961009",)),
    "pancreas": Row(Material(4.8e3, 0.05, 12, 7), CITED, "shear waves", ("pancrea",), ("15776009",)),
    "bowel": Row(Material(10e3, 0.25, 12, 7), GUESS, "as bladder's", ("bowel", "colon", "duoden", "stomach", "esophag", "oesophag", "intestin", "sigmoid", "jejun", "ileum"),
                 ("71854001", "38848004", "69695003", "32849002", "30315005"), True),
    "lung": Row(Material(2e3, 0.05, 4, 2), GUESS, "soft, filled with air", ("lung", "pulmo", "trachea", "bronch"), ("39607008", "44567001"), True),
    "heart": Row(Material(20e3, 0.25, 12, 7), GUESS, "between muscle's and figure 8's surrounding", ("heart", "myocard", "cardiac", "atrium"), ("80891009",), True),
    "brain": Row(Material(2e3, 0.05, 4, 2), GUESS, "soft", ("brain", "cerebell", "cerebr", "thalamus", "lobe_frontal"), ("12738006",)),
    "breast": Row(Material(3.2e3, 0.05, 12, 7), CITED, "compression of samples: gland and fat alike", ("breast", "mamma", "fibroglandular"), ("76752008",)),
    "thyroid": Row(Material(10e3, 0.25, 12, 7), GUESS, "as muscle's", ("thyroid",), ("69748006",)),
    "muscle": Row(Material(11e3, 0.25, 12, 7), CITED, "shear waves",
                  ("muscle", "gluteus", "iliopsoas", "autochthon", "levator", "obturator", "psoas", "rectus_abdominis", "oblique", "erector", "quadratus", "latissimus",
                   "trapezius", "pectoralis", "diaphragm"), ("91727004",)),
    "fat": Row(Material(3.2e3, 0.05, 12, 7), CITED, "compression of samples of the breast", ("fat", "adipose", "subcutaneous"), ("55603005",)),
}
ALSO = {"gland": "prostate"}     # whole names
BODIES = ("surrounding", "body", "body_trunc", "trunk", "external", "skin", "body_contour", "patient")     # names for the outer contour of the body
BONES = ("bone", "rib", "vertebra", "sacrum", "hip", "femur", "humerus", "scapula", "clavicula", "clavicle", "sternum", "skull", "costal_cartilage", "pelvis",
         "pubic", "ilium", "ischium", "pubis", "coccyx", "tibia", "fibula", "patella", "radius", "ulna", "mandible", "spine", "calvari", "jawbone", "tarsal", "carpal", "metatarsal",
         "metacarpal", "phalang", "hyoid", "teeth", "hip_implant")
COLUMNS = {"name": None, "youngs_modulus": "modulus", "poisson_ratio": "poisson", "stiffening": "stiffening", "cutting_force": "cutting", "cutting_viscosity": "viscosity",
           "friction_static": "static", "friction_kinetic": "kinetic", "friction_viscous": "viscous", "puncture_force": "wall"}
POSITIVE = ("modulus",)


def words_of(name):
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def begins(text, words):
    return any(re.search(rf"(^|_){word}", text) for word in words)


def is_bone(name):
    return known(name) is None and begins("_".join(words_of(name)), BONES)


def is_body(name):
    return "_".join(words_of(name)) in BODIES


def known(name, kind=""):
    """Looks a region up in TABLE by its name or its description in the file (`kind`). Returns the name of the row, or None."""
    codes, plain = set(words_of(kind)), "_".join(words_of(name))
    if plain in ALSO:
        return ALSO[plain]
    for row, entry in TABLE.items():
        if codes & set(entry.codes):
            return row
    for text in (plain, "_".join(words_of(kind))):
        for row, entry in TABLE.items():
            if begins(text, entry.words):
                return row
    return None


def row_of(name, kind=""):
    """Like known(), but returns the row "any other" instead of None."""
    return known(name, kind) or "any other"


def is_spared(name, kind=""):
    """Whether needles on their way to other regions should avoid this one."""
    row = known(name, kind)
    return bool(row) and TABLE[row].spare


@dataclasses.dataclass(frozen=True)
class Found:
    material: Material
    row: str                 # name of the table row that defines the material; "--materials" if the user's file does
    basis: str
    source: str
    force: str = ""          # as in Row

    def text(self):
        return f"{self.row}: {self.basis}, {self.source}"


def find(name, kind="", own=None):
    """Returns the material of a region. own: user-defined materials, as returned by read()."""
    for called, material in (own or {}).items():
        if words_of(called) == words_of(name):
            return Found(material, "--materials", "given", "by the user")
    row = "surrounding" if is_body(name) else row_of(name, kind)
    entry = SURROUNDING if row == "surrounding" else TABLE.get(row, OTHER)
    return Found(entry.material, row, entry.basis, entry.source, entry.force)


def read(path):
    """Reads a CSV file of materials with the columns COLUMNS, of which only `name` is required. Returns region name -> Material."""
    found = {}
    try:
        with open(path, newline="", encoding="utf-8-sig") as file:
            rows = csv.DictReader(file, skipinitialspace=True)
            strange = [name for name in rows.fieldnames or [""] if name.strip() not in COLUMNS]
            if strange or "name" not in [name.strip() for name in rows.fieldnames]:
                raise BadFile(f"{path}:1: the header must have name, and may have {', '.join(list(COLUMNS)[1:])}")
            for row in rows:
                name = (row.pop("name") or "").strip()
                found[name] = changed(find(name).material, row, f"{path}:{rows.line_num}")
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
