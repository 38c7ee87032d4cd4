"""A monocular drive whose scale drifts: odometry, and maps that do and do not ask for the scale."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo import Estimate, fit_logarithms, solve
from certpgo.io.datasets.monocular import drifting, in_one_unit, keyframes, odometry
from certpgo.solve import metrics
from reports.harness.experiments.figure import Data, Figure

from . import _maps, _scenes, _style

SET, WALK = "kitti_00", 0.02
#: Of how many poses one is a keyframe.
EVERY, QUICK_EVERY = 10, 20
#: The maps: what they are called, and the colours of their lines.
MAPS = {
    "odometry": ("odometry", _style.VERMILION),
    "poses": ("one unit for all", _style.ORANGE),
    "similarities": ("scales, $F$", _style.GREEN),
    "logarithms": ("scales, logarithms", _style.BLUE),
}


def compute(quick: bool, data: Path | None) -> Data:
    """Maps of the same measurements, placed on the truth, with errors, verdicts and scales."""
    instance = _scenes.load(SET, data)
    every = QUICK_EVERY if quick else EVERY
    truth, loops = keyframes(solve(instance).estimate, instance.graph.edges, every)
    graph, scaled = drifting(truth, loops, np.random.default_rng(0), walk=WALK)
    poses, similarities, fit = solve(in_one_unit(graph)), solve(graph), fit_logarithms(graph)
    placed = {
        name: metrics.align_positions(found, truth, scaled=True)
        for name, found in (
            ("odometry", odometry(graph)),
            ("poses", poses.estimate),
            ("similarities", similarities.estimate),
            ("logarithms", fit.estimate),
        )
    }
    steps = np.linalg.norm(np.diff(truth.translations, axis=0), axis=1)
    return {
        "n": graph.num_nodes,
        "loops": len(loops),
        "walk": WALK,
        "closures": loops.tolist(),
        "truth": _from_above(truth),
        "maps": {name: _from_above(found) for name, found in placed.items()},
        "error": {name: metrics.position_errors(x, truth).rmse for name, x in placed.items()},
        "driven_km": np.r_[0.0, np.cumsum(steps) / 1e3].round(3).tolist(),
        "true_scales": scaled.scales.round(4).tolist(),
        "scales": {
            name: placed[name].scales.round(4).tolist() for name in ("similarities", "logarithms")
        },
        "verdict": {"poses": poses.verdict.value, "similarities": similarities.verdict.value},
        "cost": fit.cost,
        "lower_bound": fit.lower_bound(1.0),
    }


def _from_above(estimate: Estimate) -> list[list[float]]:
    return np.round(estimate.translations[:, :2], 1).tolist()


def draw(figure, record: Data) -> None:
    """The maps over the truth, in a row, and the scales of their frames below."""
    figure.set_size_inches(_style.PAGE, 0.48 * _style.PAGE)
    panels = figure.subplot_mosaic([list(MAPS), ["scales"] * 4], height_ratios=(1.0, 0.6))
    everything = np.concatenate([record["truth"], *record["maps"].values()])
    (left, low), (right, high) = everything.min(axis=0), everything.max(axis=0)
    room = 0.1 * (high - low)  # for the bars
    for letter, (name, (title, colour)) in zip("abcd", MAPS.items(), strict=True):
        axes = panels[name]
        _maps.draw_map(
            axes,
            [record["maps"][name], record["truth"]],
            record["closures"],
            colours=(colour, _style.BLACK),
            widths=(1.2, 0.4),
        )
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(left, right), ylim=(low - room, high + 0.2 * room))
        _style.panel(axes, letter, f"{title}: {record['error'][name]:.1f} m")
    axes, driven = panels["scales"], record["driven_km"]
    axes.plot(driven, record["true_scales"], color=_style.BLACK, linewidth=0.6, label="truth")
    for name, scales in record["scales"].items():
        title, colour = MAPS[name]
        axes.plot(driven, scales, color=colour, label=title)
    axes.set(xlabel="driven, km", ylabel="unit of a frame, m", xlim=(0.0, driven[-1]))
    axes.legend()
    _style.panel(axes, "e", "the units of the frames, after alignment")


FIGURE = Figure(
    name="gallery_scale_drift",
    title="Scale drift: a monocular drive, before and after",
    source="kitti_00, see `certpgo list`",
    compute=compute,
    draw=draw,
    caption=(
        "Monocular odometry whose scale drifts by {walk:.0%} a keyframe, and loop closures (grey) "
        "that measure scales: {n} keyframes of kitti_00, {loops} loops, the truth in black. Errors "
        "of positions are root mean squares after the best similarity: odometry "
        "{error[odometry]:.1f} m; ordinary poses in one unit {error[poses]:.1f} m "
        "({verdict[poses]}); unknown scales by F {error[similarities]:.1f} m "
        "({verdict[similarities]}), by the cost of logarithms {error[logarithms]:.1f} m. The last "
        "map costs {cost:.1f}, and every map with its scales at least {lower_bound:.1f}."
    ),
)
