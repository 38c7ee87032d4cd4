"""Runs a table: instance by instance, method by method, one record each.

A failure is a record with its reason. Records are yielded as they are made, so that an
interruption leaves what is done.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certpgo import registry
from certpgo.certify import Certificate, certify
from certpgo.errors import CertPGOError, InputError, SpecError
from certpgo.estimate import Estimate
from certpgo.graph import Graph, Instance, PoseGraph
from certpgo.harness import bench, evaluate
from certpgo.harness.instances import (
    connected_parts,
    is_here,
    known_truth,
    load_row,
    rotations_alone,
    seed_of,
)
from certpgo.harness.methods import build
from certpgo.harness.records import Record, of_certificate, of_solution, provenance
from certpgo.harness.spec import OPTIMUM_METRICS, Method, Row, Table
from certpgo.linalg.factor import default_engine
from certpgo.problem import Problem, problem_of
from certpgo.solution import Solution, Solver, Status

#: Environment variable that `certpgo.linalg.factor.default_engine` obeys.
ENGINE_VARIABLE = "CERTPGO_ENGINE"

Announce = Callable[[str], None]


def _quiet(message: str) -> None:
    """Announce nothing."""


def run(
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
    seeds : how many instances a synthetic row stands for, by default the table's
    quick : run the quick profile's rows alone, with one seed by default
    announce : told what is about to run
    """
    usual = 1 if quick else table.seeds
    for place, row in enumerate(chosen_rows(table, data=data, quick=quick)):
        for repetition in range((seeds or usual) if row.generator else 1):
            seed = seed_of(table.seed, place, repetition) if row.generator else None
            for record in _run_row(table, row, data, seed, announce):
                yield replace(record, seed=repetition if row.generator else None)


def chosen_rows(table: Table, *, data: Path | None, quick: bool) -> tuple[Row, ...]:
    """The rows to run: those of the profile, and the stand-ins when no file is here.

    Raises
    ------
    InputError
        Rows are optional, and the files of none of them are here.
    """
    rows = table.rows
    if table.optional:
        here = [
            tuple(row for row in group if is_here(row, data))
            for group in (table.rows, table.stand_ins)
        ]
        rows = here[0] or here[1]
    if not rows:
        raise InputError(
            f"none of the files of table {table.name} is here: pip install 'certpgo[baselines]' "
            "brings some, certpgo fetch others; --data names a folder of your own"
        )
    if quick and table.quick:
        rows = tuple(row for row in rows if row.label in table.quick) or rows[:1]
    return rows


def _run_row(
    table: Table,
    row: Row,
    data: Path | None,
    seed: np.random.SeedSequence | None,
    announce: Announce,
) -> Iterator[Record]:
    announce(f"{row.label}: reading")
    try:
        if row.absent:
            raise InputError(f"not run: {row.absent}")
        complete = load_row(replace(row, rotations=False), data, seed)
        instance = rotations_alone(complete) if row.rotations else complete
        judged = instance if row.judging is None else _rejudged(row, data, seed)
    except CertPGOError as error:
        for method in table.methods:
            yield replace(_blank(table, row, method), error=str(error))
        return
    for part in _parts(row, instance):
        whole = part is instance
        case = _Case(
            instance=part,
            judged=judged if whole else part,
            timed=complete.graph if whole else part.graph,
            best=_optimum(table, part, announce),
            truth=_truth(row, part, data),
        )
        for method in table.methods:
            if method.takes not in ("", _kind(part.graph)) or not row.runs(method):
                continue
            announce(f"{part.name}: {method.label}")
            with _engine(method.engine):
                yield replace(
                    _run_method(table, row, method, case),
                    part="" if whole else part.name,
                    provenance=provenance(default_engine(), _root()),
                )


def _optimum(table: Table, part: Instance, announce: Announce) -> float | None:
    """F of the part's optimum, where the table compares with it."""
    if not set(table.metrics) & set(OPTIMUM_METRICS):
        return None
    announce(f"{part.name}: the optimum")
    try:
        return evaluate.optimum(problem_of(part.graph))
    except CertPGOError:
        return None  # every method then says why


def _truth(row: Row, part: Instance, data: Path | None) -> evaluate.Truth | None:
    try:
        return known_truth(row, part, data)
    except CertPGOError:
        return None  # of none of the part's nodes


def _parts(row: Row, instance: Instance) -> list[Instance]:
    # Refused: every method then says why.
    return [instance] if row.components == "refuse" else connected_parts(instance, row.components)


def _kind(graph: Graph) -> str:
    return "poses" if isinstance(graph, PoseGraph) else "rotations"


@contextmanager
def _engine(name: str) -> Iterator[None]:
    """Prefer an engine for a while."""
    before = os.environ.get(ENGINE_VARIABLE)
    if name:
        os.environ[ENGINE_VARIABLE] = name
    try:
        yield
    finally:
        if before is not None:
            os.environ[ENGINE_VARIABLE] = before
        elif name:
            del os.environ[ENGINE_VARIABLE]


def _rejudged(row: Row, data: Path | None, seed: np.random.SeedSequence | None) -> Instance:
    return load_row(replace(row, reading=row.judging or {}), data, seed)


@dataclass
class _Case:
    """An instance with all that its methods' answers are held against.

    Attributes
    ----------
    instance, judged : the graph to solve, and the one that the thesis' metrics are evaluated on
    timed : the graph that the reference of times is run on
    best : F of the optimum, or None
    truth : nodes of which it is known, and theirs, or None
    first : the answer of the table's first method, once there is one
    """

    instance: Instance
    judged: Instance
    timed: Graph
    best: float | None
    truth: evaluate.Truth | None
    first: Estimate | None = None


def _run_method(table: Table, row: Row, method: Method, case: _Case) -> Record:
    instance, judged = case.instance, case.judged
    graph = instance.graph
    record = replace(
        _blank(table, row, method),
        reading=dict(instance.options),
        judging=None if judged is instance else dict(judged.options),
        d=graph.d,
        n=graph.num_nodes,
        m=graph.num_edges,
    )
    if method.max_nodes is not None and graph.num_nodes > method.max_nodes:
        return replace(record, error=f"not run: above {method.max_nodes} nodes")
    try:
        problem = problem_of(graph)
        if not method.solver:
            wanted = [key for key in table.metrics if key in (method.published or table.metrics)]
            return replace(record, metrics=evaluate.of_graph(wanted, problem))
        times: dict[str, float] = {}
        if table.reference is not None:
            times, kept = bench.against(table.reference, method, graph, case.timed)
            record = replace(record, metrics=times, note=kept)
            if not table.certify:
                return record
        solution = solve(method, problem, row, instance.source)
        if solution.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        note = "; ".join(filter(None, (record.note, solution.note)))
        record = replace(record, **of_solution(solution), note=note)
        certificate, seconds = _certified(problem, solution) if table.certify else (None, 0.0)
        judge = problem if judged is instance else problem_of(judged.graph)
        metrics = evaluate.of_estimate(
            table.metrics,
            problem,
            judge,
            solution,
            certificate,
            certify_seconds=seconds,
            best=case.best,
            truth=case.truth,
            outliers=instance.outliers,
            other=case.first,
        )
        if method is table.methods[0]:
            case.first = solution.estimate
        spent = {"total_seconds": sum(solution.seconds.values())}
        record = replace(record, metrics={**times, **metrics, **spent})
        if certificate is None:
            return record
        by = evaluate.certified_by(solution.judged(problem), certificate)
        return replace(record, certified_by=by, **of_certificate(certificate))
    except CertPGOError as error:
        return replace(record, error=str(error))
    except Exception as error:  # a table survives whatever a method raises
        first = str(error).partition("\n")[0]
        return replace(record, error=f"{type(error).__name__}: {first}")


def solve(method: Method, problem: Problem, row: Row | None = None, source: str = "") -> Solution:
    """The method's answer, from its starting method's answer where it has one.

    Parameters
    ----------
    row : the row whose own settings apply
    source : where the problem was read from, for methods that read it themselves

    Raises
    ------
    SpecError
        The method or a setting is unknown, or the method does not take such a problem.
    """
    own = dict(row.settings.get(method.label, {})) if row else {}
    if method.reads_source:
        own["source"] = source
    solver = build(method.solver, {**method.settings, **own})
    refuse_other_problems(method.solver, solver, problem.graph)
    if method.start is None:
        return solver.solve(problem)
    start = solve(method.start, problem, row, source)
    solution = solver.solve(problem, initial=start.estimate)
    before = {method.start.label: sum(start.seconds.values())}
    return replace(solution, seconds={**before, **solution.seconds})


def refuse_other_problems(name: str, solver: Solver, graph: Graph) -> None:
    """Refuse a graph that the method is not for.

    Raises
    ------
    SpecError
        The method takes poses only, or rotations only.
    """
    kind = _kind(graph)
    if kind == "poses" and not solver.poses:
        raise SpecError(f"{name} takes rotation graphs only; this graph measures poses")
    if kind == "rotations" and not solver.rotations:
        raise SpecError(f"{name} takes pose graphs only; this graph measures rotations")


def _certified(problem: Problem, solution: Solution) -> tuple[Certificate, float]:
    start = time.perf_counter()
    certificate = certify(solution.judged(problem), solution.estimate)
    return certificate, time.perf_counter() - start


def _blank(table: Table, row: Row, method: Method) -> Record:
    settings = {**method.settings, **row.settings.get(method.label, {})}
    return Record(table.name, row.label, method.label, solver=method.solver, settings=settings)


def _root() -> Path | None:
    try:
        return registry.repository()
    except SpecError:
        return None
