"""The result of trocar-fit."""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass
class Estimate:
    """An estimated parameter, with its 95 % confidence interval."""

    key: str
    unit: str
    value: float
    low: float
    high: float
    start: float
    at_bound: bool = False
    determined: bool = True    # false if the data do not determine the parameter


@dataclass
class Fitted:
    """The result of a fit."""

    estimates: list[Estimate]
    correlations: Array         # (p, p) correlations of the estimates
    chi2: float                 # sum over the data of (residual / standard deviation)^2
    freedom: int                # number of data points minus number of parameters
    converged: bool
    simulations: int            # how many times the full set of recordings was simulated
    warnings: list[str] = field(default_factory=list)
    predicted: list[list[Array]] = field(default_factory=list)    # for each recording and channel, the predicted means over the averaging intervals
