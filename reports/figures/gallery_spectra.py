"""Spectra of the certificate matrix at three points of one graph."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo import Estimate, Quadratic, solve
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.optimize.riemannian_newton import newton
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

SIGMA_DEG, MOVED_DEG, CLOSURES, SHOWN = 3.0, 3.0, 20, 18
TITLES = {
    "optimum": "global optimum",
    "wound_up": "wound up: a local minimum",
    "moved": "optimum, moved at random",
}
COLOURS = {"optimum": _style.BLUE, "wound_up": _style.VERMILION, "moved": _style.PURPLE}


def compute(quick: bool, data: Path | None) -> Data:
    """The smallest eigenvalues at each point, its cost and what they prove."""
    n = 24 if quick else 60
    rng = _scenes.generator(12)
    instance = synthetic.orbital(n, np.radians(SIGMA_DEG), rng, closures=CLOSURES)
    problem = Quadratic(instance.graph)
    best = solve(instance.graph)
    turn = 2.0 * np.pi * np.arange(n)[:, None] / n * np.array([0.0, 0.0, 1.0])
    once_more = Estimate(instance.truth.rotations @ so.exp(turn))
    shaken = so.exp(np.radians(MOVED_DEG) * rng.standard_normal((n, 3)))
    points = {
        "optimum": best.estimate,
        "wound_up": newton(problem, once_more).estimate,
        "moved": Estimate(best.estimate.rotations @ shaken),
    }
    unit = float(problem.node_weights.mean())
    record = {key: _spectrum(problem, point, unit) for key, point in points.items()}
    return {
        "n": n,
        "m": instance.graph.num_edges,
        "sigma_deg": SIGMA_DEG,
        "moved_deg": MOVED_DEG,
        "verdict": best.verdict.value,
        "points": record,
        "costs": ", ".join(f"{point['cost']:.4g}" for point in record.values()),
        "bounds": ", ".join(f"{max(point['bound'], 0.0):.4g}" for point in record.values()),
        "wound_up_smallest": record["wound_up"]["eigenvalues"][0],
    }


def _spectrum(problem: Quadratic, point: Estimate, unit: float) -> Data:
    """Eigenvalues of S = L - blkdiag(Lam), in units of the mean degree."""
    S = problem.certificate_matrix(problem.multipliers(point)).toarray()
    values = np.linalg.eigvalsh(S)
    cost = problem.cost(point)
    # S + eta I >= 0 bounds the gap by d n eta.
    bound = cost - len(values) * max(-float(values[0]), 0.0)
    return {
        "cost": cost,
        "bound": bound,
        "eigenvalues": (values[:SHOWN] / unit).tolist(),
        "stationarity_deg": float(np.degrees(problem.stationarity(point))),
    }


def draw(figure, record: Data) -> None:
    """A panel a point: eigenvalues as bars from zero, in ascending order."""
    figure.set_size_inches(_style.PAGE, 0.32 * _style.PAGE)
    panels = figure.subplots(1, len(record["points"]), sharey=True)
    for axes, letter, (key, point) in zip(panels, "abc", record["points"].items(), strict=True):
        values = np.array(point["eigenvalues"])
        place = np.arange(1, len(values) + 1)
        axes.axhline(0.0, color=_style.GREY, linewidth=0.8)
        axes.vlines(place, 0.0, values, color=COLOURS[key], linewidth=1.5)
        axes.plot(place, values, "o", color=COLOURS[key])
        said = f"F = {point['cost']:.3f}\nF* $\\geq$ {max(point['bound'], 0.0):.3f}"
        axes.text(0.05, 0.95, said, transform=axes.transAxes, va="top", fontsize=7)
        axes.set(xlabel="eigenvalue number")
        axes.set_xticks((1, 3, 6, 9, 12, 15, 18))
        _style.panel(axes, letter, TITLES[key])
    panels[0].set(ylabel="eigenvalue / mean degree")


FIGURE = Figure(
    name="gallery_spectra",
    title="The smallest eigenvalues of the certificate matrix",
    source="A. Eriksson et al., Rotation Averaging and Strong Duality, 2018, eqs. 16 and 18",
    compute=compute,
    draw=draw,
    caption=(
        "S = L - blkdiag(Lam) on a near-cycle of {n} cameras with {m} measurements, noise "
        "{sigma_deg:g} degrees. At the optimum ({verdict}) S has three zeros and is positive "
        "semidefinite; at the wound-up local minimum it has an eigenvalue of "
        "{wound_up_smallest:.2g} mean degrees; at the optimum moved by {moved_deg:g} degrees an "
        "axis the zeros are gone. Costs {costs}; the bounds that these spectra prove: {bounds}."
    ),
    notes=("The eigenvalues are dense linear algebra's; a proof takes a factorization.",),
)
