"""Optimality of rotations without eigenvalues: residual torques as a sum of cycles of springs.

With E = R_i R_ij R_j^T (angle a, axis n) on an edge let c = kappa cos(a), phi = kappa sin(a) n. If
phi is a sum of torques f_C of cycles, each cycle passes the fold of its springs w_eC, and
c_e >= sum_C w_eC, then R is a global optimum of F. For any R, and any numbers with which the cycles
pass,

    F* >= F(R) - 4 sum_e (delta_e + sqrt(delta_e^2 + |r_e|^2)),
    delta_e = sum_C w_eC - c_e,    r_e = phi_e - sum_C f_C.

Statements and proofs are in docs/concepts/bounds.md. Numbers come from a cone program, are rounded
to integers, and are judged by `certpgo.cycle_checker` in fractions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from certpgo import cycle_checker
from certpgo.certify.cycle_program import Split, SplitProgram
from certpgo.certify.tolerances import ATOL, FLOOR, RTOL, SETTLED, allowed
from certpgo.errors import InputError, require
from certpgo.graph import Estimate
from certpgo.graph.cycles import Cycles, cycle_list
from certpgo.graph.display import Brief
from certpgo.io.exact import quaternion
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import NO_SCALES, Quadratic

#: Bits of rotations, and of torques and springs below the smallest weight.
ROTATION_BITS, BITS = 40, 44
#: Cycles in the list, at most, unless a basis has more.
MOST = 4000
#: Seconds after which the solver gives up.
PATIENCE = 60.0
#: How a solver ends with a ratio to speak of.
SOLVED = ("Solved", "AlmostSolved")
#: Share of the slack of an edge that its springs are given; the rest pays for what is left over.
SHARE = 0.5
#: What springs are given in any case, relative to kappa, and factors to try where they fail.
LEAST, STIFFENED = 1e-10, (1.0, 10.0, 1e2, 1e3, 1e4)


@dataclass(frozen=True, eq=False, repr=False)
class CycleProof(Brief):
    """What cycles prove of rotations.

    Attributes
    ----------
    proven : whether the lower bound is as close to the cost as that of CERTIFIED
    reason : why not; empty if proven
    ratio : the smallest number with sum_C w_eC <= c_e - (1 - ratio) |c_e| on all edges, as the
        solver found it: at most 1 where the split succeeds
    cost : F of the rotations, rounded up
    lower_bound : at most F*, by exact arithmetic; F is that of the rotations alone
    cycles : the closed walks, on the edges that measure a rotation
    torques : for each 1 (plane) or 3 integers, in the unit 2^-bits
    springs : for each as many integers as it has edges, in this unit
    bits : see there
    rotations : (n, 2 or 4) integers: sine and cosine of half the angle, or quaternions x y z w, of
        any norm
    """

    proven: bool
    reason: str
    ratio: float
    cost: float
    lower_bound: float
    cycles: Cycles
    torques: list[list[int]]
    springs: list[list[int]]
    bits: int
    rotations: list[list[int]]

    @property
    def walks(self) -> list[tuple[list[int], list[int], list[int]]]:
        """Each cycle's torque, steps (k or -k for the k-th edge, from 1) and springs."""
        steps = ((self.cycles.edges + 1) * self.cycles.signs).tolist()
        ends = zip(self.cycles.starts[:-1], self.cycles.starts[1:], strict=True)
        walked = (steps[start:end] for start, end in ends)
        return list(zip(self.torques, walked, self.springs, strict=True))


def prove(
    problem: Quadratic, estimate: Estimate, *, most: int = MOST, seconds: float = PATIENCE
) -> CycleProof:
    """Try to prove by cycles that rotations are optimal.

    It is about the rotations' part of F alone, which is at most F. For a proof they are stationary;
    the bound holds for any.

    Parameters
    ----------
    estimate : its rotations
    most : cycles of the list: a basis, and all of length 2, then 3 to 6, while they are not more
    seconds : after which the solver of the cone program gives up

    Raises
    ------
    InputError
        Not a problem of F, an estimate of another graph, nodes of unknown scale, or weights that
        are negative or not isotropic.
    """
    require(problem, Quadratic, "the chordal problem of a graph")
    if problem.takes_scales:
        raise InputError(NO_SCALES)
    if problem.graph.is_signed:
        raise InputError("proofs by cycles are for positive weights")
    if problem.graph.has_matrix_weights:
        raise InputError("proofs by cycles are for isotropic weights (no couplings, no arms)")
    problem.check(estimate)
    measured = _Measured.of(problem)
    cycles = cycle_list(problem.n, measured.edges, most)
    torques, stiffness = measured.flow(estimate.rotations)
    unit = float(np.median(measured.kappa))
    program = SplitProgram(cycles, torques / unit, stiffness / unit, seconds)
    split = program.smallest_ratio()
    ratio, status = split.value, split.status
    if not (status in SOLVED and ratio < 1.0):
        split = program.smallest_loss()
    bits = BITS - math.frexp(float(measured.kappa.min()))[1]
    split = replace(split, torques=unit * split.torques, springs=unit * split.springs)
    cycles, f, w = _in_integers(cycles, split, stiffness, measured.kappa, bits)
    rotations = _integers(_stated(estimate.rotations), ROTATION_BITS)
    found = CycleProof(False, "", ratio, math.inf, 0.0, cycles, f, w, bits, rotations)
    upper, lower = measured.bounds(found)
    scale = ATOL * float(measured.kappa.sum())
    proven = upper - lower <= max(allowed(upper, RTOL, scale), FLOOR * scale)
    reason = "" if proven else _reason(ratio, status, problem.rotation, estimate)
    return replace(found, proven=proven, reason=reason, cost=upper, lower_bound=lower)


def _reason(ratio: float, status: str, problem: Quadratic, estimate: Estimate) -> str:
    """Why a proof fails."""
    if (off := problem.stationarity(Estimate.trusted(estimate.rotations))) > SETTLED:
        return f"the rotations are not stationary, by {off:.2g} radians"
    if status not in SOLVED:
        return f"no split over these cycles was found (the solver says {status})"
    if ratio < 1.0:
        return f"the solver's numbers are too inaccurate ({status})"
    return f"the cycles ask for {ratio:.3g} times the stiffness of an edge"


@dataclass(frozen=True)
class _Measured:
    """The edges that measure a rotation."""

    edges: IntArray
    rotations: FloatArray
    kappa: FloatArray

    @classmethod
    def of(cls, problem: Quadratic) -> _Measured:
        graph = problem.graph
        on = graph.kappa > 0.0
        return cls(graph.edges[on], graph.rotations[on], graph.kappa[on])

    def flow(self, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Torques kappa sin(a) n, (m, 1 or 3), and stiffnesses kappa cos(a), (m,)."""
        i, j = self.edges.T
        E, d = R[i] @ self.rotations @ np.swapaxes(R[j], 1, 2), R.shape[-1]
        skew = so.vee(0.5 * (E - np.swapaxes(E, 1, 2))).reshape(len(i), -1)
        cosines = 0.5 * (np.trace(E, axis1=1, axis2=2) - (d - 2))
        return self.kappa[:, None] * skew, self.kappa * np.clip(cosines, -1.0, 1.0)

    def bounds(self, proof: CycleProof) -> tuple[float, float]:
        """F of the rotations, rounded up, and the lower bound, rounded down."""
        q = quaternion.to_write(self.rotations)
        edges = [
            (i, j, cycle_checker.whole(turn), Fraction(kappa))
            for (i, j), turn, kappa in zip(
                self.edges.tolist(), q.tolist(), self.kappa.tolist(), strict=True
            )
        ]
        given = {k: [0] * (4 - len(row)) + row for k, row in enumerate(proof.rotations)}
        unit = 1 / Fraction(2) ** proof.bits
        upper, lower = cycle_checker.bounds(edges, given, proof.walks, unit)
        return of_matrices(upper, lower, self.rotations, self.kappa)


def of_matrices(
    upper: Fraction, lower: Fraction, rotations: FloatArray, kappa: FloatArray
) -> tuple[float, float]:
    """Bounds of a cost with the rotations of quaternions as those with the very matrices.

    These are off by eps_e at most, and |sqrt(F) - sqrt(F')| <= sqrt(sum kappa eps_e^2) =: eps for
    both costs, at any point. The bounds are rounded outward.
    """
    d = rotations.shape[-1]
    exact = quaternion.rotations(quaternion.to_write(rotations))[:, :d, :d]
    off = np.abs(exact - rotations).max(initial=0.0) + 64.0 * np.finfo(float).eps
    eps = Fraction(3.0 * float(off)) * root_up(Fraction(float(kappa.sum()) * 1.001))
    lower = max(lower, Fraction(0))
    upper += 2 * eps * root_up(upper) + eps**2
    low = math.nextafter(float(lower - 2 * eps * root_up(lower)), -math.inf)
    return math.nextafter(float(upper), math.inf), max(low, 0.0)


def root_up(x: Fraction) -> Fraction:
    """At least the square root."""
    n, d = x.as_integer_ratio()
    return Fraction(math.isqrt(n * d << 400) + 1, d << 200)


def _stated(R: FloatArray) -> FloatArray:
    """Quaternions x y z w; in the plane their z and w alone."""
    return quaternion.to_write(R)[:, -2 * (R.shape[-1] - 1) :]


def _integers(x: FloatArray, bits: int) -> list[list[int]]:
    """The multiples of 2^-bits nearest to the entries of rows."""
    return [[int(entry) for entry in row] for row in np.rint(np.ldexp(x, bits)).tolist()]


def _in_integers(
    cycles: Cycles, split: Split, stiffness: FloatArray, kappa: FloatArray, bits: int
) -> tuple[Cycles, list[list[int]], list[list[int]]]:
    """Torques and springs in integers with which each cycle passes, and the cycles that do.

    Each edge gives a share of what it has left to its springs. Cycles that no springs let pass are
    left out, and those that do nothing: what is missing is part of the bound.
    """
    m = len(kappa)
    slack = stiffness - np.bincount(cycles.edges, split.springs, m)
    each = np.maximum(slack, 0.0) / np.maximum(np.bincount(cycles.edges, minlength=m), 1)
    more = (SHARE * each + LEAST * kappa)[cycles.edges]
    kept, torques, springs = [], [], []
    for c, torque in enumerate(_integers(split.torques, bits)):
        at, square = slice(*cycles.starts[c : c + 2]), sum(f * f for f in torque)
        if not square and (split.springs[at] >= 0.0).all():
            continue
        for factor in STIFFENED:
            (w,) = _integers(split.springs[None, at] + factor * more[at], bits)
            if (last := _folded(w, square)) is not None:
                kept.append(c)
                torques.append(torque)
                springs.append([*w[:-1], max(w[-1], -last)])
                break
    return cycles.chosen(kept), torques, springs


def _folded(springs: list[int], square: int) -> int | None:
    """All springs but the last as one; None where they do not pass."""
    u = springs[0]
    for w in springs[1:-1]:
        if u + w <= 0:
            return None
        u = (u * w - square) // (u + w)
    return u
