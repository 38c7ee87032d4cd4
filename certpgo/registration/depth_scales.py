"""Frames whose depths have unknown units: a factor for each, from similarities between frames.

A network that sees one image, or a stereo pair of unknown baseline, tells depths up to a factor
that differs from frame to frame. At first each frame gets the unit in which its median depth is
`MEDIAN`, which no factor changes. Matched points of two frames then tell the ratio of their units.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from certpgo.errors import FormatError
from certpgo.graph.edges import components_of
from certpgo.io.csv_files import text_of
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.pairs import FramePair
from certpgo.registration.sequences import Frame, FrameSequence
from certpgo.registration.stages import Progress, digest, each, silent

#: Median depth of a frame in its first unit, and of a map's frames in its own, in the geometric
#: mean: about that of rooms in metres, as what the front end has in metres must be about right.
MEDIAN = 2.0
#: Rounds of re-weighting, and the change of a logarithm of scale at which it ends.
ROUNDS, SETTLED = 100, 1e-9
#: Standard deviations of a logarithm of scale from which a pair pulls no harder.
HUBER = 1.345


@dataclass(frozen=True, eq=False, kw_only=True)
class ScaledSequence(FrameSequence):
    """Frames whose depths are multiplied by a factor each.

    Attributes
    ----------
    source : the frames as they are
    factors : (n,) positive
    """

    source: FrameSequence
    factors: FloatArray

    def frame(self, k: int) -> Frame:
        """The k-th frame."""
        frame = self.source.frame(k)
        return Frame(frame.colour, (self.factors[k] * frame.depth).astype(np.float32))

    def key(self, k: int) -> str:
        """A digest of the k-th frame's content and factor."""
        return digest(self.source.key(k), float(self.factors[k]))

    def _of_frames(self, kept: list[int]) -> dict[str, Any]:
        return {"source": self.source.chosen(kept), "factors": self.factors[kept]}


def with_factors(frames: FrameSequence, factors: FloatArray) -> ScaledSequence:
    """Frames with their depths multiplied by factors (n,).

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.registration.depth_scales import with_factors
    >>> from certpgo.registration.synthetic import synthetic_sequence
    >>> frames = synthetic_sequence(2, size=(64, 48))
    >>> twice = with_factors(frames, np.array([1.0, 2.0]))
    >>> bool((twice.frame(1).depth == 2.0 * frames.frame(1).depth).all())
    True
    """
    return ScaledSequence(
        name=frames.name,
        names=frames.names,
        times=frames.times,
        camera=frames.camera,
        truth=frames.truth,
        registered=frames.registered,
        source=frames,
        factors=np.asarray(factors, dtype=np.float64),
    )


def with_factors_of(path: Path, frames: FrameSequence) -> ScaledSequence:
    """The frames that a file of factors names, with their depths multiplied.

    Raises
    ------
    FormatError
        The file cannot be read, a line has no name and positive factor, or a frame is named twice.
    """
    found: dict[str, float] = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.DictReader(file)
            for row in rows:
                name, factor = text_of(row.get("name") or ""), _positive(row.get("factor") or "")
                if not name or name in found or factor is None:
                    said = "columns name and factor expected: a frame once, and a positive number"
                    raise FormatError(path, rows.line_num, said)
                found[name] = factor
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        said = getattr(error, "strerror", None) or "no CSV file"
        raise FormatError(path, None, f"cannot be read: {said}") from None
    known = [k for k, name in enumerate(frames.names) if name in found]
    if not known:
        raise FormatError(path, None, f"names no frame of {frames.name}")
    return with_factors(frames.chosen(known), np.array([found[frames.names[k]] for k in known]))


def _positive(text: str) -> float | None:
    """A positive number; None for any other text."""
    try:
        number = float(text)
    except ValueError:
        return None
    return number if 0.0 < number < math.inf else None


def of_one_median(frames: FrameSequence, progress: Progress = silent) -> ScaledSequence:
    """The frames, each in the unit in which its median depth is `MEDIAN`.

    Frames without any depth, or whose files are damaged, keep their unit.
    """

    def factor(k: int) -> float:
        try:
            depth = frames.frame(k).depth
        except FormatError:  # it is left out, with the reason, when it is looked at
            return 1.0
        known = depth[depth > 0.0]
        return MEDIAN / float(np.median(known)) if len(known) else 1.0

    return with_factors(frames, np.array(each("depths", factor, range(len(frames)), progress)))


def agreed_scales(pairs: Sequence[FramePair], n: int) -> FloatArray:
    """(n,) scales s of frames with s_j / s_i as the pairs measure them.

    The sum of Huber's function of (log s_j - log s_i - log s_ij) over their standard deviations is
    least, so that wrong pairs pull no harder than others. Frames that pairs join have a geometric
    mean of 1.

    Parameters
    ----------
    pairs : with scales and covariances (7, 7)
    n : number of frames
    """
    edges = np.array([(pair.i, pair.j) for pair in pairs], dtype=np.intp).reshape(-1, 2)
    measured = np.log([pair.scale for pair in pairs])
    deviation = np.sqrt([pair.covariance[6, 6] for pair in pairs])
    row = np.arange(len(pairs))
    signs, shape = np.tile([-1.0, 1.0], len(row)), (len(pairs), n)
    D = sparse.csr_array((signs, (np.repeat(row, 2), edges.ravel())), shape)
    part = components_of(n, edges)
    # One of each part is pinned.
    loose = np.setdiff1d(np.arange(n), np.unique(part, return_index=True)[1])
    x, pull = np.zeros(n), np.ones(len(row))
    for _ in range(ROUNDS):
        weighted = sparse.diags_array(pull / deviation**2) @ D[:, loose]
        normal = sparse.csc_array(D[:, loose].T @ weighted)
        found = spsolve(normal, weighted.T @ measured) if len(loose) else x[loose]
        change, x[loose] = float(np.abs(found - x[loose]).max(initial=0.0)), found
        if change < SETTLED:
            break
        off = np.abs(D @ x - measured) / deviation
        pull = HUBER / np.maximum(off, HUBER)
    means = np.bincount(part, x) / np.bincount(part)
    return np.asarray(np.exp(x - means[part]))
