"""certpgo compare: methods side by side on the same graphs, each answer judged alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._reading import Reading, takes_reading
from certpgo.cli._tables import run_table
from certpgo.errors import SpecError

if TYPE_CHECKING:
    from certpgo.harness.spec import Method, Row, Table


@takes_reading
def command(
    graphs: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DATASET|FILE]...", help="By default the data sets found here."),
    ] = None,
    methods: Annotated[
        str | None, typer.Option("--methods", help="Names, separated by commas.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for the results.")
    ] = Path("compare-results"),
    quick: Annotated[bool, typer.Option("--quick", help="The small graphs alone.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    *,
    reading: Reading,
) -> int:
    """Run methods on graphs and print cost, proven gap, verdict and time of each."""
    from certpgo import registry

    table: Table = registry.get_table("compare")
    options = {key: value for key, value in reading.options.items() if value not in (None, False)}
    if graphs:
        table = replace(table, rows=_rows(graphs), stand_ins=(), optional=False, quick=())
    if methods is not None:
        table = replace(table, methods=_methods(table, methods.split(",")))
    table = replace(
        table,
        rows=tuple(_read_with(row, options) for row in table.rows),
        stand_ins=tuple(_read_with(row, options) for row in table.stand_ins),
    )
    return run_table(table, out, data=reading.data, quick=quick, json=json)


def _read_with(row: Row, options: dict[str, object]) -> Row:
    return replace(row, reading={**row.reading, **options})


def _rows(graphs: list[str]) -> tuple[Row, ...]:
    from certpgo.harness.instances import require_known
    from certpgo.harness.spec import Row

    for name in graphs:
        require_known(name)  # said before the work, not after
    return tuple(Row(dataset=name) for name in dict.fromkeys(graphs))


def _methods(table: Table, names: list[str]) -> tuple[Method, ...]:
    """Methods by their label in the table, or by their name in the registry."""
    from certpgo import registry
    from certpgo.harness.spec import Method

    labelled = {method.label: method for method in table.methods}
    known = {*labelled, *registry.solver_names()}
    for name in names:
        if name not in known:
            raise SpecError.unknown("method", name, known)
    return tuple(labelled.get(name) or Method(name) for name in dict.fromkeys(names))
