"""Times of methods against a reference, under the timing protocol."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.linalg.blocks import add_to_diagonal, pinned
from certpgo.linalg.factor import default_engine
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.sum import Sum
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
        engine = method.engine or default_engine()
        ours = _step(method, lambda: Quadratic(graph, engine))
        times = paired(ours, _step(reference, lambda: Quadratic(complete, engine)))
    metrics = {
        "ratio": times.ratio,
        "median_seconds": times.first,
        "reference_seconds": times.second,
    }
    return metrics, kept


def _step(method: Method, posed: Callable[[], Quadratic]) -> Step:
    if method.solver == FACTORIZATION:
        return _factorization(posed())
    return step_of(method, posed)


def step_of(method: Method, posed: Callable[[], Quadratic | Sum]) -> Step:
    """The method on a problem, after the method that it starts from on the chordal problem."""
    own = _own_step(method, posed)
    if method.start is None:
        return own
    before = step_of(method.start, lambda: chordal(posed()))
    return lambda: (before(), own())[-1]


def chordal(problem: Quadratic | Sum) -> Quadratic:
    """The problem under F."""
    return problem.chordal if isinstance(problem, Sum) else problem


def _own_step(method: Method, posed: Callable[[], Quadratic | Sum]) -> Step:
    solver: Any = build(method.solver, method.settings)
    prepared = getattr(solver, "prepared", None)
    if prepared is not None:
        step: Step = prepared(posed())
        return step
    # A new problem each time: nothing remembered from the round before.
    return lambda: solver.solve(posed())


def factorization(graph: Graph, engine: str | None = None) -> Step:
    """One numeric factorization of the optimum's certificate matrix: the machine's own unit."""
    return _factorization(Quadratic(graph, engine or default_engine()))


def _factorization(problem: Quadratic) -> Step:
    S = problem.certificate_matrix(problem.multipliers(solve(problem).estimate))
    if problem.has_positions:
        S = pinned(S, np.array([0]))
    S = add_to_diagonal(S, SHIFT * float(S.diagonal().mean()))
    symbolic = problem.symbolic(S)
    return lambda: symbolic.factor(S)
