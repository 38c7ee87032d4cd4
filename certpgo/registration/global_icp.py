"""Global ICP: all scans moved at once to meet where they overlap, without pairwise motions.

Toldo, Beinat, Crosilla, "Global registration of multiple point clouds embedding the generalized
Procrustes analysis into an ICP framework", 3DPVT 2010: mutually nearest points of all scans form
groups, and the scans move so that the points of each group meet. Here they meet as discs do, mostly
across the surface (see `DISC`), so that scans slide along each other within a few steps; and all
scans move at once, rather than each to the groups' centres in turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.dense import PreparedCloud

#: Weight of a distance along the surface, relative to one across it.
DISC = 0.1
#: Levenberg's, relative to a scan's own weight.
DAMPING = 1e-3
#: The reach shrinks by this factor once no point moves by more than `SETTLED` of it, or after so
#: many rounds, as matches may alternate.
FINER, SETTLED, LONGEST = 0.5, 0.25, 15
#: The end: so many rounds at the finest reach without a gain of this share.
PATIENCE, GAIN = 4, 1e-3
#: Normals of a group that agree less do not lie on one surface.
AGREEMENT = 0.8


@dataclass(frozen=True, eq=False)
class GlobalRegistration:
    """Where the scans are.

    Attributes
    ----------
    estimate : a pose for each scan; the first stays where it was
    rounds : of matching and moving
    converged : whether the rule of the end is met, rather than the limit of rounds
    groups : of points that meet, at the estimate
    rmse : root mean square distance of grouped points from their group's centre, metres
    """

    estimate: Estimate
    rounds: int
    converged: bool
    groups: int
    rmse: float


@dataclass(frozen=True, eq=False)
class Round:
    """What a monitor is told: reach and rmse in metres; `groups`, and how far a scan moved."""

    number: int
    reach: float
    groups: int
    rmse: float
    moved: float


def global_icp(
    clouds: list[PreparedCloud],
    initial: Estimate,
    *,
    reach: float,
    finest: float,
    max_rounds: int = 100,
    monitor: Callable[[Round], object] = lambda _: None,
) -> GlobalRegistration:
    """Move scans so that mutually nearest points meet.

    The reach, up to which points are partners, begins large and is halved whenever the scans come
    to rest. At the finest one the estimate that gathers most points most closely is kept, and the
    search ends when there is no better one.

    Parameters
    ----------
    initial : n poses, of scans that nearly overlap
    reach : to begin with, about as far as points are misplaced, metres
    finest : reach at the end, about the distance of neighbouring points, metres
    monitor : is called with each round

    Raises
    ------
    InputError
        Another number of poses, no translations, or reaches that are not positive.
    """
    if initial.num_nodes != len(clouds) or initial.translations is None or initial.d != 3:
        raise InputError(f"{len(clouds)} poses in space expected, one for each scan")
    if not 0.0 < finest <= reach:
        raise InputError(f"0 < finest <= reach expected, not {finest:g} and {reach:g}")
    cloudset = _Clouds(clouds, finest)
    R, t = initial.rotations.copy(), initial.translations.copy()
    best, best_score, since = (R, t, 0, 0.0), -1.0, 0
    number = level = 0
    while number < max_rounds and since < PATIENCE:
        number, level = number + 1, level + 1
        groups = cloudset.groups(R, t, reach)
        if reach == finest:
            since = 0 if groups.score > (1.0 + GAIN) * best_score else since + 1
            if groups.score > best_score:
                best, best_score = (R, t, groups.count, groups.rmse), groups.score
        R, t, moved = cloudset.moved(R, t, groups)
        monitor(Round(number, reach, groups.count, groups.rmse, moved))
        if reach > finest and (moved < SETTLED * reach or level == LONGEST):
            reach, level = max(FINER * reach, finest), 0
    if best_score < 0.0:  # the limit came before the finest reach
        best = (R, t, groups.count, groups.rmse)
    R, t, count, rmse = best
    estimate = Estimate(R, t).anchored(0, initial)
    return GlobalRegistration(estimate, number, since == PATIENCE, count, rmse)


@dataclass(frozen=True, eq=False)
class _Groups:
    """Points that meet, each of another scan.

    Attributes
    ----------
    member : (k,) number of each point among those of all clouds
    group : (k,) number of its group
    apart : (k, 3) from the group's centre to the point, in the world
    normal : (k, 3) of the group's surface
    score : members that are at their centre count 1, those at the reach 0
    """

    member: IntArray
    group: IntArray
    apart: FloatArray
    normal: FloatArray
    score: float

    @property
    def count(self) -> int:
        return int(self.group.max()) + 1 if len(self.group) else 0

    @property
    def rmse(self) -> float:
        return float(np.sqrt(np.mean(np.sum(self.apart**2, axis=1)))) if len(self.group) else 0.0


class _Clouds:
    """Points and normals of all scans in a row, and a tree for each scan, built once."""

    def __init__(self, clouds: list[PreparedCloud], spacing: float) -> None:
        self.spacing = spacing
        sizes = [len(cloud.points) for cloud in clouds]
        self.first = np.concatenate([[0], np.cumsum(sizes)])
        self.scan = np.repeat(np.arange(len(clouds)), sizes)
        self.points = np.concatenate([cloud.points for cloud in clouds])
        self.normals = np.concatenate([cloud.normals for cloud in clouds])
        self.trees = [cKDTree(cloud.points) for cloud in clouds]
        self.centres = np.array([cloud.points.mean(axis=0) for cloud in clouds])
        self.sizes = np.array(
            [
                np.linalg.norm(c.points - m, axis=1).max()
                for c, m in zip(clouds, self.centres, strict=True)
            ]
        )

    def _pairs(self, R: FloatArray, t: FloatArray, reach: float) -> IntArray:
        """(k, 2) points of two scans, each the nearest to the other within reach."""
        stride = max(1, round(0.5 * reach / self.spacing) ** 2)
        found = [np.empty((0, 2), dtype=np.intp)]
        for i, own in enumerate(self.trees):
            asked = np.arange(0, own.n, stride)
            seen = own.data[asked] @ R[i].T + t[i]
            for j, other in enumerate(self.trees):
                if i == j:
                    continue
                # Queries move rather than trees.
                distance, b = other.query((seen - t[j]) @ R[j], distance_upper_bound=reach)
                met = distance < reach
                there = other.data[b[met]] @ R[j].T + t[j]
                _, back = own.query((there - t[i]) @ R[i], distance_upper_bound=reach)
                mutual = back == asked[met]
                a = self.first[i] + asked[met][mutual]
                found.append(np.stack([a, self.first[j] + b[met][mutual]], axis=1))
        return np.concatenate(found)

    def groups(self, R: FloatArray, t: FloatArray, reach: float) -> _Groups:
        """Compact groups: components of mutual pairs, with the central point of each scan."""
        a, b = self._pairs(R, t, reach).T
        total = len(self.points)
        graph = sparse.coo_array((np.ones(len(a), dtype=bool), (a, b)), (total, total))
        label = connected_components(graph, directed=False)[1]
        member = np.unique(np.concatenate([a, b]))
        group = label[member]
        place = self._placed(self.points, member, R) + t[self.scan[member]]
        distance = np.linalg.norm(place - _means(place, group), axis=1)
        # Components chain from scan to scan and back: of each scan the most central point stays.
        order = np.lexsort((distance, self.scan[member], group))
        key = np.stack([group[order], self.scan[member[order]]])
        chosen = order[np.r_[True, (np.diff(key) != 0).any(axis=0)][: len(order)]]
        member, group, place = member[chosen], group[chosen], place[chosen]
        normal = self._placed(self.normals, member, R)
        leader = np.unique(group, return_index=True, return_inverse=True)[1:]
        leading = normal[leader[0]][leader[1]] if len(group) else normal
        normal = _means(
            np.where(np.sum(normal * leading, 1, keepdims=True) < 0, -normal, normal), group
        )
        length = np.linalg.norm(normal, axis=1)
        kept = length > AGREEMENT
        member, place, normal = member[kept], place[kept], (normal / length[:, None])[kept]
        group = np.unique(group[kept], return_inverse=True)[1]
        apart = place - _means(place, group)
        score = float(np.sum(1.0 - np.sum(apart**2, axis=1) / reach**2))
        return _Groups(member, group, apart, normal, score)

    def _placed(self, vectors: FloatArray, member: IntArray, R: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("kab,kb->ka", R[self.scan[member]], vectors[member]))

    def moved(
        self, R: FloatArray, t: FloatArray, groups: _Groups
    ) -> tuple[FloatArray, FloatArray, float]:
        """A Gauss-Newton step of generalized Procrustes: new poses, and how far a point moved.

        The cost is the sum of squared distances from the groups' centres, which follow the points:
        with M the means over groups, J^T (I - M) J.
        """
        if not groups.count:
            return R, t, 0.0
        n, scan = len(R), self.scan[groups.member]
        centres = np.einsum("nab,nb->na", R, self.centres) + t
        arm = self._placed(self.points, groups.member, R) + t[scan] - centres[scan]
        size = 1.0 / np.sqrt(np.bincount(groups.group))
        number = np.arange(len(scan))
        means = sparse.csr_array((size[groups.group], (groups.group, number)))
        H, gradient = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
        axes = [np.broadcast_to(axis, arm.shape) for axis in np.eye(3)]
        for direction, weight in [(groups.normal, 1.0 - DISC), *((axis, DISC) for axis in axes)]:
            rows = np.hstack([np.cross(arm, direction), direction])
            columns = 6 * scan[:, None] + np.arange(6)
            start = 6 * np.arange(len(scan) + 1)
            J = sparse.csr_array((rows.ravel(), columns.ravel(), start), (len(scan), 6 * n))
            mean = means @ J
            H += weight * (J.T @ J - mean.T @ mean).toarray()
            gradient += weight * (J.T @ np.sum(direction * groups.apart, axis=1))
        # All scans can move together, and one without partners anywhere: neither does.
        own = np.diag(H)
        step = np.linalg.solve(H + np.diag(DAMPING * own + (own == 0.0)), gradient)
        turn, shift = np.split(-step.reshape(n, 6), 2, axis=1)
        new = so.project(so.exp(turn) @ R)
        farthest = self.sizes * np.linalg.norm(turn, axis=1) + np.linalg.norm(shift, axis=1)
        t = centres + shift - np.einsum("nab,nb->na", new, self.centres)
        return new, t, float(farthest.max())


def _means(values: FloatArray, group: IntArray) -> FloatArray:
    """The mean over each value's group, (k, 3) as the values."""
    if not len(group):
        return values
    _, place = np.unique(group, return_inverse=True)
    sums = [np.bincount(place, column) for column in values.T]
    return (np.stack(sums, axis=1) / np.bincount(place)[:, None])[place]
