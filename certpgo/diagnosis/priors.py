"""Priors and held nodes at wrong places: what the measurements cost with and without them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from certpgo.diagnosis.estimates import explains
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding, explained
from certpgo.errors import CertPGOError, NumericalError
from certpgo.graph import Estimate, Instance
from certpgo.graph.components import restricted
from certpgo.graph.kinds import PRIORS
from certpgo.graph.phrases import cost_shown, counted, few
from certpgo.objective.choose_cost import objective_of
from certpgo.optimize.descent import descend

#: Priors that are left out one by one, the costliest first.
TRIED = 3
#: Share of chi^2 that a prior which is wrong alone accounts for, even to first order.
HARDLY = 0.5
#: Strength of priors that contradict all else for no known cause, over that of costs, and at most.
WITHOUT_CAUSE, MOST = 0.5, 3.0


def found(examined: Examined) -> Iterator[Finding]:
    """Priors or held nodes without which the measurements cost far less."""
    instance = examined.instance
    world, fit = examined.world, examined.fit
    if instance.graph.has_scales or (fit is not None and not fit.is_unusually_large):
        return
    # What is left may leave nodes free.
    with suppress(CertPGOError, np.linalg.LinAlgError):
        if instance.held:
            yield from _held(examined)
        elif world is not None:
            yield from _priors(examined, world)


def _priors(examined: Examined, world: int) -> Iterator[Finding]:
    instance, best = examined.instance, examined.best
    rows = np.flatnonzero(instance.measurements.are(*PRIORS)[: instance.graph.num_edges])
    if len(rows) < 2:
        return
    examined.trying("prior-elsewhere")
    costs = examined.problem.edge_costs(examined.answer.estimate)
    costly = rows[np.argsort(-costs[rows], kind="stable")[:TRIED]]
    without = [(_without(examined, row), row) for row in costly.tolist()]
    alone = [(one, row) for one, row in without if one is not None and _explains(examined, one)]
    if len(alone) == 1:  # else each of several may be the wrong one
        [(cost, row)] = alone
        node = instance.named(int(instance.graph.edges[row, 1]))
        said = f"the prior of {node} contradicts all else: the map costs {cost_shown(cost)} "
        yield Finding(
            "prior-elsewhere",
            f"{said}without it, {cost_shown(best)} with it",
            "check the place, frame and unit of that prior, or leave it out",
            cost,
            best,
            edges=(int(instance.known_numbers[row]),),
        )
        return
    left = restricted(instance, np.delete(np.arange(instance.graph.num_nodes), world), "relative")
    cost = _descended(examined, left, examined.answer.estimate)
    # Without chi^2 something else has to say what is usual.
    if _explains(examined, cost) and (examined.fit is not None or _is_checked(examined, left)):
        yield Finding(
            "priors-elsewhere",
            f"the {counted(len(rows), 'prior{s}')} and the other measurements contradict each "
            f"other: the map costs {cost_shown(cost)} without them, {cost_shown(best)} with them",
            "check their frame, unit, axes and which node each is of",
            cost,
            best,
            strength=min(WITHOUT_CAUSE * explained(cost, best), MOST),
            edges=tuple(instance.known_numbers[rows].tolist()),
        )


def _explains(examined: Examined, cost: float) -> bool:
    """Whether so little is left of the cost."""
    best = examined.best
    return examined.is_above(best, cost) and explains(cost, best, 0.0)


def _without(examined: Examined, row: int) -> float | None:
    """The cost without a measurement; None if it hardly falls, or nothing checks what is left."""
    first, kept = examined.first, np.ones(examined.instance.graph.num_edges, dtype=bool)
    if first is not None and first.surprises[row] < HARDLY * first.fit.chi2:
        return None  # it is to first order what chi^2 falls by
    kept[row] = False
    with suppress(CertPGOError, np.linalg.LinAlgError):
        left = examined.instance.with_edges(kept)
        if _is_checked(examined, left):
            return _descended(examined, left, examined.answer.estimate)
    return None


def _is_checked(examined: Examined, instance: Instance) -> bool:
    """Whether measurements say more than they determine."""
    problem = objective_of(instance, examined.problem.cost_name)
    layout, measured = problem.tangent_layout, np.sum(problem.numbers)
    return bool(measured > layout.size - layout.sizes[layout.still()])


def _held(examined: Examined) -> Iterator[Finding]:
    instance, best = examined.instance, examined.best
    free = instance.released
    if free is None:
        return
    examined.trying("held-elsewhere")
    answer = examined.answer.estimate
    cost = _descended(examined, free, answer.subset(np.arange(free.graph.num_nodes)))
    if _explains(examined, cost):
        named = few(instance.ids[list(instance.fixed)].tolist())
        yield Finding(
            "held-elsewhere",
            f"the measurements contradict where the file fixes nodes ({named}): the map costs "
            f"{cost_shown(cost)} with these released, {cost_shown(best)} with them held",
            "release them (--no-fixed), or correct their values",
            cost,
            best,
        )


def _descended(examined: Examined, instance: Instance, start: Estimate) -> float:
    """What other measurements of the same nodes cost at the end of descent."""
    problem = objective_of(instance, examined.problem.cost_name)
    begin = problem.settled(start.subset(np.arange(instance.graph.num_nodes)))
    end = descend(problem, begin, monitor=examined.monitor)
    cost = problem.cost(problem.settled(end.estimate))
    if not np.isfinite(cost):
        raise NumericalError("descent did not end")
    return cost
