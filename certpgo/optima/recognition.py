"""Recognising public graphs, and what is proven of their optima."""

from __future__ import annotations

from dataclasses import dataclass

from certpgo.certify.tolerances import difference_up
from certpgo.certify.wording import part
from certpgo.errors import require
from certpgo.graph import Graph, Instance
from certpgo.graph.dataset import graph_of
from certpgo.graph.phrases import bound_shown, cost_shown, gap_shown
from certpgo.objective.choose_cost import own_cost
from certpgo.objective.costs import CHORDAL, COSTS
from certpgo.optima.fingerprint import fingerprint
from certpgo.optima.register import Optimum, Register, Sizes, shipped


@dataclass(frozen=True)
class Recognised:
    """A graph that the register knows, under a cost.

    Attributes
    ----------
    optimum : what is proven of it
    is_exact : whether its numbers are the register's to the last bit. If not, they agree to nine
        digits, as those of the same file do on other computers, and so do the optima about
    """

    optimum: Optimum
    is_exact: bool

    def __str__(self) -> str:
        o = self.optimum
        of = "the cost of " + o.cost if o.cost != CHORDAL else "F"
        here = f"this is the public {o.name}: the optimum of {of} is"
        if not self.is_exact:
            here = f"this is the public {o.name} to nine digits: the optimum of {of} there is"
        return f"{here} proven to be between {bound_shown(o.lower)} and {cost_shown(o.upper)}"

    def above(self, cost: float) -> float:
        """How far a cost is above the optimum, at most."""
        return max(difference_up(cost, self.optimum.lower), 0.0)

    def compared(self, cost: float) -> str:
        """How far the cost of an estimate is above the optimum, in words."""
        gap = self.above(cost)
        share = f" ({part(gap / cost)} of its cost)" if cost > 0.0 else ""
        return f"this estimate is at most {gap_shown(gap)} above it{share}"


def known_optimum(
    graph: Graph | Instance, cost: str | None = None, register: Register | None = None
) -> Recognised | None:
    """What is proven of the optimum of a public graph, without any search; None for others.

    Parameters
    ----------
    graph : the measurements, or the instance that was read
    cost : by default that which `certpgo.solve` takes
    register : by default the one that the package carries

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> known_optimum(winding_cycle(5, 0.1, 0)[0]) is None
    True
    """
    require(graph, Instance | Graph, "a graph or an instance")
    if cost is None:
        cost = own_cost(graph)
    measured, sizes = graph_of(graph), sizes_of(graph)
    known = shipped(sizes) if register is None else register
    if (measured.kind, sizes) not in known.sizes:
        return None
    found = fingerprint(graph, cost)
    entry = None if found is None else known.get(found.digest, cost)
    return None if entry is None or found is None else Recognised(entry, found.exact == entry.exact)


def recognise(graph: Graph | Instance, register: Register | None = None) -> tuple[Recognised, ...]:
    """What is proven of a graph's optimum under each cost; empty for a graph that is not known.

    Parameters
    ----------
    graph, register : as of `known_optimum`

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> recognise(winding_cycle(5, 0.1, 0)[0])
    ()
    """
    found = (known_optimum(graph, cost, register) for cost in COSTS)
    return tuple(one for one in found if one is not None)


def sizes_of(graph: Graph | Instance) -> Sizes:
    """How large a graph is.

    Examples
    --------
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> sizes_of(winding_cycle(5, 0.1, 0)[0]).poses
    5
    """
    measured = graph_of(graph)
    ranges = graph_of(graph).ranges
    points, priors = int(measured.is_point.sum()), int(measured.from_world.sum())
    return Sizes(
        measured.d,
        measured.num_nodes - points - bool(priors),
        points,
        measured.num_edges,
        0 if ranges is None else ranges.num_edges,
        priors,
    )
