"""Spectral initialization for poses: eigenvectors of the translation-eliminated data matrix."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import spectral
from certpgo.optimize.iterative import Settings
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Solution, Status


@dataclass(frozen=True)
class EigenQ(Settings):
    """Rotations from the d smallest eigenvectors of Q, with optimal translations.

    Doherty, Rosen, Leonard, ICRA 2022. Unlike EigenMA, Q includes the translations: usually a
    better initialization, and its eigenvalues a better lower bound.

    Attributes
    ----------
    tol : relative accuracy of the eigenpairs

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import Quadratic, get_solver
    >>> from certpgo.io.datasets.synthetic import helix
    >>> problem = Quadratic(helix(3, np.random.default_rng(0)).graph)
    >>> solution = get_solver("eigen_q")().solve(problem)
    >>> solution.lower_bound <= solution.cost
    True
    """

    tol: float = 1e-3

    rotations: ClassVar[bool] = False
    takes_initial: ClassVar[bool] = False

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """The poses; InputError for a problem without translations."""
        if not problem.has_positions:
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
