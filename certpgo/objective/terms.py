"""The terms of a graph: relative poses, and all else that is measured."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.graph.observations import Observations
from certpgo.graph.phrases import listed
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.families.positions import Positions
from certpgo.objective.families.rotations_alone import RotationsAlone
from certpgo.objective.minorants import Minorants
from certpgo.objective.signed_weights import with_rows_of
from certpgo.objective.term import Term, term_of


class Placed(NamedTuple):
    """A term of a sum.

    Attributes
    ----------
    rows : (k,) its measurements among all, ascending
    """

    rows: IntArray
    term: Term


def edges_under(graph: Graph, between: type[EdgeCost]) -> EdgeCost:
    """The cost of a program of a graph's edges, whatever they measure."""
    return between(graph.with_blocks() if graph.blocks else graph)


def terms_of(of_edges: EdgeCost, blocks: Sequence[Observations]) -> tuple[Placed, ...]:
    """The terms of edges and blocks, each with the rows that are its measurements.

    Rows are the edges, then those of the blocks.

    Parameters
    ----------
    of_edges : see `edges_under`; edges with kappa = 0 are of positions, and the rotational part of
        their information is zero; those with tau = 0 are of rotations, and the rest is zero

    Raises
    ------
    InputError
        No term takes a block.
    """
    return (*_of_edges(of_edges), *_of_blocks(of_edges.graph.num_edges, blocks))


def _of_edges(of_edges: EdgeCost) -> Iterator[Placed]:
    graph, between = of_edges.graph, type(of_edges)
    turned, moved = graph.measures_rotation, graph.measures_translation
    if between.takes_partial or (turned & moved).all():
        yield Placed(np.arange(graph.num_edges), of_edges)
        return
    kinds: list[tuple[BoolArray, Callable[[Graph], Term]]] = [
        (turned & moved, between),
        (~moved, lambda alone: RotationsAlone(between(alone))),
        (~turned, Positions),
    ]
    for chosen, of in kinds:
        if chosen.any():
            yield Placed(np.flatnonzero(chosen), of(graph.with_edges(chosen)))


def _of_blocks(m: int, blocks: Sequence[Observations]) -> Iterator[Placed]:
    for block in blocks:
        yield Placed(np.arange(m, m + block.num_edges), term_of(block))
        m += block.num_edges


def title_of(of_edges: EdgeCost, blocks: Sequence[Observations]) -> str:
    """What the sum of terms is, in the words of the program's users."""
    partial = of_edges.graph.is_partial and not of_edges.takes_partial
    others = ["positions"] if partial else []
    others += [term_of(block).plural for block in blocks]
    title = of_edges.title
    return f"{title}{of_edges.conjunction} {listed(others)}" if others else title


def scale_of(terms: Sequence[Placed]) -> Scale:
    """What W of the verdicts counts of all."""
    return reduce(add, (term.scale for _, term in terms))


def with_rows(graph: Graph) -> Graph:
    """The graph with an edge for each row: those of blocks measure zero, by their weights."""
    others = [term_of(block) for block in graph.blocks]
    return with_rows_of(graph, others) if others else graph


def enclosures_of(terms: Sequence[Placed], estimate: Estimate) -> tuple[FloatArray, FloatArray]:
    """(m,) lower and upper bounds on the costs, with translations taken as stored."""
    found = [(rows, term.edge_enclosures(estimate)) for rows, term in terms]
    low, high = (placed([(rows, of[k]) for rows, of in found]) for k in (0, 1))
    return low, high


def enclosure_of(terms: Sequence[Placed], estimate: Estimate) -> tuple[float, float]:
    """Lower and upper bounds on the sum of the costs."""
    try:
        low, high = map(math.fsum, enclosures_of(terms, estimate))
    except OverflowError:
        return -math.inf, math.inf
    return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)


def minorants_of(terms: Sequence[Placed], v: FloatArray, Q: FloatArray) -> Minorants:
    """Those of all rows that touch at v (m, d) and Q (m, d, d)."""
    if len(terms) == 1:
        return terms[0].term.whole_minorants(v, Q)
    found = [(rows, term.whole_minorants(v[rows], Q[rows])) for rows, term in terms]
    names = [one.name for one in fields(Minorants) if one.name != "touching"]
    columns = {name: placed([(r, getattr(m, name)) for r, m in found]) for name in names}
    known = [(rows, m.touching) for rows, m in found if m.touching is not None]
    return Minorants(**columns, touching=placed(known, len(v)) if known else None)


def gathered(terms: Sequence[Placed], of: Callable[[Term], Any]) -> Any:
    """(m, ...) what each term says about its rows, in the order of all rows."""
    return placed([(rows, of(term)) for rows, term in terms])


def placed(parts: Sequence[tuple[IntArray, Any]], m: int | None = None) -> Any:
    """(m, ...) values at these rows, which are all of them unless m is given; zeros elsewhere."""
    first = parts[0][1]
    count = sum(len(rows) for rows, _ in parts) if m is None else m
    if len(parts) == 1 and count == len(first):
        return first
    out = np.zeros((count, *first.shape[1:]), dtype=first.dtype)
    for rows, values in parts:
        out[rows] = values
    return out
