"""Methods compared on a graph: cost, proven gap, verdict and run time of each."""

from __future__ import annotations

import itertools
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from certpgo import registry
from certpgo.certify import Certificate
from certpgo.certify.certificate import CHORDAL as OF_F
from certpgo.certify.region import limits
from certpgo.errors import CertPGOError, FormatError, SpecError, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.capabilities import require_capable
from certpgo.graph.phrases import listed
from certpgo.io.accept_paths import AnyPath, as_instance
from certpgo.objective.choose_cost import (
    CHORDAL,
    COSTS,
    Sum,
    objective_of,
    own_cost,
)
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Solution, Solver, Status
from certpgo.solve.judging import Judge, certify
from certpgo.solve.metrics import TrajectoryErrors, f_ml


@dataclass(frozen=True)
class Competitor:
    """A method with its settings.

    Attributes
    ----------
    solver : name in the registry
    label : name in tables, by default the solver's
    settings : fields of the solver's dataclass
    start : the method that computes the initial estimate, or None
    takes : ``"poses"`` or ``"rotations"`` if restricted to these; empty for both
    reads_source : whether the method reads the graph's file itself (for the full information
        matrices, which our graphs do not keep); the path is passed as its setting ``source``
    cost, kernel : the cost that it minimises, see `certpgo.objective.choose_cost`
    """

    solver: str = ""
    label: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    start: Competitor | None = None
    takes: Literal["", "poses", "rotations"] = ""
    reads_source: bool = False
    cost: str = CHORDAL
    kernel: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))
        if not self.label:
            object.__setattr__(self, "label", self.solver or "graph")

    def suits(self, graph: Graph) -> bool:
        """Whether the method runs on graphs of this kind."""
        return self.takes in ("", graph.kind)


#: The label of the method that reads the graph's file itself.
OF_THE_FILE = "gtsam_gauss_newton (file)"
_CERTIFIED = Competitor("certified")
_EIGEN_MA = Competitor("eigen_ma", takes="poses")
_EIGEN_RA = Competitor("eigen_ra", takes="rotations")
#: Methods compared by default.
METHODS = (
    _CERTIFIED,
    Competitor("spanning_tree"),
    _EIGEN_MA,
    Competitor("eigen_ma", "eigen_ma (unit weights)", {"weights": "unit"}, takes="poses"),
    Competitor("eigen_q", takes="poses"),
    Competitor("fixed_point", "eigen_ma + fixed_point", start=_EIGEN_MA, takes="poses"),
    Competitor("newton", "eigen_ma + newton", start=_EIGEN_MA, takes="poses"),
    _EIGEN_RA,
    Competitor("laplacian_gauss_newton", takes="rotations"),
    Competitor("fixed_point", "eigen_ra + fixed_point", start=_EIGEN_RA, takes="rotations"),
    Competitor("newton", "eigen_ra + newton", start=_EIGEN_RA, takes="rotations"),
    Competitor("gtsam_chordal", takes="poses"),
    Competitor("gtsam_gauss_newton", takes="poses"),
    Competitor("gtsam_levenberg_marquardt", takes="poses"),
    Competitor("gtsam_fastsync"),
    Competitor("g2o_gauss_newton", takes="poses"),
    Competitor("g2o_levenberg_marquardt", takes="poses"),
    Competitor("ceres_levenberg_marquardt", takes="poses"),
    Competitor(
        "gtsam_gauss_newton",
        OF_THE_FILE,
        takes="poses",
        reads_source=True,
    ),
)
#: Shape of the rows in files and JSON documents.
SCHEMA = 2


@dataclass(frozen=True)
class MethodResult:
    """The result of a method on a connected graph, or its error.

    Attributes
    ----------
    graph, d, nodes, edges, reading : the graph, and how it was read; None and empty if it could not
        be read, or is not connected
    method, settings : the label, and the settings that differ from the default; empty, like the
        next two, for a graph that could not be read or does not have the cost
    objective : the cost that judges the estimate, as in `certpgo.Certificate`
    minimised : the cost that the method was given, see `certpgo.objective.choose_cost`; a
        method that reads the graph's file minimises its own
    error : why there is no estimate (the fields below are then empty), or empty
    status, iterations, seconds, note : as in `certpgo.Solution`
    cost : the objective of all measurements
    f_ml : the thesis' log-likelihood with unit weights; larger is better
    certified_cost : the objective of the measurements that the verdict is about, rounded up
    kept : share of the measurements that a robust method kept, or None
    accuracy : as in `certpgo.solve.metrics.TrajectoryErrors`, if the truth was given; else empty
    verdict, lower_bound, gap, relative_gap : as in `certpgo.Certificate`, for the kept measurements
    distance_m, distance_deg : the largest distance and angle of any node from where any optimum of
        these has it, as in `certpgo.certify.region.ProvenDistance`; None where nothing is known
    """

    graph: str
    d: int | None = None
    nodes: int | None = None
    edges: int | None = None
    reading: Mapping[str, str] = field(default_factory=dict)
    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    objective: str = ""
    minimised: str = ""
    error: str = ""
    status: str = ""
    iterations: int = 0
    seconds: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    cost: float | None = None
    f_ml: float | None = None
    kept: float | None = None
    verdict: str = ""
    lower_bound: float | None = None
    gap: float | None = None
    relative_gap: float | None = None
    distance_m: float | None = None
    distance_deg: float | None = None
    certified_cost: float | None = None
    accuracy: Mapping[str, float | None] = field(default_factory=dict)


def methods_under(
    cost: str, methods: Iterable[Competitor] = METHODS, kernel: str = ""
) -> tuple[Competitor, ...]:
    """The methods with a cost to minimise where they can; the others minimise F.

    The certified pipeline is also there for F, labelled so. It alone minimises under kernels.
    """
    if kernel:
        under = replace(_CERTIFIED, cost=cost, kernel=kernel)
        of_f = replace(_CERTIFIED, label="certified (F)")
        listed = ((under, of_f) if method == _CERTIFIED else (method,) for method in methods)
        return tuple(itertools.chain.from_iterable(listed))
    if cost == CHORDAL:
        return tuple(methods)
    chosen: list[Competitor] = []
    for method in methods:
        if method.reads_source or not _minimises(method, cost):
            chosen.append(method)
            continue
        chosen.append(replace(method, cost=cost))
        if method == _CERTIFIED:
            chosen.append(replace(method, label="certified (F)"))
    return tuple(chosen)


def _minimises(method: Competitor, cost: str) -> bool:
    try:
        solver = registry.get_solver(method.solver)
    except CertPGOError:  # its row will say so
        return False
    return cost in getattr(solver, "own_costs", ())


def compare(
    instance: Instance | Graph | AnyPath,
    methods: Iterable[Competitor] | None = None,
    *,
    cost: str | None = None,
    kernel: str | None = None,
    announce: Callable[[str], None] = lambda label: None,
    errors: Callable[[Estimate], TrajectoryErrors] | None = None,
) -> Iterator[MethodResult]:
    """Run methods on a connected graph in turn and certify their estimates.

    Estimates of all measurements are judged by one `certpgo.solve.judging.Judge`: they share the
    best bound so far. A method that fails, or whose package is not installed, gives a row with the
    reason.

    Parameters
    ----------
    methods : by default `METHODS`, as `methods_under` the cost
    cost : the cost that judges all estimates, whichever each method minimises: ``"chordal"``, or
        for an instance with information matrices ``"g2o"`` or ``"gtsam"``, see
        `certpgo.objective.choose_cost`. By default that of its `own_cost`, as for `certpgo.solve`
    kernel : a robust kernel of that cost, such as ``"huber:5deg"``
    announce : called with the label of each method before it runs
    errors : the errors of an estimate, if the truth is known

    Raises
    ------
    InputError
        The instance does not have this cost.
    KeyboardInterrupt
        Ctrl-C, also where a method returns an estimate after it.
    """
    instance = as_instance(instance, "compare")
    if methods is not None:
        require(methods, Iterable, "a list of Competitors")
    require_capable(instance.graph, "compare", instance.name)
    cost = own_cost(instance) if cost is None else cost
    posed = objective_of(instance, cost, kernel)
    judge = Judge(posed)
    objective = OF_F if posed.is_chordal else posed.title
    for method in methods_under(cost, kernel=kernel or "") if methods is None else methods:
        require(method, Competitor, "a Competitor")
        announce(method.label)
        blank = MethodResult(
            instance.name,
            posed.d,
            posed.n,
            posed.graph.num_measurements,
            dict(instance.options),
            method.label,
            dict(method.settings),
            objective,
            f"{method.cost}, {method.kernel}" if method.kernel else method.cost,
        )
        try:
            problem, left_out = _given(posed, method)
            if posed.measured.blocks and not left_out:
                blank = replace(blank, minimised=f"{method.cost} with {_others(posed)}")
            solution = solution_of(method, problem, instance)
            note = "; ".join(filter(None, (left_out, solution.note)))
            solution = replace(solution, note=note)
            accuracy = {} if errors is None else asdict(errors(solution.estimate))
            yield replace(_result(blank, solution, posed, judge), accuracy=accuracy)
        except CertPGOError as error:
            yield replace(blank, error=str(error))
        except MemoryError:
            yield replace(blank, error="not enough memory")
        except Exception as error:  # a failing method must not end the comparison
            yield replace(blank, error=in_one_line(error))


def _given(posed: Quadratic | Sum, method: Competitor) -> tuple[Quadratic | Sum, str]:
    """What a method is given under F, and what that leaves out, in a sentence."""
    if not posed.measured.blocks:
        return posed.chordal, ""
    if _minimises(method, CHORDAL):
        return (posed if posed.cost_name == CHORDAL else posed.isotropic), ""
    return Quadratic(posed.measured.with_blocks()), f"minimises F without {_others(posed)}"


def _others(posed: Quadratic | Sum) -> str:
    """What is measured besides edges."""
    return listed([block.kind.plural for block in posed.measured.blocks])


def _result(
    blank: MethodResult, solution: Solution, problem: Quadratic | Sum, judge: Judge
) -> MethodResult:
    if solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    if solution.weights is None:
        certificate = judge.certify(solution.estimate)
    else:
        certificate, _ = certified(solution, problem)
    distance_m, distance_deg = limits(certificate.stated_distance())
    graph = problem.chordal.graph
    weights = None if solution.weights is None else solution.weights[graph.is_measured]
    return replace(
        blank,
        status=solution.status.value,
        iterations=solution.iterations,
        seconds=dict(solution.seconds),
        note=solution.note,
        cost=problem.cost(solution.estimate),
        f_ml=f_ml(graph, solution.estimate),
        kept=None if weights is None else float((weights > 0.0).mean()),
        verdict=certificate.verdict.value,
        lower_bound=certificate.lower_bound,
        gap=certificate.gap,
        relative_gap=certificate.relative_gap,
        distance_m=distance_m,
        distance_deg=distance_deg,
        certified_cost=certificate.cost_upper,
    )


def solution_of(
    method: Competitor,
    problem: Quadratic | Sum,
    instance: Instance | None = None,
    *,
    settings: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Solution:
    """The method's solution, from the initial estimate of its ``start`` method if it has one.

    Parameters
    ----------
    problem : the chordal one
    instance : that of the problem, for methods that read its file or its information matrices
    settings : further settings by method label

    Raises
    ------
    SpecError
        The method or a setting is unknown, or the method does not take this kind of problem or
        cost.
    """
    own = {**method.settings, **settings.get(method.label, {})}
    if method.reads_source:
        own["source"] = "" if instance is None else instance.source
    solver = registry.build(method.solver, own, problem.graph)
    posed: Quadratic | Sum = problem
    if method.cost != CHORDAL or method.kernel:
        minimised = getattr(solver, "own_costs", ())
        if instance is None or (method.cost in COSTS and method.cost not in minimised):
            raise SpecError(f"{method.solver} does not minimise the cost {method.cost}")
        posed = objective_of(instance, method.cost, method.kernel or None)
    if method.start is None:
        return _timed(solver, posed)
    start = solution_of(method.start, problem, instance, settings=settings)
    solution = _timed(solver, posed, start.estimate)
    spent = sum(start.seconds.values())
    return replace(
        solution,
        seconds={method.start.label: spent, **solution.seconds},
        trace=tuple(replace(it, seconds=it.seconds + spent) for it in solution.trace),
    )


def certified(solution: Solution, problem: Quadratic | Sum) -> tuple[Certificate, float]:
    """The certificate for the measurements that the method kept, and its run time in seconds."""
    start = time.perf_counter()
    certificate = certify(solution.judged(problem), solution.estimate)
    return certificate, time.perf_counter() - start


def as_data(result: MethodResult) -> dict[str, Any]:
    """The row of a result in files: the number of its shape, then the fields."""
    return {"schema": SCHEMA, **asdict(result)}


def read_results(path: Path) -> list[MethodResult] | None:
    """The results in a file that `certpgo compare` wrote; None where its rows are of another kind.

    Raises
    ------
    FormatError
        A line is no such result.
    """
    results = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        try:
            row = dict(json.loads(line))
            if row.pop("schema", None) != SCHEMA:
                return None
            results.append(MethodResult(**row))
        except (ValueError, TypeError):
            raise FormatError(
                path, number, "a result expected, as certpgo compare writes"
            ) from None
    return results


def in_one_line(error: Exception) -> str:
    """A foreign error in one line: its type and the first line of its message."""
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def _timed(solver: Solver, problem: Quadratic | Sum, initial: Estimate | None = None) -> Solution:
    """The method's solution, on one thread; if it reports no phases, it is timed as a whole."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):  # of OpenMP, too, which other programs use
        start = time.perf_counter()
        solution = solver.solve(problem, initial=initial)  # type: ignore[arg-type]
    elapsed = time.perf_counter() - start
    return solution if solution.seconds else replace(solution, seconds={"solve": elapsed})
