"""The exact weights of many information matrices, in batches.

`certpgo.io.exact.information.weights` is the definition, in integers. Double-double arithmetic
gives the same doubles for numbers of at most 15 digits; the definition is used when an error bound
leaves the rounding, or positive definiteness, undecided.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from certpgo.checker import FAR
from certpgo.errors import InputError
from certpgo.graph.edges import in_range
from certpgo.io.exact.doubledouble import (
    DD,
    add,
    divide,
    multiply,
    negative,
    rounds_alike,
    two_product,
    two_sum,
)
from certpgo.io.exact.information import InformationLayout, indefinite, weights
from certpgo.linalg import compiled
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray

#: Decimals of at most 15 digits round to distinct doubles.
_MAX_INTEGER = 1e15
_MAX_LENGTH = 16
#: Shorter decimals are zero if and only if their double is, unless they are unusual.
_MAX_ZERO_LENGTH = 200

#: Error bound of determinants and adjugates, relative to the largest entry's power; true errors are
#: below a few tens of 2^-104.
_MARGIN = 2.0**-92
#: Smaller scaled determinants are computed in integers.
_REGULAR = 2.0**-36
_UNUSUAL = re.compile(rb"_|[eE][-+]?\d{3}")


class Weighed(NamedTuple):
    """The weights of k information matrices, and the matrices themselves.

    Attributes
    ----------
    kappa, tau : (k,) weights; 0 for a block of zeros
    indefinite : (k,) which full matrices are not positive definite, without zero rows
    numbers : (k, size) of the matrices, in the order of the text
    """

    kappa: FloatArray
    tau: FloatArray
    indefinite: BoolArray
    numbers: FloatArray


def weigh(texts: list[bytes], layout: InformationLayout) -> Weighed:
    """The weights of information matrices, given as numbers separated by blanks."""
    found = _weighed(texts, layout)
    kappa, tau = found.kappa, found.tau
    weighty = in_range(kappa) | (kappa == 0.0), in_range(tau) | (tau == 0.0)
    if not (weighty[0] & weighty[1]).all():
        raise InputError(f"information must give weights between {1.0 / FAR:.2g} and {FAR:.2g}")
    return found


def stated_blocks(texts: list[bytes], layout: InformationLayout) -> tuple[FloatArray, FloatArray]:
    """Weights 1 of rotations and translations, 0 where the text states that they are not measured.

    That is a block of zeros beside another one. What else is in the texts does not matter.
    """
    ones = np.ones(len(texts))
    try:
        values, _ = _read(texts, layout)
    except InputError:
        return ones, ones
    p = len(layout.positions)
    blocks = (layout.upper(layout.d, p), layout.upper(0, layout.d))
    turned, moved = (np.array(values[:, block].any(axis=1)) for block in blocks)
    return ones_where(turned, moved)


def ones_where(turned: BoolArray, moved: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Weights 1 of rotations and translations, 0 where the other alone is stated."""
    return np.where(moved & ~turned, 0.0, 1.0), np.where(turned & ~moved, 0.0, 1.0)


def _weighed(texts: list[bytes], layout: InformationLayout) -> Weighed:
    values, lengths = _read(texts, layout)
    plain = np.isfinite(values).all(axis=1)
    if _UNUSUAL.search(b" ".join(texts)):
        plain &= np.array([not _UNUSUAL.search(text) for text in texts], dtype=np.bool_)
    d = layout.d
    kappa, certain = _block(values, lengths, layout.upper(d, len(layout.positions)))
    tau, certain_tau = _block(values, lengths, layout.upper(0, d))
    if d == 3:
        kappa *= 0.5
    for k in np.flatnonzero(~(plain & certain & certain_tau)):
        kappa[k], tau[k] = _exact(texts[k], layout)
    return Weighed(kappa, tau, indefinite(values, layout), values)


def _read(texts: list[bytes], layout: InformationLayout) -> tuple[FloatArray, IntArray]:
    """The numbers (k, size) in the texts, and how long they are written."""
    size = layout.size
    values, lengths = np.empty((len(texts), size)), np.empty((len(texts), size), dtype=np.intp)
    if compiled.AVAILABLE and compiled.kernel.numbers(texts, values, lengths):
        return values, lengths
    tokens = b" ; ".join([*texts, b""]).split()
    try:
        # A separator after every size-th number, unless some text has more or fewer.
        separators = tokens[size :: size + 1]
        if separators != [b";"] * len(texts) or len(tokens) != len(texts) * (size + 1):
            raise ValueError
        del tokens[size :: size + 1]
        values[:] = np.array(list(map(float, tokens))).reshape(-1, size)
    except ValueError:
        for text in texts:
            _exact(text, layout)
        raise InputError("information must be decimal numbers") from None
    lengths[:] = np.array(list(map(len, tokens)), dtype=np.intp).reshape(-1, size)
    return values, lengths


def _exact(text: bytes, layout: InformationLayout) -> tuple[float, float]:
    return weights(text.decode("ascii", "replace"), layout)


def _block(
    values: FloatArray, lengths: IntArray, block: tuple[int, ...]
) -> tuple[FloatArray, BoolArray]:
    """The means size / tr(A^-1) of diagonal blocks A (k,), and which are certain."""
    upper, length = values[:, block].T, lengths[:, block].max(axis=1)
    size = {1: 1, 3: 2, 6: 3}[len(block)]
    diagonal = [0, 2, 3][:size] if size < 3 else [0, 3, 5]
    out = upper[0].copy()
    # Equal doubles on the diagonal: the mean lies between the decimals, and rounds the same.
    isotropic = (upper[diagonal] == out).all(axis=0) & (out > 0.0)
    isotropic &= ~np.delete(upper, diagonal, axis=0).any(axis=0) & (length <= _MAX_ZERO_LENGTH)
    rest = np.flatnonzero(~isotropic & (length <= _MAX_LENGTH) & (size > 1))
    certain = isotropic
    if len(rest):
        out[rest], certain[rest] = _harmonic_means(upper[:, rest], diagonal)
    return out, certain


def _harmonic_means(upper: FloatArray, diagonal: list[int]) -> tuple[FloatArray, BoolArray]:
    size = len(diagonal)
    N, power = _scaled_integers(upper)
    scale = np.abs(N).max(axis=0)
    with np.errstate(all="ignore"):
        minors, determinant, adjugate = (_planar if size == 2 else _spatial)(N)
        zero = np.zeros_like(scale)
        numerator = multiply((zero + size, zero), determinant)
        mean = divide(numerator, multiply(adjugate, (power, zero)))
        regular = (determinant[0] > _REGULAR * scale**size) & (minors > _REGULAR * scale).all(
            axis=0
        )
        # |error| <= MARGIN (scale^size / det + scale^(size-1) / adjugate), relative.
        margin = 4.0 * _MARGIN * (scale**size / determinant[0] + scale ** (size - 1) / adjugate[0])
        certain = regular & rounds_alike(mean, margin)
    return mean[0] + mean[1], certain


def _planar(N: FloatArray) -> tuple[FloatArray, DD, DD]:
    """Leading minors except the determinant, determinant, trace of the adjugate."""
    a, b, c = N
    return a[None], add(two_product(a, c), negative(two_product(b, b))), two_sum(a, c)


def _spatial(N: FloatArray) -> tuple[FloatArray, DD, DD]:
    a, b, c, p, q, r = N
    zero = np.zeros_like(a)

    def minor(w: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> DD:
        return add(two_product(w, x), negative(two_product(y, z)))

    xx, yy, zz = minor(p, r, q, q), minor(a, r, c, c), minor(a, p, b, b)
    determinant = add(
        multiply((a, zero), xx),
        add(
            multiply((-b, zero), minor(b, r, c, q)),
            multiply((c, zero), minor(b, q, c, p)),
        ),
    )
    scale = np.abs(N).max(axis=0)
    return np.stack([a, zz[0] / scale]), determinant, add(add(xx, yy), zz)


def _scaled_integers(upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Integers N (in doubles) and powers of ten with N / power the decimals; NaN if none."""
    N, power = np.full_like(upper, np.nan), np.ones(upper.shape[1])
    remaining = np.arange(upper.shape[1])
    for digits in range(0, _MAX_LENGTH, 3):
        with np.errstate(over="ignore"):  # too large to fit
            scaled = np.rint(upper[:, remaining] * 10.0**digits)
        fits = (scaled / 10.0**digits == upper[:, remaining]) & (np.abs(scaled) < _MAX_INTEGER)
        found = fits.all(axis=0)
        N[:, remaining[found]] = scaled[:, found]
        power[remaining[found]] = 10.0**digits
        remaining = remaining[~found]
    return N, power
