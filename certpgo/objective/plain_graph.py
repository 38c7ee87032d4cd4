"""Graphs of poses with isotropic weights, whose optimum and bound compiled code finds at once."""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo.graph import Estimate
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.rotations import rotation_defect
from certpgo.linalg.threads import one_thread
from certpgo.objective.edge_sums import EdgeSums
from certpgo.objective.quadratic import Quadratic

#: Sums of weights whose squares, over their number, are within the range of doubles.
RANGE = 2.0**-100, 2.0**100


class PlainGraph:
    """The problem of such a graph, see `is_plain`."""

    def __init__(self, problem: Quadratic) -> None:
        self._problem = problem
        of = EdgeSums(problem.graph)
        sums = of.node_sums
        places = problem.pattern.places[:3]
        of_nodes = sums.spread, sums.first, sums.degree
        self._graph: tuple[Any, ...] = of.edges, problem.d, places, of_nodes

    @staticmethod
    def is_plain(problem: Any) -> bool:
        """Whether there is compiled code for a problem."""
        if not (isinstance(problem, Quadratic) and compiled.AVAILABLE):
            return False
        graph = problem.graph
        plain = graph.has_positions and not (graph.is_general or graph.is_signed)
        plain = plain and bool((graph.nodes == 0).all()) and problem.engine == "multifrontal"
        return plain and not graph.has_scales and RANGE[0] <= problem.scale <= RANGE[1]

    @one_thread
    def settled(self, start: Estimate, enough: float) -> tuple[Estimate, FloatArray] | None:
        """The minimum near an estimate, and its multipliers (n, d, d); None if there is none near.

        By Newton's method with one factor, which ends where a step promised at most the share
        ``enough`` of F; then with the best translations.
        """
        problem, d = self._problem, self._problem.d
        R, t = np.array(start.rotations), np.array(start.translations)
        multipliers = np.empty_like(R)
        of_tangents, of_scalars = (self._fronts(b) for b in (d + d * (d - 1) // 2, 1))
        fronts = of_tangents.arrays, of_scalars.arrays
        found = compiled.kernel.settle(*self._graph, *fronts, enough, R, t, multipliers)
        return None if found is None else (problem.as_estimate(R, t), multipliers)

    @one_thread
    def proven(self, point: Estimate, multipliers: FloatArray) -> FloatArray | None:
        """(n, d, d) multipliers of `certpgo.certify.dual.dual_bound` by its first shift.

        None if that does not suffice.

        Parameters
        ----------
        point : with the best translations for its rotations
        multipliers : (n, d, d) those of the point
        """
        form, lowered = self._fronts(self._problem.d + 1), multipliers.copy()
        defect = rotation_defect(self._problem.graph.rotations)
        poses = point.rotations, point.translations
        known: tuple[Any, ...] = form.arrays, form.lengths, defect, *poses
        return lowered if compiled.kernel.prove(*self._graph, *known, lowered) else None

    def _fronts(self, rows: int) -> Any:
        symbolic: Any = self._problem.analyses.of_rows(rows)
        return symbolic.fronts
