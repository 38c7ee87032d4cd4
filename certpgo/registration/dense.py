"""Generalized ICP between two clouds, by small_gicp, with the information that it has of the pose.

Segal, Haehnel, Thrun, "Generalized-ICP", RSS 2009: each point is taken for a small disc, and pairs
of nearest points for discs on the same surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.errors import InputError, MissingDependency
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, frozen_floats

#: Points of a cloud from which discs are estimated, and pairs from which a motion is.
NEIGHBOURS, FEWEST = 10, 30
#: Steps below which the search ends: radians, and metres per metre of reach.
TURN, SHIFT = 1e-4, 1e-3
ITERATIONS = 30
#: Of the reach: how near partners are, across the surface, where surfaces meet; and what no scanner
#: tells, for points that are exact.
MET, EXACT = 0.25, 1e-3
#: Voxels from the origin that small_gicp can number.
FARTHEST = 2**20 - 1


@dataclass(frozen=True, eq=False)
class PreparedCloud:
    """A cloud that is ready to be aligned with any number of others.

    Attributes
    ----------
    points : (n, 3) one for each occupied voxel, metres
    normals : (n, 3) unit vectors across the surface, of either sign
    cloud, tree : small_gicp's own
    """

    points: FloatArray
    normals: FloatArray
    cloud: Any
    tree: Any

    def nearest(self, queries: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points nearest to ``queries`` (k, 3): their numbers (k,) and distances (k,), metres."""
        numbers, squares = self.tree.batch_nearest_neighbor_search(queries)
        return np.asarray(numbers, dtype=np.intp), np.sqrt(squares)

    @cached_property
    def roughness(self) -> float:
        """Distance of the nearest neighbour across the surface, rms, metres.

        Two scans of the surface with this noise and spacing are as far apart, or nearer by chance.
        """
        nearest, _ = self.tree.batch_knn_search(self.points, 2)
        second = np.asarray(nearest, dtype=np.intp)[:, 1]
        off = np.sum(self.normals * (self.points - self.points[second]), axis=1)
        return float(np.sqrt(np.mean(off**2)))


@dataclass(frozen=True, eq=False)
class DenseRegistration:
    """How a source cloud lies in the frame of a target.

    Attributes
    ----------
    R, t : (3, 3) and (3,), metres: p_target ~ R p_source + t
    information : (6, 6) of xi = (rotation, translation) in T exp(xi), so in the source's frame;
        1/rad^2 and 1/m^2
    inliers : pairs of points within reach
    rmse : root mean square distance of the pairs across the target's surface, metres
    overlap : share of the source's points that have a partner, 0 to 1
    meeting : share of these that are within a quarter of the reach across the surface, 0 to 1: of
        surfaces that only cross, .37 by chance
    """

    R: FloatArray
    t: FloatArray
    information: FloatArray
    inliers: int
    rmse: float
    overlap: float
    meeting: float


def prepare(points: FloatArray, *, voxel: float = 0.03) -> PreparedCloud:
    """A cloud's downsampled points, their normals and a search tree.

    Parameters
    ----------
    points : (n, 3), metres
    voxel : edge of the cubes whose points are averaged, metres

    Raises
    ------
    InputError
        Points that are not (n, 3) and finite, no length of a voxel, or one that is too small.
    MissingDependency
        small_gicp is not installed.
    """
    try:
        import small_gicp
    except ModuleNotFoundError:
        raise MissingDependency("small_gicp, which aligns clouds,", "rgbd") from None

    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"points must be (n, 3) and finite, not {points.shape}")
    if not (np.isfinite(voxel) and voxel > 0.0):
        raise InputError(f"a voxel's edge must be positive, not {voxel}")
    if len(points) and np.abs(points).max() >= FARTHEST * voxel:
        raise InputError(f"voxels of {voxel:g} m do not reach {np.abs(points).max():g} m far")
    if not len(points):  # small_gicp builds no tree of nothing
        return PreparedCloud(points, points, None, None)
    cloud, tree = small_gicp.preprocess_points(points, voxel, NEIGHBOURS)
    # Homogeneous there.
    kept, normals = cloud.points()[:, :3], cloud.normals()[:, :3]
    return PreparedCloud(frozen_floats(kept), frozen_floats(normals), cloud, tree)


def align(
    target: PreparedCloud,
    source: PreparedCloud,
    initial: tuple[FloatArray, FloatArray],
    *,
    reach: float = 0.08,
    sigma: float | None = None,
    settled: tuple[float, float] | None = None,
    iterations: int = ITERATIONS,
) -> DenseRegistration | None:
    """Align two clouds that are nearly aligned; None if too few points meet.

    Parameters
    ----------
    initial : R (3, 3) and t (3,) to begin with
    reach : distance up to which points are partners, metres
    sigma : standard deviation of the distance of partners across the surface, metres; by default
        the measured one, or that of neighbours in the target, of which a scan that is given twice
        has no less. Larger if errors of neighbouring points are alike, as those of a depth camera
        are
    settled : steps below which the search ends, radians and metres; by default tiny ones
    iterations : stop anyway

    Raises
    ------
    MissingDependency
        small_gicp is not installed.
    """
    try:
        import small_gicp
    except ModuleNotFoundError:
        raise MissingDependency("small_gicp, which aligns clouds,", "rgbd") from None

    if min(len(target.points), len(source.points)) < FEWEST:
        return None
    ends = settled or (TURN, SHIFT * reach)
    begin = np.eye(4)
    begin[:3, :3], begin[:3, 3] = initial
    found = small_gicp.align(
        target.cloud,
        source.cloud,
        target.tree,
        begin,
        max_correspondence_distance=reach,
        max_iterations=iterations,
        rotation_epsilon=ends[0],
        translation_epsilon=ends[1],
    ).T_target_source
    if not np.isfinite(found).all():
        return None
    R, t = so.project(found[None, :3, :3])[0], found[:3, 3]
    moved = source.points @ R.T + t
    nearest, distances = target.nearest(moved)
    met = distances <= reach
    if np.count_nonzero(met) < FEWEST:
        return None
    partners = nearest[met]
    across = target.normals[partners]
    off = np.abs(np.sum(across * (moved[met] - target.points[partners]), axis=1))
    rmse = float(np.sqrt(np.mean(off**2)))
    if sigma is None:
        sigma = max(rmse, target.roughness, EXACT * reach)
    information = _information(source.points[met], across @ R, source.normals[met], reach, sigma)
    inliers, meeting = len(partners), float(np.mean(off < MET * reach))
    return DenseRegistration(R, t, information, inliers, rmse, inliers / len(met), meeting)


def _information(
    points: FloatArray, theirs: FloatArray, own: FloatArray, reach: float, sigma: float
) -> FloatArray:
    """The information matrix (6, 6) of pairs, from points and both their normals (k, 3) at hand.

    A distance across the surface changes by n^T (v - p x w) = (p x n, n)^T (w, v). The normals n
    are estimates; their errors would pretend to know shifts along a plane. Those of the two scans
    are independent, so that the mixed moment is free of them. What remains unknown is within reach.
    """
    own = own * np.sign(np.sum(own * theirs, axis=1))[:, None]
    size = np.sqrt(np.mean(points**2))
    scale = np.array([size] * 3 + [1.0] * 3)
    rows, others = (np.hstack([np.cross(points, n), n]) / scale for n in (theirs, own))
    moment = rows.T @ others
    values, axes = np.linalg.eigh(0.5 * (moment + moment.T))
    known = np.maximum(values, 0.0) / sigma**2 + reach**-2
    information = (axes * known) @ axes.T * np.outer(scale, scale)
    return np.asarray(0.5 * (information + information.T))
