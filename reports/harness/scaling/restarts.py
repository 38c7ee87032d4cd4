"""Whether simply restarting many times finds what `solve` did not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.certify import Verdict
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.io.datasets.edges import random_edges
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.solve.solving import solve

#: Noise of the rotations, radians, and of the steps relative to their size; None is uniform.
NOISES = (0.1, 0.3, 0.6, 1.0, 1.5, None)
#: Newton's steps in a restart, and the stationarity at which its cost is known well enough.
STEPS, TOLERANCE = 200, 1e-6


@dataclass(frozen=True)
class RestartOutcome:
    """One graph, solved and then attacked.

    Attributes
    ----------
    number : of the graph, from 0
    verdict : of `solve`
    cost : of its estimate
    best : the lowest cost that a restart reached
    """

    number: int
    verdict: Verdict
    cost: float
    best: float

    @property
    def excess(self) -> float:
        """By what part of its cost a restart beat the estimate; negative where none did."""
        return (self.cost - self.best) / self.cost if self.cost > 0.0 else 0.0


def graphs(count: int, seed: int = 0) -> Iterator[Graph]:
    """Random graphs in turn: in the plane and in space, of rotations and poses, of any noise.

    10 to 80 nodes; a random tree and up to twice as many further edges.
    """
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        d, poses = 2 + number % 2, bool(number // 2 % 2)
        noise = NOISES[number // 4 % len(NOISES)]
        n = int(rng.integers(10, 81))
        edges = random_edges(n, n - 1 + int(rng.integers(2, 2 * n)), rng)
        yield _graph(rng, n, d, edges, noise, poses)


def attacked(number: int, graph: Graph, restarts: int) -> RestartOutcome:
    """The estimate of `solve`, and the best of Newton's method from uniformly random rotations."""
    solved, problem = solve(graph), Quadratic(graph)
    best = np.inf
    if solved.verdict is Verdict.BOUNDED:
        rng = np.random.default_rng(number)
        for _ in range(restarts):
            start = problem.complete(so.random(rng, problem.n, problem.d))
            best = min(best, _restarted(problem, start))
    return RestartOutcome(number, solved.verdict, solved.cost, best)


def _restarted(problem: Quadratic, start: Estimate) -> float:
    return newton(problem, start, NewtonSettings(tolerance=TOLERANCE, max_iterations=STEPS)).cost


def _graph(
    rng: np.random.Generator, n: int, d: int, edges: np.ndarray, noise: float | None, poses: bool
) -> Graph:
    m, (i, j) = len(edges), edges.T
    R = so.random(rng, n, d)
    measured = so.random(rng, m, d)
    if noise is not None:
        turns = so.exp(noise * rng.standard_normal((m, so.tangent_dim(d))))
        measured = np.swapaxes(R[i], 1, 2) @ R[j] @ turns
    rotation = RotationGraph(n, edges, measured, rng.uniform(0.5, 2.0, m))
    if not poses:
        return rotation
    t = 3.0 * rng.standard_normal((n, d))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    steps = steps + (1.0 if noise is None else noise) * rng.standard_normal((m, d))
    return PoseGraph(rotation, steps, rng.uniform(0.5, 2.0, m))
