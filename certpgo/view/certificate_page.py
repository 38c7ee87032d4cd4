"""The page of one certificate: what is proven, its assumptions, and the residuals."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from certpgo.certify.certificate import Certificate
from certpgo.certify.region import ProvenDistance
from certpgo.certify.wording import bound_claim, meaning, numbers, part, stated_objective, trusts
from certpgo.errors import CertPGOError, NumericalError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.graph import length_unit
from certpgo.graph.phrases import bound_shown, cost_shown, counted, gap_shown
from certpgo.io.surfaces import Surface
from certpgo.linalg.arrays import IntArray
from certpgo.objective.choose_cost import (
    COSTS,
    Certifiable,
)
from certpgo.optimize.monitor import Iteration
from certpgo.solve.accuracy_wording import digits, distances, ends, provenance
from certpgo.solve.assessment import Assessment, CostlyEdge
from certpgo.solve.bounds_table import rungs_of_eigenvalues
from certpgo.solve.diagnostics import kinds_in_words
from certpgo.solve.rungs import Rung
from certpgo.view.advice import advice, cost_options
from certpgo.view.charts import Bars, Curve, Lines, bars, histogram, lines
from certpgo.view.eigenvalues import CertificateMatrix, certificate_matrix
from certpgo.view.load_scene import INITIAL_VALUES, is_spread, scene_of, start
from certpgo.view.page import page
from certpgo.view.page_scene import Data, page_scene
from certpgo.view.sureness import Sureness

#: Eigenvalues shown beyond the d of the gauge.
EIGENVALUES = 5
#: Those of the gauge are zero at stationary points, up to this part of the largest one shown.
GAUGE = 1e-6


@dataclass(frozen=True)
class Origin:
    """Where an estimate came from, and how to certify it again.

    Attributes
    ----------
    graph, estimate : names as given; empty for a computed estimate that was not written
    reading : command-line options with which the graph was read
    judging : those with which ``certify`` matched and judged the estimate
    proof : the proof file, if one was written
    method : the method that found the estimate, or empty
    meaning : what the verdict means; by default that of the certificate
    remarks : sentences shown below the verdict
    choice : what is proven about rejected measurements, as names and values
    partial : whether the verdict is only about the measurements that the method kept
    disagreeing : whether some measurements disagree with the rest
    settings : settings of the search that found the estimate, one text each
    environment : versions, machine and engine
    """

    graph: str
    estimate: str = ""
    reading: tuple[str, ...] = ()
    judging: tuple[str, ...] = ()
    proof: str = ""
    method: str = ""
    meaning: str = ""
    remarks: tuple[str, ...] = ()
    choice: tuple[tuple[str, str], ...] = ()
    partial: bool = False
    disagreeing: bool = False
    settings: tuple[str, ...] = ()
    environment: Mapping[str, str] | None = None


@np.errstate(over="ignore", invalid="ignore")  # infinite costs are shown without warnings
def certificate_page(
    instance: Instance,
    problem: Certifiable,
    estimate: Estimate,
    assessment: Assessment,
    origin: Origin,
    trace: Sequence[Iteration] = (),
    *,
    cloud: Surface | None = None,
    rejected: IntArray | None = None,
    distance: ProvenDistance | None = None,
) -> str:
    """The page as one HTML file; the same bytes for the same arguments.

    Parameters
    ----------
    instance, problem : the connected graph, and the problem that the certificate is about, under
        its cost
    assessment : assessment of the estimate, with its certificate
    trace : iterations of the method that found it, if it kept them
    cloud : points that were seen from the estimate's poses, in its frame and unit
    rejected : (r, 2) nodes of measurements that the problem does without
    distance : how far every optimum can be; by default that of the certificate
    """
    certificate = assessment.certificate
    distance = distance or certificate.stated_distance()
    spectrum, spectrum_note = _spectrum(problem, certificate)
    seen_from = None if distance is None else distance.reference
    of = Sureness(instance, problem, certificate, estimate, seen_from)
    recheck_note, recheck = _recheck(instance, origin, problem, certificate)
    return page(
        "certificate.html",
        verdict=certificate.verdict.value,
        graph=instance.name,
        meaning=origin.meaning or meaning(certificate),
        distance="" if distance is None else distance.sentence(instance.named),
        reason=_reason(certificate, origin),
        remarks=[*_cost(problem), *_misfit(assessment), *origin.remarks],
        figures=_figures(certificate, origin),
        advice=_advice(instance, origin, problem, certificate),
        numbers=[
            *_head(instance, origin),
            *origin.choice,
            *_facts(instance, assessment, distance),
        ],
        scene=_scene(of, cloud, rejected),
        angles=_angles(problem, estimate),
        edge_header=_edge_header(instance.graph),
        edges=[_edge(edge, instance) for edge in assessment.edges],
        bounds=[
            (rung.title, rung.shown, rung.says, rung.needs)
            for rung in _rungs(problem, estimate, certificate)
        ],
        spectrum=spectrum,
        spectrum_note=spectrum_note,
        charts=_charts(trace, certificate),
        no_charts=_no_trace(origin),
        recheck_note=recheck_note,
        recheck=recheck,
        settings=origin.settings,
        environment=dict(origin.environment or {}),
    )


def _advice(
    instance: Instance, origin: Origin, problem: Certifiable, certificate: Certificate
) -> list[tuple[str, str]]:
    """What to do next; nothing about measurements that another method chose."""
    if origin.partial:
        return []
    return advice(
        certificate,
        instance,
        origin.graph,
        origin.estimate,
        reading=origin.reading,
        judging=origin.judging,
        cost=problem.cost_name,
        searched=origin.method == "certified",
        disagreeing=origin.disagreeing,
    )


def _scene(of: Sureness, cloud: Surface | None, rejected: IntArray | None) -> Data:
    """The estimate of the measurements that the certificate is about, and how it began."""
    instance, problem, estimate = of.instance, of.problem, of.estimate
    judged = replace(instance, graph=problem.measured, initial=None, outliers=None)
    begun = _beginning(judged, instance.initial, estimate)
    clouds = () if cloud is None else (cloud,)
    drawn = scene_of(judged, *begun, ("estimate", estimate), *clouds)
    shown = replace(drawn, sureness=of)
    return page_scene(shown, problem.edge_costs(estimate), rejected=rejected)


def _beginning(
    judged: Instance, initial: Estimate | None, estimate: Estimate
) -> list[tuple[str, Estimate]]:
    """Other initial values than the estimate, or dead reckoning; none if only distances join it."""
    if initial is not None and is_spread(initial) and not _is_same(initial, estimate):
        return [(INITIAL_VALUES, initial)]
    return [start(judged)] if judged.graph.is_connected else []


def _is_same(a: Estimate, b: Estimate) -> bool:
    """Whether two estimates of one graph hold the same numbers."""
    same = np.array_equal(a.rotations, b.rotations)
    if a.translations is None or b.translations is None:
        return same
    return same and np.array_equal(a.translations, b.translations)


def _angles(problem: Certifiable, estimate: Estimate) -> Bars | None:
    """A histogram of the residual angles of a rotation graph, which has no positions to see."""
    if problem.measured.has_positions:
        return None
    return histogram(np.degrees(problem.residual_angles(estimate)).tolist(), "degrees")


def _reason(certificate: Certificate, origin: Origin) -> str:
    reason = certificate.reason
    if origin.partial:
        return f"Of the kept measurements alone: {reason}"
    return reason[:1].upper() + reason[1:]


def _figures(certificate: Certificate, origin: Origin) -> list[tuple[str, str, str]]:
    """The three numbers of a verdict: their names, values, and what they mean."""
    gap, relative = certificate.gap, certificate.relative_gap
    judged = "the kept measurements" if origin.partial else "this estimate"
    return [
        ("cost", cost_shown(certificate.cost_upper), f"F of {judged}"),
        ("bound", bound_shown(certificate.lower_bound), bound_claim(certificate)),
        (
            "gap",
            gap_shown(gap),
            f"{part(relative)} of F" if math.isfinite(relative) else "between them",
        ),
    ]


_EDGE_HEADER = ("edge", "nodes", "term of F", "share of F", "residual, degrees")


def _cost(problem: Certifiable) -> Iterable[str]:
    if problem.is_lifted:
        yield "The cost F on this page includes the squared errors of distances."
    elif not problem.is_chordal:
        yield f"The cost F is {problem.title} on this page."


def _misfit(assessment: Assessment) -> Iterable[str]:
    """The warning of an unusual chi^2."""
    fit = assessment.best_fit
    if fit is not None and fit.warning:
        yield f"{fit.warning}."


def _rungs(problem: Certifiable, estimate: Estimate, certificate: Certificate) -> tuple[Rung, ...]:
    """The bounds by eigenvalues and angles, which are about isotropic weights."""
    if not problem.is_chordal:
        return ()
    return rungs_of_eigenvalues(problem.chordal, estimate, certificate)


def _head(instance: Instance, origin: Origin) -> Iterable[tuple[str, str]]:
    graph = instance.graph
    nodes, edges = counted(graph.num_nodes, "node{s}"), counted(graph.num_measurements, "edge{s}")
    size = [nodes, edges, f"{graph.d}D"]
    if instance.graph.ranges is not None:  # numbered after the edges
        size.insert(2, counted(instance.graph.ranges.num_edges, "distance{s}"))
    yield "graph", f"{origin.graph} ({', '.join(size)})"
    if of_kinds := kinds_in_words(instance):
        yield "among these", ", ".join(of_kinds)
    if origin.estimate:
        yield "estimate", origin.estimate
    if origin.method:
        yield "method", origin.method


def _facts(
    instance: Instance, assessment: Assessment, distance: ProvenDistance | None
) -> Iterable[tuple[str, str]]:
    certificate = assessment.certificate
    yield from numbers(certificate, assessment.farthest, length_unit(instance.graph))
    if assessment.fit is not None:
        yield "chi^2", str(assessment.fit)
    yield from () if distance is None else distance.in_words(instance.named)
    yield from distances(assessment, instance)
    yield from digits(assessment)
    yield from trusts(certificate)
    yield "objective", stated_objective(instance.options, certificate)
    yield from provenance(instance, certificate)
    yield from (("notice", sentence) for sentence in instance.notices)


def _edge_header(graph: Graph) -> tuple[str, ...]:
    of_poses = graph.has_positions
    return (*_EDGE_HEADER, f"residual, {length_unit(graph)}") if of_poses else _EDGE_HEADER


def _edge(edge: CostlyEdge, instance: Instance) -> tuple[str, ...]:
    cells = (
        str(edge.edge),
        ends(instance, *edge.ids),
        f"{edge.cost:.6g}",
        f"{100.0 * edge.share:.3g} %",
        "" if edge.angle is None else f"{math.degrees(edge.angle):.4g}",
    )
    if not instance.graph.has_positions:
        return cells
    return (*cells, "" if edge.metres is None else f"{edge.metres:.4g}")


def _spectrum(problem: Certifiable, certificate: Certificate) -> tuple[Bars | None, str]:
    """A chart with its explanation, or the reason why there is none."""
    if problem.is_lifted:
        return None, "The bound is that of a relaxation above this space, which is not drawn."
    try:
        matrix = certificate_matrix(problem, certificate)
    except CertPGOError:
        matrix = None
    if matrix is None:
        return None, "There is no certificate matrix: no lower bound was found."
    d = problem.d
    try:
        values = matrix.eigenvalues(d + EIGENVALUES)
    except (NumericalError, np.linalg.LinAlgError) as error:
        return None, f"The eigenvalues could not be computed: {error}."
    nearest = np.argsort(np.abs(values), kind="stable")[:d]
    is_stationary = bool(np.abs(values[nearest]).max() <= GAUGE * np.abs(values).max())
    gauge = set(nearest.tolist()) if is_stationary else set()
    names = [f"{k + 1}" + (" (gauge)" if k in gauge else "") for k in range(len(values))]
    return bars(values.tolist(), names), _spectrum_in_words(
        matrix, certificate, is_stationary=is_stationary
    )


def _spectrum_in_words(
    matrix: CertificateMatrix, certificate: Certificate, *, is_stationary: bool
) -> str:
    """What the eigenvalues of the matrix say."""
    source, proof = "", ""
    if matrix.touches is None:
        claim = "no estimate is better than the point at which they are computed"
        proof = (
            f"; the proof is a factorization with {certificate.shift:.3g} added to each, which the "
            "bound accounts for"
        )
    else:
        where = "after local descent" if certificate.descended else "at this estimate"
        claim = "no estimate costs less than that"
        source = (
            "The matrix is that of the surrogate, a pose graph whose cost plus a constant is never "
            f"above F, and equal to it {where}: {cost_shown(matrix.touches)}. "
        )
    d, whole = matrix.problem.d, "the gauge, a rotation of the whole world"
    gauge = f"the {d} nearest to zero belong to {whole}"
    if not is_stationary:
        gauge = f"fewer than {d} are zero; at stationary points {d} are, those of {whole}"
    return (
        f"{source}Translations are eliminated. If none is negative, {claim}; {gauge}. "
        f"Computed eigenvalues only illustrate{proof}."
    )


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


def _recheck(
    instance: Instance,
    origin: Origin,
    problem: Certifiable,
    certificate: Certificate,
) -> tuple[str, list[str]]:
    quoted = shlex.quote
    if origin.proof:
        note = "An independent program, which shares no code with certpgo, checks the proof file:"
        return note, [f"certpgo check {quoted(origin.graph)} {quoted(origin.proof)}"]
    chosen = cost_options(instance, problem.cost_name)
    options = " ".join(quoted(option) for option in (*chosen, *origin.reading))
    estimate = origin.estimate or "best.g2o"
    named = f" --method {quoted(origin.method)}"
    by = {"": "", "certified": "", "robust": " --robust"}.get(origin.method, named)
    solving = f"certpgo solve {quoted(origin.graph)}{by} {options}".rstrip()
    if origin.partial:
        return "To choose the measurements and certify the estimate again:", [solving]
    lines_ = [] if origin.estimate else [f"{solving} -o {estimate}"]
    judging = " ".join((options, *map(quoted, origin.judging))).strip()
    certify = f"certpgo certify {quoted(origin.graph)} {quoted(estimate)} {judging}".rstrip()
    tier = "" if certificate.tier.value == "standard" else f" --tier {certificate.tier.value}"
    if problem.unprovable or not COSTS[problem.cost_name].provable:
        return "To certify the estimate again:", [*lines_, f"{certify}{tier}"]
    return "No proof file was written. To certify the estimate again and write a proof:", [
        *lines_,
        f"{certify}{tier} --proof estimate.cert",
        f"certpgo check {quoted(origin.graph)} estimate.cert",
    ]
