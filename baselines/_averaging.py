"""The base of GTSAM's staircases for rotation averaging: initialization and ranks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from certpgo.errors import SpecError
from certpgo.graph import Estimate, PoseGraph
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic

from ._baseline import Baseline
from ._gtsam import Model, isotropic_model, library


@dataclass(frozen=True)
class Averaging(Baseline):
    """A staircase of GTSAM on rotations alone, in 2D and 3D.

    Attributes
    ----------
    rank : the first rank; by default the dimension of space
    max_rank : the last rank; GTSAM's default is 10
    start : initialization if no estimate is given: GTSAM's ``"fastsync"``, its own default, its
        ``"chordal"`` initialization, or ``"random"`` rotations
    seed : of the random rotations
    """

    poses: ClassVar[bool] = False
    rotations: ClassVar[bool] = True

    rank: int | None = None
    max_rank: int = 10
    start: Literal["fastsync", "chordal", "random"] = "fastsync"
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        self.ranks(2)

    def ranks(self, d: int) -> range:
        """The ranks of the staircase in dimension d."""
        first = d if self.rank is None else self.rank
        if not d <= first <= self.max_rank:
            raise SpecError(f"no ranks of at least {d} from {first} to {self.max_rank}")
        return range(first, self.max_rank + 1)

    def begin(self, problem: Quadratic, model: Model, initial: Estimate | None) -> Estimate:
        """The initial rotations."""
        if initial is not None:
            return initial
        if self.start == "random":
            return Estimate(so.random(np.random.default_rng(self.seed), problem.n, problem.d))
        if self.start == "fastsync":
            return model.estimate(getattr(library(), f"fastSync{model.kind}")(model.graph))
        return model.estimate(_chordal(problem.rotation))


def posed(problem: Quadratic) -> Model:
    """The measurements as relative poses without translation, which some of GTSAM needs."""
    graph = problem.graph
    still = np.zeros((graph.num_edges, graph.d))
    return isotropic_model(Quadratic(PoseGraph(graph, still, graph.kappa)))


def _chordal(problem: Quadratic) -> Any:
    """The rotations of InitializePose3, in 2D of LAGO, as Values."""
    gtsam, graph = library(), posed(problem).anchored()
    if problem.d == 3:
        return gtsam.InitializePose3.initializeOrientations(graph)
    angles, values = gtsam.lago.initializeOrientations(graph, False), gtsam.Values()
    for key in range(problem.n):
        values.insert(key, gtsam.Rot2(angles.at(key)[0]))
    return values
