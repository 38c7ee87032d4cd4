"""Moreira 2020, Figure C.3: trajectories of EIG-SE(3) and the loop closures."""

from __future__ import annotations

from pathlib import Path

from certpgo.registry import get_solver
from reports.harness.experiments.figure import Data, Figure

from . import _slam, _style


def compute(quick: bool, data: Path | None) -> Data:
    """EIG-SE(3)'s positions, set by set."""
    return _slam.maps("eig_se3", lambda _: get_solver("eig_se3")(), quick, data)


def draw(figure, record: Data) -> None:
    """Trajectories over loop closures."""
    _slam.draw(figure, record, {"eig_se3": ("EIG-SE(3)", _style.VERMILION)})


FIGURE = Figure(
    name="moreira2020_figureC_3",
    title="Trajectories of EIG-SE(3) and loop closures (Moreira 2020, Figure C.3)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure C.3",
    compute=compute,
    draw=draw,
    caption="EIG-SE(3) (red) over the loop closures (grey); f_ML is {values}.",
    notes=(
        _slam.LEFT_OUT,
        "The thesis' Garage and Cubicle are worse: see the notes of Table 5.7 for what its "
        "eigenvectors can have been.",
    ),
)
