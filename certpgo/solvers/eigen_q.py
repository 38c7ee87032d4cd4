"""Spectral initialization for poses: eigenvectors of the translation-eliminated data matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize import spectral
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status


@dataclass(frozen=True)
class EigenQ:
    """Rotations from the d smallest eigenvectors of Q, then the best translations for them.

    Doherty, Rosen, Leonard, ICRA 2022. Unlike EigenMA's, the eigenvectors know the translations:
    usually a better start, and its eigenvalues a better lower bound.

    Attributes
    ----------
    tol : relative accuracy of the eigenpairs

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import PoseProblem, get_solver
    >>> from certpgo.datasets.synthetic import helix
    >>> problem = PoseProblem(helix(3, np.random.default_rng(0)).graph)
    >>> solution = get_solver("eigen_q")().solve(problem)
    >>> solution.lower_bound <= solution.cost
    True
    """

    tol: float = 1e-3

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not 0.0 < self.tol < 1.0:
            raise SpecError(f"tol must lie between 0 and 1, not {self.tol}")

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Poses of the problem.

        Raises
        ------
        InputError
            The problem has no translations.
        """
        if not isinstance(problem, PoseProblem):
            raise InputError("eigen_q needs translations; use eigen_ra for rotations alone")
        watch = Stopwatch()
        with watch.phase("eigen"):
            pairs = spectral.eliminated_eigenpairs(problem, tol=self.tol)
        with watch.phase("round"):
            rotations = spectral.round_to_rotations(pairs.vectors, problem.d)
        with watch.phase("translations"):
            estimate = problem.complete(rotations)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=Status.CLOSED_FORM,
            lower_bound=spectral.spectral_bound(problem, pairs),
            seconds=watch.seconds,
        )


SOLVER = EigenQ
