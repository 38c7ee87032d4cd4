"""A certificate in words that need no paper, as JSON, and as an exit code."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from certpgo.cli._show import facts

if TYPE_CHECKING:
    from certpgo.certify import Certificate

#: Exit code after Ctrl-C.
INTERRUPTED = 130
#: Exit codes by verdict, in the order of what a caller should act on.
EXIT_CODES = {"CERTIFIED": 0, "BOUNDED": 3, "REFUTED": 4, "UNDECIDED": 5}

_MEANINGS = {
    "CERTIFIED": "no other answer can be better by more than the tolerance, and this is proven",
    "BOUNDED": "how far this answer can be from the best is proven, but exceeds the tolerance",
    "REFUTED": "a better answer exists, which improving this one step by step does not reach",
    "UNDECIDED": "nothing useful could be proven, for or against",
}
_TRUSTS = {
    "screen": "a factorization as it is, its rounding errors unbounded: a hint, no proof",
    "standard": (
        "a factorization whose rounding errors are bounded, if the linear algebra library keeps "
        "the usual error bound of such factorizations"
    ),
}


def exit_code(certificates: Iterable[Certificate]) -> int:
    """The exit code of the weakest verdict."""
    return max((EXIT_CODES[c.verdict.value] for c in certificates), default=0)


def show(certificate: Certificate, reading: Mapping[str, str]) -> None:
    """Print the verdict, its reason, the numbers behind it, and by which reading it is judged."""
    from certpgo.harness.render import reading_sentence

    verdict = certificate.verdict.value
    judged_by = f"F with {reading_sentence(reading)} (other tools minimise other errors)"
    facts(
        [
            (verdict, _MEANINGS[verdict]),
            ("because", certificate.reason),
            *_numbers(certificate),
            ("judged by", judged_by),
        ]
    )


def _numbers(certificate: Certificate) -> Iterable[tuple[str, str]]:
    yield "cost F", f"{certificate.cost:.12g}"
    if math.isfinite(certificate.lower_bound):
        yield "lower bound", f"{certificate.lower_bound:.12g}  (no answer of this graph costs less)"
        share = "" if certificate.cost <= 0.0 else f"  ({certificate.relative_gap:.2e} of the cost)"
        yield "gap", f"{certificate.gap:.3g}{share}"
    yield "tolerance", f"{certificate.tolerance:.3g}"
    yield "worst residual", f"{math.degrees(certificate.max_residual_angle):.4g} degrees"
    if certificate.refined_cost < certificate.cost - certificate.tolerance:
        yield "improved", f"{certificate.refined_cost:.12g}  (cost after improving it step by step)"
    if certificate.better_cost is not None:
        yield "better answer", f"{certificate.better_cost:.12g}"
    yield "proof rests on", _TRUSTS[certificate.tier.value]


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
