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
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.information import Information
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.blocks import Layout, pinned, scatter_sum
from certpgo.linalg.factor import Factor
from certpgo.linalg.selected_inverse import blocks_of_pairs
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.costs import COSTS
from certpgo.objective.edge_equations import linearized
from certpgo.objective.residuals import NONE
from certpgo.objective.sum import Sum
from certpgo.objective.terms import gathered
from certpgo.optimize.marginals import LARGEST
from certpgo.solve.fit import Fit

#: Weight of a measurement that does not count, to keep the pattern of the matrix.
IDLE = 1e-12
#: Steps of Gauss and Newton to the fit, and the relative decrease that is not worth another.
STEPS, SMALL = 3, 1e-4
#: Share of a direction's variance that a fit must leave to check it.
CHECKED = 1e-3
#: Random signs that squared entries are averaged over: so many numbers in all, within limits.
SIGNS, FEWEST, MOST_SIGNS = 30_000, 8, 200


class StudiedTerm(NamedTuple):
    """Rows of one term, in stated standard deviations.

    Attributes
    ----------
    residuals : (k, r)
    slopes : (k, r, 2p) derivatives by the two nodes
    logs : (k,) log det of the stated weights
    """

    rows: IntArray
    residuals: FloatArray
    slopes: FloatArray
    logs: FloatArray


class Coupling(NamedTuple):
    """How kinds of measurements see one another's noise.

    Attributes
    ----------
    B : (k, k)
    squares : (k,) of the kinds, over variances that are assumed
    left : (m,) numbers of measurements that the fit does not take, roughly
    """

    B: FloatArray
    squares: FloatArray
    left: FloatArray


@dataclass(frozen=True, eq=False)
class Study:
    """Measurements at the best fit to those that count, in stated standard deviations.

    Attributes
    ----------
    estimate : the fit
    numbers : (m,) how many numbers each measures
    parts : residuals
    edges : (m, 2) nodes
    anchor : a pose that stands still
    layout, factor : of H
    diagonal : (N,) of H
    factors : (m,) of the stated weights
    counts : (m,) which measurements the fit is of
    """

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
        for rows, e, _, _ in self.parts:
            found[rows] = (e * e).sum(axis=1)
        return found

    @property
    def fit(self) -> Fit:
        """chi^2 of what counts, over the assumed variances."""
        free = self.layout.size - int(self.layout.sizes[self.anchor])
        chi2 = float((self.factors * self.squares)[self.counts].sum())
        return Fit(chi2, max(int(self.numbers[self.counts].sum()) - free, 1))

    @cached_property
    def surprise(self) -> float:
        """-2 log of the restricted likelihood of what counts, but for a constant.

        With the weights W of the measurements |e|^2 - log det W + log det H.
        """
        still = self.layout.first_row(self.anchor) + np.arange(self.layout.sizes[self.anchor])
        log = 2.0 * np.log(self.factor.lower()[0].diagonal()).sum()
        total = float(log - np.log(self.diagonal[still]).sum()) + self.fit.chi2
        for rows, _, _, logs in self.parts:
            of_rows = logs + self.numbers[rows] * np.log(self.factors[rows])
            total -= float(of_rows[self.counts[rows]].sum())
        return total

    @property
    def surprises(self) -> FloatArray:
        """(m,) squared distances from what the others say, over what these are uncertain by."""
        return self._judged[0]

    @property
    def checked(self) -> IntArray:
        """(m,) in how many directions that is known."""
        return self._judged[1]

    @cached_property
    def _judged(self) -> tuple[FloatArray, IntArray]:
        Z = blocks_of_pairs(*self.factor.lower(), self.layout, self.edges)
        still = np.repeat(self.edges == self.anchor, Z.shape[1] // 2, axis=1)
        Z = np.where(still[:, :, None] | still[:, None, :], 0.0, Z)
        surprises, checked = np.zeros(len(Z)), np.zeros(len(Z), dtype=np.intp)
        for rows, e, A, _ in self.parts:
            own = self.counts[rows], self.factors[rows, None, None]
            P = own[1] * (A @ Z[rows] @ np.swapaxes(A, 1, 2))
            sign = np.where(own[0], 1.0, -1.0)[:, None, None]
            left, U = np.linalg.eigh(np.eye(e.shape[1]) - sign * P)
            along = np.einsum("mab,ma->mb", U, e) ** 2
            known = left > CHECKED
            within = np.where(known, along / np.where(known, left, 1.0), 0.0).sum(axis=1)
            surprises[rows] = self.factors[rows] * within
            checked[rows] = self.numbers[rows] - (~known).sum(axis=1)
        return surprises, np.maximum(checked, 0)

    def coupling(self, kinds: Sequence[BoolArray]) -> Coupling:
        """How kinds of measurements, given by flags (m,), see one another's noise.

        Expectations over signs z, as those of |((I - P) z)_k|^2 are B_kl for signs of kind l.
        """
        m, n, (_, e, A, _) = len(self.edges), len(self.layout.sizes), self.parts[0]
        count = int(np.clip(SIGNS / m, FEWEST, MOST_SIGNS))
        rng, p = np.random.default_rng(0), A.shape[2] // 2
        free = np.ones((n, p, 1))
        free[self.anchor] = 0.0
        roots = [np.sqrt(self.factors[rows])[:, None, None] * A for rows, _, A, _ in self.parts]
        B, left = np.zeros((len(kinds), len(kinds))), np.zeros(m)
        for k, kind in enumerate(kinds):
            signs, pulled = [], np.zeros((n, p, count))
            for (rows, e, _, _), A in zip(self.parts, roots, strict=True):
                counts = kind[rows, None] & A.any(axis=2)
                z = np.where(counts[:, :, None], rng.choice([-1.0, 1.0], (*e.shape, count)), 0.0)
                at = np.swapaxes(A, 1, 2) @ z
                for end, own in enumerate((at[:, :p], at[:, p:])):
                    pulled += scatter_sum(self.edges[rows, end], own, n)
                signs.append(z)
            moved = self.layout.unpack(self.factor.solve(self.layout.pack(free * pulled))) * free
            for (rows, *_), A, z in zip(self.parts, roots, signs, strict=True):
                by_nodes = np.concatenate([moved[end] for end in self.edges[rows].T], axis=1)
                of_rows = ((z - A @ by_nodes) ** 2).sum(axis=(1, 2)) / count
                B[:, k] += [of_rows[one[rows]].sum() for one in kinds]
                left[rows] += of_rows
        squares = self.factors * self.squares
        return Coupling(0.5 * (B + B.T), np.array([squares[one].sum() for one in kinds]), left)


def studied_problem(problem: Certifiable) -> Sum | None:
    """The sum of squares whose weights are those that the measurements state; None if not known.

    F is none: in the plane it counts the square of a turn twice. Its weights are those of g2o's.
    """
    graph = problem.measured
    if isinstance(problem, Sum) and problem.cost_name != "chordal":
        return problem
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
    weighed = problem.reweighted(np.where(kept, f, IDLE * f))
    layout = weighed.tangent_layout
    still = layout.first_row(anchor) + np.arange(layout.sizes[anchor])
    free = np.ones(layout.size)
    free[still] = 0.0
    model, factor = weighed.normal_equations(estimate), None
    for left in range(STEPS, -1, -1):
        H = pinned(model.gauss_newton, still)
        factor = weighed.symbolic(H).factor(H)
        if factor is None:
            return None
        moved = model.moved(-factor.solve(free * model.gradient)) if left else model
        if not moved.cost < model.cost * (1.0 - SMALL):
            break
        model = moved
    if factor is None or not _is_determined(factor, H.diagonal(), free):
        return None
    parts = []
    for rows, term in problem.terms:
        e, at_i, at_j = linearized(term, model.point)
        root, logs = _roots(term.weights)
        slopes = root @ np.concatenate([at_i, at_j], axis=2)
        parts.append(StudiedTerm(rows, (root @ e[:, :, None])[:, :, 0], slopes, logs))
    numbers = gathered(problem.terms, lambda term: term.numbers[0] + term.numbers[1])
    of_nodes = weighed.graph.edges, anchor, layout
    return Study(model.point, numbers, tuple(parts), *of_nodes, factor, H.diagonal(), f, kept)


def _is_determined(factor: Factor, diagonal: FloatArray, free: FloatArray) -> bool:
    """Whether a random motion is what it is without rounding: nodes that are left free are not."""
    x = free * np.random.default_rng(0).standard_normal(len(free))
    return bool((np.abs(factor.solve(x)) * diagonal < LARGEST).all())


def _roots(W: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, r, r) symmetric roots of semidefinite matrices, and (k,) logarithms of determinants.

    Of what they state: zeros do not count.
    """
    diagonal, unit = np.einsum("maa->ma", W), np.eye(W.shape[1])
    if np.count_nonzero(W) == np.count_nonzero(diagonal):
        values, U = diagonal, np.broadcast_to(unit, W.shape)
    else:
        values, U = np.linalg.eigh(W)
    values = np.maximum(values, 0.0)
    stated = values > NONE * values.max(axis=1, keepdims=True)
    log = np.log(np.where(stated, values, 1.0)).sum(axis=1)
    return (U * np.sqrt(values)[:, None]) @ np.swapaxes(U, 1, 2), log
