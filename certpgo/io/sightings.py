"""Graphs of nothing but points that cameras see, numbered apart from the cameras."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Graph, PoseGraph, RotationGraph, SimilarityGraph
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, numbered


def seen_twice(points: IntArray) -> BoolArray:
    """(k,) which sightings are of points (k,) that others are of, too."""
    _, which, counts = np.unique(points, return_inverse=True, return_counts=True)
    return np.asarray(counts[which] > 1)


def graph_of_sightings(
    pairs: IntArray, where: FloatArray, tau: FloatArray, *, free: bool = False
) -> tuple[Graph, IntArray, int]:
    """The graph, the ids of its nodes, and what was added to the numbers of points.

    Parameters
    ----------
    pairs : (k, 2) a camera and a point, each numbered from 0 or more
    where : (k, 3) where the point is in the camera's frame
    free : whether each camera's unit of length is its own, and unknown
    """
    cameras = np.unique(pairs[:, 0])
    moved_by = int(cameras[-1]) + 1
    ids = np.concatenate([cameras, np.unique(pairs[:, 1]) + moved_by])
    edges = numbered(ids, pairs + np.array([0, moved_by]))
    k = len(tau)
    rotation = RotationGraph(len(ids), edges, np.tile(np.eye(3), (k, 1, 1)), np.zeros(k))
    points = np.arange(len(ids)) >= len(cameras)
    make = SimilarityGraph if free else PoseGraph
    return make(rotation, where, tau, points=points), ids, moved_by
