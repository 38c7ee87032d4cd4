"""Loop closures that are missing: the eigenvector of lambda_2 says which would help much."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np
from scipy.spatial import KDTree

from certpgo.errors import InputError, require
from certpgo.graph import Estimate, Graph, Instance, RotationGraph
from certpgo.graph.display import Speaking
from certpgo.graph.phrases import counted, shown_id
from certpgo.graph.succession import succession
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import CHORDAL, objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.connectivity import Connectivity
from certpgo.solve.loop_closures import loop_closures, with_rotations
from certpgo.solve.search import search
from certpgo.solve.settings import DEFAULT

#: Pairs whose lambda_2 is computed, of those with the largest gain in first order.
TRIED = 8
#: Relative difference of lambda_2 from which a pair is better than one of larger gain.
BETTER = 1e-9
#: Nodes at either end of the eigenvector whose pairs are considered.
ENDS = 64


@dataclass(frozen=True, eq=False, repr=False)
class SuggestedLoops(Speaking):
    """Loop closures that would make a graph more connected, chosen one after another.

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
            yield f"{shown_id(i)}-{shown_id(j)}", f"{value:.4g}"

    @property
    def named(self) -> IntArray:
        """(k, 2) the pairs by the instance's ids."""
        return np.asarray(self.instance.ids[self.pairs])

    def _picture(self) -> str:
        return self.instance._picture()


def suggest_loops(
    graph: Instance | Graph,
    count: int = 5,
    *,
    within: float | None = None,
    estimate: Estimate | None = None,
) -> SuggestedLoops:
    """Pairs of nodes whose loop closures would raise lambda_2, chosen greedily.

    A loop closure of weight kappa between i and j raises it by kappa (v_i - v_j)^2 in first order,
    v being the unit eigenvector. Of the eight pairs with the largest such gain, the best is taken,
    and the next pair is chosen with it. No search: another pair may raise lambda_2 more, and other
    sets of as many pairs may. Where lambda_2 is double, as on a cycle, no single loop closure
    raises it.

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
    require(count, Integral, "the number of loop closures")
    if count < 1:
        raise InputError(f"the number of loop closures must be at least 1, not {count}")
    instance, rotations = with_rotations(graph)
    problem, nodes = rotations.problem, rotations.nodes
    near = None if within is None else _near(instance, nodes, within, estimate)
    loops = loop_closures(rotations)
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
            trial = Quadratic(_with_loop(problem.graph, pair, kappa))
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


def _near(
    instance: Instance, nodes: IntArray, within: float, estimate: Estimate | None
) -> IntArray:
    """(p, 2) pairs of these nodes, by place, at most this far apart, but not consecutive."""
    require(within, Real, "a distance in metres")
    if estimate is None:
        estimate = search(objective_of(instance, CHORDAL), DEFAULT).estimate
    if estimate.translations is None:
        raise InputError(f"{instance.name}: nodes of a rotation graph have no distance")
    pairs = KDTree(estimate.translations[nodes]).query_pairs(within, output_type="ndarray")
    apart = ~succession(instance).are_steps(nodes[pairs])
    if not apart.any():
        raise InputError(f"{instance.name}: no two nodes are within {within:g} m of each other")
    return np.asarray(pairs[apart])


def _ends(v: FloatArray) -> IntArray:
    """(p, 2) pairs of a node with small v and one with large v."""
    order = np.argsort(v)
    low, high = order[:ENDS], order[-ENDS:]
    pairs = np.column_stack([np.repeat(low, len(high)), np.tile(high, len(low))])
    return np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)


def _unconnected(graph: Graph, pairs: IntArray) -> IntArray:
    """Those of the pairs (p, 2), ascending each, that no edge connects."""
    place = np.array([graph.num_nodes, 1])
    return np.asarray(pairs[~np.isin(pairs @ place, np.sort(graph.edges, axis=1) @ place)])


def _with_loop(graph: Graph, pair: IntArray, kappa: float) -> Graph:
    """The graph with another edge, whose measurement does not matter."""
    return RotationGraph(
        graph.num_nodes,
        np.concatenate([graph.edges, pair[None]]),
        np.concatenate([graph.rotations, np.eye(graph.d)[None]]),
        np.append(graph.kappa, kappa),
    )
