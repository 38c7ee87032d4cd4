"""GTSAM's Shonan rotation averaging (Dellaert et al., ECCV 2020), and its verdict on estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._averaging import Averaging, posed
from ._baseline import Outcome
from ._gtsam import Model, isotropic_model, library
from ._programs import GTSAM


@dataclass(frozen=True)
class Shonan(Averaging):
    """Shonan averaging with GTSAM's parameters; see `Averaging` for the settings.

    Its cost is F. The note is its own verdict: a point is certified if the smallest eigenvalue
    found by its Lanczos is above -1e-4; its certificate matrix is twice ours.
    """

    def ready(
        self, problem: Quadratic, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build measurements and initial values; the function climbs the staircase."""
        ranks = self.ranks(problem.d)
        with watch.phase("build"):
            model = isotropic_model(problem)
            averaging = _averaging(problem.rotation)
        with watch.phase("start"):
            start = self.begin(problem, model, initial)
        return lambda: _climb(averaging, model, start, ranks)


def calls_optimal(problem: Quadratic, estimate: Estimate) -> tuple[bool, float]:
    """Shonan's verdict on the rotations of an estimate, and the eigenvalue it is based on."""
    library()
    with GTSAM.translated():
        averaging = _averaging(problem.rotation)
        values = _lifted(estimate.rotations, problem.d)
        verdict = bool(averaging.checkOptimality(values))
        return verdict, float(averaging.computeMinEigenValue(values))


def _climb(averaging: Any, model: Model, start: Estimate, ranks: range) -> Outcome:
    """ShonanAveraging's ``run``, which does not report its final rank."""
    threshold = _parameters(start.d).getOptimalityThreshold()
    level, iterations = _lifted(start.rotations, ranks[0]), 0
    for p in ranks:
        search = averaging.createOptimizerAt(p, level)
        point = search.optimize()
        iterations += search.iterations()
        eigenvalue, direction = averaging.computeMinEigenVector(point)
        finding = f"at p = {p}, smallest eigenvalue {eigenvalue:.1e}"
        if eigenvalue > threshold:
            values = averaging.roundSolution(point)
            return Outcome(
                model, values, Status.CONVERGED, iterations, f"Shonan: certified {finding}"
            )
        if p < ranks[-1]:
            level = averaging.initializeWithDescent(p + 1, point, direction, eigenvalue)
    raise NumericalError(f"GTSAM: Shonan::run did not converge for given max_p: {finding}")


def _averaging(problem: Quadratic) -> Any:
    """ShonanAveraging2 or 3, whose kappa 1/sigma^2 is twice ours; both accept pose factors."""
    graph = posed(problem).graph
    factors = [graph.at(k) for k in range(graph.nrFactors())]
    return getattr(library(), f"ShonanAveraging{problem.d}")(factors, _parameters(problem.d))


def _parameters(d: int) -> Any:
    """GTSAM's defaults."""
    gtsam = library()
    search = gtsam.LevenbergMarquardtParams.CeresDefaults()
    return getattr(gtsam, f"ShonanAveragingParameters{d}")(search)


def _lifted(R: FloatArray, p: int) -> Any:
    """Rotations (n, d, d) as Values of SO(p)."""
    gtsam = library()
    values = gtsam.Values()
    for key, rotation in enumerate(R):
        values.insert(key, gtsam.SOn.Lift(p, rotation))
    return values


SOLVER = Shonan
