"""certpgo suggest: which loop closures would help a graph."""

from __future__ import annotations

from typing import Annotated

import typer

from certpgo.cli._options import GraphName, Json, note_distances_uncounted
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, table, working

EXAMPLES = (
    "certpgo suggest graph.g2o",
    "certpgo suggest graph.g2o --within 5",
)


@takes_reading
def command(
    graph: GraphName,
    count: Annotated[
        int, typer.Option("-n", "--count", min=1, help="Loop closures to suggest.")
    ] = 5,
    within: Annotated[
        float | None,
        typer.Option(
            "--within",
            metavar="METRES",
            help="Largest distance between the two nodes in the best estimate.",
        ),
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> None:
    """Name pairs of nodes whose loop closures would connect a graph much better.

    A greedy choice: each is the best of the eight that raise the algebraic connectivity most to
    first order, given those before it. Other pairs may raise it more. New loop closures are assumed
    to have the median precision of those in the graph.
    """
    from certpgo.graph.phrases import shown_id
    from certpgo.solve.suggesting import suggest_loops

    instance = reading.open(reading.resolve(graph), operation=None)
    note_distances_uncounted(instance)
    with working(f"connectivity of {instance.name}"):
        found = suggest_loops(instance, count, within=within)
    pairs, values = found.named.tolist(), found.connectivity.tolist()
    if json:
        document(
            {
                "graph": instance.name,
                "connectivity": values[0],
                "kappa": found.kappa,
                "suggested": [
                    {"ids": pair, "connectivity": value}
                    for pair, value in zip(pairs, values[1:], strict=True)
                ],
            }
        )
        return
    rows = [
        [f"{shown_id(i)}-{shown_id(j)}", f"{value:.4g}", f"{value / before:.3g}"]
        for (i, j), before, value in zip(pairs, values, values[1:], strict=False)
    ]
    table(
        "Loop closures that would help, chosen greedily",
        ["nodes", "connectivity", "times before"],
        rows,
    )
    typer.echo(str(found).splitlines()[0])
