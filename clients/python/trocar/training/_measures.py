"""The measures of a run: their names, units and meanings."""
from __future__ import annotations

from typing import NamedTuple


class Measure(NamedTuple):
    """A number that describes a run. Values are in SI units, Gy, and fractions; `unit` and `factor` are for display."""

    words: str
    unit: str
    factor: float    # from the value to the displayed number
    decimals: int
    of_plan: bool    # True if the task needs a plan
    of_dose: bool    # True if the plan needs a source and a prescription


def _of(words: str, unit: str = "", factor: float = 1.0, decimals: int = 0, plan: bool = False, dose: bool = False) -> Measure:
    return Measure(words, unit, factor, decimals, plan or dose, dose)


MEASURES = {
    "tip_error": _of("Distance of a tip from its target in the displaced tissue, while the needle was at its deepest; the largest of all targets", "mm", 1e3, 1),
    "seed_error": _of("Mean distance of the seeds from their planned places, in the tissue at rest", "mm", 1e3, 1, plan=True),
    "seed_error_largest": _of("Largest distance of a seed from its planned place", "mm", 1e3, 1, plan=True),
    "seeds_missing": _of("Planned seeds that were not left in the tissue", plan=True),
    "seeds_extra": _of("Seeds in the tissue that were not planned", plan=True),
    "passes": _of("Times that a needle entered the tissue"),
    "redirections": _of("Times that a needle was drawn back by 5 mm or more in the tissue and pushed forward again by 5 mm or more"),
    "path": _of("Length of the paths cut by the needles", "mm", 1e3),
    "time": _of("Time from the first contact of a needle with the tissue until the last needle was left or withdrawn", "s", 1.0, 1),
    "force": _of("Largest force on the hand while the needle was in the tissue", "N", 1.0, 2),
    "displacement": _of("Largest displacement of the gland, or of the tissue if the task names no gland", "mm", 1e3, 1),
    "organs_touched": _of("Organs that a needle entered, of those that the task tells to avoid"),
    "D90": _of("Minimum dose in the 90 % of the gland with the highest doses, needles out", "Gy", 1.0, 1, dose=True),
    "V100": _of("Part of the gland that receives the prescribed dose or more", "%", 100.0, 1, dose=True),
    "V150": _of("Part of the gland that receives 150 % of the prescribed dose or more", "%", 100.0, 1, dose=True),
    "rectum_D2cc": _of("Minimum dose in the 2 cm³ of the rectum with the highest doses", "Gy", 1.0, 1, dose=True),
    "urethra_D10": _of("Minimum dose in the 10 % of the urethra with the highest doses", "Gy", 1.0, 1, dose=True),
}


def shown(name: str, value: float | None) -> str:
    """Formats a value with its unit for display."""
    measure = MEASURES[name]
    if value is None:
        return "–"
    return f"{measure.factor * value:.{measure.decimals}f}{' ' if measure.unit else ''}{measure.unit}".replace("-", "\u2212")
