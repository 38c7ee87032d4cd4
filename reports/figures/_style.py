"""What the figures share: colours, widths, and axes in three dimensions."""

from __future__ import annotations

import numpy as np

#: Widths of a column and of a page, inches.
COLUMN, PAGE = 8.8 / 2.54, 18.0 / 2.54

#: Okabe and Ito's colours, which the colour-blind tell apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
#: Of lines that are told apart by colour, in this order, and of what is in the background.
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
GREY = "#999999"
MARKERS = "osD^vP*"


def panel(axes, letter: str, text: str = "") -> None:
    """Name the panel, as ``(a) text``."""
    axes.set_title(f"({letter}) {text}".strip(), loc="left")


def key(figure, lines: dict[str, str]) -> None:
    """What lines are, by their colours, above all panels."""
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour, label=label) for label, colour in lines.items()]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))


def ball(axes, radius: float) -> None:
    """Three-dimensional axes for rotation vectors: a ball's outline and its axes, no box."""
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    c, s, o = radius * np.cos(turn), radius * np.sin(turn), 0.0 * turn
    for circle in ((c, s, o), (c, o, s), (o, c, s)):
        axes.plot(*circle, color=GREY, linewidth=0.4)
    for k, name in enumerate("xyz"):
        end = radius * np.eye(3)[k]
        axes.plot(*np.stack([-end, end], axis=1), color=GREY, linewidth=0.4)
        axes.text(*(1.12 * end), name, fontsize=7, ha="center", va="center")
    limits = (-radius, radius)
    axes.set(xlim=limits, ylim=limits, zlim=limits)
    axes.set_box_aspect((1, 1, 1), zoom=1.45)
    axes.view_init(elev=20, azim=-55)
    axes.set_axis_off()
