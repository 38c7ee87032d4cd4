"""Many clouds as one: means over a voxel grid, and denoising by neighbours."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from certpgo.errors import GraphError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.registration.features import ColourCamera
from certpgo.registration.sequences import FrameSequence
from certpgo.registration.stages import Progress, each, silent

#: Edge of a voxel, metres, and neighbours by which a point is judged; 0.007 and 30 in the thesis,
#: Table D.1.
GRID, NEIGHBOURS = 0.01, 12
#: Standard deviations beyond the mean of all points at which a point's neighbours are too far.
FAR = 2.0
#: Pixels of which a cloud takes one, of images this wide.
STEP, WIDE = 2, 640
#: Points in a voxel of the scene at least.
SEEN_TWICE = 2
#: Points whose neighbours are looked for at a time.
BLOCK = 100_000
#: Bits of a voxel's number in each direction.
BITS = 21


@dataclass(frozen=True, eq=False)
class ColouredCloud:
    """Points with colours.

    Attributes
    ----------
    points : (k, 3) metres
    colours : (k, 3) red, green and blue, 0 to 255
    """

    points: NDArray[np.float32]
    colours: NDArray[np.uint8]

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    def subset(self, chosen: IntArray | BoolArray) -> ColouredCloud:
        """Some of the points."""
        return ColouredCloud(self.points[chosen], self.colours[chosen])


class VoxelGrid:
    """Sums of what falls into each voxel of a grid; only one number per voxel is kept of each.

    Parameters
    ----------
    size : edge of a voxel, metres

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.registration.fuse import VoxelGrid
    >>> grid = VoxelGrid(0.1)
    >>> grid.add(np.array([[0.01, 0, 0], [0.03, 0, 0], [0.5, 0, 0]]), np.full((3, 3), 255))
    >>> grid.cloud().points.round(3).tolist()
    [[0.019999999552965164, 0.0, 0.0], [0.5, 0.0, 0.0]]
    """

    def __init__(self, size: float) -> None:
        self.size = size
        self._parts: list[tuple[NDArray[np.int64], FloatArray]] = []

    def add(self, points: FloatArray, colours: NDArray[np.uint8]) -> None:
        """Add points (k, 3) with colours (k, 3)."""
        values = np.hstack([np.ones((len(points), 1)), points, colours])
        self._parts.append(_grouped(voxel_keys(points, self.size), values))
        # Like a binary counter: parts are joined with those of about their own size.
        while len(self._parts) > 1 and len(self._parts[-2][0]) < 2 * len(self._parts[-1][0]):
            self._join()

    def _join(self) -> None:
        """Add the last part to the one before it: only what is new there takes memory."""
        (few, added), (keys, sums) = self._parts.pop(), self._parts.pop()
        at = np.searchsorted(keys, few)
        new = np.append(keys, -1)[at] != few  # voxels' numbers are not negative
        sums[at[~new]] += added[~new]
        more = np.insert(sums, at[new], added[new], axis=0)
        self._parts.append((np.insert(keys, at[new], few[new]), more))

    def cloud(self, least: int = 1) -> ColouredCloud:
        """The mean of each voxel with at least so many points."""
        while len(self._parts) > 1:
            self._join()
        sums = self._parts[0][1] if self._parts else np.empty((0, 7))
        sums = sums[sums[:, 0] >= least]
        means = sums[:, 1:] / sums[:, :1]
        colours = np.clip(np.rint(means[:, 3:]), 0, 255).astype(np.uint8)
        return ColouredCloud(means[:, :3].astype(np.float32), colours)


def fused(
    frames: FrameSequence,
    nodes: IntArray,
    estimate: Estimate,
    *,
    grid: float = GRID,
    cutoff: float = 4.0,
    colour: ColourCamera | None = None,
    progress: Progress = silent,
) -> ColouredCloud:
    """The scene that frames saw, as means over voxels, denoised.

    Parameters
    ----------
    nodes : (n,) numbers of the frames
    estimate : n poses, world <- camera, metres; the scene is in their world
    grid : edge of a voxel, metres
    cutoff : largest depth that is used, metres
    colour : the colour camera, or None if depth is registered to it
    progress : is called with the stage, and how many of how many frames are done

    Raises
    ------
    GraphError
        The poses are not in space.
    """
    R, t = estimate.rotations, estimate.translations
    if t is None or R.shape[1] != 3:
        raise GraphError("a scene needs poses in space, with positions")
    voxels, lock = VoxelGrid(grid), Lock()

    def add(node: int) -> None:
        frame = frames.frame(int(nodes[node]))
        near = np.where(frame.depth <= cutoff, frame.depth, np.float32(0.0))
        step = STEP if near.shape[1] >= WIDE else 1
        image = frame.colour if colour is None else colour.seen(frame, frames.camera)
        colours = image[::step, ::step][near[::step, ::step] > 0.0]
        points = frames.camera.cloud(near, step) @ R[node].T + t[node]
        with lock:
            voxels.add(points, colours)

    each("fusion", add, range(len(nodes)), progress)
    return denoised(voxels.cloud(SEEN_TWICE))


def voxel_keys(points: FloatArray, size: float) -> NDArray[np.int64]:
    """(k,) a number for the voxel of each point, for grids of up to 2^21 voxels a side."""
    cells = np.floor(points / size).astype(np.int64) + (1 << (BITS - 1))
    return np.asarray((cells[:, 0] << (2 * BITS)) | (cells[:, 1] << BITS) | cells[:, 2])


def voxel_means(points: FloatArray, size: float) -> FloatArray:
    """The mean (n, 3) of the points in each occupied voxel."""
    values = np.hstack([np.ones((len(points), 1)), points])
    _, sums = _grouped(voxel_keys(points, size), values)
    return np.asarray(sums[:, 1:] / sums[:, :1])


def _grouped(keys: NDArray[np.int64], values: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """The distinct keys, ascending, with the sums of their values (k, p)."""
    if len(keys) == 0:
        return keys, values
    order = np.argsort(keys, kind="stable")
    first = np.r_[True, np.diff(keys[order]) != 0]
    number = np.empty(len(keys), dtype=np.intp)
    number[order] = np.cumsum(first) - 1
    sums = [np.bincount(number, column) for column in values.T]
    return keys[order][first], np.stack(sums, axis=1)


def denoised(cloud: ColouredCloud, neighbours: int = NEIGHBOURS) -> ColouredCloud:
    """The cloud without points whose nearest neighbours are unusually far.

    A point goes if its mean distance to them is above the mean of all points by `FAR` standard
    deviations (Rusu et al., "Towards 3D point cloud based object maps", 2008).
    """
    k = min(neighbours, len(cloud) - 1)
    if k < 1:
        return cloud
    points = cloud.points.astype(np.float64)
    tree = cKDTree(points)
    # A query's answers take many times the memory of its points.
    parts = np.array_split(points, len(points) // BLOCK + 1)
    distances = np.concatenate([tree.query(part, k + 1)[0][:, 1:].mean(axis=1) for part in parts])
    return cloud.subset(np.asarray(distances <= distances.mean() + FAR * distances.std()))
