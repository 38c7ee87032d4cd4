"""The restricted likelihood of variances of kinds of measurements.

Variances v_k of kinds k divide the stated weights. All follows from the matrix H_k = A_k^T A_k, the
gradient and the squares of each kind at one fit: with H = sum H_k / v_k, -2 log L is

    S = sum_k (|e_k|^2 / v_k + n_k log v_k) + log det H

for the residuals e_k at the fit with these variances. Its derivative by log v_k is
l_k - |e_k|^2 / v_k, where l_k = n_k - tr(H_k H^-1) / v_k is how many of the kind's n_k numbers the
fit leaves. Second derivatives are the average of those that are expected and those that are
observed, which takes one solution for each kind (Gilmour, Thompson and Cullis 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from certpgo.diagnosis.study import IDLE, Study
from certpgo.linalg.arrays import CSC, BoolArray, FloatArray
from certpgo.linalg.blocks import pinned, with_entries
from certpgo.linalg.factor import Factor
from certpgo.linalg.selected_inverse import blocks_of_pairs


@dataclass(frozen=True, eq=False)
class Likelihood:
    """The likelihood near a fit, to first order.

    Attributes
    ----------
    fit : at the stated noise
    kinds : flags (m,) of the measurements of each of K kinds, all of which count
    """

    fit: Study
    kinds: Sequence[BoolArray]

    def at(self, variances: FloatArray) -> Variances | None:
        """The fit with these variances (K,); None where its weights leave nodes free."""
        problem, free, shares = self.fit.problem, self.fit.free, np.append(1.0 / variances, 1.0)
        matrices, gradients = zip(*self._equations, strict=True)
        data = sum(share * H.data for share, H in zip(shares, matrices, strict=True))
        H = pinned(with_entries(matrices[0], data), np.flatnonzero(free == 0.0))
        symbolic = problem.symbolic(H)
        factor = symbolic.factor(H)
        if factor is None:
            return None
        step = -factor.solve(free * (shares @ gradients))
        turned = gradients + np.stack([symbolic.multiply(one, step) for one in matrices])
        squares = shares * (self._squares + (gradients + turned) @ step)
        anchored = float(np.log(H.diagonal()[free == 0.0]).sum())
        surprise = float(squares.sum() + self._numbers @ np.log(variances))
        return Variances(
            self,
            variances,
            surprise + factor.log_det - anchored,
            squares[:-1],
            free * (shares[:, None] * turned)[:-1],
            factor,
        )

    @cached_property
    def _factors(self) -> list[FloatArray]:
        """(m,) of the stated weights, of each kind and of all else."""
        fit, rest = self.fit, ~np.any(self.kinds, axis=0)
        return [one * fit.factors for one in (*self.kinds, rest * np.where(fit.counts, 1.0, IDLE))]

    @cached_property
    def _equations(self) -> list[tuple[CSC, FloatArray]]:
        """Matrices and gradients, of each kind and of all else."""
        return [self.fit.equations(factors) for factors in self._factors]

    @cached_property
    def _squares(self) -> FloatArray:
        return np.array([factors @ self.fit.squares for factors in self._factors])

    @cached_property
    def _numbers(self) -> FloatArray:
        return np.array([float(self.fit.numbers[one].sum()) for one in self.kinds])

    @cached_property
    def _blocks(self) -> FloatArray:
        """(m, 2p, 2p) what measurements add to H."""
        parts = self.fit.parts
        found = np.empty((len(self.fit.edges), *[parts[0].slopes.shape[2]] * 2))
        for rows, *_, A, _ in parts:
            found[rows] = self.fit.factors[rows, None, None] * (np.swapaxes(A, 1, 2) @ A)
        return found


@dataclass(frozen=True, eq=False)
class Variances:
    """Variances, and the fit with these.

    Attributes
    ----------
    variances : (K,) over those stated
    surprise : S, but for a constant
    squares : (K,) of residuals, over these variances
    pulls : (K, N) gradients of half of these
    """

    of: Likelihood
    variances: FloatArray
    surprise: float
    squares: FloatArray
    pulls: FloatArray
    factor: Factor

    @cached_property
    def left(self) -> FloatArray:
        """(K,) how many numbers of each kind the fit leaves."""
        fit = self.of.fit
        Z = blocks_of_pairs(*self.factor.lower(), fit.layout, fit.edges)
        Z *= ~np.repeat(fit.edges == fit.anchor, Z.shape[1] // 2, axis=1)[:, :, None]
        taken = np.einsum("mab,mab->m", self.of._blocks, Z)
        of_kinds = np.array([taken[one].sum() for one in self.of.kinds])
        return np.asarray(self.of._numbers - of_kinds / self.variances)

    @cached_property
    def curvature(self) -> FloatArray:
        """(K, K) second derivatives of S by logarithms of variances: average information."""
        return np.diag(self.squares) - self.pulls @ self.factor.solve(self.pulls.T)
