"""Moreira 2020, Figure C.1: trajectories of EigenMA and the loop closures."""

from __future__ import annotations

from pathlib import Path

from reports.harness.experiments.figure import Data, Figure

from . import _slam, _style


def compute(quick: bool, data: Path | None) -> Data:
    """EigenMA's positions, set by set."""
    return _slam.maps("eigen_ma", lambda entry: entry.method, quick, data)


def draw(figure, record: Data) -> None:
    """Trajectories over loop closures."""
    _slam.draw(figure, record, {"eigen_ma": ("EigenMA", _style.BLUE)})


FIGURE = Figure(
    name="moreira2020_figureC_1",
    title="Trajectories of EigenMA and loop closures (Moreira 2020, Figure C.1)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure C.1",
    compute=compute,
    draw=draw,
    caption="EigenMA (blue) over the loop closures (grey); f_ML is {values}.",
    notes=(_slam.LEFT_OUT, "Of parallel edges of Cubicle the last counts; f_ML has all of them."),
)
