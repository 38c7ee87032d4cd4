"""Pose graphs whose distances have weights of either sign."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from certpgo.graph import Graph
from certpgo.graph.concatenate import joined_arms
from certpgo.objective.term import Term


def with_rows_of(graph: Graph, terms: Sequence[Term]) -> Graph:
    """The edges of a graph, and for each row of terms one that measures zero.

    Its tau is what W counts of the row, and may have either sign in surrogates.
    """
    k = sum(len(term.edges) for term in terms)

    # Products of nodes are none.
    measured = [np.sum(term.numbers, axis=0) > 0 for term in terms]

    def padded(values: Any) -> Any:
        more = () if values is None else ((0, k), *((0, 0),) * (values.ndim - 1))
        return None if values is None else np.pad(values, more)

    return Graph(
        nodes=graph.nodes,
        edges=np.concatenate([graph.edges, *(term.edges for term in terms)]),
        rotations=np.concatenate([graph.rotations, np.tile(np.eye(graph.d), (k, 1, 1))]),
        kappa=np.concatenate([graph.kappa, *(term.turning for term in terms)]),
        translations=padded(graph.translations),
        tau=np.concatenate([graph.tau, *(term.scale.move for term in terms)]),
        couplings=padded(graph.couplings),
        arms=joined_arms([graph, *terms], graph.d),
        scales=np.pad(graph.scales, (0, k), constant_values=1.0),
        assumed=~np.concatenate([graph.is_measured, *measured]),
        absolute=padded(graph.absolute),
        is_signed=True,
    )
