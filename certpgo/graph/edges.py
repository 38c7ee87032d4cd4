"""Arrays of edges: what a graph requires of them, and which of them a part keeps."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from certpgo.errors import GraphError, InputError
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    chosen_rows,
    frozen_flags,
    frozen_floats,
)

if TYPE_CHECKING:
    from scipy import sparse

Keep = Literal["all", "first", "last"]

#: Products of numbers beyond might underflow or overflow. The checker has its own, the same.
FAR = 2.0**400


class Pairs:
    """Nodes that pairs connect."""

    num_nodes: int
    edges: IntArray

    @cached_property
    def components(self) -> IntArray:
        """(n,) label of each node's connected component; labels count from 0."""
        return components_of(self.num_nodes, self.edges)

    @cached_property
    def component_sizes(self) -> tuple[int, ...]:
        """Nodes in each component, in the order of the labels."""
        return tuple(int(k) for k in np.bincount(self.components))

    @property
    def is_connected(self) -> bool:
        """Whether there is one component."""
        return len(self.component_sizes) == 1


def in_range(weights: FloatArray) -> BoolArray:
    """Which weights are allowed: products of others could overflow or underflow."""
    return np.asarray((weights > 1.0 / FAR) & (weights < FAR))


def check_edges(edges: IntArray, n: int) -> None:
    """Refuse indices out of range and loops by a GraphError."""
    if edges.size and not (edges.min() >= 0 and edges.max() < n):
        outside = np.asarray(((edges < 0) | (edges >= n)).any(axis=1))
        raise GraphError(f"{edge_name(edges, outside)}: nodes are numbered 0 to {n - 1}")
    loop = np.asarray(edges[:, 0] == edges[:, 1])
    if loop.any():
        raise GraphError(f"{edge_name(edges, loop)}: a node cannot be measured from itself")


def check_weights(
    name: str, weights: FloatArray, edges: IntArray, *, or_none: bool = False
) -> None:
    """Refuse weights of another shape or out of range by a GraphError.

    With ``or_none`` they may be 0, which measures nothing.
    """
    if weights.shape != (len(edges),):
        raise GraphError(f"{name} must have {len(edges)} entries, not {weights.shape}")
    bad = ~in_range(weights)
    if or_none:
        bad &= weights != 0.0
    if bad.any():
        value = weights[np.argmax(bad)]
        expected = "positive" if value <= 0.0 else f"between {1.0 / FAR:.2g} and {FAR:.2g}"
        raise GraphError(f"{edge_name(edges, bad)}: {name} is {value}; it must be {expected}")


def check_matrices(name: str, values: FloatArray, shape: tuple[int, ...], edges: IntArray) -> None:
    """Refuse arrays of another shape or too large by a GraphError."""
    if values.shape != shape:
        raise GraphError(f"{name} must be {shape}, not {values.shape}")
    bad = np.asarray(~(np.abs(values) < FAR).reshape(len(edges), -1).all(axis=1))
    if bad.any():
        raise GraphError(f"{edge_name(edges, bad)}: {name} must be below {FAR:.2g}")


def check_flags(name: str, flags: BoolArray | None, m: int) -> BoolArray | None:
    """(m,) flags of edges, or None if none is set; a GraphError if they are more or fewer."""
    if flags is None:
        return None
    given = frozen_flags(flags)
    if given.shape != (m,):
        raise GraphError(f"{name} must be {m} flags, one per edge")
    return given if given.any() else None


def flags_of_nodes(name: str, flags: BoolArray, n: int) -> BoolArray:
    """(n,) flags of nodes; a GraphError if they are more or fewer."""
    given = frozen_flags(flags)
    if given.shape != (n,):
        raise GraphError(f"{name} must be {n} flags, one per node")
    return given


def symmetric(A: FloatArray) -> FloatArray:
    """The symmetric parts of matrices (m, d, d)."""
    return np.asarray(0.5 * A + 0.5 * np.swapaxes(A, 1, 2))  # whose sum may be beyond doubles


def polar_factors(N: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Factors P, K and K' (m, d, d) with N = P K = K' P, P orthogonal, K and K' symmetric >= 0."""
    # A reflection of one axis makes every determinant positive.
    flip = np.ones(N.shape[:-1])
    flip[:, -1] = np.where(so.determinants(N) < 0.0, -1.0, 1.0)
    P = so.project(N * flip[:, None, :]) * flip[:, None, :]
    back = np.swapaxes(P, 1, 2)
    return P, symmetric(back @ N), symmetric(N @ back)


def edge_name(edges: IntArray, bad: BoolArray) -> str:
    """The first bad edge, for messages."""
    i, j = edges[np.argmax(bad)]
    return f"edge ({i}, {j})"


def broadcast(weights: FloatArray | float, m: int) -> FloatArray:
    """One weight per edge."""
    given = frozen_floats(weights)
    if given.shape not in ((), (1,), (m,)):
        raise InputError(f"one weight is expected, or {m}, not {given.shape}")
    return np.broadcast_to(given, (m,))


def components_of(n: int, edges: IntArray) -> IntArray:
    """(n,) label of each node's connected component; labels count from 0."""
    labels: IntArray = np.empty(n, dtype=np.int64)
    if compiled.AVAILABLE:
        compiled.kernel.components(np.ascontiguousarray(edges, dtype=np.int64), labels)
    else:
        from scipy.sparse import csgraph

        matrix = adjacency(n, edges[:, 0], edges[:, 1], np.ones(len(edges)))
        labels = csgraph.connected_components(matrix, directed=False)[1].astype(np.int64)
    labels.flags.writeable = False
    return labels


def adjacency(n: int, i: IntArray, j: IntArray, values: FloatArray) -> sparse.csr_array:
    """The (n, n) matrix with ``values`` at (i, j), repeated pairs summed, for csgraph."""
    from scipy import sparse

    # csgraph needs 32-bit indices; SciPy before 1.17 does not convert them.
    pairs = np.asarray(i, dtype=np.int32), np.asarray(j, dtype=np.int32)
    return sparse.coo_array((values, pairs), shape=(n, n)).tocsr()


def simple_edges(n: int, edges: IntArray, keep: Keep) -> IntArray:
    """Indices of the edges that ``keep`` keeps of parallel ones, ascending."""
    if keep == "all":
        return np.arange(len(edges))
    pair = np.sort(edges, axis=1) @ np.array([n, 1])
    if keep == "last":
        _, index = np.unique(pair[::-1], return_index=True)
        return np.sort(len(edges) - 1 - index)
    if keep == "first":
        return np.sort(np.unique(pair, return_index=True)[1])
    raise GraphError(f"keep must be 'all', 'first' or 'last', not {keep!r}")


def chosen_nodes(nodes: ArrayLike, n: int) -> IntArray:
    """The numbers of some of n nodes, given by these or as flags."""
    return np.asarray(np.arange(n)[chosen_rows(nodes, n, "nodes")])


def induced(n: int, edges: IntArray, nodes: IntArray) -> tuple[IntArray, IntArray]:
    """Renumbered edges among ``nodes``, and which edges of the whole graph they are."""
    number = np.full(n, -1, dtype=np.intp)
    number[nodes] = np.arange(len(nodes))
    renumbered = number[edges]
    chosen = np.flatnonzero((renumbered >= 0).all(axis=1))
    return renumbered[chosen], chosen
