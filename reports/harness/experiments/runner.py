"""Runs a table: instance by instance, method by method, one record each.

A failure is a record with its reason. Records are yielded as they are made, so that an
interruption keeps what is done.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from certpgo import registry
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.components import connected_parts, rotations_alone
from certpgo.linalg.factor import default_engine
from certpgo.objective.choose_cost import CHORDAL, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status
from certpgo.solve.comparison import certified, solution_of
from certpgo.solve.provenance import provenance
from reports.harness.experiments import evaluate, reference
from reports.harness.experiments.absence import Absence, NotRun, missing
from reports.harness.experiments.instances import known_truth, load_row
from reports.harness.experiments.limits import NO_LIMIT, Limit, OutOfTime
from reports.harness.experiments.metrics import Needs, needing
from reports.harness.experiments.records import Record, of_certificate, of_solution, trace_of
from reports.harness.experiments.spec import Method, Row, Table
from reports.harness.experiments.trials import Trial, trials_of

Announce = Callable[[str], None]


def _quiet(message: str) -> None:
    """Announce nothing."""


def run_table(
    table: Table,
    *,
    data: Path | None = None,
    seeds: int | None = None,
    quick: bool = False,
    announce: Announce = _quiet,
) -> Iterator[Record]:
    """Run every row and method of the table.

    Parameters
    ----------
    data : folder to look for files in first
    seeds : how many instances a synthetic row represents, by default the table's
    quick : run the quick profile's rows alone, with one seed by default
    announce : called with what is about to run
    """
    for trial in trials_of(table, data=data, seeds=seeds, quick=quick):
        yield from run_trial(trial, data=data, announce=announce)


def run_trial(
    trial: Trial,
    *,
    data: Path | None = None,
    methods: Collection[str] | None = None,
    limit: Limit = NO_LIMIT,
    announce: Announce = _quiet,
) -> Iterator[Record]:
    """Run methods on the instance, and yield a record of each on each component.

    Parameters
    ----------
    data : folder to look for files in first
    methods : labels of those to run; by default all
    limit : on the time of each
    """
    table, row = trial.table, trial.row
    chosen = [m for m in table.methods if methods is None or m.label in methods]
    announce(f"{row.label}: reading")
    try:
        if row.absent:
            raise NotRun(Absence.LEFT_OUT, row.absent)
        complete = load_row(replace(row, rotations=False), data, trial.seed)
        instance = rotations_alone(complete) if row.rotations else complete
        judged = instance
        if row.judging is not None:
            judged = load_row(replace(row, reading=row.judging), data, trial.seed)
    except CertPGOError as error:
        for method in chosen:
            yield replace(trial.blank(method), **missing(error)._asdict())
        return
    parts = _parts(row, instance)
    for part in parts:
        whole = part is instance
        context = _Context(
            trial,
            instance=part,
            judged=judged if whole else part,
            timed=complete.graph if whole else part.graph,
            truth=_truth(row, part, data),
            limit=limit,
            announce=announce,
        )
        suited = [m for m in table.methods if suits(row, m, part.graph.kind)]
        for method in suited:
            if method not in chosen:
                context.remember(method)
                continue
            announce(f"{part.name}: {method.label}")
            yield replace(
                _run_method(method, context),
                part="" if whole else part.name,
                parts=len(parts),
                provenance=provenance(method.engine or default_engine(), registry.source()),
            )


def suits(row: Row, method: Method, kind: str) -> bool:
    """Whether the method is run on the row, whose graph is of that kind."""
    return row.runs(method) and method.takes in ("", kind)


def _truth(row: Row, part: Instance, data: Path | None) -> evaluate.Truth | None:
    try:
        return known_truth(row, part, data)
    except CertPGOError:
        return None  # of none of the part's nodes


def _parts(row: Row, instance: Instance) -> list[Instance]:
    # Refused: every method then says why.
    return [instance] if row.components == "refuse" else connected_parts(instance, row.components)


@dataclass
class _Context:
    """An instance with everything that its methods' estimates are evaluated with.

    Attributes
    ----------
    trial : the row that it is of
    instance, judged : the graph to solve, and the one that the thesis' metrics are evaluated on
    timed : the graph that the reference of times is run on
    truth : nodes of which it is known, and theirs, or None
    limit : on the time of a method
    first : the estimate of the table's first method, once there is one
    """

    trial: Trial
    instance: Instance
    judged: Instance
    timed: Graph
    truth: evaluate.Truth | None
    limit: Limit
    announce: Announce
    first: Estimate | None = None

    @cached_property
    def best(self) -> float | None:
        """F of the optimum, where the table compares with it."""
        if not needing(self.trial.table.metrics, Needs.OPTIMUM):
            return None
        self.announce(f"{self.instance.name}: the optimum")
        try:
            return evaluate.optimum(Quadratic(self.instance.graph))
        except CertPGOError:
            return None  # every method then says why

    def remember(self, method: Method) -> None:
        """Solve again what others are compared with, where its record exists already."""
        table = self.trial.table
        if method is not table.methods[0] or not needing(table.metrics, Needs.FIRST):
            return
        self.announce(f"{self.instance.name}: {method.label} again")
        with suppress(Exception, OutOfTime), self.limit.kept():
            problem = Quadratic(self.instance.graph, method.engine or default_engine())
            settings = self.trial.row.settings
            self.first = solution_of(method, problem, self.instance, settings=settings).estimate


def _run_method(method: Method, context: _Context) -> Record:
    instance, judged = context.instance, context.judged
    graph = instance.graph
    record = replace(
        context.trial.blank(method),
        reading=dict(instance.options),
        judging=None if judged is instance else dict(judged.options),
        d=graph.d,
        n=graph.num_nodes,
        m=graph.num_edges,
        kind=graph.kind,
    )
    try:
        if method.max_nodes is not None and graph.num_nodes > method.max_nodes:
            raise NotRun(Absence.TOO_LARGE, f"above {method.max_nodes} nodes")
        best = context.best
        with context.limit.kept():
            return _solved(method, context, best, record)
    except (Exception, OutOfTime) as error:  # a table goes on whatever a method raises
        return replace(record, **missing(error)._asdict())


def _solved(method: Method, context: _Context, best: float | None, record: Record) -> Record:
    """The record completed by the method's estimate and its metrics."""
    trial, instance, judged = context.trial, context.instance, context.judged
    table = trial.table
    problem = Quadratic(instance.graph, method.engine or default_engine())
    if not method.solver:
        asked = [key for key in table.metrics if key in (method.published or table.metrics)]
        return replace(record, metrics=evaluate.of_graph(asked, problem))
    row = trial.row
    posed = problem if row.cost == CHORDAL else objective_of(instance, row.cost)
    times: dict[str, float] = {}
    if table.reference is not None:
        times, kept = reference.against(table.reference, method, instance.graph, context.timed)
        record = replace(record, metrics=times, note=kept)
        if not table.certify:
            return record
    solution = solution_of(method, problem, instance, settings=row.settings)
    if solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if method.cost != row.cost:  # its bound and trace are of another cost
        solution = replace(solution, lower_bound=None, trace=())
    note = "; ".join(filter(None, (record.note, solution.note)))
    trace = () if record.seed else trace_of(solution)
    record = replace(record, **of_solution(solution), note=note, trace=trace)
    certificate, seconds = certified(solution, posed) if table.certify else (None, 0.0)
    evaluated = problem if judged is instance else Quadratic(judged.graph)
    metrics = evaluate.of_estimate(
        table.metrics,
        posed,
        evaluated,
        solution,
        certificate,
        certify_seconds=seconds,
        best=best,
        truth=context.truth,
        outliers=instance.outliers,
        other=context.first,
    )
    if method is table.methods[0]:
        context.first = solution.estimate
    spent = {"total_seconds": sum(solution.seconds.values())}
    record = replace(record, metrics={**times, **metrics, **spent})
    if certificate is None:
        return record
    by = evaluate.certified_by(solution.judged(problem), certificate)
    return replace(record, certified_by=by, **of_certificate(certificate))
