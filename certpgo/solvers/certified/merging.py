"""Maps of several sessions or robots, merged by measurements between them.

No relative pose of the maps has to be known: F of all measurements together is solved and
certified. Terms of F are never negative, so that F* of the merged graph is at least the sum of
those of the maps; what it is more is what the measurements between them cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from certpgo.costs.fit import Fit, squares
from certpgo.errors import GraphError, InputError
from certpgo.graph import Graph, Instance, PoseGraph
from certpgo.graph.information import Information
from certpgo.graph.joining import joined
from certpgo.graph.labels import WORLD, Label, Landmark, called, in_order
from certpgo.graph.origins import in_one_world
from certpgo.graph.speaking import Speaking
from certpgo.graph.wording import counted, few
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.problem import problem_of
from certpgo.solvers.certified.disagreement import outlying, select
from certpgo.solvers.certified.result import CertifiedSolution
from certpgo.solvers.certified.search import search
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
    left_out : whether these were left out, so that the answer is about the others

    Examples
    --------
    Two halves of a square that is exactly measured: what lies between them costs nothing.

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
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
    left_out: bool = False

    @property
    def raised(self) -> float:
        """By how much F* exceeds the sum of the maps' own, as found: what merging costs."""
        return self.answer.cost - sum(part.cost for part in self.parts)

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of the measurements that the answer is about, where all state their noise."""
        return replace(self.answer, instance=self.instance).fit

    @property
    def _headline(self) -> str:
        return f"{counted(len(self.parts), 'map{s}')} merged: {self.answer._headline}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        for k, part in enumerate(self.parts):
            size = part.graph.size_in_words
            yield f"map {k}", f"{part.certificate.in_brief}; {size}"
        yield "merged", f"{self.answer.certificate.in_brief}, {self.raised:.4g} above the maps' sum"
        measured = counted(len(self.between), "measurement{s}")
        terms = self.terms
        if self.left_out:
            terms = terms[~np.isin(self.between, self.disagreeing)]
            measured = f"{len(terms)} of {measured} kept"
        yield "between", f"{measured}, whose terms add up to {float(terms.sum()):.4g}"
        if self.fit is not None:
            yield "chi^2", str(self.fit)
        if len(self.disagreeing):
            named = few([self.named(edge) for edge in self.disagreeing.tolist()])
            yield "left out" if self.left_out else "disagree", named

    def named(self, edge: int) -> str:
        """A measurement between maps by the labels of its nodes, with its term."""
        i, j = (self.instance.labels[k] for k in self.instance.graph.edges[edge].tolist())
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
    maps : at least two. A graph's nodes have their numbers as ids; the world of maps with priors is
        one and the same
    between : measurements whose nodes have the `certpgo.Instance.labels` that the maps give them:
        ids, for example
    offset : where ids occur in several maps: the k-th map's ids are raised by k times this, in
        ``between`` and in the result, and so are numbers of landmarks
    robust : whether measurements between maps that disagree with the rest are left out; those of
        the maps are trusted
    settings, options : as in `certpgo.solve`

    Raises
    ------
    InputError
        Fewer than two maps, ids that occur in several of them, a measurement between unknown nodes
        or within one map, distances, or positions from origins that are too far apart.
    GraphError
        The maps are not connected, or of different kinds, or a node is a pose in one and a point
        in another.

    Examples
    --------
    Two halves of a hexagon, each with its own numbers:

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
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
    labelled = _labelled(maps, offset)
    origins = [one.origin if isinstance(one, Instance) else None for one in maps]
    whole, first = _joined(labelled, origins, between)
    whole = replace(whole, information=_information([*maps, between]))
    parts = tuple(search(problem_of(one), chosen) for one, _ in labelled)
    across = np.arange(first, whole.graph.num_edges)
    problem = problem_of(whole.graph)
    answer = search(problem, chosen)
    costs = problem.edge_costs(answer.estimate)
    disagreeing = across[outlying(problem, costs, 1.0)[across]]
    left_out = False
    if len(disagreeing):
        # Least squares spreads the error of a wrong measurement over right ones.
        selection = select(problem, trusted=np.arange(first))
        disagreeing = across[selection.rejected[across]]
        if left_out := robust and len(disagreeing) > 0:
            kept = problem.reweighted(selection.weights)
            answer = search(kept, chosen)
            costs = problem.edge_costs(answer.estimate)
    chi2, numbers = (of.sum(axis=1)[across] for of in squares(problem, answer.estimate))
    tails = np.asarray(special.gammaincc(0.5 * numbers, 0.5 * chi2))
    return Merged(whole, answer, parts, across, costs[across], tails, disagreeing, left_out)


def _labelled(
    maps: Sequence[Instance | Graph], offset: int | None
) -> list[tuple[Graph, list[Label]]]:
    """The graphs of the maps, and different labels for all nodes but the world."""
    if len(maps) < 2:
        raise InputError(f"merging takes at least two maps, not {len(maps)}")
    found: list[tuple[Graph, list[Label]]] = []
    known: set[Label] = set()
    for k, one in enumerate(maps):
        own: Sequence[Label]
        if isinstance(one, Instance):
            _refuse_distances(one)
            graph, own = one.graph, one.labels
        else:
            graph, own = one, range(one.num_nodes)
        labels = [_raised(label, k, offset) for label in own]
        shared = [label for label in labels if label in known and label is not WORLD]
        if shared:
            raise InputError(f"{called(shared[0])} is in several maps: an offset tells them apart")
        known.update(labels)
        found.append((graph, labels))
    return found


def _raised(label: Label, k: int, offset: int | None) -> Label:
    """The label of a node of the k-th map among all maps."""
    number = label.number if isinstance(label, Landmark) else label
    if offset is None or label is WORLD:
        return label
    if not isinstance(number, int):
        raise InputError(f"{called(label)} of map {k} has a name: an offset is for ids")
    if not 0 <= number < offset:
        raise InputError(f"map {k} has ids outside 0 ... {offset - 1}: a larger offset is due")
    number += k * offset
    return Landmark(number) if isinstance(label, Landmark) else number


def _refuse_distances(one: Instance) -> None:
    if one.ranges is not None:
        raise InputError(f"{one.name}: measured distances cannot be merged")


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
    maps: Sequence[tuple[Graph, list[Label]]],
    origins: Sequence[FloatArray | None],
    between: Instance,
) -> tuple[Instance, int]:
    """All measurements, and the index of the first one between maps."""
    owner = {label: k for k, (_, own) in enumerate(maps) for label in own}
    labelled = [*(own for _, own in maps), _across(owner, between)]
    worlds = [own.index(WORLD) if WORLD in own else None for own in labelled]
    graphs = [*(graph for graph, _ in maps), between.graph]
    origin, graphs = in_one_world(list(zip(graphs, worlds, [*origins, None], strict=True)))
    labels = list(owner)
    labels = [labels[k] for k in in_order(labels).tolist()]
    place = {label: k for k, label in enumerate(labels)}
    nodes = [np.array([place[label] for label in own]) for own in labelled]
    edges = [own[graph.edges] for own, graph in zip(nodes, graphs, strict=True)]
    whole = joined(graphs, len(labels), _points(graphs, nodes, labels), edges)
    name = f"{len(maps)} maps"
    first = sum(graph.num_edges for graph, _ in maps)
    return Instance.labelled(name, whole, labels, origin=origin), first


def _points(
    graphs: Sequence[Graph], nodes: Sequence[IntArray], labels: Sequence[Label]
) -> BoolArray | None:
    """Which nodes are points, as all graphs say it."""
    points, poses = np.zeros((2, len(labels)), dtype=bool)
    for graph, own in zip(graphs, nodes, strict=True):
        flags = np.zeros(graph.num_nodes, dtype=bool)
        if isinstance(graph, PoseGraph) and graph.points is not None:
            flags = graph.points
        points[own[flags]] = True
        poses[own[~flags]] = True
    if (points & poses).any():
        raise GraphError(f"{called(labels[int(np.argmax(points & poses))])} is a pose and a point")
    return points if points.any() else None


def _across(owner: Mapping[Label, int], between: Instance) -> tuple[Label, ...]:
    """The labels of the nodes of measurements between maps, if that is what they are."""
    _refuse_distances(between)
    labels = between.labels
    if between.world is not None:
        raise InputError(f"{between.name}: priors are of one map, not between two: add them to it")
    for label in labels:
        if label not in owner:
            raise InputError(f"{between.name}: {called(label)} is in none of the maps")
    for i, j in between.graph.edges.tolist():
        if owner[labels[i]] == owner[labels[j]]:
            said = f"{labels[i]}-{labels[j]}"
            raise InputError(f"{between.name}: {said} is within one map, not between two")
    return labels
