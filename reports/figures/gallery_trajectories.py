"""Trajectories of real sets: as they begin, and at the certified optimum."""

from __future__ import annotations

from pathlib import Path

from certpgo import solve
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.spanning_tree import SpanningTree
from certpgo.solve import metrics
from certpgo.view.load_scene import scene_of
from certpgo.view.page_scene import page_scene
from reports.harness.experiments.figure import VIEWS, Data, Figure

from . import _maps, _scenes, _style

SETS = ("sphere2500", "parking-garage", "torus3D")
#: Those that the report shows as views to turn, and edges drawn there.
TURNED, EDGES = ("sphere2500", "parking-garage"), 5000


def compute(quick: bool, data: Path | None) -> Data:
    """Positions before and after, set by set."""
    sets, views = [], []
    names = _scenes.here(SETS, data)
    for name in names[:1] if quick else names:
        instance = _scenes.load(name, data)
        problem = Quadratic(instance.graph)
        before, source = instance.initial, "the file's initial values"
        if before is None:
            before, source = SpanningTree().solve(problem).estimate, "a spanning tree"
        best = solve(problem)
        sets.append(
            {
                "name": name,
                "n": problem.n,
                "m": instance.graph.num_edges,
                "source": source,
                "verdict": best.verdict.value,
                "cost_before": problem.cost(before),
                "cost": best.cost,
                "lower_bound": best.certificate.lower_bound,
                "before": _maps.positions(metrics.align_positions(before, best.estimate)),
                "after": _maps.positions(best.estimate),
                "closures": _maps.closures(instance.graph),
            }
        )
        if name in TURNED:
            drawn = scene_of(instance, best)
            shown = page_scene(drawn, problem.edge_costs(best.estimate), limit=EDGES)
            if (distance := best.certificate.stated_distance()) is not None:
                shown["sentences"].append(distance.sentence(instance.named))
            title = f"{name}: the certified optimum, edges by residual"
            views.append({"title": title, "scene": shown})
    return {
        "sets": sets,
        VIEWS: views,
        "values": "; ".join(
            f"{s['name']} from F = {s['cost_before']:.4g} ({s['source']}) to {s['cost']:.7g} "
            f"({s['verdict']})"
            for s in sets
        ),
    }


def draw(figure, record: Data) -> None:
    """A column a set, before above after, seen from the same side."""
    sets = record["sets"]
    figure.set_size_inches(_style.PAGE * len(sets) / len(SETS), 0.56 * _style.PAGE)
    panels = figure.subplots(2, len(sets), squeeze=False)
    rows = (("before", _style.VERMILION, 0.3), ("after", _style.BLUE, 0.5))
    letters = iter("abcdef")
    for row, (key, colour, width) in zip(panels, rows, strict=True):
        for axes, entry in zip(row, sets, strict=True):
            _maps.draw_map(
                axes,
                [entry[key]],
                entry["closures"] if key == "after" else (),
                colours=(colour,),
                widths=(width,),
                like=entry["after"],
            )
            _style.panel(axes, next(letters), f"{entry['name']}, {key}")


FIGURE = Figure(
    name="gallery_trajectories",
    title="Before and after: initial values and certified optima",
    source="the data sets, see `certpgo list`",
    compute=compute,
    draw=draw,
    caption="Trajectories, and in the lower row loop closures (grey): {values}.",
)
