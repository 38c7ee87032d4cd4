"""GTSAM's Levenberg-Marquardt optimizer from random rotations, on the chordal cost F itself."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Stopwatch
from certpgo.optimize.solution import Status

from ._baseline import Baseline, Outcome
from ._gtsam import Model, chordal_model, library

#: Decrease of the error, relative and in units of W, at which GTSAM stops: stationary to six
#: digits; its defaults stop much earlier.
DECREASE = 1e-13
#: Relative difference of costs below which minima are the same.
SAME = 1e-6


@dataclass(frozen=True)
class RandomStarts(Baseline):
    """The best of several random starts of Levenberg-Marquardt; the baseline of Eriksson et al.

    Its factors are chordal (FrobeniusBetweenFactor), so that GTSAM minimises F, not its own
    logarithmic residuals. Initial rotations have uniformly random axes and angles uniform in
    [0, 2 pi], different for each graph.

    Attributes
    ----------
    starts : number of starts
    seed : of the starts
    max_iterations : of each start
    """

    poses: ClassVar[bool] = False
    rotations: ClassVar[bool] = True

    starts: int = 1
    seed: int = 0
    max_iterations: int = 500

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.starts < 1 or self.max_iterations < 1:
            raise SpecError("starts and max_iterations must be at least 1")

    def ready(
        self, problem: Quadratic, initial: Estimate | None, watch: Stopwatch
    ) -> Callable[[], Outcome]:
        """Build graph and starts; an initial estimate is the first one."""
        with watch.phase("build"):
            model = chordal_model(problem)
        with watch.phase("start"):
            initials = [model.values(start) for start in self._starts(problem, initial)]
        parameters = library().LevenbergMarquardtParams()
        parameters.setMaxIterations(self.max_iterations)
        parameters.setRelativeErrorTol(DECREASE)
        parameters.setAbsoluteErrorTol(DECREASE * problem.scale)

        def run() -> Outcome:
            ends = [self._optimized(model, values, parameters) for values in initials]
            best = min(ends, key=lambda end: end.error)
            near = best.error + SAME * abs(best.error) + 1e-12 * problem.scale
            counts = {"starts": self.starts, "best ones": sum(end.error <= near for end in ends)}
            return Outcome(model, best.values, best.status, best.iterations, counts=counts)

        return run

    def _starts(self, problem: Quadratic, initial: Estimate | None) -> Iterator[Estimate]:
        if initial is not None:
            yield initial
        measured = zlib.crc32(np.ascontiguousarray(problem.rotation.graph.rotations).tobytes())
        rng = np.random.default_rng([self.seed, measured])
        for _ in range(self.starts - (initial is not None)):
            yield Estimate(random_turns(rng, problem.n, problem.d))

    def _optimized(self, model: Model, values: Any, parameters: Any) -> End:
        search = library().LevenbergMarquardtOptimizer(model.graph, values, parameters)
        result = search.optimize()
        limited = search.iterations() >= self.max_iterations
        status = Status.ITERATION_LIMIT if limited else Status.CONVERGED
        return End(result, search.error(), status, search.iterations())


@dataclass(frozen=True, eq=False)
class End:
    """The result of one start."""

    values: Any
    error: float
    status: Status
    iterations: int


def random_turns(rng: np.random.Generator, n: int, d: int) -> FloatArray:
    """Rotations (n, d, d) about uniformly random axes by angles uniform in [0, 2 pi]."""
    axis = rng.standard_normal((n, so.tangent_dim(d)))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return so.exp(rng.uniform(0.0, 2.0 * np.pi, (n, 1)) * axis)


SOLVER = RandomStarts
