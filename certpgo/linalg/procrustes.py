"""Points that are matched: the motion or similarity that best takes one set to another.

Least squares in closed form. Schönemann 1966 has rotations, Arun, Huang and Blostein 1987 rigid
motions; the extended problem has a scale too (Schönemann and Carroll, "Fitting one matrix to
another under choice of a central dilation and a rigid motion", 1970; Umeyama 1991 for rotations
without reflection). It is the relative pose of two point clouds whose correspondences are known
(Moreira 2020, section 1.1); for more clouds there is no closed form, but a graph of sightings.
"""

from __future__ import annotations

import numpy as np

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.similarities import Similarities


def procrustes(target: FloatArray, source: FloatArray, *, scaled: bool = False) -> Similarities:
    """Motions that best take points (b, k, d) to others; if ``scaled``, similarities.

    Points of two monocular maps, each in its own unit, give an edge of a
    `certpgo.SimilarityGraph`: with those of node i as target and those of j as source, R_ij, t_ij
    and s_ij. Where all points of the source coincide, the scale is not a number.

    Examples
    --------
    Umeyama's example, whose best fit without a rotation would be a reflection:

    >>> import numpy as np
    >>> from certpgo.linalg.procrustes import procrustes
    >>> source = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]])
    >>> target = np.array([[[0.0, 0.0], [-1.0, 0.0], [0.0, 2.0]]])
    >>> R, t, s = procrustes(target, source, scaled=True)
    >>> R[0].round(3).tolist(), t[0].round(3).tolist(), float(s[0].round(3))
    ([[0.832, 0.555], [-0.555, 0.832]], [-0.8, 0.4], 0.721)
    """
    (p, x), (q, y) = _centred(target), _centred(source)
    R = so.project(np.swapaxes(x, 1, 2) @ y)
    s = dilation(x, y, R) if scaled else np.ones(len(R))
    return Similarities(R, p - s[:, None] * (R @ q[:, :, None])[:, :, 0], s)


def dilation(x: FloatArray, y: FloatArray, R: FloatArray) -> FloatArray:
    """(b,) scales s of least sum |x - s R y|^2, of centred points (b, k, d) and rotations."""
    aligned = np.einsum("bki,bij,bkj->b", x, R, y)
    square = np.einsum("bki,bki->b", y, y)
    s: FloatArray = np.divide(aligned, square, out=np.full(len(R), np.nan), where=square > 0.0)
    return s


def _centred(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Means (b, d) of points (b, k, d), and their differences from them."""
    mean = points.mean(axis=1)
    return mean, points - mean[:, None]
