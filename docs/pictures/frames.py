"""Draws frames.svg: the world, two bodies, and what an edge measures."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

HERE = Path(__file__).parent

#: Okabe and Ito's colours, which remain distinct for every type of colour vision.
ORANGE, BLUE, GREEN, GREY = "#d55e00", "#0072b2", "#009e73", "#444444"


def turn(degrees: float) -> np.ndarray:
    """The rotation of the plane by an angle."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str, width: float = 1.6) -> None:
    """An arrow between two points."""
    style = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", xy=tuple(end), xytext=tuple(start), arrowprops=style)


def frame(axes: Axes, R: np.ndarray, t: np.ndarray, colour: str, names: tuple[str, str]) -> None:
    """Two axes, the columns of R, at t."""
    for axis, name in zip(R.T, names, strict=True):
        arrow(axes, t, t + axis, colour)
        axes.text(*(t + 1.22 * axis), name, color=colour, ha="center", va="center")
    axes.plot(*t, "o", color=colour, markersize=4)


def draw(figure: Figure) -> None:
    """The picture."""
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    origin = np.zeros(2)
    t_i, R_i = np.array([2.3, 1.5]), turn(25.0)
    t_j, R_j = np.array([5.4, 2.2]), turn(75.0)
    for t, name, shift in ((t_i, "$t_i$", (-0.12, 0.2)), (t_j, "$t_j$", (0.0, -0.26))):
        arrow(axes, origin, t, GREY, 0.9)
        middle = 0.55 * t + np.array(shift)
        axes.text(*middle, name, color=GREY, ha="center", va="center")
    arrow(axes, t_i, t_j, ORANGE)
    axes.text(3.75, 2.12, "$R_i\\,t_{ij}$", color=ORANGE, ha="center", va="center")
    frame(axes, np.eye(2), origin, "black", ("$x$", "$y$"))
    frame(axes, R_i, t_i, BLUE, ("", ""))
    frame(axes, R_j, t_j, GREEN, ("", ""))
    axes.text(-0.12, -0.3, "world", ha="left", va="center")
    axes.text(2.02, 1.7, "body $i$", color=BLUE, ha="right", va="center")
    axes.text(5.62, 1.98, "body $j$", color=GREEN, ha="left", va="center")
    axes.text(2.05, 2.72, "columns of $R_i$", color=BLUE, ha="center", va="center")
    axes.text(5.15, 3.4, "columns of $R_j = R_i R_{ij}$", color=GREEN, ha="center", va="center")
    axes.set(xlim=(-0.45, 7.1), ylim=(-0.55, 3.7), aspect="equal")
    axes.axis("off")


def main() -> None:
    """Write the picture beside this file."""
    settings = {"font.size": 9.0, "svg.hashsalt": "frames", "mathtext.fontset": "cm"}
    with mpl.rc_context(settings):
        figure = Figure(figsize=(5.4, 3.04))
        draw(figure)
        figure.savefig(HERE / "frames.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main()
