"""Findings of single measurements that are wrong, and what would make them right."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from certpgo.diagnosis.conventions import with_w_first
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.judged import SAME, Judged, limit
from certpgo.diagnosis.study import study
from certpgo.errors import CertPGOError
from certpgo.graph import Graph
from certpgo.graph.phrases import cost_shown, counted
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import budgets, cores

#: A right reading is within what is exceeded with this chance, and has this share of the cost.
FITS, SHARE = 1e-3, 0.05
#: The same share where few nodes were tried, and where all were.
FEW_TRIED, CLEARLY = 0.25, 0.01
#: Measurements that are looked at one by one, and that a sentence names.
MOST, NAMED = 50, 4
#: Seconds that proofs may take.
PROVING = 1.0
#: Neighbours that an id may be off to.
OFF = 2
#: Chance that some node fits, and how much larger the region is in which they are counted.
CHANCE, COUNTED = 0.05, 5.0


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
    if not of.explains(examined.best):
        yield _disagreeing(examined, of, rows.tolist())
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
    verb, them = ("is", "it") if len(rows) == 1 else ("are", "them")
    others = [] if kind or len(of.rows) > 1 else _as_likely(examined, of)
    sure = bool(proven[rows].all()) and not others
    wrong = f"{counted(len(rows), 'measurement{s}')} {verb} {'proven to be ' * sure}wrong"
    said = f"{wrong}, if the others are right: {_named(examined, of, rows, mended)}"
    if others:
        pairs = ("-".join(map(str, examined.instance.pairs[row].tolist())) for row in others)
        said += f", or instead {' or '.join(pairs)}: nothing tells which"
    cost, numbers = of.left, examined.instance.known_numbers
    given = max(examined.best, cost)
    said += f"; without {them} the map costs {cost_shown(cost)}, as it stands {cost_shown(given)}"
    next = f"correct {them} so" if kind else f"certpgo solve --robust leaves {them} out"
    if not kind:
        next += "; certpgo outliers says what is proven"
    strength = 1.0 + min(1.0, math.log10(given / of.cost)) + 0.05 * bool(kind)
    known = tuple(sorted(numbers[rows].tolist()))
    return Finding(kind or "wrong-measurement", said, next, cost, given, strength, known, sure)


def _disagreeing(examined: Examined, of: Judged, rows: list[int]) -> Finding:
    """Measurements that are far from what the others say, in a map that is wrong without them."""
    numbers = tuple(sorted(examined.instance.known_numbers[rows].tolist()))
    verb, them = ("disagrees", "it") if len(rows) == 1 else ("disagree", "them")
    said = (
        f"{counted(len(rows), 'measurement{s}')} {verb} most with the others, but something else "
        f"is wrong, too: without {them} the map costs {cost_shown(of.left)}, as it stands "
        f"{cost_shown(examined.best)}: {_named(examined, of, rows, {})}"
    )
    next = "look for what the measurements of one sensor or one stretch have in common"
    return Finding("wrong-measurement", said, next, of.left, examined.best, 0.2, numbers)


def _named(examined: Examined, of: Judged, rows: list[int], mended: Mapping[int, _Mended]) -> str:
    """The first few measurements, with what each costs and how it would fit."""

    def named(row: int) -> str:
        i, j = examined.instance.pairs[row].tolist()
        costs = f"{i}-{j} (cost {cost_shown(float(of.fit.squares[row]))}"
        more = f": {mended[row].said}" if row in mended else ""
        return f"{costs}{more})"

    return ", ".join([*map(named, rows[:NAMED]), *["..."] * (len(rows) > NAMED)])


def _as_likely(examined: Examined, of: Judged) -> list[int]:
    """Measurements that may be the wrong one as well, such as others of a chain.

    Of odometry and a loop closure, odometry is right.
    """
    first = examined.first
    if first is None:
        return []
    row, steps = int(of.rows[0]), examined.steps
    same = first.surprises >= SAME * first.surprises[row]
    if not (row < len(steps) and steps[row]):
        same[: len(steps)] &= ~steps
    return [other for other in np.flatnonzero(same).tolist() if other != row][:NAMED]


def _proven(examined: Examined, of: Judged) -> BoolArray:
    """(m,) which are proven to be wrong, if all others on a path between their ends are right."""
    problem, found = examined.problem, np.zeros(len(of.wrong), dtype=bool)
    if of.wrong.sum() > MOST:
        return found
    with suppress(CertPGOError, np.linalg.LinAlgError):
        budget = np.maximum(budgets(problem), of.scales * limit(of.fit.numbers))
        stop = Stop(examined.monitor)
        with stop.within(PROVING):
            sets = cores(problem, ~of.wrong, of.rows, budget, stop, trusted=~of.wrong)
        found[[wrong for *_, wrong in sets]] = True
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
    back, numbers = np.swapaxes(M, 1, 2), of.fit.numbers[rows]
    for end in (1, 0):
        near, far = graph.edges[rows, 1 - end], graph.edges[rows, end]
        R = X[near] @ (M if end else back)
        at = t[near] + np.einsum("mab,mb->ma", X[near] if end else -R, v)
        cost = graph.kappa[rows, None] * _squared(R.reshape(len(rows), -1), X[poses])
        cost += graph.tau[rows, None] * _squared(at, t[poses])
        cost[(poses == far[:, None]) | (poses == near[:, None])] = np.inf
        off = np.abs(instance.ids[poses] - instance.ids[far][:, None])
        # Where many nodes are about there, one of them fits by chance.
        wide = COUNTED**2 * 2.0 * special.gammainccinv(0.5 * numbers, FITS) * of.scales[rows]
        expected = (cost < wide[:, None]).sum(axis=1) / COUNTED**numbers
        closures = ~examined.steps[rows][:, None]
        # A short motion fits between neighbours, whatever it was meant for.
        beyond = np.abs(instance.ids[poses] - instance.ids[near][:, None]) > OFF
        anywhere = closures & (expected < CHANCE)[:, None] & beyond
        for allowed, share in ((off <= OFF) & closures, FEW_TRIED), (anywhere, CLEARLY):
            costs = np.where(allowed, cost, np.inf)
            chosen = poses[costs.argmin(axis=1)]
            edges = graph.edges[rows].copy()
            edges[:, end] = np.where(np.isfinite(costs.min(axis=1)), chosen, far)
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
