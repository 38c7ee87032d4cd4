"""Ceres' Levenberg-Marquardt optimizer (Agarwal et al., Ceres Solver), by the package pyceres."""

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
from ._ceres import cost_functions, quaternions, rotations
from ._chi_squared import ChiSquared, information_of, started
from ._programs import CERES, Program


@dataclass(frozen=True, eq=False)
class Model:
    """A problem in Ceres.

    Attributes
    ----------
    problem : Ceres' own
    poses : (n, 3) x, y and angle; or (n, 7) position and quaternion x y z w, which Ceres changes
    start : the same at the beginning
    costs : one of each edge, which must outlive the problem
    note : which information they use
    """

    problem: Any
    poses: FloatArray
    start: FloatArray
    costs: list[Any]
    note: str

    @property
    def chi_squared(self) -> float:
        """Of the poses as they are; evaluate_residuals of pyceres 2.6 crashes."""
        return 2.0 * float(solved(self, max_num_iterations=0).initial_cost)

    def estimate(self, poses: FloatArray) -> Estimate:
        """The poses as an estimate; NumericalError if they are not finite."""
        if not np.isfinite(poses).all():
            raise NumericalError("Ceres: the result is not finite")
        if poses.shape[1] == 3:
            return Estimate(so.exp(poses[:, 2:]), poses[:, :2])
        return Estimate(so.project(rotations(poses[:, 3:])), poses[:, :3])


def solved(model: Model, **settings: Any) -> Any:
    """Ceres' summary of a run from the poses as they are; NumericalError if it fails."""
    ceres = CERES.library()
    options, summary = ceres.SolverOptions(), ceres.SolverSummary()
    options.linear_solver_type = ceres.LinearSolverType.SPARSE_NORMAL_CHOLESKY
    options.logging_type = ceres.LoggingType.SILENT
    for name, value in settings.items():
        setattr(options, name, value)
    ceres.solve(options, model.problem, summary)
    if not summary.IsSolutionUsable():
        raise NumericalError(f"Ceres: {summary.message}")
    return summary


def built(problem: Quadratic | Sum, estimate: Estimate, note: str = "") -> Model:
    """The problem at an estimate, with the first pose fixed."""
    ceres, graph, d = CERES.library(), problem.graph, problem.d
    R, t = estimate.rotations, estimate.translations
    poses = np.ascontiguousarray(np.c_[t, so.log(R) if d == 2 else quaternions(R)])
    blocks = [[pose] if d == 2 else [pose[:3], pose[3:]] for pose in poses]
    stated, costs = ceres.Problem(), cost_functions(graph, information_of(problem))
    for (i, j), cost in zip(graph.edges.tolist(), costs, strict=True):
        stated.add_residual_block(cost, None, blocks[i] + blocks[j])
    if d == 3:
        for _, quaternion in blocks:
            stated.set_manifold(quaternion, ceres.EigenQuaternionManifold())
    for block in blocks[0]:
        stated.set_parameter_block_constant(block)
    return Model(stated, poses, poses.copy(), costs, note)


@dataclass(frozen=True)
class LevenbergMarquardt(ChiSquared):
    """Ceres' Levenberg-Marquardt from GTSAM's chordal initialization; settings as `ChiSquared`.

    Residuals are those of Ceres' pose-graph examples, in Python, as pyceres binds none: the phase
    ``evaluate`` is what they take, and ``solve`` is all else.
    """

    program: ClassVar[Program] = CERES

    def ready(
        self, problem: Quadratic | Sum, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build the problem; the function runs the optimizer from the initial poses."""
        ceres = self.program.library()
        with watch.phase("start"):
            start = started(problem, initial)
        with watch.phase("build"):
            model = built(problem, start, self.note(problem))
        limits = {
            "max_num_iterations": self.max_iterations,
            "function_tolerance": self.tolerance,
        }

        def run() -> Outcome:
            model.poses[:] = model.start
            summary = solved(model, **limits)
            ended = summary.termination_type == ceres.TerminationType.CONVERGENCE
            return Outcome(
                model,
                model.poses,
                Status.CONVERGED if ended else Status.ITERATION_LIMIT,
                summary.num_successful_steps + summary.num_unsuccessful_steps - 1,
                evaluating=(
                    summary.residual_evaluation_time_in_seconds
                    + summary.jacobian_evaluation_time_in_seconds
                )
                / summary.total_time_in_seconds,
            )

        return run


SOLVER = LevenbergMarquardt
