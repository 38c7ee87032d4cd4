"""The judge: certify(problem, estimate) sees no solver, only the answer."""

from __future__ import annotations

import numpy as np

from certpgo import spectral
from certpgo.certify.bounds import Bounds, bounds
from certpgo.certify.case import ATOL, RTOL, Basin, Case
from certpgo.certify.certificate import Certificate, Tier
from certpgo.errors import NumericalError
from certpgo.estimate import Estimate
from certpgo.problem import Problem


def certify(
    problem: Problem,
    estimate: Estimate,
    *,
    tier: Tier | str = Tier.STANDARD,
    rtol: float = RTOL,
    atol: float = ATOL,
    refine: bool = True,
) -> Certificate:
    """Judge an estimate against the best possible one.

    The lower bound belongs to the problem, not to the estimate: a copy is refined to a stationary
    point, the bound is taken from there (and, failing that, from a spectral start), and the
    estimate as given is judged against it.

    Parameters
    ----------
    tier : ``"standard"``, or ``"screen"``, which never yields CERTIFIED
    rtol, atol : CERTIFIED means gap <= rtol F + atol W
    refine : False takes the bound from the estimate's own multipliers, and tries nothing else

    Raises
    ------
    InputError
        An estimate of another graph, tolerances that are negative or not finite, or weights beyond
        the range of doubles.
    """
    case = Case.of(problem, tier, rtol, atol)
    problem.check(estimate)
    with np.errstate(over="ignore", invalid="ignore"):  # infinite costs are judged, not warned of
        own, other = case.basin(estimate, refine), None
        if refine and own.cost - own.value > case.tolerance(own.cost):
            other = _other_basin(case)
        return case.certificate(estimate, own, other, _bounds(case.problem, own.point))


def _other_basin(case: Case) -> Basin:
    """What descent from the eigenvectors reaches."""
    try:
        start = spectral.spectral_start(case.problem)
    except (NumericalError, np.linalg.LinAlgError):
        n, d = case.problem.n, case.problem.d
        start = Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))
    return case.basin(start, True)


def _bounds(problem: Problem, point: Estimate) -> Bounds | None:
    try:
        return bounds(problem.rotation, point)
    except (NumericalError, np.linalg.LinAlgError):
        return None
