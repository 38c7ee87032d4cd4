"""GTSAM's Riemannian staircase on rotations (RiemannianStaircaseOptimizer, new in 4.3)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, rounded
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._averaging import Averaging
from ._baseline import Outcome
from ._gtsam import Model, isotropic_model, library

#: For the augmented Lagrangian, as in GTSAM's own tests; its defaults, 20 and 1e-5, are looser.
MAX_ITERATIONS, VIOLATION = 100, 1e-8


@dataclass(frozen=True)
class Staircase(Averaging):
    """Burer-Monteiro by augmented Lagrangians; see `Averaging` for the settings.

    Its cost is F. The note is its own verdict, an eigenvalue or its threshold -1e-3, and how far
    its values are from rotations; the estimate is their projection. Iterations are levels of the
    staircase.
    """

    def ready(
        self, problem: Quadratic, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build factors and initial values; the function climbs and projects the result."""
        gtsam, ranks = library(), self.ranks(problem.d)
        with watch.phase("build"):
            model = isotropic_model(problem)
            graph = _frobenius(model)
        with watch.phase("start"):
            values = gtsam.Values()
            for key, R in enumerate(self.begin(problem, model, initial).rotations):
                values.insert(key, R.T)  # its variables are stacked in rows
        parameters = _parameters(ranks)

        def run() -> Outcome:
            search = gtsam.RiemannianStaircaseOptimizer(graph, values, parameters)
            return _outcome(search.optimize(), model)

        return run


def _outcome(result: Any, model: Model) -> Outcome:
    # It does not round what it does not certify.
    values = result.roundedValues() if result.hasRoundedSolution() else result.values
    Y = np.array([values.atMatrix(key).T for key in model.keys])
    if not np.isfinite(Y).all():
        raise NumericalError("GTSAM: the result is not finite")
    verdict = "certified" if result.certified else "not certified"
    return Outcome(
        model,
        model.values(rounded(Lift(Y))),
        Status.CONVERGED if result.certified else Status.ITERATION_LIMIT,
        len(result.getRanksVisited()),
        f"GTSAM's staircase: {verdict} at p = {result.finalRank}, "
        f"smallest eigenvalue {result.minEigenvalue:.1e}, {_defects(Y)}",
    )


def _defects(Y: FloatArray) -> str:
    """How far blocks (n, p, d) are from rotations."""
    gram = np.swapaxes(Y, 1, 2) @ Y
    defect = f"orthogonal up to {np.abs(gram - np.eye(Y.shape[2])).max():.1e}"
    if Y.shape[1] > Y.shape[2]:
        return defect
    determinants = so.determinants(Y)
    return f"{defect}, determinants {determinants.min():.6f} to {determinants.max():.6f}"


def _frobenius(model: Model) -> Any:
    gtsam = library()
    factor = getattr(gtsam, f"FrobeniusBetweenFactor{model.kind}")
    graph = gtsam.NonlinearFactorGraph()
    for k in range(model.graph.nrFactors()):
        between = model.graph.at(k)
        graph.add(factor(*between.keys(), between.measured(), between.noiseModel()))
    return graph


def _parameters(ranks: range) -> Any:
    parameters = library().RiemannianStaircaseParams()
    parameters.pMin, parameters.pMax = ranks[0], ranks[-1]
    inner = parameters.getAlmParams()
    inner.maxIterations, inner.absoluteViolationTolerance = MAX_ITERATIONS, VIOLATION
    parameters.setAlmParams(inner)
    return parameters


SOLVER = Staircase
