"""Models how the gland swells after an implant, and computes the dose delivered while the swelling subsides.

The gland swells with the seeds in it, and shrinks back to its former size as the seeds decay. Inside the gland, all distances scale with the cube root of
the volume ratio. Outside, the tissue moves aside and keeps its volume: on each ray from the gland's centre, r'^3 = r^3 + R^3 (ratio - 1), where R is the
distance from the centre to the gland's surface.

    >>> swelling = Swelling()                                    # volume ratio 1.18 on the day of the implant, falling linearly to 1 within 30 days
    >>> swelling = Swelling(1.5, days=None, half_life=10.0)      # exponential decay
    >>> dose = delivered(source, seeds, strength, points, Swollen(gland.points), swelling)
"""
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Sequence

import numpy as np
import numpy.typing as npt

from ._dose import Dose, Source

Array = npt.NDArray[np.float64]

__all__ = ["SOURCE", "Swelling", "Swollen", "delivered"]

SOURCE = ("40 patients with I-125 seeds in serial MR images: 1.18 ± 0.14 times the volume on the day of the implant, 1.01 ± 0.15 after 30 days, linear in between "
          "(Brachytherapy 2010, PubMed 20116344, abstract)")
STAGES = 8      # number of Gauss-Legendre points; doubling it changes D90 by less than 0.01 % (tests/python/test_dosimetry.py)
RAY = 5e-4      # m, from the outermost voxel centre on a ray to the gland's surface: half a 1 mm voxel
CELLS = 24      # the distance from the gland's centre to its surface is tabulated for this many polar intervals and twice as many azimuthal ones


@dataclass(frozen=True)
class Swelling:
    """The gland's volume over time, relative to the volume before the implant. By default, the swelling subsides linearly, as in `SOURCE`. For exponential
    decay, a half-life of about 10 days is typical (Waterman et al., Int. J. Radiation Oncology Biol. Phys. 41, 1998, as cited by Chen et al., Medical Physics
    33, 2006)."""

    ratio: float = 1.18               # volume on the day of the implant relative to the volume before it, at least 1
    days: float | None = 30.0         # time until a linear swelling has subsided; None if the decay is exponential
    half_life: float | None = None    # days, for exponential decay

    def __post_init__(self) -> None:
        if not 1.0 <= self.ratio <= 3.0:
            raise ValueError(f"a swelling of {self.ratio:g} times the volume: expected 1 to 3")
        if (self.days is None) == (self.half_life is None):
            raise ValueError("a swelling has either days or a half-life")
        if not 0.0 < (self.days or self.half_life or 0.0) < math.inf:
            raise ValueError("days or half-life of a swelling: expected a number above 0")

    def volume(self, day: float) -> float:
        """Returns the gland's volume `day` days after the implant, relative to the volume before it."""
        rest = max(1.0 - day / self.days, 0.0) if self.days else 0.5 ** (day / self.half_life)
        return 1.0 + (self.ratio - 1.0) * rest

    def stages(self, half_life: float) -> list[tuple[float, float]]:
        """Returns (weight, relative volume) pairs, with weights that add up to 1. The dose from seeds with this half-life (days) is the weighted mean of their
        doses in glands of these constant volumes."""
        # The weight of a time interval is the fraction of atoms that decay in it. The integral is split where a linear swelling ends, because the
        # integrand has a kink there.
        end = 1.0 - 0.5 ** (self.days / half_life) if self.days else 1.0
        at, weights = np.polynomial.legendre.leggauss(STAGES)
        decayed, found = 0.5 * end * (at + 1.0), []
        for fraction, weight in zip(decayed, 0.5 * end * weights):
            found.append((float(weight), self.volume(-half_life * math.log2(1.0 - fraction))))
        return found + ([(1.0 - end, 1.0)] if end < 1.0 else [])

    def words(self) -> str:
        """Describes the swelling in words, for the report."""
        if self.ratio == 1.0:
            return "no swelling"
        return f"{self.ratio:g} times the volume on the day of the implant, " + (f"subsiding linearly over {self.days:g} days" if self.days else
                                                                               f"decaying exponentially with a half-life of {self.half_life:g} days")


class Swollen:
    """Moves points with a swelling gland, given by its voxel centres (n, 3) m. The gland must be star-shaped about its centroid, as prostates are."""

    def __init__(self, voxels: Array) -> None:
        self.middle = voxels.mean(axis=0)
        off = voxels - self.middle
        far = np.linalg.norm(off, axis=1)
        polar, azimuth = self._cells(off)
        reach = np.zeros((CELLS, 2 * CELLS))
        np.maximum.at(reach, (polar, azimuth), far)
        if not reach.all():    # cells without voxels, which occur in coarse glands, get the mean of the others
            reach[reach == 0.0] = reach[reach > 0.0].mean()
        self._reach = reach + RAY

    @staticmethod
    def _cells(off: Array) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
        """Returns the polar and azimuthal indices (n,) of the cells that contain the directions (n, 3). All cells cover the same solid angle."""
        length = np.maximum(np.linalg.norm(off, axis=1), 1e-12)
        polar = np.clip((0.5 * (off[:, 2] / length + 1.0) * CELLS).astype(int), 0, CELLS - 1)
        azimuth = np.clip(((np.arctan2(off[:, 1], off[:, 0]) / (2.0 * math.pi) + 0.5) * 2 * CELLS).astype(int), 0, 2 * CELLS - 1)
        return polar, azimuth

    def moved(self, points: Array, ratio: float) -> Array:
        """Returns where points (n, 3) m are when the gland has swollen to `ratio` times its volume."""
        off = points - self.middle
        far, scale = np.linalg.norm(off, axis=1), np.full(len(points), ratio ** (1.0 / 3.0))
        surface = self._reach[self._cells(off)]
        outside = far > surface
        scale[outside] = np.cbrt(1.0 + (ratio - 1.0) * (surface[outside] / far[outside]) ** 3)
        return self.middle + scale[:, None] * off


def delivered(source: Source, seeds: Sequence[tuple[Array, Array]], strength: float, points: Array, swollen: Swollen, swelling: Swelling) -> Array:
    """Computes the dose (n,) Gy that seeds of `strength` U deliver to tissue points (n, 3) m; points and seeds move with the swelling. Each seed is given by
    its position (3,) m and direction (3,) in the gland without swelling."""
    total = np.zeros(len(points))
    places = np.reshape([position for position, _ in seeds], (-1, 3))
    for weight, ratio in swelling.stages(source.half_life / 86400.0):
        dose = Dose.at(source, swollen.moved(points, ratio))
        for place, (_, direction) in zip(swollen.moved(places, ratio), seeds):
            dose.add(place, direction, strength)
        total += weight * dose.values
    return total
