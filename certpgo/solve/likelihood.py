"""Costs of the true poses under the stated noise, of which f is chi^2.

f at the truth exceeds the `quantile` with the complementary probability: that is exact. With one
pose at its true place and all others at their best, f exceeds its minimum by chi^2 of as many
degrees of freedom as a pose has: that is the likelihood ratio, and holds for small noise. Where
squares count twice, as under F in the plane, both are upper bounds.

So they are where kappa and tau average information: a term of F is at most 2 kappa |w|^2 +
tau |v|^2 for noise (w, v) of covariance Omega^-1, that is chi^2 times the largest eigenvalue of
diag(tau, 2 kappa) Omega^-1; what the nodes take up of it, a projection, is no larger.
"""

from __future__ import annotations

import numpy as np

from certpgo.errors import InputError, NumericalError, require_numbers
from certpgo.graph.kinds import Node
from certpgo.graph.phrases import cost_shown
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.rotations import tangent_dim
from certpgo.objective.choose_cost import CHORDAL, Certifiable

#: Probability of regions, unless another one is asked for.
LEVEL = 0.95
#: Least eigenvalue of information, its diagonal scaled to one, that is not a direction left open.
SINGULAR = 1e-13
#: Relative rounding of weights that average information.
SAME = 1e-9


def excesses(problem: Certifiable, level: float) -> FloatArray:
    """(n,) what f with one node at its true place is above its minimum, with this probability.

    Infinite where the noise of what the cost weighs is not stated.

    Raises
    ------
    InputError
        The cost is no chi^2, as over similarities, or the level is no probability.
    """
    each = quantiles_of_nodes(problem, level)
    return np.asarray(_counted(problem).max() * each)


def quantiles_of_nodes(problem: Certifiable, level: float) -> FloatArray:
    """(n,) of chi^2 with as many degrees of freedom as a node has.

    Raises
    ------
    InputError
        As for `excesses`.
    """
    _require(problem, level)
    d, is_point = problem.d, problem.graph.nodes == Node.POINT
    turned, moved = tangent_dim(d), d if problem.graph.has_positions else 0
    degrees = np.where(is_point, moved, moved + turned)
    return _quantile(degrees, 1.0 - level)


def quantile(problem: Certifiable, level: float) -> float:
    """What f at the truth is at most, with this probability.

    Raises
    ------
    InputError
        As for `excesses`.
    """
    _require(problem, level)
    turned, moved = problem.numbers
    counted, twice = _counted(problem), problem.double > 1
    if (counted > problem.double).any():
        return float(counted.max() * _quantile(int((turned + moved).sum()), 1.0 - level))
    once, doubled = int((moved + np.where(twice, 0, turned)).sum()), int(turned[twice].sum())
    if not doubled:
        return float(_quantile(once, 1.0 - level))
    # Of two upper bounds: either part is larger with half the probability, or all count twice.
    half = 0.5 * (1.0 - level)
    apart = 2.0 * _quantile(doubled, half) + (_quantile(once, half) if once else 0.0)
    return float(min(apart, 2.0 * _quantile(once + doubled, 1.0 - level)))


def excess_of_truth(problem: Certifiable, level: float, cost: float, bound: float) -> float:
    """By how much that `quantile` is above a cost.

    Raises
    ------
    NumericalError
        No estimate costs as little.
    """
    most = quantile(problem, level)
    if most < bound:
        raise NumericalError(
            f"no estimate costs less than {cost_shown(bound)}, and the true poses at most "
            f"{cost_shown(most)} with probability {level:g}: the noise is not as stated"
        )
    return most - cost


def _counted(problem: Certifiable) -> FloatArray:
    """(m,) what squares of standard normal variables count in the cost of each row, at most.

    Infinite where F weighs what the information does not state.
    """
    counted, graph = problem.double.astype(np.float64), problem.chordal.graph
    information = problem.measured.information
    if information is None or problem.cost_name != CHORDAL:
        return counted
    m, d = len(information.index), problem.d
    Omega = information.about_tangents().matrices
    weights = np.zeros(Omega.shape[:2])
    weights[:, :d] = graph.tau[:m, None] if graph.has_positions else 0.0
    weights[:, d:] = 2.0 * graph.kappa[:m, None]
    weights[~graph.is_measured[:m]] = 0.0  # constraints are met
    stated = np.einsum("maa->ma", Omega) > 0.0
    rows = np.arange(Omega.shape[1])
    Omega = np.where(stated[:, :, None] & stated[:, None, :], Omega, 0.0)
    Omega[:, rows, rows] += ~stated
    size = np.sqrt(np.einsum("maa->ma", Omega))
    correlated = Omega / (size[:, :, None] * size[:, None, :])
    known = (stated | (weights == 0.0)).all(axis=1)
    known &= np.linalg.eigvalsh(correlated)[:, 0] > SINGULAR
    most, ratio = np.where(weights.any(axis=1), np.inf, 0.0), np.sqrt(weights) / size
    inverse = np.linalg.inv(correlated[known])
    spread = ratio[known][:, :, None] * inverse * ratio[known][:, None, :]
    most[known] = np.linalg.eigvalsh(spread)[:, -1]
    # Averages of multiples of the identity are these, but for rounding.
    own = counted[:m]
    counted[:m] = np.where(most > (1.0 + SAME) * own, most, own)
    return counted


def _require(problem: Certifiable, level: float) -> None:
    require_numbers(level=level)
    if problem.takes_scales or problem.kernel is not None:
        raise InputError(f"{problem.title} is no chi^2: give an excess, and no level")


def _quantile(degrees: FloatArray | int, rest: float) -> FloatArray:
    """What chi^2 exceeds with probability ``rest``."""
    from scipy import special

    return np.asarray(2.0 * special.gammainccinv(0.5 * np.asarray(degrees), rest))
