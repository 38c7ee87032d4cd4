"""certpgo certify: judge an estimate, whoever made it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli import _verdict
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, notice, working
from certpgo.cli._writing import refuse_overwriting
from certpgo.errors import InputError

if TYPE_CHECKING:
    from certpgo.certify import Certificate


@takes_reading
def command(
    graph: Annotated[str, typer.Argument(metavar="GRAPH", help="A file or dataset.")],
    estimate: Annotated[
        str, typer.Argument(metavar="ESTIMATE", help="A file or dataset that holds poses.")
    ],
    tier: Annotated[
        str, typer.Option("--tier", help="What may be trusted: standard, or screen (a hint only).")
    ] = "standard",
    rtol: Annotated[
        float, typer.Option("--rtol", help="Gap, over the cost, that counts as optimal.")
    ] = 1e-5,
    atol: Annotated[
        float, typer.Option("--atol", help="Gap, over the problem's scale, that counts as optimal.")
    ] = 1e-12,
    refine: Annotated[
        bool, typer.Option("--refine/--no-refine", help="Take the bound from an improved copy.")
    ] = True,
    polish: Annotated[
        Path | None, typer.Option("--polish", metavar="OUT", help="Write the best answer found.")
    ] = None,
    timestamps: Annotated[
        str, typer.Option("--timestamps", help="Of a TUM file: ids, index, or a file of seconds.")
    ] = "ids",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    *,
    reading: Reading,
) -> int:
    """Judge an estimate against the best possible answer of the graph."""
    import numpy as np

    from certpgo.certify import certify as judge
    from certpgo.io import read_estimate, write
    from certpgo.io.format import format_to_write
    from certpgo.problem import problem_of

    if polish is not None:
        format_to_write(polish, None)  # a wrong suffix is said before the work, not after
    refuse_overwriting([polish], [graph, estimate, timestamps], reading.data)
    instance = reading.open(graph)
    parts = reading.parts(instance)
    if polish is not None and len(parts) > 1:
        raise InputError("--polish writes one answer; choose one with --components largest")
    given = read_estimate(reading.locate(estimate), instance, timestamps=timestamps)
    certificates: list[Certificate] = []
    for part in parts:
        nodes = np.searchsorted(instance.ids, part.ids)
        with working(f"certifying {part.name}"):
            certificates.append(
                judge(
                    problem_of(part.graph),
                    given if part is instance else given.subset(nodes),
                    tier=tier,
                    rtol=rtol,
                    atol=atol,
                    refine=refine,
                )
            )
        if not json:
            if len(parts) > 1:
                typer.echo(part.name)
            _verdict.show(certificates[-1], part.options)
    if polish is not None:
        best = certificates[0].better or certificates[0].refined
        write(polish, best, instance=parts[0])
        notice(f"the best answer found is in {polish}")
    if json:
        reports = [
            {"graph": part.name, "options": dict(part.options), **_verdict.as_json(certificate)}
            for part, certificate in zip(parts, certificates, strict=True)
        ]
        document(reports[0] if len(reports) == 1 else reports)
    return _verdict.exit_code(certificates)
