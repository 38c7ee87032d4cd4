"""Weights of measured poses, from information matrices given as numbers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from certpgo.errors import FormatError, InputError
from certpgo.graph.edges import symmetric
from certpgo.graph.information import Information
from certpgo.graph.phrases import counted
from certpgo.io.exact.information import ROW_MAJOR_2D, ROW_MAJOR_3D, InformationLayout
from certpgo.io.exact.weighing import ones_where, weigh
from certpgo.io.fields import distinct_texts
from certpgo.io.format import ReadOptions
from certpgo.io.precision_kind import as_information
from certpgo.linalg.arrays import FloatArray, IntArray

#: How far a matrix may be from its transpose, relative to its largest entry.
ASYMMETRY = 1e-6
#: What a cross block of a matrix that is indefinite as a whole becomes.
INDEFINITE = "edge{s} with information indefinite as a whole, diagonal blocks used"
#: What becomes of information on some axes.
PARTIAL = (
    "measurement{s} with information on some axes only: F takes their mean for all axes, other "
    "costs take it as it is"
)
#: What becomes of information on positions or rotations alone.
ALONE = "edge{s} with information on a translation or a rotation alone"


class Weighing(NamedTuple):
    """Weights of measured poses.

    Attributes
    ----------
    kappa, tau : (m,) weights
    information : the matrices themselves; None where they are ignored
    notices : what was assumed, one sentence each
    """

    kappa: FloatArray
    tau: FloatArray
    information: Information | None
    notices: tuple[str, ...]


def weighed(
    path: Path,
    matrices: FloatArray,
    rotations: FloatArray,
    options: ReadOptions,
    name: Callable[[int], str],
) -> Weighing:
    """The weights of measurements with these information matrices.

    Parameters
    ----------
    path : of the file, for messages
    matrices : (m, p, p), translation before rotation, p = 3 or 6; 1/m^2, 1/m and dimensionless
    rotations : (m, d, d) measured
    name : of a measurement, for messages

    Raises
    ------
    FormatError
        A matrix is not symmetric, or a diagonal block is not positive definite.
    """
    if options.ignore_information:
        d = 2 if matrices.shape[-1] == 3 else 3
        turned, moved = matrices[:, d:, d:] != 0.0, matrices[:, :d, :d] != 0.0
        return Weighing(*ones_where(turned.any(axis=(1, 2)), moved.any(axis=(1, 2))), None, ())
    off = np.abs(matrices - np.swapaxes(matrices, 1, 2)).max(axis=(1, 2), initial=0.0)
    if (skew := off > ASYMMETRY * np.abs(matrices).max(axis=(1, 2), initial=0.0)).any():
        said = f"{name(int(np.argmax(skew)))}: a symmetric matrix expected"
        raise FormatError(path, None, said)
    layout = ROW_MAJOR_3D if matrices.shape[-1] == 6 else ROW_MAJOR_2D
    row, column = np.triu_indices(len(layout.positions))
    upper = symmetric(matrices)[:, row, column]
    texts, which = distinct_texts(" ".join(map(repr, M)).encode() for M in upper.tolist())
    try:
        found = weigh(as_information(texts, layout, options.weights_are), layout)
    except InputError as error:
        said = _placed(texts, which, layout, options, name, str(error))
        raise FormatError(path, None, said) from None
    kappa, tau = found.kappa[which], found.tau[which]
    if options.rotation_information == "quaternion":
        kappa = 0.25 * kappa  # half the angle, a quarter of the information; exact
    whole = Information(found.numbers[:, np.array(layout.positions)], which)
    indefinite = int(np.count_nonzero(found.indefinite[which]))
    counts = {INDEFINITE: indefinite, **partial_counts(whole, kappa, tau)}
    notices = tuple(counted(count, what) for what, count in counts.items() if count)
    return Weighing(kappa, tau, whole.in_first_frames(rotations), notices)


def partial_counts(information: Information, kappa: FloatArray, tau: FloatArray) -> dict[str, int]:
    """How many measured poses state information on some axes, or on one block, alone."""
    alone = (kappa == 0.0) | (tau == 0.0)
    partial = int(np.count_nonzero(information.is_partial))
    return {PARTIAL: partial, ALONE: int(np.count_nonzero(alone))}


def _placed(
    texts: list[bytes],
    which: IntArray,
    layout: InformationLayout,
    options: ReadOptions,
    name: Callable[[int], str],
    said: str,
) -> str:
    """What is wrong with the first matrix that cannot be read, with its name."""
    for k, text in enumerate(texts):
        try:
            weigh(as_information([text], layout, options.weights_are), layout)
        except InputError as error:
            return f"{name(int(np.argmax(which == k)))}: {error}"
    return said
