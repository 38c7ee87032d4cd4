"""certpgo compare: methods side by side on the same graphs, each answer judged alike."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._reading import Components, Reading, takes_reading
from certpgo.cli._reports import Order
from certpgo.cli._tables import run_report
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
        str | None, typer.Option("--methods", help="Names or labels, separated by commas.")
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
    from certpgo.harness.execute import Pool

    table: Table = registry.get_table("compare")
    options = {key: value for key, value in reading.options.items() if value not in (None, False)}
    if graphs:
        table = replace(
            table, rows=_rows(graphs, reading.data), stand_ins=(), optional=False, quick=()
        )
    if methods is not None:
        table = replace(table, methods=_methods(table, methods.split(",")))
    table = replace(
        table,
        rows=_read_with(table.rows, options, reading.components),
        stand_ins=_read_with(table.stand_ins, options, reading.components),
    )
    order = Order(out, reading.data, quick=quick, again=True, named=bool(graphs))
    return run_report(table, order, Pool(), json=json, lines=False)


def _read_with(
    rows: tuple[Row, ...], options: dict[str, object], components: Components
) -> tuple[Row, ...]:
    return tuple(
        replace(row, reading={**row.reading, **options}, components=components.value)
        for row in rows
    )


def _rows(graphs: list[str], data: Path | None) -> tuple[Row, ...]:
    from certpgo import datasets
    from certpgo.harness.instances import require_known
    from certpgo.harness.spec import Row

    for name in graphs:
        require_known(name)  # said before the work, not after
    for name in graphs:
        if not Path(name).exists():
            datasets.fetch(name, data)  # asked for by name, it may be downloaded
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
    # Asked for by name, a method that does not take the graph says so.
    return tuple(
        replace(labelled.get(name) or Method(name), takes="") for name in dict.fromkeys(names)
    )
