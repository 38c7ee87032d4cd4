"""certpgo diagnose: what is wrong with a map, an estimate or its truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from certpgo.cli._options import (
    CostOption,
    GraphName,
    Json,
    MaxDifference,
    Timestamps,
    estimate_argument,
    time_limit_option,
)
from certpgo.cli._outputs import Outputs
from certpgo.cli._reading import Components, Reading, restricted_to, takes_reading
from certpgo.cli._show import StatusLine, document, facts, notice, noticing, paragraph, working
from certpgo.cli._truth import OF_TRUTH, TruthFile, TruthOffset

if TYPE_CHECKING:
    from certpgo.diagnosis import KnownTruth
    from certpgo.graph import Estimate, Instance
    from certpgo.io.datasets.source import Source
    from certpgo.io.matching import Matching
    from certpgo.optimize.monitor import Iteration

EXAMPLES = (
    "certpgo diagnose graph.g2o estimate.tum",
    "certpgo diagnose graph.g2o estimate.tum --truth truth.tum",
    "certpgo diagnose graph.g2o",
)
RULES = (OF_TRUTH,)


@takes_reading
def command(
    graph: GraphName,
    estimate: Annotated[
        str | None,
        estimate_argument("Estimate that is asked about: file or dataset."),
    ] = None,
    cost: CostOption = None,
    truth: TruthFile = None,
    truth_offset: TruthOffset = 0.0,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="OUT", help="Write the findings to this text file."),
    ] = None,
    html: Annotated[
        Path | None,
        typer.Option("--html", metavar="OUT", help="Write the findings as an HTML page."),
    ] = None,
    time_limit: Annotated[
        float | None, time_limit_option("For each search.", "2 s, and 1 ms a measurement")
    ] = None,
    timestamps: Timestamps = None,
    max_difference: MaxDifference = 0.01,
    json: Json = False,
    *,
    reading: Reading,
) -> None:
    """Say why a map is wrong: which mistake explains it, with its cost and that of the map.

    Tried are conventions of estimates, measurements and truth, wrong measurements, the stated
    noise, the optimizer, and the graph itself. Nothing is changed. Without an estimate the graph is
    examined alone.
    """
    from certpgo.diagnosis import diagnose
    from certpgo.io.matching import Matching
    from certpgo.io.timestamps import timed
    from certpgo.io.writing import write_text

    source, of_estimate = reading.resolve(graph), reading.resolve(estimate)
    of_truth = reading.resolve(truth)
    outputs = Outputs(scene=out, html=html, json=json)
    outputs.refuse(source, of_estimate, of_truth)
    whole = timed(_whole(source, reading), timestamps)
    # Parts that nothing joins are a finding, and examined each.
    largest = reading.components is Components.LARGEST
    [instance] = reading.parts(whole) if largest else [whole]
    how = Matching.of(timestamps, max_difference)
    given = None if of_estimate is None else _estimate(of_estimate, whole, instance, reading, how)
    known = _truth(of_truth, instance, reading, how.of_truth(truth_offset))
    with working(f"examining {instance.name}") as line:
        status = _Status(line)
        found = diagnose(
            instance,
            given,
            truth=known,
            cost=cost,
            time_limit=time_limit,
            monitor=status,
            progress=status.trying,
        )
    if out is not None:
        write_text(out, f"{found}\n")
    if html is not None:
        from certpgo.view.diagnosis_page import write_diagnosis_page

        write_diagnosis_page(html, instance.name, found)
        notice(f"page written to {html}")
    if json:
        document({"graph": instance.name, **found.as_data()})
        return
    paragraph(f"{found.headline}.")
    typer.echo()
    facts(found.facts())


class _Status(StatusLine):
    """The line of a spinner: the mistake that is tried, and the iteration of a search."""

    def __init__(self, line: Any) -> None:
        super().__init__(line)
        self.kind, self.count = "", 0

    def trying(self, kind: str) -> None:
        """Show the kind of a mistake."""
        self.kind, self.count = kind, self.count + 1
        self.line.update(f"trying mistake {self.count}: {kind}")

    def __call__(self, iteration: Iteration) -> bool:
        """Show the iteration; never stop."""
        if not self.kind:
            return super().__call__(iteration)
        self.line.update(f"trying mistake {self.count}: {self.kind}, step {iteration.number}")
        return False


def _whole(source: Source, reading: Reading) -> Instance:
    """The graph; with nodes released where it cannot be read with these held."""
    from certpgo.errors import FormatError, InputError

    try:
        return reading.open(source, operation=None)
    except FormatError:
        raise
    except InputError as refusal:
        if not reading.fixed:
            raise
        released = replace(reading, fixed=False).open(source, operation=None)
        notice(f"{refusal}: released here")
        return released


def _estimate(
    of: Source, whole: Instance, part: Instance, reading: Reading, how: Matching
) -> Estimate | Path:
    """The estimate of a part; or its path if it is refused, which then is to be explained."""
    from certpgo.errors import FormatError
    from certpgo.io import read_estimate

    try:
        with noticing():
            found = read_estimate(
                of.path(),
                whole,
                timestamps=how.timestamps,
                max_difference=how.max_difference,
                topic=reading.topic_of(of),
            )
    except FormatError:
        return of.path()
    return restricted_to(part, found, whole)


def _truth(
    of: Source | None, instance: Instance, reading: Reading, how: Matching
) -> KnownTruth | None:
    from certpgo.diagnosis import KnownTruth
    from certpgo.errors import in_file
    from certpgo.io.estimates import true_poses

    if of is None:
        return None
    poses = true_poses(of.path(), topic=reading.topic_of(of))
    with in_file(of.path()):
        return KnownTruth.of(poses, instance, how)
