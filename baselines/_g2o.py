"""The base of g2o's optimizers (Kuemmerle et al., ICRA 2011), by the package g2opy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._baseline import Outcome
from ._chi_squared import ChiSquared, information_of, started
from ._programs import G2O, Program


@dataclass(frozen=True, eq=False)
class Model:
    """A problem in g2o: an optimizer that holds the graph, and its vertices in order."""

    d: int
    optimizer: Any
    vertices: list[Any]
    note: str

    @property
    def chi_squared(self) -> float:
        """Of the vertices as they are."""
        self.optimizer.initialize_optimization()
        self.optimizer.compute_active_errors()
        return float(self.optimizer.active_chi2())

    def restart(self) -> None:
        """Put the vertices where they were built."""
        for vertex in self.vertices:
            vertex.pop()
            vertex.push()

    def estimate(self, vertices: list[Any]) -> Estimate:
        """The poses of vertices; NumericalError if they are not finite."""
        if self.d == 2:
            x = np.array([vertex.estimate().vector() for vertex in vertices])
            R, t = so.exp(x[:, 2:]), x[:, :2]
        else:
            M = np.array([vertex.estimate().matrix() for vertex in vertices])
            R, t = M[:, :3, :3], M[:, :3, 3]
        if not (np.isfinite(R).all() and np.isfinite(t).all()):
            raise NumericalError("g2o: the result is not finite")
        return Estimate(so.project(R), t)


def built(problem: Quadratic | Sum, estimate: Estimate, note: str = "") -> Model:
    """The problem at an estimate, with the first pose fixed."""
    g2o, d = G2O.library(), problem.d
    optimizer, vertices = g2o.SparseOptimizer(), []
    for k, pose in enumerate(_poses(estimate.rotations, estimate.translations)):
        vertex = getattr(g2o, f"VertexSE{d}")()
        vertex.set_id(k)
        vertex.set_estimate(pose)
        vertex.set_fixed(k == 0)
        vertex.push()
        optimizer.add_vertex(vertex)
        vertices.append(vertex)
    graph = problem.graph
    measured = _poses(graph.rotations, graph.translations)
    stated = information_of(problem)
    for (i, j), pose, information in zip(graph.edges.tolist(), measured, stated, strict=True):
        edge = getattr(g2o, f"EdgeSE{d}")()
        edge.set_vertex(0, vertices[i])
        edge.set_vertex(1, vertices[j])
        edge.set_measurement(pose)
        edge.set_information(information)
        optimizer.add_edge(edge)
    return Model(d, optimizer, vertices, note)


@dataclass(frozen=True)
class Optimizer(ChiSquared):
    """An optimizer of g2o with Eigen's sparse Cholesky factorization; settings as `ChiSquared`."""

    program: ClassVar[Program] = G2O
    algorithm: ClassVar[str]

    def ready(
        self, problem: Quadratic | Sum, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build the graph; the function runs the optimizer from the initial poses."""
        g2o, d = self.program.library(), problem.d
        with watch.phase("start"):
            start = started(problem, initial)
        with watch.phase("build"):
            model = built(problem, start, self.note(problem))
            allowed = model.chi_squared * (1.0 + self.tolerance) + 1e-12 * problem.scale
            blocks = getattr(g2o, f"BlockSolverSE{d}")(getattr(g2o, f"LinearSolverEigenSE{d}")())
            model.optimizer.set_algorithm(
                getattr(g2o, f"OptimizationAlgorithm{self.algorithm}")(blocks)
            )
            small = g2o.SparseOptimizerTerminateAction()
            small.set_gain_threshold(self.tolerance)
            model.optimizer.add_post_iteration_action(small)

        def run() -> Outcome:
            model.restart()
            model.optimizer.initialize_optimization()
            steps = model.optimizer.optimize(self.max_iterations)
            return Outcome(model, model.vertices, self._status(model, allowed, steps), steps)

        return run

    def _status(self, model: Model, allowed: float, steps: int) -> Status:
        # Gauss-Newton keeps a step that increases chi^2.
        if steps <= 0:
            raise NumericalError("g2o: its linear system cannot be solved")
        if not model.optimizer.active_chi2() <= allowed:
            return Status.STALLED
        return Status.ITERATION_LIMIT if steps >= self.max_iterations else Status.CONVERGED


def _poses(R: FloatArray, t: FloatArray) -> list[Any]:
    g2o = G2O.library()
    if R.shape[-1] == 2:
        return [g2o.SE2(*x, a) for x, [a] in zip(t.tolist(), so.log(R).tolist(), strict=True)]
    M = np.tile(np.eye(4), (len(R), 1, 1))
    M[:, :3, :3], M[:, :3, 3] = R, t
    return [g2o.Isometry3d(pose) for pose in M]
