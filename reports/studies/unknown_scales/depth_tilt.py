"""The tilt of a depth camera's depths, from matched keypoints of pairs of frames.

Errors of structured light's depths are smooth over the image (Teichman, Miller, Thrun,
"Unsupervised intrinsic calibration of depth sensors via SLAM", 2013). Their part that is linear in
the ray (u, v, 1) looks like another unit of depths: a camera that turns sees the same things at
other u, nearer or farther by the same share. So each pair's unit is free while a and b of
z (1 + a u + b v) are estimated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.linalg.arrays import FloatArray
from certpgo.registration.camera import Camera
from certpgo.registration.features import Features, match
from certpgo.registration.pairs import FramePair
from certpgo.registration.ransac import jacobian, moved
from certpgo.registration.sequences import Frame, FrameSequence

#: Pairs that are looked at, at most.
PAIRS = 300
#: Steps of Gauss and Newton at most, and the step, in standard deviations, at which they end.
STEPS, SETTLED = 10, 0.1
#: Squared Mahalanobis distance at which a match pulls a quarter as hard.
DOUBTFUL = 9.0
#: Squared distance from 0, in standard deviations, from which on a tilt is believed, and the
#: largest one. Without any, at most 22 was seen. Noise is as large as pairs say, not as stated, but
#: pairs that share a frame are not independent, and steps of disparity are no noise.
CONVINCING, LARGEST = 25.0, 0.1


def slopes(points: FloatArray) -> FloatArray:
    """(..., 2) u and v of the rays (u, v, 1) to points (..., 3)."""
    return np.asarray(points[..., :2] / points[..., 2:])


def straightened(points: FloatArray, tilt: tuple[float, float]) -> FloatArray:
    """Points (k, 3) with their depths z, and all along with them, times 1 + a u + b v."""
    return np.asarray(points * (1.0 + slopes(points) @ np.array(tilt))[:, None])


@dataclass(frozen=True, eq=False, kw_only=True)
class StraightenedSequence(FrameSequence):
    """Frames whose depths at the ray (u, v, 1) are multiplied by 1 + a u + b v.

    Attributes
    ----------
    source : the frames as they are
    tilt : a and b
    """

    source: FrameSequence
    tilt: tuple[float, float]

    @classmethod
    def of(cls, frames: FrameSequence, tilt: tuple[float, float]) -> StraightenedSequence:
        """The frames without that tilt."""
        return cls(
            name=frames.name,
            names=frames.names,
            times=frames.times,
            camera=frames.camera,
            truth=frames.truth,
            registered=frames.registered,
            source=frames,
            tilt=tilt,
        )

    def frame(self, k: int) -> Frame:
        """The k-th frame."""
        frame = self.source.frame(k)
        pixels = np.stack(np.meshgrid(*map(np.arange, frame.depth.shape[::-1])), axis=-1)
        rays = self.camera.rays(pixels.astype(np.float64))
        depth = frame.depth * (1.0 + slopes(rays) @ np.array(self.tilt))
        return Frame(frame.colour, depth.astype(np.float32))

    def key(self, k: int) -> str:
        """What the k-th frame is made of."""
        return f"{self.source.key(k)} {self.tilt}"

    def _of_frames(self, kept: list[int]) -> dict[str, Any]:
        return {"source": self.source.chosen(kept)}


def depth_tilt(
    pairs: Sequence[FramePair], features: Mapping[int, Features], camera: Camera
) -> tuple[float, float]:
    """The a and b by which true depths are z (1 + a u + b v); 0 if the pairs do not show any.

    Matched points of all pairs agree best, each pair with its own similarity.

    Parameters
    ----------
    pairs : with scales, of frames that see things at different places of the image: loops
    features : of their frames, by number
    camera : of the keypoints, for their noise
    """
    if not pairs:
        return 0.0, 0.0
    few = np.unique(np.linspace(0, len(pairs) - 1, PAIRS).astype(int)).tolist()
    samples = [_matched(features[pairs[k].i], features[pairs[k].j]) for k in few]
    motions = [(pairs[k].R, pairs[k].t, pairs[k].scale) for k in few]
    tilt, noise = np.zeros(2), max(1.0, float(np.median([pairs[k].chi2 for k in few])))
    for _ in range(STEPS):
        systems = [
            _normal(*points, *motion, (tilt[0], tilt[1]), camera)
            for points, motion in zip(samples, motions, strict=True)
        ]
        H, g = (np.array(part) for part in zip(*systems, strict=True))
        # Motions are eliminated: each is its own pair's.
        inverse = np.linalg.pinv(H[:, :7, :7], hermitian=True)  # few matches leave some open
        M = H[:, 7:, :7] @ inverse
        information = (H[:, 7:, 7:] - M @ H[:, :7, 7:]).sum(axis=0)
        reduced = g[:, 7:] - (M @ g[:, :7, None])[:, :, 0]
        step = np.linalg.lstsq(information, reduced.sum(axis=0))[0]
        xi = (inverse @ (g[:, :7] - H[:, :7, 7:] @ step)[:, :, None])[:, :, 0]
        motions = [moved(*motion, change) for motion, change in zip(motions, xi, strict=True)]
        tilt = tilt + step
        if step @ information @ step < SETTLED**2:
            break
    else:
        return 0.0, 0.0
    convincing = tilt @ information @ tilt > CONVINCING * noise
    found = convincing and np.abs(tilt).max() <= LARGEST
    return (float(tilt[0]), float(tilt[1])) if found else (0.0, 0.0)


def _matched(a: Features, b: Features) -> tuple[FloatArray, FloatArray]:
    m, n = match(a, b)
    return a.points[m], b.points[n]


def _normal(
    target: FloatArray,
    source: FloatArray,
    R: FloatArray,
    t: FloatArray,
    s: float,
    tilt: tuple[float, float],
    camera: Camera,
) -> tuple[FloatArray, FloatArray]:
    """The normal equations (9, 9) and (9,) of a pair: of its motion's tangent, then of the tilt.

    Residuals are those of `refine`; doubtful matches pull less, as Geman and McClure weigh them.
    """
    C, D = camera.covariances(target), camera.covariances(source)
    p, q = straightened(target, tilt), straightened(source, tilt)
    e = (p - t) @ R / s - q
    W = np.linalg.inv(R.T @ C @ R / s**2 + D)
    squares = np.einsum("ka,kab,kb->k", e, W, e)
    # At the most likely points, as errors of depth change derivatives as well.
    q = q + (D @ W @ e[:, :, None])[:, :, 0]
    p = s * q @ R.T + t
    turned = (p @ R / s)[:, :, None] * slopes(target)[:, None, :]
    J = np.concatenate([jacobian(q, True), q[:, :, None] * slopes(source)[:, None, :] - turned], 2)
    W = W / (1.0 + squares / DOUBTFUL)[:, None, None] ** 2
    JW = np.swapaxes(J, 1, 2) @ W
    return (JW @ J).sum(axis=0), (JW @ e[:, :, None]).sum(axis=0)[:, 0]
