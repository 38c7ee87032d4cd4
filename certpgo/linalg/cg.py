"""Preconditioned conjugate gradients that detect negative curvature."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from certpgo.linalg.arrays import FloatArray

Apply = Callable[[FloatArray], FloatArray]


class End(Enum):
    """Why conjugate gradients stopped."""

    CONVERGED = "converged"
    LIMIT = "iteration limit"
    BOUNDARY = "boundary"
    NEGATIVE_CURVATURE = "negative curvature"


@dataclass(frozen=True, eq=False)
class Truncated:
    """The result of conjugate gradients.

    Attributes
    ----------
    x : (N,) approximate solution of A x = b
    residual : (N,) b - A x
    end : why they stopped
    products : number of products with A
    """

    x: FloatArray
    residual: FloatArray
    end: End
    products: int


def conjugate_gradients(
    multiply: Apply,
    b: FloatArray,
    precondition: Apply,
    *,
    tol: float,
    max_iterations: int,
    radius: float = math.inf,
    trust: float = 0.0,
) -> Truncated:
    """Solve A x = b for symmetric A, truncated as by Steihaug; Nocedal and Wright, Algorithm 7.2.

    Parameters
    ----------
    multiply : x -> A x
    b : (N,)
    precondition : r -> P^-1 r for some positive definite P near A
    tol : stop when the residual's P^-1 norm has decreased by this factor
    radius : the largest P norm of x, reached when x would leave the region or on negative
        curvature; without a bound, x stops at negative curvature
    trust : of a P that is A up to rounding, the distance from 1 of the first step's length up to
        which that step is the solution
    """
    x, r = np.zeros_like(b), b.copy()
    y = precondition(r)
    p, size = y, float(r @ y)
    target = tol**2 * size
    xx, xp, pp = 0.0, 0.0, size  # products of x and p in P
    for number in range(1, max_iterations + 1):
        Ap = multiply(p)
        curvature = float(p @ Ap)
        if not curvature > 0.0 and radius == math.inf:
            return Truncated(x, r, End.NEGATIVE_CURVATURE, number)
        longest = (math.sqrt(xp * xp + pp * max(radius * radius - xx, 0.0)) - xp) / pp
        step = size / curvature if curvature > 0.0 else math.inf
        if step >= longest:
            end = End.BOUNDARY if curvature > 0.0 else End.NEGATIVE_CURVATURE
            return Truncated(x + longest * p, r - longest * Ap, end, number)
        x = x + step * p
        r = r - step * Ap
        if number == 1 and abs(step - 1.0) <= trust:
            return Truncated(x, r, End.CONVERGED, number)
        y = precondition(r)
        old, size = size, float(r @ y)
        if size <= target:
            return Truncated(x, r, End.CONVERGED, number)
        xx += 2.0 * step * xp + step**2 * pp
        p = y + (size / old) * p
        xp, pp = (size / old) * (xp + step * pp), size + (size / old) ** 2 * pp
    return Truncated(x, r, End.LIMIT, max_iterations)
