"""How far phases are from what this core can do: flops at its peak, bytes at its bandwidth."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import blas

from certpgo import certify
from certpgo.errors import MissingDependency
from certpgo.graph import Instance
from certpgo.io import datasets
from certpgo.io.datasets import synthetic
from certpgo.linalg import compiled, factor, multifrontal
from certpgo.linalg.arrays import CSC, FloatArray
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.multifrontal import Fronts, Tree
from certpgo.objective.choose_cost import CHORDAL
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.solving import solve
from reports.harness.experiments.timing import processor_seconds
from reports.harness.speed.measuring import Comparison, Group, Lap, Timer, Timers, processor
from reports.harness.speed.solving import certifying, finished, shares, solving

SECTION = "times the limit"
#: Turns of helices: 10,000 to 100,000 poses.
TURNS, QUICK_TURNS = (100, 200, 316), (10,)
#: Public sets beside them.
SETS = ("sphere2500", "torus3D")
#: What a ratio is called large above.
LARGE = 3.0
#: Rows of the products that show the peak, and megabytes that are copied.
ROWS, COPIED = 1024, 64
#: Shift over the mean diagonal, which makes a semidefinite matrix definite.
SHIFT = 1e-6
BYTES = {"single": 4, "double": 8}
ORDERING, ANALYSIS = "fill-reducing order", "analysis"
ASSEMBLY, GRADIENT = "Newton's matrix, assembled", "gradient"
SINGLE, DOUBLE = "factor of Newton's matrix, single", "factor of Newton's matrix, double"
SUBSTITUTION, PRODUCT = "solution with the single factor", "product with Newton's matrix"
ROUNDING = "factor of the certificate's matrix, with row sums"
COSTS = (CHORDAL, "g2o", "gtsam")
PHASES = (
    ORDERING,
    ANALYSIS,
    ASSEMBLY,
    GRADIENT,
    SINGLE,
    DOUBLE,
    SUBSTITUTION,
    PRODUCT,
    ROUNDING,
)


@dataclass
class Work:
    """What a phase does at least: flops in each precision, and bytes that are read or written."""

    single: float = 0.0
    double: float = 0.0
    moved: float = 0.0

    def timer(self) -> Timer:
        """The time that this takes at the peaks and the bandwidth of the moment."""
        peaks = {name: flops for name in BYTES if (flops := getattr(self, name))}

        def lap() -> Lap:
            rates = {name: peak(name) for name in peaks}
            seconds = sum(flops / rates[name] for name, flops in peaks.items())
            said = [f"{rates[name] / 1e9:.0f} GFlop/s in {name}" for name in peaks]
            if self.moved:
                bandwidth = copied_per_second()
                seconds += self.moved / bandwidth
                said.append(f"{bandwidth / 1e9:.1f} GB/s")
            return Lap(seconds, ", ".join(said))

        return lap


def groups(quick: bool) -> Iterator[Group]:
    """Helices of growing size, and public sets, under F."""
    whole = (*PHASES, solving(CHORDAL), certifying(CHORDAL))
    compared = tuple(Comparison(phase, limit_of(phase), LARGE) for phase in whole)
    for turns in QUICK_TURNS if quick else TURNS:
        timers = functools.partial(_graph, functools.partial(_helix, turns))
        subject = f"helix of {turns**2:,} poses"
        yield Group(SECTION, subject, timers, compared, 1 if quick else 2, size=turns**2)
    for name in () if quick else SETS:
        read = functools.partial(datasets.load, name, download=False, quiet=True)
        own = (Comparison(solving(cost), limit_of(solving(cost)), LARGE) for cost in COSTS[1:])
        yield Group(SECTION, name, functools.partial(_graph, read, COSTS), (*compared, *own), 2)


def limit_of(phase: str) -> str:
    """What a phase is compared with."""
    return f"limit of {phase}"


def _helix(turns: int) -> Instance:
    return synthetic.helix(turns, np.random.default_rng(0))


@contextmanager
def _graph(made: Callable[[], Instance], costs: Sequence[str] = COSTS[:1]) -> Iterator[Timers]:
    if not compiled.AVAILABLE:
        raise MissingDependency("the compiled engine", remedy=compiled.COMPILED)
    graph: Any = made().graph
    estimate = finished(solve(graph, cost=CHORDAL)).estimate
    problem = Quadratic(graph)
    steps, work = _phases(problem, estimate)
    whole: dict[str, Callable[[], Any]] = {
        certifying(CHORDAL): lambda: certify(graph, estimate, cost=CHORDAL)
    }
    for cost in costs:
        whole[solving(cost)] = functools.partial(_solved, graph, cost)
    for name, step in whole.items():
        with counting() as total:
            step()
        work[name] = total
    say = {solving(cost): shares for cost in costs}
    yield {name: processor(step, say.get(name)) for name, step in (steps | whole).items()} | {
        limit_of(name): least.timer() for name, least in work.items()
    }


def _solved(graph: Any, cost: str) -> Any:
    return finished(solve(graph, cost=cost))


def _phases(
    problem: Quadratic, estimate: Any
) -> tuple[dict[str, Callable[[], Any]], dict[str, Work]]:
    """What is done inside, and the least work of each."""
    pattern, graph = problem.pattern, problem.graph
    indptr, indices = pattern.indptr, pattern.indices
    H, S = _definite(problem.gauss_newton(estimate)), _definite(problem.matrix)
    (newton, entries), (dual, of_dual) = _fronts(problem, H), _fronts(problem, S)
    weights = np.ones((dual.size, 2))
    panels = newton.factor_kept_single(entries, H.diagonal())
    if panels is None:
        raise ArithmeticError("a definite matrix has no factor")
    right = np.ones(newton.size)
    none = np.zeros_like(estimate.rotations)
    steps: dict[str, Callable[[], Any]] = {
        ORDERING: lambda: factor.fill_reducing_order(indptr, indices),
        ANALYSIS: lambda: Tree.of(indptr, indices, problem.order),
        ASSEMBLY: lambda: pattern.assemble(*problem.hessian(estimate, none), problem.d),
        GRADIENT: lambda: problem.gradient(estimate),
        SINGLE: lambda: newton.factor_kept_single(entries, H.diagonal()),
        DOUBLE: lambda: newton.factor(entries),
        SUBSTITUTION: lambda: panels.solve(right),
        PRODUCT: lambda: newton.multiply(entries, right),
        ROUNDING: lambda: dual.row_sums(of_dual, weights),
    }
    of_edges = float(_bytes(graph.edges, graph.rotations, graph.translations))
    of_nodes = float(_bytes(estimate.rotations, estimate.translations))
    of_pattern = float(_bytes(indptr, indices))
    flops = flops_of(newton)
    work = {
        ORDERING: Work(moved=of_pattern),
        ANALYSIS: Work(moved=of_pattern),
        ASSEMBLY: Work(moved=of_edges + of_nodes + entries.nbytes),
        GRADIENT: Work(moved=of_edges + 2.0 * of_nodes),
        SINGLE: Work(single=flops),
        DOUBLE: Work(double=flops),
        SUBSTITUTION: Work(moved=substituted(newton, "single")),
        PRODUCT: Work(moved=multiplied(newton, entries)),
        ROUNDING: Work(double=flops_of(dual)),
    }
    return steps, work


def _fronts(problem: Quadratic, A: CSC) -> tuple[Fronts, FloatArray]:
    """The fronts of a matrix of this graph, and its entries."""
    tree = Tree.of(problem.pattern.indptr, problem.pattern.indices, problem.order)
    sizes = problem.pattern.layout_of(A).sizes
    return Fronts(tree, sizes), np.ascontiguousarray(A.data, dtype=np.float64)


def _definite(A: CSC) -> CSC:
    return add_to_diagonal(A, SHIFT * float(A.diagonal().mean()))


def _bytes(*arrays: Any) -> int:
    return sum(array.nbytes for array in arrays)


def flops_of(fronts: Fronts) -> float:
    """Additions and multiplications of a Cholesky factorization: squares of L's column lengths."""
    tree = fronts.tree
    lengths = np.diff(fronts.offset)
    below = np.concatenate([[0], np.cumsum(lengths[tree.rows])])
    width = np.diff(fronts.offset[tree.start]).astype(float)
    height = width + np.diff(below[tree.begin])
    squares = width * height**2 - height * width * (width - 1.0)
    return float((squares + width * (width - 1.0) * (2.0 * width - 1.0) / 6.0).sum())


def substituted(fronts: Fronts, precision: str) -> float:
    """Bytes of a solution: L is read twice."""
    return 2.0 * BYTES[precision] * fronts.entries


def multiplied(fronts: Fronts, data: FloatArray) -> float:
    """Bytes of a product: entries are read once, and two vectors moved."""
    return float(data.nbytes) + 2.0 * BYTES["double"] * fronts.size


@contextmanager
def counting() -> Iterator[Work]:
    """The work of factorizations, solutions and products during the block."""
    total = Work()
    own = {name: getattr(Fronts, name) for name in ("eliminate", "solve", "multiply")}
    eliminate, solution, product = own.values()

    def eliminating(self: Fronts, data: FloatArray, **options: Any) -> Any:
        kind = "single" if options.get("keep") == "single" else "double"
        setattr(total, kind, getattr(total, kind) + flops_of(self))
        return eliminate(self, data, **options)

    def substituting(self: Fronts, panels: multifrontal.Kept, *rest: Any) -> Any:
        kind = "single" if panels.dtype == np.float32 else "double"
        total.moved += substituted(self, kind)
        return solution(self, panels, *rest)

    def multiplying(self: Fronts, data: FloatArray, x: FloatArray) -> Any:
        total.moved += multiplied(self, data)
        return product(self, data, x)

    replaced = {"eliminate": eliminating, "solve": substituting, "multiply": multiplying}
    try:
        for name, function in replaced.items():
            setattr(Fronts, name, function)
        yield total
    finally:
        for name, function in own.items():
            setattr(Fronts, name, function)


def peak(precision: str) -> float:
    """Flops per second of a product of dense matrices."""
    A = _ones(precision)
    multiply = blas.sgemm if precision == "single" else blas.dgemm
    begin = processor_seconds()
    multiply(1.0, A, A)
    return 2.0 * ROWS**3 / (processor_seconds() - begin)


@functools.cache
def _ones(precision: str) -> Any:
    return np.ones((ROWS, ROWS), dtype=f"f{BYTES[precision]}", order="F")


def copied_per_second() -> float:
    """Bytes read and written per second while a large array is copied."""
    source, target = _arrays()
    begin = processor_seconds()
    np.copyto(target, source)
    return 2.0 * source.nbytes / (processor_seconds() - begin)


@functools.cache
def _arrays() -> tuple[FloatArray, FloatArray]:
    return np.ones(COPIED * 125_000), np.ones(COPIED * 125_000)
