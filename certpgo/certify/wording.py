"""A certificate in words: what it means, what it rests on, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.graph.speaking import Speaking
from certpgo.graph.wording import (
    bound_shown,
    cost_shown,
    counted,
    gap_shown,
    reading_sentence,
    rounded_up,
)
from certpgo.objective.base import CHORDAL

_MEANINGS = {
    "CERTIFIED": "no estimate can be better by more than the tolerance; this is proven",
    "BOUNDED": "the gap to the best possible estimate is proven, but exceeds the tolerance",
    "REFUTED": "a lower-cost estimate exists that local descent from this one does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
_LOWER = "no bound could be proven, and an estimate of lower cost is known"
_RIGHT_BASIN = "not the optimum, but local descent from here reaches it; this is proven"
_RIGHT_ROTATIONS = "not the optimum, but with its best translations it is; this is proven"
_HINT = "a hint of the gap to the best possible estimate; this tier proves nothing"
_TRUSTS = {
    "screen": "a plain factorization whose rounding errors are not bounded: a hint, no proof",
    "standard": (
        "a factorization with bounded rounding errors, provided that the linear algebra library "
        "keeps the usual error bound"
    ),
    "proof": (
        "the residual of a factorization, measured in integers and exact products: only IEEE 754 "
        "arithmetic, Python and NumPy's sums of products are trusted"
    ),
}
_ANGLES = ", and its library's sine and arctangent to 4 units in the last place"

#: Gap relative to F that is never called small.
LARGE = 0.01
#: Why the relaxation may be loose where positions alone join parts: for those on a line of the
#: plane or in a plane of space, and else.
_MIRRORED = {
    "line": "the relaxation does not know left from right, and positions on a line fit a mirror "
    "image as well: attitudes, or positions off the line, would tell",
    "plane": "the relaxation does not know left from right, and positions in a plane fit a mirror "
    "image as well: attitudes, or positions out of the plane, would tell",
    "perhaps": "the relaxation does not know left from right, and may mirror what only positions "
    "and odometry hold: attitudes or loop closures would tell",
}

#: What to do next, in Python; the quickstart says more.
_SEARCH = "certpgo.solve(graph, initial=estimate) searches further; the gap holds all the same"
_NEXT = {
    "CERTIFIED": "nothing: keep the estimate",
    "BOUNDED": _SEARCH,
    "REFUTED": "take certificate.better, or start your solver from certpgo.solve(graph).estimate",
    "UNDECIDED": "the reason says what was in the way; certpgo.solve(graph) finds an estimate",
}
_POLISHED = "take certificate.refined, or keep the estimate: the gap is all that it can lose"
_SCREENED = 'certify(..., tier="standard") proves a gap'


class Statement(Speaking):
    """What words are about; `certpgo.Certificate` explains the attributes."""

    if TYPE_CHECKING:
        verdict: str
        tier: str
        cost_upper: float
        lower_bound: float
        gap: float
        rtol: float
        atol: float
        scale: float
        max_residual_angle: float
        refined_cost: float
        basin_is_global: bool
        better_cost: float | None
        objective: str
        descended: bool
        settled: bool
        obstacle: Obstacle

        @property
        def relative_gap(self) -> float: ...  # noqa: D102

        @property
        def tolerance(self) -> float: ...  # noqa: D102

        @property
        def best_cost(self) -> float: ...  # noqa: D102

    @property
    def reason(self) -> str:
        """The reason for the verdict in one sentence."""
        return reason_of(self)

    @property
    def in_brief(self) -> str:
        """The verdict and the cost that it is about."""
        return f"{self.verdict}, F = {cost_shown(self.cost_upper)}"

    @property
    def _headline(self) -> str:
        return f"{self.verdict}: {meaning(self)}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from self._proven()
        yield "next", advice(self)

    def _proven(self) -> Iterator[tuple[str, str]]:
        yield from numbers(self)
        yield "reason", self.reason
        yield from trusts(self)
        yield "objective", self.objective


def advice(certificate: Statement) -> str:
    """What to do next, in Python."""
    if certificate.verdict != "BOUNDED":
        return _NEXT[certificate.verdict]
    if certificate.tier == "screen":
        return _SCREENED
    return _POLISHED if certificate.basin_is_global else _NEXT["BOUNDED"]


def meaning(certificate: Statement) -> str:
    """What the verdict means."""
    verdict = certificate.verdict
    if certificate.tier == "screen" and verdict == "BOUNDED":
        return _HINT
    in_right_basin = verdict == "BOUNDED" and certificate.basin_is_global
    if in_right_basin:
        return _RIGHT_BASIN if certificate.descended else _RIGHT_ROTATIONS
    if verdict == "CERTIFIED" and certificate.gap > certificate.rtol * certificate.cost_upper:
        return _within(certificate)
    lower = certificate.best_cost < certificate.cost_upper - certificate.tolerance
    return _LOWER if lower and verdict == "UNDECIDED" else _MEANINGS[verdict]


def _within(certificate: Statement) -> str:
    """What CERTIFIED means where only the part of W makes it so."""
    share = f", {part(certificate.relative_gap)} of F" if certificate.cost_upper > 0.0 else ""
    gap = gap_shown(certificate.gap)
    return f"to within atol W{share}: no estimate can be better by more than {gap}; this is proven"


def trusts(certificate: Statement) -> Iterable[tuple[str, str]]:
    """The assumptions of the proof, unless nothing was proven."""
    if certificate.verdict != "UNDECIDED":
        angles = certificate.tier == "proof" and "EdgeSE2" in certificate.objective
        yield "proof rests on", _TRUSTS[certificate.tier] + (_ANGLES if angles else "")


def objective(reading: Mapping[str, str], certificate: Statement | None = None) -> str:
    """The cost that the verdict refers to."""
    if certificate is not None and certificate.objective != CHORDAL:
        return certificate.objective
    return f"F with {reading_sentence(reading)}"


def stated_objective(reading: Mapping[str, str], certificate: Statement) -> str:
    """The cost that the verdict refers to, and that others minimise others."""
    others = " (other tools minimise other errors)" if certificate.objective == CHORDAL else ""
    return f"{objective(reading, certificate)}{others}"


def part(share: float) -> str:
    """A share, rounded up, in percent, or in scientific notation if it is small."""
    if share >= 1e-3:
        return f"{rounded_up(100.0 * share, 3)} %"
    return f"{float(rounded_up(share, 3)):.2e}"


def bound_claim(certificate: Statement) -> str:
    """What the lower bound says of all estimates."""
    claim = "no estimate of this graph costs less"
    return f"likely: {claim}" if certificate.tier == "screen" else claim


def numbers(certificate: Statement) -> Iterable[tuple[str, str]]:
    """Cost, bound, gap and tolerance as names and values."""
    yield "cost F, at most", cost_shown(certificate.cost_upper)
    if math.isfinite(certificate.lower_bound):
        shown = f"{bound_shown(certificate.lower_bound)}  ({bound_claim(certificate)})"
        yield "lower bound", shown
        positive = certificate.cost_upper > 0.0
        share = f"  ({part(certificate.relative_gap)} of the cost)" if positive else ""
        yield "gap", f"{gap_shown(certificate.gap)}{share}"
    mostly = certificate.atol * certificate.scale > certificate.rtol * certificate.cost_upper
    of_weights = f"  (mostly {certificate.atol:.3g} of the total weight W)" if mostly else ""
    yield "tolerance", f"{certificate.tolerance:.3g}{of_weights}"
    yield "largest residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost_upper - certificate.tolerance:
        ended = "" if certificate.settled else "part of a "
        name, what = ("after descent", f"after {ended}local descent")
        if not certificate.descended:
            name, what = "translations", "with its best translations"
        yield name, f"{cost_shown(certificate.refined_cost)}  (its cost {what})"
    if certificate.better_cost is not None:
        yield "lower cost", cost_shown(certificate.better_cost)


def reason_of(c: Statement) -> str:
    """One sentence on what is proven about the estimate, and why it is not more."""
    if not math.isfinite(c.cost_upper):
        return "the cost of this estimate is beyond the range of doubles"
    why = limit_in_words(c) if c.verdict in ("BOUNDED", "UNDECIDED") else ""
    if why and c.verdict == "UNDECIDED" and c.obstacle.searched:
        return why
    return f"{_proven(c)}; {why}" if why else _proven(c)


def _proven(c: Statement) -> str:
    """What is proven about the estimate."""
    floor = f"no estimate of this graph costs less than {bound_shown(c.lower_bound)}"
    if c.tier == "screen":
        floor = f"likely, though not proven at this tier: {floor}"
    own = f"this one costs {cost_shown(c.cost_upper)}"
    by = "after local descent" if c.descended else "with its best translations"
    by = by if c.settled or not c.descended else "after part of a local descent"
    improved = f"{own} and, {by}, {cost_shown(c.refined_cost)}"
    lower = c.refined_cost < c.cost_upper - c.tolerance
    if c.verdict == "CERTIFIED":
        within = f"{floor}; {own}, within {_of_f(c)} of the optimum"
        if c.gap <= c.rtol * c.cost_upper:
            return within
        small = f"{within}, which is negligible relative to the total weight W = {c.scale:.2g}"
        return (
            f"{small}, though not to F: atol=0 compares with F alone"
            if c.gap > LARGE * c.cost_upper
            else small
        )
    if c.better_cost is not None and c.verdict != "REFUTED":
        also = f"another estimate costs {cost_shown(c.better_cost)}"
        return f"{floor}; {improved if lower else own}; {also}"
    if c.better_cost is not None:
        descent = "does not lead there" if c.settled else "was given up far from it"
        return (
            f"another estimate costs {cost_shown(c.better_cost)}; "
            f"{improved if lower else own}, and local descent from it {descent}; {floor}"
        )
    if c.verdict == "UNDECIDED":
        return f"{own}, and no lower bound above zero could be proven"
    if c.basin_is_global and not c.descended:
        return f"{floor}; {improved}, the optimum: only its translations are not the best"
    if c.basin_is_global:
        return (
            f"{floor}; {improved}, the optimum: this one is in the right basin, but not at its "
            "minimum"
        )
    if lower:
        return f"{floor}; {improved}: the optimum is at most that"
    return f"{floor}; {own}, at most {_of_f(c)} above the optimum"


def _of_f(c: Statement) -> str:
    """The gap relative to F and in absolute terms."""
    if not c.cost_upper > 0.0:
        return gap_shown(c.gap)
    share = part(c.relative_gap)
    return f"{share}{' of' * share.endswith('%')} F = {gap_shown(c.gap)}"


def limit_in_words(c: Statement) -> str:
    """What keeps the gap open, in words; empty where the numbers say it."""
    o = c.obstacle
    undecided = c.verdict == "UNDECIDED"
    if o.missing and o.edge is not None:
        count = counted(o.missing, "measurement{s}")
        return f"{count} without a minorant there, such as edge {o.edge}"
    if o.mirrored is not None:
        return _MIRRORED[o.mirrored]
    if o.of_distances:
        return _of_distances(o)
    if o.kind is LimitedBy.STOPPED:
        return _stopped(o, undecided=undecided)
    if o.kind is not LimitedBy.ROUNDING or not o.searched:
        return ""
    if not undecided:
        return "the relaxation has no lower point beyond rounding, which limits the proof"
    share = c.cost_upper / c.scale
    return (
        "the relaxation has no lower point beyond rounding, but the cost, "
        f"{c.cost_upper:.4g}, is only {share:.1g} of the total weight W, too little for a proof "
        f"that allows for rounding: atol={2.0 * share:.1g} treats it as zero, and weights that "
        "state the true precision of the data raise it"
    )


def _stopped(o: Obstacle, *, undecided: bool) -> str:
    """That a search ended early."""
    if not o.searched:
        return f"the search for a bound ended early ({o.stopped})"
    if o.patience is not None:
        ended = f"the staircase ended at rank {o.rank}, {early(o.patience)}"
        return f"{ended} before a useful bound was found" if undecided else ended
    return "stopped before a useful bound was found" if undecided else ""


def _of_distances(o: Obstacle) -> str:
    """What the relaxation of measured distances is worth."""
    if o.searched:
        return (
            f"the relaxation of distances is not tight: its optimum has rank {o.rank} and is no "
            "map, so that this gap cannot be closed"
        )
    if o.stopped is not None:
        return f"the relaxation was not solved before the search was stopped ({o.stopped})"
    return f"the relaxation was not solved: the climb ended by itself, at rank {o.rank}"


def early(patience: float) -> str:
    """That a search ended by its own limit, and how to let it continue."""
    return (
        f"{patience:g} s after a first bound; setting a time limit (time_limit, --time-limit) lets "
        "it continue"
    )
