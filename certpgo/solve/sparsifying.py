"""Graphs with fewer loop closures, and what the optimum and its certificate lose.

Loop closures are chosen by algebraic connectivity or by the measured spectrum, see
`certpgo.optimize.connectivity`; both graphs are then solved and certified. The eigenvector of the
former says which loop closure would help most.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy.spatial import KDTree

from certpgo.errors import GraphError, InputError
from certpgo.graph import Estimate, Graph, Instance, RotationGraph
from certpgo.graph.display import Speaking
from certpgo.graph.edges import components_of
from certpgo.graph.graph import require_connected, require_one_unit
from certpgo.graph.kinds import Kind
from certpgo.graph.phrases import counted
from certpgo.graph.trees import minimum_spanning_tree
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, certifiable
from certpgo.objective.problem import RotationProblem
from certpgo.optimize.connectivity import Connectivity, SpectralMargin, choose
from certpgo.solve.fit import Fit
from certpgo.solve.metrics import TrajectoryErrors, trajectory_errors
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.search import search
from certpgo.solve.settings import DEFAULT, SolveSettings

#: What loop closures are chosen by: where they are, or also what they measure.
By = Literal["connectivity", "spectrum"]
#: Pairs whose lambda_2 is computed, of those with the largest gain in first order.
TRIED = 8
#: Relative difference of lambda_2 from which a pair is better than one of larger gain.
BETTER = 1e-9
#: Nodes at either end of the eigenvector whose pairs are considered.
ENDS = 64


@dataclass(frozen=True, eq=False, repr=False)
class Sparsified(Speaking):
    """A graph with some of its loop closures, beside the whole one.

    Attributes
    ----------
    instance : the sparse graph
    kept : (k,) its measurements' indices in the whole graph, ascending
    chosen : (c,) those of the loop closures among them
    loops : loop closures of the whole graph
    full : lambda_2 of the whole graph's Laplacian weighted by kappa, 1/rad^2
    connectivity : that of the sparse graph
    bound : no choice of as many loop closures has a larger one
    whole, answer : certified answers of the whole and the sparse graph
    cost : F of the whole graph at the sparse one's answer
    moved : root mean square distance and angle between the two answers

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import sphere
    >>> graph = sphere(10, np.random.default_rng(0), rotation_noise=0.05).graph
    >>> sparse = certpgo.sparsify(graph, 0.25)
    >>> len(sparse.chosen) == round(0.25 * sparse.loops), sparse.answer.verdict.value
    (True, 'CERTIFIED')
    >>> bool(sparse.connectivity <= sparse.bound <= 1.01 * sparse.full), bool(sparse.loss > 0.0)
    (True, True)
    """

    instance: Instance
    kept: IntArray
    chosen: IntArray
    loops: int
    full: float
    connectivity: float
    bound: float
    whole: CertifiedSolution
    answer: CertifiedSolution
    cost: float
    moved: TrajectoryErrors

    @property
    def loss(self) -> float:
        """By how much F of all measurements rises, relative to their best known cost."""
        least = self.whole.cost
        return (self.cost - least) / least if least > 0.0 else 0.0

    @cached_property
    def fit(self) -> Fit | None:
        """chi^2 of the measurements kept, where their source states the noise."""
        return replace(self.answer, instance=self.instance).fit

    @property
    def _headline(self) -> str:
        kept = f"{len(self.chosen)} of {counted(self.loops, 'loop closure{s}')} kept"
        return f"{kept}; the sparse graph is {self.answer._headline}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        yield (
            "connectivity",
            (
                f"{self.connectivity:.4g} of {self.full:.4g} with all; "
                f"no choice of as many exceeds {self.bound:.4g}"
            ),
        )
        yield "whole", self.whole.certificate.in_brief
        yield "sparse", f"{self.answer.certificate.in_brief} of the measurements kept"
        loss = f"{self.cost:.10g} for all measurements, {100.0 * self.loss:.3g} % more"
        yield "loss", f"chordal cost F = {loss}"
        if self.fit is not None:
            yield "chi^2", str(self.fit)
        metres = "" if self.moved.ate_m is None else f"{self.moved.ate_m:.4g} m and "
        yield "moved", f"{metres}{self.moved.ate_deg:.4g} degrees (root mean square)"

    def _picture(self) -> str:
        return self.instance._picture()


@dataclass(frozen=True, eq=False, repr=False)
class SuggestedLoops(Speaking):
    """Loop closures that would make a graph more connected, the best first.

    Attributes
    ----------
    instance : the graph
    pairs : (k, 2) nodes to connect
    connectivity : (k + 1,) lambda_2 as it is, then with each pair and those before it, 1/rad^2
    kappa : weight that the loop closures are assumed to have, 1/rad^2

    Examples
    --------
    The ends of a path are what to connect first:

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> path = winding_cycle(9, 0.0, 0)[0].graph.with_edges(np.arange(8))
    >>> certpgo.suggest_loops(path, 1).pairs.tolist()
    [[0, 8]]
    """

    instance: Instance
    pairs: IntArray
    connectivity: FloatArray
    kappa: float

    @property
    def _headline(self) -> str:
        before, after = self.connectivity[[0, -1]]
        loops = counted(len(self.pairs), "loop closure{s}")
        return f"{loops} would raise the connectivity from {before:.4g} to {after:.4g}"

    def _facts(self) -> Iterator[tuple[str, str]]:
        for (i, j), value in zip(self.named.tolist(), self.connectivity[1:], strict=True):
            yield f"{i}-{j}", f"{value:.4g}"

    @property
    def named(self) -> IntArray:
        """(k, 2) the pairs by the instance's ids."""
        return np.asarray(self.instance.ids[self.pairs])

    def _picture(self) -> str:
        return self.instance._picture()


def sparsify(
    graph: Instance | Graph,
    keep: float,
    settings: SolveSettings | None = None,
    *,
    by: By = "connectivity",
    **options: Any,
) -> Sparsified:
    """Keep the loop closures that connect a graph best, and solve it with and without the others.

    Steps of odometry, between nodes whose ids are consecutive, are always kept; where they do not
    connect the graph, so is a spanning tree. Sightings, priors and distances are kept too. Among
    the others, the choice approximately maximises lambda_2 of the graph Laplacian weighted by kappa
    (Doherty et al., arXiv 2403.19879). That depends on where loop closures are, not on what they
    measure; ``by="spectrum"`` raises its margin above the smallest eigenvalues of the measured
    rotations (`SpectralMargin`), which wrong ones narrow.

    Parameters
    ----------
    keep : loop closures to keep: an integer is their number, a float a fraction of them
    by : ``"connectivity"`` or ``"spectrum"``
    settings, options : as in `certpgo.solve`

    Raises
    ------
    InputError
        ``keep`` or ``by`` is out of range, or the graph has no loop closures.
    GraphError
        It is not connected, or only measurements of other kinds than relative rotations connect it.
    NumericalError
        An eigenvector was not found.

    Examples
    --------
    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import sphere
    >>> graph = sphere(10, np.random.default_rng(0), rotation_noise=0.05).graph
    >>> sparse = certpgo.sparsify(graph, 30)
    >>> len(sparse.chosen), sparse.instance.graph.num_edges == len(sparse.kept)
    (30, True)
    """
    settings = (settings or DEFAULT).changed(options)
    if by not in get_args(By):
        raise InputError(f"by is 'connectivity' or 'spectrum', not {by!r}")
    whole, rotations = _with_rotations(graph)
    loops = _loop_closures(rotations)
    count = _number(keep, int(loops.sum()))
    connectivity = Connectivity(rotations.problem)
    margin = SpectralMargin(connectivity) if by == "spectrum" else None
    choice = choose(connectivity, loops, count, margin)
    full = connectivity(np.ones(len(loops)))[0]
    chosen = rotations.edges[choice.chosen]
    left_out = np.setdiff1d(rotations.edges[loops], chosen)
    kept = np.setdiff1d(np.arange(whole.graph.num_edges), left_out)
    sparse = whole.with_edges(kept)
    problem = certifiable(whole, CHORDAL)
    best = search(problem, settings)
    answer = search(certifiable(sparse, CHORDAL), settings)
    poses = whole.poses
    return Sparsified(
        instance=sparse,
        kept=kept,
        chosen=chosen,
        loops=int(loops.sum()),
        full=full,
        connectivity=choice.connectivity,
        bound=choice.bound,
        whole=best,
        answer=answer,
        cost=problem.cost(answer.estimate),
        moved=trajectory_errors(answer.estimate.subset(poses), best.estimate.subset(poses)),
    )


def suggest_loops(
    graph: Instance | Graph,
    count: int = 5,
    *,
    within: float | None = None,
    estimate: Estimate | None = None,
) -> SuggestedLoops:
    """Pairs of nodes whose loop closures would raise lambda_2 most, one after another.

    A loop closure of weight kappa between i and j raises it by kappa (v_i - v_j)^2 in first order,
    v being the unit eigenvector. Of the pairs with the largest such gain, the best is taken. Where
    lambda_2 is double, as on a cycle, no single loop closure raises it.

    Parameters
    ----------
    count : number of pairs
    within : only pairs at most this far from each other, metres, as places must be near each other
        to be recognized
    estimate : where the nodes are, with ``within``; by default the best estimate found

    Raises
    ------
    InputError
        As `sparsify`; no pair is as near, or positions are missing.
    GraphError
        The graph is not connected.
    NumericalError
        An eigenvector was not found.

    Examples
    --------
    The connectivity of a path of nine nodes, and of the cycle that it becomes, is known in closed
    form: 2 - 2 cos(pi / 9) and 2 - 2 cos(2 pi / 9).

    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> path = winding_cycle(9, 0.0, 0)[0].graph.with_edges(range(8))
    >>> found = certpgo.suggest_loops(path, 1)
    >>> (found.connectivity / found.kappa).round(4).tolist()
    [0.1206, 0.4679]
    """
    if count < 1:
        raise InputError(f"the number of loop closures must be at least 1, not {count}")
    instance, rotations = _with_rotations(graph)
    problem, nodes = rotations.problem, rotations.nodes
    near = None if within is None else _near(instance, nodes, within, estimate)
    loops = _loop_closures(rotations)
    kappa = float(np.median(problem.graph.kappa[loops] if loops.any() else problem.graph.kappa))
    connectivity = Connectivity(problem)
    values = [connectivity(np.ones(problem.graph.num_edges))[0]]
    pairs: list[IntArray] = []
    while len(pairs) < count:
        v = connectivity.vector
        new = _unconnected(problem.graph, _ends(v) if near is None else near)
        gain = (v[new[:, 0]] - v[new[:, 1]]) ** 2
        trials = []
        for pair in new[np.argsort(-gain, kind="stable")[:TRIED]]:
            trial = RotationProblem(_with_loop(problem.graph, pair, kappa))
            one = Connectivity(trial, v)
            trials.append((one(np.ones(trial.graph.num_edges))[0], pair, trial, one))
        if not trials:
            break
        least = max(trial[0] for trial in trials) * (1.0 - BETTER)
        value, pair, problem, connectivity = next(one for one in trials if one[0] >= least)
        pairs.append(pair)
        values.append(value)
    if not pairs:
        raise InputError(f"{instance.name}: no two nodes are left to connect")
    return SuggestedLoops(instance, nodes[np.array(pairs)], np.array(values), kappa)


class _Rotations(NamedTuple):
    """The relative rotations of an instance: their edges and nodes in it, with ids, and problem."""

    edges: IntArray
    nodes: IntArray
    ids: IntArray
    problem: RotationProblem


def _with_rotations(graph: Instance | Graph) -> tuple[Instance, _Rotations]:
    """The instance, and its relative rotations."""
    instance = graph
    if not isinstance(instance, Instance):
        instance = Instance("graph", instance, np.arange(instance.num_nodes))
    require_one_unit(instance.graph, "loop closures")
    require_connected(instance.measurements)
    edges = np.flatnonzero(instance.measurements.are(Kind.BETWEEN, Kind.ROTATION))
    nodes = np.unique(instance.graph.edges[edges])
    if not len(edges):
        raise GraphError(f"{instance.name}: no rotation is measured between poses")
    rotation = instance.graph.rotation.with_edges(edges).subgraph(nodes)
    if not rotation.is_connected:
        raise GraphError(f"{instance.name}: rotations between poses do not connect them")
    return instance, _Rotations(edges, nodes, instance.ids[nodes], RotationProblem(rotation))


def _loop_closures(rotations: _Rotations) -> BoolArray:
    """(r,) relative rotations that are neither odometry nor needed to connect the nodes."""
    graph = rotations.problem.graph
    i, j = rotations.ids[graph.edges].T
    loops = np.asarray(np.abs(i - j) != 1)
    if components_of(graph.num_nodes, graph.edges[~loops]).max(initial=0) > 0:
        # Odometry is shorter than all others, so that the tree completes it.
        lengths = 1.0 / graph.kappa
        lengths = np.where(loops, lengths, 0.5 * lengths.min())
        tree = minimum_spanning_tree(graph, lengths)
        pair = np.sort(graph.edges, axis=1) @ np.array([graph.num_nodes, 1])
        order = np.lexsort((lengths, pair))
        first = order[np.unique(pair[order], return_index=True)[1]]
        joined = np.sort(np.column_stack(tree.nonzero()), axis=1) @ [graph.num_nodes, 1]
        loops[first[np.isin(pair[first], joined)]] = False
    return loops


def _number(keep: float, loops: int) -> int:
    """How many loop closures to keep."""
    if loops == 0:
        raise InputError("the graph has no loop closures to choose from")
    if isinstance(keep, int):
        if not 1 <= keep <= loops:
            raise InputError(f"1 to {loops} loop closures can be kept, not {keep}")
        return keep
    if not 0.0 < keep <= 1.0:
        raise InputError(f"the fraction of loop closures must be in (0, 1], not {keep:g}")
    return max(1, round(keep * loops))


def _near(
    instance: Instance, nodes: IntArray, within: float, estimate: Estimate | None
) -> IntArray:
    """(p, 2) pairs of these nodes, by place, at most this far apart, but not consecutive."""
    if estimate is None:
        estimate = search(certifiable(instance, CHORDAL), DEFAULT).estimate
    if estimate.translations is None:
        raise InputError(f"{instance.name}: nodes of a rotation graph have no distance")
    pairs = KDTree(estimate.translations[nodes]).query_pairs(within, output_type="ndarray")
    apart = np.abs(np.diff(instance.ids[nodes][pairs], axis=1)[:, 0]) != 1
    if not apart.any():
        raise InputError(f"{instance.name}: no two nodes are within {within:g} m of each other")
    return np.asarray(pairs[apart])


def _ends(v: FloatArray) -> IntArray:
    """(p, 2) pairs of a node with small v and one with large v."""
    order = np.argsort(v)
    low, high = order[:ENDS], order[-ENDS:]
    pairs = np.column_stack([np.repeat(low, len(high)), np.tile(high, len(low))])
    return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def _unconnected(graph: RotationGraph, pairs: IntArray) -> IntArray:
    """Those of the pairs (p, 2), ascending each, that no edge connects."""
    place = np.array([graph.num_nodes, 1])
    return np.asarray(pairs[~np.isin(pairs @ place, np.sort(graph.edges, axis=1) @ place)])


def _with_loop(graph: RotationGraph, pair: IntArray, kappa: float) -> RotationGraph:
    """The graph with another edge, whose measurement does not matter."""
    return RotationGraph(
        graph.num_nodes,
        np.concatenate([graph.edges, pair[None]]),
        np.concatenate([graph.rotations, np.eye(graph.d)[None]]),
        np.append(graph.kappa, kappa),
    )
