"""certpgo outliers: rejected measurements one by one, and what is proven about each."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._interrupting import INTERRUPTED, tell_interrupted
from certpgo.cli._options import (
    CostOption,
    GraphName,
    Json,
    Quantile,
    chosen_cost,
    time_limit_option,
)
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import StatusLine, document, facts, notice, table, working
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.graph import Instance
    from certpgo.solve.outlier_report import OutlierReport, RejectedEdge
    from certpgo.solve.result import CertifiedSolution


#: Seconds for proofs about single measurements, without a limit of the user's.
PROOFS = 60.0


@takes_reading
def command(
    graph: GraphName,
    cost: CostOption = None,
    quantile: Quantile = None,
    level: Annotated[
        float,
        typer.Option("--level", help="Probability that noise as stated refutes a right one."),
    ] = 1e-6,
    time_limit: Annotated[
        float | None,
        time_limit_option(
            "Stop the robust fit, and then what is proven about each measurement.",
            "30 s after a first bound, and 60 s",
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", "--csv", metavar="OUT", help="Write a row per rejected measurement."
        ),
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """List the measurements that disagree with the rest, and prove what accepting each costs.

    They are those that certpgo solve --robust rejects, under the same cost. Ctrl-C during the
    proofs about each prints what is proven by then.
    """
    from certpgo import solve_robustly
    from certpgo.cli._options import refuse_with_distances
    from certpgo.cli._verdict import EXIT_CODES, headline
    from certpgo.optimize.solution import Status
    from certpgo.solve.outlier_report import outlier_report, write_report

    outputs = Outputs(csv=csv, json=json)
    outputs.refuse()
    source = reading.resolve(graph)
    outputs.refuse_overwriting(source, *reading.others)
    instance = reading.open(source, distances=True)
    refuse_with_distances(instance, outliers=True)
    instance, *others = reading.parts(instance)
    if others:
        raise InputError("measurements of one component are listed: --components largest")
    chosen = chosen_cost(cost, instance)
    with working(f"rejecting measurements of {instance.name}") as status:
        monitor = StatusLine(status)
        how: dict[str, Any] = {"cost": chosen, "quantile": quantile, "time_limit": time_limit}
        answer = solve_robustly(instance, monitor=monitor, **how)
        if answer.solution.status is Status.INTERRUPTED:  # nothing is known of its choice
            raise KeyboardInterrupt
        if answer.rejection is None:
            return _nothing_listed(instance, answer, csv, json=json)
        proofs = PROOFS if time_limit is None else time_limit
        report = outlier_report(answer, level=level, time_limit=proofs)
    if report.interrupted:
        tell_interrupted("what is proven by then stands")
    elif not report.is_complete:
        notice("the proofs were stopped; --time-limit lets them continue")
    if csv is not None:
        write_report(csv, report.edges)
        notice(f"{len(report.edges)} rejected measurements written to {csv}")
    if json:
        document(_as_json(instance.name, report))
    else:
        headline(answer.certificate, report.rejection)
        facts([("graph", instance.name), *report.in_words(answer.certificate)])
        table("Rejected measurements", _HEADER, map(_row, report.edges), optional=_OPTIONAL)
    if report.interrupted:
        return INTERRUPTED
    return max(EXIT_CODES[verdict.value] for verdict in (answer.verdict, report.rejection.verdict))


def _nothing_listed(
    instance: Instance, answer: CertifiedSolution, csv: Path | None, *, json: bool
) -> int:
    """Say that no measurement is rejected, or refuse if nothing is known of those that are."""
    from certpgo.cli._verdict import EXIT_CODES, warnings
    from certpgo.solve.outlier_report import write_report

    if len(answer.solution.rejected):
        raise InputError(answer.solution.note.rpartition("; ")[2])
    said = f"none of the {instance.num_measurements} measurements is rejected"
    if csv is not None:
        write_report(csv, ())
    if json:
        verdict = answer.verdict.value
        document({"graph": instance.name, "verdict": verdict, "sentence": said, "rejected": []})
    for sentence in (said, *warnings(answer.fit)):
        notice(sentence)
    return EXIT_CODES[answer.verdict.value]


_HEADER = ("nodes", "degrees", "metres", "cost", "price", "accepting costs", "over odometry", "")
#: Columns that narrow terminals do without, the first one first.
_OPTIONAL = ("price", "over odometry", "metres")


def _row(edge: RejectedEdge) -> list[str]:
    from certpgo.graph.phrases import rounded_down

    def shown(value: float | None) -> str:
        return "" if value is None else f"{value:.4g}"

    rises = (edge.rise, edge.rise_over_odometry)
    least = ("" if rise is None else rounded_down(rise, 4) for rise in rises)
    known = "wrong" if edge.is_refuted else "ambiguous" if edge.ambiguous else ""
    measured = (shown(edge.degrees), shown(edge.metres), shown(edge.cost), shown(edge.price))
    return [f"{edge.i}-{edge.j}", *measured, *least, known]


def _as_json(name: str, report: OutlierReport) -> dict[str, Any]:
    found = report.rejection
    return {
        "graph": name,
        "verdict": found.verdict.value,
        "sentence": found.sentence,
        "cost": found.certificate.cost_upper,
        "lower_bound": found.certificate.lower_bound,
        "quantile": found.quantile,
        "level": report.level,
        "complete": report.is_complete,
        "wrong_at_least": len(report.cores),
        "odometry_by": report.order,
        "wrong_at_least_over_odometry": len(report.cores_over_odometry),
        "doubtful_kept": None if report.doubtful_kept is None else report.doubtful_kept.tolist(),
        "cores": [members.tolist() for members in report.cores],
        "rejected": [
            {
                **asdict(edge),
                "refuted": edge.is_refuted,
                "refuted_by_odometry": edge.is_refuted_by_odometry,
            }
            for edge in report.edges
        ],
    }
