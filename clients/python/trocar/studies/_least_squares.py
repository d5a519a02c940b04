"""Nonlinear least squares, with the covariance of the solution, for models that are expensive and not perfectly smooth. Evaluations run in parallel."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
# Returns the residuals (n,) at each of several points (p,), or None where they cannot be computed.
Evaluate = Callable[[Sequence[Array]], list[Array | None]]

# Simulations are not perfectly smooth: a small change to a parameter can move an event, such as the tip entering the next element, to a different tick, and
# then some residuals jump. Finite differences therefore need steps that change the residuals by much more than a jump, and the search must be able to
# cross jumps.
FIRST_STEP = 0.01     # initial finite-difference step, as a fraction of a parameter's range
STEPS = (0.002, 0.1)     # smallest and largest finite-difference step
CHANGE = 10.0         # desired norm of the change in the residuals over one finite-difference step
JUMP = 10.0           # to cross a jump, the search accepts an increase in chi squared of up to this much
MOST_RISES = 5        # maximum number of such increases
SMALL = 0.02          # a step is not worth taking if it should lower chi squared by less than this (a seventh of a standard error)
WORTH = 0.25          # decrease in chi squared that counts as progress: half a standard error
IDLE = 5              # give up after this many steps without progress: the residuals jump, and no Jacobian describes them
MOST_STEPS = 60


@dataclass
class Solution:
    """Where the search ended. Points are scaled: each parameter is 0 at its lower bound and 1 at its upper bound."""

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


class _Differences:
    """Computes Jacobians by finite differences, for scaled points."""

    def __init__(self, evaluate: _Counted, count: int):
        self.evaluate, self.steps = evaluate, np.full(count, FIRST_STEP)

    def _at(self, point: Array, signs: Array, chosen: Sequence[int]) -> list[Array | None]:
        points = []
        for i in chosen:
            moved = point.copy()
            moved[i] += signs[i] * self.steps[i]
            points.append(moved)
        return self.evaluate(points) if points else []

    def one_sided(self, point: Array, residuals: Array) -> Array:
        """Returns the Jacobian (n, p) by one-sided differences. Steps towards the middle of a parameter's range or, if the residuals cannot be computed
        there, away from it; a column is 0 if neither works. Adapts the step sizes."""
        every, signs = range(len(point)), np.where(point < 0.5, 1.0, -1.0)
        there = self._at(point, signs, every)
        failed = [i for i in every if there[i] is None]
        signs[failed] *= -1.0
        for i, other in zip(failed, self._at(point, signs, failed)):
            there[i] = other
        jacobian = np.zeros((len(residuals), len(point)))
        for i, found in enumerate(there):
            if found is not None:
                jacobian[:, i] = (found - residuals) / (signs[i] * self.steps[i])
        size = np.linalg.norm(jacobian, axis=0)
        self.steps = np.clip(CHANGE / np.maximum(size, 1e-300), *STEPS)
        return jacobian

    def central(self, point: Array, residuals: Array) -> Array:
        """Returns the Jacobian by central differences, falling back to one-sided ones at bounds and where the residuals can be computed on one side only."""
        jacobian = np.zeros((len(residuals), len(point)))
        every = range(len(point))
        sides = []
        for sign in (1.0, -1.0):
            signs = np.full(len(point), sign)
            inside = [i for i in every if 0.0 <= point[i] + sign * self.steps[i] <= 1.0]
            sides.append(dict(zip(inside, self._at(point, signs, inside))))
        for i in every:
            ahead, behind = sides[0].get(i), sides[1].get(i)
            width = self.steps[i] * ((ahead is not None) + (behind is not None))
            if width > 0.0:
                jacobian[:, i] = ((residuals if ahead is None else ahead) - (residuals if behind is None else behind)) / width
        return jacobian


def _bounded_step(jacobian: Array, residuals: Array, point: Array, damping: float) -> Array:
    """Returns the Levenberg-Marquardt step (Marquardt 1963) within the bounds: the solution of a bounded linear least-squares problem, found by an
    active-set method in which the active set is the parameters at a bound (Nocedal and Wright 2006, section 16.5)."""
    size, low, high = np.sum(jacobian ** 2, axis=0), -point, 1.0 - point
    matrix = np.concatenate([jacobian, np.diag(np.sqrt(damping * np.maximum(size, 1e-9 * size.max() + 1e-300)))])
    target = np.concatenate([-residuals, np.zeros(len(point))])
    side = np.zeros(len(point))    # -1 or 1 for a parameter at its lower or upper bound
    step = np.zeros(len(point))
    for _ in range(4 * len(point)):
        free = side == 0.0
        step = np.where(side < 0.0, low, np.where(side > 0.0, high, 0.0))
        if free.any():
            step[free] = np.linalg.lstsq(matrix[:, free], target - matrix @ step, rcond=1e-12)[0]
        outside = free & ((step < low) | (step > high))
        if outside.any():
            side[outside] = np.where(step < low, -1.0, 1.0)[outside]
            continue
        inward = -side * (matrix.T @ (target - matrix @ step))    # how fast the sum of squares falls as a parameter moves off its bound
        if inward.max() <= 0.0:
            break
        side[np.argmax(inward)] = 0.0
    return np.clip(step, low, high)


def _fall(jacobian: Array, residuals: Array, step: Array) -> float:
    """Returns how much a step should lower chi squared according to the Jacobian."""
    return float(residuals @ residuals - np.sum((residuals + jacobian @ step) ** 2))


def minimise(evaluate: Evaluate, start: Array) -> Solution:
    """Minimises the sum of squared residuals over scaled points (p,) by the Levenberg-Marquardt method. As each column of a finite-difference Jacobian
    costs a simulation, the Jacobian is mostly updated with Broyden's formula instead (Broyden 1965). Residuals must be divided by their standard
    deviations, because the search ends when a step should lower chi squared by less than SMALL. Raises ValueError if the residuals cannot be computed at
    the start."""
    counted = _Counted(evaluate)
    differences = _Differences(counted, len(start))
    point = np.array(start, np.float64)
    residuals = counted([point])[0]
    if residuals is None:
        raise ValueError("no residuals at the start")
    jacobian, damping, rises, converged = differences.one_sided(point, residuals), 1e-3, 0, False
    moved, idle, renewed = np.zeros(len(point)), 0, False    # moved: change in `point` since the last finite-difference Jacobian
    best = point, residuals
    for _ in range(MOST_STEPS):
        chi2, lowest = float(residuals @ residuals), float(best[1] @ best[1])
        scale = max(1.0, chi2 / max(len(residuals) - len(point), 1))
        fresh = float(np.linalg.norm(jacobian @ moved)) < CHANGE * np.sqrt(scale)
        left = _fall(jacobian, residuals, _bounded_step(jacobian, residuals, point, 0.0))    # how much chi squared can still be expected to fall
        if (fresh and left < SMALL * scale) or (renewed and idle >= IDLE):
            converged = True
            break
        if left < SMALL * scale or idle >= IDLE:
            point, residuals = best
            jacobian, moved, damping, idle, renewed = differences.one_sided(point, residuals), 0.0 * moved, min(damping, 1e-3), 0, True
            continue
        step = _bounded_step(jacobian, residuals, point, damping)
        there, expected = counted([point + step])[0], _fall(jacobian, residuals, step)
        after = np.inf if there is None else float(there @ there)
        gain = (chi2 - after) / max(expected, 1e-300)
        across = gain <= 1e-2 and rises < MOST_RISES and expected < JUMP * scale and after < lowest + JUMP * scale
        idle += 1
        if after < lowest - WORTH * scale:
            idle, renewed = 0, False
        if there is not None and (gain > 1e-2 or across):
            change = jacobian @ step
            if change @ change > CHANGE ** 2 * scale:
                jacobian = jacobian + np.outer(there - residuals - change, step) / (step @ step)
            rises += across
            point, residuals, moved = point + step, there, moved + step
            best = (point, residuals) if after < lowest else best
            damping = damping / 10.0 if gain > 0.5 else damping if gain > 0.1 else 4.0 * damping
        elif not fresh:
            jacobian, moved = differences.one_sided(point, residuals), 0.0 * moved
        else:
            damping = 10.0 * max(damping, 1e-4)
    point, residuals = best
    return Solution(point, residuals, differences.central(point, residuals), converged, counted.count)


def jacobian_at(evaluate: Evaluate, point: Array) -> Array:
    """Returns the Jacobian (n, p) at a point by central differences. Raises ValueError if the residuals cannot be computed there."""
    counted = _Counted(evaluate)
    differences = _Differences(counted, len(point))
    residuals = counted([point])[0]
    if residuals is None:
        raise ValueError("no residuals")
    differences.one_sided(point, residuals)    # only to adapt the step sizes
    return differences.central(point, residuals)


# ---- what the data determine ----------------------------------------------------------------------------------------------------------------


@dataclass
class Covariance:
    """The covariance of a solution, in terms of the scaled parameters."""

    matrix: Array                      # (p, p), with a very large variance in directions that the data do not determine
    directions: list[tuple[float, Array]]    # principal axes: (standard deviation as a fraction of the range, unit vector (p,)), least well determined first


def covariance(jacobian: Array) -> Covariance:
    """Returns the covariance (J^T J)^-1 of a least-squares solution whose residuals have unit variance, from the singular values of J."""
    _, values, rows = np.linalg.svd(jacobian, full_matrices=False)
    spreads = 1.0 / np.maximum(values, 1e-9)
    order = np.argsort(-spreads)
    return Covariance((rows.T * spreads ** 2) @ rows, [(float(spreads[k]), rows[k]) for k in order])
