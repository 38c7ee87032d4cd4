"""How figures of a page or paper look."""

#: Settings of Matplotlib: small type that stays legible in a column of 8.8 cm, thin lines, and
#: dense artists at the resolution of a screen.
STYLE: dict[str, float | bool] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "grid.linewidth": 0.4,
    "savefig.dpi": 130,
}
