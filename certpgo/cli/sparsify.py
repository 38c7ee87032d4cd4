"""certpgo sparsify: the loop closures that connect a graph best, and what the others were worth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import GraphName, Json
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, noticing, working
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable


def amount(text: str) -> float:
    """A number of loop closures, or a fraction of them: ``500``, ``0.2`` or ``20%``."""
    try:
        if text.endswith("%"):
            return float(text[:-1]) / 100.0
        return int(text) if text.isdigit() else float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not a number, a fraction or a percentage") from None


@takes_reading
@tells_unwritten("out")
def command(
    graph: GraphName,
    keep: Annotated[
        float,
        typer.Option(
            "--keep",
            parser=amount,
            metavar="K",
            help="Loop closures to keep: a number such as 500, or a share such as 0.2 or 20%.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write the sparse graph and its estimate.")
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Keep the loop closures that connect a graph best, and show what is lost.

    Chosen by the algebraic connectivity of the graph, with a bound on every other choice of as
    many. The whole and the sparse graph are solved and certified. Parallel edges are all read.
    """
    from dataclasses import asdict, replace

    from certpgo.assess.sparsifying import sparsify
    from certpgo.io import write
    from certpgo.io.format import format_to_write

    if out is not None:
        format_to_write(out, None)
    refuse_unwritable(out)
    source = reading.resolve(graph)
    refuse_overwriting([out], [source])
    instance = reading.open(source)
    with working(f"sparsifying {instance.name}"):
        found = sparsify(instance, keep)
    if out is not None:
        with noticing():
            write(out, replace(found.instance, initial=found.answer.estimate))
    if json:
        sides = {"whole": found.whole.certificate, "sparse": found.answer.certificate}
        document(
            {
                "graph": instance.name,
                "loop_closures": found.loops,
                "kept": instance.ids[instance.graph.edges[found.chosen]].tolist(),
                "connectivity": found.connectivity,
                "connectivity_bound": found.bound,
                "connectivity_of_all": found.full,
                "cost_of_all": found.cost,
                "loss": found.loss,
                "moved": asdict(found.moved),
                **{
                    side: {
                        "verdict": certificate.verdict.value,
                        "cost": certificate.cost_upper,
                        "lower_bound": certificate.lower_bound,
                    }
                    for side, certificate in sides.items()
                },
            }
        )
    else:
        typer.echo(str(found))
    return _verdict.exit_code([found.answer.certificate])
