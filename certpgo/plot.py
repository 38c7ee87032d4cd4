"""Plots of answers with Matplotlib, one call each: `certpgo.plot.trajectory(answer)`."""

from certpgo.view.curves import bounds, convergence, residuals, spectrum
from certpgo.view.maps import scale_bar, trajectory
from certpgo.view.style import STYLE

__all__ = ["STYLE", "bounds", "convergence", "residuals", "scale_bar", "spectrum", "trajectory"]
