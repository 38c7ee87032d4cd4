"""The judge: certify(problem, estimate) sees no solver, only the answer."""

from __future__ import annotations

import numpy as np

from certpgo.certify.bounds import Bounds, bounds
from certpgo.certify.case import ATOL, RTOL, Basin, Case
from certpgo.certify.certificate import Certificate, Tier
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.objective.base import Objective
from certpgo.objective.problem import Problem
from certpgo.optimize import spectral


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
    problem : the measurements with their weights, which say what F is
    estimate : n poses or rotations in the graph's order and units, whoever made them
    tier : ``"standard"``, ``"proof"``, which trusts no factorization, or ``"screen"``, which never
        yields CERTIFIED
    rtol, atol : CERTIFIED means gap <= rtol F + atol W
    refine : False takes the bound from the estimate's own multipliers, and tries nothing else

    Raises
    ------
    InputError
        An estimate of another graph, tolerances that are negative or not finite, or weights beyond
        the range of doubles.

    Examples
    --------
    A cycle that closes but for 0.3 radians, and the stationary point that turns once around with
    it. Descent cannot leave that one, and yet it is not the best:

    >>> from certpgo import RotationProblem, certify
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(9, 0.3, 1)
    >>> problem = RotationProblem(instance.graph)
    >>> certificate = certify(problem, around)
    >>> certificate.verdict.value, problem.cost(certificate.better) < problem.cost(around)
    ('REFUTED', True)
    >>> certify(problem, instance.truth).verdict.value
    'CERTIFIED'
    """
    return Judge(problem, tier=tier, rtol=rtol, atol=atol, refine=refine).certify(estimate)


class Judge:
    """`certify` for many estimates of one problem, which shares what is proven about it.

    Where descent reaches a point that a lower bound known already certifies, no other is computed.

    Parameters
    ----------
    problem, tier, rtol, atol, refine : as for `certify`
    """

    def __init__(
        self,
        problem: Problem,
        *,
        tier: Tier | str = Tier.STANDARD,
        rtol: float = RTOL,
        atol: float = ATOL,
        refine: bool = True,
    ) -> None:
        if not isinstance(problem, Objective):
            raise InputError(
                "a PoseProblem(graph) or RotationProblem(graph) is judged, not a "
                f"{type(problem).__name__}"
            )
        self._problem, self._refine = problem, refine
        self._case = Case.of(problem, tier, rtol, atol)
        self._best: Basin | None = None
        self._spectral: Basin | None = None

    def certify(self, estimate: Estimate) -> Certificate:
        """Judge one estimate.

        Raises
        ------
        InputError
            An estimate of another graph.
        """
        case = self._case
        self._problem.check(estimate)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite costs are judged, not warned
            own, other = case.basin(estimate, self._refine, self._best), None
            if self._refine and not case.is_sharp(own):
                other = self._elsewhere()
            for basin in (own, other):
                if basin is not None and (self._best is None or basin.value > self._best.value):
                    self._best = basin
            return case.certificate(estimate, own, other, _bounds(case.problem, own.point))

    def _elsewhere(self) -> Basin:
        """A basin known to be the best, or what descent from the eigenvectors reaches."""
        if self._best is not None and self._case.is_sharp(self._best):
            return self._best
        if self._spectral is None:
            self._spectral = self._case.basin(_spectral_start(self._case.problem), True)
        return self._spectral


def _spectral_start(problem: Problem) -> Estimate:
    try:
        return spectral.spectral_start(problem)
    except (NumericalError, np.linalg.LinAlgError):
        n, d = problem.n, problem.d
        return Estimate(np.tile(np.eye(d), (n, 1, 1)), np.zeros((n, d)))


def _bounds(problem: Problem, point: Estimate) -> Bounds | None:
    try:
        return bounds(problem.rotation, point)
    except (NumericalError, np.linalg.LinAlgError):
        return None
