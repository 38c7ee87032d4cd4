"""Exact weights: from the text of an information matrix to kappa and tau.

The decimals in a file are exact rationals; kappa and tau are rational functions of them, rounded
once to the nearest double, so that every machine reads the same problem (LAPACK's inverse differs
between machines). With Omega_t the leading and Omega_R the trailing block,

    3D   tau = 3 / tr(Omega_t^-1)    kappa = 3 / (2 tr(Omega_R^-1))
    2D   tau = 2 / tr(Omega_t^-1)    kappa = Omega_theta

as in SE-Sync (Rosen et al. 2019, Section 5). A direction of which a matrix states nothing, by a row
and a column of zeros, is left out of these means; a block without any has the weight 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from certpgo.errors import InputError
from certpgo.linalg.arrays import BoolArray, FloatArray

#: Decimal exponents and digit counts beyond a double's range are refused to save memory.
_MAX_EXPONENT = 400


@dataclass(frozen=True)
class InformationLayout:
    """The order of the entries of a symmetric information matrix in a format.

    Attributes
    ----------
    positions : position, in the text, of each entry of the matrix ordered (translation, rotation)
    count : number of entries in the text, where there are others too; 0 if there are none
    """

    positions: tuple[tuple[int, ...], ...]
    count: int = 0

    @property
    def d(self) -> int:
        """Dimension of space."""
        return 3 if len(self.positions) == 6 else 2

    @property
    def size(self) -> int:
        """Number of entries in the text."""
        p = len(self.positions)
        return self.count or p * (p + 1) // 2

    def upper(self, start: int, stop: int) -> tuple[int, ...]:
        """Positions of the upper triangle of a diagonal block, row by row."""
        return tuple(self.positions[i][j] for i in range(start, stop) for j in range(i, stop))


#: Upper triangle row by row, translation before rotation: g2o and iSAM.
ROW_MAJOR_2D = InformationLayout(((0, 1, 2), (1, 3, 4), (2, 4, 5)))
ROW_MAJOR_3D = InformationLayout(
    (
        (0, 1, 2, 3, 4, 5),
        (1, 6, 7, 8, 9, 10),
        (2, 7, 11, 12, 13, 14),
        (3, 8, 12, 15, 16, 17),
        (4, 9, 13, 16, 18, 19),
        (5, 10, 14, 17, 19, 20),
    )
)
#: TORO's order in 2D: xx xy yy tt xt yt.
TORO_2D = InformationLayout(((0, 1, 4), (1, 2, 5), (4, 5, 3)))


def weights(text: str, layout: InformationLayout) -> tuple[float, float]:
    """The weights kappa and tau of one matrix, each rounded once from the exact rational.

    Parameters
    ----------
    text : the numbers, separated by blanks
    layout : their order

    Raises
    ------
    InputError
        A number is missing, malformed or out of range; both blocks are zero, or one of them is not
        positive definite where it is not zero.
    """
    tokens = text.lower().split()
    if len(tokens) != layout.size:
        raise InputError(f"{layout.size} information numbers expected, {len(tokens)} found")
    if "_" in text:
        raise InputError("information must be decimal numbers")
    d = layout.d
    blocks = (layout.upper(d, len(layout.positions)), layout.upper(0, d))
    (rotation, rotation_exponent), (translation, translation_exponent) = (
        _integers([tokens[k] for k in block]) for block in blocks
    )
    if not any(rotation) and not any(translation):
        raise InputError("the information is zero: nothing is measured")
    n_R, d_R = _harmonic_mean(rotation, "the rotation block of the information")
    n_t, d_t = _harmonic_mean(translation, "the translation block of the information")
    kappa = _rounded(n_R, d_R if d == 2 else 2 * d_R, rotation_exponent)
    return kappa, _rounded(n_t, d_t, translation_exponent)


def position_weight(text: str, layout: InformationLayout) -> float:
    """The weight tau of the matrix of a position, rounded once from the exact rational.

    Parameters
    ----------
    text, layout : as of `weights`

    Raises
    ------
    InputError
        As `weights`.
    """
    tokens = text.lower().split()
    upper, exponent = _integers([tokens[k] for k in layout.upper(0, len(layout.positions))])
    if not any(upper):
        raise InputError("the information of a position is zero: nothing is measured")
    return _rounded(*_harmonic_mean(upper, "the information of a position"), exponent)


def _integers(tokens: Sequence[str]) -> tuple[list[int], int]:
    """Integers N and an exponent e with the decimals equal to N 10^e."""
    try:
        pairs = [_decimal(token) for token in tokens]
    except ValueError:
        raise InputError("information must be decimal numbers") from None
    if max(abs(e) for _, e in pairs) + max(map(len, tokens)) > _MAX_EXPONENT:
        raise InputError("an information number is out of range")
    lowest = min((e for value, e in pairs if value), default=0)
    return [value * 10 ** (e - lowest) if value else 0 for value, e in pairs], lowest


def _decimal(token: str) -> tuple[int, int]:
    mantissa, mark, exponent = token.partition("e")
    whole, _, fraction = mantissa.partition(".")
    return int(whole + fraction), (int(exponent) if mark else 0) - len(fraction)


def _harmonic_mean(upper: list[int], what: str) -> tuple[int, int]:
    """The fraction size / tr(A^-1) of a symmetric matrix A without the rows that are zero.

    From adjugate and determinant; 0 for a zero matrix.
    """
    minors: tuple[int, ...]
    upper = _stated(upper)
    if not upper:
        return 0, 1
    if len(upper) == 1:
        minors, numerator, denominator = (upper[0],), upper[0], 1
    elif len(upper) == 3:
        a, b, c = upper
        determinant = a * c - b * b
        minors, numerator, denominator = (a, determinant), 2 * determinant, a + c
    else:
        a, b, c, p, q, r = upper
        xx, yy, zz = p * r - q * q, a * r - c * c, a * p - b * b
        determinant = a * xx - b * (b * r - c * q) + c * (b * q - c * p)
        minors, numerator, denominator = (a, zz, determinant), 3 * determinant, xx + yy + zz
    if min(minors) <= 0:
        raise InputError(
            f"{what} is not positive definite; a direction that is not measured has a row and a "
            "column of zeros"
        )
    return numerator, denominator


def _stated(upper: list[int]) -> list[int]:
    """The upper triangle of a matrix without the rows and columns that are zero."""
    size = {1: 1, 3: 2, 6: 3}[len(upper)]
    places = list(combinations_with_replacement(range(size), 2))
    known = {axis for place, value in zip(places, upper, strict=True) if value for axis in place}
    return [value for place, value in zip(places, upper, strict=True) if known.issuperset(place)]


def _rounded(numerator: int, denominator: int, exponent: int) -> float:
    """numerator/denominator 10^exponent, correctly rounded."""
    power: int = 10 ** abs(exponent)
    try:
        value = (
            numerator * power / denominator if exponent >= 0 else numerator / (denominator * power)
        )
    except OverflowError:
        value = 0.0
    if value == 0.0 and numerator:
        raise InputError("the information is out of a double's range")
    return value


def indefinite(values: FloatArray, layout: InformationLayout) -> BoolArray:
    """Which full matrices, given as numbers (k, size), are not positive definite without zero rows.

    By elimination in doubles: only for a notice, no weight depends on it.
    """
    positions = np.array(layout.positions)
    coupled = np.flatnonzero(values[:, positions[: layout.d, layout.d :].ravel()].any(axis=1))
    A = values[coupled][:, positions]
    A += np.asarray(~np.any(A, axis=1))[:, None, :] * np.eye(A.shape[-1])
    positive = np.ones(len(A), dtype=np.bool_)
    with np.errstate(all="ignore"):
        for k in range(A.shape[-1]):
            positive &= A[:, k, k] > 0.0
            A -= A[:, :, k, None] * (A[:, None, k, :] / A[:, k, k, None, None])
    out = np.zeros(len(values), dtype=np.bool_)
    out[coupled] = ~positive
    return out
