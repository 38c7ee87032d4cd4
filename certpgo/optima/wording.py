"""An entry of the register in words."""

from __future__ import annotations

from collections.abc import Iterator

from certpgo.graph.phrases import bound_shown, cost_shown, gap_shown
from certpgo.optima.register import Optimum, Register
from certpgo.optima.remarks import Remarks
from certpgo.optima.verifying import command

HEADER = (
    "graph",
    "cost",
    "d",
    "poses",
    "points",
    "edges",
    "ranges",
    "priors",
    "optimum at least",
    "at most",
    "gap",
    "verdict",
    "tier",
)
TRUST = {
    "standard": "a factorization whose rounding is bounded (tier standard)",
    "proven": "IEEE 754 arithmetic alone (tier proven)",
    "exact": "a proof that the checker accepted in integers (tier exact)",
}


def interval(o: Optimum) -> str:
    """Where the optimum is."""
    return f"{bound_shown(o.lower)} <= optimum <= {cost_shown(o.upper)}"


def row(o: Optimum) -> tuple[str, ...]:
    """An entry's cells, as of `HEADER`."""
    s = o.sizes
    counts = (s.d, s.poses, s.points, s.edges, s.ranges, s.priors)
    sizes = [str(count) if count else "" for count in counts]
    bounds = (bound_shown(o.lower), cost_shown(o.upper), gap_shown(o.relative_gap))
    return (o.name, o.cost, *sizes, *bounds, o.verdict, o.tier)


def details(o: Optimum, register: Register) -> Iterator[tuple[str, str]]:
    """The numbers of an entry and what they rest on, as names and values."""
    yield "verdict", f"{o.verdict}, relative gap {gap_shown(o.relative_gap)}"
    yield "rests on", TRUST[o.tier]
    if o.chi2 is not None:
        yield "chi^2", f"{o.chi2:.6g} at {o.freedom} degrees of freedom"
    said = register.remarks.get(o.name, Remarks())
    if said.text:
        yield "remark", said.text
    for one in said.of(o.cost):
        yield "published", f"{one.value} ({one.source})"
    for one in said.wrong:
        if one.cost == o.cost:
            yield "not", f"{one.value}: {one.source}"
    if len(o.names) > 1:
        yield "also called", ", ".join(o.names[1:])
    for source in o.sources:
        yield "source", source
    if o.kept:
        yield "proof", str(register.proof(o))
    elif o.proof_sha256 is not None:
        yield "proof", f"made again by: {command(o)}"
    elif o.unproven:
        yield "no proof", o.unproven
    yield "made by", f"certpgo {o.version}"
