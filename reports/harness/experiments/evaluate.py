"""Evaluates estimates: metrics come from the problem and the certificate, never from a method."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import suppress
from typing import Literal

import numpy as np

from certpgo.certify import Certificate, Verdict
from certpgo.certify.bounds import (
    Bounds,
    alpha_max,
    bounds,
    fiedler_value,
    normalized_fiedler_value,
)
from certpgo.certify.tolerances import SETTLED
from certpgo.errors import NumericalError, SpecError
from certpgo.graph import Estimate
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import riemannian_newton as newton
from certpgo.optimize import spectral
from certpgo.optimize.solution import Solution
from certpgo.solve import metrics
from certpgo.solve.solving import solve
from reports.harness.experiments.metrics import METRICS, Needs, needing

#: Nodes of which the truth is known, and theirs.
Truth = tuple[IntArray, Estimate]

#: F within this part of the optimum, or this part of W, is the optimum.
SAME, SAME_SCALE = 1e-6, 1e-12


def of_graph(keys: Iterable[str], problem: Quadratic) -> dict[str, float]:
    """Metrics of the graph alone, those asked for, and residual-angle bounds.

    Eigenvalues are the smallest of the connection Laplacian, and Fiedler's, from which the bounds
    follow.
    """
    asked = needing(keys, Needs.GRAPH, Needs.RESIDUAL_BOUND)
    values: dict[str, float] = {}
    if any(key.startswith("lambda") for key in asked):
        smallest = spectral.smallest_eigenpairs(problem.rotation).values
        values = {f"lambda{k}": float(value) for k, value in enumerate(smallest, start=1)}
    if {"fiedler", "alpha_max_deg"} & set(asked):
        values["fiedler"] = fiedler_value(problem.rotation)
        connectivity = values["fiedler"] / float(problem.rotation.node_weights.max())
        values["alpha_max_deg"] = math.degrees(alpha_max(connectivity))
    if "normalized_alpha_max_deg" in asked:
        nu = normalized_fiedler_value(problem.rotation)
        values["normalized_alpha_max_deg"] = math.degrees(alpha_max(nu))
    return {key: values[key] for key in asked if key in values}


def optimum(problem: Quadratic) -> float | None:
    """F of the optimum to rounding; None where none is certified."""
    found = solve(problem)
    if found.verdict is not Verdict.CERTIFIED:
        return None
    return min(found.cost, newton.newton(problem, found.estimate, near=True).cost)


def certified_by(problem: Quadratic, certificate: Certificate) -> str:
    """Which bounds prove the estimate, or the stationary point near it, optimal.

    Residual-angle bounds are about stationary rotations alone, not about poses.
    """
    point, holding = certificate.refined, list[str]()
    if not problem.has_positions and (b := _residual_bounds(problem, point)) is not None:
        largest = float(problem.residual_angles(point).max())
        holding = [
            name
            for name, holds in (
                ("Theorem 4.1", largest <= b.alpha_max),
                ("normalized", largest <= b.normalized_alpha_max),
                ("rows", b.row_bound_holds),
                ("Theorem 4.2", b.cycle is not None and largest <= b.cycle),
                ("cycle sum", b.cycle_sum_holds),
            )
            if holds
        ]
    if certificate.verdict is Verdict.CERTIFIED or certificate.basin_is_global:
        holding.append("factorization")
    return ", ".join(holding) or "none"


def _residual_bounds(problem: Quadratic, point: Estimate) -> Bounds | None:
    """Residual-angle bounds of a stationary point; None elsewhere, or where eigenvalues fail."""
    if problem.stationarity(point) > SETTLED:
        return None
    with suppress(NumericalError, np.linalg.LinAlgError):
        return bounds(problem, point)
    return None


def of_estimate(
    keys: Iterable[str],
    problem: Quadratic | Sum,
    evaluated: Quadratic,
    solution: Solution,
    certificate: Certificate | None,
    certify_seconds: float = 0.0,
    best: float | None = None,
    truth: Truth | None = None,
    outliers: BoolArray | None = None,
    other: Estimate | None = None,
) -> dict[str, float]:
    """The metrics of an estimate: those of the keys, and those that cost nothing.

    Parameters
    ----------
    problem : the problem that estimates are judged by; F, bounds and gaps refer to it
    evaluated : the problem whose graph the thesis' metrics are evaluated on
    certificate : of the estimate, or None; of a robust method's, for the measurements it kept
    best : F of the optimum, or None
    truth : the nodes of which it is known, and theirs, or None
    outliers : (m,) True where a measurement is known to be wrong, or None
    other : another estimate, which this one is compared with, or None
    """
    keys, estimate = tuple(keys), solution.estimate
    if of_graph_alone := needing(keys, Needs.GRAPH):
        raise SpecError(f"{', '.join(of_graph_alone)}: of a graph, not of an estimate")
    cost = problem.cost(estimate)
    values = {"cost": cost}
    if {"max_residual_deg", "median_residual_deg", "within_2_deg_percent"} & set(keys):
        angles = np.degrees(problem.residual_angles(estimate))
        values["max_residual_deg"] = float(angles.max())
        values["median_residual_deg"] = float(np.median(angles))
        values["within_2_deg_percent"] = 100.0 * float(np.mean(angles <= 2.0))
    if other is not None and "apart_deg" in keys:
        values["apart_deg"] = metrics.angular_errors(estimate, other, norm="l1").median_deg
    if best is not None:
        values["error"] = cost - best
        if solution.relaxation is not None:
            values["relaxation_error"] = solution.relaxation.value - best
        reached = cost - best <= SAME * best + SAME_SCALE * problem.scale
        values["global_percent"] = 100.0 * reached
    if needing(keys, Needs.RESIDUAL_BOUND):
        values.update(of_graph(needing(METRICS, Needs.RESIDUAL_BOUND), evaluated))
    if truth is not None and needing(keys, Needs.TRUTH):
        values.update(_against_truth(estimate, truth))
    if solution.weights is not None:
        values.update(_kept(solution.weights, outliers))
    if solution.lower_bound is not None:
        values["own_bound"] = solution.lower_bound
    if "f_ml" in keys:
        values["f_ml"] = metrics.f_ml(evaluated.graph, estimate)
    if "mean_symmetry" in keys and evaluated.has_positions:
        values["mean_symmetry"] = metrics.mean_symmetry(evaluated.graph, estimate)
    if certificate is not None:
        values["lower_bound"] = certificate.lower_bound
        values["gap"] = certificate.gap
        values["relative_gap"] = certificate.relative_gap
        if certificate.lower_bound > 0.0 and "over_bound" in keys:
            values["over_bound"] = certificate.cost_upper / certificate.lower_bound
        values["certify_seconds"] = certify_seconds
    return {key: value for key, value in values.items() if math.isfinite(value)}


def _against_truth(estimate: Estimate, truth: Truth) -> dict[str, float]:
    nodes, true = truth
    known = estimate.subset(nodes)
    values = {
        "f_gt": metrics.f_gt(known, true),
        "f_gt_anchored": metrics.f_gt(known, true, anchored=True),
    }
    norms: tuple[tuple[str, Literal["l2", "l1"]], ...] = (("", "l2"), ("_l1", "l1"))
    for suffix, norm in norms:
        errors = metrics.angular_errors(known, true, norm=norm)
        values |= {
            f"mean{suffix}_deg": errors.mean_deg,
            f"median{suffix}_deg": errors.median_deg,
            f"rmse{suffix}_deg": errors.rmse_deg,
        }
    return values


def _kept(weights: FloatArray, outliers: BoolArray | None) -> dict[str, float]:
    """The share of measurements kept; of the rejected, and of the wrong, the share that is both."""
    rejected = weights <= 0.0
    values = {"kept_percent": 100.0 * float(np.mean(~rejected))}
    if outliers is not None:
        both = float((rejected & outliers).sum())
        values["precision"] = both / float(rejected.sum()) if rejected.any() else 1.0
        if outliers.any():
            values["recall"] = both / float(outliers.sum())
    return values
