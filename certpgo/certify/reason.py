"""The reason of a verdict, in words."""

from __future__ import annotations

import math

from certpgo.certify.certificate import Certificate, Tier, Verdict
from certpgo.graph.wording import rounded_down, rounded_up

#: Gap relative to F that is never called small.
LARGE = 0.01


def reason_of(c: Certificate) -> str:
    """One sentence on what is proven about the estimate, and why it is not more."""
    if not math.isfinite(c.cost_upper):
        return "the cost of this estimate is beyond the range of doubles"
    floor = f"no estimate of this graph costs less than {rounded_down(c.lower_bound, 10)}"
    if c.tier is Tier.SCREEN:
        floor = f"likely, though not proven at this tier: {floor}"
    own = f"this one costs {rounded_up(c.cost_upper, 10)}"
    by = "after local descent" if c.descended else "with its best translations"
    by = by if c.settled or not c.descended else "after part of a local descent"
    improved = f"{own} and, {by}, {rounded_up(c.refined_cost, 10)}"
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
        also = f"another estimate costs {rounded_up(c.better_cost, 10)}"
        return f"{floor}; {improved if lower else own}; {also}"
    if c.better_cost is not None:
        descent = "does not lead there" if c.settled else "was given up far from it"
        return (
            f"another estimate costs {rounded_up(c.better_cost, 10)}; "
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
        return rounded_up(c.gap, 2)
    share = c.gap / c.cost_upper
    said = f"{rounded_up(100.0 * share, 3)} % of" if share > LARGE else rounded_up(share, 2)
    return f"{said} F = {rounded_up(c.gap, 2)}"
