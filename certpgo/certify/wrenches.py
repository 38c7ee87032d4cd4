"""Optimality of poses by cycles: residual wrenches as a sum of cycles of matrix springs.

At an estimate (R_i, p_i) an edge has the residual eps = p_j - p_i - R_i t_ij, the force
g = tau eps, and E and phi of `certpgo.certify.cycles`. A row of another estimate is
t_i = s_i + p_i.y_i and y_i^T R_i; with z_i = (s_i, y_i), (zeta, eta) = z_j - z_i,

    sigma = zeta + p_j.eta,    Q_e = tau sigma^2 - sigma g.eta + kappa eta^T sym(E) eta,
    2 z_i^T Om_e z_j = s_j g.y_i - s_i g.y_j + 2 psi.(y_i x y_j),    psi = phi - p_j x g / 2.

If the wrenches Om_e are a sum of cycles whose folds of matrix springs pass, and Q_e is at least the
sum of its springs, the estimate is a global optimum of F. For any estimate, and cycles that pass,
with Q'_e - sum_C Q_eC >= a_e sigma^2 + b_e |eta|^2, where g', phi' and Q'_e are of the cycles' sum,

    F* >= F - sum_e |g_e - g'_e|^2 / a_e + 4 (sqrt(b_e^2 + |phi_e - phi'_e|^2) - b_e).

Statements and proofs are in docs/concepts/bounds.md. The bound is computed in fractions, from
numbers that a semidefinite program finds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from certpgo import cycle_checker
from certpgo.certify.cycles import SOLVED, of_matrices, root_up
from certpgo.certify.tolerances import ATOL, FLOOR, RTOL, allowed
from certpgo.certify.wrench_program import split_wrenches
from certpgo.errors import InputError, require
from certpgo.graph import Estimate
from certpgo.graph.cycles import Cycles, cycle_list
from certpgo.graph.display import Brief
from certpgo.io.exact import quaternion
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import NO_SCALES, Quadratic

#: Cycles in the list, at most, unless a basis has more; seconds after which the solver gives up.
MOST, PATIENCE = 400, 120.0
#: Bits after the point of stored numbers, and of springs in series, in units of the weights.
BITS, FINE = 44, 80
#: Shares of what is left of an edge: for its springs, and for the bound.
SHARE, KEPT = 0.5, 0.25

Matrix = list[list[Fraction]]


@dataclass(frozen=True, eq=False, repr=False)
class WrenchProof(Brief):
    """What cycles prove of poses.

    Attributes
    ----------
    proven : whether the lower bound is as close to the cost as that of CERTIFIED
    reason : why not; empty if proven
    margin : the largest t with Q_e - sum_C Q_eC >= t (tau sigma^2 + kappa |eta|^2) on all edges, as
        the solver found it: positive where the split succeeds
    cost : F of the estimate, rounded up
    lower_bound : at most F*, by exact arithmetic
    cycles : the closed walks
    shares : (p,) for each step of each cycle the share of the edge's wrench that it carries, in the
        unit of the weights; those of an edge add up to 1
    """

    proven: bool
    reason: str
    margin: float
    cost: float
    lower_bound: float
    cycles: Cycles
    shares: FloatArray

    def holding(self, edge: int) -> dict[int, float]:
        """The cycles that hold an edge, with the share of its wrench that each carries."""
        at = np.flatnonzero(self.cycles.edges == edge)
        owners = self.cycles.owners[at].tolist()
        found = zip(owners, self.shares[at].tolist(), strict=True)
        return dict(sorted(found, key=lambda pair: -abs(pair[1])))


def prove_poses(
    problem: Quadratic, estimate: Estimate, *, most: int = MOST, seconds: float = PATIENCE
) -> WrenchProof:
    """Try to prove by cycles that an estimate of poses is optimal.

    For a proof it is stationary. The work is that of a semidefinite program with a cone of side
    2 (d + 1) for each step of each cycle: for graphs of some hundred edges.

    Parameters
    ----------
    most : cycles of the list: a basis, and all of length 2, then 3 to 6, while they are not more
    seconds : after which the solver gives up

    Raises
    ------
    InputError
        An estimate of another graph; a graph without positions, with points, nodes of unknown
        scale, or edges that are not relative poses of isotropic weights.
    """
    require(problem, Quadratic, "the chordal problem of a graph")
    if problem.takes_scales:
        raise InputError(NO_SCALES)
    graph = problem.graph
    if not problem.has_positions or graph.is_point.any() or graph.is_general:
        said = "proofs by cycles of wrenches are about relative poses of isotropic weights"
        raise InputError(f"{said}; certpgo.certify.cycles is about the rotations of other graphs")
    problem.check(estimate)
    exact = _Exact(problem, estimate)
    cycles = cycle_list(problem.n, graph.edges, most)
    springs, wrenches = exact.forms()
    units = exact.units()
    split = split_wrenches(cycles, springs, wrenches, units, seconds)
    turned = np.swapaxes(units, 1, 2) @ wrenches @ units
    carried = np.swapaxes(units, 1, 2)[cycles.edges] @ split.wrenches[cycles.owners]
    carried = cycles.signs[:, None, None] * (carried @ units[cycles.edges])
    size = (turned**2).sum(axis=(1, 2))
    shares = (carried * turned[cycles.edges]).sum(axis=(1, 2))
    shares = np.divide(shares, size[cycles.edges], where=size[cycles.edges] > 0.0, out=0.0 * shares)
    cost, bound = exact.cost(), Fraction(0)
    reason = "" if split.status in SOLVED else f"the solver says {split.status}"
    if not reason and split.margin <= 0.0:
        reason = f"the cycles ask for more than the edges have, by {-split.margin:.3g} of weights"
    if not reason:
        used = np.bincount(cycles.edges, minlength=graph.num_edges)
        spare = SHARE * split.margin / np.maximum(used, 1)
        weights = exact.weights()
        stiff = split.springs + (spare[:, None, None] * weights)[cycles.edges]
        found = exact.bound(cycles, split.wrenches, stiff, KEPT * split.margin)
        bound, reason = (found, "") if found is not None else (bound, "rounded springs do not pass")
    upper, lower = of_matrices(cost, bound, graph.rotations, graph.kappa)
    scale = ATOL * problem.scale
    if not reason and upper - lower > max(allowed(upper, RTOL, scale), FLOOR * scale):
        reason = "the estimate is not stationary, or the solver's numbers are too inaccurate"
    return WrenchProof(not reason, reason, split.margin, upper, lower, cycles, shares)


class _Exact:
    """A graph and an estimate in fractions, in units of powers of two, from their middle."""

    def __init__(self, problem: Quadratic, estimate: Estimate) -> None:
        graph, R, t = problem.graph, estimate.rotations, estimate.translations
        if t is None:
            raise InputError("an estimate with positions expected")
        self.d, self.edges = graph.d, graph.edges
        kappa, tau = float(np.median(graph.kappa)), float(np.median(graph.tau))
        length = math.frexp(math.sqrt(kappa / tau))[1]
        self.weight = math.frexp(kappa)[1]
        self.p = np.rint(np.ldexp(t - t.mean(axis=0), BITS - length)) / 2.0**BITS
        self.t = np.ldexp(graph.translations, -length)
        self.kappa = np.ldexp(graph.kappa, -self.weight)
        self.tau = np.ldexp(graph.tau, 2 * length - self.weight)
        q = np.rint(np.ldexp(quaternion.to_write(R), BITS)).astype(np.int64).tolist()
        stated = quaternion.to_write(graph.rotations).tolist()
        measured, d = [cycle_checker.whole(row) for row in stated], self.d
        turns = [_rotation(row, d) for row in q]
        self.E: list[Matrix] = []
        self.eps: list[list[Fraction]] = []
        for k, (i, j) in enumerate(self.edges.tolist()):
            x, y, z, w = q[j]
            turned = cycle_checker.product(q[i], measured[k])
            self.E.append(_rotation(cycle_checker.product(turned, [-x, -y, -z, w]), d))
            step, here, there = (_fractions(v) for v in (self.t[k], self.p[i], self.p[j]))
            moved = [_dot(row, step) for row in turns[i]]
            self.eps.append([there[a] - here[a] - moved[a] for a in range(d)])

    def cost(self) -> Fraction:
        """F of the estimate, rounded to fractions."""
        total = Fraction(0)
        for E, eps, kappa, tau in zip(self.E, self.eps, self.kappa, self.tau, strict=True):
            turn = 2 * (self.d - sum(E[a][a] for a in range(self.d)))
            term = Fraction(kappa) * turn + Fraction(tau) * _dot(eps, eps)
            total += Fraction(math.ceil(term * 2**200), 2**200)
        return total * Fraction(2) ** self.weight

    def forms(self) -> tuple[FloatArray, FloatArray]:
        """Springs Q_e and wrenches Om_e in doubles, (m, d + 1, d + 1)."""
        d, p = self.d, self.p[self.edges[:, 1]]
        E, eps = np.array(self.E, dtype=float), np.array(self.eps, dtype=float)
        arm, tau = p - eps, self.tau[:, None]
        B = np.empty((len(E), d + 1, d + 1))
        B[:, 0, 0], B[:, 0, 1:], B[:, 1:, 0] = self.tau, tau * p, tau * arm
        B[:, 1:, 1:] = (
            tau[:, :, None] * arm[:, :, None] * p[:, None] + self.kappa[:, None, None] * E
        )
        T = np.swapaxes(B, 1, 2)
        return 0.5 * (B + T), 0.5 * (T - B)

    def units(self) -> FloatArray:
        """U with U^T W U = I, W of tau sigma^2 + kappa |eta|^2."""
        found = np.tile(np.eye(self.d + 1), (len(self.tau), 1, 1))
        found[:, 0, 1:] = -self.p[self.edges[:, 1]]
        found[:, :, 0] /= np.sqrt(self.tau)[:, None]
        found[:, :, 1:] /= np.sqrt(self.kappa)[:, None, None]
        return found

    def weights(self) -> FloatArray:
        """W of each edge."""
        inverse = np.linalg.inv(self.units())
        return np.asarray(np.swapaxes(inverse, 1, 2) @ inverse)

    def bound(
        self, cycles: Cycles, wrenches: FloatArray, springs: FloatArray, kept: float
    ) -> Fraction | None:
        """The lower bound; None where cycles or edges do not pass."""
        m, D = len(self.edges), self.d + 1
        force = [[[Fraction(0)] * D for _ in range(D)] for _ in range(m)]
        stiff = [[[Fraction(0)] * D for _ in range(D)] for _ in range(m)]
        rounded = [_rounded(Q) for Q in np.asarray(0.5 * (springs + np.swapaxes(springs, 1, 2)))]
        for c, wrench in enumerate(np.asarray(0.5 * (wrenches - np.swapaxes(wrenches, 1, 2)))):
            at, Om = range(*cycles.starts[c : c + 2]), _rounded(wrench)
            if not _passes([rounded[k] for k in at], Om):
                return None
            for k in at:
                e = int(cycles.edges[k])
                force[e] = _sum(force[e], Om, int(cycles.signs[k]))
                stiff[e] = _sum(stiff[e], rounded[k])
        total = Fraction(0)
        for e in range(m):
            loss = self._loss(e, force[e], stiff[e], Fraction(kept))
            if loss is None:
                return None
            total += Fraction(math.ceil(loss * 2**200), 2**200)
        return self.cost() - total * Fraction(2) ** self.weight

    def _loss(self, e: int, Om: Matrix, Q: Matrix, kept: Fraction) -> Fraction | None:
        d, tau, kappa = self.d, Fraction(self.tau[e]), Fraction(self.kappa[e])
        p, E = _fractions(self.p[self.edges[e, 1]]), self.E[e]
        g = [2 * Om[1 + a][0] for a in range(d)]
        moment = [-2 * x for x in _axial([row[1:] for row in Om[1:]])]
        lever = _cross(p, g)
        phi = [(x + y) / 2 for x, y in zip(moment, lever, strict=True)]
        # In sigma and eta: zeta = sigma - p.eta.
        own = [[tau, *(-x / 2 for x in g)]]
        own += [[-g[a] / 2, *(kappa * (E[a][b] + E[b][a]) / 2 for b in range(d))] for a in range(d)]
        by = [[Fraction(1), *(-x for x in p)]]
        by += [[Fraction(int(a == b)) for b in range(-1, d)] for a in range(d)]
        taken = _times(_transposed(by), _times(Q, by))
        left = _sum(own, taken, -1)
        a, b = kept * tau, kept * kappa
        for k in range(d + 1):
            left[k][k] -= b if k else a
        if not _is_definite(left):
            return None
        off = [tau * x - y for x, y in zip(self.eps[e], g, strict=True)]
        turned = [kappa * x - y for x, y in zip(_axial(E), phi, strict=True)]
        return _dot(off, off) / a + 4 * (root_up(b * b + _dot(turned, turned)) - b)


def _passes(springs: list[Matrix], Om: Matrix) -> bool:
    """The fold of springs around a cycle, with those in series rounded down."""
    P, D = springs[0], len(Om)
    for Q in springs[1:-1]:
        A, right = _sum(P, Q), _sum(Q, Om, -1)
        if (X := _solved(A, right)) is None:
            return False
        P = _sum(Q, _times(_sum(Q, Om), X), -1)
        P = [
            [Fraction(round(P[a][b] * 2**FINE) - D * (a == b), 2**FINE) for b in range(D)]
            for a in range(D)
        ]
    return _is_definite(_sum(P, springs[-1]))


def _solved(A: Matrix, right: Matrix) -> Matrix | None:
    """A^-1 times a matrix; None where A is not positive definite."""
    rows, n = [[*a, *b] for a, b in zip(A, right, strict=True)], len(A)
    for k in range(n):
        if rows[k][k] <= 0:
            return None
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    for k in reversed(range(n)):
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(k):
            rows[i] = [x - rows[i][k] * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [row[n:] for row in rows]


def _is_definite(A: Matrix) -> bool:
    return _solved(A, [[] for _ in A]) is not None


def _rotation(q: list[int], d: int) -> Matrix:
    """The rotation of a quaternion x y z w of any norm."""
    x, y, z, w = q
    same, cross = w * w - x * x - y * y - z * z, ((0, -z, y), (z, 0, -x), (-y, x, 0))
    norm = same + 2 * (x * x + y * y + z * z)
    return [
        [Fraction(2 * (q[a] * q[b] + w * cross[a][b]) + same * (a == b), norm) for b in range(d)]
        for a in range(d)
    ]


def _axial(A: Matrix) -> list[Fraction]:
    """The vector of the skew part, one number in the plane."""
    pairs = ((1, 0),) if len(A) == 2 else ((2, 1), (0, 2), (1, 0))
    return [(A[a][b] - A[b][a]) / 2 for a, b in pairs]


def _cross(x: list[Fraction], y: list[Fraction]) -> list[Fraction]:
    pairs = ((0, 1),) if len(x) == 2 else ((1, 2), (2, 0), (0, 1))
    return [x[a] * y[b] - x[b] * y[a] for a, b in pairs]


def _fractions(x: FloatArray) -> list[Fraction]:
    return [Fraction(v) for v in x.tolist()]


def _rounded(A: FloatArray) -> Matrix:
    return [[Fraction(round(x * 2.0**BITS), 2**BITS) for x in row] for row in A.tolist()]


def _sum(A: Matrix, B: Matrix, sign: int = 1) -> Matrix:
    return [[x + sign * y for x, y in zip(a, b, strict=True)] for a, b in zip(A, B, strict=True)]


def _transposed(A: Matrix) -> Matrix:
    return [list(row) for row in zip(*A, strict=True)]


def _times(A: Matrix, B: Matrix) -> Matrix:
    columns = _transposed(B)
    return [[_dot(row, column) for column in columns] for row in A]


def _dot(x: list[Fraction], y: list[Fraction]) -> Fraction:
    return sum((a * b for a, b in zip(x, y, strict=True)), Fraction(0))
