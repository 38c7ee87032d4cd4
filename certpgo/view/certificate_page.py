"""The page of one certificate: what is proven, its assumptions, and the residuals."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from certpgo.assess.assessment import Assessment, CostlyEdge
from certpgo.assess.ladder import rungs_of_eigenvalues
from certpgo.assess.wording import digits, distances, meaning, numbers, objective, trusts
from certpgo.certify.certificate import Certificate
from certpgo.certify.curvature import smallest_eigenvalues
from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Instance
from certpgo.io.plural import counted
from certpgo.objective.problem import PoseProblem, Problem
from certpgo.optimize.monitor import Iteration
from certpgo.view.page import page
from certpgo.view.plots import Bars, Curve, Lines, bars, lines
from certpgo.view.scene import scene

#: Eigenvalues shown beyond the d of the gauge.
EIGENVALUES = 5


@dataclass(frozen=True)
class Origin:
    """Where an estimate came from, and how to certify it again.

    Attributes
    ----------
    graph, estimate : names as given; empty for a computed estimate that was not written
    reading : command-line options with which the graph was read
    proof : the proof file, if one was written
    method : the method that found the estimate, or empty
    remarks : sentences shown below the verdict
    partial : whether the verdict is only about the measurements that the method kept
    settings : settings of the search that found the estimate, one text each
    environment : versions, machine and engine
    """

    graph: str
    estimate: str = ""
    reading: tuple[str, ...] = ()
    proof: str = ""
    method: str = ""
    remarks: tuple[str, ...] = ()
    partial: bool = False
    settings: tuple[str, ...] = ()
    environment: Mapping[str, str] | None = None


@np.errstate(over="ignore", invalid="ignore")  # infinite costs are shown without warnings
def certificate_page(
    instance: Instance,
    problem: Problem,
    estimate: Estimate,
    assessment: Assessment,
    origin: Origin,
    trace: Sequence[Iteration] = (),
) -> str:
    """The page as one HTML file; the same bytes for the same arguments.

    Parameters
    ----------
    instance, problem : the connected graph, and the problem that the certificate is about
    assessment : assessment of the estimate, with its certificate
    trace : iterations of the method that found it, if it kept them
    """
    certificate = assessment.certificate
    rungs = rungs_of_eigenvalues(problem, estimate, certificate)
    spectrum, spectrum_note = _spectrum(problem, certificate)
    recheck_note, recheck = _recheck(origin, certificate)
    return page(
        "certificate.html",
        verdict=certificate.verdict.value,
        graph=instance.name,
        meaning=meaning(certificate),
        reason=certificate.reason[:1].upper() + certificate.reason[1:],
        remarks=origin.remarks,
        numbers=[*_head(instance, origin), *_facts(instance, assessment)],
        scene=scene(problem, estimate, instance.ids),
        edge_header=_EDGE_HEADER[: None if isinstance(problem, PoseProblem) else -1],
        edges=[_edge(edge) for edge in assessment.edges],
        bounds=[(rung.title, rung.shown, rung.says, rung.needs) for rung in rungs],
        spectrum=spectrum,
        spectrum_note=spectrum_note,
        charts=_charts(trace, certificate),
        no_charts=_no_trace(origin),
        recheck_note=recheck_note,
        recheck=recheck,
        settings=origin.settings,
        environment=dict(origin.environment or {}),
    )


_EDGE_HEADER = ("edge", "nodes", "term of F", "share of F", "residual, degrees", "residual, m")


def _head(instance: Instance, origin: Origin) -> Iterable[tuple[str, str]]:
    graph = instance.graph
    nodes, edges = counted(graph.num_nodes, "node{s}"), counted(graph.num_edges, "edge{s}")
    yield "graph", f"{origin.graph} ({nodes}, {edges}, {graph.d}D)"
    if origin.estimate:
        yield "estimate", origin.estimate
    if origin.method:
        yield "method", origin.method


def _facts(instance: Instance, assessment: Assessment) -> Iterable[tuple[str, str]]:
    certificate = assessment.certificate
    yield from numbers(certificate)
    yield from distances(assessment)
    yield from digits(assessment)
    yield from trusts(certificate)
    yield "objective", f"{objective(instance.options)} (other tools minimise other errors)"


def _edge(edge: CostlyEdge) -> tuple[str, ...]:
    cells = (
        str(edge.edge),
        f"{edge.ids[0]} to {edge.ids[1]}",
        f"{edge.cost:.6g}",
        f"{100.0 * edge.share:.3g} %",
        f"{math.degrees(edge.angle):.4g}",
    )
    return cells if edge.metres is None else (*cells, f"{edge.metres:.4g}")


def _spectrum(problem: Problem, certificate: Certificate) -> tuple[Bars | None, str]:
    """A chart with its explanation, or the reason why there is none."""
    if certificate.multipliers is None:
        return None, "There is no certificate matrix: no lower bound was found."
    d = problem.d
    try:
        values = smallest_eigenvalues(problem, certificate.multipliers, d + EIGENVALUES)
    except (NumericalError, np.linalg.LinAlgError) as error:
        return None, f"The eigenvalues could not be computed: {error}."
    gauge = set(np.argsort(np.abs(values), kind="stable")[:d].tolist())
    names = [f"{k + 1}" + (" (gauge)" if k in gauge else "") for k in range(len(values))]
    note = (
        "Translations are eliminated. If none is negative, no estimate is better than the point "
        f"at which they are computed; the {d} nearest to zero belong to the gauge, a rotation of "
        "the whole world. Computed eigenvalues only illustrate; the proof is a factorization with "
        f"{certificate.shift:.3g} added to each, which the bound accounts for."
    )
    return bars(values.tolist(), names), note


def _charts(trace: Sequence[Iteration], certificate: Certificate) -> list[Lines]:
    steps = [float(k) for k in range(len(trace))]
    costs = [iteration.cost for iteration in trace]
    gaps = [cost - certificate.lower_bound for cost in costs]
    title = "Gap to the proven lower bound"
    drawn = (
        lines("Cost F", "iteration", [Curve("F", steps, costs)]),
        lines(title, "iteration", [Curve("gap", steps, gaps)], logarithmic=True),
    )
    return [chart for chart in drawn if chart is not None]


def _no_trace(origin: Origin) -> str:
    if origin.method:
        return "The method kept fewer than two iterations."
    return "The estimate came from a file, without iterations."


def _recheck(origin: Origin, certificate: Certificate) -> tuple[str, list[str]]:
    quoted = shlex.quote
    if origin.proof:
        note = "An independent program, which shares no code with certpgo, checks the proof file:"
        return note, [f"certpgo check {quoted(origin.graph)} {quoted(origin.proof)}"]
    options = " ".join(quoted(option) for option in origin.reading)
    estimate = origin.estimate or "best.g2o"
    named = f" --method {quoted(origin.method)}"
    by = {"": "", "certified": "", "robust": " --robust"}.get(origin.method, named)
    solving = f"certpgo solve {quoted(origin.graph)}{by} {options}".rstrip()
    if origin.partial:
        return "To choose the measurements and certify the estimate again:", [solving]
    lines_ = [] if origin.estimate else [f"{solving} -o {estimate}"]
    certify = f"certpgo certify {quoted(origin.graph)} {quoted(estimate)} {options}".rstrip()
    tier = "" if certificate.tier.value == "standard" else f" --tier {certificate.tier.value}"
    return "No proof file was written. To certify the estimate again and write a proof:", [
        *lines_,
        f"{certify}{tier} --proof estimate.cert",
        f"certpgo check {quoted(origin.graph)} estimate.cert",
    ]
