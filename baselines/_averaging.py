"""What GTSAM's staircases for rotation averaging share: where they start, and their ranks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate, PoseGraph
from certpgo.linalg import so
from certpgo.objective.problem import PoseProblem, Problem, RotationProblem

from ._baseline import Baseline
from ._gtsam import Model, isotropic_model, library

STARTS = ("fastsync", "chordal", "random")


@dataclass(frozen=True)
class Averaging(Baseline):
    """A staircase of GTSAM on rotations alone, in 2D and 3D.

    Attributes
    ----------
    rank : where the staircase begins; by default the dimension of space
    max_rank : where it ends; GTSAM's default is 10
    start : where to start when no initial estimate is given: GTSAM's ``"fastsync"``, which is its
        own default, its ``"chordal"`` initialization, or ``"random"`` rotations
    seed : of the random rotations

    Raises
    ------
    SpecError
        An unknown start, ranks that make no staircase, a negative seed.
    """

    poses: ClassVar[bool] = False
    rotations: ClassVar[bool] = True

    rank: int | None = None
    max_rank: int = 10
    start: str = "fastsync"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.start not in STARTS:
            raise SpecError.unknown("start", self.start, STARTS)
        self.ranks(2)
        if self.seed < 0:
            raise SpecError(f"seed must not be negative: {self.seed}")

    def ranks(self, d: int) -> range:
        """The ranks to climb in dimension d.

        Raises
        ------
        SpecError
            The first is below d, or above the last.
        """
        first = d if self.rank is None else self.rank
        if not d <= first <= self.max_rank:
            raise SpecError(f"no ranks of at least {d} from {first} to {self.max_rank}")
        return range(first, self.max_rank + 1)

    def begin(self, problem: Problem, model: Model, initial: Estimate | None) -> Estimate:
        """The rotations to start from."""
        if initial is not None:
            return initial
        if self.start == "random":
            return Estimate(so.random(np.random.default_rng(self.seed), problem.n, problem.d))
        if self.start == "fastsync":
            return model.estimate(getattr(library(), f"fastSync{model.kind}")(model.graph))
        return model.estimate(_chordal(problem.rotation))


def posed(problem: RotationProblem) -> Model:
    """The measurements as those of poses at one place: what GTSAM asks for here and there."""
    graph = problem.graph
    still = np.zeros((graph.num_edges, graph.d))
    return isotropic_model(PoseProblem(PoseGraph(graph, still, graph.kappa)))


def _chordal(problem: RotationProblem) -> Any:
    """The rotations of InitializePose3, in 2D of LAGO, as Values."""
    gtsam, graph = library(), posed(problem).anchored()
    if problem.d == 3:
        return gtsam.InitializePose3.initializeOrientations(graph)
    angles, values = gtsam.lago.initializeOrientations(graph, False), gtsam.Values()
    for key in range(problem.n):
        values.insert(key, gtsam.Rot2(angles.at(key)[0]))
    return values
