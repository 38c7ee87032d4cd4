"""A certificate in words: what it means, what it rests on, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from certpgo.certify.obstacle import LimitedBy, Obstacle
from certpgo.graph import Estimate
from certpgo.graph.display import Speaking
from certpgo.graph.phrases import (
    bound_shown,
    cost_shown,
    counted,
    gap_shown,
    reading_sentence,
    rounded_up,
)
from certpgo.objective.quadratic import CHORDAL

_MEANINGS = {
    "REFUTED": "A better estimate is known. Local descent from this one does not reach it",
    "UNDECIDED": "Nothing useful could be proven, for or against this estimate",
}
_GIVEN_UP = "A better estimate is known. Local descent from this one was given up far from it"
_LOWER = "No bound could be proven. An estimate of lower cost is known"
_RIGHT_BASIN = "Right basin. Local descent from this estimate reaches the proven optimum"
_RIGHT_ROTATIONS = "Right rotations. With its best translations this estimate is the proven optimum"
_TRUSTS = {
    "screen": "a factorization whose rounding errors are not bounded: a hint, not a proof",
    "standard": (
        "a factorization with bounded rounding errors, if the linear algebra library keeps the "
        "usual error bound"
    ),
    "proof": (
        "the residual of a factorization, computed in integers and exact products: only IEEE 754 "
        "arithmetic, Python and NumPy's sums of products are trusted"
    ),
}
_ANGLES = ", and NumPy's sine and arctangent to 4 units in the last place"

#: Why the relaxation may be loose where positions alone join parts: for those on a line of the
#: plane or in a plane of space, and else.
_MIRRORED = {
    "line": "the positions lie on a line, so a mirror image fits them as well and the relaxation "
    "cannot exclude it: attitudes, or positions off the line, would",
    "plane": "the positions lie in a plane, so a mirror image fits them as well and the relaxation "
    "cannot exclude it: attitudes, or positions off the plane, would",
    "perhaps": "the relaxation may mirror what only positions and odometry hold: attitudes or "
    "loop closures would exclude this",
}

#: What to do next, in Python; the quickstart says more.
_NEXT = {
    "CERTIFIED": "nothing: keep the estimate",
    "BOUNDED": "certpgo.solve(graph, initial=estimate) searches further; the gap holds meanwhile",
    "REFUTED": "take certificate.better, or start your solver from certpgo.solve(graph).estimate",
    "UNDECIDED": "see the reason; certpgo.solve(graph) finds an estimate",
}
_POLISHED = "take certificate.refined, or keep the estimate: it can lose no more than the gap"
_FINAL = "keep the estimate: it can lose no more than the gap"
_SCREENED = 'certify(..., tier="standard") proves a gap'


class Statement(Speaking):
    """What words are about; `certpgo.Certificate` explains the attributes."""

    if TYPE_CHECKING:
        verdict: str
        tier: str
        cost_computed: float
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
        refined: Estimate
        descended: bool
        settled: bool
        obstacle: Obstacle
        rejected: int
        broken: bool

        @property
        def relative_gap(self) -> float: ...  # noqa: D102

        @property
        def tolerance(self) -> float: ...  # noqa: D102

        @property
        def is_exact_fit(self) -> bool: ...  # noqa: D102

        @property
        def best_cost(self) -> float: ...  # noqa: D102

        def far(self) -> Iterable[tuple[str, str]]: ...  # noqa: D102

    @property
    def reason(self) -> str:
        """The reason for the verdict: what is proven, and what limits it."""
        return reason_of(self)

    @property
    def in_brief(self) -> str:
        """The verdict and the cost that it is about."""
        return f"{self.stated}, {self.cost_in_words} = {cost_shown(self.cost_upper)}"

    @property
    def stated(self) -> str:
        """The verdict as headlines state it."""
        return EXACT_FIT if self.is_exact_fit else self.verdict

    @property
    def cost_in_words(self) -> str:
        """What ``cost_upper`` is."""
        broken = " and that of the held nodes that are moved" if self.broken else ""
        return f"{named_cost(self.objective)}{broken}"

    @property
    def _headline(self) -> str:
        return f"{self.stated}. {meaning(self)}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield from self._proven(self.far())
        yield "next", advice(self)

    def _proven(self, far: Iterable[tuple[str, str]]) -> Iterator[tuple[str, str]]:
        yield from (*numbers(self), *reasons(self), *far, *trusts(self))


def named_cost(objective: str) -> str:
    """A cost by its name, from the objective of a certificate."""
    return "chordal cost F" if objective == CHORDAL else objective


def advice(certificate: Statement) -> str:
    """What to do next, in Python."""
    if certificate.verdict != "BOUNDED":
        return _NEXT[certificate.verdict]
    if certificate.tier == "screen":
        return _SCREENED
    if certificate.basin_is_global:
        return _POLISHED
    return _FINAL if certificate.obstacle.is_final else _NEXT["BOUNDED"]


def meaning(certificate: Statement) -> str:
    """What the verdict means, in sentences without the last stop."""
    c = certificate
    if c.verdict == "BOUNDED" and c.tier == "screen":
        return f"Probably {_above(c)} above the optimum. This tier proves nothing"
    if c.verdict == "BOUNDED" and c.basin_is_global:
        return _RIGHT_BASIN if c.descended else _RIGHT_ROTATIONS
    if c.is_exact_fit:
        return _FITS
    if c.verdict in ("CERTIFIED", "BOUNDED"):
        proven = f"Proven: {_optimal(c)}{_above(c)} above the optimum"
        return f"{proven}. {_SMALL}" if _is_within_atol(c) else proven
    if c.verdict == "REFUTED" and not c.settled:
        return _GIVEN_UP
    lower = c.best_cost < c.cost_upper - c.tolerance
    return _LOWER if lower and c.verdict == "UNDECIDED" else _MEANINGS[c.verdict]


def _optimal(c: Statement) -> str:
    """That it is optimal among all choices of rejected measurements, if that is so."""
    if not c.rejected or c.verdict != "CERTIFIED":
        return ""
    if c.rejected == 1:
        return "neither taking the rejected measurement back nor another estimate costs less; "
    return (
        f"no choice among the {c.rejected} rejected measurements and no other estimate costs less; "
    )


#: Share of the cost from which rounding of its evaluation is worth a line.
UNCERTAIN = 1e-6
#: What headlines state of a CERTIFIED estimate whose cost is rounding.
EXACT_FIT = "EXACT FIT"
_FITS = "Every measurement is met to ten digits: the cost is what rounding leaves"
_SMALL = "That is negligible against the total weight W"


def _is_within_atol(c: Statement) -> bool:
    """Whether only the part of W in the tolerance makes it CERTIFIED."""
    return c.verdict == "CERTIFIED" and c.gap > c.rtol * c.cost_upper


def _above(c: Statement) -> str:
    """The gap, in absolute terms and relative to the cost."""
    cost = "truncated cost" if c.rejected else "cost"
    share = f" ({part(c.relative_gap)} of the {cost})" if c.cost_upper > 0.0 else ""
    return f"at most {gap_shown(c.gap)}{share}"


def reasons(certificate: Statement) -> Iterable[tuple[str, str]]:
    """What keeps the gap open, where the numbers do not say it."""
    c = certificate
    if not math.isfinite(c.cost_upper):
        yield "reason", _OVERFLOW
    elif c.verdict in ("BOUNDED", "UNDECIDED") and (why := obstacle_in_words(c)):
        yield "reason", why
    elif c.verdict == "UNDECIDED":
        yield "reason", _NO_BOUND


def trusts(certificate: Statement) -> Iterable[tuple[str, str]]:
    """The assumptions of the proof, unless nothing was proven."""
    c = certificate
    if c.verdict != "UNDECIDED":
        in_plane = c.refined.rotations.shape[-1] == 2
        angles = c.tier == "proof" and c.objective != CHORDAL and in_plane
        yield "proof rests on", _TRUSTS[c.tier] + (_ANGLES if angles else "")


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
    return "probably no estimate costs less" if certificate.tier == "screen" else _CLAIM


def numbers(
    certificate: Statement, metres: float | None = None, unit: str = "m"
) -> Iterable[tuple[str, str]]:
    """Cost, bound, gap and tolerance as names and values.

    Parameters
    ----------
    metres : the largest translation residual, if it is known
    unit : its unit
    """
    c = certificate
    rounded = ", rounded up" if c.is_exact_fit else ""
    yield "cost", f"{cost_shown(c.cost_upper)}  ({c.cost_in_words}{rounded})"
    if c.cost_computed < (1.0 - UNCERTAIN) * c.cost_upper and not c.is_exact_fit:
        computed = cost_shown(c.cost_computed)
        yield "as computed", f"{computed}  (above, rounding under large weights is added)"
    if math.isfinite(c.lower_bound):
        yield "lower bound", f"{bound_shown(c.lower_bound)}  ({bound_claim(c)})"
        share = f"  ({part(c.relative_gap)} of the cost)" if c.cost_upper > 0.0 else ""
        yield "gap", f"{gap_shown(c.gap)}{'  (rounding)' if c.is_exact_fit else share}"
    mostly = "  (mostly as the cost is almost zero against the total weight W)"
    of_weights = mostly if c.tolerance > 2.0 * c.rtol * c.cost_upper else ""
    if not c.is_exact_fit:
        yield "tolerance", f"{c.tolerance:.3g}{of_weights}"
    far = "" if metres is None else f", {metres:.4g} {unit}"
    yield "largest residual", f"{math.degrees(c.max_residual_angle):.4g} degrees{far}"
    if c.refined_cost < c.cost_upper - c.tolerance:
        ended = "" if c.settled else "part of a "
        name, what = ("after descent", f"its cost after {ended}local descent")
        if not c.descended:
            name, what = "translations", "its cost with its best translations"
        yield name, f"{cost_shown(c.refined_cost)}  ({what})"
    if c.better_cost is not None:
        yield "lower cost", f"{cost_shown(c.better_cost)}  (of the better estimate)"


_CLAIM = "no estimate of this graph costs less"
_OVERFLOW = "the cost of this estimate is beyond the range of doubles"
_NO_BOUND = "no lower bound above zero could be proven"
_LOOSE = "the relaxation is not tight, as far as is known: its optimum is below all estimates"


def reason_of(c: Statement) -> str:
    """What is proven about the estimate, and why it is not more."""
    if not math.isfinite(c.cost_upper):
        return _OVERFLOW
    why = obstacle_in_words(c) if c.verdict in ("BOUNDED", "UNDECIDED") else ""
    if why and c.verdict == "UNDECIDED" and c.obstacle.searched:
        return why
    return f"{_proven(c)}; {why}" if why else _proven(c)


def _proven(c: Statement) -> str:
    """What is proven about the estimate."""
    floor = f"{_CLAIM} than {bound_shown(c.lower_bound)}"
    if c.tier == "screen":
        floor = f"probably, though this tier proves nothing, {floor}"
    own, improved = f"this one costs {cost_shown(c.cost_upper)}", _improved(c)
    if c.is_exact_fit:
        return f"{floor}; {own}, and every measurement is met up to rounding"
    if c.verdict == "CERTIFIED":
        return f"{floor}; {own}, {_above(c)} above the optimum{_against_weight(c)}"
    if c.better_cost is not None:
        better = f"another estimate costs {cost_shown(c.better_cost)}"
        if c.verdict != "REFUTED":
            return f"{floor}; {improved or own}; {better}"
        descent = "does not lead there" if c.settled else "was given up far from it"
        return f"{better}; {improved or own}, and local descent from it {descent}; {floor}"
    if c.verdict == "UNDECIDED":
        return f"{own}; {_NO_BOUND}"
    if c.basin_is_global:
        return f"{floor}; right basin: {improved or own}, the optimum"
    if improved:
        return f"{floor}; {improved}, so the optimum is at most that"
    return f"{floor}; {own}, {_above(c)} above the optimum"


def _improved(c: Statement) -> str:
    """The cost before and after descent, if that lowers it."""
    if not c.refined_cost < c.cost_upper - c.tolerance:
        return ""
    by = "after local descent" if c.settled else "after part of a local descent"
    by = by if c.descended else "with its best translations"
    return f"this one costs {cost_shown(c.cost_upper)}, {by} {cost_shown(c.refined_cost)}"


def _against_weight(c: Statement) -> str:
    """That the gap is small only against the total weight, if so."""
    small = f", which is negligible against the total weight W = {c.scale:.2g}"
    return small if _is_within_atol(c) else ""


def obstacle_in_words(c: Statement) -> str:
    """What keeps the gap open, in words; empty where the numbers say it."""
    o, undecided = c.obstacle, c.verdict == "UNDECIDED"
    if o.missing and o.edge is not None:
        count = counted(o.missing, "measurement{s}")
        return f"{count} without a minorant at this estimate, such as edge {o.edge}"
    if o.ambiguous:
        few = counted(len(o.ambiguous), "rejected measurement{s}")
        return f"{few} of {c.rejected} may, all at once, be explained by the estimate's uncertainty"
    if o.mirrored is not None:
        return _MIRRORED[o.mirrored]
    if o.of_distances:
        return _of_distances(o)
    if o.kind is LimitedBy.STOPPED:
        return _stopped(o, undecided=undecided)
    if not o.searched:
        return ""
    if o.kind is LimitedBy.LOOSE:
        return "" if undecided else _LOOSE
    if o.kind is not LimitedBy.ROUNDING:
        return ""
    if not undecided:
        return "only rounding keeps the gap open: the relaxation has no lower point"
    share = c.cost_upper / c.scale
    return (
        f"the relaxation has no lower point, but the cost, {c.cost_upper:.4g}, is only "
        f"{share:.1g} of the total weight W, too little for a proof that allows for rounding, and "
        "too much for an exact fit"
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
            f"the range relaxation is not tight: its optimum has rank {o.rank} and is not a map, "
            "so this gap cannot be closed"
        )
    if o.stopped is not None:
        return f"the range relaxation was not solved: the search was stopped ({o.stopped})"
    return f"the range relaxation was not solved: the staircase ended by itself, at rank {o.rank}"


def early(patience: float) -> str:
    """That a search ended by its own limit, and how to let it continue."""
    return (
        f"{patience:g} s after a first bound; a time limit (time_limit, --time-limit) lets it "
        "continue"
    )
