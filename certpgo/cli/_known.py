"""What the register of public graphs says, for the commands that read a graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Instance
    from certpgo.optima import Recognised


def fact(part: Instance, cost: str | None, certificate: Certificate) -> Iterator[tuple[str, str]]:
    """What is known of a graph, and how far the estimate is above that, as a name and a value."""
    found = _known(part, cost, certificate)
    if found is not None:
        compared = f"; {found.compared(certificate.cost_upper)}" if found.is_exact else ""
        yield "register", f"{found}{compared}"


def as_json(
    part: Instance, cost: str | None, certificate: Certificate | None
) -> dict[str, Any] | None:
    """What is known of a graph, for --json; None if nothing is."""
    found = _known(part, cost, certificate)
    return None if found is None else in_short(found)


def in_short(found: Recognised) -> dict[str, Any]:
    """A graph's name in the register, and its bounds under a cost."""
    o = found.optimum
    return {
        "name": o.name,
        "cost": o.cost,
        "is_exact": found.is_exact,
        "lower_bound": o.lower,
        "cost_upper": o.upper,
        "verdict": o.verdict,
        "tier": o.tier,
    }


def _known(part: Instance, cost: str | None, certificate: Certificate | None) -> Recognised | None:
    """What is known under a cost; None where the verdict is about other measurements."""
    from certpgo.optima import known_optimum

    if cost is None or (certificate is not None and certificate.rejected):
        return None
    return known_optimum(part, cost)
