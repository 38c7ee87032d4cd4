"""The page of one certificate: what is proven, on what it rests, where the residuals are."""

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

#: Eigenvalues that are shown beyond the d of the gauge.
EIGENVALUES = 5


@dataclass(frozen=True)
class Origin:
    """Where an estimate came from, and how to certify it again.

    Attributes
    ----------
    graph, estimate : as they were named; an estimate of our own that was not written has none
    reading : options of the command line that say how the graph was read
    proof : the proof file, if one was written
    method : that found the answer, or empty
    remarks : sentences that a reader of the verdict should know
    partial : whether the verdict is about a part of the measurements, those that the method kept
    settings : of the search that found the estimate, one text each
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


def certificate_page(
    instance: Instance,
    problem: Problem,
    estimate: Estimate,
    assessment: Assessment,
    origin: Origin,
    trace: Sequence[Iteration] = (),
) -> str:
    """The page, one HTML file; the same bytes for the same arguments.

    Parameters
    ----------
    instance, problem : the connected graph, and the problem that the certificate is about
    assessment : of the estimate, with its certificate
    trace : of the method that found it, if it kept one
    """
    with np.errstate(over="ignore", invalid="ignore"):  # infinite costs are shown, not warned of
        return _page(instance, problem, estimate, assessment, origin, trace)


def _page(
    instance: Instance,
    problem: Problem,
    estimate: Estimate,
    assessment: Assessment,
    origin: Origin,
    trace: Sequence[Iteration],
) -> str:
    certificate = assessment.certificate
    rungs = rungs_of_eigenvalues(problem, estimate, certificate)
    spectrum, spectrum_said = _spectrum(problem, certificate)
    recheck_said, recheck = _recheck(origin, certificate)
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
        spectrum_said=spectrum_said,
        charts=_charts(trace, certificate),
        no_charts=_no_trace(origin),
        recheck_said=recheck_said,
        recheck=recheck,
        settings=origin.settings,
        environment=dict(origin.environment or {}),
    )


_EDGE_HEADER = ("edge", "nodes", "term of F", "share of F", "off by, degrees", "off by, m")


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
    yield "proof rests on", trusts(certificate)
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
    """A picture, and what it shows; or why there is none."""
    if certificate.multipliers is None:
        return None, "There is no certificate matrix: no lower bound was found."
    d = problem.d
    try:
        values = smallest_eigenvalues(problem, certificate.multipliers, d + EIGENVALUES)
    except (NumericalError, np.linalg.LinAlgError) as error:
        return None, f"They could not be computed: {error}."
    gauge = set(np.argsort(np.abs(values), kind="stable")[:d].tolist())
    names = [f"{k + 1}" + (" (gauge)" if k in gauge else "") for k in range(len(values))]
    said = (
        "Translations are eliminated. Where none is negative, no estimate is better than the point "
        f"at which they are computed; the {d} nearest to zero belong to the gauge, a rotation of "
        "the whole world. Computed eigenvalues are a picture; the proof is a factorization with "
        f"{certificate.shift:.3g} added to each, which the bound accounts for."
    )
    return bars(values.tolist(), names), said


def _charts(trace: Sequence[Iteration], certificate: Certificate) -> list[Lines]:
    steps = [float(k) for k in range(len(trace))]
    costs = [iteration.cost for iteration in trace]
    gaps = [cost - certificate.lower_bound for cost in costs]
    drawn = (
        lines("Cost F", "iteration", [Curve("F", steps, costs)]),
        lines(
            "Gap to the proven lower bound",
            "iteration",
            [Curve("gap", steps, gaps)],
            logarithmic=True,
        ),
    )
    return [chart for chart in drawn if chart is not None]


def _no_trace(origin: Origin) -> str:
    if origin.method:
        return "The method kept fewer than two iterations."
    return "The estimate came from a file, which does not say how it was found."


def _recheck(origin: Origin, certificate: Certificate) -> tuple[str, list[str]]:
    quoted = shlex.quote
    if origin.proof:
        said = "An independent program, which shares no code with certpgo, checks the proof file:"
        return said, [f"certpgo check {quoted(origin.graph)} {quoted(origin.proof)}"]
    options = " ".join(quoted(option) for option in origin.reading)
    estimate = origin.estimate or "best.g2o"
    named = f" --method {quoted(origin.method)}"
    by = {"": "", "certified": "", "robust": " --robust"}.get(origin.method, named)
    solving = f"certpgo solve {quoted(origin.graph)}{by} {options}".rstrip()
    if origin.partial:
        return "To choose the measurements and certify the estimate again:", [solving]
    lines_ = [] if origin.estimate else [f"{solving} -o {estimate}"]
    judged = f"certpgo certify {quoted(origin.graph)} {quoted(estimate)} {options}".rstrip()
    tier = "" if certificate.tier.value == "standard" else f" --tier {certificate.tier.value}"
    said = "No proof file was written. To certify the estimate again and write a proof:"
    return said, [
        *lines_,
        f"{judged}{tier} --proof answer.cert",
        f"certpgo check {quoted(origin.graph)} answer.cert",
    ]
