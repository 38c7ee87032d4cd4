"""Measurements of one kind between pairs of nodes, a row each: what a graph is a sum of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral
from typing import Any, ClassVar, Self

import numpy as np

from certpgo.errors import GraphError, InputError, require
from certpgo.graph.display import Brief
from certpgo.graph.edges import broadcast, check_edges, edge_name, induced
from certpgo.graph.kinds import Kind
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray, frozen_indices


@dataclass(frozen=True, eq=False, repr=False)
class Observations(Brief):
    """Measurements of one kind, besides a graph's edges; a kind is a subclass.

    Its other attributes are arrays with a row each. What they cost says a
    `certpgo.objective.term.Term` that takes the class.

    Attributes
    ----------
    num_nodes : number n of nodes of the graph that they belong to
    edges : (k, 2) node pairs

    Raises
    ------
    GraphError
        An index out of range, or a pair of equal nodes; or other arrays than of k rows.
    """

    #: What a row measures.
    kind: ClassVar[Kind] = Kind.OTHER
    #: Whether they measure positions, so that a world that they are of is somewhere.
    places: ClassVar[bool] = True
    #: Attributes that weigh rows, (k, ...): what factors multiply.
    weighs: ClassVar[tuple[str, ...]] = ("weights",)

    num_nodes: int
    edges: IntArray

    def __post_init__(self) -> None:
        require(self.num_nodes, Integral, "a number of nodes")
        object.__setattr__(self, "edges", frozen_indices(self.edges))
        k = len(self.edges)
        if self.edges.shape != (k, 2):
            raise GraphError(f"pairs of nodes are (k, 2), not {self.edges.shape}")
        check_edges(self.edges, self.num_nodes)
        for name in self._columns:
            if len(getattr(self, name)) != k:
                raise GraphError(f"{name} must have {k} rows, one per pair of nodes")
        self._check_values()

    def _check_values(self) -> None:
        """Refuse numbers that are not finite, and weights that are not positive."""
        for name in self._columns:
            values = np.asarray(getattr(self, name), dtype=np.float64)
            values = values.reshape(self.num_edges, math.prod(values.shape[1:]))
            is_weight = name in self.weighs and values.shape[1] == 1
            bad = ~np.isfinite(values).all(axis=1) | (is_weight & ~(values > 0.0).all(axis=1))
            if bad.any():
                wanted = "finite and positive" if is_weight else "finite"
                said = f"{name} must be {wanted}"
                raise GraphError(f"{edge_name(self.edges, np.asarray(bad))}: {said}")

    @classmethod
    def named(cls, name: str) -> type[Observations]:
        """The kind whose class has this name, the last one that is defined by now.

        Raises
        ------
        InputError
            There is none.
        """
        kinds = [*cls.__subclasses__()]
        for kind in kinds:
            kinds.extend(kind.__subclasses__())
        found = [kind for kind in kinds if kind.__name__ == name]
        if not found:
            raise InputError(f"measurements of the kind {name}: import what defines that first")
        return found[-1]

    @property
    def num_edges(self) -> int:
        """Number k of rows."""
        return len(self.edges)

    @property
    def kinds(self) -> IntArray:
        """(k,) what each row measures."""
        return np.full(self.num_edges, self.kind)

    @property
    def turned(self) -> IntArray:
        """The nodes whose rotations they hold, if only in part."""
        return np.zeros(0, dtype=np.intp)

    @property
    def num_measurements(self) -> int:
        """How many rows measure something."""
        return int(np.count_nonzero(self.kinds != Kind.PRODUCT))

    @property
    def columns(self) -> dict[str, Any]:
        """The attributes with a row each, but the pairs of nodes."""
        return {name: getattr(self, name) for name in self._columns}

    @property
    def _columns(self) -> list[str]:
        return [one.name for one in fields(self) if one.name not in ("num_nodes", "edges")]

    def subset(self, chosen: IntArray | BoolArray) -> Self:
        """The ``chosen`` rows, given by index or mask (k,)."""
        columns = {name: getattr(self, name)[chosen] for name in ("edges", *self._columns)}
        return replace(self, **columns)

    def between(self, nodes: IntArray) -> Self | None:
        """Those between some nodes (l,), numbered 0 ... l-1 in that order; None without any."""
        edges, inside = induced(self.num_nodes, self.edges, nodes)
        if not len(inside):
            return None
        return replace(self.subset(inside), num_nodes=len(nodes), edges=edges)

    def reweighted(self, factors: FloatArray) -> Self:
        """The rows with weights times factors (k,); one with factor 0 is removed."""
        factors = broadcast(factors, self.num_edges)
        chosen = self.subset(factors != 0.0)
        factors = factors[factors != 0.0]
        weighed: dict[str, Any] = {
            name: factors.reshape(-1, *[1] * (np.ndim(values) - 1)) * values
            for name in self.weighs
            for values in [getattr(chosen, name)]
        }
        return replace(chosen, **weighed)

    def scaled(self, factor: float) -> Self:
        """The same rows with weights times ``factor``."""
        return self.reweighted(np.full(self.num_edges, factor))

    @staticmethod
    def joined(
        num_nodes: int, parts: Sequence[Observations], nodes: Sequence[IntArray]
    ) -> Observations:
        """All rows of several of one kind, whose nodes have these numbers among all."""
        first = parts[0]
        columns = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in first._columns
        }
        edges = np.concatenate([to[part.edges] for part, to in zip(parts, nodes, strict=True)])
        return replace(first, num_nodes=num_nodes, edges=edges, **columns)
