"""Residuals at the best fit to first order: how much of each measurement the fit uses up.

With residuals e = A x - b over stated standard deviations, the fit leaves (I - P) e of the noise e,
P = A H^-1 A^T and H = A^T A. So e^T (I - P)^-1 e, of a measurement's block, is its squared distance
from what all others say, in units of what that is uncertain by; and where the variances of kinds k
are s_k^2, their squares have means sum_l B_kl s_l^2, B_kl the squared entries of that block of
I - P. Solved for s^2 that is the estimate of least variance near s = 1 (Rao's MINQUE), whose
covariance is 2 B^-1.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, cast

import numpy as np

from certpgo.diagnosis.studied_term import StudiedTerm
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.information import Information
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray, IntArray
from certpgo.linalg.blocks import Layout, pinned, scatter_sum
from certpgo.linalg.factor import Factor
from certpgo.linalg.selected_inverse import blocks_of_pairs
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.objective.edge_equations import linearized
from certpgo.objective.normal_equations import moved
from certpgo.objective.sum import Sum
from certpgo.objective.terms import gathered
from certpgo.optimize.marginals import LARGEST
from certpgo.solve.fit import Fit

#: Weight of a measurement that does not count, to keep the pattern of the matrix.
IDLE = 1e-12
#: Steps of Gauss and Newton to the fit, and the share of the cost that the last one may be worth,
#: which is taken to first order.
STEPS, LAST = 3, 1e-2
#: Share of a direction's variance that a fit must leave to check it.
CHECKED = 1e-3
#: Random signs that squared entries are averaged over: so many numbers in all, within limits. Their
#: error is then a fifth of the noise's own at most.
SIGNS, FEWEST, MOST_SIGNS = 20_000, 4, 24


class Coupling(NamedTuple):
    """How kinds of measurements see one another's noise.

    Attributes
    ----------
    B : (k, k)
    squares : (k,) of the kinds, over variances that are assumed
    """

    B: FloatArray
    squares: FloatArray


class _Judged(NamedTuple):
    """What a fit leaves of each measurement, see `Study`."""

    surprises: FloatArray
    checked: IntArray
    left: FloatArray


@dataclass(frozen=True, eq=False)
class Study:
    """Measurements at the best fit to those that count, in stated standard deviations.

    Attributes
    ----------
    problem : the measurements and their stated weights
    estimate : the fit, or near it
    numbers : (m,) how many numbers each measures
    parts : residuals
    edges : (m, 2) nodes
    anchor : a pose that stands still
    layout, factor : of H
    diagonal : (N,) of H
    factors : (m,) of the stated weights
    counts : (m,) which measurements the fit is of
    """

    problem: Sum
    estimate: Estimate
    numbers: IntArray
    parts: tuple[StudiedTerm, ...]
    edges: IntArray
    anchor: int
    layout: Layout
    factor: Factor
    diagonal: FloatArray
    factors: FloatArray
    counts: BoolArray

    @cached_property
    def squares(self) -> FloatArray:
        """(m,) squared residuals over stated variances."""
        found = np.zeros(len(self.edges))
        for rows, _, _, e, *_ in self.parts:
            found[rows] = (e * e).sum(axis=1)
        return found

    @property
    def fit(self) -> Fit:
        """chi^2 of what counts, over the assumed variances."""
        free = self.layout.size - int(self.layout.sizes[self.anchor])
        chi2 = float((self.factors * self.squares)[self.counts].sum())
        return Fit(chi2, max(int(self.numbers[self.counts].sum()) - free, 1))

    @cached_property
    def free(self) -> FloatArray:
        """(N,) zeros for the anchor, else ones."""
        free = np.ones(self.layout.size)
        free[self.layout.rows_of(self.anchor)] = 0.0
        return free

    @cached_property
    def surprise(self) -> float:
        """-2 log of the restricted likelihood of what counts, but for a constant.

        With the weights W of the measurements |e|^2 - log det W + log det H.
        """
        anchored = float(np.log(self.diagonal[self.free == 0.0]).sum())
        total = self.factor.log_det - anchored + self.fit.chi2
        for rows, *_, logs in self.parts:
            of_rows = logs + self.numbers[rows] * np.log(self.factors[rows])
            total -= float(of_rows[self.counts[rows]].sum())
        return total

    @property
    def surprises(self) -> FloatArray:
        """(m,) squared distances from what the others say, over what these are uncertain by."""
        return self._judged.surprises

    @property
    def checked(self) -> IntArray:
        """(m,) in how many directions that is known."""
        return self._judged.checked

    @property
    def left(self) -> FloatArray:
        """(m,) how many of its numbers the fit leaves: all of those that do not count."""
        return self._judged.left

    @cached_property
    def remaining(self) -> tuple[FloatArray, ...]:
        """Of each part (k, r, r), what is left of a measurement's own noise: blocks of I - P.

        Of those that do not count, the variance of their distance from the fit, I + P.
        """
        Z = blocks_of_pairs(*self.factor.lower(), self.layout, self.edges)
        still = np.repeat(self.edges == self.anchor, Z.shape[1] // 2, axis=1)
        Z[still[:, :, None] | still[:, None, :]] = 0.0
        signed = np.where(self.counts, -self.factors, self.factors)
        return tuple(
            np.eye(A.shape[1]) + signed[rows, None, None] * (A @ Z[rows] @ np.swapaxes(A, 1, 2))
            for rows, *_, A, _ in self.parts
        )

    @property
    def unevenness(self) -> float:
        """The larger of two ratios of squares of translations and rotations, over those left.

        Of poses that measure both.
        """
        d, sums = self.problem.d, np.zeros((2, 2))
        for (rows, *_, e, A, _), G in zip(self.parts, self.remaining, strict=True):
            stated = np.any(A, axis=2) & self.counts[rows, None]
            of_both = stated[:, :d].any(axis=1) & stated[:, d:].any(axis=1)
            stated &= of_both[:, None]
            both = self.factors[rows, None] * e**2, np.einsum("maa->ma", G)
            for k, own in enumerate((slice(0, d), slice(d, None))):
                sums[k] += [of[:, own][stated[:, own]].sum() for of in both]
        if not (sums > 0.0).all():
            return 1.0
        moved, turned = (sums[:, 0] / sums[:, 1]).tolist()
        return float(max(moved / turned, turned / moved))

    @cached_property
    def _judged(self) -> _Judged:
        surprises, left = np.zeros((2, len(self.edges)))
        checked = np.zeros(len(self.edges), dtype=np.intp)
        for (rows, _, _, e, *_), G in zip(self.parts, self.remaining, strict=True):
            within, unknown = _within(e, G)
            surprises[rows] = self.factors[rows] * within
            checked[rows] = self.numbers[rows] - unknown
            left[rows] = np.einsum("maa->m", G) - e.shape[1] + self.numbers[rows]
        left = np.where(self.counts, np.maximum(left, 0.0), self.numbers)
        return _Judged(surprises, np.maximum(checked, 0), left)

    def under(self, weights: Sequence[FloatArray]) -> Study | None:
        """The fit to other weights near this one, to first order; None where they leave nodes free.

        Parameters
        ----------
        weights : of each part (k, r, r)
        """
        both = zip(self.parts, weights, strict=True)
        parts = tuple(StudiedTerm.of(*part[:3], W) for part, W in both)
        other = replace(self, parts=parts)
        H, gradient = other.equations(np.where(self.counts, 1.0, IDLE) * self.factors)
        H = pinned(H, np.flatnonzero(self.free == 0.0))
        factor = self.problem.symbolic(H).factor(H)
        if factor is None or not _is_determined(factor, H.diagonal(), self.free):
            return None
        moved = other.moved(-factor.solve(self.free * gradient))
        return replace(moved, factor=factor, diagonal=H.diagonal())

    def equations(self, factors: FloatArray) -> tuple[CSC, FloatArray]:
        """The matrix (N, N) and gradient (N,) of measurements whose weights have factors (m,)."""
        (n, p), m = (len(self.layout.sizes), self.parts[0].slopes.shape[2] // 2), len(self.edges)
        diagonal, gradient, upper = np.zeros((n, p, p)), np.zeros((n, p)), np.zeros((m, p, p))
        for rows, *_, e, A, _ in self.parts:
            own = np.flatnonzero(factors[rows])
            if not len(own):
                continue
            rows, e, A = rows[own], e[own], A[own]
            back = factors[rows, None, None] * np.swapaxes(A, 1, 2)
            square, pull = back @ A, (back @ e[:, :, None])[:, :, 0]
            for end, half in zip(self.edges[rows].T, (slice(0, p), slice(p, None)), strict=True):
                diagonal += scatter_sum(end, square[:, half, half], n)
                gradient += scatter_sum(end, pull[:, half], n)
            upper[rows] = square[:, :p, p:]
        H = self.problem.chordal.pattern.assemble(diagonal, upper, self.problem.d)
        return H, self.layout.pack(gradient)

    def moved(self, step: FloatArray) -> Study:
        """After a step (N,), to first order."""
        moves = self.layout.unpack(step)
        at_edges = moves[self.edges]
        parts = tuple(
            part.moved(at_edges[part.rows].reshape(len(part.rows), -1)) for part in self.parts
        )
        return replace(self, estimate=moved(self.estimate, moves), parts=parts)

    def coupling(self, kinds: Sequence[BoolArray]) -> Coupling:
        """How kinds of measurements that count, given by flags (m,), see one another's noise.

        Expectations over signs z, as those of |((I - P) z)_k|^2 are B_kl for signs of kind l.
        I - P is a projection, so that a row of B adds up to the numbers of that kind that are left:
        no signs are drawn for the kind of which most are.
        """
        rng, count = np.random.default_rng(0), len(kinds)
        left = np.array([self.left[one].sum() for one in kinds])
        most = int(np.argmax(left))
        others = [k for k in range(count) if k != most]
        B = np.zeros((count, count))
        for k in others:
            B[others, k] = self._seen(kinds[k], [kinds[other] for other in others], rng)
        B = 0.5 * (B + B.T)
        B[others, most] = B[most, others] = np.maximum(left - B.sum(axis=1), 0.0)[others]
        B[most, most] = max(left[most] - B[most].sum(), 0.0)
        squares = self.factors * self.squares
        return Coupling(B, np.array([squares[one].sum() for one in kinds]))

    def _seen(
        self, kind: BoolArray, by: Sequence[BoolArray], rng: np.random.Generator
    ) -> FloatArray:
        """(k,) squared entries of I - P between a kind and those by which it is seen."""
        n, p = len(self.layout.sizes), self.parts[0].slopes.shape[2] // 2
        free = self.free[:, None]
        count = int(np.clip(SIGNS // len(self.edges), FEWEST, MOST_SIGNS))
        pulled, signs = np.zeros((n, p, count)), []
        for rows, _, _, e, A, _ in self.parts:
            own = np.flatnonzero(kind[rows])
            z = rng.choice([-1.0, 1.0], (len(own), e.shape[1], count))
            z = np.where(np.any(A[own], axis=2, keepdims=True), z, 0.0)
            at = np.swapaxes(np.sqrt(self.factors[rows[own]])[:, None, None] * A[own], 1, 2) @ z
            signs.append((own, z))
            if not len(own):
                continue
            for end, half in enumerate((at[:, :p], at[:, p:])):
                pulled += scatter_sum(self.edges[rows[own], end], half, n)
        moved = self.layout.unpack(self.factor.solve(free * self.layout.pack(pulled)))
        moved *= self.layout.unpack(free)
        found = np.zeros(len(by))
        seen = np.zeros(len(self.edges), dtype=bool)
        for one in by:
            seen |= one
        for (rows, *_, A, _), (own, z) in zip(self.parts, signs, strict=True):
            chosen = np.flatnonzero(seen[rows])
            by_nodes = np.concatenate([moved[end] for end in self.edges[rows[chosen]].T], axis=1)
            off = -np.sqrt(self.factors[rows[chosen]])[:, None, None] * (A[chosen] @ by_nodes)
            off[np.searchsorted(chosen, own)] += z
            of_rows = (off**2).sum(axis=(1, 2)) / count
            found += [of_rows[one[rows[chosen]]].sum() for one in by]
        return found


def _within(e: FloatArray, G: FloatArray) -> tuple[FloatArray, IntArray]:
    """(k,) squares e^T G^-1 e of the directions that a fit checks, and (k,) how many it does not.

    The least of r eigenvalues is the determinant over the product of the others, which is at most
    their mean to the power of r - 1.
    """
    unknown, r = np.zeros(len(e), dtype=np.intp), e.shape[1]
    with np.errstate(all="ignore"):
        others = np.einsum("maa->m", G) / max(r - 1, 1)
        doubtful = ~((np.linalg.det(G) > CHECKED * others ** (r - 1)) & (others > 0.0))
    found = np.zeros(len(e))
    sure = ~doubtful
    found[sure] = (e[sure] * np.linalg.solve(G[sure], e[sure][:, :, None])[:, :, 0]).sum(axis=1)
    if doubtful.any():
        left, U = np.linalg.eigh(G[doubtful])
        along = np.einsum("mab,ma->mb", U, e[doubtful]) ** 2
        known = left > CHECKED
        found[doubtful] = np.where(known, along / np.where(known, left, 1.0), 0.0).sum(axis=1)
        unknown[doubtful] = (~known).sum(axis=1)
    return found, unknown


def studied_problem(problem: Certifiable) -> Sum | None:
    """The sum of squares whose weights are those that the measurements state; None if not known.

    F is none: in the plane it counts the square of a turn twice. Its weights are those of g2o's.
    """
    graph = problem.measured
    if problem.cost_name != CHORDAL:
        return cast("Sum", problem)
    if not graph.has_positions or graph.has_scales or graph.has_others or graph.has_couplings:
        return None
    with suppress(CertPGOError):
        stated = Information.isotropic(graph.kappa, graph.tau, graph.d, about="quaternion")
        return Sum(graph.with_information(stated), COSTS["g2o"], problem.engine)
    return None


def study(
    problem: Sum,
    estimate: Estimate,
    anchor: int,
    factors: FloatArray | None = None,
    counts: BoolArray | None = None,
) -> Study | None:
    """The measurements at the fit near an estimate; None where they leave nodes free.

    Parameters
    ----------
    anchor : a pose that stands still
    factors : (m,) of the stated weights, by default ones
    counts : (m,) which measurements the fit is of, by default all
    """
    m = problem.graph.num_edges
    f = np.ones(m) if factors is None else factors
    kept = np.ones(m, dtype=bool) if counts is None else counts
    weights = np.where(kept, f, IDLE * f)
    weighed = problem if (weights == 1.0).all() else problem.reweighted(weights)
    layout, factor, near = weighed.tangent_layout, None, False
    still = layout.rows_of(anchor)
    free = np.ones(layout.size)
    free[still] = 0.0
    model = weighed.normal_equations(estimate)
    for left in range(STEPS, -1, -1):
        H = pinned(model.gauss_newton, still)
        factor = weighed.symbolic(H).factor(H)
        if factor is None:
            return None
        gradient = free * model.gradient
        step = -factor.solve(gradient)
        near = -float(step @ gradient) <= LAST * model.cost
        if near or not left or not (there := model.moved(step)).cost < model.cost:
            break
        model = there
    if factor is None or not _is_determined(factor, H.diagonal(), free):
        return None
    parts = []
    for rows, term in problem.terms:
        e, at_i, at_j = linearized(term, model.point)
        motions = np.concatenate([at_i, at_j], axis=2)
        parts.append(StudiedTerm.of(rows, e, motions, term.weights))
    numbers = gathered(problem.terms, lambda term: term.numbers[0] + term.numbers[1])
    of_nodes = weighed.graph.edges, anchor, layout
    found = Study(
        problem, model.point, numbers, tuple(parts), *of_nodes, factor, H.diagonal(), f, kept
    )
    return found.moved(step) if near else found


def _is_determined(factor: Factor, diagonal: FloatArray, free: FloatArray) -> bool:
    """Whether a random motion is what it is without rounding: nodes that are left free are not."""
    x = free * np.random.default_rng(0).standard_normal(len(free))
    return bool((np.abs(factor.solve(x)) * diagonal < LARGEST).all())
