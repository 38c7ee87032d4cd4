"""certpgo outliers: rejected measurements one by one, and what is proven about each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._cause import cause, cause_as_json, cause_of_rejections
from certpgo.cli._interrupting import INTERRUPTED, tell_interrupted, tells_unwritten
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
    from certpgo.certify.region import ProvenDistance
    from certpgo.graph import Instance
    from certpgo.solve.outlier_report import OutlierReport, RejectedEdge
    from certpgo.solve.result import CertifiedSolution


EXAMPLES = (
    "certpgo outliers graph.g2o",
    "certpgo outliers graph.g2o -o rejected.csv",
)
#: Seconds for proofs about single measurements, without a limit of the user's.
PROOFS = 60.0


@takes_reading
@tells_unwritten("csv")
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

    They are those that certpgo solve --robust rejects, under the same cost, and where it takes the
    noise as other than stated, those at the stated noise too. The distance to every optimum is over
    all choices of rejected measurements, if that is CERTIFIED. Ctrl-C during the proofs about each
    prints what is proven by then.
    """
    from certpgo import solve_robustly
    from certpgo.cli._verdict import EXIT_CODES, distance, headline
    from certpgo.optimize.solution import Status
    from certpgo.solve.outlier_report import outlier_report

    outputs = Outputs(csv=csv, json=json)
    outputs.refuse()
    source = reading.resolve(graph)
    outputs.refuse(source, *reading.others)
    instance = reading.open(source, operation="outliers")
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
        stated = answer.at_stated_noise
        answers = [answer] if stated is None or stated.rejection is None else [answer, stated]
        proofs = PROOFS if time_limit is None else time_limit
        reports = [
            None if one.rejection is None else outlier_report(one, level=level, time_limit=proofs)
            for one in answers
        ]
        found_wrong = cause_of_rejections(answer, monitor, cost=chosen, time_limit=time_limit)
    known = [report for report in reports if report is not None]
    if any(report.interrupted for report in known):
        tell_interrupted("what is proven by then stands")
    elif not all(report.is_complete for report in known):
        notice("the proofs were stopped; --time-limit lets them continue")
    if csv is not None:
        _written(csv, known)
    if not json:
        facts([("noise", answer.noise)] if answer.noise else [])
        facts(cause(found_wrong))
    codes, documents = [], []
    for one, report in zip(answers, reports, strict=True):
        codes.append(EXIT_CODES[one.verdict.value])
        if report is None:
            documents.append(_nothing_listed(instance, one, json=json))
            continue
        codes.append(EXIT_CODES[report.rejection.verdict.value])
        far = report.rejection.standing(one.certificate).stated_distance()
        documents.append(_as_json(instance, report, far))
        if not json:
            headline(one.certificate, report.rejection)
            assumed = [("assuming", report.rejection.noise)] if answer.noise else []
            found = [*assumed, *report.in_words(one.certificate), *distance(far, instance)]
            facts([("graph", instance.name), *found])
            table("Rejected measurements", _HEADER, map(_row, report.edges), optional=_OPTIONAL)
    if json:
        other = documents[1] if len(documents) > 1 else None
        more = {"at_stated_noise": other, **cause_as_json(found_wrong)}
        document({"noise_scale": answer.noise_scale, **documents[0], **more})
    return INTERRUPTED if any(report.interrupted for report in known) else max(codes)


def _written(csv: Path, reports: Sequence[OutlierReport]) -> None:
    """Write the rejected measurements, at the stated noise where no others are."""
    from certpgo.solve.outlier_report import write_report

    edges = reports[0].edges if reports else ()
    write_report(csv, edges)
    if edges:
        notice(f"{len(edges)} rejected measurements written to {csv}, {reports[0].rejection.noise}")


def _nothing_listed(instance: Instance, answer: CertifiedSolution, *, json: bool) -> dict[str, Any]:
    """Say that no measurement is rejected, or refuse if nothing is known of those that are."""
    from certpgo.cli._verdict import distance_as_json, warnings

    if len(answer.solution.rejected):
        raise InputError(answer.solution.note.rpartition("; ")[2])
    said = f"none of the {instance.num_measurements} measurements is rejected"
    if answer.noise_scale != 1.0:
        said += f" at {answer.noise_scale:.3g} times the stated noise"
    for sentence in (said, *warnings(answer.fit)):
        notice(sentence)
    return {
        "graph": instance.name,
        "verdict": answer.verdict.value,
        "sentence": said,
        "rejected": [],
        **distance_as_json(answer.certificate.stated_distance(), instance),
    }


_HEADER = ("nodes", "degrees", "metres", "cost", "price", "accepting costs", "over odometry", "")
#: Columns that narrow terminals do without, the first one first.
_OPTIONAL = ("price", "over odometry", "metres")


def _row(edge: RejectedEdge) -> list[str]:
    from certpgo.graph.phrases import rounded_down, shown_id

    def shown(value: float | None) -> str:
        return "" if value is None else f"{value:.4g}"

    rises = (edge.rise, edge.rise_over_odometry)
    least = ("" if rise is None else rounded_down(rise, 4) for rise in rises)
    known = "wrong" if edge.is_refuted else "ambiguous" if edge.ambiguous else ""
    measured = (shown(edge.degrees), shown(edge.metres), shown(edge.cost), shown(edge.price))
    return [f"{shown_id(edge.i)}-{shown_id(edge.j)}", *measured, *least, known]


def _as_json(
    instance: Instance, report: OutlierReport, far: ProvenDistance | None
) -> dict[str, Any]:
    from certpgo.cli._verdict import distance_as_json

    found = report.rejection
    return {
        "graph": instance.name,
        "verdict": found.verdict.value,
        "sentence": found.sentence,
        "cost": found.certificate.cost_upper,
        "lower_bound": found.certificate.lower_bound,
        **distance_as_json(far, instance),
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
