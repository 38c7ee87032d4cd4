"""A certificate in words: what it means, what it rests on, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

from certpgo.graph.speaking import Speaking
from certpgo.graph.wording import reading_sentence, rounded_down, rounded_up
from certpgo.optimize.monitor import CHORDAL

_MEANINGS = {
    "CERTIFIED": "no estimate can be better by more than the tolerance; this is proven",
    "BOUNDED": "the gap to the best possible estimate is proven, but exceeds the tolerance",
    "REFUTED": "a lower-cost estimate exists that local descent from this one does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
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
        reason: str
        objective: str
        descended: bool
        settled: bool

        @property
        def relative_gap(self) -> float: ...  # noqa: D102

        @property
        def tolerance(self) -> float: ...  # noqa: D102

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
    return _MEANINGS[verdict]


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


def numbers(certificate: Statement) -> Iterable[tuple[str, str]]:
    """Cost, bound, gap and tolerance as names and values."""
    yield "cost F, at most", rounded_up(certificate.cost_upper, 12)
    if math.isfinite(certificate.lower_bound):
        claim = "no estimate of this graph costs less"
        claim = f"likely: {claim}" if certificate.tier == "screen" else claim
        yield "lower bound", f"{rounded_down(certificate.lower_bound, 12)}  ({claim})"
        positive = certificate.cost_upper > 0.0
        share = f"  ({part(certificate.relative_gap)} of the cost)" if positive else ""
        yield "gap", f"{rounded_up(certificate.gap, 3)}{share}"
    mostly = certificate.atol * certificate.scale > certificate.rtol * certificate.cost_upper
    of_weights = f"  (mostly {certificate.atol:.3g} of the total weight W)" if mostly else ""
    yield "tolerance", f"{certificate.tolerance:.3g}{of_weights}"
    yield "largest residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost_upper - certificate.tolerance:
        ended = "" if certificate.settled else "part of a "
        name, what = ("after descent", f"after {ended}local descent")
        if not certificate.descended:
            name, what = "translations", "with its best translations"
        yield name, f"{certificate.refined_cost:.12g}  (its cost {what})"
    if certificate.better_cost is not None:
        yield "lower cost", f"{certificate.better_cost:.12g}"
