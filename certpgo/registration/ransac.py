"""Rigid motions from matched points in space: RANSAC, Procrustes, and refinement.

Convention: p_target ~ R p_source + t, so that an edge (target, source) of a pose graph measures
(R, t). Tangents are (rotation, translation) in the frame of the source: T exp(xi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from certpgo.errors import SpecError
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.registration.procrustes import procrustes

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
    """A rigid motion between matched points.

    Attributes
    ----------
    R, t : p_target ~ R p_source + t, metres
    information : (6, 6) of the tangent (rotation, translation), 1/rad^2, 1/(rad m) and 1/m^2
    inliers : (k,) which matches agree
    chi2 : mean squared Mahalanobis distance of the inliers over 3; 1 for the stated noise
    """

    R: FloatArray
    t: FloatArray
    information: FloatArray
    inliers: BoolArray
    chi2: float

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
) -> Motion | None:
    """The motion on which most matches agree; None if too few do.

    Parameters
    ----------
    target, source : (k, 3) matched points, metres
    covariances : (k, 3, 3) of both, m^2, each in its own frame
    rng : draws the triples

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
    sigma = np.sqrt(sum(np.trace(C, axis1=1, axis2=2) for C in covariances) / 3.0)
    start = _search(target, source, np.asarray(sigma), rng, chosen)
    if start is None:
        return None
    return refine(target, source, covariances, start, chosen)


def _search(
    target: FloatArray,
    source: FloatArray,
    sigma: FloatArray,
    rng: np.random.Generator,
    settings: RansacSettings,
) -> tuple[FloatArray, FloatArray] | None:
    """The hypothesis of most inliers, by distances in units of isotropic noise sigma (k,)."""
    k = len(target)
    judges = np.arange(k) if k <= JUDGES else rng.permutation(k)[:JUDGES]
    limit = settings.gate**2 * 3.0 * sigma[judges] ** 2
    if settings.threshold_m2 is not None:
        limit = np.full(len(judges), 3.0 * settings.threshold_m2)
    best, most = None, 2
    p, q = target[judges].T, source[judges].T
    for drawn in range(0, settings.iterations, BATCH):
        # Triples that are pruned cannot be three inliers: all that were drawn count.
        if drawn * (most / len(judges)) ** 3 > -math.log1p(-settings.confidence):
            break
        triples = rng.integers(k, size=(min(BATCH, settings.iterations - drawn), 3))
        triples = triples[_congruent(target[triples], source[triples], 2.0 * sigma[triples])]
        if not len(triples):
            continue
        R, t = procrustes(target[triples], source[triples])
        off = R @ q + t[:, :, None] - p
        counts = (np.einsum("bak,bak->bk", off, off) < limit).sum(axis=1)
        winner = int(counts.argmax())
        if counts[winner] > most:
            most, best = int(counts[winner]), (R[winner], t[winner])
    return best


def _congruent(p: FloatArray, q: FloatArray, tolerance: FloatArray) -> BoolArray:
    """(b,) which triangles (b, 3, 3) have sides of equal lengths, and are no slivers."""
    sides = [np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2) for x in (p, q)]
    allowed = tolerance + np.roll(tolerance, 1, axis=1)
    equal = (np.abs(sides[0] - sides[1]) < allowed).all(axis=1)
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1)
    longest = sides[0].max(axis=1)
    wide = (area > 0.1 * longest**2) & (longest > 5.0 * tolerance.max(axis=1))
    return np.asarray(equal & wide)


def refine(
    target: FloatArray,
    source: FloatArray,
    covariances: tuple[FloatArray, FloatArray],
    start: tuple[FloatArray, FloatArray],
    settings: RansacSettings,
) -> Motion | None:
    """The most likely motion for the matches within the gate, by Gauss and Newton's steps.

    Residuals are seen in the frame of the source, e = R^T (p - t) - q, of covariance
    R^T C_p R + C_q. The information is over the variance of unit weight, which the inliers tell.
    """
    R, t = start
    limit = settings.gate**2
    if settings.threshold_m2 is not None:
        limit = settings.threshold_m2
    inliers = np.zeros(len(target), dtype=bool)
    # From a triple, the first inliers are few: the gate narrows.
    for step in range(STEPS):
        e = (target - t) @ R - source
        weights = np.linalg.inv(R.T @ covariances[0] @ R + covariances[1])
        squares = np.einsum("ka,kab,kb->k", e, weights, e)
        distance = squares if settings.threshold_m2 is None else (e * e).sum(axis=1)
        previous, inliers = inliers, distance < limit * max(1.0, 4.0 / (1.0 + step) ** 2)
        if inliers.sum() < settings.inliers:
            return None
        information, xi = _step(source[inliers], e[inliers], weights[inliers])
        R, t = _moved(R, t, xi)
        small = xi @ information @ xi < SETTLED**2
        if step > 1 and small and np.array_equal(previous, inliers):
            break
    if inliers.mean() < settings.share:
        return None
    chi2 = float(squares[inliers].mean()) / 3.0
    return Motion(R, t, information / max(chi2, LEAST), inliers, chi2)


def stepped(
    R: FloatArray, t: FloatArray, source: FloatArray, e: FloatArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The motion after a step of Gauss and Newton.

    Parameters
    ----------
    source, e : (k, 3) points q and residuals R^T (p - t) - q
    weights : (k, 3, 3) of the residuals
    """
    return _moved(R, t, _step(source, e, weights)[1])


def _step(q: FloatArray, e: FloatArray, W: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The information (6, 6) and the step (6,), in the tangent."""
    # e(T exp(xi)) = e - v - w x q to first order.
    J = np.concatenate([-so.hat(q), np.broadcast_to(np.eye(3), (len(q), 3, 3))], axis=2)
    JW = np.swapaxes(J, 1, 2) @ W
    information = (JW @ J).sum(axis=0)
    return information, np.linalg.solve(information, (JW @ e[:, :, None]).sum(axis=0)[:, 0])


def _moved(R: FloatArray, t: FloatArray, xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    return so.project((R @ so.exp(xi[:3]))[None])[0], t + R @ xi[3:]
