"""Axes to draw on, as Matplotlib has them; it is imported on first use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from certpgo.errors import MissingDependency
from certpgo.linalg.arrays import FloatArray, round_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Of what is in the background.
GREY = "0.6"


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
        raise MissingDependency("matplotlib, which draws plots,", "plots") from None
    return plt.gca()


def scale_bar(ax: Axes, at: FloatArray) -> None:
    """A bar below positions (n, 2), whose length is 1, 2 or 5 times a power of ten, metres.

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
    ax.plot([x, x + length], [y, y], color="black", linewidth=1.5, solid_capstyle="butt")
    ax.text(x + 0.5 * length, y, f"{length:g} m\n", ha="center", va="center", fontsize=7)
