"""Eriksson et al. 2018, Figure 2: a complete graph and a cycle, with what their bounds allow."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo.certify.bounds import alpha_max
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure

from . import _style

#: Vertices of the graphs.
N = 6


def compute(quick: bool, data: Path | None) -> Data:
    """Edges of both graphs, and the angles of Theorem 4.1 and Theorem 4.2."""
    graphs = {
        "complete": np.argwhere(np.tri(N, k=-1).T),
        "cycle": np.stack([np.arange(N), (np.arange(N) + 1) % N], axis=1),
    }
    record: Data = {"n": N, "cycle_bound_deg": 180.0 / N}
    for name, edges in graphs.items():
        A = np.zeros((N, N))
        A[tuple(edges.T)] = 1.0
        A += A.T
        degrees = A.sum(axis=1)
        fiedler = float(np.linalg.eigvalsh(np.diag(degrees) - A)[1])
        bound = float(np.degrees(alpha_max(fiedler / degrees.max())))
        record[name] = {"edges": edges.tolist(), "fiedler": fiedler, "alpha_max_deg": bound}
    return record


def draw(figure, record: Data) -> None:
    """Both graphs, their vertices on a circle."""
    figure.set_size_inches(_style.COLUMN, 0.55 * _style.COLUMN)
    turn = 2.0 * np.pi * np.arange(record["n"]) / record["n"] + np.pi / 2.0
    x, y = np.cos(turn), np.sin(turn)
    for axes, letter, name in zip(figure.subplots(1, 2), "ab", ("complete", "cycle"), strict=True):
        for i, j in record[name]["edges"]:
            axes.plot(x[[i, j]], y[[i, j]], color=_style.BLUE, linewidth=0.8)
        axes.plot(x, y, "o", color=_style.BLACK, markersize=5)
        axes.set(aspect="equal", xlim=(-1.2, 1.2), ylim=(-1.2, 1.2))
        axes.set_axis_off()
        _style.panel(axes, letter, f"{record[name]['alpha_max_deg']:.1f} deg")


FIGURE = Figure(
    name="eriksson2018_figure2",
    title="A complete graph and a cycle graph (Eriksson et al. 2018, Figure 2)",
    source="A. Eriksson et al., Rotation Averaging and Strong Duality, 2018, Figure 2",
    compute=compute,
    draw=draw,
    caption="Graphs of {n} vertices, and the largest residual for which Theorem 4.1 guarantees the "
    "optimum: {complete[alpha_max_deg]:.1f} degrees for the complete graph and "
    "{cycle[alpha_max_deg]:.1f} for the cycle, of which Theorem 4.2 allows {cycle_bound_deg:.1f}.",
    claims=(
        Claim(
            "For complete graphs the bound is above 42.9 degrees, whatever their size (of 6)",
            lambda record: record["complete"]["alpha_max_deg"] >= 42.9,
            "section 4.1, Corollary 4.1",
        ),
        Claim(
            "For cycles Theorem 4.1 is conservative: Theorem 4.2 allows more",
            lambda record: record["cycle"]["alpha_max_deg"] < record["cycle_bound_deg"],
            "section 4.1",
        ),
    ),
)
