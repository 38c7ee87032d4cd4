"""The tolerances of certificates, and what they may not be."""

from __future__ import annotations

import math
from numbers import Real

from certpgo.errors import InputError, require
from certpgo.objective.objective import Objective

#: CERTIFIED means gap <= rtol F + min(atol W, NEGLIGIBLE F), or that of an exact fit.
RTOL, ATOL = 1e-5, 1e-12
#: Share of the cost that W never makes up for: weights, such as that of a rigid mount, may make
#: atol W larger than any cost.
NEGLIGIBLE = 1e-3
#: Share of atol W by which costs of optimal points may differ: squared residuals of 1e-9.
FLOOR = 1e-6
#: Largest factor by which the proof tier reduces the effect of rounding.
PROOF_GAIN = 1e3
#: Share of the tolerated gap within which a stationary point's own bound needs no descent.
AT_REST = 0.1
#: Stationarity, radians, at which a stalled descent counts as converged, a point as stationary.
SETTLED = 1e-6


def allowed(cost: float, rtol: float, absolute: float) -> float:
    """Rtol F and an absolute part, of which no more counts than a small share of the cost."""
    return rtol * cost + min(absolute, NEGLIGIBLE * cost)


def difference_up(high: float, low: float) -> float:
    """A double not below the difference; its rounding is found exactly (Knuth's TwoSum)."""
    gap = high - low
    if not math.isfinite(gap):
        return gap
    subtracted = gap - high
    missing = (high - (gap - subtracted)) - (low + subtracted)
    return gap if missing <= 0.0 else math.nextafter(gap, math.inf)


def refuse_tolerances(rtol: float, atol: float) -> None:
    """Refuse tolerances that are negative, 1 or larger, or not finite.

    Raises
    ------
    InputError
        One is.
    """
    for tolerance in (rtol, atol):
        require(tolerance, Real, "a number as tolerance")
    if not (0.0 <= rtol < 1.0 and 0.0 <= atol < 1.0):
        raise InputError(f"tolerances must lie within 0 ... 1: rtol={rtol}, atol={atol}")


def refuse_time_limit(seconds: float | None) -> None:
    """Refuse a negative time limit.

    Raises
    ------
    InputError
        It is, or it is not a number.
    """
    if seconds is not None:
        require(seconds, Real, "seconds as time limit")
    if seconds is not None and not seconds >= 0.0:
        raise InputError(f"the time limit must not be negative: {seconds}")


def refuse_unprovable(problem: Objective) -> None:
    """Refuse a problem whose cost the checker does not know.

    Raises
    ------
    InputError
        Its reason says so.
    """
    if problem.unprovable:
        raise InputError(problem.unprovable)
