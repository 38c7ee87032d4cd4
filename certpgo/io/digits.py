"""The digits of a file's poses, and rounding to them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Estimate
from certpgo.graph.phrases import counted
from certpgo.io.chunks import without_comments
from certpgo.io.compressed import opened
from certpgo.io.exact import quaternion
from certpgo.io.format import Chart, format_of
from certpgo.linalg.arrays import FloatArray

#: Pose lines to examine.
SAMPLE = 2000
#: Significant digits from which nothing is lost.
ALL = 15
#: Numbers below `SMALL` required to distinguish decimals from significant digits.
ENOUGH, SMALL = 5, 0.1

_NUMBER = re.compile(rb"[-+]?(?=\.?\d)(\d*)(?:\.(\d*))?(?:[eE]([-+]?\d{1,9}))?\Z")


@dataclass(frozen=True)
class Digits:
    """The precision of written numbers.

    Attributes
    ----------
    count : number of digits
    decimals : whether these are decimals, not significant digits
    """

    count: int
    decimals: bool

    def rounded(self, x: FloatArray) -> FloatArray:
        """Numbers (...,) rounded to these digits."""
        if self.decimals:
            return np.asarray(np.round(x, self.count))
        size = np.maximum(np.abs(x), 1e-280)  # smaller is zero
        unit = 10.0 ** (np.floor(np.log10(size)) + 1.0 - self.count)
        return np.asarray(np.round(x / unit) * unit)

    def __str__(self) -> str:
        return counted(self.count, "decimal{s}" if self.decimals else "significant digit{s}")


@dataclass(frozen=True)
class Writing:
    """How a text file represents poses, and with how many digits."""

    chart: Chart
    digits: Digits

    def rounded(self, estimate: Estimate) -> Estimate:
        """The estimate as the file would store it.

        Raises
        ------
        InputError
            There are too few digits for rotations.
        """
        R, t = estimate.rotations, estimate.translations
        if self.chart.world_to_camera:
            R, t = _inverse(R, t)
        R = self._rotations(R)
        t = None if t is None else self.digits.rounded(t)
        if self.chart.world_to_camera:
            R, t = _inverse(R, t)
        return Estimate(R, t)

    def _rotations(self, R: FloatArray) -> FloatArray:
        d, rounded = R.shape[-1], self.digits.rounded
        if d == 2 and self.chart.planar_angle:
            return quaternion.planar_rotations(rounded(np.arctan2(R[:, 1, 0], R[:, 0, 0])))
        if self.chart.rotation == "quaternion":
            q = rounded(quaternion.to_write(R))
        else:
            q = quaternion.from_matrices(rounded(quaternion.embedded(R)))
        return quaternion.rotations(q)[:, :d, :d]


def writing_of(path: str | Path) -> Writing | None:
    """How a file's poses are written; None for binary formats, and with all digits.

    Raises
    ------
    FormatError
        The file cannot be read.
    """
    path = Path(path)
    form = format_of(path)
    if form.chart is None:
        return None
    try:
        with opened(path) as lines:
            digits = digits_of(list(chain.from_iterable(_sample(lines, form.chart))))
    except OSError as error:
        raise FormatError(path, None, f"cannot be read: {error.strerror}") from None
    return None if digits is None else Writing(form.chart, digits)


def digits_of(words: list[bytes]) -> Digits | None:
    """The precision of written numbers; None for all digits, and without numbers.

    Decimals are counted if all numbers have equally many, or if small numbers have fewer
    significant digits than large ones; otherwise the precision is the largest number of significant
    digits, as trailing zeros may have been dropped.
    """
    parts = [match.groups(b"") for word in words if (match := _NUMBER.match(word))]
    if not parts:
        return None
    significant = np.array([len((whole + tail).lstrip(b"0")) for whole, tail, _ in parts])
    decimals = np.array([len(tail) - int(power or b"0") for _, tail, power in parts])
    size = np.abs(np.array([float(word) for word in words if _NUMBER.match(word)]))
    most = int(significant.max())
    if most >= ALL:
        return None
    plain = not any(power for _, _, power in parts)
    small = (size > 0.0) & (size < SMALL)
    shrinking = small.sum() >= ENOUGH and int(significant[small].max()) < most
    if plain and (np.ptp(decimals) == 0 or shrinking):
        return Digits(int(decimals.max()), True)
    return Digits(max(most, 1), False)


def _sample(lines: Iterable[bytes], chart: Chart) -> Iterator[list[bytes]]:
    """The numbers of the first pose lines."""
    texts = (words for line in lines if (words := without_comments(line).split()))
    return islice((numbers for words in texts if (numbers := chart.numbers(words))), SAMPLE)


def _inverse(R: FloatArray, t: FloatArray | None) -> tuple[FloatArray, FloatArray | None]:
    back = np.swapaxes(R, 1, 2)
    return back, None if t is None else -np.einsum("nab,nb->na", back, t)
