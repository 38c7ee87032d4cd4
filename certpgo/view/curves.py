"""Residuals, eigenvalues, bounds and convergence of an answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from certpgo.certify import Certificate
from certpgo.errors import InputError, kind_of, require
from certpgo.graph import Estimate
from certpgo.graph.phrases import bound_shown, cost_shown, gap_shown
from certpgo.objective.choose_cost import Certifiable, Sum
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.monitor import Iteration
from certpgo.optimize.solution import Solution
from certpgo.solve.bounds_table import rungs_of_eigenvalues
from certpgo.solve.result import CertifiedSolution
from certpgo.view.eigenvalues import certificate_matrix
from certpgo.view.maps import GREY, RED, given_or_current

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def residuals(
    of: CertifiedSolution | Quadratic | Sum,
    estimate: Estimate | None = None,
    *,
    bins: int = 50,
    ax: Axes | None = None,
) -> Axes:
    """Draw the distribution of residual angles, degrees, over the measurements.

    Parameters
    ----------
    of : an answer of `certpgo.solve`; or a problem, with an ``estimate`` from elsewhere
    bins : number of bars
    ax : axes to draw on; by default the current ones

    Examples
    --------
    A cycle that is wound up has the same residual on every edge:

    >>> from matplotlib.figure import Figure
    >>> from certpgo import Quadratic, plot
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> instance, around = winding_cycle(9, 0.0, 1)
    >>> problem = Quadratic(instance.graph)
    >>> ax = plot.residuals(problem, around, ax=Figure().add_subplot())
    >>> ax.get_title()
    '9 edges, at most 40 degrees'
    """
    if isinstance(of, CertifiedSolution):
        problem, at = of.problem, of.estimate if estimate is None else estimate
    elif estimate is None:
        raise InputError("residuals are of an answer, or of a problem and an estimate")
    else:
        problem, at = of, estimate
    if not hasattr(problem, "residual_angles"):
        raise InputError(f"an answer, or a problem and an estimate expected, not {kind_of(of)}")
    problem.check(at)
    angles = np.degrees(problem.residual_angles(at))
    ax = given_or_current(ax)
    ax.hist(angles, bins=bins, range=(0.0, max(1.05 * float(angles.max()), 1e-9)))
    ax.set_yscale("log")
    ax.set(xlabel="residual angle, degrees", ylabel="measurements")
    ax.set_title(f"{len(angles)} edges, at most {angles.max():.3g} degrees")
    return ax


def spectrum(
    of: CertifiedSolution | Quadratic | Sum,
    certificate: Certificate | None = None,
    *,
    count: int = 8,
    ax: Axes | None = None,
) -> Axes:
    """Draw the smallest eigenvalues of the certificate matrix: none is negative at an optimum.

    Those of the gauge, d of them, are zero. Computed eigenvalues illustrate; they prove nothing.

    Parameters
    ----------
    of : an answer of `certpgo.solve`; or a problem, with a ``certificate`` of it
    count : number of eigenvalues
    ax : axes to draw on; by default the current ones

    Raises
    ------
    InputError
        There is no certificate matrix, as no lower bound was found.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> answer = certpgo.solve(winding_cycle(9, 0.3, 0)[0])
    >>> ax = certpgo.plot.spectrum(answer, count=5, ax=Figure().add_subplot())
    >>> len(ax.patches)
    5
    """
    matrix = certificate_matrix(*_certified(of, certificate))
    if matrix is None:
        raise InputError("there is no certificate matrix to draw")
    values = matrix.eigenvalues(count)
    ax = given_or_current(ax)
    ax.bar(np.arange(1, len(values) + 1), values)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
    ax.set(xlabel="number", ylabel="eigenvalue of the certificate matrix")
    return ax


def bounds(
    of: CertifiedSolution | Quadratic | Sum,
    certificate: Certificate | None = None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw how far the cost is above each lower bound, and the tolerance of CERTIFIED.

    The axis is logarithmic: a proven bound may be eleven digits closer than one of eigenvalues.

    Parameters
    ----------
    of : an answer of `certpgo.solve`; or a problem, with a ``certificate`` of it
    ax : axes to draw on; by default the current ones

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import winding_cycle
    >>> answer = certpgo.solve(winding_cycle(9, 0.3, 0)[0])
    >>> ax = certpgo.plot.bounds(answer, ax=Figure().add_subplot())
    >>> ax.get_xscale(), ax.get_yticklabels()[-1].get_text()
    ('log', 'proven bound')
    """
    problem, proven = _certified(of, certificate)
    shown: list[tuple[str, float]] = []
    if problem.is_chordal:
        rungs = rungs_of_eigenvalues(problem.chordal, proven.refined, proven)
        shown = [(r.title, r.value) for r in rungs if r.about == "cost" and r.value is not None]
    shown = [(title, value) for title, value in shown if value != proven.lower_bound]
    shown.append(("proven bound", proven.lower_bound))
    # A gap of zero has no place on a logarithmic axis: rounding of the cost is the least drawn.
    least = np.finfo(float).eps * max(abs(proven.cost_upper), proven.tolerance)
    gaps = [max(proven.cost_upper - value, least) for _, value in shown[:-1]]
    gaps.append(max(proven.gap, least))
    ax = given_or_current(ax)
    places = np.arange(len(shown))
    ax.hlines(places, least, gaps, color=GREY)
    ax.plot(gaps, places, "o")
    for place, gap, (_, value) in zip(places, gaps, shown, strict=True):
        text = bound_shown(value) if place == places[-1] else f"{value:.6g}"
        ax.annotate(text, (gap, place), (0, 6), textcoords="offset points", ha="center")
    ax.axvline(proven.tolerance, linestyle="--", color=RED)
    tolerance = f"tolerance {gap_shown(proven.tolerance)}"
    ax.annotate(
        tolerance,
        (proven.tolerance, 1),
        (3, -3),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        va="top",
        color=RED,
        rotation=90,
    )
    ax.set_xscale("log")
    ax.set_yticks(places, [title for title, _ in shown])
    ax.margins(x=0.1, y=0.3)
    title = f"{proven.stated}, cost {cost_shown(proven.cost_upper)}, gap {gap_shown(proven.gap)}"
    ax.set(xlabel=f"{proven.objective} minus lower bound", title=title)
    return ax


def convergence(
    of: CertifiedSolution | Solution | Sequence[Iteration],
    *,
    lower_bound: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw how far the cost is above a lower bound, iteration by iteration.

    Parameters
    ----------
    of : an answer of `certpgo.solve`, a solution with a trace, or iterations that a monitor kept
    lower_bound : by default the answer's or solution's own; without one the cost itself is drawn
    ax : axes to draw on; by default the current ones

    Raises
    ------
    InputError
        There are no iterations.

    Examples
    --------
    >>> import numpy as np
    >>> from matplotlib.figure import Figure
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> answer = certpgo.solve(helix(4, np.random.default_rng(0)))
    >>> ax = certpgo.plot.convergence(answer, ax=Figure().add_subplot())
    >>> ax.get_ylabel()
    'cost above the lower bound'
    """
    solution = of.solution if isinstance(of, CertifiedSolution) else of
    if isinstance(solution, Solution):
        trace: Sequence[Iteration] = solution.trace
        lower_bound = solution.lower_bound if lower_bound is None else lower_bound
    else:
        trace = solution
        require(trace, list | tuple, "an answer, or a sequence of iterations")
        for iteration in trace:
            require(iteration, Iteration, "an Iteration")
    if not len(trace):
        raise InputError("no iterations to draw: the method recorded none")
    ax = given_or_current(ax)
    costs = np.array([iteration.cost for iteration in trace])
    numbers = [iteration.number for iteration in trace]
    above = costs if lower_bound is None else np.maximum(costs - lower_bound, 0.0)
    ax.semilogy(numbers, np.where(above > 0.0, above, np.nan), marker="o", markersize=3.0)
    label = "cost" if lower_bound is None else "cost above the lower bound"
    ax.set(xlabel="iteration", ylabel=label)
    return ax


def _certified(of: object, certificate: Certificate | None) -> tuple[Certifiable, Certificate]:
    """The problem, and a certificate about it."""
    if certificate is not None:
        require(certificate, Certificate, "a Certificate")
    if isinstance(of, CertifiedSolution):
        return of.problem, certificate or of.certificate
    if certificate is None or not hasattr(of, "is_chordal"):
        raise InputError(f"an answer, or a problem and its certificate expected, not {kind_of(of)}")
    return of, certificate  # type: ignore[return-value]
