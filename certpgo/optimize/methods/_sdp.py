"""The common part of both semidefinite programs: settings, CVXPY's solvers, rounding."""

from __future__ import annotations

import importlib.util
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from certpgo.errors import MissingDependency, NumericalError, SpecError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.iterative import Settings
from certpgo.optimize.methods import _memory
from certpgo.optimize.methods._relaxed import (
    Scaled,
    leading_rows,
    made_feasible,
    null_space_rotations,
    remark_on,
)
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Relaxation, Solution, Status

#: CVXPY's statuses that come with a solution.
STATUSES = {
    "optimal": Status.CONVERGED,
    "optimal_inaccurate": Status.STALLED,
    "user_limit": Status.ITERATION_LIMIT,
}


#: The packages cvxpy and cvxpy-base have the same files: uninstalling one takes the other's.
INSTALL_CVXPY = "pip install --force-reinstall --no-deps cvxpy-base"


@dataclass(frozen=True)
class Program:
    """A solver of semidefinite programs, called through CVXPY.

    Attributes
    ----------
    package : name for pip
    module : name of its Python module
    tolerances : its settings for tolerances
    iterations : its setting for the maximal number of iterations
    tolerance : the default; None for the solver's own
    group : CVXPY's argument that contains these settings, if any
    """

    package: str
    module: str
    tolerances: tuple[str, ...] = ()
    iterations: str = ""
    tolerance: float | None = None
    group: str = ""


_MOSEK = "MSK_DPAR_INTPNT_CO_TOL_"
#: By CVXPY's names.
PROGRAMS = {
    # The solver's own 1e-8 saves three iterations, and gives F to 1e-6 at best.
    "CLARABEL": Program(
        "clarabel", "clarabel", ("tol_gap_abs", "tol_gap_rel", "tol_feas"), "max_iter", 1e-10
    ),
    "COPT": Program("coptpy", "coptpy"),
    "CVXOPT": Program("cvxopt", "cvxopt", ("abstol", "reltol", "feastol"), "max_iters"),
    "MOSEK": Program(
        "mosek",
        "mosek",
        (f"{_MOSEK}REL_GAP", f"{_MOSEK}PFEAS", f"{_MOSEK}DFEAS"),
        "MSK_IPAR_INTPNT_MAX_ITERATIONS",
        group="mosek_params",
    ),
    "SCS": Program("scs", "scs", ("eps_abs", "eps_rel"), "max_iters"),
    "SDPA": Program("sdpa-python", "sdpap", ("epsilonStar", "epsilonDash"), "maxIteration"),
}


@dataclass(frozen=True, eq=False)
class ConicSolution:
    """What a solver returned, for the scaled problem.

    Attributes
    ----------
    multipliers : (n, d, d), or None
    gram : (dn, dn), or None
    """

    multipliers: FloatArray | None
    gram: FloatArray | None


@dataclass(frozen=True, eq=False)
class Posed:
    """A program for CVXPY.

    Attributes
    ----------
    problem : the cvxpy.Problem
    read : the values of its variables, once solved
    """

    problem: Any
    read: Callable[[], ConicSolution]


@dataclass(frozen=True)
class Semidefinite(Settings, ABC):
    """Settings of the programs, and how they are solved.

    Attributes
    ----------
    program : the solver, by CVXPY's name: CLARABEL, or another of `PROGRAMS` that is installed
    chordal : whether Clarabel decomposes a sparse matrix into its cliques; other solvers never do
    tolerance : of the solver, in its own terms; None is its default, 1e-10 for Clarabel
    max_iterations : of the solver; None is its default
    force : solve even if memory seems too small
    """

    program: str = "CLARABEL"
    chordal: bool = True
    tolerance: float | None = None
    max_iterations: int | None = None
    force: bool = False

    takes_initial: ClassVar[bool] = False
    compiled: ClassVar[bool] = True
    #: Whether the semidefinite matrix is as sparse as the graph.
    decomposable: ClassVar[bool]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.program not in PROGRAMS:
            raise SpecError.unknown("program", self.program, PROGRAMS)
        if self.tolerance is not None and not 0.0 < self.tolerance < 1.0:
            raise SpecError(f"tolerance must lie between 0 and 1, not {self.tolerance}")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise SpecError("max_iterations must be at least 1")
        self.options()

    @abstractmethod
    def library(self) -> Any:
        """CVXPY, imported only by the programs' own files."""

    @abstractmethod
    def pose(self, cp: Any, data: Scaled) -> Posed:
        """The program of a scaled problem for CVXPY, ``cp``."""

    @abstractmethod
    def scalars(self, n: int, d: int) -> int:
        """Number of unknowns."""

    def solve(
        self, problem: Quadratic, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations rounded from the program's solution, and optimal translations.

        The program is convex, and its solver calls nothing back: ``initial`` and ``monitor`` are
        not used.
        """
        if initial is not None:
            problem.check(initial)
        self._require()
        rotation, d, N = problem.rotation, problem.d, problem.n * problem.d
        if not self.force:
            what = f"{type(self).__module__.rpartition('.')[2]} with {self.program}"
            instead = "program=SCS", _memory.bytes_needed("SCS", N, N, ())
            # First a lower bound: finding cliques takes a while.
            _memory.refuse(_memory.bytes_needed(self.program, N, N, ()), what, *instead)
            _memory.refuse(self.bytes_needed(rotation), what, *instead)
        cp = self.library()  # importing it is not timed
        watch, data = Stopwatch(), Scaled(rotation)
        with watch.phase("model"):
            posed = self.pose(cp, data)
        with watch.phase("solve"):
            conic = self._run(posed)
        multipliers = feasible = rows = None
        with watch.phase("bound"):
            if conic.multipliers is not None:
                multipliers = data.multipliers(conic.multipliers)
                feasible = made_feasible(data, multipliers)
        with watch.phase("round"):
            if conic.gram is not None:
                rows = leading_rows(data.gram(conic.gram), d)
                R = rounded(Lift(rows)).rotations
            elif feasible is not None:
                R = null_space_rotations(rotation, feasible)
            else:
                raise NumericalError(f"{self.program} returned neither Lambda nor Y")
            estimate = problem.complete(R)
        value, status = data.unit * float(posed.problem.value), str(posed.problem.status)
        rank = None if rows is None else rows.shape[1]
        relaxation = Relaxation(value, status, multipliers, rows, rank)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=STATUSES[status],
            iterations=int(posed.problem.solver_stats.num_iters or 0),
            lower_bound=None if feasible is None else feasible.value,
            seconds=watch.seconds,
            note=f"{self.program}: {remark_on(problem, relaxation)}",
            relaxation=relaxation,
        )

    def options(self) -> dict[str, Any]:
        """The solver's own settings; SpecError if its name for one is unknown."""
        program = PROGRAMS[self.program]
        inner: dict[str, Any] = {}
        tolerance = program.tolerance if self.tolerance is None else self.tolerance
        limit = (program.iterations,) if program.iterations else ()
        for what, value, names in (
            ("tolerance", tolerance, program.tolerances),
            ("max_iterations", self.max_iterations, limit),
        ):
            if value is not None:
                if not names:
                    raise SpecError(f"{what} cannot be set for {self.program}: leave it at none")
                inner.update(dict.fromkeys(names, value))
        if self.program == "CLARABEL":
            inner["chordal_decomposition_enable"] = self.chordal
        return {program.group: inner} if program.group and inner else inner

    def bytes_needed(self, problem: Quadratic) -> float:
        """Peak memory of solving, roughly; see `_memory`."""
        N, m = problem.n * problem.d, self.scalars(problem.n, problem.d)
        cones = [N]
        if self.program == "CLARABEL" and self.chordal and self.decomposable:
            cones = [problem.d * size for size in _memory.clique_sizes(problem)]
        return _memory.bytes_needed(self.program, N, m, cones)

    def _require(self) -> None:
        program = PROGRAMS[self.program]
        if importlib.util.find_spec(program.module) is None:
            raise MissingDependency(self.program, package=program.package)
        if importlib.util.find_spec("cvxpy") is None:
            raise MissingDependency("CVXPY", remedy=INSTALL_CVXPY)

    def _run(self, posed: Posed) -> ConicSolution:
        """Solve without output or warnings."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                # SciPy's back end is faster for few, large, sparse constraints.
                posed.problem.solve(solver=self.program, canon_backend="SCIPY", **self.options())
            except Exception as error:  # solvers raise exceptions of their own
                line = (str(error) or type(error).__name__).partition("\n")[0]
                sentence = line.partition(". ")[0]  # CVXPY appends advice
                raise NumericalError(f"{self.program} gave up: {sentence}") from error
            status, value = posed.problem.status, posed.problem.value
            if status not in STATUSES or value is None or not np.isfinite(value):
                raise NumericalError(f"{self.program} found no solution: {status}")
            return posed.read()
