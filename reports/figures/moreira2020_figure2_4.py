"""Moreira 2020, Figure 2.4: two pose graphs and their matrices of relative poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

POSES, BLOCK, SIGMA_DEG, SIGMA_M = 5, 4, 4.0, 0.05
#: The measured pairs: a cycle of all poses and one more.
MEASURED = ((0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (1, 3))
#: Singular values below this part of the largest are zero up to rounding.
ZERO = 1e-12


def compute(quick: bool, data: Path | None) -> Data:
    """The block matrix of all exact relative poses, and of the measured ones."""
    rng = _scenes.generator(0)
    turn = 2.0 * np.pi * np.arange(POSES) / POSES
    poses = _poses(
        so.exp(np.outer(turn, [0.0, 0.0, 1.0])),
        np.stack([np.cos(turn), np.sin(turn), 0.3 * np.cos(2.0 * turn)], axis=1),
    )
    exact = poses[:, None] @ np.linalg.inv(poses)[None]
    measured = np.zeros_like(exact)
    measured[range(POSES), range(POSES)] = np.eye(BLOCK)
    i, j = np.array(MEASURED).T
    noise = so.langevin(rng, np.radians(SIGMA_DEG) ** -2.0, len(i), 3)
    shift = SIGMA_M * rng.standard_normal((len(i), 3))
    measured[i, j] = _poses(noise @ exact[i, j, :3, :3], exact[i, j, :3, 3] + shift)
    measured[j, i] = np.linalg.inv(measured[i, j])
    complete = np.array([(a, b) for a in range(POSES) for b in range(a)])
    graphs = [_graph(complete, exact), _graph(np.array(MEASURED), measured)]
    return {
        "n": POSES,
        "positions": poses[:, :2, 3].tolist(),
        "sigma_deg": SIGMA_DEG,
        "sigma_m": SIGMA_M,
        "graphs": graphs,
        "ranks": [graph["rank"] for graph in graphs],
        "edges": [len(graph["edges"]) for graph in graphs],
    }


def _poses(R: FloatArray, t: FloatArray) -> FloatArray:
    """(k, 4, 4) homogeneous matrices."""
    poses = np.zeros((len(R), BLOCK, BLOCK))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = R, t, 1.0
    return poses


def _graph(edges: np.ndarray, blocks: FloatArray) -> Data:
    """Edges, the block matrix (4n, 4n), and its numerical rank."""
    matrix = blocks.swapaxes(1, 2).reshape(BLOCK * POSES, BLOCK * POSES)
    values = np.linalg.svd(matrix, compute_uv=False)
    return {
        "edges": edges.tolist(),
        "matrix": np.round(matrix, 4).tolist(),
        "singular_values": values.tolist(),
        "rank": int((values > ZERO * values[0]).sum()),
    }


def draw(figure, record: Data) -> None:
    """Each graph, and its matrix beside it."""
    figure.set_size_inches(_style.PAGE, 0.27 * _style.PAGE)
    panels = figure.subplots(1, 4)
    t = np.array(record["positions"])
    names = ("ground truth", "measured")
    for k, (graph, name) in enumerate(zip(record["graphs"], names, strict=True)):
        left, right = panels[2 * k : 2 * k + 2]
        for edge in graph["edges"]:
            left.plot(*t[edge].T, color=_style.GREY, linewidth=0.8)
        left.plot(*t.T, "o", color=_style.BLUE, markersize=9)
        for number, place in enumerate(t, start=1):
            left.text(*place, str(number), color="white", ha="center", va="center", fontsize=7)
        left.set_aspect("equal")
        left.set_axis_off()
        _style.panel(left, "ac"[k], name)
        matrix = np.array(graph["matrix"])
        empty = np.kron(
            np.abs(matrix).reshape(POSES, BLOCK, POSES, BLOCK).sum(axis=(1, 3)) == 0.0,
            np.ones((BLOCK, BLOCK)),
        )
        shown = np.where(empty, np.nan, matrix)
        right.imshow(shown, cmap="RdBu", vmin=-2.0, vmax=2.0, interpolation="none")
        for line in BLOCK * np.arange(1, POSES) - 0.5:
            right.axhline(line, color=_style.GREY, linewidth=0.3)
            right.axvline(line, color=_style.GREY, linewidth=0.3)
        right.set(xticks=(), yticks=())
        _style.panel(right, "bd"[k], f"rank {graph['rank']}")


def has_rank_4(record: Data) -> bool:
    """Whether the matrix of exact relative poses has as many singular values that are not zero."""
    return bool(record["ranks"][0] == BLOCK)


FIGURE = Figure(
    name="moreira2020_figure2_4",
    title="Pose graphs and their matrices of relative poses (Moreira 2020, Figure 2.4)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 2.4",
    compute=compute,
    draw=draw,
    caption=(
        "(a) A complete graph of {n} poses and (b) the matrix of its {edges[0]} exact relative "
        "poses in both directions, of rank {ranks[0]}. (c) {edges[1]} of them, measured with "
        "{sigma_deg:g} degrees and {sigma_m:g} m of noise, and (d) their matrix, white where "
        "nothing is measured, of rank {ranks[1]}."
    ),
    notes=(
        "The thesis draws the same, of poses that it does not give, and leaves the rank of (d) "
        "open.",
    ),
    claims=(
        Claim(
            "The matrix of the exact relative poses has rank 4",
            has_rank_4,
            "section 2.3.1, Figure 2.4",
        ),
    ),
)
