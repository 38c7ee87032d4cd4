"""Maps of several sessions or robots, merged by measurements between them.

No relative pose of the maps has to be known: all measurements together are solved and certified.
Terms of the cost are never negative, so that the optimum of the merged graph is at least the sum of
those of the maps; what it is more is what the measurements between them cost.

Whether these agree with the rest is judged by the law of the noise that the files state: under the
cost of their program, where all are of one and have its information, at a fit under that cost.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from certpgo.certify.wording import named_cost
from certpgo.errors import GraphError, InputError, require
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.capabilities import lacking, require_capable
from certpgo.graph.concatenate import joined
from certpgo.graph.display import Speaking
from certpgo.graph.held import refuse_held
from certpgo.graph.labels import WORLD, Label, Landmark, called, in_order, shown
from certpgo.graph.origins import in_one_world
from certpgo.graph.phrases import counted, few
from certpgo.io.accept_paths import AnyPath, as_instance, measured
from certpgo.io.frames import frame_node
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, objective_of
from certpgo.optimize.descent import descend
from certpgo.optimize.monitor import Monitor
from certpgo.solve.fit import Fit, squares
from certpgo.solve.many import results_of
from certpgo.solve.outliers import outlying, select
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.selection import Posed
from certpgo.solve.settings import SolveSettings, settings_from

#: The reading option that says what rotational information is of.
READ_AS = "rotation_information"


@dataclass(frozen=True, eq=False, repr=False)
class Merged(Speaking):
    """Maps in one frame, with the certificate of all measurements together.

    Attributes
    ----------
    instance : the merged graph: measurements of the maps in order, then those between them, and
        distances likewise. Its one fixed node or initial value, if any, is where the first map with
        initial values has a pose
    answer : its best estimate, with the certificate
    parts : the certified answer of each map alone
    between : (k,) rows of the measurements between the maps in `Instance.measurements`
    terms : (k,) their terms of F at the optimum
    tails : (k,) probabilities that a correct measurement is as far off, or further, by the noise
        that the files state
    disagreeing : rows of those between maps that disagree with the rest
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
        return replace(self.answer, instance=self.kept).fit

    @cached_property
    def kept(self) -> Instance:
        """The measurements that the answer is about."""
        if not self.left_out:
            return self.instance
        rows = np.arange(self.instance.graph.num_edges)
        return self.instance.with_edges(~np.isin(rows, self.disagreeing))

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
        yield "cost", named_cost(self.answer.certificate.objective)
        if self.fit is not None:
            yield "chi^2", str(self.fit)
        if len(self.disagreeing):
            named = few([self.named(edge) for edge in self.disagreeing.tolist()])
            yield "left out" if self.left_out else "disagree", named

    def named(self, edge: int) -> str:
        """A measurement between maps by the labels of its nodes, with its term."""
        i, j = (self.instance.labels[k] for k in self.instance.measurements.edges[edge].tolist())
        return f"{shown(i)}-{shown(j)} (term {self.terms[np.searchsorted(self.between, edge)]:.3g})"

    def _picture(self) -> str:
        return self.answer._picture()


def merge(
    maps: Sequence[Instance | Graph | AnyPath],
    between: Instance | AnyPath,
    settings: SolveSettings | None = None,
    *,
    cost: str | None = None,
    offset: int | None = None,
    robust: bool = False,
    **options: Any,
) -> Merged:
    """Merge maps whose relative poses are unknown, by measurements between them.

    Parameters
    ----------
    maps : at least two, or the paths of their files. A graph's nodes have their numbers as ids; the
        world of maps with priors is one and the same
    between : measurements whose nodes have the `certpgo.Instance.labels` that the maps give them:
        ids, for example
    offset : where ids occur in several maps: the k-th map's ids are raised by k times this, in
        ``between`` and in the result, and so are numbers of landmarks
    cost : as in `certpgo.solve`, of the maps and of all together
    robust : whether measurements between maps that disagree with the rest are left out; those of
        the maps are trusted
    settings, options : as in `certpgo.solve`

    Raises
    ------
    InputError
        Fewer than two maps, ids that occur in several of them, a measurement between unknown nodes
        or within one map, or positions from origins that are too far apart; or held poses; or
        ``robust`` for maps with distances.
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
    chosen = settings_from(settings, options)
    require(maps, list | tuple, "merge takes a list of maps, and what joins them: maps")
    instances = [_as_instance(one) for one in maps]
    joints: Any = measured(between)
    require(joints, Instance, "an instance of the measurements between maps")
    for one in (*instances, joints):
        refuse_held(one)
    names = _labelled(instances, offset)
    whole, across = _joined(instances, names, joints)
    problem = objective_of(whole, cost)

    def alone(one: Instance, ends: Monitor) -> CertifiedSolution:
        return search(objective_of(one, problem.cost_name), chosen, monitor=ends)

    parts = tuple(results_of(alone, instances))
    answer = search(problem, chosen)
    # Residuals are judged by the file's own noise, whatever is minimised.
    if robust:
        require_capable(whole.graph, "robust merge")
    judged = objective_of(whole)
    fit = _fit(judged, answer.estimate)
    disagreeing, left_out = across[:0], False
    if not lacking(whole.graph, "robust merge"):
        disagreeing = across[outlying(judged, judged.edge_costs(fit), 1.0)[across]]
    if len(disagreeing):
        # Least squares spreads the error of a wrong measurement over right ones.
        own = np.setdiff1d(np.arange(judged.graph.num_edges), across)
        selection = select(judged, trusted=own)
        disagreeing = across[selection.rejected[across]]
        if left_out := robust and len(disagreeing) > 0:
            answer = search(problem.reweighted(selection.weights), chosen)
            fit = _fit(judged.reweighted(selection.weights), answer.estimate)
    tails = _tails(judged, fit)
    whole = _in_first_frame(whole, instances, names, answer.estimate)
    terms = problem.edge_costs(answer.estimate)
    return Merged(whole, answer, parts, across, terms[across], tails[across], disagreeing, left_out)


def _fit(problem: Posed, start: Estimate) -> Estimate:
    """The optimum of F, or one near it under the cost of another program."""
    return start if problem.is_chordal else descend(problem, start).estimate


def _in_first_frame(
    whole: Instance, maps: Sequence[Instance], names: Sequence[Sequence[Label]], estimate: Estimate
) -> Instance:
    """The merged graph with an estimate as its initial values, in the frame of the first map.

    That is the first one with initial values, or the world where there are priors. What other maps
    fix chose their frames, and is free.
    """
    if whole.world is not None:
        return replace(whole, initial=estimate.anchored(whole.world))
    for one, labels in zip(maps, names, strict=True):
        if (values := one.initial) is None:
            continue
        first = frame_node(one)
        node = whole.labels.index(labels[first])
        t = None if values.translations is None else values.translations[first]
        placed = estimate.anchored(node).moved(values.rotations[first], t)
        return replace(whole, initial=placed, fixed=(node,) if first in one.fixed else ())
    return replace(whole, initial=estimate.anchored(frame_node(whole)))


def _tails(problem: Posed, estimate: Estimate) -> FloatArray:
    """Probabilities that correct measurements are as far off, or further; nan without a law."""
    if lacking(problem.measured, "robust merge"):
        return np.full(problem.graph.num_edges, np.nan)
    if problem.cost_name != CHORDAL:
        chi2, numbers = problem.edge_costs(estimate), sum(problem.numbers)
    else:
        chi2, numbers = (of.sum(axis=1) for of in squares(problem, estimate))
    return np.asarray(special.gammaincc(0.5 * numbers, 0.5 * chi2))


def _as_instance(one: Instance | Graph | AnyPath) -> Instance:
    instance = as_instance(one, "merge", "map")
    require_capable(instance.graph, "merge")
    return instance


def _labelled(maps: Sequence[Instance], offset: int | None) -> list[list[Label]]:
    """Different labels for all nodes of the maps but the world."""
    if len(maps) < 2:
        raise InputError(f"merging takes at least two maps, not {len(maps)}")
    found: list[list[Label]] = []
    known: set[Label] = set()
    for k, one in enumerate(maps):
        labels = [_raised(label, k, offset) for label in one.labels]
        shared = [label for label in labels if label in known and label is not WORLD]
        if shared:
            raise InputError(f"{called(shared[0])} is in several maps: an offset tells them apart")
        known.update(labels)
        found.append(labels)
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


def _joined(
    maps: Sequence[Instance], names: Sequence[Sequence[Label]], between: Instance
) -> tuple[Instance, IntArray]:
    """All measurements, and the rows of those between maps."""
    owner = {label: k for k, own in enumerate(names) for label in own}
    parts, labelled = [*maps, between], [*names, _across(owner, between)]
    worlds = [own.index(WORLD) if WORLD in own else None for own in labelled]
    origins = [*(one.origin for one in maps), None]
    posed = zip((part.graph for part in parts), worlds, origins, strict=True)
    origin, graphs = in_one_world(list(posed))
    # Only one place of the world is assumed.
    parts = [
        part if graph.num_edges == part.graph.num_edges else part.with_edges(part.is_measured)
        for part, graph in zip(parts, graphs, strict=True)
    ]
    labels = list(owner)
    labels = [labels[k] for k in in_order(labels).tolist()]
    place = {label: k for k, label in enumerate(labels)}
    nodes = [np.array([place[label] for label in own]) for own in labelled]
    whole = joined(graphs, len(labels), _points(graphs, nodes, labels), nodes)
    merged = Instance.labelled(f"{len(maps)} maps", whole, labels, origin=origin)
    read = {part.options.get(READ_AS, "tangent") for part in parts if len(part.options)}
    options = {READ_AS: read.pop()} if len(read) == 1 else {}
    merged = replace(merged, options=options)
    # Rows are of all graphs in order, then of their blocks by kind.
    own_rows = [part.graph.num_edges for part in parts]
    kinds = dict.fromkeys(type(block) for part in parts for block in part.graph.blocks)
    for kind in kinds:
        own_rows += [
            sum(block.num_edges for block in part.graph.blocks if type(block) is kind)
            for part in parts
        ]
    source = np.repeat(np.tile(np.arange(len(parts)), 1 + len(kinds)), own_rows)
    return merged, np.flatnonzero(source == len(maps))


def _points(
    graphs: Sequence[Graph], nodes: Sequence[IntArray], labels: Sequence[Label]
) -> BoolArray | None:
    """Which nodes are points, as all graphs say it."""
    points, poses = np.zeros((2, len(labels)), dtype=bool)
    for graph, own in zip(graphs, nodes, strict=True):
        points[own[graph.is_point]] = True
        poses[own[~graph.is_point]] = True
    if (points & poses).any():
        raise GraphError(f"{called(labels[int(np.argmax(points & poses))])} is a pose and a point")
    return points if points.any() else None


def _across(owner: Mapping[Label, int], between: Instance) -> tuple[Label, ...]:
    """The labels of the nodes of measurements between maps, if that is what they are."""
    labels = between.labels
    if between.world is not None:
        raise InputError(f"{between.name}: priors are of one map, not between two: add them to it")
    for label in labels:
        if label not in owner:
            raise InputError(f"{between.name}: {called(label)} is in none of the maps")
    for i, j in between.measurements.edges.tolist():
        if owner[labels[i]] == owner[labels[j]]:
            said = f"{labels[i]}-{labels[j]}"
            raise InputError(f"{between.name}: {said} is within one map, not between two")
    return labels
