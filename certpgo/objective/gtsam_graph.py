"""GTSAM's factor graphs as problems under GTSAM's cost, and back.

GTSAM orders tangent vectors of Pose3 rotation first, of Pose2 translation first; information here
is translation first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, cast, overload

import numpy as np

from certpgo.errors import InputError, MissingDependency, kind_of, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.phrases import counted, listed
from certpgo.io.gtsam_factors import instance_of_factors
from certpgo.io.gtsam_values import FACTOR_GRAPH
from certpgo.linalg.arrays import FloatArray
from certpgo.objective import gtsam_similarities
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.kernels import AppliedKernel, Kernel
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.robust import RobustSum
from certpgo.objective.sum import Sum
from certpgo.objective.truncated_cost import TruncatedCost

#: The robust noise whose cost is truncated least squares.
TRUNCATED = "TruncatedLeastSquares"
#: What robust noise becomes.
Robust = Literal["kernel", "weights"]
#: Kernels by their names in GTSAM, and their scales from the weight at a residual of 1, or of FAR.
FAR = 2.0**40
_KERNELS: dict[str, tuple[str, Callable[[Any], float]]] = {
    "Huber": ("huber", lambda kernel: FAR * kernel.weight(FAR)),
    "Cauchy": ("cauchy", lambda kernel: _scale_of(kernel.weight(1.0))),
    "GemanMcClure": ("geman-mcclure", lambda kernel: _scale_of(math.sqrt(kernel.weight(1.0)))),
}


@overload
def from_gtsam(graph: Any) -> Instance: ...
@overload
def from_gtsam(
    graph: Any, values: Any, *, robust: Robust = "kernel"
) -> tuple[Sum | TruncatedCost | Quadratic, Estimate]: ...
def from_gtsam(
    graph: Any, values: Any = None, *, robust: Robust = "kernel"
) -> Instance | tuple[Sum | TruncatedCost | Quadratic, Estimate]:
    """A factor graph as an instance; with values, its problem under GTSAM's cost and the estimate.

    The cost is twice GTSAM's error of the types in ``certpgo.io.gtsam_factors``: relative poses,
    priors on poses, rotations, translations and points, GPS, and distances. Nodes are the keys of
    factors, ascending, and then the world, where something is measured in it. One prior on a pose,
    if nothing else is, fixes the frame at no cost and is left out; the estimate's cost does not
    include it. Priors with constrained noise hold poses where they are; of several, all but the one
    of the lowest key may only be the first pose of relative poses.

    Of ImuFactor and CombinedImuFactor, with fixed biases, the rotation alone has GTSAM's cost: that
    of the steps is quadratic, with the same variance of all coordinates and without what correlates
    them with the rotation, see ``certpgo.io.gtsam_inertial``.

    Robust noise of Huber, Cauchy, or Geman and McClure is a kernel of the problem, with a scale for
    each factor, if that is the only one in the graph, and is of factors between two nodes.
    Otherwise, or with ``robust="weights"``, a factor gets the weight that it has at the values: at
    an optimum of GTSAM's, that cost is stationary too, but it is another one, as its title says; it
    is easier to certify. With truncated least squares, factors that are cut off at the values cost
    at most what GTSAM says, and the others are kept: the problem is then a `TruncatedCost`.

    Factors of similarities, whose cost of logarithms has no quadratic form below it, become a
    problem of F with the weights of their noise: a `Quadratic`, with all scales unknown.

    Parameters
    ----------
    graph : a NonlinearFactorGraph with Gaussian noise, or robust noise if there are values; or one
        of BetweenFactorSimilarity2 or BetweenFactorSimilarity3
    values : a value for every key of the graph
    robust : what robust noise becomes

    Raises
    ------
    InputError
        Factors of other types, named with their counts; noise that is constrained but holds no
        pose; a key without a value, or whose value is of another type; robust noise, or several
        held poses, without values.
    GraphError
        Without factors of weight zero, the others leave poses free.

    Examples
    --------
    A triangle of steps one metre forward and a third of a turn, with a degree too much at the end:

    >>> import certpgo, gtsam, numpy as np
    >>> graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    >>> noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    >>> for i, j, turn in ((0, 1, 120), (1, 2, 120), (2, 0, 121)):
    ...     step = gtsam.Pose2(1, 0, np.radians(turn))
    ...     graph.add(gtsam.BetweenFactorPose2(i, j, step, noise))
    >>> certpgo.solve(certpgo.from_gtsam(graph)).verdict.value
    'CERTIFIED'
    >>> for k, (x, y) in enumerate([(0, 0), (1, 0), (0.5, 0.866)]):
    ...     values.insert(k, gtsam.Pose2(x, y, np.radians(120 * k)))
    >>> problem, estimate = certpgo.from_gtsam(graph, values)
    >>> bool(np.isclose(problem.cost(estimate), 2 * graph.error(values)))
    True
    >>> certpgo.solve(problem).verdict.value
    'CERTIFIED'
    """
    if robust not in ("kernel", "weights"):
        raise InputError(f"robust is 'kernel' or 'weights', not {robust!r}")
    if values is not None:
        problem, estimate, _ = judged_factors(graph, values, robust=robust)
        return problem, estimate
    _require_factors(graph)
    if _of_similarities(graph):
        raise InputError("from_gtsam takes factors of similarities with values")
    instance, kernels = instance_of_factors(graph)
    if kernels:
        named = listed(sorted({type(kernel).__name__ for kernel in kernels.values()}))
        many = counted(len(kernels), "factor{s}")
        said = f"{many} with robust noise ({named}), whose weights are those at an estimate"
        raise InputError(f"{said}: from_gtsam(graph, values)")
    return instance


def judged_factors(
    graph: Any, values: Any, cost: str = GtsamCost.name, *, robust: Robust = "weights"
) -> tuple[Sum | TruncatedCost | Quadratic, Estimate, Instance | None]:
    """The problem of a factor graph under a cost, the values, and its instance.

    There is none of similarities, whose problem is one of F.
    """
    _require_factors(graph, values)
    if _of_similarities(graph):
        return *_problem_of_similarities(graph, values), None
    instance, kernels = instance_of_factors(graph, values)
    problem, estimate = objective_of(instance, cost), cast("Estimate", instance.initial)
    if not kernels:
        return problem, estimate, instance
    numbers, costs = instance.known_numbers.tolist(), problem.edge_costs(estimate)
    plain = cast("Sum", problem)
    kernel = _kernel(kernels, numbers[: plain.measured.num_edges]) if robust == "kernel" else None
    if kernel is not None:
        applied = AppliedKernel(kernel, kernel.squares(plain.measured))
        if (applied.idle == np.isinf(kernel.scale)).all():  # no measurement from a world has it
            return RobustSum.of(plain, applied), estimate, instance
    return _as_robust(plain, kernels, numbers, costs), estimate, instance


def _require_factors(graph: Any, *values: Any) -> None:
    for given, name in ((graph, FACTOR_GRAPH), *((one, "Values") for one in values)):
        if type(given).__name__ != name:
            raise InputError(f"from_gtsam takes a factor graph and Values, not {kind_of(given)}")


def _of_similarities(graph: Any) -> bool:
    """Whether some factors are of relative similarities."""
    kinds = {type(graph.at(k)).__name__ for k in range(graph.size())}
    return not kinds.isdisjoint(gtsam_similarities.BETWEEN)


def _problem_of_similarities(graph: Any, values: Any) -> tuple[Quadratic, Estimate]:
    """The problem of factors of similarities, all of one dimension, with at most one prior."""
    factors = [factor for k in range(graph.size()) if (factor := graph.at(k)) is not None]
    kinds = [type(factor).__name__ for factor in factors]
    known = gtsam_similarities.BETWEEN
    other = sorted(set(kinds) - {*known, *gtsam_similarities.PRIORS})
    if other or len({known[kind] for kind in kinds if kind in known}) > 1:
        said = other[0] if other else "factor of another dimension"
        raise InputError(f"beside relative similarities, a {said} cannot be certified")
    between = [f for f, kind in zip(factors, kinds, strict=True) if kind in known]
    if len(factors) - len(between) > 1:
        raise InputError(f"{len(factors) - len(between)} priors: one fixes the frame, more do not")
    keys = np.array(sorted(int(key) for key in values.keys()))  # noqa: SIM118 - not a mapping
    pairs = np.array([[int(key) for key in factor.keys()] for factor in between])  # noqa: SIM118
    missing = ~np.isin(pairs, keys)
    if missing.any():
        raise InputError(f"the values have no similarity at key {pairs[missing][0]}")
    edges, d = np.searchsorted(keys, pairs), known[type(between[0]).__name__]
    return gtsam_similarities.problem_of_factors(between, values, keys, edges, d)


def _kernel(kernels: Mapping[int, Any], numbers: Sequence[int]) -> Kernel | None:
    """The kernel of all robust factors, with infinite scales of others.

    None if they have several, or if some are no edges between nodes.

    Parameters
    ----------
    kernels : by number
    numbers : of the edges
    """
    names = {type(kernel).__name__ for kernel in kernels.values()}
    if len(names) != 1 or not names <= _KERNELS.keys() or not kernels.keys() <= {*numbers}:
        return None
    name, scale_of = _KERNELS[names.pop()]
    scales = [scale_of(kernels[k]) if k in kernels else np.inf for k in numbers]
    return Kernel(name, np.array(scales))


def _scale_of(share: float) -> float:
    """The scale k whose k^2 / (k^2 + 1) is this."""
    return math.sqrt(share / (1.0 - share))


def _as_robust(
    problem: Sum, kernels: Mapping[int, Any], numbers: Sequence[int], costs: FloatArray
) -> Sum | TruncatedCost:
    """The problem with the weights of robust noise for these costs, or with truncated ones.

    Parameters
    ----------
    kernels : by number
    numbers : of the problem's rows
    """
    weights, prices, names = np.ones(len(costs)), np.full(len(costs), np.inf), set[str]()
    for k in (k for k, number in enumerate(numbers) if number in kernels):
        kernel, distance = kernels[numbers[k]], float(np.sqrt(costs[k]))
        if type(kernel).__name__ != TRUNCATED:
            weights[k] = kernel.weight(distance)
            names.add(type(kernel).__name__)
        elif kernel.weight(distance) == 0.0:
            prices[k] = 2.0 * kernel.loss(distance)
    if names:
        named = " and ".join(sorted(names))
        said = f"with the weights of {named} at the given values"
        problem = replace(problem.reweighted(weights), remark=said)
        prices = prices[weights > 0.0]
    return TruncatedCost(problem, prices) if np.isfinite(prices).any() else problem


def _require_problem(problem: object) -> None:
    """Refuse anything but a problem of other costs by an InputError."""
    if not isinstance(problem, Sum):
        raise InputError(f"to_gtsam takes a Sum, not {kind_of(problem)}")


def to_gtsam(problem: Sum | Quadratic | Graph, estimate: Estimate) -> tuple[Any, Any]:
    r"""The factor graph and values of a problem and an estimate, with keys 0 ... n-1.

    ``graph.error(values)`` is half the cost under ``"gtsam"``; no prior is added. Of similarities,
    whose graph may be given in place of the problem, it is half the cost of logarithms, see
    `certpgo.fit_logarithms`.

    Raises
    ------
    InputError
        It is neither, or has a robust kernel; or similarities have points or known scales.
    MissingDependency
        GTSAM is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> import certpgo
    >>> from certpgo.objective.choose_cost import objective_of
    >>> line = "EDGE_SE2 {} {} 1 0 1.57 100 3 0 200 1 50"
    >>> edges = ((0, 1), (1, 2), (2, 3), (3, 0))
    >>> _ = Path("square.g2o").write_text("\n".join(line.format(*edge) for edge in edges))
    >>> problem = objective_of(certpgo.read("square.g2o"), "gtsam")
    >>> best = certpgo.solve(problem)
    >>> graph, values = certpgo.to_gtsam(problem, best.estimate)
    >>> abs(2 * graph.error(values) - best.cost) < 1e-9
    True
    """
    if isinstance(problem, Graph) and problem.has_scales:
        problem = Quadratic(problem)
    require(estimate, Estimate, "an Estimate")
    if isinstance(problem, Quadratic) and problem.takes_scales:
        similar: tuple[Any, Any] = gtsam_similarities.factors_and_values(
            _library(), problem, estimate
        )
        return similar
    _require_problem(problem)
    problem = cast("Sum", problem)
    problem.check(estimate)
    graph, gtsam = factors_of(problem), _library()
    t, values = estimate.translations, gtsam.Values()
    for k, M in enumerate(
        _matrices(estimate.rotations, np.zeros((problem.n, problem.d)) if t is None else t)
    ):
        values.insert(k, _pose(gtsam, M))
    return graph, values


def factors_of(problem: Sum) -> Any:
    """The factor graph of `to_gtsam`."""
    if problem.kernel is not None:
        raise InputError(f"to_gtsam takes costs without a kernel, not {problem.title}")
    for block in problem.measured.blocks:
        raise InputError(f"to_gtsam takes relative poses, not {block.kind.plural}")
    gtsam, measured, d = _library(), problem.graph, problem.d
    order = _tangent_order(d)
    factor = getattr(gtsam, f"BetweenFactorPose{d}")
    graph = gtsam.NonlinearFactorGraph()
    matrices = _matrices(measured.rotations, measured.translations)
    stated = measured.information_matrices
    for (i, j), M, full in zip(measured.edges.tolist(), matrices, stated, strict=True):
        noise = gtsam.noiseModel.Gaussian.Information(full[np.ix_(order, order)])
        graph.add(factor(i, j, _pose(gtsam, M), noise))
    return graph


def _library() -> Any:
    try:
        import gtsam
    except ImportError:
        raise MissingDependency("gtsam", "baselines") from None
    return gtsam


def _tangent_order(d: int) -> list[int]:
    """The permutation between GTSAM's order of tangent vectors and translation first."""
    return [0, 1, 2] if d == 2 else [3, 4, 5, 0, 1, 2]


def _pose(gtsam: Any, M: FloatArray) -> Any:
    if M.shape[0] == 4:
        return gtsam.Pose3(M)
    return gtsam.Pose2(M[0, 2], M[1, 2], float(np.arctan2(M[1, 0], M[0, 0])))


def _matrices(R: FloatArray, t: FloatArray) -> FloatArray:
    n, d = t.shape
    out = np.zeros((n, d + 1, d + 1))
    out[:, :d, :d], out[:, :d, d], out[:, d, d] = R, t, 1.0
    return out
