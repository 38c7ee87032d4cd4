"""Running tables and figures from the command line: one, or all of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import closing
from typing import TYPE_CHECKING

import typer

from certpgo.cli._interrupting import INTERRUPTED
from certpgo.cli._show import document, notice
from certpgo.errors import InputError, UnusableFile
from reports.harness.commands._live import watching
from reports.harness.commands._reports import FigureReport, Order, Report, TableReport

if TYPE_CHECKING:
    from reports.harness.experiments.execute import Pool
    from reports.harness.experiments.figure import Figure
    from reports.harness.experiments.spec import Table


def run_report(
    spec: Table | Figure, order: Order, pool: Pool, *, json: bool, lines: bool = True
) -> int:
    """Run a table or figure, print it, and write it into a folder.

    Parameters
    ----------
    pool : where it runs
    lines : where stderr is no terminal, print one line per finished row
    """
    report = _report(spec, order)
    interrupted = run_tasks({spec.name: report}, pool, lines=lines)
    path = report.close(interrupted=interrupted)
    unread = report.unread
    if not report.is_any:
        if interrupted:
            raise KeyboardInterrupt
        raise InputError("; ".join(unread) or "nothing to run")
    if json:
        document(report.data())
    else:
        report.show()
    if interrupted:
        hint = "" if order.named else "; the same command goes on from there"
        notice(f"interrupted with {report.line()}{hint}")
    elif not report.tasks:
        notice("Up to date; use --again to recompute")
    if interrupted or not json:
        notice(f"written to {path} and {path.stem}.{report.companion}")
    for reason in unread:
        notice(f"not read: {reason}")
    if interrupted:
        return INTERRUPTED
    return 1 if unread else 0


def run_all(names: Iterable[str], order: Order, pool: Pool, *, json: bool) -> int:
    """Run tables and figures together, print one line for each, and write them into a folder."""
    from reports.harness.experiments import scan

    reports: dict[str, Report] = {}
    skipped: dict[str, str] = {}
    for name in names:
        try:
            reports[name] = _report(scan.get_experiment(name), order)
        except (InputError, UnusableFile) as error:
            skipped[name] = str(error)
    interrupted = run_tasks(reports, pool, lines=True)
    for report in reports.values():
        report.close(interrupted=interrupted and bool(report.tasks))
    if json:
        document({name: report.data() for name, report in reports.items()})
    else:
        for report in reports.values():
            typer.echo(report.line())
    for name, reason in skipped.items():
        notice(f"{name}: {reason}")
    if not any(report.tasks for report in reports.values()):
        notice("Up to date; use --again to recompute")
    if not interrupted:
        notice(f"written to {order.out}")
        return 0
    notice(f"interrupted; the same command goes on from what is in {order.out}")
    return INTERRUPTED


def _report(spec: Table | Figure, order: Order) -> Report:
    from reports.harness.experiments.figure import Figure

    return FigureReport(spec, order) if isinstance(spec, Figure) else TableReport(spec, order)


def run_tasks(reports: Mapping[str, Report], pool: Pool, *, lines: bool) -> bool:
    """Keep the result of each task when it is there; returns whether that was interrupted."""
    from reports.harness.experiments.execute import execute

    tasks = [task for report in reports.values() for task in report.tasks]
    try:
        with (
            watching(tasks, lines=lines) as view,
            closing(
                execute(tasks, pool, announce=view.announce, starting=view.starting)
            ) as outcomes,
        ):
            for outcome in outcomes:
                reports[outcome.task.report].keep(outcome)
                view.show(outcome)
    except KeyboardInterrupt:
        return True
    return False
