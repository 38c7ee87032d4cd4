"""Kinds of nodes: how their blocks move, and what their multipliers prove.

A block of a point of the relaxation has d columns in r >= d dimensions: a frame, whose columns are
orthonormal, or a multiple of one. Functions are of the blocks of all nodes of a kind at once. For
S = M less the blocks Lam of symmetric multipliers, and S >= 0,

    F = tr(X S X^T) + sum of tr(Lam_i Y_i^T Y_i) >= sum over kinds of what their diagonals prove.

A kind of one's own derives from one of these by `dataclasses.replace`, and has a number: a row in
``MANIFOLDS``, and one in ``certpgo.graph.kinds.NODES``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph.kinds import Node
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from certpgo.linalg.ball_arithmetic import U

Blocks = Callable[[FloatArray], FloatArray]


def same(blocks: FloatArray) -> FloatArray:
    """The blocks themselves."""
    return blocks


@dataclass(frozen=True)
class Manifold:
    """How the blocks of the nodes of one kind move, and what their multipliers prove.

    Attributes
    ----------
    name : what such nodes are called
    tangents : frames (k, r, d) -> (k, q, r, d) orthonormal bases of their moves
    tangent_dim : (r, d) -> number q of these
    nearest : blocks (k, r, d) -> the nearest frames
    rounded : blocks (k, d, d) -> the nearest frames that an estimate may have
    constrained : symmetric (k, d, d) -> those that are multipliers of the kind's constraints
    admissible : multipliers (k, d, d) -> near ones that a bound may have
    proven : diagonals (k, d) of multipliers -> their share of a bound, rounded down; None if there
        is none, where nothing fixes the lengths of the columns
    turns : whether any rotation of a frame is a move, and any symmetric block a multiplier, as
        compiled sums and Newton's method have it
    scaled : whether blocks are multiples of frames, by any positive factors
    """

    name: str
    tangents: Blocks
    tangent_dim: Callable[[int, int], int]
    nearest: Blocks
    rounded: Blocks
    constrained: Blocks
    admissible: Blocks
    proven: Callable[[FloatArray], float] | None
    turns: bool = False
    scaled: bool = False

    def __post_init__(self) -> None:
        if self.turns and self.constrained not in (same, np.zeros_like):
            raise InputError(f"{self.name}: where frames turn, symmetric blocks are multipliers")


def sum_of(diagonals: FloatArray) -> float:
    """The sum of all entries, rounded down: frames have columns of length one."""
    return math.nextafter(math.fsum(diagonals.ravel().tolist()), -math.inf)


def least_of(diagonals: FloatArray) -> float:
    """The least sum of a row times their number, rounded down: squares of scales have mean one."""
    least = min(math.fsum(row) for row in diagonals.tolist())
    product = math.nextafter(least, -math.inf) * len(diagonals)
    return math.nextafter(product, -math.inf)


def with_common_trace(Lam: FloatArray) -> FloatArray:
    """Multipliers whose traces are the mean of given ones, but for rounding."""
    means = np.trace(Lam, axis1=1, axis2=2) / Lam.shape[-1]
    return _with_means(Lam, means - float(means.mean()))


def traceless(Lam: FloatArray) -> FloatArray:
    """Multipliers of trace zero.

    Their traces are exactly >= 0, by a little, as they count s_i^2 >= 0 times in the cost.
    """
    d = np.arange(Lam.shape[-1])
    own = _with_means(Lam, np.trace(Lam, axis1=1, axis2=2) / Lam.shape[-1])
    diagonal = own[:, d, d]
    size, trace = np.abs(diagonal).sum(axis=1), diagonal.sum(axis=1)  # within 2 U of the sizes
    own[:, -1, -1] += np.maximum(-trace, 0.0) + 4.0 * U * size + 2.0**-1000
    return own


def _with_means(Lam: FloatArray, less: FloatArray) -> FloatArray:
    own, d = Lam.copy(), np.arange(Lam.shape[-1])
    own[:, d, d] -= less[:, None]
    return own


def _stiefel_dim(r: int, d: int) -> int:
    return r * d - d * (d + 1) // 2


def _no_tangents(Y: FloatArray) -> FloatArray:
    return np.zeros((len(Y), 0, *Y.shape[1:]))


def _no_dim(r: int, d: int) -> int:
    return 0


def _identities(blocks: FloatArray) -> FloatArray:
    return np.broadcast_to(np.eye(blocks.shape[-1]), blocks.shape)


#: Rotations: frames of St(r, d), of poses as of nodes that have a rotation alone.
POSE = Manifold(
    "poses",
    so.tangent_basis,
    _stiefel_dim,
    so.orthonormal,
    so.project,
    same,
    same,
    sum_of,
    turns=True,
)
#: Positions alone: what is stored as their blocks stays as it is.
POINT = Manifold(
    "points",
    _no_tangents,
    _no_dim,
    same,
    _identities,
    np.zeros_like,
    same,
    None,
    turns=True,
)
#: Similarities of unknown scale, beside poses whose scale is known.
SCALED = Manifold(
    "poses of unknown scale",
    so.tangent_basis,
    _stiefel_dim,
    so.orthonormal,
    so.project,
    traceless,
    traceless,
    None,
    scaled=True,
)
#: Similarities in a map without any known scale, in the unit of the root mean square of all.
IN_MEAN_UNIT = Manifold(
    "poses of unknown scale in their mean unit",
    so.tangent_basis,
    _stiefel_dim,
    so.orthonormal,
    so.project,
    with_common_trace,
    with_common_trace,
    least_of,
    scaled=True,
)


#: What each kind of node is.
MANIFOLDS: dict[int, Manifold] = {
    Node.POSE: POSE,
    Node.ROTATION: POSE,
    Node.POINT: POINT,
    Node.SCALED: SCALED,
}


@dataclass(frozen=True, eq=False)
class Kinds:
    """The kinds of a graph's nodes.

    Attributes
    ----------
    of : (n,) which of the manifolds each node has
    manifolds : of the kinds
    """

    of: IntArray
    manifolds: tuple[Manifold, ...]

    @staticmethod
    def in_graph(graph: Any, pose: Manifold) -> Kinds:
        """Those of a graph, whose poses are of kind ``pose``."""
        own = {**MANIFOLDS, Node.POSE: pose, Node.ROTATION: pose}
        if graph.in_mean_unit:
            own[Node.SCALED] = IN_MEAN_UNIT
        return Kinds(graph.nodes, tuple(own[k] for k in range(len(own))))

    @cached_property
    def _parts(self) -> list[tuple[Manifold, IntArray]]:
        counts = np.bincount(self.of, minlength=len(self.manifolds)).tolist()
        kinds = [k for k, count in enumerate(counts) if count]
        return [(self.manifolds[k], np.flatnonzero(self.of == k)) for k in kinds]

    def apply(self, name: str, blocks: FloatArray) -> FloatArray:
        """A function of the manifolds of blocks (..., n, r, d): zeros where one gives fewer."""
        parts = self._parts
        if len(parts) == 1:
            return np.asarray(getattr(parts[0][0], name)(blocks))
        found = [(at, getattr(kind, name)(blocks[..., at, :, :])) for kind, at in parts]
        if name != "tangents":
            out = np.empty_like(blocks)
            for nodes, values in found:
                out[..., nodes, :, :] = values
            return out
        most = max(values.shape[1] for _, values in found)
        bases = np.zeros((len(blocks), most, *blocks.shape[1:]))
        for nodes, values in found:
            bases[nodes, : values.shape[1]] = values
        return bases

    def tangent_dim(self, rank: int, d: int) -> int:
        """The number of tangents that a node has at most."""
        return max(kind.tangent_dim(rank, d) for kind, _ in self._parts)

    def proven(self, diagonals: FloatArray) -> float:
        """The bound by diagonals (k, d) of the multipliers at the `held` nodes, rounded down."""
        among = self.of[self.held]
        kinds = [k for k, kind in enumerate(self.manifolds) if kind.proven and (among == k).any()]
        if len(kinds) == 1:
            return self._proven_by(kinds[0], diagonals)
        shares = [self._proven_by(k, diagonals[among == k]) for k in kinds]
        return math.nextafter(math.fsum(shares), -math.inf)

    def _proven_by(self, k: int, diagonals: FloatArray) -> float:
        proven = self.manifolds[k].proven
        return proven(diagonals) if proven else 0.0

    @cached_property
    def turn(self) -> bool:
        """Whether any rotation moves a block, as compiled sums and Newton's method have it."""
        return all(kind.turns for kind, _ in self._parts)

    @cached_property
    def held(self) -> IntArray:
        """The nodes whose multipliers count in bounds, ascending."""
        return np.flatnonzero(np.array([bool(kind.proven) for kind in self.manifolds])[self.of])

    @cached_property
    def scaled(self) -> BoolArray:
        """(n,) which nodes have an unknown scale."""
        return np.array([kind.scaled for kind in self.manifolds])[self.of]

    @property
    def in_mean_unit(self) -> bool:
        """Whether no scale is known, and the unit is the root mean square of all."""
        return IN_MEAN_UNIT in self.manifolds
