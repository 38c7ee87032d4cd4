"""The graph itself: copies of measurements, parallel ones that exclude each other, bridges."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy import special
from scipy.sparse import csgraph

from certpgo.diagnosis.detectability import information_of, noise_at, noise_of
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import REMARK, Finding
from certpgo.graph import Instance
from certpgo.graph.bridges import bridges
from certpgo.graph.edges import adjacency, components_of
from certpgo.graph.kinds import Measurements
from certpgo.graph.phrases import counted, few
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import objective_of
from certpgo.optimize.descent import descend
from certpgo.solve.accuracy_wording import ends, few_edges

#: Probability that right parallel measurements are called contradictory.
RARE = 1e-6
#: Pairs without which the noise is judged.
LEFT_OUT = 10
#: Share and number of nodes from which what hangs on a bridge is large.
SHARE, MANY = 0.1, 10
#: Nodes that are named where their ids are not consecutive.
FEW = 4


def found(examined: Examined) -> Iterator[Finding]:
    """Copies and contradictions among parallel measurements."""
    examined.trying("duplicated-edges")
    yield from copies(examined.instance)
    if not examined.instance.graph.has_scales:
        examined.trying("contradictory-edges")
        yield from _contradictions(examined)


# --- Parallel measurements ------------------------------------------------------------------------


def copies(instance: Instance) -> Iterator[Finding]:
    """Measurements that repeat others."""
    graph = instance.graph
    m, known = graph.num_edges, instance.is_measured
    numbers = [graph.edges, graph.rotations.reshape(m, -1), graph.kappa[:, None]]
    if graph.has_positions:
        numbers += [graph.translations, graph.tau[:, None]]
    rows = np.flatnonzero(known)
    _, first, kind, counts = np.unique(
        np.concatenate(numbers, axis=1)[rows],
        axis=0,
        return_index=True,
        return_inverse=True,
        return_counts=True,
    )
    again = np.setdiff1d(np.arange(len(rows)), first)
    if not len(again):
        return
    most = int(counts[kind.reshape(-1)].max())
    copied = rows[again]
    yield Finding(
        "duplicated-edges",
        f"{len(again)} of {counted(len(rows), 'measurement{s}')} repeat others exactly "
        f"({few_edges(instance, copied)}): covariances there are up to "
        f"{math.sqrt(most):.3g} times too small, in standard deviations",
        "keep each once, unless they were measured independently",
        strength=min(0.2 + 1.6 * len(again) / len(rows), 1.0),
        edges=tuple(instance.known_numbers[copied].tolist()),
        proven=True,
    )


def _contradictions(examined: Examined) -> Iterator[Finding]:
    """The parallel measurements that exclude each other beyond the noise."""
    instance, graph = examined.instance, examined.instance.graph
    pairs = _parallel(np.sort(graph.edges, axis=1), np.flatnonzero(examined.whole))
    if not len(pairs):
        return
    apart = _disagreements(examined, pairs)
    p = so.tangent_dim(graph.d) + (graph.d if graph.has_positions else 0)
    # Squares of turns may count twice.
    most = float(examined.problem.double.max() * special.chdtri(p, RARE / len(pairs)))
    noise = noise_of(examined)
    if noise != 1.0:  # it may be what these measurements make of it
        noise = min(noise, max(_noise_without(examined, pairs, apart), float(noise > 1.0)))
    excluded = np.flatnonzero(apart > noise**2 * most)
    if not len(excluded):
        return
    worst = excluded[np.argmax(apart[excluded])]
    i, j = instance.pairs[pairs[worst, 0]].tolist()
    costs = examined.problem.edge_costs(examined.answer.estimate)[pairs[worst]]
    numbers = instance.known_numbers[pairs]
    yield Finding(
        "contradictory-edges",
        f"{counted(len(excluded), 'pair{s}')} of parallel measurements cannot both be right; the "
        f"worst is between {ends(instance, i, j, 'and')}: chi^2 of their "
        f"difference is {apart[worst]:.4g}, where {most:.3g} is rare; measurements "
        f"{numbers[worst, 0]} and {numbers[worst, 1]} cost {costs[0]:.3g} and {costs[1]:.3g} in "
        "the best map",
        "remove the wrong one of each pair: certpgo solve GRAPH --robust",
        strength=0.5,
        edges=tuple(np.unique(numbers[excluded]).tolist()),
        proven=True,
    )


def _noise_without(examined: Examined, pairs: IntArray, apart: FloatArray) -> float:
    """The noise by residuals without the costlier ones of the pairs that disagree most."""
    answer = examined.answer
    worst = pairs[np.argsort(-apart)[:LEFT_OUT]]
    costs = examined.problem.edge_costs(answer.estimate)[worst]
    out = np.take_along_axis(worst, np.argmax(costs, axis=1)[:, None], 1)
    kept = np.ones(examined.instance.graph.num_edges, dtype=bool)
    kept[out] = False
    problem = objective_of(examined.instance.with_edges(kept), examined.problem.cost_name)
    end = descend(problem, problem.settled(answer.estimate), monitor=examined.monitor)
    return noise_at(problem, problem.settled(end.estimate))


def _parallel(sides: IntArray, rows: IntArray) -> IntArray:
    """(k, 2) rows between the same nodes, each with the next one."""
    order = rows[np.lexsort((rows, sides[rows, 1], sides[rows, 0]))]
    same = (sides[order[1:]] == sides[order[:-1]]).all(axis=1)
    return np.stack([order[:-1][same], order[1:][same]], axis=1)


def _disagreements(examined: Examined, pairs: IntArray) -> FloatArray:
    """(k,) chi^2 of the differences of parallel measurements, zero where that is not known."""
    graph, answer = examined.instance.graph, examined.answer
    sides = np.sort(graph.edges[pairs[:, 0]], axis=1)
    (R, t), (Q, s) = (_as_between(examined, pairs[:, k], sides[:, 0]) for k in (0, 1))
    parts = [so.log(np.swapaxes(R, 1, 2) @ Q).reshape(len(pairs), -1)]
    if graph.has_positions:
        parts.insert(0, np.einsum("kba,kb->ka", R, s - t))
    off = np.concatenate(parts, axis=1)
    both = pairs.T.ravel(), np.concatenate([sides, sides])
    of_both = information_of(answer.problem, answer.marginals, *both)
    known = (np.linalg.eigvalsh(of_both)[:, 0] > 0.0).reshape(2, -1).all(axis=0)
    W, V = np.split(of_both, 2)
    found = np.zeros(len(pairs))
    spread = np.linalg.inv(W[known]) + np.linalg.inv(V[known])
    solved = np.linalg.solve(spread, off[known][:, :, None])[:, :, 0]
    found[known] = (off[known] * solved).sum(axis=1)
    return found


def _as_between(
    examined: Examined, rows: IntArray, first: IntArray
) -> tuple[FloatArray, FloatArray]:
    """What some measurements say of the second pose in the frame of the first."""
    graph = examined.instance.graph
    R, is_back = graph.rotations[rows], graph.edges[rows, 0] != first
    back = np.swapaxes(R, 1, 2)
    turned = np.where(is_back[:, None, None], back, R)
    if not graph.has_positions:
        return turned, np.zeros((len(rows), 0))
    t = graph.translations[rows]
    return turned, np.where(is_back[:, None], -np.einsum("kab,kb->ka", back, t), t)


# --- Bridges --------------------------------------------------------------------------------------


def remarks(examined: Examined) -> Iterator[Finding]:
    """The bridge on which most hangs, which matters where something else is wrong."""
    instance = examined.instance
    hanging = _hanging(instance.measurements)
    if hanging is None:
        return
    (i, j), nodes = hanging
    between = ends(instance, int(instance.ids[i]), int(instance.ids[j]), "and")
    if instance.world is not None:
        nodes = nodes[nodes != instance.world]
    ids = np.sort(instance.ids[nodes])
    yield Finding(
        REMARK,
        f"all of {counted(len(ids), 'node{s}')} ({_in_short(ids.tolist())}) hang on what is "
        f"measured between {between}, which nothing checks",
        "measure them once more from elsewhere",
        strength=0.0,
        edges=_numbers_of(instance, i, j),
        proven=True,
    )


def _in_short(ids: list[int]) -> str:
    """Ascending ids: from which to which if none is missing, else the first few."""
    if ids[-1] - ids[0] == len(ids) - 1:
        return f"{ids[0]} to {ids[-1]}"
    return few(ids, FEW)


def _numbers_of(instance: Instance, i: int, j: int) -> tuple[int, ...]:
    pairs = np.sort(instance.measurements.edges, axis=1)
    rows = np.flatnonzero((pairs == sorted((i, j))).all(axis=1))
    return tuple(instance.known_numbers[rows].tolist())


def _hanging(measured: Measurements) -> tuple[tuple[int, int], IntArray] | None:
    """The bridge that splits off most nodes, and which: the smaller part, if that is large."""
    alone, n = bridges(measured), measured.num_nodes
    if not len(alone):
        return None
    pairs = np.sort(measured.edges, axis=1)
    rest = ~np.isin(pairs @ [n, 1], alone @ [n, 1])
    labels = components_of(n, measured.edges[rest])
    sizes, (i, j) = np.bincount(labels), labels[alone].T
    tree = adjacency(len(sizes), i, j, np.ones(len(alone)))
    order, parents = csgraph.breadth_first_order(tree, 0, directed=False)
    below = sizes.copy()
    for block in order[:0:-1].tolist():
        below[parents[block]] += below[block]
    lower = np.where(parents[i] == j, i, j)
    smaller = np.minimum(below[lower], n - below[lower])
    k = int(np.argmax(smaller))
    if smaller[k] < max(SHARE * n, MANY):
        return None
    first, second = alone[k].tolist()
    others = (pairs != alone[k]).any(axis=1)
    sides = components_of(n, measured.edges[others])
    is_first = sides == sides[first]
    return (first, second), np.flatnonzero(is_first if 2 * is_first.sum() < n else ~is_first)
