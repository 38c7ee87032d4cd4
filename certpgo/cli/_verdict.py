"""A certificate in words that need no paper, as JSON, and as an exit code."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from certpgo.cli._show import facts

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.harness.assessment import Assessment

#: Exit code after Ctrl-C.
INTERRUPTED = 130
#: Exit codes by verdict, in the order of what a caller should act on.
EXIT_CODES = {"CERTIFIED": 0, "ERROR": 1, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}
#: Costliest edges that are shown; --json has more.
EDGES = 3
#: What a file's digits cost is said from this part of the tolerance on.
NOTABLE = 0.01

_MEANINGS = {
    "CERTIFIED": "no other answer can be better by more than the tolerance, and this is proven",
    "BOUNDED": "how far this answer can be from the best is proven, but exceeds the tolerance",
    "REFUTED": "a better answer is in hand, which improving this one step by step does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
_RIGHT_BASIN = "not the best answer, but improving it reaches the best, and this is proven"
_HINT = "a hint of how far this answer can be from the best; at this tier nothing is proven"
_TRUSTS = {
    "screen": "a factorization as it is, its rounding errors unbounded: a hint, no proof",
    "standard": (
        "a factorization whose rounding errors are bounded, if the linear algebra library keeps "
        "the usual error bound of such factorizations"
    ),
    "proof": (
        "what a factorization leaves over, measured in integers and exact products: IEEE 754 "
        "arithmetic, Python and sums of products by NumPy are all that is trusted"
    ),
}


def exit_code(certificates: Iterable[Certificate]) -> int:
    """The exit code of the weakest verdict."""
    return weakest(c.verdict.value for c in certificates)


def weakest(verdicts: Iterable[str]) -> int:
    """The exit code of the weakest of these verdicts, ``ERROR`` being one."""
    return max((EXIT_CODES[verdict] for verdict in verdicts), default=0)


def show(
    certificate: Certificate, reading: Mapping[str, str], assessment: Assessment | None = None
) -> None:
    """Print the verdict, its reason, the numbers behind it, and by which reading it is judged."""
    verdict = certificate.verdict.value
    meaning = _RIGHT_BASIN if _is_near(certificate) else _MEANINGS[verdict]
    if certificate.tier.value == "screen" and verdict == "BOUNDED":
        meaning = _HINT
    facts(
        [
            (verdict, meaning),
            ("because", certificate.reason),
            *_numbers(certificate),
            *(() if assessment is None else _comparison(assessment)),
            ("proof rests on", _TRUSTS[certificate.tier.value]),
            ("judged by", f"{judged_by(reading)} (other tools minimise other errors)"),
        ]
    )


def judged_by(reading: Mapping[str, str]) -> str:
    """Which cost it is that the verdict is about."""
    from certpgo.harness.render import reading_sentence

    return f"F with {reading_sentence(reading)}"


def _is_near(certificate: Certificate) -> bool:
    """Whether the best answer is the one that this one leads to."""
    return certificate.verdict.value == "BOUNDED" and certificate.basin_is_global


def _part(share: float) -> str:
    return f"{100.0 * share:.3g} %" if share >= 1e-3 else f"{share:.2e}"


def _numbers(certificate: Certificate) -> Iterable[tuple[str, str]]:
    yield "cost F", f"{certificate.cost:.12g}"
    if math.isfinite(certificate.lower_bound):
        said = "no answer of this graph costs less"
        said = f"likely: {said}" if certificate.tier.value == "screen" else said
        yield "lower bound", f"{certificate.lower_bound:.12g}  ({said})"
        share = (
            "" if certificate.cost <= 0.0 else f"  ({_part(certificate.relative_gap)} of the cost)"
        )
        yield "gap", f"{certificate.gap:.3g}{share}"
    yield "tolerance", f"{certificate.tolerance:.3g}"
    yield "worst residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost - certificate.tolerance:
        yield (
            "improved",
            f"{certificate.refined_cost:.12g}  (its cost after improving it step by step)",
        )
    if certificate.better_cost is not None:
        yield "better answer", f"{certificate.better_cost:.12g}"


def _comparison(a: Assessment) -> Iterable[tuple[str, str]]:
    """How far the best answer in hand is, where the cost sits, and what digits cost."""
    c, d = a.certificate, a.distance
    if a.excess > c.tolerance:
        which = "the best possible answer" if a.best_is_optimal else "the best answer found"
        apart = f"{which} is {d.mean_deg:.3g} degrees away on average, {d.worst_deg:.3g} at most"
        if d.mean_m is not None:
            apart += f"; {d.mean_m:.3g} m on average, {d.worst_m:.3g} m at most"
        yield "distance", apart
        share = f" ({_part(a.excess / c.cost)})" if math.isfinite(c.cost) else ""
        yield "", f"and costs {a.excess:.4g}{share} less than this one"
    for k, edge in enumerate(a.edges[:EDGES]):
        metres = "" if edge.metres is None else f", {edge.metres:.3g} m"
        said = f"{edge.ids[0]} to {edge.ids[1]}: {100.0 * edge.share:.3g} % of F"
        yield (
            "" if k else "costliest edges",
            f"{said}, off by {math.degrees(edge.angle):.4g} degrees{metres}",
        )
    if a.rounding is not None:
        digits, cost = a.rounding.digits, a.rounding.cost
        if cost is None:
            yield "digits", f"the file's {digits} are too few for rotations"
        elif cost > NOTABLE * c.tolerance:
            share = f", {cost / a.best_cost:.1e} of F" if a.best_cost > c.tolerance else ""
            yield (
                "digits",
                f"the file's {digits} make even the best answer cost {cost:.1g} more{share}",
            )


def comparison_as_json(a: Assessment) -> dict[str, Any]:
    """What `show` says beyond the certificate; angles of edges in radians."""
    d = a.distance
    return {
        "best": {
            "cost": a.best_cost,
            "is_optimal": a.best_is_optimal,
            "excess": a.excess,
            "relative_excess": a.relative_excess,
            "mean_deg": d.mean_deg,
            "worst_deg": d.worst_deg,
            "mean_m": d.mean_m,
            "worst_m": d.worst_m,
        },
        "costliest_edges": [
            {
                "edge": edge.edge,
                "ids": list(edge.ids),
                "cost": edge.cost,
                "share": edge.share,
                "angle": edge.angle,
                "metres": edge.metres,
            }
            for edge in a.edges
        ],
        "digits": None
        if a.rounding is None
        else {
            "count": a.rounding.digits.count,
            "decimals": a.rounding.digits.decimals,
            "cost": a.rounding.cost,
        },
    }


def as_json(certificate: Certificate) -> dict[str, Any]:
    """The certificate without its arrays; angles in radians."""
    return {
        "verdict": certificate.verdict.value,
        "reason": certificate.reason,
        "tier": certificate.tier.value,
        "cost": certificate.cost,
        "lower_bound": certificate.lower_bound,
        "gap": certificate.gap,
        "relative_gap": certificate.relative_gap,
        "rtol": certificate.rtol,
        "atol": certificate.atol,
        "scale": certificate.scale,
        "stationarity": certificate.stationarity,
        "max_residual_angle": certificate.max_residual_angle,
        "refined_cost": certificate.refined_cost,
        "basin_is_global": certificate.basin_is_global,
        "better_cost": certificate.better_cost,
        "engine": certificate.engine,
    }
