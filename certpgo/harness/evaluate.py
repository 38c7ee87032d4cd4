"""The judge of tables: metrics come from the problem and the certificate, never from a method."""

from __future__ import annotations

import math
from collections.abc import Iterable

from certpgo import metrics, spectral
from certpgo.certify import Certificate
from certpgo.certify.bounds import fiedler_value
from certpgo.errors import SpecError
from certpgo.estimate import Estimate
from certpgo.harness.spec import GRAPH_METRICS
from certpgo.problem import PoseProblem, Problem


def of_graph(keys: Iterable[str], problem: Problem) -> dict[str, float]:
    """Eigenvalues of the problem: the smallest of the connection Laplacian, and Fiedler's."""
    wanted = [key for key in keys if key in GRAPH_METRICS]
    values: dict[str, float] = {}
    if any(key.startswith("lambda") for key in wanted):
        smallest = spectral.smallest_eigenpairs(problem.rotation).values
        values = {f"lambda{k}": float(value) for k, value in enumerate(smallest, start=1)}
    if "fiedler" in wanted:
        values["fiedler"] = fiedler_value(problem.rotation)
    return {key: values[key] for key in wanted if key in values}


def of_estimate(
    keys: Iterable[str],
    problem: Problem,
    judge: Problem,
    estimate: Estimate,
    certificate: Certificate | None,
    certify_seconds: float = 0.0,
) -> dict[str, float]:
    """The metrics asked for.

    Parameters
    ----------
    problem : the problem that was solved; F, bounds and gaps refer to it
    judge : the problem whose graph the thesis' metrics are evaluated on
    certificate : of the estimate for ``problem``, or None
    """
    values = {"cost": problem.cost(estimate)}
    for key in keys:
        if key == "f_ml":
            values[key] = metrics.f_ml(judge.graph, estimate)
        elif key == "mean_symmetry" and isinstance(judge, PoseProblem):
            values[key] = metrics.mean_symmetry(judge.graph, estimate)
        elif key in GRAPH_METRICS:
            raise SpecError(f"{key} belongs to a graph, not to an estimate")
    if certificate is not None:
        values["lower_bound"] = certificate.lower_bound
        values["gap"] = certificate.gap
        values["relative_gap"] = certificate.relative_gap
        values["certify_seconds"] = certify_seconds
    return {key: value for key, value in values.items() if math.isfinite(value)}
