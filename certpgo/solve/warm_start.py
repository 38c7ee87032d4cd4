"""The two ways to an optimum with its certificate: descent from the last one, and a new search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.certify import Certificate, Tier
from certpgo.certify.dual import DualBound, diagonals
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import allowed
from certpgo.certify.units import scaled_down, scaled_up
from certpgo.certify.verdict import verdict
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.objective.manifolds import sum_of
from certpgo.objective.plain_edges import PlainEdges, Settled
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
from certpgo.optimize.descent import polished
from certpgo.optimize.initialization import Start
from certpgo.optimize.solution import Status
from certpgo.solve import bounding
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.settings import SolveSettings

#: Share of F that a descent from the last optimum leaves, a tenth of what batches differ by.
ENOUGH = 1e-10
#: Stationarity, radians, from which the exact Hessian is tried: the last optimum is not far.
NEAR = 0.1


@dataclass(eq=False)
class Found:
    """The end of a search, in the units of the graph; the certificate is made when asked for."""

    estimate: Estimate
    cost: float
    lower_bound: float
    judge: Callable[[], Certificate]

    @cached_property
    def certificate(self) -> Certificate:
        """What is proven about the estimate."""
        return self.judge()

    def __getstate__(self) -> dict[str, Any]:
        # What makes a certificate cannot be pickled, and is not needed once there is one.
        known = vars(self) | {"certificate": self.certificate}
        del known["judge"]
        return known


def descended(
    plain: PlainEdges | None,
    problem: Callable[[], Quadratic | Sum],
    start: Estimate,
    settings: SolveSettings,
    composed: int,
) -> Found | None:
    """The end of descent from an estimate, if that is certified.

    Parameters
    ----------
    plain : the graph of the ``problem``, if that is F and compiled code takes it
    composed : number of the first of the nodes whose poses were composed from measurements
    """
    enough = max(ENOUGH, settings.newton.enough)
    near = None if plain is None else plain.settled(start, enough, composed)
    found = None if near is None else _at_once(near, problem, settings)
    return found or _by_steps(problem(), start if near is None else near.estimate, settings)


def _by_steps(problem: Quadratic | Sum, start: Estimate, settings: SolveSettings) -> Found | None:
    tier = settings.tier or Tier.STANDARD
    normalized = NormalizedProblem.of(problem, tier, settings.rtol, settings.atol)
    newtons = settings.newton
    nearer = replace(newtons, enough=max(ENOUGH, newtons.enough), near=max(NEAR, newtons.near))
    try:
        end = polished(normalized.problem, start, nearer)
        cost = normalized.cost_upper(end)
        bound = bounding.bound_near(normalized, end, cost, sharp=False, tight=True)
    except (NumericalError, np.linalg.LinAlgError):
        return None
    minimum = LocalMinimum(end, cost, True, bound)
    if not normalized.is_closed(minimum):
        return None
    unit = normalized.unit
    return Found(
        end,
        scaled_up(unit, cost),
        scaled_down(unit, minimum.value),
        lambda: verdict(normalized, end, minimum),
    )


def _at_once(
    found: Settled, problem: Callable[[], Quadratic | Sum], settings: SolveSettings
) -> Found | None:
    """The same at the end of compiled code."""
    point, cost, multipliers, proven = found
    tier, rtol, atol = settings.tier or Tier.STANDARD, settings.rtol, settings.atol
    if proven is None or tier is not Tier.STANDARD:
        return None
    value = sum_of(diagonals(proven))
    if not cost - value <= allowed(cost, rtol, 0.0):
        return None

    def judged() -> Certificate:
        normalized = NormalizedProblem.of(problem(), tier, rtol, atol)
        less, form = 1.0 / normalized.unit, normalized.problem
        shift = less * float((diagonals(multipliers) - diagonals(proven)).max())
        nonzeros = int(form.symbolic(form.matrix).lengths.sum())
        proof = less * value, less * proven, form, shift, 1, nonzeros
        bound = DualBound(*proof, attained=form.cost(point))
        return verdict(normalized, point, LocalMinimum(point, less * cost, True, bound))

    return Found(point, cost, value, judged)


def searched(problem: Quadratic | Sum, settings: SolveSettings, start: Start | None) -> Found:
    """The end of the whole search of `certpgo.solve`; Ctrl-C ends it, and is passed on."""
    result = found_anew(problem, settings, start)
    if result.solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    proven = result.certificate
    return Found(result.estimate, proven.cost_upper, proven.lower_bound, lambda: proven)


def found_anew(
    problem: Quadratic | Sum, settings: SolveSettings, start: Start | None
) -> CertifiedSolution:
    """The answer of the whole search; that on F alone begins from an estimate."""
    return search(problem, settings, start if problem.is_chordal else None)
