"""Bounds that need no factorization of the certificate matrix."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Bounds:
    """A priori statements about stationary points of the rotation problem.

    Angles in radians. A stationary point whose residual angles all stay within one of the angle
    bounds is optimal; the bounds say nothing about points that are not stationary, and nothing
    about translations.

    Attributes
    ----------
    spectral : n (lambda_1 + ... + lambda_d)(L) <= F*, from computed eigenvalues
    alpha_max : Eriksson et al., Theorem 4.1
    normalized_alpha_max : the same with the normalized Laplacian's second eigenvalue
    cycle : pi / n (Theorem 4.2) when the graph is one unweighted cycle, else None
    row_bound_holds : whether each node's own residuals satisfy the a posteriori row bound
    """

    spectral: float
    alpha_max: float
    normalized_alpha_max: float
    cycle: float | None
    row_bound_holds: bool
