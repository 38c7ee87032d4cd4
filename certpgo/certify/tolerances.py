"""The tolerances of certificates."""

from __future__ import annotations

import math

from certpgo.errors import NumericalError

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


def gap_of(cost: float, bound: float, *, rigorous: bool) -> float:
    """What a bound leaves of a cost, rounded up.

    Raises
    ------
    NumericalError
        The bound is rigorous and above the cost: no verdict would be true.
    """
    gap = difference_up(cost, bound)
    if rigorous and gap < 0.0:
        raise NumericalError("a bound above the cost is a fault of this program: report it")
    return gap


def difference_up(high: float, low: float) -> float:
    """A double not below the difference; its rounding is found exactly (Knuth's TwoSum)."""
    gap = high - low
    if not math.isfinite(gap):
        return gap
    subtracted = gap - high
    missing = (high - (gap - subtracted)) - (low + subtracted)
    return gap if missing <= 0.0 else math.nextafter(gap, math.inf)
