"""Bounds that trust no factorization, with the data that the checker needs to verify them.

The checker measures the residual of its own factorization. What each of its rows requires is
subtracted, with a margin, from the multipliers (rotations) or from the diagonal before factorizing
(translations, compensated by the rotations through the gauge), until the checker accepts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from certpgo import checker
from certpgo.certify.dual import DualBound
from certpgo.certify.multipliers import Shifted
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Point
from certpgo.io.exact import quaternion
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.blocks import scatter_sum
from certpgo.linalg.rotations import rotation_defect
from certpgo.linalg.threads import one_thread
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic

#: First shift tried, in units of rounding of the mean diagonal (for poses, times the growth), and
#: its growth per attempt.
FIRST_SHIFT, GROWTH = 0.25, 8.0
#: Number of shifts tried before the fallback multipliers.
SHIFTS = 5
#: Initial amount per row, in units of rounding of its diagonal entry; a row that lacks more gets
#: this multiple of the missing amount in the next round.
UNITS, MARGIN = 0.05, 1.5
#: A row below this multiple of its requirement gets twice as much in the next round; the rotations
#: compensate this multiple of the translations' amounts.
SAFETY = 1.2
ROUNDS = 10


@dataclass(frozen=True, eq=False)
class Witness:
    """The untrusted data, besides the multipliers, with which a lower bound is verified.

    Attributes
    ----------
    order : (n,) elimination order of the nodes
    delta : (n b,) subtracted from the equilibrated certificate matrix's diagonal before
        factorizing; here, points have rows of rotations too
    pin : the pose whose translation is pinned; 0 for rotations alone, or the reference
    exponent : base-2 exponent of the translations' weights in row sums
    """

    order: checker.Ints
    delta: FloatArray
    pin: int
    exponent: int


@one_thread
def prove(
    problem: Quadratic,
    graph: checker.Graph,
    point: Point,
    fallback: FloatArray | None = None,
    *,
    spare: FloatArray | None = None,
    reference: int | None = None,
) -> tuple[FloatArray, Witness] | None:
    """Multipliers Lam' (n, d, d) with a witness that F* >= tr(Lam'); None if there are none.

    Of general edges, F is what the checker's terms add up to: for those of
    `checker.surrogate`, kappa I takes the place of polar factors on the diagonal.

    Parameters
    ----------
    graph : the problem's measurements, to the last bit
    point : stationary, of any rank, to more digits than descents for other purposes have, as of
        `certpgo.optimize.descent.rested`
    fallback : less sharp multipliers, e.g. of another point if the relaxation is loose
    spare : (n,) by which multipliers of unknown scales are raised, so that those without it leave
        a matrix that exceeds a positive semidefinite one by as much there
    reference : a pose to pin and to eliminate last, so that distances seen from it can be claimed
    """
    point = problem.with_optimal_translations(point)
    prover = _Prover(problem, graph, point, spare, reference)
    shift = prover.first_shift
    for _ in range(SHIFTS):
        found = prover.settle(partial(prover.shifted.less, shift))
        if found is not None:
            return found
        shift *= GROWTH
    if fallback is None:
        return None
    other = recentred(problem, graph, fallback)
    return prover.settle(lambda _: other)


def proposed(
    problem: Quadratic,
    graph: checker.Graph,
    point: Point,
    fallback: FloatArray | None = None,
    *,
    reference: int | None = None,
) -> tuple[FloatArray, Witness]:
    """What `prove` tries first, untested, without a fallback."""
    point = problem.with_optimal_translations(point)
    return _Prover(problem, graph, point, reference=reference).proposal()


def proven_bound(
    problem: Quadratic, graph: checker.Graph, point: Estimate, bound: DualBound
) -> DualBound | None:
    """A bound of the standard tier, proven without trusting a factorization; None if that fails.

    The point is as of `prove`. The proof is about rotations from quaternions, the bound about the
    rotations nearest to the stored matrices. An edge adds the blocks -kappa (D, D^T) to the
    difference of their M, where |D| is at most the `distances`; this is bounded below by -kappa |D|
    on both nodes' diagonals.
    """
    weights = distances(graph, problem.rotation.graph.rotations) * graph.kappa
    if graph.scales is not None:
        weights = weights * graph.scales
    less = 1.001 * operators.degrees(problem.graph.edges, weights, problem.n)
    found = prove(problem, graph, point, bound.multipliers, spare=2.0 * less)
    if found is None:
        return None
    multipliers, rows, poses = found[0].copy(), np.arange(problem.d), problem.poses
    diagonal = np.nextafter(multipliers[poses][:, rows, rows] - less[poses, None], -np.inf)
    multipliers[poses[:, None], rows, rows] = diagonal
    loose, held = np.isin(poses, problem.held, invert=True), problem.held
    if any(math.fsum(row) < 0.0 for row in diagonal[loose].tolist()):
        return None
    value = problem.kinds.proven(diagonal[~loose])
    taken = np.einsum("naa->na", problem.multipliers(point)[held]) - diagonal[~loose]
    return replace(bound, value=value, multipliers=multipliers, shift=float(taken.max()))


def distances(graph: checker.Graph, R: FloatArray) -> FloatArray:
    """(m,) bounds on the distances of the graph's rotations from those nearest to matrices R."""
    taken = np.ldexp(graph.R.astype(np.float64), -checker.POINT)
    apart = np.linalg.norm(taken - R, axis=(1, 2))
    return np.asarray(apart + rotation_defect(R) + 8.0 * checker.U)


def exact_cost(problem: Quadratic, graph: checker.Graph, estimate: Estimate) -> float:
    """F of the estimate, rounded up; infinite beyond the range of doubles."""
    try:
        t = estimate.translations if problem.has_positions else None
        s = problem.scales.of(estimate) if problem.takes_scales else None
        return checker.upper_bound(graph, quaternions(estimate.rotations), t, s=s)
    except (checker.Refused, OverflowError):
        return math.inf


def proven_surrogate(
    problem: Quadratic,
    constants: FloatArray,
    point: Point,
    bound: DualBound,
) -> DualBound | None:
    """A bound on a surrogate's cost plus constants (m,), proven without trusting a factorization.

    The couplings, arms and weights are the data, to the last bit; None if that fails.
    """
    graph = exact_graph(problem)
    found = prove(problem, graph, point, bound.multipliers)
    if found is None:
        return None
    diagonal = np.einsum("naa->na", found[0])
    centre = np.repeat(-problem.graph.kappa, 2 * problem.d)
    total = math.fsum(np.concatenate([diagonal.ravel(), constants, centre]))
    # The exact ones are no larger.
    multipliers = recentred(problem, graph, found[0], -1.0)
    multipliers += _rounding_of_centres(problem, graph, found[0])[:, None, None] * np.eye(problem.d)
    taken = np.einsum("naa->na", problem.multipliers(point) - multipliers)
    value, shift = math.nextafter(total, -math.inf), float(taken.max())
    return replace(bound, value=value, multipliers=multipliers, shift=shift)


def recentred(
    problem: Quadratic, taken: checker.Graph, multipliers: FloatArray, sign: float = 1.0
) -> FloatArray:
    """Multipliers (n, d, d) where the checker's kappa I replaces polar factors, or the reverse."""
    graph, n = problem.rotation.graph, problem.n
    if not graph.is_general:
        return multipliers
    _, K, K_left = graph.polar
    centre = taken.kappa[:, None, None] * np.eye(problem.d)
    gained = scatter_sum(taken.i, centre, n) + scatter_sum(taken.j, centre, n)
    i, j = graph.edges.T
    return np.asarray(
        multipliers + sign * (gained - scatter_sum(i, K_left, n) - scatter_sum(j, K, n))
    )


def _rounding_of_centres(
    problem: Quadratic, taken: checker.Graph, multipliers: FloatArray
) -> FloatArray:
    """(n,) bounds on the norms of what `recentred` rounds."""
    graph, n, d = problem.rotation.graph, problem.n, problem.d
    if not graph.is_general:
        return np.zeros(n)
    weights = d * taken.kappa + np.trace(graph.polar[1], axis1=1, axis2=2)
    sizes = operators.degrees(graph.edges, weights, n) + np.abs(multipliers).sum(axis=(1, 2))
    terms = np.bincount(graph.edges.ravel(), minlength=n) + 8.0
    return np.asarray(2.0 * d * checker.U * terms * sizes)


class _Prover:
    """Residuals of one certificate matrix under different shifts; amounts are in units of A.

    They are of the checker's rows (n b,), where points have rows of rotations.
    """

    def __init__(
        self,
        problem: Quadratic,
        graph: checker.Graph,
        point: Point,
        spare: FloatArray | None = None,
        reference: int | None = None,
    ) -> None:
        self.problem, self.graph = problem, graph
        # A bound does not depend on the estimate in its proof.
        d, t = problem.d, point.translations
        identity = np.tile(np.eye(d), (problem.n, 1, 1))
        self.posed = Estimate(identity, None if t is None else np.zeros((problem.n, d)))
        shifted = Shifted.of(problem, point, reference)
        self.pin, order = shifted.pin or reference or 0, problem.order.astype(np.intp)
        self.order = order if reference is None else np.append(order[order != reference], reference)
        self.shifted = replace(shifted, multipliers=recentred(problem, graph, shifted.multipliers))
        self.first_shift = FIRST_SHIFT * shifted.unit * (1.0 if shifted.pin is None else GROWTH)
        self.layout = problem.pattern.layout_of(problem.matrix)
        self.diagonal = self.layout.unpack(problem.matrix.diagonal())
        if graph.points is not None:
            self.diagonal[graph.points, -d:] = 2.0 ** checker.magnitude(graph)
        self.left = self.diagonal.copy()  # of the certificate matrix
        self.left[:, -d:] -= np.einsum("naa->na", shifted.multipliers)
        moving = self.shifted.weights[~problem.rotation_rows]
        self.exponent = int(math.log2(moving[0])) if len(moving) else 0
        self.loose = np.setdiff1d(problem.poses, problem.held)
        self.spare = np.zeros_like(self.diagonal)
        if spare is not None:
            self.spare[self.loose, -d:] = spare[self.loose, None]

    def settle(
        self, multipliers: Callable[[FloatArray], FloatArray]
    ) -> tuple[FloatArray, Witness] | None:
        """Multipliers, reduced by the rotations' amounts, that the checker accepts.

        ``multipliers`` are a function of the translations' amounts, in the problem's rows (N,).
        """
        asked = self.first_amounts
        for _ in range(ROUNDS):
            less = self.without(multipliers(self.demand(asked)), asked)
            found = self.residual(less, asked)
            if found is None:
                return None
            if found.accepted:
                return less, found.witness
            asked = np.maximum(np.where(found.enough, 1.0, 2.0) * asked, found.wanted)
        return None

    @property
    def first_amounts(self) -> FloatArray:
        """What is asked for first."""
        return UNITS * checker.U * self.diagonal.ravel()

    def proposal(self) -> tuple[FloatArray, Witness]:
        """The multipliers and the witness with the first shift and the first amounts, untested."""
        asked = self.first_amounts
        less = self.without(self.shifted.less(self.first_shift, self.demand(asked)), asked)
        exponents, normal = np.frexp(self.left.ravel())[1], checker.magnitude(self.graph)
        # As the checker equilibrates it.
        delta = np.ldexp(asked, 2 * ((normal - exponents) >> 1) - normal)
        return less, Witness(self.order, delta, self.pin, self.exponent)

    def demand(self, asked: FloatArray) -> FloatArray:
        """The translations' amounts where rows ask for some."""
        return self.packed(SAFETY * asked + self.spare.ravel())

    def packed(self, amounts: FloatArray) -> FloatArray:
        """Amounts of the problem's rows (N,)."""
        return self.layout.pack(amounts.reshape(self.diagonal.shape))

    def without(self, multipliers: FloatArray, asked: FloatArray) -> FloatArray:
        """The multipliers, their diagonals reduced by the rotations' amounts; points have none.

        Those of unknown scales are raised by what is to spare.
        """
        less, rows, d = multipliers.copy(), np.arange(self.problem.d), self.problem.d
        amounts = self.packed(asked)[self.shifted.is_rotation].reshape(-1, d)
        less[self.problem.held[:, None], rows, rows] -= amounts
        less[self.loose[:, None], rows, rows] += self.spare[self.loose, -d:]
        return less

    def residual(self, multipliers: FloatArray, asked: FloatArray) -> _Found | None:
        """The checker's residual when ``asked`` is subtracted before factorizing."""
        blank = Witness(self.order, np.zeros(self.diagonal.size), self.pin, self.exponent)
        proof = proof_of(self.posed, multipliers, blank)
        try:
            blocks = checker.certificate_matrix(self.graph, proof)
        except (checker.Refused, OverflowError):
            return None
        normal = checker.magnitude(self.graph)
        scale = np.ldexp(1.0, 2 * blocks.scales.ravel() - normal)  # of A's diagonal
        delta = (asked * scale).astype(np.float32).astype(np.float64)
        left = checker.residual(blocks, self.order, delta)
        if left is None:
            return None
        short = left.needed - (left.diagonal - delta)
        wanted = MARGIN * np.maximum(short, 0.0) / scale
        enough = left.diagonal >= SAFETY * left.needed
        accepted = bool(np.all(left.diagonal >= left.needed))
        return _Found(accepted, enough, wanted, replace(blank, delta=delta))


@dataclass(frozen=True, eq=False)
class _Found:
    """Whether it is accepted, which rows have enough, the amounts they require, the witness."""

    accepted: bool
    enough: BoolArray
    wanted: FloatArray
    witness: Witness


def exact_graph(problem: Quadratic) -> checker.Graph:
    """The problem's measurements as the checker represents them."""
    graph = problem.rotation.graph
    (i, j), m = graph.edges.T.astype(np.intp), graph.num_edges
    t, tau, points = np.zeros((m, graph.d)), np.ones(m), None
    if problem.has_positions:
        t, tau = problem.graph.translations, problem.graph.tau
        points = problem.graph.is_point if problem.graph.is_point.any() else None
    R, q, N = None, None, graph.couplings
    if N is None:
        q = quaternions(graph.rotations)
        R = checker.rotations(q)
    exact = checker.Graph(graph.num_nodes, i, j, R, t, graph.kappa, tau, N, q, points=points)
    exact = exact._replace(arms=problem.graph.arms)
    if problem.takes_scales:
        of = cast("Any", problem.graph)
        return exact._replace(scales=of.scales, free=of.free)
    return exact


def quaternions(R: FloatArray) -> FloatArray:
    """Unit quaternions (k, 4) of rotations (k, 3, 3), half-angle pairs (k, 2) of (k, 2, 2)."""
    q = quaternion.to_write(R)
    return q if R.shape[-1] == 3 else q[:, [3, 2]]


def proof_of(
    point: Estimate,
    multipliers: FloatArray,
    witness: Witness,
    minorants: checker.EdgeBounds | None = None,
) -> checker.Proof:
    """A proof in the checker's representation."""
    rows, columns = np.triu_indices(point.d)
    return checker.Proof(
        quaternions(point.rotations),
        point.translations,
        multipliers[:, rows, columns],
        witness.order,
        witness.delta,
        witness.pin,
        witness.exponent,
        minorants,
    )
