"""What the figures share: colours, widths, and axes in three dimensions."""

from __future__ import annotations

#: Widths of a column and of a page, inches.
COLUMN, PAGE = 8.8 / 2.54, 18.0 / 2.54

#: Okabe and Ito's colours, which the colour-blind tell apart.
BLACK, ORANGE, SKY, GREEN = "#000000", "#E69F00", "#56B4E9", "#009E73"
YELLOW, BLUE, VERMILION, PURPLE = "#F0E442", "#0072B2", "#D55E00", "#CC79A7"
#: Of lines that are told apart by colour, in this order, and of what is in the background.
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
GREY = "#999999"
MARKERS = "osD^vP*"


def panel(axes, letter: str, text: str = "") -> None:
    """Name the panel, as ``(a) text``."""
    axes.set_title(f"({letter}) {text}".strip(), loc="left")
