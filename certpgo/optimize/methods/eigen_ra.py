"""EigenRA: rotation averaging by the smallest eigenvectors of the connection Laplacian."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

from certpgo.graph import Estimate
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status

Anchor = Literal["none", "first", "chordal"]
Weights = Literal["graph", "unit"]
Eigensolver = Literal["krylov_schur", "arpack"]


@dataclass(frozen=True)
class EigenRA(Settings):
    """The closed-form estimator of Moreira 2020, sections 4.2 and 4.6, d = 2 and 3.

    Attributes
    ----------
    weights : ``"graph"`` uses kappa; ``"unit"`` weighs every edge equally, as the thesis does
    anchor : how eigenvectors V become rotations (Appendix B.6): ``"none"`` projects the blocks of
        V; ``"first"`` those of V V_1^-1; ``"chordal"`` solves a linear system with the first
        rotation fixed instead, which is the chordal relaxation
    eigensolver : ``"krylov_schur"`` (block, the default) or ``"arpack"``
    tol : relative accuracy of the eigenpairs

    Examples
    --------
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> problem = Quadratic(winding_cycle(6, 0.3, 0)[0].graph)
    >>> solution = get_solver("eigen_ra")().solve(problem)
    >>> solution.lower_bound <= solution.cost  # the spectral bound, after eq. 4.7
    True
    """

    weights: Weights = "graph"
    anchor: Anchor = "none"
    eigensolver: Eigensolver = "krylov_schur"
    tol: float = 1e-5

    poses: ClassVar[bool] = False
    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations of the problem; translations, if any, are ignored."""
        watch = Stopwatch()
        rotations, bound = self.rotations_of(problem.rotation, watch)
        estimate = Estimate(rotations)
        return Solution(
            estimate=estimate,
            cost=problem.rotation.cost(estimate),
            status=Status.CLOSED_FORM,
            lower_bound=bound,
            seconds=watch.seconds,
        )

    def rotations_of(self, problem: Quadratic, watch: Stopwatch) -> tuple[FloatArray, float | None]:
        """Rotations (n, d, d), and the spectral bound on F*, if the weights are the graph's."""
        if self.weights == "unit":
            problem = problem.with_unit_weights()
        if self.anchor == "chordal":
            with watch.phase("solve"):
                return spectral.solve_anchored(problem), None
        with watch.phase("eigen"):
            pairs = spectral.smallest_eigenpairs(problem, tol=self.tol, method=self.eigensolver)
        with watch.phase("round"):
            if self.anchor == "first":
                rotations = spectral.round_anchored(pairs.vectors, problem.d)
            else:
                rotations = spectral.round_to_rotations(pairs.vectors, problem.d)
        bound = spectral.spectral_bound(problem, pairs) if self.weights == "graph" else None
        return rotations, bound


SOLVER = EigenRA
