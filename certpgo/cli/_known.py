"""What the register of public graphs says, for the commands that read a graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from certpgo.certify import Certificate
    from certpgo.graph import Instance
    from certpgo.optima import Recognised


def known(part: Instance, cost: str, certificate: Certificate | None) -> Recognised | None:
    """What is known of a graph under a cost; None where the verdict is about another cost."""
    from certpgo.optima import known_optimum

    if certificate is not None and certificate.rejected:
        return None
    return known_optimum(part, cost)


def fact(found: Recognised | None, certificate: Certificate | None) -> Iterator[tuple[str, str]]:
    """The same as a name and a value, and how far the estimate is above the bound at most."""
    if found is None:
        return
    said = str(found)
    if certificate is not None and found.is_exact:
        said += f"; {found.compared(certificate.cost_upper)}"
    yield "register", said


def as_json(found: Recognised | None) -> dict[str, Any] | None:
    """The same for --json; None for a graph that is not known."""
    if found is None:
        return None
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
