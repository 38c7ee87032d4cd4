"""Viewing graphs as MATLAB files: one square sparse 0/1 adjacency matrix, no rotations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Instance, RotationGraph
from certpgo.io.format import Format, ReadOptions
from certpgo.linalg.arrays import IntArray


def _recognises(path: Path, head: bytes) -> bool:
    return head.startswith(b"MATLAB 5.0 MAT-file")


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
        options={"rotation_information": options.rotation_information or "tangent"},
        notices=("only the topology is in the file: every rotation is the identity, kappa = 1",),
    )


def _adjacency(path: Path) -> tuple[int, IntArray]:
    """Number of nodes, and the edges (m, 2) with i < j."""
    from scipy import io, sparse

    try:
        variables = io.loadmat(path)
    except Exception:  # a broken file makes SciPy's reader raise nearly anything
        raise FormatError(path, None, "not a readable MATLAB 5 file") from None
    matrices = [value for name, value in variables.items() if not name.startswith("__")]
    if len(matrices) != 1 or not sparse.issparse(matrices[0]):
        raise FormatError(path, None, "one sparse adjacency matrix expected")
    A = sparse.coo_array(matrices[0])
    if A.shape[0] != A.shape[1]:
        raise FormatError(path, None, f"a square adjacency matrix expected, not {A.shape}")
    rows, columns = A.coords
    pairs = np.sort(np.stack([rows, columns], axis=-1).astype(np.intp)[A.data != 0], axis=1)
    return A.shape[0], np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)


FORMAT = Format(
    name="viewing_graph",
    suffixes=(".mat",),
    recognises=_recognises,
    holds="the topology of a graph",
    read_graph=_read_graph,
)
