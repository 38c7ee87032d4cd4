"""What a lower bound loses at an estimate whose gauge is taken out exactly.

At a stationary estimate x the columns of V = x^T are null vectors of the certificate matrix S. To
show S >= 0 in spite of them, a shift must be larger than the rounding of all rows, and rows with
long levers, such as those of a world that positions are measured in, lose everything. Here the
columns of one pose p are replaced by V, a congruence:

    S >= 0  if and only if  [[S_rr, G], [G^T, K]] >= 0,    G = (S V)_r,  K = V^T S V,

for r all rows but those of p. The multiplier of p appears in K alone, and may be any symmetric
matrix. That with K = G^T C^-1 G makes S >= 0 whenever S_rr >= C > 0, C diagonal. The traces of all
multipliers then add up to

    F* >= F(x) - |C^-1/2 G|_F^2,

the cost less a squared gradient over a curvature. S_rr is definite, as its gauge is fixed, so that
C may be far above rounding, and G is computed from residuals: rounding costs next to nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.edges import symmetric
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic

#: Rounding of the sums of rounding errors.
UP = 1.001


@dataclass(frozen=True, eq=False)
class EdgeForces:
    """Residuals of edges times their weights, with bounds on the errors of the computed ones.

    For the rotations nearest to the stored matrices; all others are taken as stored.

    Attributes
    ----------
    turn, turn_error : (m,) norms of E K
    pull, pull_error : (m,) norms of tau r, for poses
    moment : (d, d) the sum of E K E^T and tau r r^T, whose trace is F, in the world
    moment_error : bound on the error of its eigenvalues
    """

    turn: FloatArray
    turn_error: FloatArray
    pull: FloatArray
    pull_error: FloatArray
    moment: FloatArray
    moment_error: float

    @staticmethod
    def of(graph: Graph, estimate: Estimate) -> EdgeForces:
        """Those at an estimate."""
        own, weight, measured = rotation_defect(estimate.rotations), graph.kappa, 0.0
        _, K, _ = graph.polar
        missed = np.zeros(1)
        if (N := graph.couplings) is not None:
            weight, missed = np.trace(K, axis1=1, axis2=2), _missed(N, *graph.polar)
        else:
            measured = rotation_defect(graph.rotations)
        E = operators.rotation_residuals(graph, estimate.rotations)
        size, off = np.sqrt(np.einsum("mab,mab->m", E, E)), 2.0 * own + measured + 192.0 * U
        turn, turn_error = weight * size, weight * (off + 64.0 * U * size)
        moment = np.einsum("mab,mcb->ac", E @ K, E)
        error = turn_error * (2.0 * size + off) + missed
        total, pull, pull_error = float(turn @ size), np.zeros(0), np.zeros(0)
        if graph.has_positions and estimate.translations is not None:
            residual = operators.translation_residuals(graph, estimate)
            r, tau = np.linalg.norm(residual, axis=1), np.abs(graph.tau)
            # The rounding of t_j - t_i is relative to its size, at most r plus the levers.
            off_t = (own + 32.0 * U) * sum(_lengths(graph)) + 32.0 * U * r
            pull, pull_error = tau * r, tau * (off_t + 8.0 * U * r)
            moment += residual.T @ (graph.tau[:, None] * residual)
            error = error + pull_error * (2.0 * r + off_t)
            total += float(pull @ r)
        rounding = (2 * graph.num_edges + 16) * 4.0 * U * total
        return EdgeForces(turn, turn_error, pull, pull_error, moment, UP * (error.sum() + rounding))


def _missed(N: FloatArray, P: FloatArray, K: FloatArray, K_left: FloatArray) -> FloatArray:
    """(m,) bounds on the norms of what E K E^T misses of the form with N, K and K', by rounding.

    With A = N - P K and B = K' - P K P^T that is R_i B R_i^T - R_i A R_j^T and its transpose.
    """
    product = P @ K
    A, B = N - product, K_left - product @ np.swapaxes(P, 1, 2)
    norms = [np.sqrt(np.einsum("mab,mab->m", C, C)) for C in (A, B)]
    return np.asarray(UP * (2.0 * norms[0] + norms[1] + 64.0 * U * np.trace(K, axis1=1, axis2=2)))


def _lengths(graph: Graph) -> tuple[FloatArray, FloatArray]:
    """(m,) lengths of the levers from i to j, and of the arms at j."""
    lever = np.linalg.norm(graph.translations, axis=1)
    return lever, np.zeros_like(lever) if graph.arms is None else np.linalg.norm(graph.arms, axis=1)


@dataclass(frozen=True, eq=False)
class Anchored:
    """The certificate matrix of an estimate, with one pose's columns replaced by null vectors.

    Attributes
    ----------
    problem : the problem
    estimate : near-stationary, with translations
    multipliers : (n, d, d) symmetric; that of the anchor does not count
    anchor : the pose p
    """

    problem: Quadratic
    estimate: Estimate
    multipliers: FloatArray
    anchor: int

    @staticmethod
    def of(problem: Quadratic, estimate: Estimate, multipliers: FloatArray) -> Anchored:
        """That anchored where the problem is."""
        return Anchored(problem, estimate, symmetric(multipliers), problem.anchor)

    @cached_property
    def forces(self) -> EdgeForces:
        """The edges' forces."""
        return EdgeForces.of(self.problem.graph, self.estimate)

    @cached_property
    def rows(self) -> tuple[FloatArray, FloatArray]:
        """G (N, d), zero in the rows of p, and bounds (N,) on the errors of its rows' norms."""
        problem, d = self.problem, self.problem.d
        G = np.swapaxes(problem.gradient(self.estimate), 1, 2).copy()
        G[:, -d:] -= self.multipliers @ np.swapaxes(self.estimate.rotations, 1, 2)
        turn, move = self._errors
        errors = np.tile(turn[:, None], (1, G.shape[1]))
        if G.shape[1] > d:
            errors[:, 0] = move
        G[self.anchor] = errors[self.anchor] = 0.0
        layout = problem.pattern.layout_of(problem.matrix)
        return layout.pack(G), layout.pack(errors)

    @property
    def _errors(self) -> tuple[FloatArray, FloatArray]:
        """(n,) bounds on the errors of a node's block of S V, for its rotation and translation."""
        f, graph, n = self.forces, self.problem.graph, self.problem.n
        # A product of d terms each, and the distance of rotations from SO(d).
        own = rotation_defect(self.estimate.rotations)
        turn, move = f.turn, np.zeros(n)
        at_i = at_j = f.turn_error + (32.0 * U + own) * turn
        size_i = size_j = turn
        if graph.has_positions:
            pull_error = f.pull_error + 16.0 * U * f.pull
            lever, arm = _lengths(graph)
            at_i, size_i = at_i + pull_error * lever, size_i + f.pull * lever
            at_j, size_j = at_j + pull_error * arm, size_j + f.pull * arm
            move = self._summed(f.pull, f.pull, pull_error, pull_error)
        held = np.linalg.norm(self.multipliers, axis=(1, 2))
        return UP * (self._summed(size_i, size_j, at_i, at_j) + (own + 32.0 * U) * held), UP * move

    def _summed(
        self, size_i: FloatArray, size_j: FloatArray, at_i: FloatArray, at_j: FloatArray
    ) -> FloatArray:
        """(n,) errors of sums of terms, in any order, from the terms' sizes and errors."""
        n, (i, j) = self.problem.n, self.problem.graph.edges.T
        terms = np.bincount(np.concatenate([i, j]), minlength=n) + 4.0
        sizes = scatter_sum(i, size_i, n) + scatter_sum(j, size_j, n)
        return scatter_sum(i, at_i, n) + scatter_sum(j, at_j, n) + 2.0 * U * terms * sizes

    def closed(self, definite: FloatArray) -> FloatArray:
        """(n, d, d) multipliers that make S >= 0, where S_rr >= diag(``definite``) > 0, (N,).

        Their traces add up to F less |C^-1/2 G|_F^2, but for rounding.
        """
        problem, d, R = self.problem, self.problem.d, self.estimate.rotations
        others = problem.poses[problem.poses != self.anchor]
        Lam, turns, own = self.multipliers[others], R[others], rotation_defect(R)
        held = (turns @ Lam @ np.swapaxes(turns, 1, 2)).sum(axis=0)
        size = float(np.linalg.norm(Lam, axis=(1, 2)).sum())
        G, errors = self.rows
        kept = definite > 0.0
        lost = G[kept].T @ (G[kept] / definite[kept, None])
        moment, there = self.forces.moment - held - lost, R[self.anchor]
        total = size + sum(float(np.linalg.norm(A)) for A in (self.forces.moment, held, lost))
        error = self.forces.moment_error + (2.0 * own + (len(definite) + 128.0) * 2.0 * U) * total
        error += float((2.0 * errors[kept] * self.norms[kept] / definite[kept]).sum())
        proven = self.multipliers.copy()
        own_multiplier = symmetric((there.T @ moment @ there)[None])[0]
        proven[self.anchor] = own_multiplier - UP * error * np.eye(d)
        return proven

    @cached_property
    def norms(self) -> FloatArray:
        """(N,) upper bounds on the norms of the rows of G."""
        G, errors = self.rows
        return np.asarray(UP * (np.linalg.norm(G, axis=1) + errors))

    def definite_for(self, loss: float) -> FloatArray:
        """(N,) the smallest diagonal of C, in the norm that counts most, with that `loss`."""
        return np.asarray(self.norms * (self.norms.sum() / loss))
