"""Names and units of the measures of a run. words/*.json describes them for the user."""
from __future__ import annotations

from typing import NamedTuple


class Measure(NamedTuple):
    """A measure of a run. Values are stored in SI units, Gy or as fractions; `unit` and `factor` are for display."""

    unit: str
    factor: float    # displayed number = factor * value
    decimals: int
    of_plan: bool    # True if the measure needs a plan
    of_dose: bool    # True if that plan needs a source and a prescription


def _of(unit: str = "", factor: float = 1.0, decimals: int = 0, plan: bool = False, dose: bool = False) -> Measure:
    return Measure(unit, factor, decimals, plan or dose, dose)


MEASURES = {
    "tip_error": _of("mm", 1e3, 1),
    "seed_error": _of("mm", 1e3, 1, plan=True),
    "seed_error_largest": _of("mm", 1e3, 1, plan=True),
    "seeds_missing": _of(plan=True),
    "seeds_extra": _of(plan=True),
    "passes": _of(),
    "redirections": _of(),
    "path": _of("mm", 1e3),
    "time": _of("s", 1.0, 1),
    "force": _of("N", 1.0, 2),
    "displacement": _of("mm", 1e3, 1),
    "probe_force": _of("N", 1.0, 2),
    "organs_touched": _of(),
    "D90": _of("Gy", 1.0, 1, dose=True),
    "V100": _of("%", 100.0, 1, dose=True),
    "V150": _of("%", 100.0, 1, dose=True),
    "rectum_D2cc": _of("Gy", 1.0, 1, dose=True),
    "urethra_D10": _of("Gy", 1.0, 1, dose=True),
}


def shown(name: str, value: float | None) -> str:
    """Formats a value with its unit for display."""
    measure = MEASURES[name]
    if value is None:
        return "–"
    return f"{measure.factor * value:.{measure.decimals}f}{' ' if measure.unit else ''}{measure.unit}".replace("-", "\u2212")
