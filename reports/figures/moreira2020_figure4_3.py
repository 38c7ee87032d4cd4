"""Moreira 2020, Figure 4.3: Notre Dame's adjacency matrix, with a dense region and a sparse one."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

#: Cameras of the dense region, section 4.5.
DENSE = 300


def compute(quick: bool, data: Path | None) -> Data:
    """The adjacency matrix, cameras by their number of measurements, its rows in hexadecimal."""
    graph = _scenes.load(_scenes.NOTRE_DAME, data).graph
    n, (i, j) = graph.num_nodes, graph.edges.T
    A = np.zeros((n, n), dtype=bool)
    A[i, j] = A[j, i] = True
    degrees = A.sum(axis=1)
    order = np.argsort(-degrees, kind="stable")
    A = A[np.ix_(order, order)]
    inside, across, outside = A[:DENSE, :DENSE], A[:DENSE, DENSE:], A[DENSE:, DENSE:]
    return {
        "n": n,
        "m": graph.num_edges,
        "dense": DENSE,
        "rows": [row.tobytes().hex() for row in np.packbits(A, axis=1)],
        "degrees": degrees[order].tolist(),
        "least_degree": int(degrees.min()),
        "inside_percent": 100.0 * inside.sum() / (DENSE * (DENSE - 1)),
        "across_percent": 100.0 * across.mean(),
        "outside_percent": 100.0 * outside.sum() / (len(outside) * (len(outside) - 1)),
    }


def draw(figure, record: Data) -> None:
    """The matrix, and the number of measurements of each camera."""
    figure.set_size_inches(_style.PAGE, 0.47 * _style.PAGE)
    left, right = figure.subplots(1, 2)
    packed = np.array([list(bytes.fromhex(row)) for row in record["rows"]], dtype=np.uint8)
    A = np.unpackbits(packed, axis=1)[:, : record["n"]]
    left.imshow(A, cmap="cividis", interpolation="none")
    edge = record["dense"] - 0.5
    left.plot([-0.5, edge, edge], [edge, edge, -0.5], color=_style.VERMILION, linewidth=0.8)
    left.set(xlabel="camera, by degree", ylabel="camera, by degree")
    _style.panel(left, "a", "which pairs are measured")
    right.plot(record["degrees"], color=_style.BLUE)
    right.axvline(edge, color=_style.VERMILION, linewidth=0.8)
    right.set(xlabel="camera, by degree", ylabel="measurements of the camera", ylim=(0, None))
    _style.panel(right, "b")


def has_two_regions(record: Data) -> bool:
    """Whether nine tenths of the pairs of one region are measured, and a third of the other's."""
    return bool(record["inside_percent"] >= 90.0 and record["outside_percent"] <= 100.0 / 3.0)


FIGURE = Figure(
    name="moreira2020_figure4_3",
    title="Which pairs of Notre Dame's cameras are measured (Moreira 2020, Figure 4.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 4.3",
    compute=compute,
    draw=draw,
    caption=(
        "(a) The {m} measured pairs of {n} cameras (light), by the number of their measurements, "
        "which (b) shows. Of the pairs among the first {dense} {inside_percent:.3g} percent are "
        "measured, among the others {outside_percent:.3g}, across {across_percent:.3g}; every "
        "camera has {least_degree} measurements or more."
    ),
    notes=(
        "The thesis shows a photograph beside the matrix, which is not here, and does not say how "
        "its cameras are ordered; in the order of the public file no region is denser.",
    ),
    claims=(
        Claim(
            "The graph has a very densely connected region, of 300 cameras, and a sparsely "
            "connected one: at least 90 % of the pairs and at most a third",
            has_two_regions,
            "section 4.5, Figure 4.3",
        ),
    ),
)
