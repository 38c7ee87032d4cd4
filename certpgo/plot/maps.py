"""Trajectories, seen from the side that shows most of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from certpgo.assess.metrics import align_positions
from certpgo.errors import InputError, kind_of
from certpgo.graph import Estimate, Instance, PoseGraph
from certpgo.graph.picture import closures, principal_frame, seen
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.plot.axes import GREY, given_or_current, scale_bar
from certpgo.solvers.certified.result import CertifiedSolution

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def trajectory(
    of: CertifiedSolution | Estimate | Instance,
    *,
    truth: Estimate | None = None,
    ax: Axes | None = None,
    **line: Any,
) -> Axes:
    """Draw a trajectory through poses in their order, over the loop closures of an answer.

    Planar poses are drawn on x and y, metres; others as seen on the plane they lie nearest to, with
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
    estimate, nodes, edges = _parts(of)
    t = estimate.translations
    if t is None:
        raise InputError("a trajectory has positions; these are rotations alone")
    source = of.instance if isinstance(of, CertifiedSolution) else None
    truth = truth if source is None else truth or source.truth
    true = None if truth is None else align_positions(truth, estimate).translations
    ax = given_or_current(ax)
    at = _view(t)
    if len(edges):
        from matplotlib.collections import LineCollection

        ax.add_collection(LineCollection(list(at[edges]), colors=GREY, linewidths=0.3))
    if true is not None:
        ax.plot(*_view(true, like=t)[nodes].T, color=GREY, linestyle="--", label="truth")
    ax.plot(*at[nodes].T, **{"linewidth": 1.0, "label": "estimate", **line})
    ax.set_aspect("equal", adjustable="datalim")
    if t.shape[1] == 2:
        ax.set(xlabel="x, m", ylabel="y, m")
    else:
        ax.set_axis_off()
        scale_bar(ax, at)
    return ax


def _parts(of: object) -> tuple[Estimate, IntArray, IntArray]:
    """The estimate, its nodes along the trajectory, and edges to draw."""
    none = np.empty((0, 2), dtype=np.intp)
    if isinstance(of, CertifiedSolution):
        graph = of.graph
        nodes = graph.pose_nodes if isinstance(graph, PoseGraph) else np.arange(graph.num_nodes)
        return of.estimate, nodes, closures(graph.edges)
    if isinstance(of, Estimate):
        return of, np.arange(of.num_nodes), none
    if not isinstance(of, Instance):
        raise InputError(f"an answer, an estimate or an instance is drawn, not {kind_of(of)}")
    known = of.truth or of.initial
    if known is None:
        raise InputError(f"{of.name}: neither truth nor initial values: solve it first")
    return known, of.poses, closures(of.graph.edges)


def _view(t: FloatArray, like: FloatArray | None = None) -> FloatArray:
    """Positions (n, d) in the plane of the picture of ``like``."""
    shown = t if like is None else like
    if t.shape[1] == 2 or len(shown) < 3:
        return t[:, :2]
    return seen(t, principal_frame(shown))
