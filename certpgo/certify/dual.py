"""Proven lower bounds on F* from a point's multipliers, by one factorization.

For S = M - blkdiag(0, Lam') positive semidefinite, F* >= tr(Lam'). Lam' is the point's Lam less a
shift, and the factor itself shows how much shift rounding demands: a Cholesky factorization of A~
that ran to completion satisfies |A~ - L L^T| <= gamma |L| |L|^T entry by entry (Rump and Jeannerod
2014), hence A~ + diag(delta) >= 0 with delta = gamma (|L| |L|^T w) / w for any w > 0: see
`certpgo.linalg.rounding_bound`. The bound relies only on these weighted row sums, not on
single entries, where blocked triangular solves may exceed it. If they are too large to be useful,
the residual is measured instead (`Symbolic.residual`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from certpgo.certify.anchored import Anchored
from certpgo.certify.assembly_errors import assembly_errors
from certpgo.certify.multipliers import Shifted
from certpgo.graph import Estimate
from certpgo.graph.display import Brief
from certpgo.graph.relaxed_point import Point
from certpgo.linalg.arrays import CSC, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U
from certpgo.linalg.blocks import add_to_diagonal, pinned, with_entries
from certpgo.linalg.rounding_bound import OTHERS
from certpgo.objective.minorants import Minorants
from certpgo.objective.quadratic import Quadratic

#: Of an anchored bound: the largest loss over the cost that is tried first, and the factor by
#: which the second may be larger.
LOSSES = (1e-7, 30.0)
#: Share of a sufficient gap that an anchored bound may lose to its shift.
ENOUGH = 0.1
#: Share of the gap that suffices from which a loss to rounding counts in a sharp bound.
NOTICED = 0.01
#: First shift tried, in units of rounding of the mean diagonal; then this much more each time.
FIRST_SHIFT, GROWTH = 16.0, 8.0
#: In the same units, the largest shift due to rounding; beyond, it is an eigenvalue of S.
LARGEST_ROUNDING = 1e5
#: Bisection steps (on the logarithm) that sharpen a shift not due to rounding.
BISECTIONS = 6
#: Largest factor by which a measured residual improves on its bound.
MEASURING_GAIN = 1000.0
#: By which a measured residual is below its prediction at least.
SHARPER = 4.0
#: Factorizations at one shift: the translations' rounding is predicted, then confirmed.
CONFIRMATIONS = 8
#: Safety factor of the prediction over the measured value.
MARGIN = 1.25
#: Compensation over the demand: what is over keeps the matrix definite.
COVER = 1.05
#: Assumed ratio of |L| |L|^T to |A| in the prediction.
AMPLE = 4.75


#: By the reference, and whether residuals are measured: bounds that shifted multipliers prove, each
#: with (n, b, b) upper bounds on the inverse's blocks.
Inverses: TypeAlias = dict[tuple[int, bool], list[tuple[FloatArray, float]]]


@dataclass(frozen=True, eq=False, repr=False)
class Support(Brief):
    """What a bound on the cost of another program rests on.

    Attributes
    ----------
    minorants : of all measurements, some of which may not exist, for weights of order one
    point : a point of their surrogate's relaxation, whose multipliers gave the bound
    lowered : whether they are of a cost that is nowhere above it, but not the cost itself
    """

    minorants: Minorants
    point: Point
    lowered: bool = False


@dataclass(frozen=True, eq=False, repr=False)
class DualBound(Brief):
    """A lower bound on F* and the multipliers that prove it.

    Attributes
    ----------
    value : F* >= value
    multipliers : (n, d, d) Lam' with S = M - blkdiag(0, Lam') positive semidefinite; zero for
        points
    form : the problem whose matrix M is; its cost plus a constant is nowhere above the bounded cost
    shift : the largest amount taken off a diagonal entry of Lam
    factorizations : number of numeric factorizations
    nonzeros : nonzeros of the factor that proves it; 0 if rounding was not bounded
    support : what a bound on the cost of another program rests on; None for F
    loose : whether a negative eigenvalue of the certificate matrix weakened it, and not only
        rounding
    attained : the cost of the point whose multipliers gave it: what is missing to that, is rounding
        unless it is loose
    ambiguous : indices of rejected measurements whose prices are not part of it, ascending
    inverses : what `certpgo.certify.regions` knows of the inverse of the certificate matrix, which
        all estimates judged by this bound share
    """

    value: float
    multipliers: FloatArray
    form: Quadratic
    shift: float
    factorizations: int
    nonzeros: int
    support: Support | None = None
    loose: bool = False
    attained: float = math.inf
    ambiguous: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    # Of this very matrix: a copy with other multipliers has none.
    inverses: Inverses = field(default_factory=dict, init=False, repr=False)


def dual_bound(
    problem: Quadratic,
    point: Point,
    *,
    rounding: bool = True,
    enough: float = -math.inf,
    sharp: bool = True,
    tight: bool = False,
    floor: float = 0.0,
    given_up: float = 0.0,
) -> DualBound | None:
    """The best lower bound by the multipliers of ``point``; None if it is useless.

    Parameters
    ----------
    point : near-stationary, with translations optimal for its rotations; of any rank
    rounding : bound the factorization's rounding (standard tier) or ignore it (screening)
    enough : a sufficient value; if the a priori bound of the rounding misses it, the residual of a
        factor may be measured, see `certpgo.linalg.factor`
    sharp : sharpen a bound by another factorization even if it is sufficient
    tight : give up if rounding does not explain the shift, that is, if the certificate matrix has
        a negative eigenvalue
    floor : the value from which a bound is useful; below zero where weights may be negative
    given_up : the share of the multipliers that is left out, for a certificate matrix that exceeds
        a positive semidefinite one by this share of M
    """
    attempts = Attempts(problem, point, rounding, enough, sharp, floor, given_up)
    anchored = None
    if isinstance(point, Estimate) and attempts.loses_to_rounding():
        anchored = attempts.anchored(point)
    if anchored is not None and anchored.value >= attempts.expected(0.0):
        return anchored
    found = [bound for bound in (anchored, attempts.best(tight)) if bound is not None]
    return max(found, key=lambda bound: bound.value, default=None)


class Attempts:
    """Factorizations of one certificate matrix under different shifts."""

    def __init__(
        self,
        problem: Quadratic,
        point: Point,
        rounding: bool,
        enough: float,
        sharp: bool,
        floor: float = 0.0,
        given_up: float = 0.0,
    ) -> None:
        self.problem, self.rounding, self.enough, self.sharp = problem, rounding, enough, sharp
        self.floor = floor
        self.shifted = Shifted.of(problem, point)
        if given_up:
            fewer = problem.kinds.apply("admissible", (1.0 - given_up) * self.shifted.multipliers)
            self.shifted = replace(self.shifted, multipliers=fewer)
        self.is_rotation, self.weights = self.shifted.is_rotation, self.shifted.weights
        pin = self.shifted.pin
        self.pin: IntArray | None = None
        if pin is not None:
            sizes = problem.pattern.layout_of(problem.matrix).sizes
            self.pin = self.rows_of(pin)[: int(sizes.max()) - problem.d]
        self.symbolic = problem.symbolic(problem.matrix)
        self.cost = problem.cost(point)
        self.factorizations = self.nonzeros = 0
        self.unit = self.shifted.unit
        self.foreseen = (
            self.foretold(problem.matrix, self.pin) if rounding else np.zeros(len(self.weights))
        )
        # Subtracted from the translations' diagonal before the first factorization.
        self.guess = np.where(self.is_rotation, 0.0, AMPLE * self.foreseen)

    def rows_of(self, node: int) -> IntArray:
        """The rows of a node."""
        return self.problem.pattern.layout_of(self.problem.matrix).rows_of(node)

    def loses_to_rounding(self) -> bool:
        """Whether a bound by shifts is expected to lose much, and an anchored one may not."""
        if not self.rounding or len(self.shifted.arms) > self.problem.n:
            return False  # positions over complex numbers have two rows
        allowed = (NOTICED if self.sharp else 1.0) * (self.cost - self.enough)
        return self.cost - self.expected(FIRST_SHIFT * self.unit) > allowed

    def anchored(self, estimate: Estimate) -> DualBound | None:
        """The bound at an estimate whose gauge is taken out; None if S_rr is not definite.

        See `certpgo.certify.anchored`.
        """
        at = Anchored.of(self.problem, estimate, self.shifted.multipliers)
        pin = self.rows_of(at.anchor)
        A = pinned(self.problem.certificate_matrix(at.multipliers), pin)
        of_rounding = AMPLE * self.foretold(A, pin)
        cost = self.cost - self.floor
        least = min(0.5 * (self.cost - self.expected(FIRST_SHIFT * self.unit)), LOSSES[0] * cost)
        # What suffices at last: rounding leaves no smaller loss of a cost that is almost zero.
        most = ENOUGH * (self.cost - self.enough)
        losses = [least, LOSSES[1] * least, *([most] if LOSSES[1] * least < most < cost else [])]
        for loss in losses if least > 0.0 else ():
            demand = at.definite_for(loss)
            for _ in range(CONFIRMATIONS):
                rounding = self.rounding_of(at.multipliers, demand + of_rounding, False, pin)
                if rounding is None:
                    break
                definite = demand + of_rounding - rounding
                if (np.delete(definite, pin) > 0.0).all():
                    return self.of_multipliers(at.closed(definite))
                of_rounding = np.maximum(of_rounding, MARGIN * rounding)
        return None

    def expected(self, shift: float) -> float:
        """The bound that a shift is expected to give.

        One that is to be sharpened comes closer to the rounding than the first.
        """
        foreseen = self.foreseen if self.sharp else AMPLE * self.foreseen
        less = self.shifted.trace_of_less(shift, COVER * foreseen)
        return self.shifted.trace - less - float(foreseen[self.is_rotation].sum())

    def foretold(self, A: CSC, pin: IntArray | None) -> FloatArray:
        """(N,) predicted `rounding_of`, from the lengths of L's rows, for |L| |L|^T about |A|."""
        sizes = with_entries(A, np.abs(A.data)) @ self.weights
        foreseen = U * (self.symbolic.lengths + OTHERS) * sizes / self.weights
        if pin is not None:
            foreseen[pin] = 0.0
        return np.asarray(foreseen)

    def best(self, tight: bool) -> DualBound | None:
        """The bound by approximately the smallest shift that works."""
        rows = int(self.is_rotation.sum())
        explained = LARGEST_ROUNDING * self.unit
        useless = explained if tight else max(explained, (self.cost - self.floor) / rows)
        failed, shift = None, FIRST_SHIFT * self.unit * (1.0 if self.pin is None else GROWTH)
        bound = self.attempt(shift)
        while bound is None and shift < useless:
            failed = shift
            shift *= GROWTH if shift < explained else GROWTH**2
            bound = self.attempt(shift)
        if bound is None or failed is None or shift <= explained:
            return bound
        for _ in range(BISECTIONS):
            middle = math.sqrt(failed * shift)
            sharper = self.attempt(middle)
            if sharper is None:
                failed = middle
            else:
                shift, bound = middle, sharper
        return replace(bound, loose=True) if bound.value > self.floor else None

    def attempt(self, shift: float) -> DualBound | None:
        """The bound with ``shift`` on the rotations, plus the shift due to rounding."""
        measure = self.is_hopeless(shift)
        first = demand = self.guess / SHARPER if measure else self.guess
        best, generosity = None, COVER
        for _ in range(CONFIRMATIONS):
            reduced = self.shifted.less(shift, generosity * demand)
            rounding = self.rounding_of(reduced, demand, measure)
            if rounding is None:
                if demand is first:
                    return best
                generosity *= 1.5
                continue
            if np.all(rounding[~self.is_rotation] <= demand[~self.is_rotation]):
                bound = self.bound(reduced, np.where(self.is_rotation, rounding, 0.0))
                best = bound if best is None or bound.value > best.value else best
                sufficient = best.value >= self.enough
                guessed = demand is first and demand.any()
                if not guessed or (sufficient and not self.sharp):
                    if sufficient or measure or not self.is_worth_measuring(best.value, shift):
                        return best
                    measure = True
                    rounding = self.rounding_of(reduced, demand, measure)
                    if rounding is None:
                        return best
                    demand = np.zeros_like(demand)
            wanted = np.where(self.is_rotation, 0.0, MARGIN * rounding)
            # Measured values vary randomly between factors.
            if measure:
                wanted = MARGIN * wanted if demand is first else np.maximum(demand, MARGIN * wanted)
            demand = wanted
        return best

    def is_hopeless(self, shift: float) -> bool:
        """Whether only a measured residual can be expected to suffice."""
        if not self.rounding:
            return False
        value = self.expected(shift)
        return value < self.enough and self.is_worth_measuring(value, shift)

    def is_worth_measuring(self, value: float, shift: float) -> bool:
        """Whether a bound is insufficient due to rounding that measuring may reduce enough."""
        missing, allowed = self.cost - value, self.cost - self.enough
        explained = self.rounding and shift <= LARGEST_ROUNDING * self.unit
        return explained and missing <= MEASURING_GAIN * allowed and self.symbolic.measurable

    def matrix(
        self, multipliers: FloatArray, demand: FloatArray, pin: IntArray | None = None
    ) -> CSC:
        """The certificate matrix without the rows ``pin``, and ``demand`` off the diagonal.

        By default those of a pinned translation.
        """
        A, pin = self.problem.certificate_matrix(multipliers), self.pin if pin is None else pin
        if pin is not None:
            A = pinned(A, pin)
        return add_to_diagonal(A, -demand) if demand.any() else A

    def rounding_of(
        self,
        multipliers: FloatArray,
        demand: FloatArray,
        measure: bool,
        pin: IntArray | None = None,
    ) -> FloatArray | None:
        """(N,) delta such that the exact certificate matrix plus diag(delta - demand) is >= 0.

        Without the rows ``pin``, as in `matrix`. Of a factorization whose residual is either
        bounded or measured. None if the matrix is not positive definite.
        """
        self.factorizations += 1
        pin = self.pin if pin is None else pin
        A = self.matrix(multipliers, demand, pin)
        if not self.rounding:
            return None if self.symbolic.factor(A) is None else demand
        of = self.symbolic.residual if measure else self.symbolic.rounding
        found = of(A, self.weights)
        if found is None:
            return None
        self.nonzeros = found.nonzeros
        return self.compensation(found.sums, multipliers, pin)

    def compensation(
        self, sums: FloatArray, multipliers: FloatArray, pin: IntArray | None
    ) -> FloatArray:
        """(N,) of a factorization's rounding, with these row sums, and of the assembly's."""
        radii = assembly_errors(self.problem, multipliers, self.weights, self.is_rotation)
        delta = 1.001 * (sums + radii) / self.weights  # rounding of the products
        if pin is not None:
            delta[pin] = 0.0  # pinned: its diagonal entry can be arbitrarily large
        return np.asarray(delta)

    def bound(self, multipliers: FloatArray, reduction: FloatArray) -> DualBound:
        """The bound by multipliers whose diagonals are reduced by ``reduction`` (N,)."""
        d, poses, proven = self.problem.d, self.problem.held, multipliers.copy()
        # Rounded down: a smaller Lam' only adds to the diagonal of S.
        diagonal = diagonals(multipliers)[poses] - reduction[self.is_rotation].reshape(-1, d)
        diagonals(proven)[poses] = np.nextafter(diagonal, -np.inf)
        return self.of_multipliers(proven)

    def of_multipliers(self, proven: FloatArray) -> DualBound:
        """The bound by multipliers with S >= 0."""
        poses = self.problem.held
        diagonal = diagonals(proven)[poses]
        value = self.problem.kinds.proven(diagonal)
        taken = diagonals(self.shifted.multipliers)[poses] - diagonal
        return DualBound(
            value,
            proven,
            self.problem,
            float(taken.max()),
            self.factorizations,
            self.nonzeros,
            attained=self.cost,
        )


def diagonals(blocks: FloatArray) -> FloatArray:
    """(n, d) diagonals of blocks (n, d, d): the same memory."""
    return np.asarray(np.einsum("nii->ni", blocks))
