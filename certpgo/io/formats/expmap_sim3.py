"""g2o's similarities: VERTEX_SIM3:EXPMAP and EDGE_SIM3:EXPMAP, as of ORB-SLAM's essential graph.

    VERTEX_SIM3:EXPMAP id wx wy wz ux uy uz sigma [fx fy cx cy]
    EDGE_SIM3:EXPMAP i j wx wy wz ux uy uz sigma [28 numbers]
    FIX id ...

g2o has these similarities world to camera, and measures S_j S_i^-1, but writes and reads the
logarithm of the inverse of both (g2o/types/sim3/types_seven_dof_expmap.cpp): in a file they are
camera to world, and the measurement is that of node j in the frame of node i. The logarithm is
[omega, upsilon, sigma], see `certpgo.linalg.similarities`; the numbers of the camera are kept.
The information has rotation, translation and scale in this order, and weighs the logarithm, in the
unit of camera j: it is used for the weights kappa and tau alone, in the unit of the map. The fixed
node with the smallest id, or else the smallest id, has the scale 1.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Instance
from certpgo.graph.keys import Keys
from certpgo.io.build_graph import instance_from_lines, poses_from_lines
from certpgo.io.dialect import Dialect, Poses, Tag, first_tags
from certpgo.io.exact.information import InformationLayout
from certpgo.io.format import Format
from certpgo.io.lines import FARTHEST
from certpgo.linalg import similarities
from certpgo.linalg.arrays import FloatArray, IntArray

_VERTEX, _EDGE = b"VERTEX_SIM3:EXPMAP", b"EDGE_SIM3:EXPMAP"
_READ = (
    "measurement{s} of similarities, whose information is about logarithms: used for kappa and tau "
    "alone, in the unit of the map"
)
#: Of rows of the translation, then of the rotation, in the upper triangle (7, 7).
_UPPER = np.zeros((7, 7), dtype=int)
_UPPER[np.triu_indices(7)] = np.arange(28)
_UPPER = np.maximum(_UPPER, _UPPER.T)
_ROWS = [3, 4, 5, 0, 1, 2]
_LAYOUT = InformationLayout(
    tuple(tuple(_UPPER[i, _ROWS].tolist()) for i in _ROWS),
    28,
)
#: Focal lengths and centre of a camera that is not known.
_NO_CAMERA = (1, 1, 0, 0)
#: Largest component of a rotation vector, radians: of larger ones the doubles leave no angle.
_LARGEST_TURN = 1e9
#: Largest logarithm of a scale.
_FARTHEST = 69.0


def _poses(d: int, numbers: FloatArray) -> Poses:
    far = np.abs(numbers[:, :6]) > np.repeat([_LARGEST_TURN, FARTHEST], 3)
    if far.any():
        said = f"rotation vectors up to {_LARGEST_TURN:.0e} and translations up to {FARTHEST:.0e}"
        raise InputError(f"{said} expected, not {numbers[:, :6][far][0]:g}")
    _scales(numbers)  # which refuses those that are out of range
    R, t, _ = similarities.exp(numbers)
    return R, t, 0


def _scales(numbers: FloatArray) -> FloatArray:
    sigma = numbers[:, 6]
    if (np.abs(sigma) > _FARTHEST).any():
        far = sigma[np.argmax(np.abs(sigma))]
        raise InputError(f"logarithms of scales within {_FARTHEST:g} expected, not {far:g}")
    return np.asarray(np.exp(sigma))


DIALECT = Dialect(
    name="g2o (SIM3)",
    tags={
        _VERTEX: Tag("pose", 3, 7, more=4),
        _EDGE: Tag("edge", 3, 7, _READ),
        b"FIX": Tag("fix"),
    },
    poses=_poses,
    scales=_scales,
    layouts={3: _LAYOUT},
    isotropic=True,
)


def _recognises(path: Path, head: bytes) -> bool:
    return bool(first_tags(head) & {_VERTEX, _EDGE})


def vertex_lines(ids: IntArray, estimate: Estimate, camera: tuple[float, ...]) -> list[str]:
    """The lines of an estimate with scales; those of points are refused by an InputError."""
    if estimate.d != 3 or estimate.translations is None or estimate.scales is None:
        raise InputError("g2o has similarities in space alone, with translations")
    rows = similarities.log(estimate.rotations, estimate.translations, estimate.scales).tolist()
    return [
        f"{_VERTEX.decode()} {k} {_text(row)} {_text(list(camera or _NO_CAMERA))}\n"
        for k, row in zip(ids.tolist(), rows, strict=True)
    ]


def _text(row: list[float]) -> str:
    return " ".join(map(repr, row))


def write_poses(path: Path, estimate: Estimate, keys: Keys) -> None:
    """Write an estimate with scales.

    Raises
    ------
    InputError
        It is planar, or has no translations, or there are points.
    """
    n = estimate.num_nodes
    if keys.is_point(n).any():
        raise InputError("g2o has no points seen by similarities")
    lines = vertex_lines(keys.ids_of(n), estimate, keys.camera)
    path.write_text("".join(lines), encoding="ascii")


def write_graph(path: Path, instance: Instance) -> None:
    """Write a graph of similarities with its initial values; its unit is fixed.

    Raises
    ------
    InputError
        It is planar, has points or a world, or no pose or several poses of known scale.
    """
    graph = instance.graph
    if not graph.has_scales or graph.d != 3:
        raise InputError("g2o has similarities in space alone: .npz files hold those of the plane")
    if graph.in_mean_unit:
        raise InputError(
            "g2o's similarities have one known scale: .npz files hold maps without any"
        )
    [*others, unit] = np.flatnonzero(~graph.free)[::-1].tolist()
    if others or instance.world is not None or graph.is_partial:
        said = "g2o's similarities all have an unknown scale, and no points"
        raise InputError(f"{said}: .npz files hold others")
    if instance.fixed and min(instance.fixed) != unit:
        said = "whose scale is 1 is not the one with the smallest id of those that are fixed"
        raise InputError(f"node {instance.ids[unit]} {said}: .npz files hold such graphs")
    lines, values = [], _scaled(instance)
    if values is not None:
        lines = vertex_lines(instance.ids, values, instance.camera)
    lines += [f"FIX {instance.ids[k]}\n" for k in instance.fixed or (unit,)]
    measured = similarities.log(graph.rotations, graph.translations, graph.scales)
    kappa, tau = graph.kappa.tolist(), graph.tau.tolist()
    ends = instance.ids[graph.edges].tolist()
    for (i, j), row, k, w in zip(ends, measured.tolist(), kappa, tau, strict=True):
        lines.append(f"{_EDGE.decode()} {i} {j} {_text(row)} {_information(k, w)}\n")
    path.write_text("".join(lines), encoding="ascii")


def _scaled(instance: Instance) -> Estimate | None:
    """The initial values, with scales of 1 where they have none."""
    found = instance.initial
    if found is None or found.scales is not None:
        return found
    return Estimate(found.rotations, found.translations, found.keys, np.ones(found.num_nodes))


def _information(kappa: float, tau: float) -> str:
    """The upper triangle of an isotropic matrix, so that reading it returns kappa and tau."""
    # |A_j - A_i S|^2 is 2 |omega|^2 + 3 sigma^2 for small logarithms.
    diagonal = [repr(2.0 * kappa)] * 3 + [repr(tau)] * 3 + [repr(3.0 * kappa)]
    rows = ([diagonal[k], *["0"] * (6 - k)] for k in range(7))
    return " ".join(word for row in rows for word in row)


FORMAT = Format(
    name="sim3",
    suffixes=(),
    recognises=_recognises,
    holds="similarities and measurements",
    read_graph=partial(instance_from_lines, DIALECT),
    joins_files=True,
    read_poses=partial(poses_from_lines, DIALECT),
)
