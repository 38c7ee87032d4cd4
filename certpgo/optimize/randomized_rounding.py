"""Many estimates from one point of the relaxation, improved together.

If the relaxation is loose, random projections of the point find better estimates than the nearest
one (Goemans and Williamson 1995). F is the same quadratic form for each candidate, so all of them
are stacked in one array and share each product with the measurements.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, Point
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic

#: Maximal number of rotations in all candidates; minimal and maximal number of candidates, at most
#: two per node.
ROTATIONS, FEWEST, MOST = 8_000, 4, 64
#: Candidates for a point of rank d + 1; k^2 times as many for rank d + k.
CANDIDATES = 8
#: One in so many candidates is selected, and at least two.
SELECTED = 8
#: Sweeps before the selection; twice as many for higher ranks.
SWEEPS = 30
#: Relative difference of costs below which candidates are considered the same.
SAME = 1e-3
#: Radians by which the best estimate is perturbed: enough to leave a saddle, then its basin.
PERTURBATIONS = (1e-3, 0.1, 0.3, 0.6, 1.0)


def roundings(
    problem: Quadratic, point: Point, best: Estimate, rng: np.random.Generator
) -> Iterator[Estimate]:
    """Initial estimates that may descend below ``best``, the most promising first.

    Half of the candidates are random projections of the point, in both orientations, the others
    perturbations of the best estimate. All are improved by a few sweeps; the best distinct ones are
    returned. The looser the relaxation, the higher its rank and the more candidates.

    Parameters
    ----------
    point : of the relaxation, of any rank
    best : the best estimate known
    """
    extra = max(1, point.rotations.shape[1] - problem.d)
    most = min(MOST, 2 * problem.n, ROTATIONS // problem.n)
    number = max(FEWEST, min(CANDIDATES * extra**2, most))
    perturbed = _perturbed(best, rng, number // 2)
    projected = _projected(problem, point, rng, number - len(perturbed))
    candidates = _Candidates(problem, np.concatenate([projected, perturbed]))
    for _ in range(SWEEPS * min(extra, 2)):
        candidates.sweep()
    return islice(candidates.distinct(), max(2, number // SELECTED))


def _projected(
    problem: Quadratic, point: Point, rng: np.random.Generator, number: int
) -> FloatArray:
    """(number, n, d, d) rotations nearest to random projections; every other one is reflected."""
    Y = point.rotations
    d = Y.shape[2]
    basis = rng.standard_normal((number, d, Y.shape[1]))
    basis[1::2] = basis[0 : number - 1 : 2]
    basis[1::2, 0] *= -1.0
    return np.stack([problem.kinds.apply("rounded", G @ Y) for G in basis])


def _perturbed(best: Estimate, rng: np.random.Generator, number: int) -> FloatArray:
    """(number, n, d, d) perturbations of the best rotations, cycling through the sizes."""
    n, d = best.rotations.shape[:2]
    sizes = np.resize(PERTURBATIONS, number)[:, None, None]
    turns = sizes * rng.standard_normal((number, n, so.tangent_dim(d)))
    return np.asarray(best.rotations @ so.exp(turns))


class _Candidates:
    """Rotations (K, n, d, d), all with their best translations."""

    def __init__(self, problem: Quadratic, rotations: FloatArray) -> None:
        self.problem, self.rotations = problem, rotations
        self.ahead, self.sweeps = rotations, 0
        # The curvature of an upper bound on F that projection minimises.
        weight = 2.0 * problem.rotation.node_weights
        if problem.has_positions:
            weight = weight + problem.lever_weights
            weight[weight == 0.0] = 1.0  # points, whose rotations stay as they are
        self.weight = weight[:, None, None]

    def stacked(self, blocks: FloatArray) -> Lift:
        """All candidates (K, n, d, d) as one point of rank K d."""
        K, n, d, _ = blocks.shape
        R = np.swapaxes(blocks, 0, 1).reshape(n, K * d, d)
        return self.problem.with_optimal_translations(Lift(R, np.zeros((n, K * d))))

    def sweep(self) -> None:
        """A step of the projected gradient method, with Nesterov's extrapolation."""
        K, n, d, _ = self.rotations.shape
        point = self.stacked(self.ahead)
        G = self.problem.gradient(point)[:, :, -d:]
        target = (self.weight * point.rotations - G).reshape(n, K, d, d)
        before = self.rotations
        self.rotations = self.problem.kinds.apply("rounded", np.swapaxes(target, 0, 1))
        self.sweeps += 1
        momentum = self.sweeps / (self.sweeps + 3.0)
        self.ahead = self.rotations + momentum * (self.rotations - before)

    def costs(self) -> FloatArray:
        """(K,) values of F."""
        K, _, d, _ = self.rotations.shape
        point, problem = self.stacked(self.rotations), self.problem
        E = problem.rotation.residuals(point.rotations)
        costs = np.einsum("m,mrb->r", problem.rotation.graph.kappa, E**2)
        if problem.has_positions:
            costs += problem.graph.tau @ problem.translation_residuals(point) ** 2
        return np.asarray(costs.reshape(K, d).sum(axis=1))

    def distinct(self) -> Iterator[Estimate]:
        """Candidates in ascending order of cost, one for each cost."""
        costs = self.costs()
        last = -1.0
        for k in np.argsort(costs):
            if costs[k] > (1.0 + SAME) * last:
                yield self.problem.complete(self.rotations[k])
                last = float(costs[k])
