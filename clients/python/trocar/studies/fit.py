"""Fits a scene's parameters to recorded insertions: moduli, relaxation, stiffening, friction, cutting, puncture forces and the bevel.

A fit is a YAML file:

    scene: prostate.yaml                # relative to this file
    set: {inverse: sparse}              # scene keys to change; optional
    recordings:                         # each begins with the tissue at rest
      - {poses: poses.csv, forces: forces.csv, points: markers.csv}
      - {log: recording.lcm}            # LCM log: poses, and wrenches unless `forces` is given
    points:                             # rest positions (m) of the points in markers.csv
      apex: [0.0, 0.0, 0.07]
    noise: {force: 0.02, torque: 1e-3, position: 0.2e-3}    # standard deviation of one sample: N, N m, m
    every: 0.02                         # s, averaging interval for samples
    parameters:                         # scene keys to fit, with bounds
      regions[prostate].youngs_modulus: {within: [5e3, 200e3], start: 40e3}
      regions[prostate].friction.kinetic: {within: [1, 40], prior: [9, 3]}    # mean and standard deviation

Command line:

    trocar-fit run | check ...    --help says more; also python3 -m trocar.studies.fit
"""
from __future__ import annotations

import argparse
import os
import sys
from functools import partial
from pathlib import Path
from typing import Any, Callable, Sequence

import numpy as np
import numpy.typing as npt

from .. import Error, Model, Sim, __version__
from .._program import FAILED, ended, say, whole_number
from ._definition import BadStudy
from . import _fit_report as report
from ._fit_problem import BadFit, FitProblem, Unknown, read
from ._fit_result import Estimate, Fitted
from ._least_squares import Covariance, covariance, jacobian_at, minimise
from ._measurements import Channel, Recording
from ._runs import Pool

__all__ = ["BadFit", "Estimate", "FitProblem", "Fitted", "Unknown", "expected", "fit", "read", "simulate"]

Array = npt.NDArray[np.float64]

Z95 = 1.959964          # 97.5 % quantile of the normal distribution
WIDE = 0.5 / Z95        # with this standard deviation, as a fraction of the range, the 95 % interval is as wide as the range
CORRELATED = 0.9        # two parameters with an absolute correlation above this are hard to tell apart
FROM_PRIOR = 0.8        # if a parameter's standard deviation is more than this fraction of its prior's, the data have added little
MISFIT = 1.5            # if chi squared per degree of freedom is above this, the scene does not describe the data to within the noise
KEPT_MODELS = 4         # keep this many models, with their inverses, for later simulations


# ---- simulating -----------------------------------------------------------------------------------------------------------------------------


class _Models:
    """A cache of models of a problem's scene. Models with the same stiffness share an inverse."""

    def __init__(self, problem: FitProblem):
        self.problem = problem
        self.columns = [i for i in range(len(problem.unknowns)) if problem.is_stiffness(i)]
        self.bases: dict[bytes, Model] = {}    # models by stiffness, oldest first

    def base(self, values: Array) -> Model:
        """Returns a model that has the same stiffness as these parameter values. Raises Error."""
        stiffness = values[self.columns].tobytes()
        if stiffness not in self.bases:
            model = Model(self.problem.scene(values))
            while len(self.bases) >= KEPT_MODELS:
                del self.bases[next(iter(self.bases))]
            self.bases[stiffness] = model
        return self.bases[stiffness]

    def of(self, values: Array) -> Model:
        """Returns the model for these parameter values. Raises Error."""
        return self.base(values).derive(self.problem.scene(values))


def _run(problem: FitProblem, model: Model, recording: Recording) -> list[Array]:
    """Simulates a recording. Returns the value of each channel at each of its samples; positions of points are computed only once per averaging
    interval. Raises Error."""
    sim, dt = Sim(model), 1.0 / model.rate_hz
    poses = next(iter(recording.motion.play(sim, dt)))
    ticks = {id(channel): np.minimum(np.round(channel.at() / dt).astype(int), len(poses) - 1) for channel in recording.channels if channel.kind == "position"}
    outputs, places, done = [], {}, 0
    for stop in sorted({int(tick) for of_channel in ticks.values() for tick in of_channel} | {len(poses) - 1}):
        if stop + 1 > done:
            outputs.append(sim.run(poses[done:stop + 1], dt))
            done = stop + 1
        if ticks:
            field_ = sim.displacements()
            places[stop] = np.array(list(problem.points.values())) + np.einsum("kc,kci->ki", problem.weights, field_[model.tets[problem.tets]])
    wrench = {kind: np.concatenate([part[kind] for part in outputs]) for kind in ("force", "torque")}
    time, names, found = dt * np.arange(len(poses)), list(problem.points), []
    for channel in recording.channels:
        if channel.kind == "position":
            means = np.array([places[int(tick)][names.index(channel.point), channel.component] for tick in ticks[id(channel)]])
            found.append(np.repeat(means, channel.counts))
        else:
            found.append(np.interp(channel.times, time, wrench[channel.kind][:, channel.component]))
    return found


def simulate(problem: FitProblem, values: npt.ArrayLike) -> list[list[Array]]:
    """Returns the scene's prediction for each sample, by recording and channel, with the parameter values (p,). Raises Error."""
    given = np.asarray(values, np.float64)
    model = _Models(problem).of(given)
    return [_run(problem, model, recording) for recording in problem.recordings]


def _channels(problem: FitProblem) -> list[tuple[Recording, Channel]]:
    return [(recording, channel) for recording in problem.recordings for channel in recording.channels]


class _Residuals:
    """Evaluates the residuals at scaled points, in parallel processes. First come the residuals of the data (predicted minus measured, divided by the
    standard deviation), then those of the priors."""

    def __init__(self, problem: FitProblem, workers: int, progress: Callable[[int], None]):
        self.problem, self.workers, self.progress = problem, workers, progress
        self.models = _Models(problem)
        self.spreads = [channel.spreads(problem.noise[channel.kind], problem.noise["time"]) for _, channel in _channels(problem)]
        self.measured = [channel.means(channel.values) for _, channel in _channels(problem)]
        self.data = sum(len(part) for part in self.measured)
        self.why = ""    # reason why a simulation failed
        self.done = 0

    def predicted(self, scaled: Array) -> list[Array]:
        """Returns the predicted interval means of all channels. Raises Error."""
        model = self.models.of(self.problem.values(scaled))
        found = []
        for recording in self.problem.recordings:
            found += [channel.means(values) for channel, values in zip(recording.channels, _run(self.problem, model, recording))]
        return found

    def at(self, scaled: Array) -> Array:
        parts = [(there - measured) / spread for there, measured, spread in zip(self.predicted(scaled), self.measured, self.spreads)]
        priors = [(x - prior[0]) / prior[1] for x, prior in zip(scaled, map(Unknown.prior_scaled, self.problem.unknowns)) if prior]
        return np.concatenate([*parts, np.array(priors)])

    def _try(self, scaled: Array) -> tuple[list[float] | None, str]:
        try:
            return self.at(scaled).tolist(), ""
        except Error as error:
            if error.status in ("no memory", "system"):
                raise
            return None, " ".join(str(error).split())

    def __call__(self, points: Sequence[Array]) -> list[Array | None]:
        found: list[Array | None] = [None] * len(points)

        def finished(index: int, outcome: tuple[list[float] | None, str] | None, why: str) -> None:
            if outcome is None:
                raise Error(f"a simulation ended without a result ({why}), for lack of memory or because of a defect", "system")
            residuals, self.why = outcome[0], outcome[1] or self.why
            found[index] = None if residuals is None else np.array(residuals)
            self.done += 1
            self.progress(self.done)

        if self.workers == 1 or len(points) == 1:
            for index, point in enumerate(points):
                finished(index, self._try(point), "")
            return found
        pool = Pool(self.workers, finished, "trocar-fit")
        try:
            for index, point in enumerate(points):
                pool.start(index, lambda point=point: self._try(point))    # type: ignore[misc]
            pool.join()
        finally:
            pool.kill()
        return found


# ---- what the data say ----------------------------------------------------------------------------------------------------------------------


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _ambiguities(problem: FitProblem, found: Covariance) -> tuple[list[str], set[int]]:
    """Returns warnings about parameters that the data cannot tell apart, and the indices of parameters that the data do not determine."""
    keys, warnings = [unknown.key for unknown in problem.unknowns], list[str]()
    without: set[int] = set()
    for spread, direction in found.directions:
        if spread < WIDE:
            continue
        members = np.flatnonzero(np.abs(direction) > 0.3 * np.abs(direction).max())
        without.update(int(i) for i in members)
        if len(members) == 1:
            warnings.append(f"the data do not determine {keys[members[0]]}: fix it, give it a prior, or record a motion in which it matters")
            continue
        together = [f"{keys[i]} {'up' if direction[i] * direction[members[0]] > 0 else 'down'}" for i in members]
        warnings.append(f"the data cannot tell apart {_listed([keys[i] for i in members])}: {_listed(together)} together changes the prediction by less than the noise: "
                        "fix one of them, or give it a prior")
    deviations = np.sqrt(np.diag(found.matrix))
    correlations = found.matrix / np.outer(deviations, deviations)
    for i, j in zip(*np.triu_indices(len(keys), 1)):
        if abs(correlations[i, j]) > CORRELATED and not {int(i), int(j)} <= without:
            what = "ratio" if correlations[i, j] > 0 else "product"
            if not (problem.unknowns[i].logarithmic and problem.unknowns[j].logarithmic):
                what = "difference" if correlations[i, j] > 0 else "sum"
            warnings.append(f"{keys[i]} and {keys[j]} are hard to tell apart (correlation {correlations[i, j]:+.2f}): the data determine mainly their {what}")
    for i, unknown in enumerate(problem.unknowns):
        prior = unknown.prior_scaled()
        if prior and deviations[i] > FROM_PRIOR * prior[1]:
            warnings.append(f"{unknown.key}: the interval comes from the prior; the data add little")
    return warnings, without


def _estimates(problem: FitProblem, scaled: Array, found: Covariance, without: set[int]) -> list[Estimate]:
    estimates = []
    for i, unknown in enumerate(problem.unknowns):
        half = Z95 * float(np.sqrt(found.matrix[i, i]))
        low, high = (unknown.value(float(np.clip(scaled[i] + sign * half, 0.0, 1.0))) for sign in (-1.0, 1.0))
        estimates.append(Estimate(unknown.key, unknown.unit, unknown.value(float(scaled[i])), low, high, unknown.start, bool(scaled[i] <= 0.0 or scaled[i] >= 1.0),
                                  i not in without and half < 0.5))
    return estimates


def _misfits(problem: FitProblem, parts: Sequence[Array], reduced: float) -> list[str]:
    """Returns a list with a warning if the residuals (one array for each channel) are larger than the noise explains."""
    if reduced <= MISFIT:
        return []
    worst = max(range(len(parts)), key=lambda k: float(np.mean(parts[k] ** 2)))
    recording, channel = _channels(problem)[worst]
    at = channel.at()[int(np.argmax(np.abs(parts[worst])))]
    return [f"the scene does not describe the data within the noise: chi squared is {reduced:.1f} per degree of freedom; worst is {channel.name} of {recording.name}, "
            f"near {at:.2f} s. The intervals are widened, but they do not cover errors of the scene, such as its geometry"]


def _split(problem: FitProblem, residuals: Array) -> list[Array]:
    return np.split(residuals, np.cumsum([len(channel.first) for _, channel in _channels(problem)])[:-1])


def fit(problem: FitProblem, workers: int = 1, progress: Callable[[int], None] = lambda simulations: None) -> Fitted:
    """Estimates the parameters by least squares. The 95 % confidence intervals come from the Jacobian at the solution: 1.96 standard deviations either side
    of the value or, if the lower bound is above 0, of its logarithm. If chi squared exceeds its expectation, the intervals are widened by the square root
    of the ratio. workers: number of parallel processes. progress: called with the number of simulations so far. Raises BadFit if the scene cannot be
    simulated at the start values, and Error if out of memory."""
    evaluate = _Residuals(problem, workers, progress)
    try:
        solution = minimise(evaluate, problem.scaled(problem.start()))
    except ValueError:
        raise BadFit(f"{problem.path}: the start values cannot be simulated: {evaluate.why}: write other values") from None
    data = solution.residuals[:evaluate.data]
    freedom = max(len(data) - len(problem.unknowns), 1)
    chi2 = float(data @ data)
    jacobian = solution.jacobian.copy()
    jacobian[:evaluate.data] /= np.sqrt(max(1.0, chi2 / freedom))
    found = covariance(jacobian)
    warnings, without = _ambiguities(problem, found)
    estimates = _estimates(problem, solution.point, found, without)
    warnings += [f"{estimate.key} is at its {'lower' if estimate.value <= unknown.low else 'upper'} bound, {estimate.value:g}: widen the bounds, or fix it"
                 for estimate, unknown in zip(estimates, problem.unknowns) if estimate.at_bound]
    warnings += _misfits(problem, _split(problem, data), chi2 / freedom)
    if not solution.converged:
        warnings.append("the search ended before it converged: start nearer to the solution, narrow the bounds, or average over a longer time (every)")
    deviations = np.sqrt(np.diag(found.matrix))
    predicted = iter(part * spread + measured for part, spread, measured in zip(_split(problem, data), evaluate.spreads, evaluate.measured))
    return Fitted(estimates, found.matrix / np.outer(deviations, deviations), chi2, freedom, solution.converged, evaluate.done, warnings,
                  [[next(predicted) for _ in recording.channels] for recording in problem.recordings])


def expected(problem: FitProblem, workers: int = 1) -> Fitted:
    """Predicts the confidence intervals that a fit would give if the start values were true, with warnings about parameters that the recorded motions cannot
    tell apart. It does not use the measured values, so you can use it to plan an experiment. Raises BadFit, Error."""
    evaluate = _Residuals(problem, workers, lambda simulations: None)
    point = problem.scaled(problem.start())
    try:
        found = covariance(jacobian_at(evaluate, point))
    except ValueError:
        raise BadFit(f"{problem.path}: the start values cannot be simulated: {evaluate.why}: write other values") from None
    warnings, without = _ambiguities(problem, found)
    deviations = np.sqrt(np.diag(found.matrix))
    return Fitted(_estimates(problem, point, found, without), found.matrix / np.outer(deviations, deviations), float("nan"), evaluate.data - len(point), True,
                  evaluate.done, warnings)


# ---- the program ----------------------------------------------------------------------------------------------------------------------------

_say = partial(say, "trocar-fit")


def _warn(result: Fitted) -> None:
    for words in result.warnings:
        _say(f"warning: {words}")


def _fit(given: argparse.Namespace) -> int:
    if not given.no_plots:
        import matplotlib    # noqa: F401    report a missing package before the search rather than after it
    problem, out = read(given.fit), Path(given.out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadFit(f"{out}: cannot be created: {error.strerror}: choose another folder with --out") from error
    shown = 0

    def progress(simulations: int) -> None:
        nonlocal shown
        if not given.quiet and simulations >= shown + 10:
            shown = simulations
            _say(f"{simulations} simulations")

    result = fit(problem, given.workers or len(os.sched_getaffinity(0)), progress)
    print(report.table(result), end="")
    files = report.write(problem, result, out, not given.no_plots)
    print(", ".join(str(path) for path in files))
    _warn(result)
    return 0 if result.converged else 1


def _check(given: argparse.Namespace) -> int:
    problem = read(given.fit)
    channels = _channels(problem)
    print(f"{problem.path}: {len(problem.recordings)} recordings with {sum(len(channel.values) for _, channel in channels)} samples, "
          f"{sum(len(channel.first) for _, channel in channels)} means over {problem.every:g} s; {len(problem.unknowns)} parameters. Expected if the start values are true:\n")
    result = expected(problem, given.workers or len(os.sched_getaffinity(0)))
    print(report.table(result), end="")
    _warn(result)
    return 0


def _options() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="trocar-fit", description="Fits a scene's parameters, such as moduli, friction and relaxation, to recorded insertions, with 95 % "
                                     "confidence intervals, and names the parameters that the data cannot tell apart.",
                                     epilog="Exit status: 0, 1 if the search did not converge, 2 for bad input, 3 if something else failed, such as memory or a missing package.")
    parser.add_argument("--version", action="version", version=f"trocar-fit {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    def command(name: str, call: Any, words: str) -> argparse.ArgumentParser:
        added = commands.add_parser(name, help=words, description=words[0].upper() + words[1:] + ".")
        added.add_argument("fit", help="fit, a YAML file", metavar="FIT")
        added.add_argument("--workers", type=whole_number, help="simulations at a time (default: one for each processor)", metavar="N")
        added.set_defaults(call=call)
        return added

    added = command("run", _fit, "find the parameters, and write them as keys of a scene")
    added.add_argument("--out", default="fit", help="folder of the results (default: fit)", metavar="FOLDER")
    added.add_argument("--no-plots", action="store_true", help="write no picture")
    added.add_argument("--quiet", action="store_true", help="print no progress")
    command("check", _check, "check the fit, and print the intervals to expect at the start values")
    return parser


def _call(given: argparse.Namespace) -> int:
    try:
        status: int = given.call(given)
        return status
    except (BadStudy, Error) as error:
        _say(str(error))
        return FAILED if isinstance(error, Error) and error.status in ("no memory", "system") else 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the program; returns its exit status."""
    given = _options().parse_args(arguments)
    return ended("trocar-fit", lambda: _call(given), given.fit, "python3-yaml python3-matplotlib")


if __name__ == "__main__":
    from trocar.studies import fit as _imported  # classes in __main__ would differ from those that other modules import

    sys.exit(_imported.main())
