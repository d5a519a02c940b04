"""Computes Sobol sensitivity indices of a function of independent parameters, using Saltelli's design.

A parameter's first-order index is the fraction of the result's variance that is due to this parameter alone; its total index includes interactions with
other parameters. For p parameters, the design has N (p + 2) points: N points A, N points B and, for each parameter, the points A with that parameter's
values taken from B.

    >>> from trocar.studies import sensitivity
    >>> points = sensitivity.design(3, 1024, seed=1)             # in the unit cube
    >>> found = sensitivity.indices(function(points), 3)
    >>> found.first, found.total

First-order indices follow Saltelli and others, Computer Physics Communications 181 (2010) 259-270, table 2, formula (b). Total indices follow Jansen,
Computer Physics Communications 117 (1999) 35-43, which is formula (f) in that table.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Indices", "design", "indices"]

Array = npt.NDArray[np.float64]


class Indices(NamedTuple):
    """The sensitivity indices of each parameter, with 95 % confidence limits."""

    first: Array          # (p,)
    total: Array          # (p,)
    first_interval: Array  # (p, 2)
    total_interval: Array  # (p, 2)


def design(parameters: int, count: int, seed: int) -> Array:
    """Returns the design as (count (p + 2), p) points in the unit cube, from scrambled Sobol points in 2 p dimensions. Each Sobol point gives p + 2
    consecutive rows: A, B and the mixed points. `count` should be a power of 2."""
    from scipy.stats import qmc
    both = qmc.Sobol(2 * parameters, scramble=True, seed=seed).random(count)
    a, b = both[:, :parameters], both[:, parameters:]
    points = np.repeat(a[:, None, :], parameters + 2, axis=1)
    points[:, 1] = b
    for i in range(parameters):
        points[:, 2 + i, i] = b[:, i]
    return points.reshape(-1, parameters)


def _estimate(values: Array) -> tuple[Array, Array]:
    """Computes indices (..., p) from values (..., N, p + 2)."""
    a, b, mixed = values[..., :1], values[..., 1:2], values[..., 2:]
    both = np.concatenate([a, b], axis=-1)
    mean = both.mean(axis=(-2, -1), keepdims=True)    # subtract the mean, because it would increase the error of the first-order formula
    variance = both.var(axis=(-2, -1))[..., None]
    with np.errstate(invalid="ignore", divide="ignore"):    # a constant result has undefined (NaN) indices
        first = ((b - mean) * (mixed - a)).mean(axis=-2) / variance
        total = 0.5 * ((a - mixed) ** 2).mean(axis=-2) / variance
    return first, total


def _interval(drawn: Array) -> Array:
    """Returns the limits (p, 2) of the confidence intervals, given the indices (samples, p) of bootstrap samples."""
    drawn = np.where(np.isfinite(drawn), drawn, np.nan)
    enough = np.isnan(drawn).mean(axis=0) <= 0.1
    limits = np.nanpercentile(np.where(enough, drawn, 0.0), (2.5, 97.5), axis=0).T
    return np.where(enough[:, None], limits, np.nan)


def indices(values: npt.ArrayLike, parameters: int, resamples: int = 500, seed: int = 0) -> Indices:
    """Computes the indices from the function's values (count (p + 2),) at the points of `design`. If a value is not finite, all p + 2 values for its Sobol
    point are left out. The intervals are percentiles over `resamples` bootstrap samples of the N points. They are NaN if the index is undefined in more
    than a tenth of the samples, for example because all values are equal."""
    table = np.asarray(values, np.float64).reshape(-1, parameters + 2)
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 2:
        nothing = np.full(parameters, np.nan)
        return Indices(nothing, nothing, np.full((parameters, 2), np.nan), np.full((parameters, 2), np.nan))
    first, total = _estimate(table)
    random = np.random.default_rng(seed)
    drawn = [_estimate(table[random.integers(0, len(table), len(table))]) for _ in range(resamples)]
    return Indices(first, total, *(_interval(np.array(kind)) for kind in zip(*drawn)))
