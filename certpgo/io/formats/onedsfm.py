"""1DSfM scenes (Wilson and Snavely 2014): a folder with EGs.txt, or that file.

    EGs.txt     i j R_ij row by row t_ij, R_ij = R_i R_j^T with R_i world to camera
    cc.txt      the ids of the component to keep
    gt_rots.txt, rots.txt, gt_bundle.out      ground truth

With our R_i (camera to world) the same matrix is R_i^T R_j. t_ij is a direction only.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from certpgo.errors import FormatError
from certpgo.graph import Estimate, Instance, RotationGraph
from certpgo.graph.phrases import counted
from certpgo.io.chunks import first_row, read_rows, refuse_loops, whole
from certpgo.io.exact import quaternion
from certpgo.io.format import Format, ReadOptions, format_of
from certpgo.io.matching import Matching, known_poses, match
from certpgo.io.nodes import distinct
from certpgo.linalg.arrays import FloatArray, IntArray, numbered

_GRAPH, _COMPONENT = "EGs.txt", "cc.txt"
_TRUTH = ("gt_rots.txt", "rots.txt", "gt_bundle.out")
_EXPECTED = "i j, 9 numbers of R_ij row by row, 3 of t_ij"


def _recognises(path: Path, head: bytes) -> bool:
    if path.is_dir():
        return (path / _GRAPH).is_file()
    row = first_row(head)
    return len(row) == 14 and row[0].is_integer() and row[1].is_integer()


def _read_graph(path: Path, options: ReadOptions) -> Instance:
    file = path / _GRAPH if path.is_dir() else path
    numbers, R = read_rows(file, 14, _EXPECTED, _convert, options.progress)
    pairs = numbers.astype(np.intp)
    notices = ["no weights in the file: kappa = 1", "translation directions are ignored"]
    ids = distinct(pairs.ravel())
    component = file.with_name(_COMPONENT)
    if file.name == _GRAPH and component.is_file():
        ids = _component(component)
        kept = (numbered(ids, pairs) >= 0).all(axis=1)
        if not kept.any():
            raise FormatError(component, None, f"no edge of {file.name} lies in the component")
        if not kept.all():
            outside = f"edge{{s}} outside the component of {_COMPONENT} ignored"
            notices.append(counted(int(np.sum(~kept)), outside))
        pairs, R = pairs[kept], R[kept]
    graph = RotationGraph(len(ids), numbered(ids, pairs), R, np.ones(len(pairs)))
    instance = Instance(
        name=path.name if path.is_dir() else _name(path),
        graph=graph,
        ids=ids,
        source=str(path),
        options={"weights": "unit", "information": "none"},
    )
    truth, more = _truth(file, instance)
    return replace(instance, truth=truth, notices=(*notices, *more))


def _name(path: Path) -> str:
    return path.resolve().parent.name if path.name == _GRAPH else path.stem


def _convert(rows: FloatArray) -> tuple[FloatArray, ...]:
    pairs = whole(rows[:, :2])
    refuse_loops(pairs)
    return pairs, quaternion.rotations(quaternion.from_matrices(rows[:, 2:11].reshape(-1, 3, 3)))


def _component(path: Path) -> IntArray:
    (numbers,) = read_rows(path, 1, "a node id", lambda rows: (whole(rows[:, 0]),))
    return distinct(numbers.astype(np.intp))


def _truth(file: Path, instance: Instance) -> tuple[Estimate | None, tuple[str, ...]]:
    """The scene's truth, if it covers every node; else a notice of how many it covers."""
    for path in (file.with_name(name) for name in _TRUTH if file.name == _GRAPH):
        if not path.is_file():
            continue
        read_poses = format_of(path).read_poses
        if read_poses is None:
            raise FormatError(path, None, "ground-truth rotations expected")
        poses = read_poses(path)
        nodes, estimate = known_poses(poses, instance, match(poses, instance, Matching()))
        n = instance.graph.num_nodes
        if len(nodes) == n:
            return estimate, ()
        return None, (
            f"truth for {len(nodes)} of {n} nodes in {path.name}: certpgo.io.read_truth reads them",
        )
    return None, ()


FORMAT = Format(
    name="1dsfm",
    suffixes=(),
    recognises=_recognises,
    holds="relative rotations",
    read_graph=_read_graph,
)
