"""Measurements chosen for the graph that they leave: its connectivity, or its measured spectrum.

After Doherty, Papalia, Huang, Rosen, Englot and Leonard, "MAC: Maximizing Algebraic Connectivity
for Graph Sparsification" (arXiv 2403.19879): lambda_2 of the graph Laplacian weighted by kappa is
concave in the weights, and its relaxation over fractions of edges is solved by Frank-Wolfe steps.

The measured spectrum is that of the connection Laplacian, which "reflects the quality of the
observations", so that it "could be used to select or discard" them (Moreira 2020, section 6.3; how
is left open there). Its smallest d eigenvalues are zero without noise and rise with it, towards
lambda_2: the margin between them is the thesis' comparison of spectra, section 3.2.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.eigen import krylov_schur
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import factor_shifted
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

#: What is maximised: fractions of edges (m,) -> the value, and how it changes with each (m,).
Measure = Callable[[FloatArray], tuple[float, FloatArray]]


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
    problem : as given
    vector : (n,) the last eigenvector found, of unit length and orthogonal to ones
    """

    def __init__(self, problem: Quadratic, vector: FloatArray | None = None) -> None:
        self.problem = problem
        noise = np.random.default_rng(0).standard_normal((problem.n, 2))
        self.vector = noise[:, 0] if vector is None else vector
        self._noise = noise[:, 1]

    def __call__(self, fractions: FloatArray) -> tuple[float, FloatArray]:
        """lambda_2 for fractions (m,), and its supergradient: kappa (v_i - v_j)^2 for each edge.

        v is a unit vector orthogonal to ones, so that fractions' times the supergradient is at
        least lambda_2 for any fractions'. The next call starts from it.

        Raises
        ------
        NumericalError
            The eigenvector was not found.
        """
        problem = self.problem
        kappa, (i, j) = problem.graph.kappa, problem.graph.edges.T
        L = operators.laplacian(problem.pattern, kappa * fractions)
        start = np.column_stack([self.vector, self._noise])
        ones = np.ones(problem.n)
        found = deflated_eigenpairs(problem, L, ones, 1, start=start, tol=ACCURACY)
        v = found.vectors[:, 0] - found.vectors[:, 0].mean()
        v /= np.linalg.norm(v)
        self.vector = v
        return float(found.values[0]), kappa * (v[i] - v[j]) ** 2


class SpectralMargin:
    """Lambda_2 minus the mean of the smallest d eigenvalues of the connection Laplacian.

    By fractions of edges, as `Connectivity`, which it equals where the measurements are exact.
    A wrong measurement raises the mean more than lambda_2.

    Parameters
    ----------
    connectivity : lambda_2 for the same problem
    """

    def __init__(self, connectivity: Connectivity) -> None:
        self._connectivity = connectivity
        self._vectors: FloatArray | None = None

    def __call__(self, fractions: FloatArray) -> tuple[float, FloatArray]:
        """The margin for fractions (m,), and how it changes with each of them.

        The latter is kappa ((v_i - v_j)^2 - |U_j - U_i R_ij|^2 / d) for the d eigenvectors U (d,
        dn). The next call starts from them.

        Raises
        ------
        NumericalError
            Eigenvectors were not found.
        """
        value, gradient = self._connectivity(fractions)
        problem = self._connectivity.problem
        graph, d = problem.graph, problem.d
        weighted = graph.with_weights(graph.kappa * fractions)
        build = functools.partial(operators.connection_laplacian, problem.pattern, weighted)
        mean = float(problem.node_weights.mean())
        L, shift, factor = factor_shifted(problem, build, mean)
        found = krylov_schur(L, factor.solve, d, shift=shift, start=self._vectors, tol=ACCURACY)
        self._vectors = found.vectors
        U = np.swapaxes(found.vectors.reshape(problem.n, d, d), 1, 2)
        squares = (operators.rotation_residuals(graph, U) ** 2).sum(axis=(1, 2))
        return value - float(found.values.mean()), gradient - graph.kappa * squares / d


def choose(
    connectivity: Connectivity,
    candidates: BoolArray,
    count: int,
    margin: SpectralMargin | None = None,
) -> Choice:
    """The candidates (m,) with which the graph is connected best, as many as ``count``.

    Evenly spread candidates and two roundings of the relaxation are each improved by exchanges.

    Parameters
    ----------
    margin : to be raised by further exchanges, at the expense of connectivity

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
    if margin is not None:
        chosen = _exchanged(margin, candidates, chosen)[1]
        value = connectivity(_with(candidates, chosen))[0]
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
    # Connected nodes are at most one more than the edges.
    rounding = 8.0 * (len(candidates) + 1) * np.finfo(float).eps
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


def _exchanged(measure: Measure, candidates: BoolArray, chosen: IntArray) -> tuple[float, IntArray]:
    """Chosen edges of small gain exchanged for others of large gain, while the measure rises.

    lambda_2 is not smooth where it is nearly double, so that the gradient at one choice misleads;
    gains are averaged over the choices tried.
    """
    flags = _with(candidates, chosen)
    value, gains = measure(flags)
    several = max(1.0, SHARE * len(chosen))
    for _ in range(EXCHANGES):
        inside = np.flatnonzero(candidates & (flags > 0.0))
        outside = np.flatnonzero(candidates & (flags == 0.0))
        number = min(int(several), len(outside))
        trial = flags.copy()
        trial[inside[np.argsort(gains[inside], kind="stable")[:number]]] = 0.0
        trial[outside[np.argsort(-gains[outside], kind="stable")[:number]]] = 1.0
        higher, gradient = measure(trial)
        if higher > value:
            flags, value = trial, higher
        else:
            several = max(1.0, FEWER * several)
        gains += LAST * (gradient - gains)
    return value, np.flatnonzero(candidates & (flags > 0.0))
