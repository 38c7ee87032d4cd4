"""What the numbers after measured poses may be: orders of a matrix, and other matrices."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from certpgo.graph.information import unmeasured
from certpgo.linalg.arrays import FloatArray


@dataclass(frozen=True)
class Meaning:
    """What the numbers may be.

    Attributes
    ----------
    kind : its name in findings
    said : what they are
    next : what to do about it
    read : information (k, p, p) as it is meant, from that which is given
    """

    kind: str
    said: str
    next: str
    read: Callable[[FloatArray], FloatArray]


def _reordered(order: tuple[tuple[int, ...], ...]) -> Callable[[FloatArray], FloatArray]:
    """Matrices whose upper triangle, row by row, has the places of each entry."""

    def read(M: FloatArray) -> FloatArray:
        row, column = np.triu_indices(M.shape[1])
        return np.asarray(M[:, row, column][:, np.array(order)])

    return read


def _permuted(axes: list[int]) -> Callable[[FloatArray], FloatArray]:
    return lambda M: np.asarray(M[:, axes][:, :, axes])


def _lower(p: int) -> tuple[tuple[int, ...], ...]:
    """Places of entries where the lower triangle was written row by row."""
    high, low = np.maximum.outer(np.arange(p), np.arange(p)), np.minimum.outer(*[np.arange(p)] * 2)
    return tuple(map(tuple, (high * (high + 1) // 2 + low).tolist()))


def _of_cholesky(M: FloatArray) -> FloatArray:
    U: FloatArray = np.triu(M)
    return np.asarray(np.swapaxes(U, 1, 2) @ U)


def inverses(M: FloatArray) -> FloatArray:
    """Of what is measured; rows of zeros remain so."""
    if not unmeasured(M).any():
        with suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.inv(M), dtype=np.float64)
    return np.asarray(np.linalg.pinv(M, hermitian=True), dtype=np.float64)


def _turned(factor: float) -> Callable[[FloatArray], FloatArray]:
    def read(M: FloatArray) -> FloatArray:
        unit = np.repeat([1.0, math.sqrt(factor)], 3)
        return np.asarray(M * np.outer(unit, unit))

    return read


_BY_ROWS = "write the upper triangle row by row, translation before rotation"


def orders(d: int) -> tuple[Meaning, ...]:
    """Orders of the numbers of a matrix."""
    kind, p = "information-order", d * (d + 1) // 2
    lower = Meaning(kind, "are lower triangles, row by row", _BY_ROWS, _reordered(_lower(p)))
    if d == 3:
        turned = Meaning(
            kind,
            "have rotation before translation, as GTSAM's",
            "write translation before rotation, or read the file as GTSAM's",
            _permuted([3, 4, 5, 0, 1, 2]),
        )
        return turned, lower
    return (
        Meaning(
            kind,
            "are in TORO's order: xx xy yy tt xt yt",
            "write xx xy xt yy yt tt, or EDGE2 instead of EDGE_SE2",
            _reordered(((0, 1, 4), (1, 2, 5), (4, 5, 3))),
        ),
        Meaning(
            kind,
            "are in g2o's order: xx xy xt yy yt tt",
            "write xx xy yy tt xt yt, or EDGE_SE2 instead of EDGE2",
            _reordered(((0, 1, 3), (1, 5, 2), (3, 2, 4))),
        ),
        lower,
        Meaning(kind, "have the angle first", _BY_ROWS, _permuted([1, 2, 0])),
    )


OTHERS = (
    Meaning(
        "covariance",
        "are covariances, not information",
        "invert them, or read with --weights-are covariance",
        inverses,
    ),
    Meaning(
        "square-root",
        "are square roots of information",
        "square them, or read with --weights-are sqrt-information",
        _of_cholesky,
    ),
)
#: In space, of the residual of the cost: a quaternion's vector part is half of a tangent vector.
OF_QUATERNIONS = {
    "quaternion": Meaning(
        "quaternion-information",
        "are about tangent vectors, not about quaternions as g2o takes them",
        "take another cost, such as --cost gtsam or --cost chordal, or multiply them by 4",
        _turned(4.0),
    ),
    "tangent": Meaning(
        "quaternion-information",
        "are about quaternions, not about tangent vectors",
        "read with --rotation-information quaternion, or divide them by 4",
        _turned(0.25),
    ),
}
