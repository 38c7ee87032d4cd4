"""The reason of a verdict, in words."""

from __future__ import annotations

import math

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.certify.wording import part
from certpgo.graph.wording import bound_shown, cost_shown, gap_shown

#: Gap relative to F that is never called small.
LARGE = 0.01


def reason_of(c: Certificate) -> str:
    """One sentence on what is proven about the estimate, and why it is not more."""
    if not math.isfinite(c.cost_upper):
        return "the cost of this estimate is beyond the range of doubles"
    floor = f"no estimate of this graph costs less than {bound_shown(c.lower_bound)}"
    if c.tier is Tier.SCREEN:
        floor = f"likely, though not proven at this tier: {floor}"
    own = f"this one costs {cost_shown(c.cost_upper)}"
    by = "after local descent" if c.descended else "with its best translations"
    by = by if c.settled or not c.descended else "after part of a local descent"
    improved = f"{own} and, {by}, {cost_shown(c.refined_cost)}"
    lower = c.refined_cost < c.cost_upper - c.tolerance
    if c.verdict is Verdict.CERTIFIED:
        within = f"{floor}; {own}, within {_of_f(c)} of the optimum"
        if c.gap <= c.rtol * c.cost_upper:
            return within
        small = f"{within}, which is negligible relative to the total weight W = {c.scale:.2g}"
        return (
            f"{small}, though not to F: atol=0 compares with F alone"
            if c.gap > LARGE * c.cost_upper
            else small
        )
    if c.better_cost is not None and c.verdict is not Verdict.REFUTED:
        also = f"another estimate costs {cost_shown(c.better_cost)}"
        return f"{floor}; {improved if lower else own}; {also}"
    if c.better_cost is not None:
        descent = "does not lead there" if c.settled else "was given up far from it"
        return (
            f"another estimate costs {cost_shown(c.better_cost)}; "
            f"{improved if lower else own}, and local descent from it {descent}; {floor}"
        )
    if c.verdict is Verdict.UNDECIDED:
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


def _of_f(c: Certificate) -> str:
    """The gap relative to F and in absolute terms."""
    if not c.cost_upper > 0.0:
        return gap_shown(c.gap)
    share = part(c.relative_gap)
    return f"{share}{' of' * share.endswith('%')} F = {gap_shown(c.gap)}"
