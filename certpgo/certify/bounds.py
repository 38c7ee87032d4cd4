"""Bounds that need no factorization of the certificate matrix.

The residual-angle bounds hold only at exactly stationary points of the rotation problem: K_4 with
exact data has a non-stationary point with residuals of 44 < 54.4 degrees and F = 4 above F* = 0.
They never certify an estimate by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Graph
from certpgo.graph.cycles import is_cycle, walk
from certpgo.graph.display import Brief
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import divided, scatter_sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral

#: Relative tolerance for residuals about one axis, and for equal weights.
SAME = 1e-6


@dataclass(frozen=True, repr=False)
class Bounds(Brief):
    """Bounds for stationary points of the rotation problem.

    Angles in radians. A stationary point whose residual angles are all within one of the angle
    bounds is optimal. The bounds do not apply to other points, nor to translations.

    Attributes
    ----------
    spectral : n (lambda_1 + ... + lambda_d)(L) <= F*, from computed eigenvalues
    fiedler : lambda_2 of the graph Laplacian weighted by kappa
    alpha_max : Eriksson et al., Theorem 4.1
    normalized_alpha_max : likewise with the normalized Laplacian's second eigenvalue
    cycle : pi / n (Theorem 4.2) if the graph is one cycle of equal weights, else None
    row_bound_holds : whether each node's own residuals satisfy the a posteriori row bound
    cycle_sum_holds : for a cycle, whether the residuals share an axis and sign and add up to at
        most pi, none of them half a turn; None if the graph is not a cycle
    """

    spectral: float
    fiedler: float
    alpha_max: float
    normalized_alpha_max: float
    cycle: float | None
    row_bound_holds: bool
    cycle_sum_holds: bool | None


def bounds(problem: Quadratic, estimate: Estimate) -> Bounds:
    """All bounds of a graph, the a posteriori ones at ``estimate``.

    Raises
    ------
    NumericalError
        An eigenvalue computation failed.
    """
    pairs = spectral.smallest_eigenpairs(problem)
    fiedler = fiedler_value(problem)
    nu = normalized_fiedler_value(problem)
    weights = problem.node_weights
    return Bounds(
        spectral=spectral.spectral_bound(problem, pairs),
        fiedler=fiedler,
        alpha_max=alpha_max(fiedler / float(weights.max())),
        normalized_alpha_max=alpha_max(nu),
        cycle=cycle_bound(problem.graph),
        row_bound_holds=float(row_bound(problem, estimate).max()) < nu,
        cycle_sum_holds=cycle_sum_holds(problem, estimate),
    )


def alpha_max(connectivity: float) -> float:
    """The residual angle up to which stationary points are optimal, radians.

    2 arcsin(sqrt(1/4 + connectivity/2) - 1/2), with connectivity lambda_2 / d_max for Theorem 4.1
    of Eriksson et al. (eq. 22), or nu_2, the second eigenvalue of the normalized Laplacian
    D^-1/2 L_G D^-1/2, for the stronger normalized bound. Both are at most 2.

    Proof of the latter. In the gauge of R, S' = L_G x I + Delta with S' (1 x I) = 0. Scaled by
    D^-1/2 on both sides, Delta becomes a symmetric matrix similar to D^-1 Delta, whose block rows
    add up, in operator norm, to at most 2 s^2 + 2 s with s = sin(alpha / 2), for any degrees.
    The null space D^1/2 1 x I splits off, and on its complement the form is at least
    nu_2 - 2 s (1 + s). Since nu_2 >= lambda_2 / d_max it is never weaker.
    """
    x = max(connectivity, 0.0) / 2.0
    return float(2.0 * np.arcsin(x / (np.sqrt(0.25 + x) + 0.5)))


def fiedler_value(problem: Quadratic) -> float:
    """lambda_2 of the graph Laplacian weighted by kappa.

    Raises
    ------
    NumericalError
        Some edges measure no rotation, or the eigenvalue was not found.
    """
    _require_rotations(problem)
    found = spectral.deflated_eigenpairs(problem, problem.laplacian, np.ones(problem.n), 1)
    return float(found.values[0])


def _require_rotations(problem: Quadratic) -> None:
    if not problem.graph.kappa.all():
        raise NumericalError("some edges measure no rotation")


def normalized_fiedler_value(problem: Quadratic) -> float:
    """nu_2, the second eigenvalue of D^-1/2 L_G D^-1/2; at most 2."""
    _require_rotations(problem)
    L = problem.laplacian
    root = np.sqrt(problem.node_weights)
    scaled = divided(L, root)
    return float(spectral.deflated_eigenpairs(problem, scaled, root, 1).values[0])


def row_bound(problem: Quadratic, estimate: Estimate) -> FloatArray:
    """(|Delta_ii| + sum_j |Delta_ij|) / deg_i for each node, operator norms, (n,).

    A stationary point is optimal if all of them are below `normalized_fiedler_value`: the proof
    of `alpha_max` with each row's own residuals. Parallel edges are summed before norms are taken.
    """
    graph, d = problem.graph, problem.d
    i, j = graph.edges.T
    R = estimate.rotations
    E = R[i] @ graph.rotations @ np.swapaxes(R[j], 1, 2)
    delta = graph.kappa[:, None, None] * (np.eye(d) - E)
    symmetric = 0.5 * (delta + np.swapaxes(delta, 1, 2))
    diagonal = scatter_sum(i, symmetric, problem.n) + scatter_sum(j, symmetric, problem.n)
    low, high = np.minimum(i, j), np.maximum(i, j)
    flipped = np.where((i > j)[:, None, None], np.swapaxes(delta, 1, 2), delta)
    pairs, which = np.unique(low * problem.n + high, return_inverse=True)
    norms = np.linalg.norm(scatter_sum(which, flipped, len(pairs)), 2, axis=(1, 2))
    first, second = np.divmod(pairs, problem.n)
    rows = np.linalg.norm(diagonal, 2, axis=(1, 2))
    rows += np.bincount(first, norms, problem.n) + np.bincount(second, norms, problem.n)
    return np.asarray(rows / problem.node_weights)


def cycle_bound(graph: Graph) -> float | None:
    """Pi / n for a cycle of equal weights (Eriksson et al., Theorem 4.2), else None."""
    equal = np.ptp(graph.kappa) <= SAME * graph.kappa.max()
    return float(np.pi / graph.num_nodes) if equal and is_cycle(graph) else None


def cycle_sum_holds(problem: Quadratic, estimate: Estimate) -> bool | None:
    """Whether a cycle's residuals share one axis and sign and add up to at most pi.

    Then a stationary point of a (weighted) cycle is optimal, see docs/concepts/bounds.md, unless a
    residual is half a turn: one on its own makes no torque. None for other graphs.
    """
    graph = problem.graph
    if not is_cycle(graph):
        return None
    R, (i, j) = estimate.rotations, graph.edges.T
    residual = so.log(R[i] @ graph.rotations @ np.swapaxes(R[j], 1, 2))
    around = walk(graph)
    residual[around.edges[~around.forward]] *= -1.0
    angles = np.linalg.norm(residual, axis=1)
    total, aligned = angles.sum(), np.linalg.norm(residual.sum(axis=0))
    turns_less = angles.max() <= (1.0 - SAME) * np.pi
    return bool(total <= np.pi and turns_less and aligned >= (1.0 - SAME) * total)
