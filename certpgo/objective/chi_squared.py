"""Quantiles of the terms of a cost under the noise that the weights state.

A measurement contributes the square of a standard normal variable for each number it measures, with
one exception: in the plane kappa |E|^2 is 2 kappa times the squared angle, and kappa is the angle's
information. That square counts twice, and the law of a pose is that of 2 z0^2 + z1^2 + z2^2:

    P(2 z0^2 + z1^2 + z2^2 > 4 y^2) = erfc(y) + 2 / sqrt(pi) exp(-y^2) D(y),   D Dawson's function,

by integrating exp(-(4 y^2 - 2 z^2) / 2), what z1^2 + z2^2 leave, over z.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from certpgo.linalg.arrays import FloatArray
from certpgo.objective.objective import Objective

#: Share of clean graphs in which a correct measurement may be flagged.
FALSE_ALARMS = 0.01


def flagged_from(problem: Objective) -> float:
    """The quantile that few clean graphs have a correct measurement beyond: 1 - 0.01 / m."""
    return 1.0 - FALSE_ALARMS / float(problem.chordal.graph.num_measurements)


def quantiles(problem: Objective, probability: float) -> FloatArray:
    """(m,) quantiles of a correct measurement's term, if the weights state its noise."""
    return exceeded_by(problem, 1.0 - probability)


def exceeded_by(problem: Objective, share: float) -> FloatArray:
    """(m,) what the terms of this share of correct measurements exceed, to rounding.

    Zero for what measures nothing.
    """
    columns = (*problem.numbers, problem.double)
    shape = tuple(int(column.max()) + 1 for column in columns)
    kind = np.ravel_multi_index(columns, shape)
    of_kinds = np.zeros(math.prod(shape))
    for one in np.flatnonzero(np.bincount(kind)).tolist():
        turned, moved, weight = (int(k) for k in np.unravel_index(one, shape))
        of_kinds[one] = _exceeded(turned, moved, weight, share)
    return np.asarray(of_kinds[kind])


@lru_cache
def _exceeded(turned: int, moved: int, weight: int, share: float) -> float:
    """What ``turned`` squares, times ``weight``, and ``moved`` others exceed with this chance."""
    from scipy import special

    if turned + moved == 0:
        return 0.0
    once = 2.0 * float(special.gammainccinv(0.5 * (turned + moved), share))
    if weight == 1 or turned == 0:
        return once
    if moved == 0 or not 0.0 < once < math.inf:
        return weight * once
    # Each square counts at least once and at most twice.
    least, most = math.sqrt(0.25 * once), math.sqrt(0.5 * once)
    log = math.log(share)
    if not _log_tail(least) > log > _log_tail(most):  # a share of almost all, to rounding
        return once
    while least < (y := 0.5 * (least + most)) < most:
        least, most = (y, most) if _log_tail(y) > log else (least, y)
    return 4.0 * y * y


def _log_tail(y: float) -> float:
    """The logarithm of P(2 z0^2 + z1^2 + z2^2 > 4 y^2)."""
    from scipy import special

    dawson = 2.0 / math.sqrt(math.pi) * special.dawsn(y)
    return float(np.log(special.erfcx(y) + dawson) - y * y)
