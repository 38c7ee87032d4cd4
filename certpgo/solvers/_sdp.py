"""What the two semidefinite programs share: settings, CVXPY's solvers, the way to a solution."""

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
from certpgo.graph.lift import Lift, rounded
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.problem import Problem, RotationProblem
from certpgo.optimize.monitor import Monitor, Stopwatch, silent
from certpgo.optimize.solution import Relaxation, Solution, Status
from certpgo.solvers import _memory
from certpgo.solvers._relaxed import (
    Scaled,
    leading_rows,
    made_feasible,
    null_space_rotations,
    told,
)

#: What CVXPY calls the ends that come with an answer.
STATUSES = {
    "optimal": Status.CONVERGED,
    "optimal_inaccurate": Status.STALLED,
    "user_limit": Status.ITERATION_LIMIT,
}


@dataclass(frozen=True)
class Program:
    """A solver of semidefinite programs that CVXPY calls.

    Attributes
    ----------
    package : what pip installs
    module : what Python imports
    tolerances : its settings that a tolerance goes to
    iterations : its setting that limits iterations
    tolerance : the default; None is the solver's own
    group : the setting of CVXPY's that those are part of, if any
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
    # Its own 1e-8, three iterations less, is 1e-6 of F at best.
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
    """What a program's solver returned, in the scaled problem's terms.

    Attributes
    ----------
    multipliers : (n, d, d), or None
    gram : (dn, dn), or None
    """

    multipliers: FloatArray | None
    gram: FloatArray | None


@dataclass(frozen=True, eq=False)
class Posed:
    """A program as CVXPY takes it.

    Attributes
    ----------
    problem : the cvxpy.Problem
    read : what its variables hold once it is solved
    """

    problem: Any
    read: Callable[[], ConicSolution]


@dataclass(frozen=True)
class Semidefinite(ABC):
    """Settings of the programs, and what is made of their answers.

    Attributes
    ----------
    program : the solver, by CVXPY's name: CLARABEL, SCS, or one of `PROGRAMS` that is installed
    chordal : whether Clarabel decomposes a sparse matrix into its cliques; no other program does
    tolerance : what the solver is to reach, in its own measures; None is the solver's default,
        for Clarabel 1e-10
    max_iterations : stop the solver then; None is its own default
    force : solve what memory seems too small for, too
    """

    program: str = "CLARABEL"
    chordal: bool = True
    tolerance: float | None = None
    max_iterations: int | None = None
    force: bool = False

    poses: ClassVar[bool] = True
    rotations: ClassVar[bool] = True
    #: Whether the matrix that is to be semidefinite is as sparse as the graph.
    decomposable: ClassVar[bool]

    def __post_init__(self) -> None:
        if self.program not in PROGRAMS:
            raise SpecError.unknown("program", self.program, PROGRAMS)
        if self.tolerance is not None and not 0.0 < self.tolerance < 1.0:
            raise SpecError(f"tolerance must lie between 0 and 1, not {self.tolerance}")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise SpecError("max_iterations must be at least 1")
        self.options()

    @abstractmethod
    def library(self) -> Any:
        """CVXPY, which is imported by nothing but the programs' own files."""

    @abstractmethod
    def pose(self, cp: Any, data: Scaled) -> Posed:
        """The program in the terms of CVXPY, ``cp``, about a scaled problem."""

    @abstractmethod
    def scalars(self, n: int, d: int) -> int:
        """Number of the program's unknowns."""

    def solve(
        self, problem: Problem, *, initial: Estimate | None = None, monitor: Monitor = silent
    ) -> Solution:
        """Rotations rounded from the program's solution, and translations where there are any.

        The program is convex and its solver cannot be watched: ``initial`` and ``monitor`` are
        not used.

        Raises
        ------
        MissingDependency
            The solver or CVXPY is not installed.
        InputError
            Memory is too small, and ``force`` is not set.
        NumericalError
            The solver has no answer.
        """
        if initial is not None:
            problem.check(initial)
        self._require()
        rotation, d = problem.rotation, problem.d
        if not self.force:
            self._refuse_too_large(rotation)
        cp = self.library()  # its import is nobody's phase
        watch, data = Stopwatch(), Scaled(rotation)
        with watch.phase("model"):
            posed = self.pose(cp, data)
        with watch.phase("solve"):
            answer = self._run(posed)
        multipliers = feasible = rows = None
        with watch.phase("bound"):
            if answer.multipliers is not None:
                multipliers = data.multipliers(answer.multipliers)
                feasible = made_feasible(data, multipliers)
        with watch.phase("round"):
            if answer.gram is not None:
                rows = leading_rows(data.gram(answer.gram), d)
                R = rounded(Lift(rows)).rotations
            elif feasible is not None:
                R = null_space_rotations(rotation, feasible)
            else:
                raise NumericalError(f"{self.program} returned neither Lambda nor Y")
            estimate = problem.complete(R)
        value, said = data.unit * float(posed.problem.value), str(posed.problem.status)
        rank = None if rows is None else rows.shape[1]
        relaxation = Relaxation(value, said, multipliers, rows, rank)
        return Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=STATUSES[said],
            iterations=int(posed.problem.solver_stats.num_iters or 0),
            lower_bound=None if feasible is None else feasible.value,
            seconds=watch.seconds,
            note=f"{self.program}: {told(problem, relaxation)}",
            relaxation=relaxation,
        )

    def options(self) -> dict[str, Any]:
        """The settings as the solver takes them through CVXPY.

        Raises
        ------
        SpecError
            This solver's name for a setting is not known here.
        """
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
                    raise SpecError(f"{what} cannot be set for {self.program}: leave it none")
                inner.update(dict.fromkeys(names, value))
        if self.program == "CLARABEL":
            inner["chordal_decomposition_enable"] = self.chordal
        return {program.group: inner} if program.group and inner else inner

    def bytes_needed(self, problem: RotationProblem) -> float:
        """Peak memory of solving, roughly; see `_memory`."""
        N, m = problem.n * problem.d, self.scalars(problem.n, problem.d)
        cones = [N]
        if self.program == "CLARABEL" and self.chordal and self.decomposable:
            cones = [problem.d * size for size in _memory.clique_sizes(problem)]
        return _memory.bytes_needed(self.program, N, m, cones)

    def _refuse_too_large(self, problem: RotationProblem) -> None:
        method = type(self).__module__.rpartition(".")[2]
        what, N = f"{method} with {self.program}", problem.n * problem.d
        # At the very least; cliques take a while to find where even that is too much.
        instead = "program=SCS", _memory.bytes_needed("SCS", N, N, ())
        _memory.refuse(_memory.bytes_needed(self.program, N, N, ()), what, *instead)
        _memory.refuse(self.bytes_needed(problem), what, *instead)

    def _require(self) -> None:
        program = PROGRAMS[self.program]
        if importlib.util.find_spec(program.module) is None:
            raise MissingDependency(self.program, package=program.package)
        if importlib.util.find_spec("cvxpy") is None:
            raise MissingDependency("CVXPY", package="cvxpy")

    def _run(self, posed: Posed) -> ConicSolution:
        """Solve in silence."""
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            try:
                # SciPy's back end is the faster one for few, large, sparse constraints.
                posed.problem.solve(solver=self.program, canon_backend="SCIPY", **self.options())
            except Exception as error:  # every solver has its own kinds
                line = (str(error) or type(error).__name__).partition("\n")[0]
                sentence = line.partition(". ")[0]  # CVXPY goes on with its own advice
                raise NumericalError(f"{self.program} gave up: {sentence}") from error
            said, value = posed.problem.status, posed.problem.value
            if said not in STATUSES or value is None or not np.isfinite(value):
                raise NumericalError(f"{self.program} has no answer: {said}")
            return posed.read()
