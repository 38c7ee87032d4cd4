"""Lower bounds on any cost from a point: that of its surrogate there, plus a constant.

A surrogate is a quadratic problem whose cost F' plus a constant C is nowhere above the cost f, and
equal to it at its expansion point; that of F is F itself. So F' >= v implies f >= v + C. At a
stationary point of f, whose surrogate has a positive semidefinite certificate matrix there, that is
f itself.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from certpgo.certify.dual import DualBound, Support, dual_bound
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.objective.complex_relaxation import over_complex_numbers
from certpgo.objective.objective import Objective, Surrogate
from certpgo.objective.quadratic import Quadratic


def lower_bound(problem: Objective, point: Point) -> float:
    """A lower bound on the optimum of a problem's cost, from a point; 0 if there is none.

    It is the best possible if the point is an optimum of the cost's relaxation.

    Parameters
    ----------
    point : near-stationary, with translations optimal for its rotations; of any rank where the
        cost is that of poses and distances, else an estimate

    Raises
    ------
    NumericalError
        No pose graph below the cost is known there.

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.certify.bound import lower_bound
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> answer = certpgo.solve(winding_cycle(6, 0.3, 0)[0].graph)
    >>> 0.99999 * answer.cost < lower_bound(answer.problem, answer.estimate) <= answer.cost
    True
    """
    found = bound_by(problem.surrogate(point), point)
    return 0.0 if found is None else max(found.value, 0.0)


def bound_by(
    surrogate: Surrogate,
    point: Point,
    *,
    enough: float = -math.inf,
    real: bool = False,
    **how: Any,
) -> DualBound | None:
    """The bound by the multipliers of a point of a surrogate's relaxation; None without one.

    In the plane, what the relaxation over real numbers leaves open is left to that over complex
    ones.

    Parameters
    ----------
    enough : a value of it that suffices
    real : only over real numbers, of which proofs are
    how : see `certpgo.certify.dual.dual_bound`
    """
    for below, constant in surrogate.at(point):
        found = _bound_of(below, constant, point, enough, **how)
        if not real and isinstance(point, Estimate) and (found is None or found.loose):
            tighter = over_complex_numbers(below)
            other = None if tighter is None else _bound_of(tighter, constant, point, enough, **how)
            # Costs are not negative: a bound that says no more is none, and others may be better.
            if other is not None and other.value > (0.0 if found is None else found.value):
                found = other
        if found is None:
            continue
        if surrogate.minorants is None:
            return found
        return replace(found, support=Support(surrogate.minorants, point))
    return None


def _bound_of(
    below: Quadratic, constant: float, point: Point, enough: float, **how: Any
) -> DualBound | None:
    """The bound on a quadratic problem's cost plus a constant."""
    for share in below.shares(point.rotations.shape[1]):
        found = dual_bound(
            below,
            below.blocks(point),
            enough=enough - constant,
            floor=-constant if below.is_signed else 0.0,
            given_up=share,
            **how,
        )
        if found is None:
            continue
        if constant == 0.0:
            return found
        value = math.nextafter(found.value + constant, -math.inf)
        return replace(found, value=value, attained=found.attained + constant)
    return None
