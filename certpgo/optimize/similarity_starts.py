"""Where descents over similarities begin."""

from __future__ import annotations

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.edges import components_of
from certpgo.graph.relaxed_point import Lift
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import add_to_diagonal, pinned, scatter_sum
from certpgo.objective.objective import Objective
from certpgo.objective.operators import laplacian
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.initialization import Start, start_of


def nearest_start(problem: Objective) -> Start:
    """The nearest to a minimum."""
    return Start(linear_start(problem.isotropic), "linear relaxation")


def least_shrunk_start(problem: Objective) -> Start:
    """See `separate_start`."""
    return Start(separate_start(problem.isotropic), "scales, then poses")


#: How starts are computed, the nearest to a minimum first.
STARTS = (nearest_start, least_shrunk_start)


def first_start(problem: Objective) -> Start:
    """The first of them that can be computed.

    Raises
    ------
    NumericalError
        The weights are too uneven for all.
    """
    try:
        return nearest_start(problem)
    except (NumericalError, np.linalg.LinAlgError):
        return least_shrunk_start(problem)


def linear_start(problem: Quadratic) -> Estimate:
    """The minimum of F over all matrices A and vectors t, one pose held, rounded.

    Raises
    ------
    NumericalError
        That is not unique, up to rounding, or a block has no rotation near it.
    """
    layout, d = problem.pattern.layout_of(problem.matrix), problem.d
    rows = layout.first_row(problem.root) + np.arange(d + 1)
    fixed = np.zeros((problem.matrix.shape[0], d))
    fixed[rows[1:]] = np.eye(d)
    forces = -(problem.matrix @ fixed)
    forces[rows] = 0.0
    A = pinned(problem.matrix, rows)
    factor = problem.symbolic(A).factor(A)
    if factor is None:
        raise NumericalError("the measurements leave a node free, up to rounding")
    X = layout.unpack(factor.solve(forces) + fixed)
    blocks = np.swapaxes(X[:, 1:], 1, 2)
    blocks[problem.graph.is_point] = np.eye(d)
    return problem.with_optimal_translations(problem.estimate_of(Lift(blocks, X[:, 0])))


def separate_start(problem: Quadratic) -> Estimate:
    """Least squares of the logarithms of scales, then poses as of measurements in one unit.

    Raises
    ------
    NumericalError
        The weights are too uneven for a factorization.
    """
    graph, (i, _) = problem.graph, problem.graph.edges.T
    scales = log_scales(problem)
    steps = scales[i, None] * graph.translations
    flags = graph.is_point, graph.assumed, graph.absolute
    posed = Quadratic(
        PoseGraph(graph.rotations_alone, steps, graph.tau, None, *flags), problem.engine
    )
    rotations = start_of(posed).estimate.rotations
    return problem.complete(rotations, scales)


def log_scales(problem: Quadratic) -> FloatArray:
    """(n,) scales whose logarithms fit the measured ones best; 1 where they are known.

    Of nodes that no measured scale relates to known ones, one has the scale 1.
    """
    graph, n = problem.graph, problem.n
    i, j = graph.edges.T
    weights = graph.kappa
    known = np.flatnonzero(~graph.free)
    if problem.kinds.in_mean_unit:
        known = np.append(known, problem.root)
    part = components_of(n, graph.edges[graph.measures_rotation])
    _, firsts = np.unique(part, return_index=True)
    known = np.append(known, firsts[~np.isin(part[firsts], part[known])])
    measured = weights * np.log(graph.scales)
    forces = scatter_sum(j, measured, n) - scatter_sum(i, measured, n)
    forces[known] = 0.0
    L = laplacian(problem.pattern, weights)
    # Some known ones, such as points, have no measured scale and a diagonal of zero.
    L = add_to_diagonal(pinned(L, known), np.isin(np.arange(n), known).astype(float))
    factor = problem.symbolic(L).factor(L)
    if factor is None:
        raise NumericalError("the measured scales do not determine the scales of all poses")
    return np.asarray(np.exp(factor.solve(forces[:, None])[:, 0]))
