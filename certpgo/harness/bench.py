"""Times of methods against a reference, under the timing protocol."""

from __future__ import annotations

from certpgo.graph import Graph
from certpgo.harness.methods import build
from certpgo.harness.spec import Method
from certpgo.harness.timing import Step, one_core, paired
from certpgo.problem import problem_of


def against(reference: Method, method: Method, graph: Graph) -> tuple[dict[str, float], str]:
    """The timing metrics of a method, and how far the protocol could be kept.

    The graph is in memory; a baseline's own graph object is built beforehand, and of our methods
    everything counts, the assembly and analysis of matrices included.
    """
    with one_core() as kept:
        times = paired(_step(method, graph), _step(reference, graph))
    metrics = {
        "ratio": times.ratio,
        "median_seconds": times.first,
        "reference_seconds": times.second,
    }
    return metrics, kept


def _step(method: Method, graph: Graph) -> Step:
    solver = build(method.solver, method.settings)
    prepared = getattr(solver, "prepared", None)
    if prepared is not None:
        step: Step = prepared(problem_of(graph))
        return step
    # A new problem each time: nothing remembered from the round before.
    return lambda: solver.solve(problem_of(graph))
