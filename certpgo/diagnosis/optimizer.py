"""What an optimizer did with the measurements: no start, another basin, a saddle, stopped early."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from scipy import special

from certpgo.certify import Verdict
from certpgo.certify.tolerances import SETTLED
from certpgo.diagnosis.examined import SLIGHT, Examined
from certpgo.diagnosis.finding import Finding, explained
from certpgo.diagnosis.winding import wound
from certpgo.errors import CertPGOError, NumericalError
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown, counted
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray
from certpgo.objective.choose_cost import costs_of, objective_of
from certpgo.optimize.descent import descend
from certpgo.optimize.solution import Solution, Status
from certpgo.solve.accuracy_wording import ends
from certpgo.solve.fit import goodness_of_fit

#: Probability of truth that is further from the optimum, or nearer: noise is seldom as stated.
RARE = 1e-9
#: How far saddles are left, radians, and the stationarity of another program's optimum.
NUDGE, ELSEWHERE = 1e-3, 1e-4
#: Strength of what is proven, beside half of that of its costs, and that part at most.
PROVEN, MOST = 0.5, 1.0
#: Poses are at the same place if they differ by less than this.
SAME = 1e-9


def found(examined: Examined) -> Iterator[Finding]:
    """What became of the estimate."""
    estimate = examined.estimate
    if estimate is None or examined.instance.graph.has_scales:
        return
    given = examined.problem.cost(estimate)
    if not math.isfinite(given) or not examined.is_above(given, examined.best):
        return
    missing = _without_start(examined, estimate, given)
    if missing is not None:
        yield missing
        return
    with suppress(NumericalError, np.linalg.LinAlgError):
        yield from _descended(examined, estimate, given)


# --- Starts ---------------------------------------------------------------------------------------


def _without_start(examined: Examined, estimate: Estimate, given: float) -> Finding | None:
    """That poses were never set."""
    instance = examined.instance
    unset = _unset(estimate)[instance.poses]
    here, best = int(unset.sum()), examined.answer.estimate
    if here < 3 or int(_unset(best)[instance.poses].sum()) > 0.5 * here:
        return None
    of_all = len(unset)
    few = "all poses" if here == of_all else f"{here} of {counted(of_all, 'pose{s}')}"
    costs = f"it costs {cost_shown(given)}, the best estimate {cost_shown(examined.best)}"
    return Finding(
        "no-initialization",
        f"{few} of the estimate are the same, as if they were never set: {costs}",
        "start from poses composed along the measurements: certpgo solve GRAPH -o START",
        examined.best,
        given,
    )


def _unset(estimate: Estimate) -> BoolArray:
    """(n,) which poses are that of most others, or the identity at the origin."""
    R, t = estimate.rotations, estimate.translations
    flat = R.reshape(len(R), -1) if t is None else np.concatenate([R.reshape(len(R), -1), t], 1)
    origin = np.zeros(flat.shape[1])
    origin[: R[0].size] = np.eye(len(R[0])).ravel()
    rows, counts = np.unique(flat, axis=0, return_counts=True)
    common = rows[np.argmax(counts)] if counts.max() > 0.5 * len(R) else origin
    is_there = [np.abs(flat - place).max(axis=1) <= SAME for place in (common, origin)]
    return np.asarray(is_there[0] | is_there[1])


# --- Descents -------------------------------------------------------------------------------------


def _descended(examined: Examined, estimate: Estimate, given: float) -> Iterator[Finding]:
    """What descent from the estimate says of it."""
    examined.trying("stopped-early")
    problem, best = examined.problem, examined.best
    end = descend(problem, problem.settled(estimate), monitor=examined.monitor)
    there = problem.settled(end.estimate)
    reached = problem.cost(there)
    if examined.is_above(reached, best):
        yield _elsewhere(examined, given, there, end, reached)
    elif (other := _other_cost(examined, estimate, given)) is not None:
        yield other
    elif not _is_as_truth(examined, given):
        yield _stopped_early(examined, given, end)


def _weakened(cost: float, given: float, proven: float = 0.0) -> float:
    """The strength of what a mistake of convention explains as well."""
    return proven + min(0.5 * explained(cost, given), MOST)


def _stopped_early(examined: Examined, given: float, end: Solution) -> Finding:
    best = cost_shown(examined.best)
    steps = counted(end.iterations, "step{s}")
    which = "the optimum" if examined.answer.verdict is Verdict.CERTIFIED else "the best known"
    return Finding(
        "stopped-early",
        f"the estimate is not at the optimum: it costs {cost_shown(given)}, and descent from it "
        f"reaches {which}, {best}, in {steps}",
        "an optimizer may have stopped early, or the poses were never optimised: allow more "
        "iterations or a smaller tolerance (if it says that it converged, check its derivatives), "
        "or take the end of descent: certpgo certify GRAPH ESTIMATE --best OUT",
        examined.best,
        given,
        _weakened(examined.best, given),
    )


def _other_cost(examined: Examined, estimate: Estimate, given: float) -> Finding | None:
    """That the estimate is an optimum of the cost of another program."""
    own = examined.problem
    if not own.stationarity(estimate) > ELSEWHERE:
        return None
    for name in costs_of(examined.instance):
        if name == own.cost_name:
            continue
        examined.trying("other-cost")
        with suppress(CertPGOError):
            other = objective_of(examined.instance, name)
            if other.stationarity(estimate) < 0.1 * ELSEWHERE:
                return Finding(
                    "other-cost",
                    f"the estimate is an optimum of the cost of {name}, not of {own.title}: it "
                    f"costs {cost_shown(given)}, the best estimate {cost_shown(examined.best)}",
                    f"compare estimates under one cost: --cost {name}",
                    examined.best,
                    given,
                    _weakened(examined.best, given),
                )
    return None


def _is_as_truth(examined: Examined, given: float) -> bool:
    """Whether an estimate is as far from the optimum as true poses are, for noise as residuals."""
    answer, layout = examined.answer, examined.problem.tangent_layout
    fit = examined.fit or goodness_of_fit(answer.problem, answer.estimate)
    if fit is None or not fit.chi2 > 0.0:
        return False
    free = layout.size - int(layout.sizes[layout.still()])
    ratio = (given - examined.best) / examined.best * fit.freedom / free
    tails = special.fdtr(free, fit.freedom, ratio), special.fdtrc(free, fit.freedom, ratio)
    return bool(min(tails) > RARE)


def _elsewhere(
    examined: Examined, given: float, there: Estimate, end: Solution, reached: float
) -> Finding:
    """That descent from the estimate ends in another basin, or at a saddle."""
    best, shown = examined.best, cost_shown(examined.best)
    rests = end.status is Status.CONVERGED or examined.problem.stationarity(there) < SETTLED
    beyond = _past_saddle(examined, there, reached) if rests else None
    costs = f"it costs {cost_shown(given)}, "
    if beyond is not None:
        said = f"descent from the estimate rests at a saddle: {costs}the saddle "
        said += f"{cost_shown(reached)}, and a nudge leaves that for {cost_shown(beyond)}; "
        said += f"the best estimate costs {shown}"
        next = "perturb the poses before the optimization: their symmetry keeps it there"
        return Finding("saddle", said, next, best, given, _weakened(best, given, PROVEN))
    stuck = given <= reached + SLIGHT * (reached - best)
    if not stuck:
        costs += (
            f"descent {'ends at' if rests else 'is after many steps at'} {cost_shown(reached)}, "
        )
    which = "optimum" if examined.answer.verdict is Verdict.CERTIFIED else "best estimate known"
    where = "the estimate is stuck in" if stuck else "descent from the estimate leads to"
    loop, edges = _wound(examined, there)
    return Finding(
        "wrong-basin",
        f"{where} another basin: {costs}the {which} {shown}. {loop}",
        "start elsewhere: certpgo solve GRAPH -o START",
        best,
        given,
        _weakened(best, given, PROVEN),
        edges,
        proven=rests,
    )


def _past_saddle(examined: Examined, there: Estimate, reached: float) -> float | None:
    """The cost that is reached from nearby, if that is lower."""
    problem, rng = examined.problem, np.random.default_rng(0)
    turns = NUDGE * rng.standard_normal((problem.n, so.tangent_dim(problem.d)))
    nudged = Estimate(so.turned(there.rotations, turns), there.translations)
    end = descend(problem, problem.settled(nudged), monitor=examined.monitor)
    cost = problem.cost(problem.settled(end.estimate))
    return cost if examined.is_above(reached, cost) else None


def _wound(examined: Examined, there: Estimate) -> tuple[str, tuple[int, ...]]:
    """Which loop is wound, or else what is furthest off, in a sentence; and measurements."""
    instance = examined.instance
    pairs, numbers = instance.pairs, instance.known_numbers
    loop = wound(instance.graph, there, examined.answer.estimate)
    if loop is not None:
        *_, last = loop.edges.tolist()
        closed = ends(instance, *pairs[last].tolist())
        more = f", and {counted(loop.loops - 1, 'other{s}')}" if loop.loops > 1 else ""
        said = f"The loop of {counted(len(loop.edges), 'measurement{s}')} that {closed} closes is "
        said += f"wound{more}: its residual rotations add up to {loop.degrees:.0f} degrees, those "
        said += f"of the best estimate to {loop.usual:.0f}"
        return said, tuple(numbers[loop.edges].tolist())
    angles = examined.problem.residual_angles(there)
    worst = int(np.argmax(angles))
    if not angles[worst] > 0.0:
        worst = int(np.argmax(examined.problem.edge_costs(there)))
        return f"The costliest measurement is {ends(instance, *pairs[worst].tolist())}", (worst,)
    named = ends(instance, *pairs[worst].tolist())
    degrees = f"{math.degrees(angles[worst]):.0f} degrees"
    return f"The measurement {named} is off by {degrees}", (int(numbers[worst]),)


# --- Linear systems -------------------------------------------------------------------------------


def undetermined(examined: Examined) -> Iterator[Finding]:
    """Nodes that nothing determines, so that linear systems are indeterminate."""
    examined.trying("undetermined")
    if examined.first is not None:
        return  # residuals are studied of determined nodes alone
    open_ = examined.answer.undetermined
    if open_ is None:
        return
    yield indeterminate(open_.in_words(examined.instance.named), strength=0.3)


def indeterminate(said: str, strength: float) -> Finding:
    """That the measurements leave open what is said."""
    return Finding(
        "undetermined",
        f"the measurements leave nodes free, and linear systems indeterminate: {said}",
        "add such measurements, or a weak prior of these nodes",
        strength=strength,
        proven=True,
    )
