"""Where a session stands between two certificates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from certpgo.certify import Verdict
from certpgo.certify.wording import EXACT_FIT
from certpgo.graph.display import Speaking
from certpgo.graph.phrases import bound_shown, cost_shown, counted, gap_shown


@dataclass(frozen=True, repr=False)
class Standing(Speaking):
    """What is proven about a session's estimate and its measurements of the moment.

    Attributes
    ----------
    nodes, edges : how many there are
    cost : F of the estimate, rounded up
    lower_bound : no estimate has a smaller F
    gap : ``cost - lower_bound``, rounded up
    tolerance : the gap up to which the estimate counts as optimal, see `Certificate`; the cost
        itself if that is rounding
    verdict : CERTIFIED, BOUNDED or UNDECIDED, see `Verdict`
    objective : the cost that F stands for

    Examples
    --------
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> session = certpgo.Session()
    >>> session.add(winding_cycle(6, 0.3, 0)[0].graph)
    >>> session.standing.edges, session.standing.gap <= session.standing.cost
    (6, True)
    """

    nodes: int
    edges: int
    cost: float
    lower_bound: float
    gap: float
    tolerance: float
    verdict: Verdict
    objective: str

    @classmethod
    def of(
        cls,
        nodes: int,
        edges: int,
        cost: float,
        lower: float,
        gap: float,
        tolerance: float,
        title: str,
        *,
        rigorous: bool,
    ) -> Standing:
        """With the verdict that a gap stands for; a screened one is never CERTIFIED."""
        verdict = Verdict.BOUNDED if lower > 0.0 else Verdict.UNDECIDED
        if rigorous and gap <= tolerance < math.inf:
            verdict = Verdict.CERTIFIED
        return cls(nodes, edges, cost, lower, gap, tolerance, verdict, title)

    @property
    def _headline(self) -> str:
        if not self.nodes:
            return "empty: no measurements yet"
        size = f"{counted(self.nodes, 'node{s}')}, {counted(self.edges, 'measurement{s}')}"
        return f"{self.stated}: {size}, F {cost_shown(self.cost)}"

    @property
    def stated(self) -> str:
        """The verdict as headlines state it: EXACT FIT if the cost is rounding."""
        is_rounding = self.verdict is Verdict.CERTIFIED and self.cost == self.tolerance > 0.0
        return EXACT_FIT if is_rounding else self.verdict.value

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield "cost F, at most", cost_shown(self.cost)
        yield "lower bound", bound_shown(self.lower_bound)
        yield "gap", gap_shown(self.gap)
        yield "tolerance", f"{self.tolerance:.3g}"
        yield "objective", self.objective
