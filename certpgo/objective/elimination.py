"""The best translations for given rotations, which F determines."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.linalg import scalar_least_squares as network
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.factor import Factor
from certpgo.objective import operators


class EliminatedTranslations:
    """Translations, eliminated by the factor of their Laplacian.

    Parameters
    ----------
    problem : the `certpgo.objective.quadratic.Quadratic` of poses
    """

    def __init__(self, problem: Any) -> None:
        self._problem = problem

    @cached_property
    def laplacian(self) -> CSC:
        """The graph Laplacian weighted by tau, (n, n)."""
        return operators.laplacian(self._problem.pattern, self._problem.graph.tau)

    @cached_property
    def factor(self) -> Factor | None:
        """Its factor without the first node; None where weights are too uneven, or not positive."""
        found: Factor | None = self._problem.grounded_factor(self.laplacian)
        return found

    def solve(self, forces: FloatArray) -> FloatArray:
        """(n, d) solution of (translation Laplacian) t = forces, with the first node at zero.

        Raises
        ------
        NumericalError
            The weights are too uneven for a factorization.
        """
        if self.factor is None:
            raise NumericalError("the translation Laplacian could not be factorized")
        grounded = forces.copy()
        grounded[0] = 0.0
        return self.factor.solve(grounded)

    def best(self, point: Point) -> FloatArray:
        """(n, r) the translations that minimise F for a point's blocks.

        Solves for a correction, so that rounding is relative to it.
        """
        problem = self._problem
        if self.factor is not None:
            forces = np.ascontiguousarray(problem.gradient(point)[:, :, 0])
            return translations_of(point) - self.solve(forces)
        graph = problem.form  # the weights are too uneven
        known, steps = graph.measures_translation, operators.steps(graph, point)
        measured = graph.edges[known], graph.tau[known], steps[known]
        t = network.positions(problem.n, *measured, problem.order)
        return np.asarray(t - t[0])
