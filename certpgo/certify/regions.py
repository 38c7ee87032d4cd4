"""Where all estimates of low cost are, in metres and degrees.

Let S = M - blkdiag(0, Lam) >= 0 prove the bound v, so that the cost of any point is at least
v + |X|_S^2, however far away. Two estimates, moved so that they agree at one pose, the reference,
differ by D, and |D|_S <= rho, the sum of the roots of their costs less v. For G the block of a node
in A^-1, where A is S without the rows of the reference, its pose relative to that differs by
U = [u V], u in position and V = R - R' by an angle theta, with tr(U G^-1 U^T) <= rho^2, so

    |u|^2 <= rho^2 G_tt,      8 sin^2(theta / 2) <= rho^2 2 g1 g2 / (g1 + g2),

g1 >= g2 the two largest eigenvalues of G_RR. Neither estimate need be stationary. A pose of unknown
scale has V = s R - s' R', so that for b = rho^2 g1 and s' the scale of one of the two

    d (s - s')^2 <= b,      4 sin^2(theta / 2) <= d (1 - sqrt(1 - b / (d s'^2))) if b < d s'^2.

Any smaller Lam will do. Where the bound is loose, S is singular beyond its gauge, and A almost; a
shift of Lam, for which v is smaller by the shift of its trace, is then better.

Distances and angles add up: an estimate that costs much more than the best one known is no further
from an optimum than from that one, and that one from the optimum.

See docs/how-to/how_far_can_i_be_off.md.

Rounding: A - C is factorized, with a diagonal C above what rounding may be off by. So A is at least
the product of the computed factors, exactly, and G at most its inverse's block; that is computed
with bounds on rounding, too, see `certpgo.linalg.selected_inverse`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from certpgo.certify.dual import AMPLE, CONFIRMATIONS, Attempts, DualBound
from certpgo.certify.region import ProvenDistance, Region, seen_from
from certpgo.certify.tolerances import difference_up
from certpgo.errors import InputError, NumericalError, require
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.kinds import Node
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, frozen_floats
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.residual import measured_residual
from certpgo.linalg.rounding_bound import is_cholesky, rounding_of_factor
from certpgo.linalg.selected_inverse import diagonal_blocks
from certpgo.objective.quadratic import Quadratic

#: What is taken off the diagonal, over what rounding was.
COVER = 2.5
#: Relative gap from which a bound is loose, and the shifts that are tried, over that which doubles
#: the gap.
LOOSE, SHIFTS = 1e-5, (0.0, 0.02, 1.0)
#: (n,) metres, degrees and differences of scales.
Limits = tuple[FloatArray, FloatArray, FloatArray]
#: Rounding of the last few operations.
UP = 1.0 + 64.0 * U


@dataclass(frozen=True, eq=False, repr=False)
class Regions(Brief):
    """What a bound says of where estimates of low cost are, computed when it is asked for.

    Attributes
    ----------
    bound : a proven one
    estimate : the one in the centre
    cost : upper bound on its cost
    best : the best estimate known
    known : upper bound on its cost, no larger
    point : an estimate near a minimum, to judge sizes by
    anchor : the reference, if none is named: the pose of known scale whose measurements weigh most
    unit : of these costs, a power of two
    measures : whether the residual of the factorization is measured, not bounded a priori
    """

    bound: DualBound
    estimate: Estimate
    cost: float
    best: Estimate
    known: float
    point: Estimate
    anchor: int
    unit: float
    measures: bool

    @property
    def form(self) -> Quadratic:
        """The problem whose cost, plus a constant, is nowhere above."""
        return self.bound.form

    def distance(
        self, reference: int | None = None, excess: FloatArray | None = None
    ) -> ProvenDistance | None:
        """How far all nodes can be from every optimum, or from every estimate of low cost.

        None if that cannot be proven, or if no estimate costs as little.

        Parameters
        ----------
        reference : by default the anchor
        excess : (n,) as of `region`, for each node; None for optima

        Raises
        ------
        InputError
            There is no such pose, or its scale is unknown.
        """
        reference = self._pose(reference)
        most = np.full(self.form.n, self.known) if excess is None else self._at_most(excess)
        found = [
            self._limits(self.apart(self.cost, most, v), G, self.estimate)
            for G, v in self._inverses_for(reference, most)
        ]
        if not found:
            return None
        if self.best is not self.estimate:
            found += self._by_the_best(reference, most)
        metres, degrees, scales = (
            frozen_floats(np.min(columns, axis=0)) for columns in zip(*found, strict=True)
        )
        return ProvenDistance(
            reference,
            metres if self.form.has_positions else None,
            degrees,
            scales if self.form.takes_scales else None,
        )

    def region(self, node: int, reference: int | None = None, excess: float = 0.0) -> Region | None:
        """Where a node is in every estimate that costs at most ``excess`` more than this one.

        None if that cannot be proven, or if no estimate costs as little.

        Parameters
        ----------
        reference : as for `distance`
        excess : in the units of the graph's cost

        Raises
        ------
        InputError
            There is no such node or pose, the node is the reference itself, or the excess is not
            finite.
        """
        node, reference = self._node(node), self._pose(reference)
        require(excess, Real, "an excess over the cost")
        if node == reference:
            raise InputError(f"node {node} is the reference itself")
        if not math.isfinite(excess):
            raise InputError(f"the excess over the cost must be finite, not {excess}")
        most = self._at_most(np.full(self.form.n, float(excess)))
        regions = [
            self._region(node, reference, self.apart(self.cost, most, v), G)
            for G, v in self._inverses_for(reference, most)
        ]
        return min(regions, key=lambda one: (one.metres or 0.0, one.degrees), default=None)

    def _region(self, node: int, reference: int, rho: FloatArray, G: FloatArray) -> Region:
        form, (metres, degrees, scales) = self.form, self._limits(rho, G, self.estimate)
        position, rotation = seen_from(self.estimate, node, reference)
        is_point = bool(form.graph.is_point[node])
        size = G.shape[1] - (form.d if is_point else 0)
        return Region(
            node,
            reference,
            position if form.has_positions else None,
            None if is_point else rotation,
            float(metres[node]) if form.has_positions else None,
            float(degrees[node]),
            float(scales[node]),
            frozen_floats(UP * rho[node] ** 2 * G[node, :size, :size]),
        )

    def _at_most(self, excess: FloatArray) -> FloatArray:
        """(n,) the cost plus what is given in the units of the graph's, rounded up."""
        most = self.cost + excess / self.unit
        return np.asarray(most + 4.0 * U * (np.abs(most) + self.cost))

    def apart(self, cost: float, most: FloatArray, v: float) -> FloatArray:
        """(n,) upper bounds on the distance from all that costs at most ``most``, in S's seminorm.

        Parameters
        ----------
        cost : of the estimate in the centre
        most : (n,) in its units
        v : the bound that S proves
        """
        own = math.sqrt(max(difference_up(cost, v), 0.0))
        others = np.maximum((most - v) + U * np.abs(most - v), 0.0)  # exact but for the last bit
        return np.asarray(UP * (own + np.sqrt(others)))

    def _inverses_for(self, reference: int, most: FloatArray) -> list[tuple[FloatArray, float]]:
        """What is known of A^-1; nothing if no estimate costs as little."""
        is_cost = (most >= self.bound.value) & (most < math.inf)
        return self._inverses(reference) if is_cost.all() else []

    def _node(self, node: int) -> int:
        node = _number(node)
        if not 0 <= node < self.form.n:
            raise InputError(f"node {node} is not among 0 to {self.form.n - 1}")
        return node

    def _pose(self, reference: int | None) -> int:
        """A pose of known scale."""
        form = self.form
        if reference is None:
            return self.anchor
        reference = _number(reference)
        if reference not in form.poses:
            raise InputError(f"node {reference} is none of the poses")
        if form.graph.nodes[reference] not in (Node.POSE, Node.ROTATION):
            raise InputError(f"node {reference} is no reference: poses of known scale are")
        return reference

    def _by_the_best(self, reference: int, most: FloatArray) -> Iterator[Limits]:
        """The same limits as by the distance to the best estimate, and from there."""
        between = self._between(reference)
        for G, v in self._inverses_for(reference, most):
            beyond = self._limits(self.apart(self.known, most, v), G, self.best)
            metres, degrees, scales = (
                UP * (one + other) for one, other in zip(between, beyond, strict=True)
            )
            yield metres, np.minimum(degrees, 180.0), scales

    def _between(self, reference: int) -> Limits:
        """(n,) by how far, by which angle and scale nodes differ from the best estimate at most."""
        form, pair = self.form, (self.estimate, self.best)
        frames = [one.rotations[reference] for one in pair]
        defects = [so.rotation_defect(one.rotations) for one in pair]
        turned = [R.T @ one.rotations for R, one in zip(frames, pair, strict=True)]
        off = 2.0 * sum(defects) + 64.0 * U
        size = np.linalg.norm(turned[1] - turned[0], axis=(1, 2)) + off
        degrees = np.degrees(2.0 * np.arcsin(np.minimum(UP * size / math.sqrt(8.0), 1.0)))
        rigid = np.isin(form.graph.nodes, (Node.POSE, Node.ROTATION, Node.SCALED))
        degrees = np.where(rigid, UP * degrees, np.where(form.graph.is_point, 0.0, 180.0))
        metres, scales = np.zeros(form.n), np.zeros(form.n)
        if form.has_positions:
            there = [one.translations - one.translations[reference] for one in pair]  # type: ignore[index]
            lengths = [np.linalg.norm(t, axis=1) for t in there]
            u = there[1] @ frames[1] - there[0] @ frames[0]
            far = max(float(np.abs(one.translations).max()) for one in pair)  # type: ignore[arg-type]
            off_t = sum(
                (own + 64.0 * U) * length for own, length in zip(defects, lengths, strict=True)
            )
            metres = UP * (np.linalg.norm(u, axis=1) + off_t + 16.0 * U * far)
        if form.takes_scales:
            sizes = [form.scales.of(one) for one in pair]
            scales = UP * np.abs(sizes[1] - sizes[0])
        for of in (metres, degrees, scales):
            of[reference] = 0.0
        return metres, degrees, scales

    def _limits(self, rho: FloatArray, G: FloatArray, centre: Estimate) -> Limits:
        """(n,) metres, degrees and differences of scales for rho (n,) and blocks (n, b, b)."""
        form, d, square = self.form, self.form.d, UP * rho * rho
        turned, nodes, p = G[:, -d:, -d:], form.graph.nodes, G.shape[1] - d
        # Over complex numbers u has two rows of one length: the trace of their inverse counts.
        metres = UP * np.sqrt(square * np.einsum("naa->n", G[:, :p, :p])) / max(p, 1)
        degrees = np.where(nodes == Node.POINT, 0.0, 180.0)
        rigid, scaled = np.isin(nodes, (Node.POSE, Node.ROTATION)), nodes == Node.SCALED
        degrees[rigid] = _degrees(square[rigid], turned[rigid])
        scales = np.zeros(len(G))
        if scaled.any():
            sizes = form.scales.of(centre)[scaled]
            scales[scaled], degrees[scaled] = _of_scales(square[scaled], turned[scaled], sizes)
        return metres, degrees, scales

    def _inverses(self, reference: int) -> list[tuple[FloatArray, float]]:
        """Bounds v with (n, b, b) upper bounds on the blocks of A^-1, zero for the reference."""
        known, key = self.bound.inverses, (reference, self.measures)
        if key not in known:
            found, gap = list[tuple[FloatArray, float]](), self.known - self.bound.value
            for share in SHIFTS if gap > LOOSE * self.known else SHIFTS[:1]:
                multipliers, v = self._shifted(share * gap)
                with suppress(NumericalError, np.linalg.LinAlgError):
                    G = self._inverse(reference, multipliers)
                    if G is not None and np.isfinite(G).all():
                        G[reference] = 0.0
                        found.append((G, v))
            known[key] = found
        return known[key]

    def _shifted(self, taken: float) -> tuple[FloatArray, float]:
        """Multipliers (n, d, d), less about ``taken`` of the bound, and the bound they prove."""
        form, v = self.form, self.bound.value
        multipliers, rows, held = self.bound.multipliers.copy(), np.arange(form.d), form.held
        if not taken > 0.0:
            return multipliers, v
        before = multipliers[held][:, rows, rows]
        multipliers[held[:, None], rows, rows] = after = before - taken / before.size
        old, new = form.kinds.proven(before), form.kinds.proven(after)
        return multipliers, v + (new - old) - 16.0 * U * (abs(old) + abs(new) + abs(v))

    def _inverse(self, reference: int, multipliers: FloatArray) -> FloatArray | None:
        """Bounds on the blocks of A^-1; None if A is not definite beyond rounding."""
        form = self.form
        attempts = Attempts(form, self.point, True, -math.inf, False)
        pin, w = attempts.rows_of(reference), attempts.weights
        foretold = attempts.foretold(attempts.matrix(multipliers, np.zeros(0), pin), pin)
        demand = attempts.compensation(AMPLE * w * foretold, multipliers, pin)
        for _ in range(CONFIRMATIONS):
            A = attempts.matrix(multipliers, demand, pin)
            factor = attempts.symbolic.factor(A)
            if factor is None:
                return None
            L, rows = factor.lower()
            found, squares = rounding_of_factor(L, rows, w)
            if not is_cholesky(squares, A):
                return None
            # Measured, nothing is assumed of the factorization.
            sums = measured_residual(A, L, rows, w) if self.measures else found
            if sums is None:
                return None
            rounding = attempts.compensation(sums, multipliers, pin)
            if (rounding <= demand).all():
                layout = form.pattern.layout_of(form.matrix)
                return diagonal_blocks(L, rows, layout, above=True)
            demand = np.maximum(demand, COVER * rounding)
        return None


def _number(node: int) -> int:
    require(node, Integral, "the number of a node")
    if isinstance(node, bool):
        raise InputError(f"the number of a node expected, not {node}")
    return int(node)


def _of_scales(
    square: FloatArray, G: FloatArray, sizes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(k,) differences of scales and angles for rho^2 and the blocks (k, d, d) of s R."""
    d = G.shape[1]
    largest = np.linalg.eigvalsh(G)[:, -1] + 64.0 * U * np.einsum("naa->n", G)
    share = UP * square * np.maximum(largest, 0.0) / (d * sizes**2)
    bend = 0.25 * d * UP * share / (1.0 + np.sqrt(np.maximum(1.0 - share, 0.0)))
    known = (share < 1.0) & (bend < 1.0)
    angles = 2.0 * np.arcsin(np.sqrt(np.minimum(bend, 1.0)))
    return UP * sizes * np.sqrt(share), np.where(known, UP * np.degrees(angles), 180.0)


def _degrees(square: FloatArray, G: FloatArray) -> FloatArray:
    """(n,) angles for rho^2 and the blocks (n, d, d) of rotations."""
    values = np.linalg.eigvalsh(G)
    sizes = np.einsum("naa->n", G)
    first, second = (np.maximum(values[:, k], 0.0) + 64.0 * U * sizes for k in (-1, -2))
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(sizes > 0.0, first * second / (first + second), 0.0)
    share = UP * 0.25 * square * mean  # of 8
    angles = 2.0 * np.arcsin(np.sqrt(np.minimum(share, 1.0)))
    return np.where(share < 1.0, UP * np.degrees(angles), 180.0)
