"""Rigid motions and similarities from matched points in space: RANSAC, Procrustes, refinement.

Convention: p_target ~ s R p_source + t, so that an edge (target, source) of a graph measures
(R, t), and s where units of length are unknown; otherwise s is 1. Tangents are (rotation,
translation), and the logarithm of s if it is unknown, in the frame of the source: T exp(xi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.linalg.procrustes import procrustes

#: Steps of refinement at most, and the step, in standard deviations, at which it ends.
STEPS, SETTLED = 10, 1e-3
#: Variance of unit weight at least: exact points have none.
LEAST = 0.01
#: Triples that are drawn together.
BATCH = 256
#: Matches by which hypotheses are compared.
JUDGES = 200


@dataclass(frozen=True)
class RansacSettings:
    """When two frames match.

    Attributes
    ----------
    iterations : triples of matches that are drawn
    gate : Mahalanobis distance of an inlier at most, by the sensor's noise: 3.75 keeps 99.7 %, as
        three standard deviations do in one direction
    threshold_m2 : in its place the squared distance of an inlier at most, m^2
    matches : matches from which on a motion is looked for
    inliers, share : inliers, and their share of the matches, at least
    confidence : probability of having drawn three inliers at which the search ends

    Raises
    ------
    SpecError
        A setting out of its range.

    Examples
    --------
    >>> from certpgo.registration.ransac import THESIS, RansacSettings
    >>> RansacSettings().gate, THESIS.threshold_m2
    (3.75, 3e-06)
    """

    iterations: int = 7000
    gate: float = 3.75
    threshold_m2: float | None = None
    matches: int = 30
    inliers: int = 30
    share: float = 0.25
    confidence: float = 1.0 - 1e-9

    def __post_init__(self) -> None:
        positive = self.iterations > 0 and self.gate > 0.0 and self.inliers >= 3
        known = self.threshold_m2 is None or self.threshold_m2 > 0.0
        if not (positive and known and 0.0 <= self.share <= 1.0 and 0.0 < self.confidence < 1.0):
            raise SpecError("settings of RANSAC must be positive, shares at most 1, inliers 3")


#: Table D.1 of the thesis. "RANSAC RMSE threshold 3.0e-6" is a mean square in m^2.
THESIS = RansacSettings(threshold_m2=3.0e-6, matches=100)


@dataclass(frozen=True, eq=False)
class Motion:
    """A rigid motion or a similarity between matched points.

    Attributes
    ----------
    R, t : p_target ~ scale R p_source + t, metres, or the unit of the target
    information : (6, 6) of the tangent (rotation, translation), 1/rad^2, 1/(rad m) and 1/m^2;
        (7, 7) of (rotation, translation, log scale) in the unit of the source for a similarity
    inliers : (k,) which matches agree
    chi2 : mean squared Mahalanobis distance of the inliers over 3; 1 for the stated noise
    scale : 1 for a rigid motion
    """

    R: FloatArray
    t: FloatArray
    information: FloatArray
    inliers: BoolArray
    chi2: float
    scale: float = 1.0

    @property
    def share(self) -> float:
        """Share of the matches that agree."""
        return float(self.inliers.mean())


def register(
    target: FloatArray,
    source: FloatArray,
    covariances: tuple[FloatArray, FloatArray],
    rng: np.random.Generator,
    settings: RansacSettings | None = None,
    *,
    scaled: bool = False,
) -> Motion | None:
    """The motion on which most matches agree; None if too few do.

    Parameters
    ----------
    target, source : (k, 3) matched points, metres, or each in a unit of its own
    covariances : (k, 3, 3) of both, m^2, each in its own frame and unit
    rng : draws the triples
    scaled : whether the ratio of the units is unknown, and a similarity is looked for

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.linalg import rotations as so
    >>> from certpgo.registration.ransac import register
    >>> rng = np.random.default_rng(0)
    >>> p, R, t = rng.uniform(-1, 1, (100, 3)), so.random(rng, 1, 3)[0], np.array([1.0, 2, 3])
    >>> q = p @ R.T + t + 0.001 * rng.standard_normal((100, 3))
    >>> q[:50] += rng.uniform(-1, 1, (50, 3))  # half of the matches are wrong
    >>> noise = np.tile(0.0005**2 * np.eye(3), (100, 1, 1))
    >>> motion = register(q, p, (noise, noise), rng)
    >>> int(motion.inliers[50:].sum()) > 40, bool(np.linalg.norm(motion.t - t) < 0.001)
    (True, True)
    """
    chosen = settings or RansacSettings()
    if len(target) < max(chosen.matches, chosen.inliers):
        return None
    variances = np.array([np.trace(C, axis1=1, axis2=2) / 3.0 for C in covariances])
    start = _search(target, source, variances, rng, chosen, scaled)
    if start is None:
        return None
    return refine(target, source, covariances, start, chosen, scaled=scaled)


def _search(
    target: FloatArray,
    source: FloatArray,
    variances: FloatArray,
    rng: np.random.Generator,
    settings: RansacSettings,
    scaled: bool,
) -> tuple[FloatArray, FloatArray, float] | None:
    """The hypothesis of most inliers, by distances in units of isotropic noise.

    Parameters
    ----------
    variances : (2, k) of the points of target and source
    """
    k = len(target)
    judges = np.arange(k) if k <= JUDGES else rng.permutation(k)[:JUDGES]
    best, most = None, 2
    p, q = target[judges].T, source[judges].T
    for drawn in range(0, settings.iterations, BATCH):
        # Triples that are pruned cannot be three inliers: all that were drawn count.
        if drawn * (most / len(judges)) ** 3 > -math.log1p(-settings.confidence):
            break
        triples = rng.integers(k, size=(min(BATCH, settings.iterations - drawn), 3))
        triples = triples[_alike(target[triples], source[triples], variances[:, triples], scaled)]
        if not len(triples):
            continue
        R, t, s = procrustes(target[triples], source[triples], scaled=scaled)
        off = s[:, None, None] * (R @ q) + t[:, :, None] - p
        limit = settings.gate**2 * 3.0 * _added(variances[:, judges], s[:, None])
        if settings.threshold_m2 is not None:
            limit = np.full(limit.shape, 3.0 * settings.threshold_m2)
        counts = (np.einsum("bak,bak->bk", off, off) < limit).sum(axis=1)
        winner = int(counts.argmax())
        if counts[winner] > most:
            most, best = int(counts[winner]), (R[winner], t[winner], float(s[winner]))
    return best


def _added(variances: FloatArray, s: FloatArray) -> FloatArray:
    """Variances of p - s R q, of those of p and q: (2, ...) to (...)."""
    return np.asarray(variances[0] + s**2 * variances[1])


def _alike(p: FloatArray, q: FloatArray, variances: FloatArray, scaled: bool) -> BoolArray:
    """(b,) which triangles (b, 3, 3) are congruent, or similar, and no slivers."""
    sides = [np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2) for x in (p, q)]
    s = np.ones((len(p), 1))
    if scaled:
        total = sides[1].sum(axis=1, keepdims=True)
        s = sides[0].sum(axis=1, keepdims=True) / np.where(total > 0.0, total, np.inf)
    tolerance = 2.0 * np.sqrt(_added(variances, s))
    allowed = tolerance + np.roll(tolerance, 1, axis=1)
    equal = (np.abs(sides[0] - s * sides[1]) < allowed).all(axis=1)
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    longest = sides[0].max(axis=1)
    wide = (area > 0.1 * longest**2) & (longest > 5.0 * tolerance.max(axis=1))
    return np.asarray(equal & wide)


def refine(
    target: FloatArray,
    source: FloatArray,
    covariances: tuple[FloatArray, FloatArray],
    start: tuple[FloatArray, FloatArray, float],
    settings: RansacSettings,
    *,
    scaled: bool = False,
) -> Motion | None:
    """The most likely motion for the matches within the gate, by Gauss and Newton's steps.

    Residuals are seen in the frame of the source, e = R^T (p - t) / s - q, of covariance
    R^T C_p R / s^2 + C_q. The information is over the variance of unit weight, which the inliers
    tell.
    """
    R, t, s = start
    limit = settings.gate**2
    if settings.threshold_m2 is not None:
        limit = settings.threshold_m2
    inliers = np.zeros(len(target), dtype=bool)
    # From a triple, the first inliers are few: the gate narrows.
    for step in range(STEPS):
        e = (target - t) @ R / s - source
        weights = np.linalg.inv(R.T @ covariances[0] @ R / s**2 + covariances[1])
        squares = np.einsum("ka,kab,kb->k", e, weights, e)
        distance = squares if settings.threshold_m2 is None else (e * e).sum(axis=1) * s**2
        previous, inliers = inliers, distance < limit * max(1.0, 4.0 / (1.0 + step) ** 2)
        if inliers.sum() < settings.inliers:
            return None
        q, off, W = source[inliers], e[inliers], weights[inliers]
        if scaled:
            # At the most likely points: those measured are scattered, and s would be too small.
            q = q + (covariances[1][inliers] @ W @ off[:, :, None])[:, :, 0]
        information, xi = _step(q, off, W, scaled)
        R, t, s = moved(R, t, s, xi)
        small = xi @ information @ xi < SETTLED**2
        if step > 1 and small and np.array_equal(previous, inliers):
            break
    if inliers.mean() < settings.share:
        return None
    chi2 = float(squares[inliers].mean()) / 3.0
    return Motion(R, t, information / max(chi2, LEAST), inliers, chi2, s)


def stepped(
    R: FloatArray, t: FloatArray, source: FloatArray, e: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The motion after a step of Gauss and Newton.

    Parameters
    ----------
    source, e : (k, 3) points q and residuals R^T (p - t) - q
    weights : (k, 3, 3) of the residuals
    """
    R, t, _ = moved(R, t, 1.0, _step(source, e, weights, scaled=False)[1])
    return R, t


def _step(
    q: FloatArray, e: FloatArray, W: FloatArray, scaled: bool
) -> tuple[FloatArray, FloatArray]:
    """The information and the step in the tangent, of 6 numbers, or 7 with the scale."""
    J = jacobian(q, scaled)
    JW = np.swapaxes(J, 1, 2) @ W
    information = (JW @ J).sum(axis=0)
    return information, np.linalg.solve(information, (JW @ e[:, :, None]).sum(axis=0)[:, 0])


def jacobian(q: FloatArray, scaled: bool) -> FloatArray:
    """(k, 3, 6 or 7) J of residuals at points q (k, 3): e(T exp(xi)) = e - J xi to first order."""
    # That is e - v - w x q - sigma q.
    blocks = [-so.hat(q), np.broadcast_to(np.eye(3), (len(q), 3, 3))]
    return np.concatenate([*blocks, q[:, :, None]] if scaled else blocks, axis=2)


def moved(
    R: FloatArray, t: FloatArray, s: float, xi: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """The motion T exp(xi), with xi (6,), or (7,) with the logarithm of the scale."""
    growth = math.exp(float(xi[6])) if len(xi) > 6 else 1.0
    return so.project((R @ so.exp(xi[:3]))[None])[0], t + s * (R @ xi[3:6]), s * growth
