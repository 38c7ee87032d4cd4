"""GTSAM's factors of similarities as problems of F, and back.

GTSAM's Similarity3 (R, t, s) maps x to s (R x + t): our translation is s t. Its tangent vectors are
(rotation, translation, scale), those of Similarity2 (translation, angle, scale). Its error is the
logarithm, in the unit of the second node: its information gives the weights kappa and, in the unit
of the first, tau. Other entries are not used.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, RotationGraph, SimilarityGraph
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic

#: The factors that are read, with their dimension, and priors, one of which only fixes the frame.
BETWEEN = {"BetweenFactorSimilarity2": 2, "BetweenFactorSimilarity3": 3}
PRIORS = ("PriorFactorSimilarity2", "PriorFactorSimilarity3")


def problem_of_factors(
    factors: list[Any], values: Any, keys: IntArray, edges: IntArray, d: int
) -> tuple[Quadratic, Estimate]:
    """The problem of F with all scales unknown, and the estimate.

    Raises
    ------
    InputError
        A value that is no similarity, or noise that is not Gaussian.
    """
    rotations, positions, scales = _arrays([_value(values, int(key), d) for key in keys], d)
    R, t, s = _arrays([factor.measured() for factor in factors], d)
    inverse = np.array([np.linalg.inv(_information(factor)) for factor in factors])
    diagonal = np.einsum("maa->ma", inverse)
    turned, moved = (slice(2, 3), slice(0, 2)) if d == 2 else (slice(0, 3), slice(3, 6))
    kappa = (0.5 if d == 2 else 1.5) / diagonal[:, turned].sum(axis=1)
    rotation = RotationGraph(len(keys), edges, R, kappa)
    tau = d / diagonal[:, moved].sum(axis=1) / s**2
    graph = SimilarityGraph(rotation, t, tau, scales=s)
    return Quadratic(graph), Estimate(rotations, positions, scales=scales)


def factors_and_values(gtsam: Any, problem: Quadratic, estimate: Estimate) -> Any:
    """GTSAM's graph and values of a problem and an estimate, keys 0 ... n-1.

    Raises
    ------
    InputError
        There are points, or poses of known scale, which GTSAM's similarities are not.
    """
    graph, d = problem.graph, problem.d
    if not graph.free.all() or graph.is_partial:
        raise InputError("GTSAM's similarities all have an unknown scale, and see no points")
    factor = getattr(gtsam, f"BetweenFactorSimilarity{d}")
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    steps = graph.translations / graph.scales[:, None]
    measured = zip(
        graph.edges.tolist(),
        graph.rotations,
        steps,
        graph.scales.tolist(),
        graph.kappa.tolist(),
        (graph.tau * graph.scales**2).tolist(),
        strict=True,
    )
    for (i, j), R, t, s, kappa, moved in measured:
        # |A_j - A_i S|^2 is 2 |turn|^2 + d scale^2 for small logarithms.
        of = [moved, moved, 2.0 * kappa, 2.0 * kappa]
        if d == 3:
            of = [2.0 * kappa] * 3 + [moved] * 3 + [3.0 * kappa]
        noise = gtsam.noiseModel.Diagonal.Precisions(np.array(of))
        factors.add(factor(i, j, _similarity(gtsam, R, t, s), noise))
    t, s = estimate.translations, problem.scales.of(estimate)
    for k, R in enumerate(estimate.rotations):
        there = np.zeros(d) if t is None else t[k] / s[k]
        values.insert(k, _similarity(gtsam, R, there, float(s[k])))
    return factors, values


def _similarity(gtsam: Any, R: FloatArray, t: FloatArray, s: float) -> Any:
    if len(R) == 3:
        return gtsam.Similarity3(gtsam.Rot3(R), gtsam.Point3(*t), s)
    turn = gtsam.Rot2.fromAngle(float(np.arctan2(R[1, 0], R[0, 0])))
    return gtsam.Similarity2(turn, gtsam.Point2(*t), s)


def _value(values: Any, key: int, d: int) -> Any:
    try:
        return getattr(values, f"atSimilarity{d}")(key)
    except Exception:  # the binding's error for a value of another type
        raise InputError(f"the values have no Similarity{d} at key {key}") from None


def _arrays(found: list[Any], d: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotations, translations in the unit of the target, and scales."""
    R = np.array([x.rotation().matrix() for x in found]).reshape(-1, d, d)
    s = np.array([x.scale() for x in found])
    t = np.array([np.asarray(x.translation()) for x in found]).reshape(-1, d)
    return R, s[:, None] * t, s


def _information(factor: Any) -> FloatArray:
    noise = factor.noiseModel()
    if not hasattr(noise, "information") or noise.isConstrained():
        kind = type(noise).__name__
        raise InputError(f"a factor of similarities has {kind} noise: only Gaussian noise is known")
    return np.asarray(noise.information(), dtype=np.float64)
