"""Scenes as pictures, by Matplotlib, which is imported on first use: `certpgo.plot.trajectory`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from certpgo.errors import InputError, MissingDependency, kind_of
from certpgo.graph import Estimate, Instance
from certpgo.graph.kinds import PRIORS
from certpgo.graph.phrases import in_utf8
from certpgo.graph.picture import principal_frame, seen
from certpgo.io.surfaces import Surface
from certpgo.linalg.arrays import FloatArray, round_below
from certpgo.solve.result import CertifiedSolution
from certpgo.view.load_scene import scene_of
from certpgo.view.scene import Placement, Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Of what is in the background, of rejected measurements, and of landmarks.
GREY, RED, ORANGE = "0.6", "#dc322f", "#d55e00"
#: Points of a cloud drawn at most.
CLOUD = 100_000
#: Width and height of a picture, inches, and its dots per inch.
SIZE, DOTS = (8.0, 6.0), 160


def given_or_current(ax: Axes | None) -> Axes:
    """The axes, or the current ones of pyplot.

    Raises
    ------
    MissingDependency
        Matplotlib is not installed.
    """
    if ax is not None:
        return ax
    try:
        import matplotlib.pyplot as plt
    except ImportError:
        raise _missing() from None
    return plt.gca()


def _missing() -> MissingDependency:
    return MissingDependency("matplotlib, which draws plots,", "plots")


def trajectory(
    of: CertifiedSolution | Estimate | Instance,
    *,
    truth: Estimate | None = None,
    ax: Axes | None = None,
    **line: Any,
) -> Axes:
    """Draw a trajectory through poses in their order, over the loop closures of an answer.

    Planar poses are drawn on x and y; others as seen on the plane they lie nearest to, with
    a scale bar.

    Parameters
    ----------
    of : an answer of `certpgo.solve`, an estimate, or an instance: its truth, or initial values
    truth : drawn in grey, aligned; by default that of an answer's instance
    ax : axes to draw on; by default the current ones
    **line : options of ``ax.plot``

    Returns
    -------
    The axes.

    Raises
    ------
    InputError
        There are no positions.
    MissingDependency
        Matplotlib is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> answer = certpgo.solve(helix(4, np.random.default_rng(0)))
    >>> ax = certpgo.plot.trajectory(answer, ax=Figure().add_subplot())
    >>> [line.get_label() for line in ax.lines[:2]]
    ['truth', 'estimate']
    """
    graph, estimate = _parts(of)
    if estimate.translations is None:
        raise InputError("a trajectory has positions; these are rotations alone")
    scene = scene_of(*graph, ("estimate", estimate), truth=truth)
    answer = replace(scene, placements=scene.placements[-1:])
    return draw(answer, given_or_current(ax), **line)


def _parts(of: object) -> tuple[list[Any], Estimate]:
    """The graph that an estimate is of, if it is known, and the estimate."""
    if isinstance(of, CertifiedSolution):
        return [of.instance or of.graph], of.estimate
    if isinstance(of, Estimate):
        return [], of
    if not isinstance(of, Instance):
        raise InputError(f"an answer, an estimate or an instance is drawn, not {kind_of(of)}")
    known = of.truth or of.initial
    if known is None:
        raise InputError(f"{of.name}: neither truth nor initial values: solve it first")
    return [replace(of, truth=None)], known


def picture(scene: Scene, form: str, *, dark: bool = False, colour: str | None = None) -> bytes:
    """A scene as an image file.

    Parameters
    ----------
    form : ``"png"``, ``"pdf"`` or ``"svg"``
    dark, colour : as for `certpgo.view.viewer.offline`

    Raises
    ------
    InputError
        No edge has the measure ``colour``.
    MissingDependency
        Matplotlib is not installed.
    """
    try:
        from matplotlib import style
        from matplotlib.figure import Figure
    except ImportError:
        raise _missing() from None
    unit, content = scene.unit(colour), BytesIO()
    with style.context(["dark_background"] if dark else []):
        figure = Figure(figsize=SIZE, layout="constrained")
        ax = draw(scene, figure.add_subplot(), unit=unit, dark=dark)
        ax.set_title(in_utf8(", ".join([scene.name, *_said(scene, unit)])))
        if ax.get_legend_handles_labels()[0]:
            ax.legend(frameon=False)
        figure.savefig(content, format=form, dpi=DOTS)
    return content.getvalue()


def _said(scene: Scene, unit: str) -> Iterator[str]:
    """What colours mean, if edges have some."""
    for answer in scene.placements[-1:]:
        if measure := scene.measure(answer, unit):
            yield f"edges by {unit}, up to {measure.top:.3g}"


def draw(scene: Scene, ax: Axes, *, unit: str = "", dark: bool = False, **line: Any) -> Axes:
    """Draw a scene on axes, the answer last.

    Parameters
    ----------
    unit : of the measure that colours edges; if it is empty, they are grey
    dark : whether the background is dark
    **line : options of ``ax.plot`` for the answer
    """
    drawn = _Map(scene, ax)
    for _, surface in scene.surfaces:
        drawn.add_surface(surface)
    for answer in scene.placements[-1:]:
        drawn.add_edges(answer, unit, dark)
    if scene.truth is not None and scene.metric:
        drawn.add_poses(scene.truth, color=GREY, linestyle="--")
    for before in scene.placements[:-1]:
        drawn.add_poses(before, linewidth=0.6)
    for answer in scene.placements[-1:]:
        drawn.add_poses(answer, **{"linewidth": 1.0, **line})
    ax.set_aspect("equal", adjustable="datalim")
    if scene.metric and scene.d == 2:
        ax.set(xlabel=f"x, {scene.length_unit}", ylabel=f"y, {scene.length_unit}")
        return ax
    ax.set_axis_off()
    if scene.metric:
        scale_bar(ax, drawn.seen(drawn.shown), scene.length_unit)
    return ax


@dataclass(frozen=True)
class _Map:
    """A scene on axes, seen from the side that shows most of it."""

    scene: Scene
    ax: Axes

    @cached_property
    def shown(self) -> FloatArray:
        """(p, 3) positions of the answer, and points of surfaces."""
        placed = [placement.positions for placement in self.scene.placements[-1:]]
        return np.concatenate(placed + [surface.points for _, surface in self.scene.surfaces])

    @cached_property
    def _axes(self) -> FloatArray | None:
        """Principal axes to look along; None if x and y are looked at."""
        flat = self.scene.d == 2 or len(self.shown) < 3
        return None if flat else principal_frame(self.shown)

    def seen(self, points: FloatArray) -> FloatArray:
        """Points (..., 3) on the plane of the picture, (..., 2)."""
        if self._axes is None:
            return points[..., :2]
        if self.scene.is_flat and not self.scene.metric:  # a layout, from straight above
            return np.asarray(points @ self._axes[:2].T)
        return seen(points.reshape(-1, 3), self._axes).reshape(*points.shape[:-1], 2)

    def add_surface(self, surface: Surface) -> None:
        """The points of a cloud or mesh, or as many of them as can be seen."""
        drawn = np.random.default_rng(0).permutation(len(surface.points))[:CLOUD]
        ink = GREY if surface.colours is None else surface.colours[drawn] / 255.0
        x, y = self.seen(surface.points[drawn]).T
        self.ax.scatter(x, y, c=ink, s=0.5, linewidths=0.0, rasterized=True)

    def add_edges(self, answer: Placement, unit: str, dark: bool) -> None:
        """Edges of the answer, of which rejected ones are red, and its landmarks."""
        scene = self.scene
        drawn = scene.joins(answer) & ~scene.are(*PRIORS)
        if scene.metric:  # steps are the trajectory
            drawn &= ~scene.are_steps
        kept = drawn & ~scene.rejected
        ink = scene.colours(answer, unit, kept, dark=dark) / 255.0 if unit else GREY
        self._add_lines(scene.ends(answer, kept), ink, 0.5 if unit else 0.3)
        self._add_lines(scene.ends(answer, drawn & scene.rejected), RED, 0.5)
        x, y = self.seen(answer.positions[scene.landmarks[answer.nodes]]).T
        self.ax.scatter(x, y, color=ORANGE, s=4.0, linewidths=0.0)

    def _add_lines(self, ends: FloatArray, ink: Any, width: float) -> None:
        from matplotlib.collections import LineCollection

        if len(ends):
            lines = LineCollection(list(self.seen(ends)), colors=ink, linewidths=width)
            self.ax.add_collection(lines)

    def add_poses(self, placement: Placement, **line: Any) -> None:
        """The poses in their order; as dots if positions are not measured."""
        if not self.scene.metric:
            line |= {"linestyle": "", "marker": ".", "markersize": 2.0}
        at = self.seen(placement.positions[self.scene.poses(placement)])
        self.ax.plot(*at.T, **{"label": placement.name, **line})


def scale_bar(ax: Axes, at: FloatArray, unit: str = "m") -> None:
    """A bar below positions (n, 2), whose length is 1, 2 or 5 times a power of ten.

    It is about a fifth of their extent.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> from certpgo import plot
    >>> ax = Figure().add_subplot()
    >>> plot.scale_bar(ax, np.array([[0.0, 0.0], [60.0, 20.0]]))
    >>> ax.texts[0].get_text().strip()
    '10 m'
    """
    extent, corner = float(np.ptp(at[:, 0])), at.min(axis=0)
    if extent == 0.0:
        return
    length = round_below(extent / 5.0)
    x, y = float(corner[0]), float(corner[1]) - 0.06 * extent
    words = ax.text(
        x + 0.5 * length, y, f"{length:g} {unit}\n", ha="center", va="center", fontsize=7
    )
    ink = words.get_color()  # black, or light on a dark background
    ax.plot([x, x + length], [y, y], color=ink, linewidth=1.5, solid_capstyle="butt")
