"""Certification of estimates, independent of the solver: certify(problem, estimate)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from certpgo.certify.bounds import Bounds, bounds
from certpgo.certify.certificate import Certificate, Tier, of_instance
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import ATOL, RTOL
from certpgo.certify.verdict import verdict
from certpgo.errors import InputError, NumericalError, require_numbers
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.accept_paths import AnyPath, estimated, measured
from certpgo.io.writing import AnyAnswer
from certpgo.linalg.arrays import IntArray
from certpgo.linalg.threads import one_thread
from certpgo.objective.choose_cost import Judged, objective_of
from certpgo.objective.truncated_cost import rejecting
from certpgo.optimize.monitor import Iteration, Monitor, silent
from certpgo.optimize.notebook import watched
from certpgo.optimize.progress import EarlyStopping
from certpgo.optimize.solution import Status
from certpgo.solve import bounding
from certpgo.solve.minima import elsewhere, local_minimum

if TYPE_CHECKING:
    from certpgo.objective.kernels import Kernel

#: Steps of an estimate's descent before one from another start begins; most descents take fewer.
FEW = 20
#: Steps, each as good as the last ones, within which that must reach a proven optimum from then on.
HOPE = 200.0
#: Number of these last steps: descents rest at saddles, some for more than twenty steps.
RECENT = 30


def certify(
    problem: Judged | Graph | Instance | AnyPath,
    estimate: Estimate | AnyAnswer | AnyPath,
    *,
    cost: str | None = None,
    kernel: Kernel | str | None = None,
    rejected: IntArray | None = None,
    quantile: float | None = None,
    tier: Tier | str = Tier.STANDARD,
    rtol: float = RTOL,
    atol: float = ATOL,
    refine: bool = True,
    angles: bool = False,
    time_limit: float | None = None,
    monitor: Monitor | None = None,
) -> Certificate:
    """Certify an estimate: prove how far it is from the optimum.

    The lower bound belongs to the problem, not to the estimate: it is computed at a stationary
    point refined from a copy (or else from a spectral initialization), and the cost of the estimate
    as given is compared with it.

    Parameters
    ----------
    problem : the measurements with their weights, which define F; or a graph, the instance that was
        read, or the path of its file
    estimate : n poses or rotations in the graph's order and units, from any source; or an answer of
        `certpgo.solve`, or the path of a file, see `certpgo.read_estimate`
    cost, kernel : the cost of a graph, an instance or a file, as in `certpgo.solve`
    rejected : (k,) indices of measurements that were rejected, as in ``solution.rejected`` of a
        robust answer. The certificate is then about the truncated cost, that of the others plus
        min(f_e, c_e) of each of these: CERTIFIED if no other estimate costs less, whichever of them
        it takes back
    quantile : of chi^2, their prices c_e; by default that from which measurements are rejected,
        1 - 0.01 / m. It is of the noise that the weights state; where a robust answer has estimated
        it, certify ``answer.rejection.problem``
    tier : ``"standard"``, ``"proof"``, which trusts no factorization, or ``"screen"``, which never
        yields CERTIFIED
    rtol, atol : CERTIFIED means gap <= rtol F + atol W, of which the latter is at most 0.001 F
    refine : if False, compute the bound only from the estimate's own multipliers
    angles : whether to compute the bounds on residual angles too, see `Certificate.bounds`
    time_limit : seconds after which the bound found so far is used, once the current step is
        finished
    monitor : is called with each iteration of the descents, and may stop the search for a bound

    Raises
    ------
    InputError
        An estimate of another graph, tolerances that are negative or not finite, or weights beyond
        the range of doubles.

    Examples
    --------
    A cycle with a closing error of 0.3 radians, and the stationary point that winds around once:
    descent cannot leave it, yet it is not optimal.

    >>> from certpgo import Quadratic, certify
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(9, 0.3, 1)
    >>> problem = Quadratic(instance.graph)
    >>> certificate = certify(problem, around)
    >>> certificate.verdict.value, problem.cost(certificate.better) < problem.cost(around)
    ('REFUTED', True)
    >>> certify(problem, instance.truth).verdict.value
    'CERTIFIED'
    """
    whole = posed = measured(problem)
    given = estimated(estimate, posed)
    if cost is not None or kernel is not None or isinstance(posed, Instance | Graph):
        posed = objective_of(posed, cost, kernel)
    if rejected is not None:
        posed = rejecting(posed, rejected, quantile)
    elif quantile is not None:
        raise InputError("a quantile is for rejected measurements, and none are given")
    with watched(monitor) as shown:
        judge = Judge(
            posed,
            tier=tier,
            rtol=rtol,
            atol=atol,
            refine=refine,
            angles=angles,
            time_limit=time_limit,
            monitor=shown,
        )
        found = judge.certify(given)
    return of_instance(found, whole, given) if isinstance(whole, Instance) else found


class Judge:
    """`certify` for many estimates of one problem, which share the bounds proven for it.

    If a known lower bound certifies the end of a descent, no other is computed. For one thread.

    Parameters
    ----------
    problem, tier, rtol, atol, refine, angles, monitor : as for `certify`
    time_limit : for each estimate
    ctrl_c : whether the first Ctrl-C only stops the search for a bound, like the monitor
    """

    def __init__(
        self,
        problem: Judged,
        *,
        tier: Tier | str = Tier.STANDARD,
        rtol: float = RTOL,
        atol: float = ATOL,
        refine: bool = True,
        angles: bool = False,
        time_limit: float | None = None,
        monitor: Monitor = silent,
        ctrl_c: bool = False,
    ) -> None:
        require_numbers(time_limit=time_limit)
        self._normalized = NormalizedProblem.of(problem, tier, rtol, atol, monitor)
        self._problem, self._refine, self._angles = problem, refine, angles
        self._time_limit, self._ctrl_c = time_limit, ctrl_c
        self._best: LocalMinimum | None = None
        self._other: LocalMinimum | None = None
        self._latest: LocalMinimum | None = None  # the other one of this estimate, if cut short
        self._raised = False  # whether that has its best bound

    @one_thread
    def certify(self, estimate: Estimate) -> Certificate:
        """Certify one estimate.

        Raises
        ------
        InputError
            An estimate of another graph.
        """
        normalized = self._normalized
        self._problem.check(estimate)
        self._latest = None
        limits = normalized.stop.within(self._time_limit, ctrl_c=self._ctrl_c)
        # No warnings for infinite costs.
        with np.errstate(over="ignore", invalid="ignore"), limits:
            own, other = self._minima(estimate)
            known = (one for one in (self._best, own, other) if one is not None)
            self._best = best = max(known, key=lambda one: one.value)
            if best.value > own.value:
                own = replace(own, bound=best.bound)
            angles = _bounds(normalized.problem, own.point) if self._angles else None
            return verdict(normalized, estimate, own, other, angles)

    @property
    def interrupted(self) -> bool:
        """Whether the monitor or Ctrl-C stopped work on the last estimate."""
        return self._normalized.stop.interrupted

    @property
    def ended_by(self) -> Status | None:
        """Why work on the last estimate was left out: the time limit, or the monitor or Ctrl-C."""
        return self._normalized.stop.cut

    def _minima(self, estimate: Estimate) -> tuple[LocalMinimum, LocalMinimum | None]:
        """The minimum near the estimate and, if that is not proven optimal, another one.

        The bounds that take most work are computed last, and at the lower minimum first.
        """
        normalized = self._normalized
        own = self._own(estimate)
        if not self._refine or normalized.is_sharp(own) or normalized.stop.should_stop():
            return own, None
        other = self._elsewhere()
        if other is None:
            return self._with_best_bound(own), None
        for lower in (own, other) if own.cost <= other.cost else (other, own):
            known, least = max(own.value, other.value), min(own.cost, other.cost)
            if known >= least - normalized.difference(least) or normalized.stop.should_stop():
                break
            if lower is own:
                own = self._with_best_bound(own)
            elif not self._raised:
                other = self._other = self._with_best_bound(other)
                self._raised = normalized.stop.cut is None
        return own, other

    def _own(self, estimate: Estimate) -> LocalMinimum:
        """The minimum near the estimate.

        A long descent is interrupted for one that begins elsewhere, and given up where that ends at
        a proven optimum which it cannot hope to reach.
        """
        normalized = self._normalized
        if not self._refine:
            return local_minimum(normalized, estimate, False, self._best)

        def of_few(iteration: Iteration) -> bool:
            return normalized.stop(iteration) or iteration.number >= FEW

        begun = local_minimum(
            normalized, estimate, True, self._best, of_few, may_rest=self._best is None
        )
        if begun.settled or normalized.stop.should_stop():
            return begun
        other, monitor = self._elsewhere(), None
        if other is not None and normalized.is_sharp(other):
            monitor = EarlyStopping(normalized.stop, other.cost, HOPE, RECENT)
        return local_minimum(normalized, begun.point, True, self._best, monitor)

    def _with_best_bound(self, minimum: LocalMinimum) -> LocalMinimum:
        """The minimum with a bound that takes more work; itself if that fails."""
        with suppress(NumericalError, np.linalg.LinAlgError):
            return bounding.raised(self._normalized, minimum)
        return minimum

    def _elsewhere(self) -> LocalMinimum | None:
        """A minimum known to be optimal, or the one reached without the estimate, if any."""
        if self._best is not None and self._normalized.is_sharp(self._best):
            return self._best
        if self._other is None and self._latest is not None:
            return self._latest
        if self._other is None:
            normalized = self._normalized
            found = elsewhere(normalized)
            if normalized.stop.cut is not None:
                self._latest = found
                return found
            self._other = found
        return self._other


def _bounds(problem: Judged, point: Estimate) -> Bounds | None:
    # They are about chordal costs with isotropic weights.
    if not problem.is_chordal or problem.chordal.graph.is_general:
        return None
    try:
        return bounds(problem.chordal.rotation, point)
    except (NumericalError, np.linalg.LinAlgError):
        return None
