"""Conventions that measured poses, or distances, may have been written in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from certpgo.diagnosis.conventions import with_w_first
from certpgo.linalg.arrays import FloatArray, IntArray

Columns = tuple[IntArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class EdgeReading:
    """A convention of measured poses, or a unit of theirs or of distances.

    Attributes
    ----------
    kind : its name in findings
    said : what the poses are, after "all edges are "
    next : what to do about them
    read : edges (k, 2), rotations and translations as they are meant, from those that are given
    dimensions : of spaces that it is for
    metres : what lengths are multiplied by; 1 where it is no unit
    """

    kind: str
    said: str
    next: str
    read: Callable[[IntArray, FloatArray, FloatArray], Columns]
    dimensions: tuple[int, ...] = (2, 3)
    metres: float = 1.0


def _apply(R: FloatArray, t: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("mab,mb->ma", R, t))


def _mirrored(kind: str, axis: int, *, turned: bool) -> EdgeReading:
    name, both = "xyz"[axis], ("translations", "poses")[turned]

    def read(E: IntArray, R: FloatArray, t: FloatArray) -> Columns:
        signs = np.where(np.arange(R.shape[1]) == axis, -1.0, 1.0)
        return E, signs[:, None] * R * signs if turned else R, signs * t

    said = f"written with {both} mirrored in {name}"
    rest = ", and turn rotations accordingly (S R S)" if turned else ""
    dimensions = (3,) if axis == 2 else (2, 3)
    return EdgeReading(kind, said, f"negate {name} of translations{rest}", read, dimensions)


IN_DEGREES = EdgeReading(
    "edges-in-degrees",
    "written with angles in degrees",
    "write angles in radians",
    lambda E, R, t: (E, R, t),  # of rotations that are read so
    (2,),
)
READINGS = (
    EdgeReading(
        "inverted-edges",
        "inverses: of i in j, not of j in i",
        "swap the two ids of each, or invert the poses",
        lambda E, R, t: (E[:, ::-1], R, t),
    ),
    EdgeReading(
        "transposed-rotations",
        "written with transposed rotations",
        "transpose each rotation: negate its angle, or x, y and z of its quaternion",
        lambda E, R, t: (E, np.swapaxes(R, 1, 2), t),
    ),
    EdgeReading(
        "edges-w-first",
        "written with quaternions of w first",
        "write quaternions as qx qy qz qw",
        lambda E, R, t: (E, with_w_first(R), t),
        (3,),
    ),
    EdgeReading(
        "translations-in-other-frame",
        "written with translations in the frame of j, not of i (or of i in j: both fit as well)",
        "replace each translation t by R t",
        lambda E, R, t: (E, R, _apply(R, t)),
    ),
    EdgeReading(
        "inverse-translations",
        "written with translations of i in j, and rotations of j in i",
        "replace each translation t by -R t",
        lambda E, R, t: (E, R, -_apply(R, t)),
    ),
    EdgeReading(
        "negated-translations",
        "written with translations from j to i, in the frame of i",
        "negate each translation",
        lambda E, R, t: (E, R, -t),
    ),
    *(_mirrored("mirrored-edges", axis, turned=False) for axis in range(3)),
    *(_mirrored("edges-of-other-handedness", axis, turned=True) for axis in range(3)),
    IN_DEGREES,
)
