"""The certified search for graphs with measured distances: climb, bound, round, descend.

The relaxation is seldom tight: descents begin above rank d, where they hardly get stuck, and end at
a minimum of the relaxation, which gives the bound. Its projections are where the descents to
estimates begin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from certpgo.certify import Certificate, Tier, Verdict
from certpgo.certify.case import refuse_tolerances, tier_called
from certpgo.certify.dual import DualBound
from certpgo.certify.ranged import cost_upper, range_bound
from certpgo.certify.units import in_units, unit_of
from certpgo.costs.range_descent import descend, escape
from certpgo.costs.ranges import RangeProblem
from certpgo.errors import InputError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.lift import Lift, lifted, main_subspace, translations_of
from certpgo.graph.trees import tree_initialization
from certpgo.linalg import so
from certpgo.optimize.monitor import Monitor
from certpgo.optimize.progress import Stop, stoppable
from certpgo.optimize.solution import Solution, Status
from certpgo.solvers.certified.pipeline import MORE_RANKS, CertifiedSolution
from certpgo.solvers.certified.settings import SolveSettings
from certpgo.solvers.certified.staircase import Level

#: Relative gap between a point of the relaxation and its bound below which it is solved.
SOLVED = 1e-6
#: Projections of the relaxation's point from which descents to estimates begin.
PROJECTIONS = 12
#: By which a start leaves the space of d dimensions, over the median distance.
OUT = 0.3
#: Where the search began, for reports.
ORIGIN = "a random point of higher rank"


def search_ranges(
    problem: RangeProblem, settings: SolveSettings, initial: Estimate | None, monitor: Monitor
) -> CertifiedSolution:
    """The best estimate found, with what is proven about it.

    Raises
    ------
    InputError
        An initial estimate of another graph, tolerances out of range, or the proof tier.
    """
    if initial is not None:
        problem.check(initial)
    tier = tier_called(settings.tier or Tier.STANDARD)
    if tier is Tier.PROOF:
        raise InputError("the proof tier is not for graphs with measured distances")
    refuse_tolerances(settings.rtol, settings.atol)
    unit = unit_of(problem)
    with stoppable(monitor, unit, settings.time_limit) as stop:
        search = _Search(problem.scaled(1.0 / unit), settings, stop)
        search.run(initial)
    return search.result(problem, tier, unit)


class _Search:
    """The best estimate and bound so far."""

    def __init__(self, problem: RangeProblem, settings: SolveSettings, stop: Stop) -> None:
        self.problem, self.settings, self.stop = problem, settings, stop
        self.best: Lift | None = None
        self.cost, self.status = math.inf, Status.ITERATION_LIMIT
        self.bound: DualBound | None = None
        self.levels: list[Level] = []
        self.solved = False

    def run(self, initial: Estimate | None) -> None:
        """Climb from a start to the relaxation's minimum, then round."""
        rng = np.random.default_rng(0)
        if initial is not None:
            self.try_from(lifted(initial, self.problem.d))
        point = self.climb(self.start(rng))
        for projected in self.projections(point, rng):
            if self.best is not None and (self.stop.cuts() or self.is_certified):
                break
            self.try_from(projected)

    def start(self, rng: np.random.Generator) -> Lift:
        """Rotations along a tree, and random positions in one dimension more."""
        problem = self.problem
        tree = tree_initialization(problem.graph.rotation)
        length = float(np.median(problem.ranges.distances)) or 1.0
        t = length * rng.standard_normal((problem.n, problem.d))
        new = problem.whole.dimensions
        point = lifted(Estimate(tree.rotations, t), problem.d + new)
        out = OUT * length * rng.standard_normal((problem.n, new))
        return Lift(point.rotations, np.concatenate([t, out], axis=1))

    def climb(self, point: Lift) -> Lift:
        """The minimum of the relaxation, or what was found before a limit, and its bound."""
        lowest = self.problem.d + self.problem.whole.dimensions
        highest = max(self.settings.max_rank or self.problem.d + MORE_RANKS, lowest)
        following: Lift | None = point
        with suppress(NumericalError, np.linalg.LinAlgError):
            while following is not None and following.rank <= highest:
                with self.stop.watch.phase("descend"):
                    point, status = descend(self.problem, following, monitor=self.stop)
                cost = self.problem.cost(point)
                self.levels.append(Level(point.rank, cost, status))
                if self.stop.cuts():
                    break
                with self.stop.watch.phase("certify"):
                    bound = range_bound(self.problem, point, cost)
                if bound is not None and (self.bound is None or bound.value > self.bound.value):
                    self.bound = bound
                self.solved = bound is not None and bound.value >= (1.0 - SOLVED) * cost
                if self.solved:
                    break
                with self.stop.watch.phase("escape"):
                    following = escape(self.problem, point)
        return point

    def projections(self, point: Lift, rng: np.random.Generator) -> Iterator[Lift]:
        """Points of rank d: in the main subspace, then in random ones."""
        d = self.problem.d
        basis = main_subspace(point.subset(self.problem.poses))
        for _ in range(PROJECTIONS):
            for B in self.problem.whole.frames(basis):
                rotations = so.project(B.T @ point.rotations)
                yield Lift(rotations, translations_of(point) @ B)
            basis = np.linalg.qr(rng.standard_normal((point.rank, d)))[0]

    def try_from(self, start: Lift) -> None:
        """Descend, and keep the end if it is the best."""
        with self.stop.watch.phase("round"), suppress(NumericalError, np.linalg.LinAlgError):
            found, status = descend(self.problem, start, max_iterations=200, monitor=self.stop)
            cost = cost_upper(self.problem, Estimate(found.rotations, found.translations))
            if cost < self.cost:
                self.best, self.cost, self.status = found, cost, status

    @property
    def value(self) -> float:
        return self.bound.value if self.bound is not None else 0.0

    @property
    def tolerance(self) -> float:
        return self.settings.rtol * self.cost + self.settings.atol * self.problem.scale

    @property
    def is_certified(self) -> bool:
        """Whether the gap is closed."""
        return self.cost - self.value <= self.tolerance

    def result(self, problem: RangeProblem, tier: Tier, unit: float) -> CertifiedSolution:
        """The result in the units of the graph."""
        if self.best is None:
            raise NumericalError("no descent from the relaxation's point succeeded")
        estimate = Estimate(self.best.rotations, self.best.translations)
        certificate = replace(in_units(unit, self.certificate(estimate, tier)), scale=problem.scale)
        certificate = replace(certificate, reason=self.reason(certificate))
        solution = Solution(
            estimate=estimate,
            cost=problem.cost(estimate),
            status=self.stop.ended_by or self.status,
            iterations=max(len(self.stop.trace) - 1, 0),
            lower_bound=certificate.lower_bound,
            seconds=self.stop.watch.seconds,
            trace=tuple(self.stop.trace),
            note=f"initialized by {ORIGIN}; the relaxation ended at rank {self.rank}",
        )
        levels = tuple(replace(level, cost=unit * level.cost) for level in self.levels)
        return CertifiedSolution(solution, certificate, ORIGIN, levels, self.settings, problem)

    @property
    def rank(self) -> int:
        return self.levels[-1].rank if self.levels else self.problem.d

    def certificate(self, estimate: Estimate, tier: Tier) -> Certificate:
        """What is proven about the best estimate."""
        problem, gap = self.problem, math.nextafter(self.cost - self.value, math.inf)
        verdict = Verdict.BOUNDED if self.value > 0.0 else Verdict.UNDECIDED
        if tier is not Tier.SCREEN and self.is_certified:
            verdict = Verdict.CERTIFIED
        return Certificate(
            verdict=verdict,
            tier=tier,
            cost_upper=self.cost,
            lower_bound=self.value,
            gap=gap,
            rtol=self.settings.rtol,
            atol=self.settings.atol,
            scale=problem.scale,
            stationarity=problem.stationarity(estimate),
            max_residual_angle=float(problem.residual_angles(estimate).max()),
            multipliers=None if self.bound is None else self.bound.multipliers,
            shift=0.0 if self.bound is None else self.bound.shift,
            refined=estimate,
            refined_cost=self.cost,
            basin_is_global=verdict is Verdict.CERTIFIED,
            better=None,
            better_cost=None,
            bounds=None,
            engine=problem.engine,
            reason="",
            objective=problem.title,
        )

    def reason(self, c: Certificate) -> str:
        """The reason for the verdict in one sentence."""
        own = f"this one costs {c.cost_upper:.10g}"
        if c.verdict is Verdict.UNDECIDED:
            return f"{own}, and no lower bound above zero could be proven"
        floor = f"no estimate of this graph costs less than {c.lower_bound:.10g}"
        if c.verdict is Verdict.CERTIFIED:
            small = c.gap > c.rtol * c.cost_upper
            said = f"{floor}; {own}, within {c.gap:.2g} of the optimum"
            of_w = f", which is negligible relative to the total weight W = {c.scale:.2g}"
            return f"{said}{of_w}" if small else said
        said = f"{floor}; {own}, at most {100.0 * c.relative_gap:.3g} % of F above the optimum"
        if not self.solved:
            return f"{said}; the relaxation was not solved"
        return (
            f"{said}; the relaxation of distances is not tight: it is solved, at rank {self.rank}, "
            "which certifies itself alone"
        )
