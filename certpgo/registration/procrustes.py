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


def procrustes(target: FloatArray, source: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motions (b, d, d), (b, d) that best take points (b, k, d) to others, k at least d."""
    R, t, _ = _fitted(target, source, dilated=False)
    return R, t


def extended_procrustes(target: FloatArray, source: FloatArray) -> Similarities:
    """Similarities that best take points (b, k, d) to others, k at least d.

    Points of two monocular maps, each in its own unit, give an edge of a
    `certpgo.SimilarityGraph`: with those of node i as target and those of j as source, R_ij, t_ij
    and s_ij. Where all points of the source coincide, the scale is not a number.

    Examples
    --------
    Umeyama's example, whose best fit without a rotation would be a reflection:

    >>> import numpy as np
    >>> from certpgo.registration.procrustes import extended_procrustes
    >>> source = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]])
    >>> target = np.array([[[0.0, 0.0], [-1.0, 0.0], [0.0, 2.0]]])
    >>> R, t, s = extended_procrustes(target, source)
    >>> R[0].round(3).tolist(), t[0].round(3).tolist(), float(s[0].round(3))
    ([[0.832, 0.555], [-0.555, 0.832]], [-0.8, 0.4], 0.721)
    """
    return _fitted(target, source, dilated=True)


def _fitted(target: FloatArray, source: FloatArray, *, dilated: bool) -> Similarities:
    p, q = target.mean(axis=1), source.mean(axis=1)
    x, y = target - p[:, None], source - q[:, None]
    moment = np.swapaxes(x, 1, 2) @ y
    R = so.project(moment)
    s = np.ones(len(R))
    if dilated:
        # The sum of |x - s R y|^2 is least where s |y|^2 = tr(R^T x y^T).
        s = np.einsum("bij,bij->b", R, moment) / np.einsum("bki,bki->b", y, y)
    return Similarities(R, p - s[:, None] * (R @ q[:, :, None])[:, :, 0], s)
