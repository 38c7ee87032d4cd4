"""Viewing graphs in MATLAB files: one square sparse 0/1 adjacency matrix, no rotations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance, RotationGraph
from certpgo.io.format import Format, ReadOptions
from certpgo.io.matlab import SIGNATURE, sparse_pattern
from certpgo.io.nodes import distinct
from certpgo.linalg.arrays import IntArray


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith(SIGNATURE)


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    n, edges = _adjacency(path)
    if not len(edges):
        raise FormatError(path, None, "no edges")
    identities = np.tile(np.eye(3), (len(edges), 1, 1))
    return Instance(
        name=path.stem,
        graph=RotationGraph(n, edges, identities, np.ones(len(edges))),
        ids=np.arange(n),
        source=str(path),
        options={"information": "none"},
        notices=("the file has only the topology: every rotation is the identity, kappa = 1",),
    )


def _adjacency(path: Path) -> tuple[int, IntArray]:
    """Number of nodes, and the edges (m, 2) with i < j."""
    shape, rows, columns = sparse_pattern(path)
    if shape[0] != shape[1]:
        raise FormatError(path, None, f"a square adjacency matrix expected, not {shape}")
    n, apart = shape[0], rows != columns
    codes = (np.minimum(rows, columns) * n + np.maximum(rows, columns))[apart]
    return n, np.stack(np.divmod(distinct(codes), max(n, 1)), axis=-1)


FORMAT = Format(
    name="viewing_graph",
    suffixes=(".mat",),
    recognises=_recognises,
    holds="the topology of a graph",
    read_graph=_read_graph,
)
