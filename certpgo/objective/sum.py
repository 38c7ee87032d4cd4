"""The cost of a graph as a sum of terms, one for each kind of measurement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.phrases import listed
from certpgo.graph.scale import Scale
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import Ball
from certpgo.objective.edge_cost import EdgeCost
from certpgo.objective.families.distances import Distances
from certpgo.objective.families.positions import Positions
from certpgo.objective.families.rotations_alone import RotationsAlone
from certpgo.objective.minorants import Minorants
from certpgo.objective.signed_weights import with_rows_of
from certpgo.objective.term import Placed, Term, term_of

__all__ = ["Distances", "Sum"]


@dataclass(frozen=True, eq=False)
class Sum(EdgeCost):
    """A program's cost of relative poses, and the terms of all else that a graph measures.

    Its rows are the graph's edges, then those of its blocks.

    Attributes
    ----------
    graph : the measurements; edges with kappa = 0 are of positions, and the rotational part of
        their information is zero; those with tau = 0 are of rotations, and the rest is zero
    between : the program's cost of relative poses
    """

    between: type[EdgeCost]

    def __post_init__(self) -> None:
        _ = self.of_edges  # checks them

    @cached_property
    def of_edges(self) -> EdgeCost:
        """The program's cost of the edges, whatever they measure."""
        return self.between(self.graph.with_blocks())

    @cached_property
    def terms(self) -> tuple[Placed, ...]:
        """The terms, each with the rows that are its measurements."""
        return tuple(self._terms())

    def _terms(self) -> Iterator[Placed]:
        graph, m = self.of_edges.graph, self.graph.num_edges
        turned, moved = graph.measures_rotation, graph.measures_translation
        if self.between.takes_partial:
            turned = moved = turned | moved
        kinds: list[tuple[BoolArray, Callable[[Graph], Term]]] = [
            (turned & moved, self.between),
            (~moved, lambda alone: RotationsAlone(self.between(alone))),
            (~turned, Positions),
        ]
        for chosen, of in kinds:
            if chosen.any():
                yield Placed(np.flatnonzero(chosen), of(graph.with_edges(chosen)))
        for block in self.graph.blocks:
            yield Placed(np.arange(m, m + block.num_edges), term_of(block))
            m += block.num_edges

    @cached_property
    def whole(self) -> Graph:
        """The graph with an edge for each row: those of blocks measure zero, by their weights."""
        others = [term_of(block) for block in self.graph.blocks]
        return with_rows_of(self.of_edges.graph, others) if others else self.graph

    @property
    def is_definite(self) -> BoolArray:
        """(m,) which measurements have a cost that grows with all of their residuals."""
        others = np.ones(self.whole.num_edges - self.graph.num_edges, dtype=bool)
        return np.concatenate([self.graph.is_definite, others])

    @property
    def name(self) -> str:  # type: ignore[override]
        """Name in options and reports."""
        return self.between.name

    @property
    def provable(self) -> bool:  # type: ignore[override]
        """Whether the checker knows it."""
        return self.between.provable and not self.graph.blocks

    @property
    def turned_share(self) -> float:
        """That of the cost of relative poses."""
        return self.of_edges.turned_share

    @property
    def title(self) -> str:
        """What it is, in the words of the program's users."""
        partial = self.graph.is_partial and not self.between.takes_partial
        others = ["positions"] if partial else []
        others += [term_of(block).plural for block in self.graph.blocks]
        title = self.of_edges.title
        return f"{title}{self.between.conjunction} {listed(others)}" if others else title

    @property
    def edges(self) -> IntArray:
        """(m, 2) the nodes of each row."""
        return self.whole.edges

    @property
    def arms(self) -> FloatArray | None:
        """(m, d) arms of the rows; None for zeros."""
        return self.whole.arms

    @property
    def scale(self) -> Scale:
        """What W of the verdicts counts of them."""
        return reduce(add, (term.scale for _, term in self.terms))

    @property
    def numbers(self) -> tuple[IntArray, IntArray]:
        """(m,) how many numbers each row measures of a rotation, and (m,) of anything else."""
        turned = self._gathered(lambda term, rows: term.numbers[0])
        return turned, self._gathered(lambda term, rows: term.numbers[1])

    @property
    def double(self) -> IntArray:
        """(m,) how often the square of a turn counts in the cost."""
        return np.asarray(self._gathered(lambda term, rows: term.double))

    @cached_property
    def weights(self) -> FloatArray:
        """(m, k, k) weights of the residuals, and zeros where a term has fewer than k."""

        def padded(term: Term, rows: IntArray) -> FloatArray:
            more = self._longest - term.weights.shape[1]
            return np.pad(term.weights, ((0, 0), (0, more), (0, more)))

        return np.asarray(self._gathered(padded))

    @cached_property
    def _longest(self) -> int:
        """Number k of the residuals of a row, at most."""
        return max(int(term.weights.shape[1]) for _, term in self.terms)

    def residuals(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m, k) residuals, and zeros where a term has fewer."""

        def padded(term: Term, rows: IntArray) -> FloatArray:
            e = term.residuals(v[rows], Q[rows])
            return np.pad(e, ((0, 0), (0, self._longest - e.shape[1])))

        return np.asarray(self._gathered(padded))

    def linearized(self, v: FloatArray, Q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals and their derivatives, as of each term, and zeros where there are fewer."""
        found = [(rows, term.linearized(v[rows], Q[rows])) for rows, term in self.terms]

        def padded(which: int) -> FloatArray:
            parts = [(rows, of[which]) for rows, of in found]
            out = np.zeros((len(v), self._longest, *parts[0][1].shape[2:]))
            for rows, values in parts:
                out[rows, : values.shape[1]] = values
            return out

        return padded(0), padded(1), padded(2)

    def lengths_of_blocks(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(k,) norms of the residuals of the blocks, metres; 0 where they are no lengths."""
        m = self.graph.num_edges
        found = [
            np.linalg.norm(term.residuals(v[rows], Q[rows]), axis=1) * term.in_metres
            for rows, term in self.terms
            if rows[0] >= m
        ]
        return np.concatenate([np.zeros(0), *found])

    def costs(self, v: FloatArray, Q: FloatArray) -> FloatArray:
        """(m,) costs."""
        return np.asarray(self._gathered(lambda term, rows: term.costs(v[rows], Q[rows])))

    def bend(self, v: FloatArray) -> FloatArray:
        """(m,) the quadratic part of the costs in moves v (m, d)."""
        return np.asarray(self._gathered(lambda term, rows: term.bend(v[rows])))

    def enclosures(self, v: Ball, Q: Ball) -> Ball:
        """(m,) balls that contain the costs of all of these (v, Q)."""
        found = [(rows, term.enclosures(v[rows], Q[rows])) for rows, term in self.terms]
        mid, radius = np.empty((2, len(self.edges)), dtype=found[0][1].mid.dtype)
        for rows, ball in found:
            mid[rows], radius[rows] = ball.mid, ball.radius
        return Ball(mid, radius)

    def minorants(self, v: FloatArray, Q: FloatArray) -> Minorants:
        """Minorants that touch the costs at (v, Q), up to rounding."""
        found = [(rows, term.minorants(v[rows], Q[rows])) for rows, term in self.terms]
        names = [one.name for one in fields(Minorants) if one.name != "touching"]
        columns = {name: _placed([(r, getattr(m, name)) for r, m in found]) for name in names}
        known = [(rows, m.touching) for rows, m in found if m.touching is not None]
        return Minorants(**columns, touching=_placed(known, len(v)) if known else None)

    def _gathered(self, of: Callable[[Term, IntArray], Any]) -> Any:
        """(m, ...) what each term says about its rows, in the order of all rows."""
        return _placed([(rows, of(term, rows)) for rows, term in self.terms])

    def relaxed(self) -> Sum | None:
        """With relative poses of a lower cost, and all else as it is."""
        poses = self.graph.measures_rotation
        if self.between.takes_partial:
            return None
        below = self.between(self.of_edges.graph.with_edges(poses)).relaxed()
        if below is None:
            return None
        information = self.graph.information_matrices.copy()
        information[poses] = below.graph.information_matrices
        return replace(self, graph=self.graph.with_information(information))


def _placed(parts: Sequence[tuple[IntArray, Any]], m: int | None = None) -> Any:
    """(m, ...) values at these rows, which are all of them unless m is given; zeros elsewhere."""
    first = parts[0][1]
    count = sum(len(rows) for rows, _ in parts) if m is None else m
    out = np.zeros((count, *first.shape[1:]), dtype=first.dtype)
    for rows, values in parts:
        out[rows] = values
    return out
