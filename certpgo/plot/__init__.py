"""Plots of answers with Matplotlib, one call each: `certpgo.plot.trajectory(answer)`."""

from certpgo.plot.axes import scale_bar
from certpgo.plot.curves import bounds, convergence, residuals, spectrum
from certpgo.plot.maps import trajectory

__all__ = ["bounds", "convergence", "residuals", "scale_bar", "spectrum", "trajectory"]
