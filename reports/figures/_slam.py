"""The SLAM sets of Appendix C: the thesis' reading of them, and its method on them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from certpgo import Quadratic
from certpgo.graph import Graph
from certpgo.optimize.methods.eigen_ma import EigenMA
from certpgo.optimize.solution import Solver
from certpgo.solve import metrics
from reports.harness.experiments.figure import Data

from . import _maps, _scenes, _style

#: As the thesis calls them, read so that EigenMA gives the digits of its Table 5.7.
SETS = {
    "parking-garage": ("Garage", {}),
    "cubicle": ("Cubicle", {"keep": "last"}),
    "sphere_bignoise_vertex3": ("Sphere", {}),
    "torus3D": ("Torus3D", {}),
}
LEFT_OUT = "The thesis also has Grid3D and Rim, which are not here."


class Entry(NamedTuple):
    """A set: its problem, all its edges, and EigenMA as the thesis has it there."""

    name: str
    problem: Quadratic
    graph: Graph
    method: EigenMA


def problems(quick: bool, data: Path | None) -> Iterator[Entry]:
    """The sets that are here, every edge weighing 1.

    Raises
    ------
    InputError
        None is here.
    """
    names = _scenes.here(tuple(SETS), data)
    for name in names[:1] if quick else names:
        title, reading = SETS[name]
        complete = _scenes.load(name, data, unit_weights=True).graph
        simple = _scenes.load(name, data, unit_weights=True, **reading).graph
        method = EigenMA(translations="thesis", anchor="first", tol=1e-10)
        yield Entry(title, Quadratic(simple), complete, method)


def maps(key: str, method: Callable[[Entry], Solver], quick: bool, data: Path | None) -> Data:
    """Positions of a method's answers, kept as ``key``, with closures and f_ML, set by set."""
    sets = []
    for entry in problems(quick, data):
        answer = method(entry).solve(entry.problem).estimate
        sets.append(
            {
                "name": entry.name,
                "n": entry.problem.n,
                "m": entry.problem.graph.num_edges,
                "f_ml": metrics.f_ml(entry.graph, answer),
                key: _maps.positions(answer),
                "closures": _maps.closures(entry.problem.graph),
            }
        )
    values = ", ".join(f"{entry['f_ml']:.1f} on {entry['name']}" for entry in sets)
    return {"sets": sets, "values": values}


def draw(figure, record: Data, lines: dict[str, tuple[str, str]]) -> None:
    """A panel a set: its closures, if it has them, and trajectories, by name: (label, colour)."""
    rows = (len(record["sets"]) + 1) // 2
    figure.set_size_inches(_style.PAGE, 0.33 * _style.PAGE * rows)
    panels = figure.subplots(rows, 2, squeeze=False).ravel()
    for axes, letter, entry in zip(panels, "abcdef", record["sets"], strict=False):
        _maps.draw_map(
            axes,
            [entry[name] for name in lines],
            entry.get("closures", ()),
            colours=[colour for _, colour in lines.values()],
            widths=(1.0, 0.4) if len(lines) > 1 else (0.5,),
        )
        _style.panel(axes, letter, f"{entry['name']} (n = {entry['n']})")
    for axes in panels[len(record["sets"]) :]:
        axes.set_axis_off()
    if len(lines) > 1:
        _style.key(figure, dict(lines.values()))
