"""The colour camera of frames whose depth images are not registered to colour, from the frames.

Points that keypoints mark must move rigidly between frames. With wrong intrinsics they do not, so
that those of the colour camera are where the matches of some pairs of frames agree best.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.registration.camera import Camera
from certpgo.registration.features import ColourCamera, Features, depths, detect, match
from certpgo.registration.ransac import register, stepped
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.stages import UNKEPT, Arrays, Cache, Progress, each, silent

#: Pairs of frames that are compared, and frames between the two of a pair.
PAIRS, APART = 24, 3
#: Steps of the search, and its first changes: of the focal length, and of the centre in pixels.
EVALUATIONS, STRETCH, SHIFT = 60, 0.06, 8.0
#: Squared Mahalanobis distance at which a match counts half.
DOUBTFUL = 9.0
#: Relative gain of agreement, of `PAIRS` pairs, for which the colour camera is taken for another
#: one. Of three pairs of registered frames, chance was seen to give 0.07 to 0.10.
CONVINCING = 0.05
#: Steps of a fit.
FITS = 4


@dataclass(frozen=True, eq=False)
class _Sample:
    """Matched keypoints of two frames: pixels (k, 2) and depth images of both, and a motion."""

    pixels: tuple[FloatArray, FloatArray]
    depths: tuple[NDArray[np.float32], NDArray[np.float32]]
    start: tuple[FloatArray, FloatArray]


def calibrated(
    frames: FrameSequence, progress: Progress = silent, *, scaled: bool = False
) -> ColourCamera | None:
    """The colour camera of frames, or None if depth seems to be registered to colour.

    One focal length and the centre are estimated, by pairs of frames a few frames apart; distances
    between both cameras, a few centimetres, are nearly a shift of the centre. The fewer the pairs,
    the more they must gain; and what each half of them tells must serve the other half.

    Parameters
    ----------
    frames : a sequence; nothing of its truth is used
    progress : is called with the stage, and how many of how many items are done
    scaled : whether depths of each frame have an unknown factor
    """
    last = len(frames) - 1 - APART
    if last < 1:
        return None
    firsts = np.unique(np.linspace(0, last, PAIRS).astype(int)).tolist()
    found = each("camera", lambda k: _sample(frames, k, k + APART, scaled), firsts, progress)
    samples = [sample for sample in found if sample is not None]
    if not samples:
        return None
    fit = _Fit(samples, frames.camera)
    change, least = fit.best()
    # What the three numbers gain by chance is the mean of so many pairs.
    convincing = CONVINCING * math.sqrt(PAIRS / len(samples))
    if least > (1.0 - convincing) * fit.disagreement(np.zeros(3)) or not fit.pays():
        return None
    return ColourCamera(fit.camera(change))


def colour_camera(
    frames: FrameSequence,
    calibrate: bool | None = None,
    cache: Cache = UNKEPT,
    progress: Progress = silent,
    *,
    scaled: bool = False,
) -> ColourCamera | None:
    """The colour camera by `calibrated`, or None; by default where depth is not registered."""
    if not (not frames.registered if calibrate is None else calibrate):
        return None

    def made() -> Arrays:
        found = calibrated(frames, progress, scaled=scaled)
        return {} if found is None else {"camera": np.array(astuple(found.camera))}

    keys = (frames.key(k) for k in range(len(frames)))
    arrays = cache.arrays(("colour", scaled, *keys), made)
    return ColourCamera(Camera(*arrays["camera"].tolist())) if arrays else None


@dataclass(frozen=True, eq=False)
class _Fit:
    """The search for changes of the depth camera: of its focal length, and its centre in pixels."""

    samples: list[_Sample]
    base: Camera

    def camera(self, change: FloatArray) -> Camera:
        """The camera with a change (3,)."""
        base = self.base
        stretched = base.scaled(float(np.exp(change[0])))
        return Camera(
            stretched.fx, stretched.fy, float(base.cx + change[1]), float(base.cy + change[2])
        )

    def disagreement(self, change: FloatArray) -> float:
        """The mean of the pairs'."""
        camera = self.camera(change)
        return float(np.mean([_disagreement(s, camera, self.base) for s in self.samples]))

    def best(self) -> tuple[FloatArray, float]:
        """The change (3,) with the least disagreement, and that."""
        # Both directions, as the search is local.
        simplices = (
            [[0, 0, 0], [sign * STRETCH, 0, 0], [0, SHIFT, 0], [0, 0, SHIFT]] for sign in (-1, 1)
        )
        ends = [
            minimize(
                self.disagreement,
                np.zeros(3),
                method="Nelder-Mead",
                options={"initial_simplex": simplex, "maxfev": EVALUATIONS, "xatol": 1e-3},
            )
            for simplex in simplices
        ]
        end = min(ends, key=lambda end: float(end.fun))
        return end.x, float(end.fun)

    def pays(self) -> bool:
        """Whether what one half of the pairs tells makes the other half agree better, both ways."""
        halves = [_Fit(self.samples[first::2], self.base) for first in (0, 1)]
        if not all(half.samples for half in halves):
            return False
        learned = [half.best()[0] for half in halves]
        return all(
            other.disagreement(change) < other.disagreement(np.zeros(3))
            for other, change in zip(halves[::-1], learned, strict=True)
        )


def _sample(frames: FrameSequence, i: int, j: int, scaled: bool) -> _Sample | None:
    """Matched keypoints of two frames; None if no motion explains them even roughly.

    Depths of the second are in the unit of the first.
    """
    a, b = frames.frame(i), frames.frame(j)
    found = []
    for frame in (a, b):
        pixels, descriptors = detect(frame)
        z, known = depths(frame.depth, pixels)
        where = pixels[known].astype(np.float64)
        points = frames.camera.rays(where) * z[known, None]
        found.append(Features(pixels[known], points, descriptors[known]))
    m, n = match(*found)
    p, q = found[0].subset(m), found[1].subset(n)
    noise = frames.camera.covariances(p.points), frames.camera.covariances(q.points)
    motion = register(p.points, q.points, noise, np.random.default_rng([i, j]), scaled=scaled)
    if motion is None:
        return None
    both = p.pixels.astype(np.float64), q.pixels.astype(np.float64)
    return _Sample(both, (a.depth, np.float32(motion.scale) * b.depth), (motion.R, motion.t))


def _disagreement(sample: _Sample, colour: Camera, camera: Camera) -> float:
    """The mean of squared distances that the best motion leaves, doubtful ones bounded."""
    sides = [
        _looked_up(*side, colour, camera) for side in zip(sample.pixels, sample.depths, strict=True)
    ]
    (p, known), (q, also) = sides
    both = np.asarray(known & also)
    p, q, (R, t) = p[both], q[both], sample.start
    if not both.any():
        return DOUBTFUL
    C, D = colour.covariances(p), colour.covariances(q)
    for _ in range(FITS):
        e = (p - t) @ R - q
        W = np.linalg.inv(R.T @ C @ R + D)
        squares = np.einsum("ka,kab,kb->k", e, W, e)
        weights = W / (1.0 + squares / DOUBTFUL)[:, None, None] ** 2
        R, t = stepped(R, t, q, e, weights)
    return float(np.mean(squares / (1.0 + squares / DOUBTFUL)))


def _looked_up(
    pixels: FloatArray, depth: NDArray[np.float32], colour: Camera, camera: Camera
) -> tuple[FloatArray, BoolArray]:
    """(k, 3) points of colour pixels (k, 2), and which have a depth."""
    rays = colour.rays(pixels)
    # Both cameras are taken to be at one place: the pixel of a ray is that at any depth.
    seen = camera.pixels(rays)
    size = depth.shape[1], depth.shape[0]
    inside = np.asarray(((seen > -0.5) & (seen < np.array(size) - 0.5)).all(axis=1))
    z, known = depths(depth, np.where(inside[:, None], seen, 0.0).astype(np.float32))
    known &= inside
    return rays * np.where(known, z, 1.0)[:, None], known
