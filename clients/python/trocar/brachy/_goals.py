"""The dose-volume figures (such as D90 and V100) used to judge plans and implants, and their limits."""
from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Iterable, Mapping, Sequence

from ._dose import DVH

BY_USER = "chosen by the user (--limit)"
GEC_ESTRO = "GEC-ESTRO (Salembier et al., Radiotherapy and Oncology 83, 2007), cited from later publications"


@dataclass(frozen=True)
class Figure:
    """A dose-volume figure of an organ and its limits, if any. `dose` is a fraction of the prescription; `volume` is a fraction of the organ, or in m^3."""

    name: str
    organ: str
    unit: str                    # Gy, % or cm³
    dose: float | None = None    # set for figures such as V100, the volume that receives at least this dose
    volume: float | None = None  # set for figures such as D90, the minimum dose that this volume receives
    absolute: bool = False       # true if `volume` is in m^3, or the result is in cm^3
    least: float | None = None   # limits (least and most), as fractions of the prescription or of the organ
    most: float | None = None
    source: str = ""

    def value(self, dvh: DVH, prescription: float) -> float:
        """Computes the figure's value: in Gy, as a fraction, or in cm^3."""
        whole = dvh.voxel * len(dvh.doses)
        if self.volume is not None:
            return dvh.dose(min(self.volume / whole, 1.0) if self.absolute else self.volume)
        return dvh.volume(self.dose * prescription) * (1e6 * whole if self.absolute else 1.0)

    def limit(self, prescription: float) -> tuple[float | None, float | None]:
        """Returns the smallest and largest allowed values, in the unit of `value`; None where there is no limit."""
        factor = prescription if self.unit == "Gy" else 1.0
        return (None if self.least is None else factor * self.least), (None if self.most is None else factor * self.most)

    def met(self, value: float, prescription: float) -> bool | None:
        """Returns whether the value is within the limits, or None if there are none."""
        least, most = self.limit(prescription)
        if least is None and most is None:
            return None
        return (least is None or value >= least) and (most is None or value <= most)

    def shown(self, value: float | None) -> str:
        if value is None:
            return "–"
        return f"{100.0 * value:.1f} %" if self.unit == "%" else f"{value:.2f} cm³" if self.unit == "cm³" else f"{value:.1f} Gy"


FIGURES = (
    Figure("D90", "gland", "Gy", volume=0.9, least=1.0, source=GEC_ESTRO),
    Figure("V100", "gland", "%", dose=1.0, least=0.95, source=GEC_ESTRO),
    Figure("V150", "gland", "%", dose=1.5, most=0.5, source=GEC_ESTRO),
    Figure("V200", "gland", "%", dose=2.0),
    Figure("urethra D10", "urethra", "Gy", volume=0.1, most=1.5, source=GEC_ESTRO),
    Figure("urethra D30", "urethra", "Gy", volume=0.3),
    Figure("rectum D2cc", "rectum", "Gy", volume=2e-6, absolute=True, most=1.0, source=GEC_ESTRO),
    Figure("rectum V100", "rectum", "cm³", dose=1.0, absolute=True),
)


def with_limits(limits: Iterable[str]) -> tuple[Figure, ...]:
    """Returns FIGURES with other limits. Each is given as a figure, <= or >=, and a number: a multiple of the prescription for figures in Gy, a fraction of the
    organ for those in %, and cm^3 for rectum V100. A limit replaces the figure's own limit on the same side. Raises ValueError."""
    ranges = {"Gy": (10.0, "times the prescription"), "%": (1.0, "of the organ"), "cm³": (1000.0, "cm³")}    # to notice a limit given in Gy or %
    found = {figure.name: figure for figure in FIGURES}
    for text in limits:
        match = re.fullmatch(r"\s*(.+?)\s*(<=|>=)\s*([0-9.eE+-]+)\s*", text)
        figure = found.get(match[1]) if match else None
        if not match or not figure:
            raise ValueError(f"\"{text}\": write a figure, <= or >=, and a number, such as \"urethra D10 <= 1.3\"; the figures are {', '.join(found)}")
        most, unit = ranges[figure.unit]
        try:
            value = float(match[3])
        except ValueError:
            value = -1.0
        if not 0.0 <= value <= most:
            raise ValueError(f"\"{text}\": write a number from 0 to {most:g} ({unit})")
        side, other, opposite = ("least", "most", "<=") if match[2] == ">=" else ("most", "least", ">=")
        kept = getattr(figure, other)
        least, highest = (value, kept) if side == "least" else (kept, value)
        if kept is not None and least > highest:
            raise ValueError(f"\"{text}\": cannot be met together with {opposite} {kept:g}")
        found[figure.name] = replace(figure, **{side: value}, source=BY_USER if kept is None else f"{BY_USER}, and {figure.source}")
    return tuple(found.values())


def figures(histograms: Mapping[str, DVH], prescription: float) -> dict[str, float]:
    """Computes all figures of the organs whose histograms are given. Returns values by figure name."""
    return {figure.name: float(figure.value(histograms[figure.organ], prescription)) for figure in FIGURES if figure.organ in histograms}


def unmet(values: Mapping[str, float], prescription: float, goals: Sequence[Figure] = FIGURES) -> list[Figure]:
    """Returns the figures whose values are outside their limits."""
    return [figure for figure in goals if figure.name in values and figure.met(values[figure.name], prescription) is False]
