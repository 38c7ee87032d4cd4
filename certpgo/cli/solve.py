"""certpgo solve: estimate a graph with a certificate, by the pipeline or another method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._completion import formats, inputs, methods
from certpgo.cli._help import JUDGING, SEARCH
from certpgo.cli._interrupting import ends_at_once, tells_unwritten
from certpgo.cli._logarithms import fitted
from certpgo.cli._next import Asked
from certpgo.cli._options import (
    CostOption,
    GraphNames,
    HtmlOut,
    Json,
    KernelOption,
    MaxDifference,
    ProofOut,
    Quantile,
    Reference,
    Timestamps,
    chosen_cost,
    require_for,
    tier_for,
    tier_option,
    time_limit_option,
)
from certpgo.cli._outputs import Outputs, Result, emit
from certpgo.cli._reading import Reading, restricted_to, takes_reading
from certpgo.cli._rules import Rule, chordal_only, no_kernel, refuse
from certpgo.cli._show import StatusLine, notice, noticing, working
from certpgo.cli._solved import Solved
from certpgo.cli._truth import OF_TRUTH, KnownPoses, TruthFile, TruthOffset
from certpgo.errors import InputError, require_numbers

if TYPE_CHECKING:
    from certpgo import SolveSettings
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.matching import Matching
    from certpgo.optimize.monitor import Monitor
    from certpgo.optimize.solution import Solver
    from certpgo.solve.outliers import Disagreement

EXAMPLES = (
    "certpgo solve graph.g2o -o solution.g2o",
    "certpgo solve graph.g2o --proof solution.cert --html solution.html",
    "certpgo solve graph.g2o --robust --cost gtsam",
    "certpgo solve sphere2500 --method newton --cost chordal",
)
_CONNECTED = "--{option} needs a connected graph and a certified estimate"
_UNSTATED = "certifies nothing that a page or proof could state"
RULES = (
    Rule(
        "--scheduler is gone: solve runs in one process, which is faster than a cluster's two",
        "scheduler",
    ),
    Rule("--quantile needs --robust", "quantile", without="robust"),
    Rule("--set needs --method", "settings", without="method"),
    Rule("--no-certify needs --method", "certify", without="method"),
    Rule(
        "--time-limit and --max-rank cannot be combined with --method",
        "time_limit|max_rank",
        "method",
    ),
    Rule("--no-file-start cannot be combined with --method or --robust", "stored", "method|robust"),
    Rule("--robust chooses its own method: not with --method", "robust", "method"),
    chordal_only("method"),
    chordal_only("robust", "proof"),
    no_kernel("method", "robust", "scales_within"),
    no_kernel("proof", "html", "covariances", "regions"),
    Rule("--scales-within has a cost of its own: not with --cost", "scales_within", "cost"),
    Rule(
        "--scales-within has a start of its own: not with --no-file-start",
        "scales_within",
        "stored",
    ),
    Rule(f"--scales-within {_UNSTATED}: not with --{{option}}", "html|proof", "scales_within"),
    Rule(_CONNECTED, "proof|html|covariances|regions", "certify"),
    Rule("--level needs --regions", "level", without="regions"),
    OF_TRUTH,
)
OF_PARTS = (Rule(_CONNECTED, "proof|html|covariances|regions", "several"),)


@takes_reading
@tells_unwritten("out", "proof", "html", "covariances", "regions")
def command(
    graphs: GraphNames,
    cost: CostOption = None,
    kernel: KernelOption = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Reject measurements that disagree with the rest."),
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="OUT", help="Write the estimate to this file."),
    ] = None,
    format: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            autocompletion=formats,
            help="Format of --out; by default from its suffix.",
        ),
    ] = None,
    html: HtmlOut = None,
    proof: ProofOut = None,
    covariances: Annotated[
        Path | None,
        typer.Option(
            "--covariances",
            metavar="OUT",
            help="Write the covariance of each node to this CSV file.",
        ),
    ] = None,
    regions: Annotated[
        Path | None,
        typer.Option(
            "--regions",
            metavar="OUT",
            help="Write how far each node is from the estimate in all others of low cost, proven, "
            "to this CSV file.",
        ),
    ] = None,
    time_limit: Annotated[
        float | None,
        time_limit_option("Stop and return the best estimate so far.", "30 s after a first bound"),
    ] = None,
    trace: Annotated[bool, typer.Option("--trace", help="Print every iteration.")] = False,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            autocompletion=methods,
            rich_help_panel=SEARCH,
            help="Use another method (certpgo list methods), under the chordal cost.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", rich_help_panel=SEARCH, help="Setting of --method."
        ),
    ] = None,
    certify: Annotated[
        bool,
        typer.Option(
            "--certify/--no-certify",
            rich_help_panel=SEARCH,
            help="Certify the estimate of --method.",
        ),
    ] = True,
    initial: Annotated[
        str | None,
        typer.Option(
            "--initial",
            metavar="FILE",
            autocompletion=inputs,
            rich_help_panel=SEARCH,
            help="Initial estimate: a file or dataset.",
        ),
    ] = None,
    stored: Annotated[
        bool,
        typer.Option(
            "--file-start/--no-file-start",
            rich_help_panel=SEARCH,
            help="Also start from the file's initial values, unless the optimum is found without.",
        ),
    ] = True,
    max_rank: Annotated[
        int | None,
        typer.Option(
            "--max-rank",
            min=2,
            metavar="N",
            rich_help_panel=SEARCH,
            show_default="d + 7",
            help="Largest rank of the staircase.",
        ),
    ] = None,
    tier: Annotated[
        str | None,
        tier_option("standard; proof with --proof, or if only rounding prevents CERTIFIED"),
    ] = None,
    quantile: Quantile = None,
    level: Annotated[
        float | None,
        typer.Option(
            "--level",
            metavar="P",
            rich_help_panel=JUDGING,
            show_default="0.95",
            help="Probability of --regions under the stated noise.",
        ),
    ] = None,
    reference: Reference = None,
    scales_within: Annotated[
        float | None,
        typer.Option(
            "--scales-within",
            metavar="FACTOR",
            rich_help_panel=SEARCH,
            help="Minimise the cost of logarithms over nodes of unknown scale, with a bound for "
            "scales within this factor of those found.",
        ),
    ] = None,
    truth: TruthFile = None,
    truth_offset: TruthOffset = 0.0,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    scheduler: Annotated[str | None, typer.Option("--scheduler", hidden=True)] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Find the best estimate of a graph and prove how good it is.

    The certified pipeline initializes, optimizes and certifies; if that fails, it climbs the
    Riemannian staircase. Ctrl-C or SIGTERM returns the best estimate so far; a second Ctrl-C
    aborts. With --method, the first Ctrl-C aborts. With --robust, the verdict is about the kept
    measurements, and a second one about rejecting the others.
    """
    from certpgo import SolveSettings
    from certpgo.graph.components import require_pose
    from certpgo.io.matching import Matching
    from certpgo.io.timestamps import file_of_times, timed

    if scales_within is not None and not 1.0 <= scales_within < math.inf:
        raise InputError(f"--scales-within takes a factor of at least 1, not {scales_within:g}")
    graph, reading = reading.of_all(graphs)
    tier = tier_for(proof, tier, cost)
    files = {"proof": proof, "covariances": covariances, "regions": regions}
    outputs = Outputs(estimate=out, format=format, html=html, json=json, **files)
    outputs.refuse()
    source, of_truth = reading.resolve(graph), reading.resolve(truth)
    of_initial = reading.resolve(initial)
    inputs = (source, *reading.others, of_initial, of_truth, file_of_times(timestamps))
    outputs.refuse(*inputs)
    instance = timed(reading.open(source, operation=None), timestamps)
    require_numbers(level=level)
    require_for(instance, method=method, robust=robust, kernel=kernel, **files)
    if scales_within is not None and not instance.graph.has_scales:
        raise InputError(f"{instance.name}: --scales-within is for nodes of unknown scale")
    parts = reading.parts(instance)
    refuse(OF_PARTS, several=len(parts) > 1, html=html, **files)
    require_pose(reference, parts, "--reference")
    for own in outputs.split(parts):
        own.refuse(*inputs)
    how = Matching.of(timestamps, max_difference)
    truths = [KnownPoses.of(of_truth, part, reading, how.of_truth(truth_offset)) for part in parts]
    start = None if of_initial is None else _start(of_initial, instance, reading, how)
    solver = None if method is None else _solver(method, settings, parts, initial)
    chosen = chosen_cost(cost, instance, method=method, **{"robust --proof": robust and proof})
    again = _judging(timestamps, max_difference)
    asked = Asked(graph, chosen, reading, judging=again, kernel=kernel)
    outputs = outputs.about(source, instance, asked.cost)

    from certpgo.optimize.monitor import TableMonitor

    def solved(part: Instance, known: KnownPoses | None) -> Result:
        begin = None if start is None else restricted_to(part, start, instance)
        with working(f"solving {part.name}") as status:
            monitor = TableMonitor() if trace else StatusLine(status)
            if solver is None or method is None:
                limits = SolveSettings(time_limit, max_rank, tier=tier, try_file_start=stored)
                if scales_within is not None:
                    return fitted(part, begin, limits, monitor, scales_within, known)
                search = partial(_rejecting, quantile=quantile) if robust else _certified
                found = search(part, begin, limits, monitor, asked)
            else:
                requested = (tier or "standard") if certify else None
                found = _by_method(part, method, solver, begin, requested, monitor, status, asked)
        if trace and not found.solution.trace:
            notice(f"{found.method} reports no iterations to --trace")
        return replace(found, truth=known, reference=reference, level=level)

    return emit(map(solved, parts, truths), outputs.split(parts))


def _judging(timestamps: str | None, max_difference: float) -> dict[str, Any]:
    """The options that match what is written with nodes: times, not how --initial was matched."""
    from certpgo.io.timestamps import file_of_times

    times = file_of_times(timestamps)
    return {} if times is None else {"timestamps": times, "max-difference": max_difference}


def _solver(
    method: str, settings: Sequence[str] | None, parts: Sequence[Instance], initial: str | None
) -> Solver:
    """The method with its settings; an InputError if it does not take what it is given."""
    from certpgo.registry import build, parse_settings

    chosen = parse_settings(method, settings or ())
    solver = build(method, chosen, *(part.graph for part in parts))
    if initial is not None and not getattr(solver, "takes_initial", True):
        raise InputError(f"{method} takes no initial estimate: not with --initial")
    return solver


def _start(source: Source, instance: Instance, reading: Reading, how: Matching) -> Estimate:
    """The initial estimate in a file or dataset, of all nodes."""
    from certpgo.io import read_estimate

    with noticing():
        return read_estimate(
            source.path(),
            instance,
            timestamps=how.timestamps,
            max_difference=how.max_difference,
            topic=reading.topic_of(source),
        )


def _certified(
    part: Instance,
    initial: Estimate | None,
    settings: SolveSettings,
    monitor: Monitor,
    asked: Asked,
) -> Solved:
    from certpgo import solve

    how: dict[str, Any] = {"cost": asked.cost, "kernel": asked.kernel, "monitor": monitor}
    found = solve(part, settings, initial=initial, on_disagreement=_hinting, **how)
    return Solved(found.certificate, part, "certified", found.solution, asked, found)


def _rejecting(
    part: Instance,
    initial: Estimate | None,
    settings: SolveSettings,
    monitor: Monitor,
    asked: Asked,
    quantile: float | None,
) -> Solved:
    from certpgo import solve_robustly

    how: dict[str, Any] = {"cost": asked.cost, "quantile": quantile, "monitor": monitor}
    found = solve_robustly(part, settings, initial=initial, **how)
    return Solved(found.certificate, part, "robust", found.solution, asked, found)


def _hinting(found: Disagreement) -> None:
    from certpgo.solve.accuracy_wording import hint

    notice(hint(found))


def _by_method(
    part: Instance,
    name: str,
    solver: Solver,
    initial: Estimate | None,
    tier: str | None,
    monitor: Monitor,
    status: Any,
    asked: Asked,
) -> Solved:
    from certpgo.certify.certificate import of_instance
    from certpgo.objective.quadratic import Quadratic
    from certpgo.solve.judging import certify

    problem = Quadratic(part.graph)
    with ends_at_once() if getattr(solver, "compiled", False) else nullcontext():
        solution = solver.solve(problem, initial=initial, monitor=monitor)
    if tier is None:
        return Solved(None, part, name, solution, asked)
    status.update(f"certifying the estimate of {part.name}")
    certificate = certify(solution.judged(problem), solution.estimate, tier=tier)
    certificate = of_instance(certificate, part, solution.estimate)
    return Solved(certificate, part, name, solution, asked)
