"""Which frames to compare, and which of the matches to believe."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.registration.camera import Camera
from certpgo.registration.features import Features
from certpgo.registration.pairs import FramePair

#: Visual words, descriptors they are learnt from, and frames retrieved for each.
WORDS, SAMPLE, RETRIEVED = 48, 20_000, 5
#: Frames that two frames of a loop are apart at least.
GAP = 10
#: Share of a frame's points that the other must see, and frames chosen for each.
OVERLAP, SEEN = 0.5, 5
#: Points of a frame by which overlap is estimated.
PROBES = 60
#: Steps of odometry: to the next frame and the one after it.
STEPS = (1, 2)
#: Standard deviations at which dead reckoning contradicts a loop, and by how much it may drift
#: beyond what its steps state: keypoints of neighbouring steps err alike.
CONTRADICTION, DRIFT = 3.0, 3.0
#: What dead reckoning never contradicts: radians, metres.
UNREMARKABLE = math.radians(1.0), 0.02
#: The variance of a step that was not measured.
UNKNOWN = 1e6

Pairs = list[tuple[int, int]]


def adjacent(n: int) -> Pairs:
    """Each frame with the next ones."""
    return [(k, k + step) for k in range(n) for step in STEPS if k + step < n]


def retrieved(features: Sequence[Features | None], rng: np.random.Generator) -> Pairs:
    """Pairs of frames that look alike: the nearest by VLAD, at least `GAP` apart.

    Jegou, Douze, Schmid, Perez, "Aggregating local descriptors into a compact image
    representation", 2010, with intra-normalization (Arandjelovic, Zisserman 2013).
    """
    known = [k for k, found in enumerate(features) if found is not None and len(found)]
    if len(known) <= GAP:
        return []
    everything = [found for found in features if found is not None and len(found)]
    share = max(SAMPLE // len(known), 10)
    sample = np.concatenate(
        [
            found.descriptors[rng.permutation(len(found))[:share]]
            for found in everything
            if found is not None
        ]
    ).astype(np.float32)
    words = kmeans2(sample, min(WORDS, len(sample)), minit="points", rng=rng)[0]
    vectors = np.array([_vlad(found.descriptors, words) for found in everything if found])
    likeness = vectors @ vectors.T
    number = np.array(known)
    likeness[np.abs(number[:, None] - number) < GAP] = -np.inf
    pairs = set()
    for row, values in enumerate(likeness):
        for column in np.argsort(-values)[:RETRIEVED]:
            if np.isfinite(values[column]):
                pairs.add((min(known[row], known[column]), max(known[row], known[column])))
    return sorted(pairs)


def _vlad(descriptors: NDArray[np.uint8], words: FloatArray) -> FloatArray:
    """A unit vector of summed differences from the nearest words."""
    rows = descriptors.astype(np.float32)
    nearest = ((words**2).sum(axis=1) - 2.0 * rows @ words.T).argmin(axis=1)
    sums = np.zeros_like(words)
    np.add.at(sums, nearest, rows - words[nearest])
    sums /= np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-9)
    return np.asarray(sums.ravel() / max(float(np.linalg.norm(sums)), 1e-9))


def overlapping(
    clouds: Mapping[int, NDArray[np.float32]],
    estimate: Estimate,
    camera: Camera,
    size: tuple[int, int],
    done: set[tuple[int, int]],
) -> Pairs:
    """Pairs of frames that see the same places at the current estimate, and were not tried.

    Parameters
    ----------
    clouds : points of frames in their own frames, by number, ascending
    estimate : their poses
    size : width and height of images, pixels
    done : pairs that were tried
    """
    R, t = estimate.rotations, estimate.translations
    numbers = np.array(list(clouds))
    if t is None:
        return []
    probes = [cloud[:: max(len(cloud) // PROBES, 1)][:PROBES] for cloud in clouds.values()]
    owner = np.repeat(np.arange(len(probes)), [len(few) for few in probes])
    places = (np.concatenate(probes)[:, None, :] @ np.swapaxes(R[owner], 1, 2))[:, 0] + t[owner]
    totals = np.maximum(np.bincount(owner, minlength=len(probes)), 1)
    pairs = set()
    for k, i in enumerate(numbers.tolist()):
        local = (places - t[k]) @ R[k]
        front = local[:, 2] > 0.1
        pixels = camera.pixels(np.where(front[:, None], local, 1.0))
        inside = front & (pixels >= 0.0).all(axis=1) & (pixels < size).all(axis=1)
        shares = np.bincount(owner[inside], minlength=len(probes)) / totals
        shares[np.abs(numbers - i) < GAP] = 0.0
        best = [other for other in np.argsort(-shares)[:SEEN] if shares[other] >= OVERLAP]
        pairs |= {(min(i, j), max(i, j)) for j in numbers[best].tolist()}
    return sorted(pairs - done)


class DeadReckoning:
    """Poses composed from steps of odometry, and how far they may have drifted.

    Parameters
    ----------
    nodes : (n,) numbers of frames, ascending
    estimate : their poses
    steps : the measured steps
    """

    def __init__(self, nodes: IntArray, estimate: Estimate, steps: Sequence[FramePair]) -> None:
        self._of = {number: k for k, number in enumerate(nodes.tolist())}
        self.R, self.t = estimate.rotations, estimate.translations
        following = {(p.i, p.j): _variances(p) for p in steps}
        ends = itertools.pairwise(nodes.tolist())
        variances = [following.get(pair, (UNKNOWN, UNKNOWN)) for pair in ends]
        self._sums = np.vstack([np.zeros(2), np.cumsum(np.reshape(variances, (-1, 2)), axis=0)])

    def reaches(self, pair: FramePair) -> bool:
        """Whether both frames are joined by steps."""
        if self.t is None or pair.i not in self._of or pair.j not in self._of:
            return False
        i, j = self._of[pair.i], self._of[pair.j]
        return bool(abs(self._sums[j] - self._sums[i])[0] < UNKNOWN)

    def allows(self, pair: FramePair) -> bool:
        """Whether a loop is no farther from dead reckoning than this can have drifted."""
        if not self.reaches(pair):
            return True
        i, j = self._of[pair.i], self._of[pair.j]
        R, t = self._between(i, j)
        return self._closes((R.T @ pair.R, R.T @ (pair.t - t)), [(i, j)], [pair])

    def agree(self, a: FramePair, b: FramePair) -> bool:
        """Whether two loops make a cycle that closes with odometry between their ends."""
        (i, j), (k, m) = ((self._of[pair.i], self._of[pair.j]) for pair in (a, b))
        R, t = np.eye(3), np.zeros(3)
        # Along a from i to j, to m, back along b to k, and to i again.
        for turn, shift in (
            (a.R, a.t),
            self._between(j, m),
            (b.R.T, -b.R.T @ b.t),
            self._between(k, i),
        ):
            R, t = R @ turn, t + R @ shift
        return self._closes((R, t), [(i, k), (j, m)], [a, b])

    def _between(self, i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """The pose of node j in the frame of node i."""
        R, t = self.R, self.t
        shift = np.zeros(3) if t is None else R[i].T @ (t[j] - t[i])
        return R[i].T @ R[j], shift

    def _closes(
        self,
        off: tuple[FloatArray, FloatArray],
        ways: Sequence[tuple[int, int]],
        pairs: Sequence[FramePair],
    ) -> bool:
        """Whether what remains of a cycle may be drift on the ways and errors of the pairs."""
        turn = shift = 0.0
        for i, j in ways:
            way = slice(min(i, j), max(i, j) + 1)
            turned, moved = abs(self._sums[j] - self._sums[i]) * DRIFT**2
            # A turn on the way moves what comes after it.
            extent = 0.0 if self.t is None else float((np.ptp(self.t[way], axis=0) ** 2).sum())
            turn, shift = turn + turned, shift + moved + extent * turned / 3.0
        own = np.sum([_variances(pair) for pair in pairs], axis=0)
        angle, distance = float(so.angle(off[0])), float(np.linalg.norm(off[1]))
        return (
            angle <= CONTRADICTION * math.sqrt(turn + own[0]) + UNREMARKABLE[0]
            and distance <= CONTRADICTION * math.sqrt(shift + own[1]) + UNREMARKABLE[1]
        )


def _variances(pair: FramePair) -> tuple[float, float]:
    """Traces of the covariances of rotation and translation, rad^2 and m^2."""
    C = pair.covariance
    return float(np.trace(C[:3, :3])), float(np.trace(C[3:6, 3:6]))


def consistent(loops: Sequence[FramePair], reckoning: DeadReckoning) -> list[FramePair]:
    """Loops that agree with one another in pairs: a large clique of those, found greedily.

    Two loops agree if the cycle that they make with the odometry between their ends closes, within
    what it may have drifted there (Mangelson, Dominic, Eustice, Vasudevan, "Pairwise consistent
    measurement set maximization", 2018). Loops of frames that odometry does not reach are left out.
    """
    known = [pair for pair in loops if reckoning.reaches(pair)]
    if not known:
        return []
    agree = np.array([[reckoning.agree(a, b) for b in known] for a in known])
    agree |= agree.T
    candidates = np.ones(len(known), dtype=bool)
    clique: list[int] = []
    while candidates.any():
        support = np.where(candidates, (agree & candidates).sum(axis=1), -1)
        best = int(support.argmax())
        clique.append(best)
        candidates &= agree[best]
        candidates[best] = False
    return [known[k] for k in sorted(clique)]
