"""The relative pose of two frames: matched keypoints, then both clouds added to them."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.camera import Camera
from certpgo.registration.dense import DenseRegistration, PreparedCloud, align, prepare
from certpgo.registration.features import Features, match
from certpgo.registration.ransac import Motion, RansacSettings, register

#: Standard deviations that no measurement goes below, radians, metres and of a logarithm of scale:
#: what keypoints share, such as the camera's calibration, no number of them averages out.
FLOORS = math.radians(0.03), 0.0005, 0.0005
#: Edges of the voxels of a target and of a source, and the distance of partners, metres: time goes
#: with the points of the source.
VOXEL, COARSE, REACH = 0.03, 0.06, 0.08
#: Standard deviation of partners' distances, metres: above the measured one, as the errors of
#: neighbouring depths are alike. And steps at which alignment ends, far below it: radians, metres.
SIGMA, SETTLED, ITERATIONS = 0.01, (1e-3, 5e-4), 10
#: Share of a cloud that must lie on the other.
OVERLAP = 0.3
#: Frames whose clouds are kept prepared, 3 MB each.
RECENT = 32
#: What is kept of a pair.
STORED = ("R", "t", "covariance", "matches", "inliers", "chi2", "dense", "excess", "scale")


@dataclass(frozen=True, eq=False)
class Keyframe:
    """What is kept of a frame.

    Attributes
    ----------
    features : its keypoints
    cloud : (k, 3) points, a mean for each voxel, metres
    """

    features: Features
    cloud: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class FramePair:
    """A measured edge (i, j): p_i ~ scale R p_j + t.

    Attributes
    ----------
    i, j : numbers of the frames
    R, t : relative pose, metres, or the unit of i
    covariance : (6, 6) of the tangent (rotation, translation) in the frame of j, rad^2 and m^2; or
        (7, 7) of (rotation, translation, log scale), in the unit of j
    matches, inliers : of keypoints
    chi2 : of the inliers, 1 for the stated noise
    dense : whether the clouds were added
    excess : squared disagreement of keypoints and clouds over what both state, at least 1; the
        covariance contains it
    scale : units of i that one of j is; 1 where depths are in metres
    """

    i: int
    j: int
    R: FloatArray
    t: FloatArray
    covariance: FloatArray
    matches: int
    inliers: int
    chi2: float
    dense: bool
    excess: float = 1.0
    scale: float = 1.0

    @property
    def share(self) -> float:
        """Share of the matches that agree."""
        return self.inliers / self.matches

    def in_units_of(self, scales: FloatArray) -> FramePair:
        """The pair where frame k has a unit in which lengths are s_k times those in its own."""
        a, b = float(scales[self.i]), float(scales[self.j])
        grown = np.array([1.0, 1.0, 1.0, b, b, b, 1.0][: len(self.covariance)])
        covariance = grown[:, None] * self.covariance * grown
        return replace(self, t=a * self.t, covariance=covariance, scale=self.scale * a / b)


def in_units_of(scales: FloatArray, pairs: Sequence[FramePair]) -> list[FramePair]:
    """Pairs where lengths in frame k are s_k times those in its own unit."""
    return [pair.in_units_of(scales) for pair in pairs]


class Clouds:
    """The frames' clouds, prepared when they are needed, and the recent ones kept."""

    def __init__(self, views: list[Keyframe | None]) -> None:
        self._views, self._lock = views, Lock()
        self._recent: OrderedDict[int, tuple[PreparedCloud, PreparedCloud]] = OrderedDict()

    def __getitem__(self, k: int) -> tuple[PreparedCloud, PreparedCloud]:
        """The cloud of a frame as a target, and as a source."""
        with self._lock:
            if k in self._recent:
                self._recent.move_to_end(k)
                return self._recent[k]
        view = self._views[k]
        points = np.empty((0, 3)) if view is None else view.cloud.astype(np.float64)
        made = prepare(points, voxel=VOXEL), prepare(points, voxel=COARSE)
        with self._lock:
            self._recent[k] = made
            while len(self._recent) > RECENT:
                self._recent.popitem(last=False)
        return made


def measure(
    i: int,
    j: int,
    a: Features,
    b: Features,
    camera: Camera,
    settings: RansacSettings,
    clouds: Clouds | None,
    *,
    scaled: bool = False,
) -> FramePair | None:
    """The edge between two frames; None if they do not match.

    Parameters
    ----------
    a, b : keypoints of frames i and j
    camera : of the keypoints, for their noise
    clouds : of all frames, or None to use keypoints alone
    scaled : whether each frame has a unit of its own; then keypoints alone are used
    """
    m, n = match(a, b)
    p, q = a.points[m], b.points[n]
    noise = camera.covariances(p), camera.covariances(q)
    motion = register(p, q, noise, np.random.default_rng([i, j]), settings, scaled=scaled)
    if motion is None:
        return None
    floors = np.diag(np.repeat(FLOORS, (3, 3, 1 if scaled else 0)) ** 2)
    found = None if clouds is None or scaled else _by_clouds(motion, clouds[i][0], clouds[j][1])
    R, t, covariance, excess = motion.R, motion.t, np.linalg.inv(motion.information), 1.0
    if found is not None:
        R, t, covariance, excess = together(motion, found, floors)
    total = np.asarray(excess * covariance + floors, dtype=np.float64)
    counts = len(m), int(motion.inliers.sum()), motion.chi2
    return FramePair(i, j, R, t, total, *counts, found is not None, excess, motion.scale)


def _by_clouds(
    motion: Motion, target: PreparedCloud, source: PreparedCloud
) -> DenseRegistration | None:
    """The motion by clouds alone, from that by keypoints; None if too little of them meets."""
    limits: dict[str, Any] = {"settled": SETTLED, "iterations": ITERATIONS}
    found = align(target, source, (motion.R, motion.t), reach=REACH, sigma=SIGMA, **limits)
    return None if found is None or found.overlap < OVERLAP else found


def together(
    motion: Motion, found: DenseRegistration, floors: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """The most likely motion R, t for keypoints and clouds together, and how far these disagree.

    Its covariance (6, 6), as stated, is to be multiplied by the last result: the squared
    disagreement over what both state, at least 1 (Birge, "The calculation of errors by the method
    of least squares", 1932). All keypoints share errors of calibration and of synchrony, so that
    their residuals do not show these.

    Parameters
    ----------
    motion, found : by keypoints, and by clouds
    floors : (6, 6) covariance that both have besides
    """
    # To first order both are Gaussian about their own motion.
    xi = np.concatenate([so.log(motion.R.T @ found.R), motion.R.T @ (found.t - motion.t)])
    information = motion.information + found.information
    step = np.linalg.solve(information, found.information @ xi)
    stated = np.linalg.inv(motion.information) + np.linalg.inv(found.information) + 2.0 * floors
    excess = max(1.0, float(xi @ np.linalg.solve(stated, xi)) / 6.0)
    R = so.project((motion.R @ so.exp(step[:3]))[None])[0]
    return R, motion.t + motion.R @ step[3:], np.asarray(np.linalg.inv(information)), excess


def stored(pair: FramePair | None) -> dict[str, NDArray[Any]]:
    """A pair as arrays, to keep on disk; nothing for frames that do not match."""
    if pair is None:
        return {}
    return {name: np.asarray(getattr(pair, name)) for name in STORED}


def restored(i: int, j: int, arrays: dict[str, NDArray[Any]]) -> FramePair | None:
    """The pair of frames i and j that `stored` made."""
    if not arrays:
        return None
    numbers = (arrays[name].item() for name in STORED[3:])
    return FramePair(i, j, arrays["R"], arrays["t"], arrays["covariance"], *numbers)
