"""Measurements chosen for the algebraic connectivity of the graph that they leave.

After Doherty, Papalia, Huang, Rosen, Englot and Leonard, "MAC: Maximizing Algebraic Connectivity
for Graph Sparsification" (arXiv 2403.19879): lambda_2 of the graph Laplacian weighted by kappa is
concave in the weights, and its relaxation over fractions of edges is solved by Frank-Wolfe steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective import operators
from certpgo.objective.problem import RotationProblem
from certpgo.optimize.spectral import deflated_eigenpairs

#: Frank-Wolfe steps at most, and the relative gap at which they end.
STEPS, CLOSE = 60, 0.01
#: Exchanges tried from each start, the share of a choice first exchanged at once, and the factor by
#: which that falls after a failure.
EXCHANGES, SHARE, FEWER = 200, 0.1, 0.9
#: Weight of the last gradient in the mean that ranks exchanges.
LAST = 0.2
#: Accuracy of eigenvectors; every unit vector gives a valid bound.
ACCURACY = 1e-4


@dataclass(frozen=True, eq=False)
class Choice:
    """Edges chosen among candidates, the others being kept.

    Attributes
    ----------
    chosen : (count,) the edges, ascending
    connectivity : lambda_2 with them, 1/rad^2
    bound : no choice of as many candidates has a larger lambda_2
    """

    chosen: IntArray
    connectivity: float
    bound: float


class Connectivity:
    """lambda_2 of the graph Laplacian, as a function of fractions of edges.

    Parameters
    ----------
    problem : its graph has the edges; all of them measure rotations
    vector : (n,) from which the first eigenvector is sought; by default random

    Attributes
    ----------
    vector : (n,) the last eigenvector found, of unit length and orthogonal to ones
    """

    def __init__(self, problem: RotationProblem, vector: FloatArray | None = None) -> None:
        self._problem = problem
        noise = np.random.default_rng(0).standard_normal((problem.n, 2))
        self.vector = noise[:, 0] if vector is None else vector
        self._noise = noise[:, 1]

    @property
    def num_nodes(self) -> int:
        """Nodes of the graph."""
        return self._problem.n

    def __call__(self, fractions: FloatArray) -> tuple[float, FloatArray]:
        """lambda_2 for fractions (m,), and its supergradient: kappa (v_i - v_j)^2 for each edge.

        v is a unit vector orthogonal to ones, so that fractions' times the supergradient is at
        least lambda_2 for any fractions'. The next call starts from it.

        Raises
        ------
        NumericalError
            The eigenvector was not found.
        """
        problem = self._problem
        kappa, (i, j) = problem.graph.kappa, problem.graph.edges.T
        L = operators.laplacian(problem.pattern, kappa * fractions)
        start = np.column_stack([self.vector, self._noise])
        ones = np.ones(problem.n)
        found = deflated_eigenpairs(problem, L, ones, 1, start=start, tol=ACCURACY)
        v = found.vectors[:, 0] - found.vectors[:, 0].mean()
        v /= np.linalg.norm(v)
        self.vector = v
        return float(found.values[0]), kappa * (v[i] - v[j]) ** 2


def choose(connectivity: Connectivity, candidates: BoolArray, count: int) -> Choice:
    """The candidates (m,) with which the graph is connected best, as many as ``count``.

    Evenly spread candidates and two roundings of the relaxation are each improved by exchanges.

    Raises
    ------
    NumericalError
        An eigenvector was not found, as where the other edges do not connect the graph.
    """
    fractions, bound = relaxed(connectivity, candidates, count)
    starts = (
        _largest(fractions, candidates, count),
        _sampled(fractions, candidates, count),
        _sampled(np.ones(len(candidates)), candidates, count),
    )
    found = [_exchanged(connectivity, candidates, chosen) for chosen in starts]
    value, chosen = max(found, key=lambda one: one[0])
    return Choice(chosen, value, max(bound, value))


def relaxed(
    connectivity: Connectivity, candidates: BoolArray, count: int
) -> tuple[FloatArray, float]:
    """Fractions (m,) of edges that maximise lambda_2, and an upper bound on the maximum.

    Fractions of candidates are in [0, 1] and add up to ``count``; others are 1. A supergradient
    bounds lambda_2 of all choices by its largest sum over one of them, and so does every convex
    combination of supergradients.
    """
    fractions = np.where(candidates, count / max(int(candidates.sum()), 1), 1.0)
    mean, bound = np.zeros(len(candidates)), np.inf
    for t in range(STEPS):
        value, gradient = connectivity(fractions)
        step = 2.0 / (t + 2.0)
        mean += step * (gradient - mean)
        vertex = _with(candidates, _largest(gradient, candidates, count))
        best = _with(candidates, _largest(mean, candidates, count))
        bound = min(bound, float(vertex @ gradient), float(best @ mean))
        if bound - value <= CLOSE * bound:
            break
        fractions += step * (vertex - fractions)
    rounding = 4.0 * (len(candidates) + connectivity.num_nodes) * np.finfo(float).eps
    return fractions, bound * (1.0 + rounding)


def _with(candidates: BoolArray, chosen: IntArray) -> FloatArray:
    """(m,) 1 for the chosen candidates and all other edges, otherwise 0."""
    fractions = np.where(candidates, 0.0, 1.0)
    fractions[chosen] = 1.0
    return fractions


def _largest(values: FloatArray, candidates: BoolArray, count: int) -> IntArray:
    """The candidates of the largest values, ascending; of equal ones, the first."""
    among = np.flatnonzero(candidates)
    return np.sort(among[np.argsort(-values[among], kind="stable")[:count]])


def _sampled(weights: FloatArray, candidates: BoolArray, count: int) -> IntArray:
    """A systematic sample of candidates, each of a probability proportional to its weight.

    A symmetric graph has many equal fractions, of which the largest are neighbours; a systematic
    sample spreads along the trajectory.
    """
    among, order = np.flatnonzero(candidates), np.arange(count)
    total = np.cumsum(weights[among])
    picks = np.searchsorted(total, (order + 0.5) * (total[-1] / count), side="right")
    # No edge may be taken twice, or after the last, whatever its weight.
    picks = np.minimum(np.maximum.accumulate(picks - order), len(among) - count) + order
    return np.asarray(among[picks])


def _exchanged(
    connectivity: Connectivity, candidates: BoolArray, chosen: IntArray
) -> tuple[float, IntArray]:
    """Chosen edges of small gain exchanged for others of large gain, while lambda_2 rises.

    lambda_2 is not smooth where it is nearly double, so that the gradient at one choice misleads;
    gains are averaged over the choices tried.
    """
    flags = _with(candidates, chosen)
    value, gains = connectivity(flags)
    several = max(1.0, SHARE * len(chosen))
    for _ in range(EXCHANGES):
        inside = np.flatnonzero(candidates & (flags > 0.0))
        outside = np.flatnonzero(candidates & (flags == 0.0))
        number = min(int(several), len(outside))
        trial = flags.copy()
        trial[inside[np.argsort(gains[inside], kind="stable")[:number]]] = 0.0
        trial[outside[np.argsort(-gains[outside], kind="stable")[:number]]] = 1.0
        higher, gradient = connectivity(trial)
        if higher > value:
            flags, value = trial, higher
        else:
            several = max(1.0, FEWER * several)
        gains += LAST * (gradient - gains)
    return value, np.flatnonzero(candidates & (flags > 0.0))
