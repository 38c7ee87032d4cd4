"""Times of methods against a reference, under the timing protocol."""

from __future__ import annotations

import numpy as np

from certpgo.graph import Graph, PoseGraph
from certpgo.linalg.blocks import add_to_diagonal, pinned
from certpgo.objective.problem import problem_of
from certpgo.registry import build
from certpgo.solve.solving import solve
from reports.harness.experiments.spec import FACTORIZATION, Method
from reports.harness.experiments.timing import Step, one_core, paired

#: Shift, over the mean diagonal, that makes the certificate matrix of the optimum definite.
SHIFT = 1e-6


def against(
    reference: Method, method: Method, graph: Graph, complete: Graph
) -> tuple[dict[str, float], str]:
    """The timing metrics of a method, and how far the protocol could be kept.

    The graph is in memory; a baseline's own graph object is built beforehand, and of our methods
    everything counts, the assembly and analysis of matrices included.

    Parameters
    ----------
    complete : the graph that the reference runs on: the method's, or the pose graph whose rotations
        alone the method gets
    """
    with one_core() as kept:
        engine = method.engine or None
        times = paired(_step(method, graph, engine), _step(reference, complete, engine))
    metrics = {
        "ratio": times.ratio,
        "median_seconds": times.first,
        "reference_seconds": times.second,
    }
    return metrics, kept


def _step(method: Method, graph: Graph, engine: str | None) -> Step:
    if method.solver == FACTORIZATION:
        return factorization(graph, engine)
    own = _own_step(method, graph, engine)
    if method.start is None:
        return own
    before = _step(method.start, graph, engine)
    return lambda: (before(), own())


def _own_step(method: Method, graph: Graph, engine: str | None) -> Step:
    solver = build(method.solver, method.settings)
    prepared = getattr(solver, "prepared", None)
    if prepared is not None:
        step: Step = prepared(problem_of(graph, engine))
        return step
    # A new problem each time: nothing remembered from the round before.
    return lambda: solver.solve(problem_of(graph, engine))


def factorization(graph: Graph, engine: str | None = None) -> Step:
    """One numeric factorization of the optimum's certificate matrix: the machine's own unit."""
    problem = problem_of(graph, engine)
    S = problem.certificate_matrix(problem.multipliers(solve(graph).estimate))
    if isinstance(graph, PoseGraph):
        S = pinned(S, np.array([0]))
    S = add_to_diagonal(S, SHIFT * float(S.diagonal().mean()))
    symbolic = problem.symbolic(S)
    return lambda: symbolic.factor(S)
