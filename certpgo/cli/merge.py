"""certpgo merge: maps in one frame, with the certificate of all measurements together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from certpgo.cli import _verdict
from certpgo.cli._interrupting import tells_unwritten
from certpgo.cli._options import Json
from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._show import document, noticing, table
from certpgo.cli._writing import refuse_overwriting, refuse_unwritable


@takes_reading
@tells_unwritten("out")
def command(
    maps: Annotated[
        list[str], typer.Argument(metavar="MAP MAP...", help="Graphs: files or dataset names.")
    ],
    between: Annotated[
        str, typer.Option("--between", help="Graph file with the measurements between the maps.")
    ],
    offset: Annotated[
        int | None,
        typer.Option(
            "--offset",
            min=1,
            help="Raise the ids of the second map by this, of the third by twice this, and so on, "
            "as in --between.",
        ),
    ] = None,
    robust: Annotated[
        bool,
        typer.Option("--robust", help="Leave out measurements between maps that disagree."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write the merged graph and its estimate.")
    ] = None,
    json: Json = False,
    *,
    reading: Reading,
) -> int:
    """Merge maps whose relative poses are unknown, and prove how good the result is.

    Each map is certified alone, then all measurements together. The measurements between maps are
    listed with what they add to F, the worst first.
    """
    from dataclasses import replace

    import numpy as np

    from certpgo.io import write
    from certpgo.io.format import format_to_write
    from certpgo.solvers.certified.merging import merge

    if out is not None:
        format_to_write(out, None)
    refuse_unwritable(out)
    sources = [reading.resolve(name) for name in maps]
    joints = reading.resolve(between)
    refuse_overwriting([out], [*sources, joints])
    read = [reading.open(source) for source in sources]
    merged = merge(read, reading.open(joints), offset=offset, robust=robust)
    if out is not None:
        with noticing():
            written = replace(merged.instance, initial=merged.answer.estimate)
            write(out, written)
    certificate, left = merged.answer.certificate, set(merged.disagreeing.tolist())
    worst = merged.between[np.argsort(-merged.terms, kind="stable")].tolist()
    ids, labels, first = merged.instance.ids, merged.instance.labels, int(merged.between[0])
    pairs = {edge: merged.instance.graph.edges[edge] for edge in worst}
    if json:
        document(
            {
                "verdict": certificate.verdict.value,
                "cost": certificate.cost_upper,
                "lower_bound": certificate.lower_bound,
                "raised": merged.raised,
                "maps": [
                    {"name": one.name, "verdict": part.verdict.value, "cost": part.cost}
                    for one, part in zip(read, merged.parts, strict=True)
                ],
                "between": [
                    {
                        "edge": edge,
                        "ids": ids[pairs[edge]].tolist(),
                        "term": merged.terms[edge - first],
                        "tail": merged.tails[edge - first],
                        "disagrees": edge in left,
                        "left_out": merged.left_out and edge in left,
                    }
                    for edge in worst
                ],
            }
        )
    else:
        mark = "left out" if merged.left_out else "disagrees"
        rows = [
            [
                "-".join(str(labels[k]) for k in pairs[edge].tolist()),
                f"{merged.terms[edge - first]:.4g}",
                f"{merged.tails[edge - first]:.2g}",
                mark if edge in left else "",
            ]
            for edge in worst[:SHOWN]
        ]
        table("Between the maps", ["nodes", "term of F", "probability", ""], rows)
        typer.echo(str(merged))
    return _verdict.exit_code([certificate])


#: Measurements between maps that are listed.
SHOWN = 10
