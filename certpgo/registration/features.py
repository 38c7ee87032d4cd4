"""Keypoints with descriptors and places in space: SIFT, RootSIFT, and a lookup of depths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.registration.camera import Camera
from certpgo.registration.sequences import Frame, require_cv2

#: Keypoints of a frame at most, and SIFT's contrast threshold: indoor walls have little.
KEYPOINTS, CONTRAST = 1000, 0.01
#: Depths that a keypoint needs among its 3x3 pixels, and their spread over their median at most.
VALID, SPREAD = 5, 0.05
#: Distance of a match over that of the second best at most (Lowe 2004).
RATIO = 0.8
#: A unit of RootSIFT's entries, which are square roots of shares, in stored bytes.
QUANTUM = 255.0


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of a frame that have a depth.

    Attributes
    ----------
    pixels : (k, 2) columns and rows in the colour image
    points : (k, 3) in the depth camera's frame, metres
    descriptors : (k, 128) RootSIFT, unit vectors times `QUANTUM`, rounded

    See Arandjelovic, Zisserman, "Three things everyone should know to improve object retrieval",
    2012, for RootSIFT: distances are Hellinger's of the histograms.
    """

    pixels: NDArray[np.float32]
    points: FloatArray
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        """Number of keypoints."""
        return len(self.points)

    def subset(self, chosen: IntArray | BoolArray) -> Features:
        """Some of them."""
        return Features(self.pixels[chosen], self.points[chosen], self.descriptors[chosen])


@dataclass(frozen=True)
class ColourCamera:
    """The colour camera of frames whose depth images are not registered to colour.

    Both cameras look in the same direction.

    Attributes
    ----------
    camera : its intrinsics
    offset : where it is in the depth camera's frame, metres
    """

    camera: Camera
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __str__(self) -> str:
        """Its numbers, in pixels and metres."""
        c = self.camera
        place = "" if not any(self.offset) else f", at {self.offset} m of the depth camera"
        return f"fx,fy,cx,cy {c.fx:.1f},{c.fy:.1f},{c.cx:.1f},{c.cy:.1f}{place}"

    def registered(self, depth: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
        """Depths (h, w) at the pixels of the colour image, from those of the depth camera."""
        here, there = self._projected(depth, camera)
        z = depth[here]
        # The nearest surface hides the others: it is written last.
        order = np.argsort(-z, kind="stable")
        out = np.zeros_like(depth)
        out[there[0][order], there[1][order]] = z[order]
        return out

    def seen(self, frame: Frame, camera: Camera) -> NDArray[np.uint8]:
        """Colours (h, w, 3) at the pixels of a frame's depth camera; black where there are none."""
        here, there = self._projected(frame.depth, camera)
        out = np.zeros_like(frame.colour)
        out[here] = frame.colour[there]
        return out

    def _projected(
        self, depth: NDArray[np.float32], camera: Camera
    ) -> tuple[tuple[IntArray, IntArray], tuple[IntArray, IntArray]]:
        """Rows and columns (k,) of depths that colour's image shows, and where it shows them."""
        rows, columns = np.nonzero(depth)
        z = depth[rows, columns].astype(np.float64)
        rays = camera.rays(np.stack([columns, rows], axis=1).astype(np.float64))
        pixels = self.camera.pixels(rays * z[:, None] - np.array(self.offset))
        column, row = np.rint(pixels).astype(np.intp).T
        inside = (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
        return (rows[inside], columns[inside]), (row[inside], column[inside])

    def points(self, pixels: FloatArray, z: FloatArray) -> FloatArray:
        """(k, 3) points in the depth camera's frame, of colour pixels (k, 2) at depths (k,)."""
        offset = np.array(self.offset)
        return np.asarray(self.camera.rays(pixels) * (z - offset[2])[:, None] + offset)


def detect(frame: Frame) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """SIFT's keypoints of an image: pixels (k, 2) and RootSIFT descriptors (k, 128)."""
    cv2 = require_cv2()
    grey = cv2.cvtColor(frame.colour, cv2.COLOR_RGB2GRAY)
    found, raw = cv2.SIFT_create(nfeatures=KEYPOINTS, contrastThreshold=CONTRAST).detectAndCompute(
        grey, None
    )
    if raw is None:
        return np.empty((0, 2), np.float32), np.empty((0, 128), np.uint8)
    # SIFT repeats a keypoint for each of its orientations; one is enough in space.
    pixels = cv2.KeyPoint_convert(found)[:KEYPOINTS]
    histograms = raw[:KEYPOINTS] / np.maximum(raw[:KEYPOINTS].sum(axis=1, keepdims=True), 1e-9)
    return pixels, np.rint(QUANTUM * np.sqrt(histograms)).astype(np.uint8)


def place(
    pixels: NDArray[np.float32],
    descriptors: NDArray[np.uint8],
    depth: NDArray[np.float32],
    camera: Camera,
    *,
    colour: ColourCamera | None = None,
    cutoff: float,
) -> Features:
    """The keypoints of `detect` that have a depth.

    Parameters
    ----------
    pixels, descriptors : of the keypoints
    depth : (h, w) metres, 0 for none
    camera : of the depth image
    colour : the colour camera, or None if depth is registered to it
    cutoff : largest depth, metres
    """
    if colour is not None:
        depth = colour.registered(depth, camera)
    z, known = depths(depth, pixels)
    known &= z <= cutoff
    where = pixels[known].astype(np.float64)
    if colour is None:
        points = camera.rays(where) * z[known, None]
    else:
        points = colour.points(where, z[known])
    return Features(pixels[known], points, descriptors[known])


def depths(depth: NDArray[np.float32], pixels: NDArray[np.float32]) -> tuple[FloatArray, BoolArray]:
    """(k,) medians of the 3x3 depths at pixels, and where they are depths of one surface."""
    padded = np.pad(depth, 1)
    column, row = np.rint(pixels).astype(np.intp).T
    near = np.stack(
        [padded[row + dy, column + dx] for dy in range(3) for dx in range(3)], axis=1
    ).astype(np.float64)
    near[near == 0.0] = np.nan
    known = np.asarray(np.isfinite(near).sum(axis=1) >= VALID)
    near[~known] = 1.0
    z = np.nanmedian(near, axis=1)
    known &= np.nanmax(near, axis=1) - np.nanmin(near, axis=1) < SPREAD * z
    return np.where(known, z, 0.0), known


def match(a: Features, b: Features) -> tuple[IntArray, IntArray]:
    """Indices (k,) into both of keypoints that are each other's nearest, by a clear margin."""
    if len(a) < 2 or len(b) < 2:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    products = _unit(a) @ _unit(b).T
    rows = np.arange(len(a))
    forward = products.argmax(axis=1)
    best = products[rows, forward]
    mutual = best == products.max(axis=0)[forward]
    # Of equal ones, the first.
    mutual &= np.isin(rows, np.unique(np.where(mutual, forward, -1), return_index=True)[1])
    products[rows, forward] = -np.inf
    # Squared distances of unit vectors.
    clear = 1.0 - best < RATIO**2 * (1.0 - products.max(axis=1))
    index = np.flatnonzero(mutual & clear)
    return index, forward[index]


def _unit(features: Features) -> NDArray[Any]:
    rows = features.descriptors.astype(np.float32)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-9))
