"""Maps of several sessions or robots, merged by measurements between them.

No relative pose of the maps has to be known: F of all measurements together is solved and
certified. Terms of F are never negative, so that F* of the merged graph is at least the sum of
those of the maps; what it is more is what the measurements between them cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from certpgo.costs.fit import squares
from certpgo.errors import InputError
from certpgo.graph import Graph, Instance, PoseGraph
from certpgo.graph.information import Information
from certpgo.graph.joining import joined
from certpgo.graph.speaking import Speaking
from certpgo.graph.wording import counted
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.problem import problem_of
from certpgo.optimize.monitor import silent
from certpgo.solvers.certified.disagreement import outlying, select
from certpgo.solvers.certified.pipeline import CertifiedSolution, search_and_certify
from certpgo.solvers.certified.settings import SolveSettings


@dataclass(frozen=True, eq=False, repr=False)
class Merged(Speaking):
    """Maps in one frame, with the certificate of all measurements together.

    Attributes
    ----------
    instance : the merged graph: measurements of the maps in order, then those between them
    answer : its best estimate, with the certificate
    parts : the certified answer of each map alone
    between : (k,) indices in the merged graph of the measurements between the maps
    terms : (k,) their terms of F at the optimum
    tails : (k,) probabilities that a correct measurement is as far off, or further
    disagreeing : indices in the merged graph of those between maps that disagree with the rest

    Examples
    --------
    Two halves of a square that is exactly measured: what lies between them costs nothing.

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> graph = winding_cycle(4, 0.0, 0)[0].graph
    >>> halves = [graph.subgraph([0, 1]), graph.subgraph([2, 3])]
    >>> joints = certpgo.Instance("joints", graph.with_edges([1, 3]).subgraph([1, 2, 3, 0]),
    ...                           np.array([1, 10, 11, 0]))
    >>> merged = certpgo.merge(halves, joints, offset=10)
    >>> bool(abs(merged.raised) < 1e-9), merged.between.tolist(), merged.disagreeing.tolist()
    (True, [2, 3], [])
    """

    instance: Instance
    answer: CertifiedSolution
    parts: tuple[CertifiedSolution, ...]
    between: IntArray
    terms: FloatArray
    tails: FloatArray
    disagreeing: IntArray

    @property
    def raised(self) -> float:
        """By how much F* exceeds the sum of the maps' own, as found: what merging costs."""
        return self.answer.cost - sum(part.cost for part in self.parts)

    @property
    def _headline(self) -> str:
        return f"{counted(len(self.parts), 'map{s}')} merged: {self.answer._headline}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        for k, part in enumerate(self.parts):
            size = part.graph.size_in_words
            yield f"map {k}", f"{part.certificate.in_brief}; {size}"
        yield "merged", f"{self.answer.certificate.in_brief}, {self.raised:.4g} above the maps' sum"
        own = float(self.terms.sum())
        yield (
            "between",
            f"{counted(len(self.between), 'measurement{s}')}, whose terms are {own:.4g}",
        )
        yield "cost", "F, the chordal cost"
        if len(self.disagreeing):
            yield "disagree", ", ".join(self.named(edge) for edge in self.disagreeing[:5].tolist())

    def named(self, edge: int) -> str:
        """A measurement between maps by the ids of its nodes, with its term."""
        i, j = self.instance.ids[self.instance.graph.edges[edge]].tolist()
        return f"{i}-{j} (term {self.terms[edge - self.between[0]]:.3g})"

    def _picture(self) -> str:
        return self.answer._picture()


def merge(
    maps: Sequence[Instance | Graph],
    between: Instance,
    settings: SolveSettings | None = None,
    *,
    offset: int | None = None,
    robust: bool = False,
    **options: Any,
) -> Merged:
    """Merge maps whose relative poses are unknown, by measurements between them.

    Parameters
    ----------
    maps : at least two. A graph's nodes have their numbers as ids
    between : measurements whose nodes have the ids that the maps give them
    offset : where ids occur in several maps: the k-th map's ids are raised by k times this, in
        ``between`` and in the result
    robust : whether measurements between maps that disagree with the rest are left out; those of
        the maps are trusted
    settings, options : as in `certpgo.solve`

    Raises
    ------
    InputError
        Fewer than two maps, ids that occur in several of them, a measurement between unknown nodes
        or within one map.
    GraphError
        The maps are not connected, or of different kinds.

    Examples
    --------
    Two halves of a hexagon, each with its own numbers:

    >>> import certpgo
    >>> from certpgo.datasets.synthetic import winding_cycle
    >>> graph = winding_cycle(6, 0.3, 0)[0].graph
    >>> halves = [graph.subgraph([0, 1, 2]), graph.subgraph([3, 4, 5])]
    >>> import numpy as np
    >>> joints = certpgo.Instance("joints", graph.with_edges([2, 5]).subgraph([2, 3, 5, 0]),
    ...                           np.array([2, 10, 12, 0]))
    >>> merged = certpgo.merge(halves, joints, offset=10)
    >>> merged.answer.verdict.value, f"{merged.answer.cost:.6f}", merged.instance.ids.tolist()
    ('CERTIFIED', '0.029994', [0, 1, 2, 10, 11, 12])
    """
    chosen = (settings or SolveSettings()).changed(options)
    graphs, ids = _numbered(maps, offset)
    whole, first = _joined(graphs, ids, between)
    whole = replace(whole, information=_information([*maps, between]))
    parts = tuple(search_and_certify(problem_of(graph), chosen, None, silent) for graph in graphs)
    across = np.arange(first, whole.graph.num_edges)
    problem = problem_of(whole.graph)
    answer = search_and_certify(problem, chosen, None, silent)
    costs = problem.edge_costs(answer.estimate)
    disagreeing = across[outlying(problem, costs, 1.0)[across]]
    if len(disagreeing):
        # Least squares spreads the error of a wrong measurement over right ones.
        selection = select(problem, trusted=np.arange(first))
        disagreeing = across[selection.rejected[across]]
        if robust and len(disagreeing):
            kept = problem.reweighted(selection.weights)
            answer = search_and_certify(kept, chosen, None, silent)
            costs = problem.edge_costs(answer.estimate)
    chi2, numbers = (of.sum(axis=1)[across] for of in squares(problem, answer.estimate))
    tails = np.asarray(special.gammaincc(0.5 * numbers, 0.5 * chi2))
    return Merged(whole, answer, parts, across, costs[across], tails, disagreeing)


def _numbered(
    maps: Sequence[Instance | Graph], offset: int | None
) -> tuple[list[Graph], list[IntArray]]:
    """The graphs of the maps, and different ids for all nodes."""
    if len(maps) < 2:
        raise InputError(f"merging takes at least two maps, not {len(maps)}")
    graphs, ids = [], []
    for k, one in enumerate(maps):
        if isinstance(one, Instance) and (one.ranges is not None or one.world is not None):
            raise InputError(f"{one.name}: maps with priors or distances cannot be merged")
        graph = one.graph if isinstance(one, Instance) else one
        own = one.ids if isinstance(one, Instance) else np.arange(graph.num_nodes)
        if offset is not None and not (own.min() >= 0 and own.max() < offset):
            raise InputError(f"map {k} has ids outside 0 ... {offset - 1}: a larger offset is due")
        graphs.append(graph)
        ids.append(own + k * (offset or 0))
    known, count = np.unique(np.concatenate(ids), return_counts=True)
    if (count > 1).any():
        shared = known[count > 1][0]
        raise InputError(f"node {shared} is in several maps: an offset tells them apart")
    return graphs, ids


def _information(parts: Sequence[Instance | Graph]) -> Information | None:
    """The information matrices of all measurements; None where some have none."""
    stated = [part.information if isinstance(part, Instance) else None for part in parts]
    known = [one for one in stated if one is not None]
    if len(known) < len(parts) or len({one.residual for one in known}) > 1:
        return None
    starts = np.cumsum([0, *(len(one.distinct) for one in known)])
    index = [one.index + start for one, start in zip(known, starts, strict=False)]
    matrices = np.concatenate([one.distinct for one in known])
    return Information(matrices, np.concatenate(index), known[0].residual)


def _joined(
    graphs: Sequence[Graph], ids: Sequence[IntArray], between: Instance
) -> tuple[Instance, int]:
    """All measurements, and the index of the first one between maps."""
    every = np.concatenate(ids)
    order = np.argsort(every)
    owner = np.repeat(np.arange(len(ids)), [len(own) for own in ids])
    unknown = between.ids[~np.isin(between.ids, every)]
    if len(unknown):
        raise InputError(f"{between.name}: node {unknown[0]} is in none of the maps")
    place = order[np.searchsorted(every[order], between.ids)]
    across = place[between.graph.edges]
    inside = np.flatnonzero(owner[across[:, 0]] == owner[across[:, 1]])
    if len(inside):
        i, j = between.ids[between.graph.edges[inside[0]]]
        raise InputError(f"{between.name}: {i}-{j} is within one map, not between two")
    starts = np.cumsum([0, *(graph.num_nodes for graph in graphs)])
    edges = [graph.edges + start for graph, start in zip(graphs, starts, strict=False)]
    marks = [
        graph.points
        if isinstance(graph, PoseGraph) and graph.points is not None
        else np.zeros(graph.num_nodes, dtype=bool)
        for graph in graphs
    ]
    points = np.concatenate(marks) if any(mark.any() for mark in marks) else None
    whole = joined([*graphs, between.graph], len(every), points, [*edges, across])
    name = f"{len(graphs)} maps"
    return Instance(name, whole, every), sum(graph.num_edges for graph in graphs)
