"""Consistency of relative rotations by comparing two spectra; thesis section 3.2.

Perfect measurements make the connection Laplacian L similar to L_G x I, the graph Laplacian with
every eigenvalue repeated d times (Proposition 3.2.4). The distance between the spectra tells how
far the measurements are from perfect, before anything is estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral


@dataclass(frozen=True, eq=False)
class Consistency:
    """The smallest eigenvalues of a graph and of its measurements.

    Attributes
    ----------
    graph : (k,) smallest eigenvalues of the graph Laplacian L_G, weighted by kappa, ascending
    measured : (k, d) smallest eigenvalues of the connection Laplacian L, ascending along rows;
        with perfect measurements row i repeats ``graph[i]``
    """

    graph: FloatArray
    measured: FloatArray

    @property
    def differences(self) -> FloatArray:
        """(k, d) Weyl differences |lambda_i(L_G) - lambda(L)|; the thesis' are the last column."""
        return np.asarray(np.abs(self.measured - self.graph[:, None]))

    @property
    def inconsistency(self) -> float:
        """`inconsistency` of the measurements."""
        return inconsistency(float(self.measured[0, 0]), float(self.graph[1]))


def consistency(problem: Quadratic, k: int = 2) -> Consistency:
    """Compare the k smallest eigenvalues of the graph Laplacian with the k d of L.

    Parameters
    ----------
    k : 2 to the number of nodes

    Raises
    ------
    InputError
        k is out of this range.
    NumericalError
        A factorization failed, or the eigenvalues did not converge.
    """
    if not 2 <= k <= problem.n:
        raise InputError(f"2 to {problem.n} eigenvalues of the graph can be compared, not {k}")
    ones = np.ones(problem.n)
    others = spectral.deflated_eigenpairs(problem, problem.laplacian, ones, k - 1).values
    pairs = spectral.smallest_eigenpairs(
        problem, k * problem.d, tol=1e-8, shift=1e-3 * float(others[0])
    )
    return Consistency(np.concatenate([[0.0], others]), pairs.values.reshape(k, problem.d))


def inconsistency(smallest: float, fiedler: float) -> float:
    """lambda_1(L) / lambda_2(L_G): 0 for perfect measurements, for weights of any scale.

    Conjecture 3.2.1 of the thesis: it rises with the noise, to 1 for uniformly random rotations.
    On well-connected random graphs, like the thesis', it approaches 1 from below. In general it has
    no such bound: lambda_2 is at most the weight of a cut times n / (|S| |S'|) with S and S' the
    sides of the cut, and lambda_1 at least the smaller of the two sides' own lambda_1. Two cliques
    of 20 joined by one edge exceed 100; the Sphere of the thesis' Table 5.6 has 14.
    """
    return max(smallest, 0.0) / fiedler


def perturbation_bound(problem: Quadratic, estimate: Estimate) -> float:
    """A bound on Weyl differences: max_i sum_j kappa_ij ||R_ij - R_i^T R_j||, operator norms.

    Proof. H with blocks deg_i I and -kappa_ij R_i^T R_j is D^T (L_G x I) D, with the orthogonal D =
    blkdiag(R_1, ..., R_n), so its eigenvalues are those of L_G, each repeated d times. By Weyl's
    inequality those of L = H + P, both in ascending order, differ from them by at most ||P||. P is
    symmetric with blocks -kappa_ij (R_ij - R_i^T R_j) and a zero diagonal. Let P x = mu x
    with |mu| = ||P|| and x_i the longest block of x: |mu| |x_i| <= sum_j ||P_ij|| |x_j| <=
    (sum_j ||P_ij||) |x_i|. Blocks of parallel edges are summed, and the norm of a sum is at most
    the sum of norms. The thesis has ||P||_inf in place of the sum, at most sqrt(d) times as much.

    It holds for any rotations, and is small if the residuals are. For d = 2 and 3, the difference
    of two rotations has the norm 2 sin(alpha / 2), with alpha the residual angle: its Frobenius
    norm over sqrt(2).
    """
    graph = problem.graph
    chords = np.linalg.norm(problem.residuals(estimate.rotations), axis=(1, 2)) / np.sqrt(2.0)
    return float(operators.degrees(graph.edges, graph.kappa * chords, problem.n).max())
