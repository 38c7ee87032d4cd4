"""`certpgo.register`: scans of one scene, brought into one frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, combinations
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from certpgo.errors import InputError, SpecError, require
from certpgo.graph import Estimate, Instance
from certpgo.graph.edges import components_of
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.dense import prepare
from certpgo.registration.global_icp import GlobalRegistration, global_icp
from certpgo.registration.pairwise import Pair, aligned_pairs, pose_graph
from certpgo.registration.scans import Scan, read_scan
from certpgo.solve.fit import Fit
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.solving import solve

Method = Literal["pose_graph", "global_icp"]
#: Points of a scan that the default voxel leaves, about.
ENOUGH = 10_000
#: In voxels: how far scans may be misplaced, the voxels of the coarse search, and the reach of the
#: pairs.
FAR, COARSE, NEAR = 20.0, 2.0, 2.0


@dataclass(frozen=True, eq=False)
class Registration:
    """Scans in one frame.

    Attributes
    ----------
    estimate : a pose for each scan, p_world = R p + t; the first is where it was
    voxel : edge of the voxels that were matched, metres
    coarse : the global ICP that came first, or was all
    pairs, sliding : those that were kept, and those that contradict the rest; both empty for
        global ICP alone
    disagreement : (m,) how far the estimate puts a scan of each kept pair from where the pair alone
        does, rms, metres
    instance, solution : the pose graph and its certified solution; None for global ICP alone
    """

    estimate: Estimate
    voxel: float
    coarse: GlobalRegistration
    pairs: tuple[Pair, ...] = ()
    sliding: tuple[Pair, ...] = ()
    disagreement: FloatArray | None = None
    instance: Instance | None = None
    solution: CertifiedSolution | None = None

    @property
    def fit(self) -> Fit | None:
        """chi^2 of the measured pairs; None for global ICP alone."""
        return None if self.solution is None else self.solution.fit


def register(
    scans: Sequence[Scan | str | Path],
    initial: Estimate | None = None,
    *,
    method: Method = "pose_graph",
    voxel: float | None = None,
    reach: float | None = None,
    told: Callable[[str], object] | None = None,
) -> Registration:
    """Bring scans of one scene into one frame, from about where they are.

    Global ICP moves all scans at once. Then, unless it is all, generalized ICP measures each pair
    that overlaps, and the graph of these measurements with their information matrices is solved and
    certified. The certificate is about the measured pairs: whether the right surfaces were matched
    is for the overlap, the pairs that slid away and the disagreement to say.

    Parameters
    ----------
    scans : two or more, or their files
    initial : a pose for each; by default all are in one frame already
    method : ``"pose_graph"``, or ``"global_icp"`` for that alone, without a certificate
    voxel : points within such a cube are averaged, metres; by default about 10,000 are left
    reach : how far points may be misplaced to begin with, metres; by default 20 voxels
    told : is called with a sentence at each stage

    Raises
    ------
    GraphError
        Scans do not overlap with the others; they are named.
    InputError
        Fewer than two scans, another number of poses, or lengths that are not positive.
    MissingDependency
        small_gicp is not installed.
    SpecError
        An unknown method.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.registration.scans import Scan
    >>> x, y = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 4000))
    >>> hills = np.stack([x, y, 0.3 * np.sin(3.0 * x) * np.cos(2.0 * y)], axis=1)
    >>> scans = [Scan("left", hills[x < 0.5]), Scan("right", hills[x > -0.5] + [0.02, 0.0, 0.0])]
    >>> found = certpgo.register(scans)
    >>> found.solution.verdict.value
    'CERTIFIED'
    >>> bool(np.abs(found.estimate.translations[1] - [-0.02, 0.0, 0.0]).max() < 1e-4)
    True
    """
    if method not in get_args(Method):
        raise SpecError.unknown("method", method, get_args(Method))
    require(scans, list | tuple, "a list of scans, or of their files,")
    for scan in scans:
        require(scan, Scan | str | Path, "a Scan, or the path of its file,")
    read = [scan if isinstance(scan, Scan) else read_scan(scan) for scan in scans]
    if (n := len(read)) < 2:
        raise InputError("registration needs two or more scans")
    if initial is None:
        initial = Estimate(np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)))
    if initial.num_nodes != n or initial.translations is None or initial.d != 3:
        raise InputError(f"{n} poses in space expected, one for each scan")
    # Rounding decides where far scans go: in one order, whatever the order of the files.
    order = np.array(sorted(range(n), key=lambda k: read[k].points.tobytes()))
    ordered, back = [read[k] for k in order], np.argsort(order)
    voxel = default_voxel(ordered) if voxel is None else voxel
    search = _CoarseToFine(ordered, voxel, reach, method, told or (lambda _: None))
    coarse, *measured = search.run(initial.subset(order))
    coarse = replace(coarse, estimate=coarse.estimate.subset(back).anchored(0, initial))
    if method == "global_icp":
        return Registration(coarse.estimate, voxel, coarse)
    pairs, sliding = (tuple(pair.renumbered(order.tolist()) for pair in some) for some in measured)
    instance = pose_graph(pairs, [scan.name for scan in read], coarse.estimate)
    search.told("solving")
    solution = solve(instance)
    estimate = solution.estimate.anchored(0, initial)
    fine = [search.fine[k] for k in back]
    disagreement = np.array([pair.disagreement(fine, estimate) for pair in pairs])
    return Registration(estimate, voxel, coarse, pairs, sliding, disagreement, instance, solution)


class _CoarseToFine:
    """Where scans are, and the pairs that tell it."""

    def __init__(
        self,
        scans: Sequence[Scan],
        voxel: float,
        reach: float | None,
        method: Method,
        told: Callable[[str], object],
    ) -> None:
        self.names, self.told = [scan.name for scan in scans], told
        self.fine = [prepare(scan.points, voxel=voxel) for scan in scans]
        self.reach, self.near = FAR * voxel if reach is None else reach, NEAR * voxel
        self.finest, self.clouds = voxel, self.fine
        self.is_alone = method == "global_icp"
        if not self.is_alone:
            self.finest = COARSE * voxel
            self.clouds = [prepare(scan.points, voxel=self.finest) for scan in scans]
        for name, cloud in zip(self.names, self.clouds, strict=True):
            if (voxels := len(cloud.points)) < 30:
                raise InputError(f"{name}: {voxels} voxels are too few to register")

    def run(self, initial: Estimate) -> tuple[GlobalRegistration, list[Pair], list[Pair]]:
        """Global ICP, the pairs that are near it, and those that slid away."""
        everything = range(len(self.clouds))
        coarse = self._moved(everything, initial, self.reach)
        if self.is_alone:
            return coarse, [], []
        pairs, sliding = self._measured(everything, coarse.estimate)
        if _parts(len(self.clouds), pairs).any():
            # A scan without a place pulls others out of theirs: two at a time have none of it.
            known = [*pairs, *sliding]
            known += self._two_by_two(initial, _parts(len(self.clouds), known))
            graph = pose_graph(known, self.names, coarse.estimate).graph
            placed = compose(graph, spanning_tree(graph, root="center"))
            coarse = self._moved(everything, placed, self.finest)
            pairs, sliding = self._measured(everything, coarse.estimate)
        return coarse, pairs, sliding

    def _two_by_two(self, initial: Estimate, parts: IntArray) -> Iterator[Pair]:
        """Pairs of scans of different parts, each brought together without the others."""
        candidates = [(a, b) for a, b in combinations(range(len(parts)), 2) if parts[a] != parts[b]]
        for number, both in enumerate(candidates, 1):
            self.told(f"by itself: pair {number} of {len(candidates)}")
            coarse = self._moved(both, initial.subset(np.array(both)), self.reach)
            for pair in chain(*self._measured(both, coarse.estimate)):
                yield pair.renumbered(both)

    def _moved(self, scans: Sequence[int], initial: Estimate, reach: float) -> GlobalRegistration:
        """Global ICP of some scans."""
        return global_icp(
            [self.clouds[k] for k in scans],
            initial,
            reach=reach,
            finest=self.finest,
            monitor=lambda r: self.told(
                f"round {r.number}: {r.groups} groups, {r.rmse:.2g} m apart, reach {r.reach:.2g} m"
            ),
        )

    def _measured(self, scans: Sequence[int], estimate: Estimate) -> tuple[list[Pair], list[Pair]]:
        """Pairs of some scans, near an estimate and slid away from it."""
        return aligned_pairs(
            [self.fine[k] for k in scans],
            estimate,
            reach=self.near,
            told=lambda done, total: self.told(f"pair {done + 1} of {total}"),
        )


def _parts(n: int, pairs: Sequence[Pair]) -> IntArray:
    """(n,) which part each scan is in, of those that pairs join."""
    return components_of(n, np.array([(pair.i, pair.j) for pair in pairs]).reshape(-1, 2))


def default_voxel(scans: Sequence[Scan]) -> float:
    """The edge of voxels that leave about `ENOUGH` points of a scan of middle size, metres."""
    extent = np.median([np.ptp(scan.points, axis=0).max() for scan in scans])
    scan = sorted(scans, key=lambda scan: len(scan.points))[len(scans) // 2]
    if not extent > 0.0:
        raise InputError(f"{scan.name}: all points are one")
    voxel = float(extent) / 100.0
    for _ in range(4):  # surfaces: half the edge leaves four times as many
        places = np.floor(scan.points / voxel).astype(np.int64)
        left = len(np.unique(places, axis=0))
        voxel *= float(np.sqrt(left / min(ENOUGH, max(len(scan.points) // 2, 1))))
    return voxel
