"""Whether measurements are met exactly, but for rounding.

The cost of such an estimate is rounding of its own evaluation, and no bound can be within a share
of it. Residuals are compared, not costs: a single large weight makes rounding cost more than all
that other measurements do.
"""

from __future__ import annotations

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.observations import Observations
from certpgo.graph.relaxed_point import Point, translations_of
from certpgo.linalg.arrays import FloatArray
from certpgo.objective import operators
from certpgo.objective.objective import Objective
from certpgo.objective.term import relative, term_of

#: Residual over the numbers it is the difference of: what solving linear equations of a large map
#: leaves. From here on, bounds on rounding are small against the square of a residual.
ROUNDING = 2.0**-36
#: The same of the coordinates of a position, which are stored to half a unit in the last place.
STORED = 2.0**-50


def fits_exactly(problem: Objective, estimate: Estimate) -> bool:
    """Whether every residual of an estimate is rounding, whatever its weight."""
    edges = _meets_edges(problem.form, problem.blocks(estimate))
    return edges and meets_blocks(problem.measured, estimate)


def meets(graph: Graph, point: Point) -> bool:
    """Whether every residual of a graph's measurements is rounding."""
    return _meets_edges(graph, point) and meets_blocks(graph, point)


def meets_blocks(graph: Graph, point: Point) -> bool:
    """The same of all but its edges."""
    return all(_meets(block, point) for block in graph.blocks)


def _meets_edges(graph: Graph, point: Point) -> bool:
    i, j = graph.edges.T
    turned = _norms(operators.rotation_residuals(graph, point.rotations))
    size = _norms(point.rotations)[j]
    if not (turned <= ROUNDING * size)[graph.kappa != 0.0].all():
        return False
    if not graph.has_positions:
        return True
    moved = _norms(operators.translation_residuals(graph, point))
    far, stored = _distances(point)
    # Positions solve the equations of all: their rounding is relative to the map.
    size = far[i] + far[j] + _norms(operators.steps(graph, point)) + np.sqrt(np.mean(far**2))
    most = ROUNDING * size + STORED * (stored[i] + stored[j])
    return bool((moved <= most)[graph.tau != 0.0].all())


def _meets(block: Observations, estimate: Point) -> bool:
    """Whether every residual of a block is rounding of what it is the difference of."""
    term, (i, j) = term_of(block), block.edges.T
    far, stored = _distances(estimate)
    off = _norms(term.residuals(*relative(block.edges, term.arms, estimate)))
    most = ROUNDING * term.sizes
    if term.in_metres:
        most = most + ROUNDING * (far[i] + far[j]) + STORED * (stored[i] + stored[j])
    return bool((off <= most).all())


def _distances(point: Point) -> tuple[FloatArray, FloatArray]:
    """(n,) distances of positions from their mean, and from the origin.

    Where the origin is, says nothing of the map.
    """
    t = translations_of(point)
    return _norms(t - t.mean(axis=0)), _norms(t)


def _norms(x: FloatArray) -> FloatArray:
    """(k,) Frobenius norms of k vectors or matrices."""
    return np.asarray(np.sqrt(np.sum(x * x, axis=tuple(range(1, x.ndim)))))
