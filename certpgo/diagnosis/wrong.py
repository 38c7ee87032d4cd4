"""Single measurements that are wrong, and what would make them right."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from certpgo.diagnosis.conventions import with_w_first
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.noise import kinds_of
from certpgo.diagnosis.study import Study, study
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate, Graph
from certpgo.graph.phrases import cost_shown, counted
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.descent import descend
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import budgets, proven_rises
from certpgo.solve.outliers import select

#: Probability that noise makes any right measurement look wrong.
LEVEL = 1e-4
#: Multiple of the noise's variance from which a measurement is wrong, where noise is as stated, and
#: where it is estimated: real residuals have heavier tails than normal ones.
WIDE, WIDER = 1.5, 4.0
#: Nodes up to which a robust fit is tried at the least suspicion, and rounds until it settles.
FEW, SETTLING = 1000, 3
#: Measurements that are left out one by one, before a robust fit is tried; and surprise of two, one
#: over the other, that may both be the wrong one.
LEFT_OUT, AS_LIKELY = 3, 0.98
#: Ratio of variances up to which noise is as stated, and from which it is seldom misstated.
STATED, HUGE = 1.5, 50.0
#: A right reading is within what is exceeded with this chance, and has this share of the cost.
FITS, SHARE = 1e-3, 0.05
#: The same share where few nodes were tried, and where all were.
FEW_TRIED, CLEARLY = 0.25, 0.01
#: Measurements that are looked at one by one, and that a sentence names.
MOST, NAMED = 50, 4
#: Measurements of which proofs are tried, and seconds that these may take.
PROVABLE, PROVING = 3000, 1.0
#: Neighbours that an id may be off to.
OFF = 2


@dataclass(frozen=True, eq=False)
class Judged:
    """Which measurements are wrong, and the fit to the others.

    Attributes
    ----------
    wrong : (m,) flags
    fit : of all others
    scales : (m,) variance of the noise over that stated, at least 1
    """

    wrong: BoolArray
    fit: Study
    scales: FloatArray

    @property
    def cost(self) -> float:
        """chi^2 of the others, and what leaving the wrong ones out costs."""
        price = float((self.scales * _limit(self.fit.numbers))[self.wrong].sum())
        return float(self.fit.squares[~self.wrong].sum()) + price

    def gain(self, first: float) -> float:
        """How much less that is than chi^2 of all."""
        return first - self.cost if self.wrong.any() else 0.0

    @property
    def rows(self) -> IntArray:
        """(k,) the wrong measurements, the most surprising first."""
        rows = np.flatnonzero(self.wrong)
        return rows[np.argsort(-self.fit.surprises[rows], kind="stable")] if len(rows) else rows


def single(examined: Examined) -> Judged | None:
    """The one measurement without which chi^2 is not too large; None if there is none."""
    if examined.first is None or not (best := _judged(examined, examined.first)).wrong.any():
        return None
    with suppress(CertPGOError, np.linalg.LinAlgError):
        found = _without_few(examined, best, 1)
        return None if found is None or found.fit.fit.is_unusually_large else found
    return None


def judged(examined: Examined) -> Judged | None:
    """The wrong measurements: by their surprise at the fit to all, then at a robust one.

    None where nothing is known of residuals.
    """
    if examined.first is None:
        return None
    best = _judged(examined, examined.first)
    if not _is_suspicious(examined, best):
        return best
    with suppress(CertPGOError, np.linalg.LinAlgError):
        few = _without_few(examined, best, LEFT_OUT)
        found = [one for one in (_robustly(examined), few) if one is not None]
        return min(found, key=lambda one: one.cost, default=best)
    return best


def _without_few(examined: Examined, at: Judged, most: int) -> Judged | None:
    """One after another left out, each the most surprising one; None if more are wrong then."""
    problem, kept = examined.problem, np.ones(len(at.wrong), dtype=bool)
    for _ in range(most):
        surprises = np.where(kept, at.fit.surprises, 0.0)
        # Of two that are as likely, such as all that a node has, odometry is right.
        surprises[: len(examined.steps)][examined.steps] *= AS_LIKELY
        worst = int(np.argmax(surprises))
        kept[worst] = False
        fitted = descend(problem.reweighted(kept.astype(float)), at.fit.estimate)
        found = _kept(examined, fitted.estimate, kept)
        if found is None or (found.wrong == ~kept).all():
            return found
        at = found
    return None


def _robustly(examined: Examined) -> Judged | None:
    """Those that a robust fit rejects, until the choice settles."""
    chosen = select(examined.problem, fit=examined.answer.estimate, monitor=examined.monitor)
    found = _kept(examined, chosen.estimate, ~chosen.rejected)
    for _ in range(SETTLING):
        if found is None or (found.wrong == ~found.fit.counts).all():
            return found
        found = _kept(examined, found.fit.estimate, ~found.wrong)
    return None if found is None else replace(found, wrong=~found.fit.counts)


def _kept(examined: Examined, estimate: Estimate, kept: BoolArray) -> Judged | None:
    """The measurements at the fit to some of them; None where these leave nodes free."""
    if examined.studied is None:
        return None
    fit = study(examined.studied, estimate, examined.anchor, counts=kept)
    return None if fit is None else _judged(examined, fit)


def _is_suspicious(examined: Examined, first: Judged) -> bool:
    """Whether a robust fit may find wrong measurements, which a fit to all may spread and hide."""
    if first.wrong.any():
        return True
    if examined.instance.graph.num_nodes > FEW:
        return False
    # Residuals that are larger by one factor throughout are misstated noise, unless that is huge.
    fit, usual = first.fit, np.where(first.scales < HUGE, first.scales, 1.0)
    return bool((fit.surprises > usual * _limit(fit.numbers)).any())


def _judged(examined: Examined, fit: Study) -> Judged:
    """Which measurements are too far from what the others say, and noise by their medians."""
    known = fit.checked > 0
    usual = 2.0 * special.gammaincinv(0.5 * np.maximum(fit.checked, 1), 0.5)
    scales = np.ones(len(known))
    for rows in kinds_of(examined).values():
        own = rows & known
        if own.any():
            scales[rows] = max(float(np.median(fit.surprises[own] / usual[own])), 1.0)
    wide = np.where(scales < STATED, WIDE, WIDER) * scales
    wrong = known & (fit.surprises > wide * _limit(fit.checked))
    return Judged(wrong, fit, scales)


def _limit(numbers: IntArray) -> FloatArray:
    """(m,) what surprises of right measurements hardly exceed."""
    tail = LEVEL / len(numbers)
    return np.asarray(2.0 * special.gammainccinv(0.5 * np.maximum(numbers, 1), tail))


@dataclass(frozen=True)
class _Mended:
    """A wrong measurement as one that would be right."""

    row: int
    kind: str
    said: str


# --- What would make them right -------------------------------------------------------------------


def found(examined: Examined, of: Judged) -> Iterator[Finding]:
    """Wrong measurements, those with the same mistake as one finding."""
    rows = of.rows
    if not len(rows):
        return
    mended = {one.row: one for one in _mended(examined, of, rows[:MOST])}
    proven = _proven(examined, of)
    kinds = {row: mended[row].kind if row in mended else "" for row in rows.tolist()}
    for kind in sorted(set(kinds.values()), reverse=True):
        own = [row for row in rows.tolist() if kinds[row] == kind]
        yield _finding(examined, of, kind, own, mended, proven)


def _finding(
    examined: Examined,
    of: Judged,
    kind: str,
    rows: list[int],
    mended: dict[int, _Mended],
    proven: BoolArray,
) -> Finding:
    instance = examined.instance
    pairs = instance.pairs

    def named(row: int) -> str:
        i, j = pairs[row].tolist()
        costs = f"{i}-{j} (cost {cost_shown(float(of.fit.squares[row]))}"
        more = f": {mended[row].said}" if row in mended else ""
        return f"{costs}{more})"

    names = ", ".join(named(row) for row in rows[:NAMED])
    more = ", ..." if len(rows) > NAMED else ""
    verb = "is" if len(rows) == 1 else "are"
    sure = bool(proven[rows].all())
    wrong = f"{counted(len(rows), 'measurement{s}')} {verb} {'proven to be ' * sure}wrong"
    said = f"{wrong}, if the others are right: "
    numbers = tuple(sorted(instance.known_numbers[rows].tolist()))
    cost = of.cost
    given = max(examined.best, cost)
    next = "correct them so" if kind else "certpgo solve --robust leaves them out"
    if not kind:
        next += "; certpgo outliers says what is proven"
    strength = 1.0 + min(1.0, math.log10(given / cost)) + 0.05 * bool(kind)
    name = kind or "wrong-measurement"
    said = f"{said}{names}{more}"
    return Finding(name, said, next, cost, given, strength, numbers, sure)


def _proven(examined: Examined, of: Judged) -> BoolArray:
    """(m,) which are proven to be wrong, if all others are right."""
    problem, found = examined.problem, np.zeros(len(of.wrong), dtype=bool)
    if of.wrong.sum() > MOST or len(found) > PROVABLE:
        return found
    with suppress(CertPGOError, np.linalg.LinAlgError):
        budget = np.maximum(budgets(problem), of.scales * _limit(of.fit.numbers))
        posed = TruncatedCost(problem, np.where(of.wrong, budget, np.inf))
        estimate = descend(posed.kept, of.fit.estimate).estimate
        stop = Stop(examined.monitor)
        with stop.within(PROVING):
            rises = proven_rises(posed, estimate, stop)
        found[posed.rejected] = rises > budget[posed.rejected]
    return found


@dataclass(frozen=True, eq=False)
class _Reading:
    """Measurements (k,) as they may be meant.

    Attributes
    ----------
    edges, rotations, translations : as in a graph
    said : of each, in words
    share : of the surprise that it leaves at most
    """

    kind: str
    edges: IntArray
    rotations: FloatArray
    translations: FloatArray
    said: Callable[[int], str]
    share: float = SHARE


def _mended(examined: Examined, of: Judged, rows: IntArray) -> Iterator[_Mended]:
    """Readings of wrong measurements that agree with the others."""
    graph = examined.instance.graph
    rows = rows[rows < graph.num_edges]
    rows = rows[examined.whole[rows]]
    if not len(rows):
        return
    readings = [_inverted(graph, rows), *_between_others(examined, of, rows)]
    if graph.d == 3:
        readings.append(_with_w_first(graph, rows))
    surprises = _surprises(examined, of, rows, readings)
    for reading in readings:
        examined.trying(reading.kind)
    checked = np.maximum(of.fit.checked[rows], 1)
    limit = 2.0 * special.gammainccinv(0.5 * checked, FITS) * of.scales[rows]
    shares = np.array([one.share for one in readings])
    fits = (surprises < limit) & (surprises < shares[:, None] * of.fit.surprises[rows])
    for k, row in enumerate(rows.tolist()):
        if (other := _copied(graph, row)) is not None:
            i, j = examined.instance.pairs[other].tolist()
            yield _Mended(row, "copied-edge", f"a copy of {i}-{j}")
        elif fits[:, k].any():
            best = readings[int(np.argmin(np.where(fits[:, k], surprises[:, k], np.inf)))]
            yield _Mended(row, best.kind, best.said(k))


def _inverted(graph: Graph, rows: IntArray) -> _Reading:
    R, t = graph.rotations[rows], graph.translations[rows]
    edges = graph.edges[rows][:, ::-1]
    return _Reading("inverted-edge", edges, R, t, lambda _: "fits as its inverse")


def _with_w_first(graph: Graph, rows: IntArray) -> _Reading:
    R, t = with_w_first(graph.rotations[rows]), graph.translations[rows]
    return _Reading("edge-w-first", graph.edges[rows], R, t, lambda _: "fits with w first")


def _between_others(examined: Examined, of: Judged, rows: IntArray) -> Iterator[_Reading]:
    """Between one of their nodes and the other node that fits best, or whose id is near."""
    graph, instance, estimate = examined.instance.graph, examined.instance, of.fit.estimate
    poses, X, t = instance.poses, estimate.rotations, estimate.translations
    if t is None:
        return
    M, v = graph.rotations[rows], graph.translations[rows]
    back = np.swapaxes(M, 1, 2)
    for end in (1, 0):
        near, far = graph.edges[rows, 1 - end], graph.edges[rows, end]
        R = X[near] @ (M if end else back)
        at = t[near] + np.einsum("mab,mb->ma", X[near] if end else -R, v)
        cost = graph.kappa[rows, None] * _squared(R.reshape(len(rows), -1), X[poses])
        cost += graph.tau[rows, None] * _squared(at, t[poses])
        cost[(poses == far[:, None]) | (poses == near[:, None])] = np.inf
        off = np.abs(instance.ids[poses] - instance.ids[far][:, None])
        anywhere = np.broadcast_to(~examined.steps[rows][:, None], off.shape)
        for allowed, share in ((off <= OFF) & anywhere, FEW_TRIED), (anywhere, CLEARLY):
            chosen = poses[np.argmin(np.where(allowed, cost, np.inf), axis=1)]
            edges = graph.edges[rows].copy()
            edges[:, end] = np.where(chosen == near, far, chosen)
            ids, was = instance.ids[edges], instance.ids[graph.edges[rows]]

            def said(k: int, ids: IntArray = ids, was: IntArray = was) -> str:
                (i, j), (a, b) = ids[k].tolist(), was[k].tolist()
                return f"fits between {i} and {j} instead of {a} and {b}"

            yield _Reading("wrong-node", edges, M, v, said, share)


def _squared(A: FloatArray, B: FloatArray) -> FloatArray:
    """(k, n) squared distances between rows of numbers."""
    B = B.reshape(len(B), -1)
    squares = (A * A).sum(axis=1)[:, None] + (B * B).sum(axis=1) - 2.0 * A @ B.T
    return np.asarray(squares)


def _copied(graph: Graph, row: int) -> int | None:
    """Another measurement with the very numbers of one, of other nodes; None if there is none."""
    same = (graph.rotations == graph.rotations[row]).all(axis=(1, 2))
    same &= (graph.translations == graph.translations[row]).all(axis=1)
    same &= (graph.edges != graph.edges[row]).any(axis=1)
    others = np.flatnonzero(same)
    return int(others[0]) if len(others) == 1 else None


def _surprises(
    examined: Examined, of: Judged, rows: IntArray, readings: list[_Reading]
) -> FloatArray:
    """(r, k) surprises of readings, infinite where they are not known."""
    unknown = np.full((len(readings), len(rows)), np.inf)
    problem = examined.studied
    if problem is None:
        return unknown
    graph, m = problem.measured, problem.measured.num_edges
    several = graph.with_edges(np.concatenate([np.arange(m), *[rows] * len(readings)]))
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(graph, name), *(getattr(one, name) for one in readings)])
        for name in ("edges", "rotations", "translations")
    }
    counts = np.insert(~of.wrong, m, np.zeros(unknown.size, dtype=bool))
    trials = replace(problem, measured=replace(several, **columns))
    fit = study(trials, of.fit.estimate, examined.anchor, counts=counts)
    if fit is None:
        return unknown
    return fit.surprises[m : m + unknown.size].reshape(unknown.shape)
