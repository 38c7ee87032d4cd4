"""Places for the nodes of graphs that measure no positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import diags_array
from scipy.sparse.linalg import ArpackError, eigsh

from certpgo.graph import Graph
from certpgo.graph.cycles import is_cycle, walk
from certpgo.graph.edges import adjacency, simple_edges
from certpgo.linalg.arrays import CSC, FloatArray, IntArray

#: Share of all pairs that are edges from which on eigenvectors say little about a graph.
DENSE = 0.4
#: Nodes up to which eigenvectors are computed densely.
SMALL = 300
#: Of the extent, within which half of the nodes are as good as in a point.
POINT = 0.3


class Arrangement(NamedTuple):
    """Places (n, 3), and a sentence on what they are."""

    places: FloatArray
    sentence: str


def layout(graph: Graph) -> Arrangement:
    """Nodes on a circle, or by the eigenvectors of the graph, which put neighbours together.

    The circle is for cycles, in their order, and for graphs in which almost all nodes are
    neighbours or that are not connected, in the order of nodes.
    """
    n = graph.num_nodes
    if graph.is_connected and is_cycle(graph):
        sentence = "Nodes are drawn around the cycle; the graph measures no positions."
        return Arrangement(_circle(walk(graph).nodes), sentence)
    kept = simple_edges(n, graph.edges, "first")
    if n > 4 and graph.is_connected and 2 * len(kept) < DENSE * n * (n - 1):
        places = _spectral(graph, kept)
        if places is not None:
            sentence = (
                "Nodes are drawn near their neighbours, by the graph's eigenvectors; it measures "
                "no positions."
            )
            return Arrangement(places, sentence)
    sentence = "Nodes are drawn on a circle, in their order; the graph measures no positions."
    return Arrangement(_circle(np.arange(n)), sentence)


def _circle(order: IntArray) -> FloatArray:
    """Places on the circle of radius 1 around which neighbours of ``order`` are next."""
    angle = np.empty(len(order))
    angle[order] = 2.0 * np.pi * np.arange(len(order)) / len(order)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(len(order))], axis=1)


def _spectral(graph: Graph, kept: IntArray) -> FloatArray | None:
    """The d slowest modes of a random walk on the graph, of extent 1; None without convergence.

    Where they are of a few nodes that hang on single edges, and most others would lie in a point,
    the mean degree is added to each (Qin and Rohe, 2013).
    """
    n, (i, j) = graph.num_nodes, graph.edges[kept].T
    ends = np.concatenate([i, j]), np.concatenate([j, i])
    A = adjacency(n, *ends, np.ones(2 * len(kept)))
    degrees = np.asarray(A.sum(axis=1)).ravel()
    places = None
    for added in (0.0, degrees.mean()):
        places = _modes(A, degrees + added, graph.d)
        if places is None or np.median(np.abs(places).max(axis=1)) > POINT:
            break
    return places


def _modes(A: CSC, degrees: FloatArray, d: int) -> FloatArray | None:
    """Eigenvectors 2 to d + 1 of the adjacency over degrees; None without convergence."""
    n = len(degrees)
    scale = 1.0 / np.sqrt(degrees)
    steps = diags_array(scale) @ A @ diags_array(scale)
    if n <= SMALL:
        modes = np.linalg.eigh(steps.toarray())[1][:, ::-1]
    else:
        try:
            # The largest eigenvalue is simple, and its vector is known: start near the others.
            values, modes = eigsh(steps, d + 1, which="LA", v0=np.cos(np.arange(n)), tol=1e-5)
        except ArpackError:
            return None
        modes = modes[:, np.argsort(-values, kind="stable")]
    places = np.zeros((n, 3))
    chosen = scale[:, None] * modes[:, 1 : d + 1]
    heaviest = np.argmax(np.abs(chosen), axis=0)
    signs = np.sign(chosen[heaviest, np.arange(d)])
    places[:, :d] = signs * chosen / np.abs(chosen).max(axis=0)
    return places
