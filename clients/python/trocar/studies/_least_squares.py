"""Nonlinear least squares for a model whose evaluation is expensive, parallel and not perfectly smooth, with the covariance of the solution."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# Returns the residuals (n,) at each of several points (p,), or None where they cannot be computed.
Evaluate = Callable[[Sequence[Array]], list[Array | None]]

STEP = 0.005          # finite difference, as a fraction of the range of a parameter
SMALL = 0.01          # decrease of chi squared that is not worth a step: a tenth of a standard error
MOST_STEPS = 60
MOST_DAMPING = 1e6


@dataclass
class Solution:
    """The point at which the search ended. Points are scaled: each parameter goes from 0 to 1 between its bounds."""

    point: Array          # (p,)
    residuals: Array      # (n,)
    jacobian: Array       # (n, p) derivatives of the residuals, by central differences
    converged: bool
    evaluations: int


class _Counted:
    def __init__(self, evaluate: Evaluate):
        self.evaluate, self.count = evaluate, 0

    def __call__(self, points: Sequence[Array]) -> list[Array | None]:
        self.count += len(points)
        return self.evaluate(points)


def _moved(point: Array, index: int, by: float) -> Array:
    moved = point.copy()
    moved[index] += by
    return moved


def _one_sided(evaluate: _Counted, point: Array, residuals: Array, signs: Array) -> tuple[Array, list[Array | None]]:
    """Returns the Jacobian by one-sided differences, and the residuals at the points that were moved. A parameter is moved in the direction of its
    sign, or to the other side if the residuals cannot be computed there. The column is 0 if they can be computed on neither side."""
    found = evaluate([_moved(point, i, STEP * sign) for i, sign in enumerate(signs)])
    failed = [i for i, there in enumerate(found) if there is None]
    other = evaluate([_moved(point, i, -STEP * signs[i]) for i in failed]) if failed else []
    steps = STEP * signs
    columns = list(found)
    for i, there in zip(failed, other):
        steps[i], columns[i] = -steps[i], there
    jacobian = np.stack([(there - residuals) / step if there is not None else np.zeros_like(residuals) for there, step in zip(columns, steps)], axis=1)
    return jacobian, found


def _inward(point: Array) -> Array:
    return np.where(point < 0.5, 1.0, -1.0)


def _bounded_step(jacobian: Array, residuals: Array, point: Array, damping: float) -> Array:
    """Returns the step of Levenberg and Marquardt (Marquardt 1963) within the bounds. Parameters that the step would push out of the range stay at
    their bound, and the step is solved again for the others."""
    free = np.ones(len(point), bool)
    scale = np.sum(jacobian ** 2, axis=0)
    weight = np.sqrt(damping * np.maximum(scale, 1e-9 * scale.max() + 1e-300))
    while True:
        step = np.zeros(len(point))
        matrix = np.concatenate([jacobian, np.diag(weight)])[:, free]
        step[free] = np.linalg.lstsq(matrix, np.concatenate([-residuals, np.zeros(len(point))]), rcond=1e-12)[0]
        outward = free & ((point <= 0.0) & (step < 0.0) | (point >= 1.0) & (step > 0.0))
        if not outward.any():
            return np.clip(point + step, 0.0, 1.0) - point
        free &= ~outward
        if not free.any():
            return np.zeros(len(point))


def minimise(evaluate: Evaluate, start: Array) -> Solution:
    """Minimises the sum of squares of the residuals over points (p,) between 0 and 1, by the method of Levenberg and Marquardt. Between Jacobians by
    finite differences, the Jacobian is updated by Broyden's formula (Broyden 1965), because each column costs a simulation. Residuals must be
    divided by their standard deviation: the search ends when a step would change chi squared by less than SMALL. Raises ValueError if the residuals cannot be computed at the start."""
    counted = _Counted(evaluate)
    point = np.array(start, np.float64)
    residuals = counted([point])[0]
    if residuals is None:
        raise ValueError("no residuals at the start")
    jacobian, forward = _one_sided(counted, point, residuals, _inward(point))
    fresh, damping, converged = True, 1e-3, False
    for _ in range(MOST_STEPS):
        chi2, freedom = float(residuals @ residuals), max(len(residuals) - len(point), 1)
        enough = SMALL * max(1.0, chi2 / freedom)
        undamped = _bounded_step(jacobian, residuals, point, 0.0)
        if chi2 - float(np.sum((residuals + jacobian @ undamped) ** 2)) < enough:
            if fresh:
                converged = True
                break
            jacobian, forward = _one_sided(counted, point, residuals, _inward(point))
            fresh, damping = True, min(damping, 1e-3)
            continue
        step = _bounded_step(jacobian, residuals, point, damping)
        expected = chi2 - float(np.sum((residuals + jacobian @ step) ** 2))
        there = counted([point + step])[0]
        gain = -1.0 if there is None else (chi2 - float(there @ there)) / max(expected, 1e-300)
        if there is not None and gain > 1e-2:
            jacobian = jacobian + np.outer(there - residuals - jacobian @ step, step) / (step @ step)
            point, residuals, fresh = point + step, there, False
            damping = damping / 10.0 if gain > 0.5 else damping * (1.0 if gain > 0.1 else 4.0)
        elif not fresh:
            jacobian, forward = _one_sided(counted, point, residuals, _inward(point))
            fresh = True
        else:
            damping = 10.0 * max(damping, 1e-4)
        if damping > MOST_DAMPING:    # the residuals jump near the minimum: no step is small enough for the Jacobian to describe it
            break
    if not fresh:
        jacobian, forward = _one_sided(counted, point, residuals, _inward(point))
    return Solution(point, residuals, _central(counted, point, residuals, jacobian, forward), converged, counted.count)


def _central(evaluate: _Counted, point: Array, residuals: Array, jacobian: Array, forward: list[Array | None]) -> Array:
    """Returns the Jacobian by central differences where both sides can be computed, with the one-sided differences that are known already."""
    signs = _inward(point)
    inside = [i for i, there in enumerate(forward) if there is not None and 0.0 <= point[i] - STEP * signs[i] <= 1.0]
    backward = evaluate([_moved(point, i, -STEP * signs[i]) for i in inside]) if inside else []
    found = jacobian.copy()
    for i, there in zip(inside, backward):
        ahead = forward[i]
        if there is not None and ahead is not None:
            found[:, i] = (ahead - there) / (2.0 * STEP * signs[i])
    return found


# ---- what the data determine ----------------------------------------------------------------------------------------------------------------


@dataclass
class Covariance:
    """Of a solution, in scaled parameters."""

    matrix: Array                      # (p, p); directions that the data do not determine have the spread of the range
    directions: list[tuple[float, Array]]    # (standard deviation as a fraction of the range, unit vector (p,)), worst first


def covariance(jacobian: Array) -> Covariance:
    """Returns the covariance (J^T J)^-1 of a least-squares solution whose residuals have unit variance, from the singular values of J."""
    _, values, rows = np.linalg.svd(jacobian, full_matrices=False)
    spreads = 1.0 / np.maximum(values, 1e-9)
    order = np.argsort(-spreads)
    return Covariance((rows.T * spreads ** 2) @ rows, [(float(spreads[k]), rows[k]) for k in order])
