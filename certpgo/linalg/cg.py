"""Preconditioned conjugate gradients that notice when the matrix is not positive definite."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from certpgo.linalg.arrays import CSC, FloatArray


def conjugate_gradients(
    A: CSC,
    b: FloatArray,
    precondition: Callable[[FloatArray], FloatArray],
    *,
    tol: float,
    max_iterations: int,
) -> tuple[FloatArray, FloatArray] | None:
    """Solve A x = b for symmetric A; Nocedal and Wright, Algorithm 5.3.

    Parameters
    ----------
    b : (N,)
    precondition : r -> P^-1 r for some positive definite P near A
    tol : stop when the residual's P^-1 norm has fallen by this factor

    Returns
    -------
    The solution (N,) and its residual b - A x; None when a direction of negative curvature is met
    or ``max_iterations`` do not suffice.
    """
    x, r = np.zeros_like(b), b.copy()
    y = precondition(r)
    p, size = y, float(r @ y)
    target = tol**2 * size
    for _ in range(max_iterations):
        Ap = A @ p
        curvature = float(p @ Ap)
        if not curvature > 0.0:
            return None
        step = size / curvature
        x = x + step * p
        r = r - step * Ap
        y = precondition(r)
        old, size = size, float(r @ y)
        if size <= target:
            return x, r
        p = y + (size / old) * p
    return None
