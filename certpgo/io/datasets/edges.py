"""Edges (m, 2) of random graphs and of real scenes."""

from __future__ import annotations

import bisect
from pathlib import Path

import numpy as np
from scipy import linalg
from scipy.sparse import csgraph

from certpgo.errors import FileNotHere, InputError
from certpgo.graph.edges import adjacency
from certpgo.io.datasets.source import dataset
from certpgo.io.reading import read
from certpgo.linalg.arrays import IntArray


def viewing_edges(name: str, data: str | Path | None = None) -> tuple[str, int, IntArray]:
    """Name, number of nodes and edges of the largest component of a local dataset."""
    path = dataset(name, data).found
    if path is None:
        raise FileNotHere(f"{name}: file not here; certpgo fetch {name}")
    graph = read(path, quiet=True).graph
    graph = graph.rotations_alone
    sizes = np.array(graph.component_sizes)
    graph = graph.subgraph(np.flatnonzero(graph.components == int(np.argmax(sizes))))
    return Path(path).stem, graph.num_nodes, graph.edges


def random_edges(n: int, m: int, rng: np.random.Generator) -> IntArray:
    """A random tree on n nodes and uniformly random pairs, m distinct edges."""
    codes = _tree_codes(n, rng)
    while len(codes) < m:
        # Keep first occurrences: the tree, then new pairs in the order drawn.
        i, j = rng.integers(0, n, (2, 2 * (m - len(codes)) + 16))
        drawn = np.concatenate([codes, _pair_codes(n, i[i != j], j[i != j])])
        codes = drawn[np.sort(np.unique(drawn, return_index=True)[1])][:m]
    return _pairs(n, codes)


def edges_of_connectivity(
    n: int, fiedler: float, rng: np.random.Generator, *, rtol: float = 0.03, draws: int = 25
) -> IntArray:
    """A random tree on n nodes and uniformly random pairs, with a given Fiedler value.

    That is the second eigenvalue of the graph Laplacian with unit weights. Pairs are added in a
    random order; as no edge decreases an eigenvalue, bisection finds how many. If the value jumps
    too far, another tree and order are drawn. Eigenvalues are computed by dense algebra, for a few
    thousand nodes at most.

    Parameters
    ----------
    rtol : largest relative error of the Fiedler value
    draws : maximal number of trees and orders

    Raises
    ------
    InputError
        No graph drawn is within the tolerance.
    """
    nearest = np.inf
    for _ in range(draws):
        edges, value = _bisected(n, fiedler, rng)
        if abs(value - fiedler) <= rtol * fiedler:
            return edges
        nearest = min(nearest, value, key=lambda x: abs(x - fiedler))
    raise InputError(
        f"no random graph of {n} nodes has a Fiedler value within {100 * rtol:g} percent of "
        f"{fiedler:g}; the nearest of {draws} has {nearest:g}"
    )


def _bisected(n: int, fiedler: float, rng: np.random.Generator) -> tuple[IntArray, float]:
    """The edges in one random order with the nearest Fiedler value, and that value."""
    tree = _tree_codes(n, rng)
    others = np.setdiff1d(_pair_codes(n, *np.triu_indices(n, 1)), tree)
    codes = np.concatenate([tree, rng.permutation(others)])

    def reached(m: int) -> float:
        return _fiedler_value(n, _pairs(n, codes[:m]))

    counts = range(n - 1, len(codes) + 1)
    place = bisect.bisect_left(counts, fiedler, key=reached)
    near = {m: reached(m) for m in counts[max(place - 1, 0) : place + 1]}
    m = min(near, key=lambda m: abs(near[m] - fiedler))
    return _pairs(n, codes[:m]), near[m]


def connected_choice(n: int, edges: IntArray, kept: int, rng: np.random.Generator) -> IntArray:
    """Indices of ``kept`` random edges that contain a random spanning tree, ascending."""
    draw = rng.permutation(len(edges))
    tree = csgraph.minimum_spanning_tree(
        adjacency(n, edges[:, 0], edges[:, 1], (draw + 1).astype(np.float64))
    )
    draw[np.argsort(draw)[tree.data.astype(np.intp) - 1]] -= len(edges)
    return np.sort(np.argsort(draw)[:kept])


def path_with_closures(n: int, m: int, rng: np.random.Generator) -> IntArray:
    """The path 0, 1, ..., n-1 and uniformly random pairs, m distinct edges."""
    i, j = np.triu_indices(n, 2)
    chosen = rng.choice(len(i), m - (n - 1), replace=False)
    steps = np.arange(n - 1) * n + np.arange(1, n)
    return _pairs(n, np.concatenate([steps, _pair_codes(n, i[chosen], j[chosen])]))


def _tree_codes(n: int, rng: np.random.Generator) -> IntArray:
    """Each node after the first is connected to an earlier one, in random order."""
    label = rng.permutation(n)
    earlier = rng.integers(0, np.arange(1, n))
    return _pair_codes(n, label[1:], label[earlier])


def _pair_codes(n: int, i: IntArray, j: IntArray) -> IntArray:
    return np.asarray(np.minimum(i, j) * n + np.maximum(i, j))


def _pairs(n: int, codes: IntArray) -> IntArray:
    """The pairs (i, j), i < j, of codes, sorted."""
    return np.stack(np.divmod(np.sort(codes), n), axis=1)


def _fiedler_value(n: int, edges: IntArray) -> float:
    i, j = edges.T
    L = np.zeros((n, n))
    L[i, j] = L[j, i] = -1.0
    L[np.diag_indices(n)] = -L.sum(axis=1)
    return float(linalg.eigh(L, eigvals_only=True, subset_by_index=[1, 1])[0])
