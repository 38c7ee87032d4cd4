"""GTSAM's factor graphs of relative poses as problems under GTSAM's cost, and back.

GTSAM orders tangent vectors of Pose3 rotation first, of Pose2 translation first; information here
is translation first.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo.errors import InputError, MissingDependency, kind_of
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import InformationGraph
from certpgo.io.gtsam_values import estimate_from_values
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.costs.gtsam import GtsamCost
from certpgo.objective.information_problem import InformationProblem

_BETWEEN = {"BetweenFactorPose2": 2, "BetweenFactorPose3": 3}
_PRIORS = ("PriorFactorPose2", "PriorFactorPose3")


def from_gtsam(graph: Any, values: Any) -> tuple[InformationProblem, Estimate]:
    """The problem of a factor graph's relative poses under GTSAM's own cost, and the estimate.

    The cost is twice GTSAM's error. Node k is the k-th key of the values, ascending. One prior on a
    pose fixes the frame at no cost, and is left out; the estimate's cost does not include it.

    Parameters
    ----------
    graph : a NonlinearFactorGraph of BetweenFactorPose2 or BetweenFactorPose3 with Gaussian noise
    values : a pose for every key of the graph

    Raises
    ------
    InputError
        Another factor, several priors, a robust or constrained noise model, a key without a value,
        or a value that is no pose.

    Examples
    --------
    A triangle of steps one metre forward and a third of a turn, with a degree too much at the end:

    >>> import certpgo, gtsam, numpy as np
    >>> graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    >>> noise = gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    >>> for i, j, turn in ((0, 1, 120), (1, 2, 120), (2, 0, 121)):
    ...     step = gtsam.Pose2(1, 0, np.radians(turn))
    ...     graph.add(gtsam.BetweenFactorPose2(i, j, step, noise))
    >>> for k, (x, y) in enumerate([(0, 0), (1, 0), (0.5, 0.866)]):
    ...     values.insert(k, gtsam.Pose2(x, y, np.radians(120 * k)))
    >>> problem, estimate = certpgo.from_gtsam(graph, values)
    >>> bool(np.isclose(problem.cost(estimate), 2 * graph.error(values)))
    True
    >>> certpgo.solve(problem).verdict.value
    'CERTIFIED'
    """
    for given, name in ((graph, "NonlinearFactorGraph"), (values, "Values")):
        if type(given).__name__ != name:
            raise InputError(f"from_gtsam takes a factor graph and Values, not {kind_of(given)}")
    factors = [graph.at(k) for k in range(graph.size()) if graph.at(k) is not None]
    kinds = [type(factor).__name__ for factor in factors]
    other = sorted(set(kinds) - {*_BETWEEN, *_PRIORS})
    if other:
        raise InputError(f"only relative poses can be certified, not a {other[0]}")
    between = [f for f, kind in zip(factors, kinds, strict=True) if kind in _BETWEEN]
    if len(factors) - len(between) > 1:
        raise InputError(
            f"{len(factors) - len(between)} priors: with more than one, they are part of the cost"
        )
    dimensions = {_BETWEEN[kind] for kind in kinds if kind in _BETWEEN}
    if len(dimensions) != 1:
        raise InputError("a graph of BetweenFactorPose2 or of BetweenFactorPose3 is expected")
    [d] = dimensions
    keys = np.array(sorted(int(key) for key in values.keys()))  # noqa: SIM118 - not a mapping
    pairs = np.array([[int(key) for key in factor.keys()] for factor in between])  # noqa: SIM118
    edges = np.searchsorted(keys, pairs)
    missing = ~np.isin(pairs, keys)
    if missing.any():
        raise InputError(f"the values have no pose at key {pairs[missing][0]}")
    poses = np.array([_matrix(factor.measured()) for factor in between])
    information = np.array([_information(factor, d) for factor in between])
    estimate, _ = estimate_from_values(values, keys, d, True, exact=True)
    return _problem(len(keys), edges, poses, information), estimate


def _require_problem(problem: object) -> None:
    """Refuse anything but a problem of other costs by an InputError."""
    if not isinstance(problem, InformationProblem):
        raise InputError(f"to_gtsam takes an InformationProblem, not {kind_of(problem)}")


def to_gtsam(problem: InformationProblem, estimate: Estimate) -> tuple[Any, Any]:
    r"""The factor graph and values of a problem and an estimate, with keys 0 ... n-1.

    ``graph.error(values)`` is half the cost under ``"gtsam"``; no prior is added.

    Raises
    ------
    MissingDependency
        GTSAM is not installed.

    Examples
    --------
    >>> from pathlib import Path
    >>> import certpgo
    >>> from certpgo.objective.choose_cost import information_problem
    >>> line = "EDGE_SE2 {} {} 1 0 1.57 100 3 0 200 1 50"
    >>> edges = ((0, 1), (1, 2), (2, 3), (3, 0))
    >>> _ = Path("square.g2o").write_text("\n".join(line.format(*edge) for edge in edges))
    >>> problem = information_problem(certpgo.read("square.g2o"), "gtsam")
    >>> best = certpgo.solve(problem)
    >>> graph, values = certpgo.to_gtsam(problem, best.estimate)
    >>> abs(2 * graph.error(values) - best.cost) < 1e-9
    True
    """
    _require_problem(problem)
    graph, gtsam = factors_of(problem), _library()
    t, values = estimate.translations, gtsam.Values()
    for k, M in enumerate(
        _matrices(estimate.rotations, np.zeros((problem.n, problem.d)) if t is None else t)
    ):
        values.insert(k, _pose(gtsam, M))
    return graph, values


def factors_of(problem: InformationProblem) -> Any:
    """The factor graph of `to_gtsam`."""
    gtsam, measured, d = _library(), problem.graph, problem.d
    order = _tangent_order(d)
    factor = getattr(gtsam, f"BetweenFactorPose{d}")
    graph = gtsam.NonlinearFactorGraph()
    matrices = _matrices(measured.rotations, measured.translations)
    for (i, j), M, full in zip(
        measured.edges.tolist(), matrices, measured.information, strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Information(full[np.ix_(order, order)])
        graph.add(factor(i, j, _pose(gtsam, M), noise))
    return graph


def _library() -> Any:
    try:
        import gtsam
    except ImportError:
        raise MissingDependency("gtsam", "baselines") from None
    return gtsam


def _problem(
    n: int, edges: IntArray, poses: FloatArray, information: FloatArray
) -> InformationProblem:
    d = poses.shape[-1] - 1
    # As for files: harmonic means over the axes of either block.
    inverse_R, inverse_t = (
        np.trace(np.linalg.inv(information[:, block, block]), axis1=1, axis2=2)
        for block in (slice(d, None), slice(0, d))
    )
    kappa = (1.0 if d == 2 else 1.5) / inverse_R
    rotation = RotationGraph(n, edges, poses[:, :d, :d], kappa)
    graph = PoseGraph(rotation, poses[:, :d, d], d / inverse_t)
    return InformationProblem(GtsamCost(InformationGraph(graph, information)))


def _information(factor: Any, d: int) -> FloatArray:
    """The information of a factor's noise, translation first."""
    noise = factor.noiseModel()
    i, j = factor.keys()
    if not hasattr(noise, "information") or noise.isConstrained():
        kind = type(noise).__name__
        raise InputError(
            f"the factor between {i} and {j} has {kind} noise: only Gaussian noise has a cost "
            "that can be certified"
        )
    order = _tangent_order(d)
    full = np.asarray(noise.information(), dtype=np.float64)[np.ix_(order, order)]
    return np.asarray(0.5 * (full + full.T))


def _tangent_order(d: int) -> list[int]:
    """The permutation between GTSAM's order of tangent vectors and translation first."""
    return [0, 1, 2] if d == 2 else [3, 4, 5, 0, 1, 2]


def _pose(gtsam: Any, M: FloatArray) -> Any:
    if M.shape[0] == 4:
        return gtsam.Pose3(M)
    return gtsam.Pose2(M[0, 2], M[1, 2], float(np.arctan2(M[1, 0], M[0, 0])))


def _matrix(pose: Any) -> FloatArray:
    return np.asarray(pose.matrix(), dtype=np.float64)


def _matrices(R: FloatArray, t: FloatArray) -> FloatArray:
    n, d = t.shape
    out = np.zeros((n, d + 1, d + 1))
    out[:, :d, :d], out[:, :d, d], out[:, d, d] = R, t, 1.0
    return out
