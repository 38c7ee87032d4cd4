"""Methods compared on a graph: cost, proven gap, verdict and run time of each."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any, Literal

from certpgo import registry
from certpgo.assess.metrics import f_ml
from certpgo.assess.wording import reading_sentence
from certpgo.certify import Certificate, certify
from certpgo.costs import CHORDAL, InformationProblem, information_problem
from certpgo.errors import CertPGOError, SpecError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.io.plural import counted
from certpgo.objective.problem import Problem, problem_of
from certpgo.optimize.solution import Solution, Solver, Status


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
    cost : the cost that it minimises, see `certpgo.costs`
    """

    solver: str = ""
    label: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
    start: Competitor | None = None
    takes: Literal["", "poses", "rotations"] = ""
    reads_source: bool = False
    cost: str = CHORDAL

    def __post_init__(self) -> None:
        object.__setattr__(self, "settings", MappingProxyType(dict(self.settings)))
        if not self.label:
            object.__setattr__(self, "label", self.solver or "graph")

    def suits(self, graph: Graph) -> bool:
        """Whether the method runs on graphs of this kind."""
        return self.takes in ("", graph.kind)


#: The label of the method that reads the graph's file itself.
_OF_THE_FILE = "gtsam_gauss_newton (file's information)"
_EIGEN_MA = Competitor("eigen_ma", takes="poses")
_EIGEN_RA = Competitor("eigen_ra", takes="rotations")
#: Methods compared by default.
METHODS = (
    Competitor("certified"),
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
    Competitor(
        "gtsam_gauss_newton",
        _OF_THE_FILE,
        takes="poses",
        reads_source=True,
    ),
)
TITLE = "Methods side by side, every estimate certified by the same procedure"
#: Notes printed below the tables; see `notes`.
NOTES = (
    "F is the weighted squared error that is minimised, f_ML the thesis' log-likelihood with "
    "unit weights. The gap is proven: no estimate of the graph costs less than this one by more "
    "than the gap. If a method rejects measurements (see the share kept), verdict and gap refer "
    "to the kept ones, F and f_ML to all. CERTIFIED: the gap is at most 1e-5 F. BOUNDED: it is "
    "larger. REFUTED: a lower-cost estimate is known that local descent from this one does not "
    "reach.",
    "GTSAM gets the weights of F: its own error then differs from F by terms of fourth order in "
    "the residuals.",
    f"In the row {_OF_THE_FILE}, GTSAM reads the file itself and minimises its own error with the "
    "file's full information matrices.",
    "Seconds are those of one run, without reading and certifying.",
)
#: Methods without which a note is left out, by the beginnings of their labels.
_ABOUT = {NOTES[1]: "gtsam", NOTES[2]: _OF_THE_FILE}
#: Shape of the rows in files and JSON documents.
SCHEMA = 2
#: Column titles of `cells`.
COLUMNS = ("method", "F", "f_ML", "gap", "gap / F", "verdict", "kept, %", "seconds (by phase)")


@dataclass(frozen=True)
class MethodResult:
    """The result of a method on a connected graph, or its error.

    Attributes
    ----------
    graph, d, nodes, edges, reading : the graph, and how it was read; None and empty if it could not
        be read, or is not connected
    method, settings : the label, and the settings that differ from the default; empty for a graph
        that could not be read
    error : why there is no estimate (the fields below are then empty), or empty
    status, iterations, seconds, note : as in `certpgo.Solution`
    cost : F of all measurements
    f_ml : the thesis' log-likelihood with unit weights; larger is better
    kept : share of the measurements that a robust method kept, or None
    verdict, lower_bound, gap, relative_gap : as in `certpgo.Certificate`, for the kept measurements
    """

    graph: str
    d: int | None = None
    nodes: int | None = None
    edges: int | None = None
    reading: Mapping[str, str] = field(default_factory=dict)
    method: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)
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


def compare(
    instance: Instance,
    methods: Iterable[Competitor] = METHODS,
    *,
    announce: Callable[[str], None] = lambda label: None,
) -> Iterator[MethodResult]:
    """Run methods on a connected graph in turn and certify their estimates.

    A method that fails, or whose package is not installed, gives a row with the reason.

    Parameters
    ----------
    announce : called with the label of each method before it runs

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C, also where a method returns an estimate after it.
    """
    problem = problem_of(instance.graph)
    for method in methods:
        announce(method.label)
        blank = MethodResult(
            instance.name,
            problem.d,
            problem.n,
            problem.graph.num_edges,
            dict(instance.options),
            method.label,
            dict(method.settings),
        )
        try:
            yield _result(blank, method, problem, instance)
        except CertPGOError as error:
            yield replace(blank, error=str(error))
        except MemoryError:
            yield replace(blank, error="not enough memory")
        except Exception as error:  # a failing method must not end the comparison
            yield replace(blank, error=in_one_line(error))


def _result(
    blank: MethodResult, method: Competitor, problem: Problem, instance: Instance
) -> MethodResult:
    solution = solution_of(method, problem, instance)
    if solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    certificate, _ = certified(solution, problem)
    kept = solution.kept
    return replace(
        blank,
        status=solution.status.value,
        iterations=solution.iterations,
        seconds=dict(solution.seconds),
        note=solution.note,
        cost=problem.cost(solution.estimate),
        f_ml=f_ml(problem.graph, solution.estimate),
        kept=None if kept is None else kept / problem.graph.num_edges,
        verdict=certificate.verdict.value,
        lower_bound=certificate.lower_bound,
        gap=certificate.gap,
        relative_gap=certificate.relative_gap,
    )


def solution_of(
    method: Competitor,
    problem: Problem,
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
    solver = registry.build(method.solver, own)
    registry.refuse_unsuited(method.solver, solver, problem.graph)
    posed: Problem | InformationProblem = problem
    if method.cost != CHORDAL:
        if instance is None or not getattr(solver, "own_costs", False):
            raise SpecError(f"{method.solver} does not minimise the cost {method.cost}")
        posed = information_problem(instance, method.cost)
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


def certified(
    solution: Solution, problem: Problem | InformationProblem
) -> tuple[Certificate, float]:
    """The certificate for the measurements that the method kept, and its run time in seconds."""
    start = time.perf_counter()
    judged = problem if isinstance(problem, InformationProblem) else solution.judged(problem)
    certificate = certify(judged, solution.estimate)
    return certificate, time.perf_counter() - start


def as_data(result: MethodResult) -> dict[str, Any]:
    """The row of a result in files: the number of its shape, then the fields."""
    return {"schema": SCHEMA, **asdict(result)}


def in_one_line(error: Exception) -> str:
    """A foreign error in one line: its type and the first line of its message."""
    return f"{type(error).__name__}: {str(error).partition(chr(10))[0]}"


def notes(labels: Iterable[str]) -> tuple[str, ...]:
    """The notes about these methods."""
    present = tuple(labels)
    return tuple(
        note for note in NOTES if any(label.startswith(_ABOUT.get(note, "")) for label in present)
    )


def title(result: MethodResult) -> str:
    """Name and size of the graph."""
    if result.nodes is None or result.edges is None or result.d is None:
        return result.graph
    return f"{result.graph} ({sizes(result.nodes, result.edges, result.d)})"


def sizes(nodes: int, edges: int, d: int) -> str:
    """The size of a graph in words."""
    return f"{counted(nodes, 'node{s}')}, {counted(edges, 'edge{s}')}, {d}D"


def captions(results: Sequence[MethodResult]) -> Iterator[str]:
    """How the graph was read, and the methods' remarks."""
    yield f"Read with {reading_sentence(results[0].reading)}."
    yield from remarks((result.method, result.note) for result in results)


def remarks(notes: Iterable[tuple[str, str]]) -> Iterator[str]:
    """One sentence per distinct note, naming its methods."""
    methods: dict[str, list[str]] = {}
    for method, note in notes:
        if note:
            methods.setdefault(note, []).append(method)
    for note, names in methods.items():
        yield f"{', '.join(names)}: {note}."


def cells(result: MethodResult) -> tuple[str, ...]:
    """A method's row: one text per column of `COLUMNS`, then the error."""
    kept = None if result.kept is None else 100.0 * result.kept
    return (
        result.method,
        _number(result.cost, ".9g"),
        _number(result.f_ml, ".7g"),
        _number(result.gap, ".2e"),
        _number(result.relative_gap, ".1e"),
        result.verdict,
        _number(kept, ".1f"),
        seconds_by_phase(result.seconds),
        result.error,
    )


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def seconds_by_phase(phases: Mapping[str, float]) -> str:
    """Total seconds, and those of each phase if there are several."""
    if not phases:
        return ""
    parts = ", ".join(f"{name} {value:.3f}" for name, value in phases.items())
    return f"{sum(phases.values()):.3f}" + (f" ({parts})" if len(phases) > 1 else "")


def _timed(
    solver: Solver, problem: Problem | InformationProblem, initial: Estimate | None = None
) -> Solution:
    """The method's solution, on one thread; if it reports no phases, it is timed as a whole."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):
        start = time.perf_counter()
        solution = solver.solve(problem, initial=initial)  # type: ignore[arg-type]
    elapsed = time.perf_counter() - start
    return solution if solution.seconds else replace(solution, seconds={"solve": elapsed})
