"""Pairs of scans that overlap, aligned and measured: a pose graph with information matrices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from certpgo.errors import GraphError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.graph import require_connected
from certpgo.graph.information import Information
from certpgo.linalg.arrays import FloatArray
from certpgo.registration.dense import DenseRegistration, PreparedCloud, align

#: Share of the smaller scan's points that must have partners to begin with, and in the end; and of
#: these, the share that must meet: 34 to 72 % do where hills cross by chance, and 84 % or more of
#: scans that show the same, unless their noise exceeds a quarter of a voxel.
CANDIDATE, OVERLAP, MEETING = 0.1, 0.25, 0.8


@dataclass(frozen=True, eq=False)
class Pair:
    """Two scans and how they were aligned: ``found`` is of scan j in the frame of scan i."""

    i: int
    j: int
    found: DenseRegistration

    def renumbered(self, scans: Sequence[int]) -> Pair:
        """The same, of scans that have other numbers."""
        return replace(self, i=scans[self.i], j=scans[self.j])

    def disagreement(self, clouds: list[PreparedCloud], estimate: Estimate) -> float:
        """How far an estimate puts the points of j from where the pair does, rms, metres."""
        R, t = _relative(estimate, self.i, self.j)
        points = clouds[self.j].points
        difference = points @ (R - self.found.R).T + t - self.found.t
        return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))


def _relative(estimate: Estimate, i: int, j: int) -> tuple[FloatArray, FloatArray]:
    """Scan j in the frame of scan i."""
    R, t = estimate.rotations, estimate.translations
    if t is None:
        raise GraphError("poses have translations")
    return R[i].T @ R[j], R[i].T @ (t[j] - t[i])


def aligned_pairs(
    clouds: list[PreparedCloud],
    estimate: Estimate,
    *,
    reach: float,
    told: Callable[[int, int], object] = lambda done, total: None,
) -> tuple[list[Pair], list[Pair]]:
    """Pairs of scans that overlap, aligned from an estimate.

    Parameters
    ----------
    reach : distance up to which points are partners, metres
    told : is called with how many pairs are done, and of how many

    Returns
    -------
    the pairs that stay within reach of the estimate, and those that slid away from it, which
    contradict it
    """
    candidates = list(combinations(range(len(clouds)), 2))
    staying, sliding = list[Pair](), list[Pair]()
    for number, (a, b) in enumerate(candidates):
        told(number, len(candidates))
        # The smaller scan is the source: its share tells the overlap.
        i, j = (a, b) if len(clouds[b].points) <= len(clouds[a].points) else (b, a)
        R, t = _relative(estimate, i, j)
        sample = clouds[j].points[::10] @ R.T + t
        if not len(sample) or np.mean(clouds[i].nearest(sample)[1] <= reach) < CANDIDATE:
            continue
        found = align(clouds[i], clouds[j], (R, t), reach=reach)
        if found is None or found.overlap < OVERLAP or found.meeting < MEETING:
            continue
        pair = Pair(i, j, found)
        stays = pair.disagreement(clouds, estimate) <= reach
        (staying if stays else sliding).append(pair)
    return staying, sliding


def pose_graph(pairs: Sequence[Pair], names: list[str], initial: Estimate) -> Instance:
    """The graph of pairs, with their information matrices as g2o weighs them.

    g2o's residuals are translations and half angles.

    Raises
    ------
    GraphError
        Scans overlap with no others, or fall apart in groups that do not.
    """
    n = len(names)
    edges = np.array([(pair.i, pair.j) for pair in pairs], dtype=np.intp).reshape(-1, 2)
    alone = sorted(names[k] for k in np.setdiff1d(np.arange(n), edges))
    if alone:
        said = "overlaps with no other scan" if len(alone) == 1 else "overlap with no other scans"
        raise GraphError(f"{', '.join(alone)}: {said}")
    order = [3, 4, 5, 0, 1, 2]
    full = np.array([pair.found.information[np.ix_(order, order)] for pair in pairs])
    # As for files: harmonic means over the axes of either block.
    inverse_t, inverse_R = (
        np.trace(np.linalg.inv(full[:, block, block]), axis1=1, axis2=2)
        for block in (slice(0, 3), slice(3, None))
    )
    rotation = RotationGraph(n, edges, np.array([p.found.R for p in pairs]), 1.5 / inverse_R)
    half = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    graph = PoseGraph(
        rotation,
        np.array([p.found.t for p in pairs]),
        3.0 / inverse_t,
        information=Information.of(half[:, None] * full * half, "g2o", "quaternion"),
    )
    require_connected(graph)
    distinct = tuple(names) if len(set(names)) == n else ()  # files of two folders
    return Instance("scans", graph, np.arange(n), initial=initial, names=distinct)
