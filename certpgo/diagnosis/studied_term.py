"""Residuals of measurements and their derivatives, in stated standard deviations."""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple, Self

import numpy as np

from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.residuals import NONE


class StudiedTerm(NamedTuple):
    """Rows of one term: residuals and their derivatives by the two nodes.

    Attributes
    ----------
    errors, motions : (k, r) and (k, r, 2p) in their own units
    residuals, slopes : the same in stated standard deviations
    logs : (k,) log det of the stated weights
    """

    rows: IntArray
    errors: FloatArray
    motions: FloatArray
    residuals: FloatArray
    slopes: FloatArray
    logs: FloatArray

    @classmethod
    def of(
        cls, rows: IntArray, errors: FloatArray, motions: FloatArray, weights: FloatArray
    ) -> Self:
        """With these weights (k, r, r)."""
        root, logs = roots(weights)
        return cls(
            rows, errors, motions, (root @ errors[:, :, None])[:, :, 0], root @ motions, logs
        )

    def moved(self, by: FloatArray) -> Self:
        """After motions (k, 2p) of the nodes, to first order."""
        moves = by[:, :, None]
        errors = self.errors + (self.motions @ moves)[:, :, 0]
        return self._replace(
            errors=errors, residuals=self.residuals + (self.slopes @ moves)[:, :, 0]
        )


def roots(W: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, r, r) matrices C with C^T C the semidefinite ones, and (k,) their log det.

    That is of what they state: zeros do not count.
    """
    diagonal = np.einsum("maa->ma", W)
    if np.count_nonzero(W) == np.count_nonzero(diagonal):
        values, U = np.maximum(diagonal, 0.0), np.broadcast_to(np.eye(W.shape[1]), W.shape)
    else:
        with suppress(np.linalg.LinAlgError):
            C = np.linalg.cholesky(W, upper=True)
            values = np.einsum("maa->ma", C) ** 2
            if (values > NONE * values.max(axis=1, keepdims=True)).all():
                return np.asarray(C), np.asarray(np.log(values).sum(axis=1))
        values, U = np.linalg.eigh(W)
        values = np.maximum(values, 0.0)
    stated = values > NONE * values.max(axis=1, keepdims=True)
    log = np.log(np.where(stated, values, 1.0)).sum(axis=1)
    return np.sqrt(values)[:, :, None] * np.swapaxes(U, 1, 2), log
