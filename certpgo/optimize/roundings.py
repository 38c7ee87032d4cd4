"""Many estimates out of one point of the relaxation, improved together.

Where the relaxation is loose, the nearest estimate is one among many, and random projections of
the point find better ones (Goemans and Williamson 1995). F is the same quadratic form for each
candidate, so that all of them stand in one array, candidate below candidate, and a product with
the measurements serves them all.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.lift import Lift, Point
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import PoseProblem, Problem

#: Rotations in all candidates together, and the fewest and most candidates; at most two a node.
ROTATIONS, FEWEST, MOST = 8_000, 4, 64
#: Candidates where the point has one dimension more than space; k more ask for k^2 times as many.
CANDIDATES = 8
#: One in so many is worth a descent, and at least two are.
SELECTED = 8
#: Sweeps that tell a good candidate from a bad one; twice as many where there are many.
SWEEPS = 30
#: Candidates whose costs differ by less, relatively, are taken for the same.
SAME = 1e-3
#: Radians by which the best estimate is kicked: out of a saddle, and farther and farther out of
#: its basin.
KICKS = (1e-3, 0.1, 0.3, 0.6, 1.0)


def roundings(
    problem: Problem, point: Point, best: Estimate, rng: np.random.Generator
) -> Iterator[Estimate]:
    """Estimates that a descent may improve on ``best`` from, the most promising first.

    Half of the candidates are random projections of the point, in both orientations, the others
    kicks of the best estimate. All are improved by some sweeps, then the best few remain, and of
    equals one. The looser the relaxation, the more dimensions its points have, and the more
    candidates there are.

    Parameters
    ----------
    point : of the relaxation, of any rank
    best : the best estimate known
    """
    more = max(1, point.rotations.shape[1] - problem.d)
    most = min(MOST, 2 * problem.n, ROTATIONS // problem.n)
    number = max(FEWEST, min(CANDIDATES * more**2, most))
    kicked = _kicked(best, rng, number // 2)
    projected = _projected(point, rng, number - len(kicked))
    many = _Candidates(problem, np.concatenate([projected, kicked]))
    for _ in range(SWEEPS * min(more, 2)):
        many.sweep()
    return islice(many.distinct(), max(2, number // SELECTED))


def _projected(point: Point, rng: np.random.Generator, number: int) -> FloatArray:
    """(number, n, d, d) rotations nearest to random projections; every other one is reflected."""
    Y = point.rotations
    d = Y.shape[2]
    basis = rng.standard_normal((number, d, Y.shape[1]))
    basis[1::2] = basis[0 : number - 1 : 2]
    basis[1::2, 0] *= -1.0
    return np.stack([so.project(G @ Y) for G in basis])


def _kicked(best: Estimate, rng: np.random.Generator, number: int) -> FloatArray:
    """(number, n, d, d) rotations near the best, of sizes in turn."""
    n, d = best.rotations.shape[:2]
    sizes = np.resize(KICKS, number)[:, None, None]
    turns = sizes * rng.standard_normal((number, n, so.tangent_dim(d)))
    return np.asarray(best.rotations @ so.exp(turns))


class _Candidates:
    """Rotations (K, n, d, d), all with their best translations."""

    def __init__(self, problem: Problem, rotations: FloatArray) -> None:
        self.problem, self.rotations = problem, rotations
        self.ahead, self.sweeps = rotations, 0
        # The curvature of an upper bound on F, which is lowest at the nearest rotations.
        weight = 2.0 * problem.rotation.node_weights
        if isinstance(problem, PoseProblem):
            weight = weight + problem.lever_weights
        self.weight = weight[:, None, None]

    def stacked(self, blocks: FloatArray) -> Lift:
        """One point of as many dimensions as all candidates (K, n, d, d) have together."""
        K, n, d, _ = blocks.shape
        R = np.swapaxes(blocks, 0, 1).reshape(n, K * d, d)
        return self.problem.settled(Lift(R, np.zeros((n, K * d))))

    def sweep(self) -> None:
        """A step of the projected gradient method, with Nesterov's extrapolation."""
        K, n, d, _ = self.rotations.shape
        point = self.stacked(self.ahead)
        G = self.problem.gradient(point)[:, :, -d:]
        target = (self.weight * point.rotations - G).reshape(n, K, d, d)
        before, self.rotations = self.rotations, so.project(np.swapaxes(target, 0, 1))
        self.sweeps += 1
        momentum = self.sweeps / (self.sweeps + 3.0)
        self.ahead = self.rotations + momentum * (self.rotations - before)

    def costs(self) -> FloatArray:
        """(K,) values of F."""
        K, _, d, _ = self.rotations.shape
        point, problem = self.stacked(self.rotations), self.problem
        E = problem.rotation.residuals(point.rotations)
        costs = np.einsum("m,mrb->r", problem.rotation.graph.kappa, E**2)
        if isinstance(problem, PoseProblem):
            costs += problem.graph.tau @ problem.translation_residuals(point) ** 2
        return np.asarray(costs.reshape(K, d).sum(axis=1))

    def distinct(self) -> Iterator[Estimate]:
        """Candidates by cost, but one of each cost."""
        costs = self.costs()
        last = -1.0
        for k in np.argsort(costs):
            if costs[k] > (1.0 + SAME) * last:
                yield self.problem.complete(self.rotations[k])
                last = float(costs[k])
