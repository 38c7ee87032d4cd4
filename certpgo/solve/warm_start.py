"""The two ways to an optimum with its certificate: descent from the last one, and a new search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from certpgo.certify import Certificate, Tier
from certpgo.certify.dual import DualBound
from certpgo.certify.local_minimum import LocalMinimum
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.tolerances import allowed
from certpgo.certify.units import scaled_down, scaled_up
from certpgo.certify.verdict import verdict
from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.manifolds import sum_of
from certpgo.objective.plain_graph import PlainGraph
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


def descended(problem: Quadratic | Sum, start: Estimate, settings: SolveSettings) -> Found | None:
    """The end of descent from an estimate, if that is certified."""
    tier = settings.tier or Tier.STANDARD
    if isinstance(problem, Quadratic) and tier is Tier.STANDARD and PlainGraph.is_plain(problem):
        found = _at_once(problem, start, settings)
        if found is not None:
            return found
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


def _at_once(problem: Quadratic, start: Estimate, settings: SolveSettings) -> Found | None:
    """The same by compiled code, in two calls."""
    graph = PlainGraph(problem)
    end = graph.settled(start, max(ENOUGH, settings.newton.enough))
    proven = None if end is None else graph.proven(*end)
    if end is None or proven is None:
        return None
    point, multipliers = end
    cost, value = problem.enclosure(point)[1], sum_of(_diagonals(proven))
    if not cost - value <= allowed(cost, settings.rtol, settings.atol * problem.scale):
        return None

    def judged() -> Certificate:
        normalized = NormalizedProblem.of(problem, Tier.STANDARD, settings.rtol, settings.atol)
        less, form = 1.0 / normalized.unit, normalized.problem
        shift = less * float((_diagonals(multipliers) - _diagonals(proven)).max())
        nonzeros = int(form.symbolic(form.matrix).lengths.sum())
        attained = form.cost(point)
        bound = DualBound(less * value, less * proven, form, shift, 1, nonzeros, attained=attained)
        return verdict(normalized, point, LocalMinimum(point, less * cost, True, bound))

    return Found(point, cost, value, judged)


def _diagonals(multipliers: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nii->ni", multipliers))


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
