"""certpgo reproduce: papers' tables, our numbers next to the printed ones, and figures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from certpgo.cli._completion import experiments
from certpgo.errors import InputError
from reports.harness.commands._reports import Order
from reports.harness.commands._tables import run_all, run_report

if TYPE_CHECKING:
    from reports.harness.experiments.execute import Pool


EXAMPLES = (
    "certpgo reproduce eriksson2018_table1 --quick",
    "certpgo reproduce --all --workers 2",
)


def command(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", autocompletion=experiments, help="See list tables, list figures."
        ),
    ] = None,
    listing: Annotated[
        bool, typer.Option("--list", help="Say item by item how the papers compare; run nothing.")
    ] = False,
    every: Annotated[bool, typer.Option("--all", help="All tables and figures.")] = False,
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, help="Instances of a synthetic row.")
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="The small profile only.")] = False,
    workers: Annotated[
        int, typer.Option("--workers", min=1, metavar="N", help="Processes, a row each.")
    ] = 1,
    again: Annotated[bool, typer.Option("--again", help="Recompute existing results.")] = False,
    time_limit: Annotated[
        float,
        typer.Option("--time-limit", min=0.001, metavar="S", help="Seconds, of each method."),
    ] = 1800.0,
    out: Annotated[
        Path, typer.Option("-o", "--out", metavar="DIR", help="Folder for the results.")
    ] = Path("reproduce-results"),
    data: Annotated[
        Path | None, typer.Option("--data", metavar="DIR", help="Folder to look in first.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> int:
    """Run tables of papers and say which printed numbers ours agree with; draw figures.

    Only missing results are computed, so that an interrupted run resumes.
    """
    from reports.harness.experiments.execute import Pool

    if listing:
        if every or name is not None:
            raise InputError("--list is of both papers: give no name, and no --all")
        return list_items(json=json)
    if every == (name is not None):
        raise InputError("give the name of a table or figure, or --all")
    # Results of a quick run must not be taken for the report's.
    folder = out / "quick" if quick else out
    order = Order(folder, data, seeds, quick=quick, again=again, seconds=time_limit)
    return reproduce(name, order, Pool(workers), json=json)


def list_items(*, json: bool = False) -> int:
    """Print every equation, algorithm, table and figure of the papers with its outcome."""
    from certpgo import registry
    from certpgo.cli._show import document, table
    from reports.harness.rendering import items
    from reports.harness.rendering.results import gather

    report = gather(registry.repository() / "reports" / "results")
    found = items.items(report.tables, report.figures)
    if json:
        document([vars(item) for item in found])
        return 0
    for paper in dict.fromkeys(item.paper for item in found):
        of_paper = [item for item in found if item.paper == paper]
        table(paper, items.HEADER, items.rows(of_paper), items.counts(of_paper))
    return 0


def reproduce(name: str | None, order: Order, pool: Pool, *, json: bool = False) -> int:
    """Run a table or figure, or all of them, where the pool says; returns the exit code.

    Raises
    ------
    InputError
        Seeds of a figure.
    SpecError
        There is no table or figure of this name.
    """
    from reports.harness.experiments import scan
    from reports.harness.experiments.figure import Figure

    if name is None:
        names = (*scan.table_names(), *scan.figure_names())
        return run_all(names, order, pool, json=json)
    spec = scan.get_experiment(name)
    if order.seeds is not None and isinstance(spec, Figure):
        raise InputError(f"--seeds is for tables; the seeds of {spec.name} are fixed")
    return run_report(spec, order, pool, json=json)
