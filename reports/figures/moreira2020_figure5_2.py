"""Moreira 2020, Figure 5.2: errors against the truth as noise grows, and as graphs get sparser."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from certpgo import Estimate, Instance, Quadratic
from certpgo.optimize.methods.eigen_ra import EigenRA
from certpgo.optimize.methods.riemannian_gradient import RiemannianGradient
from certpgo.solve import metrics
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure

from . import _scenes, _style

N, FIEDLER, SAMPLES = 550, (0.5, 2.0, 8.0, 32.0), 5
SIGMA_DEG = (0, 2.5, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60)
LOW_SIGMA_DEG = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10)
MEASURES = ("rmse_deg", "mean_deg", "median_deg")
LABELS = {"rmse_deg": "RMSE", "mean_deg": "mean", "median_deg": "median"}


def compute(quick: bool, data: Path | None) -> Data:
    """Mean errors of EigenRA: refined on one graph, and on four."""
    n, samples = (60, 1) if quick else (N, SAMPLES)
    scene = _scenes.exact_random(60, 5.0) if quick else _scenes.exact_notre_dame(data)
    curves = {"EigenRA": {m: [] for m in MEASURES}, "refined": {m: [] for m in MEASURES}}
    sigmas = SIGMA_DEG[::3] if quick else SIGMA_DEG
    for place, sigma in enumerate(sigmas):
        first, refined = [], []
        for sample in range(samples):
            problem = _scenes.noisy(scene, sigma, _scenes.generator(5, place, sample))
            answer = EigenRA().solve(problem).estimate
            first.append(_errors(answer, scene))
            refined.append(_errors(_refined(problem, answer), scene))
        _extend(curves["EigenRA"], first)
        _extend(curves["refined"], refined)
    graphs = []
    for number, wish in enumerate(FIEDLER):
        exact = _scenes.exact_random(n, wish)
        graph = {m: [] for m in MEASURES}
        for place, sigma in enumerate(LOW_SIGMA_DEG):
            problems = (
                _scenes.noisy(exact, sigma, _scenes.generator(6, number, place, sample))
                for sample in range(samples)
            )
            _extend(graph, [_errors(EigenRA().solve(p).estimate, exact) for p in problems])
        graphs.append({"fiedler": _scenes.fiedler(exact), "m": exact.graph.num_edges, **graph})
    return {
        "n": n,
        "scene_n": scene.graph.num_nodes,
        "scene_m": scene.graph.num_edges,
        "samples": samples,
        "sigma_deg": list(sigmas),
        "curves": curves,
        "low_sigma_deg": list(LOW_SIGMA_DEG),
        "graphs": graphs,
        "slopes": ", ".join(f"{g['rmse_deg'][5] / LOW_SIGMA_DEG[5]:.2g}" for g in graphs),
        "last_eigen_ra": curves["EigenRA"]["rmse_deg"][-1],
        "last_refined": curves["refined"]["rmse_deg"][-1],
    }


def _refined(problem: Quadratic, answer: Estimate) -> Estimate:
    return RiemannianGradient(tolerance=1e-7).solve(problem, initial=answer).estimate


def _errors(estimate: Estimate, scene: Instance) -> list[float]:
    errors = metrics.angular_errors(estimate, scene.truth)
    return [getattr(errors, measure) for measure in MEASURES]


def _extend(curves: dict[str, list[float]], samples: list[list[float]]) -> None:
    for measure, mean in zip(MEASURES, np.mean(samples, axis=0), strict=True):
        curves[measure].append(float(mean))


def draw(figure, record: Data) -> None:
    """A row an error: the dense graph on the left, four graphs on the right."""
    figure.set_size_inches(_style.PAGE, 0.9 * _style.PAGE)
    panels = figure.subplots(3, 2, sharex="col")
    for (left, right), measure, letters in zip(panels, MEASURES, ("ab", "cd", "ef"), strict=True):
        for (label, curve), colour, marker in zip(
            record["curves"].items(), _style.COLOURS, "os", strict=False
        ):
            left.plot(record["sigma_deg"], curve[measure], color=colour, marker=marker, label=label)
        for graph, colour, marker in zip(
            record["graphs"], _style.COLOURS, _style.MARKERS, strict=False
        ):
            label = f"F(G) = {graph['fiedler']:.2f}, |E| = {graph['m']}"
            right.plot(
                record["low_sigma_deg"], graph[measure], color=colour, marker=marker, label=label
            )
        for axes, letter in ((left, letters[0]), (right, letters[1])):
            axes.set_ylabel(f"{LABELS[measure]} (degrees)")
            _style.panel(axes, letter)
    for axes in panels[0]:
        axes.legend(loc="upper left")
    for axes in panels[-1]:
        axes.set_xlabel("$\\sigma_R$ (degrees)")


def factors(record: Data) -> list[list[float]]:
    """Of each graph, by growing Fiedler value, the RMSE over sigma_R."""
    graphs = sorted(record["graphs"], key=lambda graph: graph["fiedler"])
    noises = record["low_sigma_deg"]
    return [
        [rmse / sigma for rmse, sigma in zip(graph["rmse_deg"], noises, strict=True) if sigma]
        for graph in graphs
    ]


def is_proportional(record: Data) -> bool:
    """Whether each graph's factors lie within a tenth of one another."""
    return all(max(ratios) <= 1.1 * min(ratios) for ratios in factors(record))


def connectivity_helps(record: Data) -> bool:
    """Whether the factors fall from graph to graph."""
    last = [ratios[-1] for ratios in factors(record)]
    return last == sorted(last, reverse=True)


CLAIMS = (
    Claim(
        "Errors are proportional to sigma_R (the RMSE over sigma_R, to 10 %, up to 10 degrees)",
        is_proportional,
        "section 5.3.2, Figure 5.2 (p. 49)",
    ),
    Claim(
        "The factor increases as the Fiedler value decreases",
        connectivity_helps,
        "section 5.3.2, Figure 5.2 (p. 49)",
    ),
)

FIGURE = Figure(
    name="moreira2020_figure5_2",
    title="Errors against the truth as noise grows (Moreira 2020, Figure 5.2)",
    source="G. Moreira, A Unified Approach for Pose Graph Optimization, 2020, Figure 5.2",
    compute=compute,
    draw=draw,
    caption=(
        "Angles to the truth after alignment, means over {samples} samples. Left: EigenRA and its "
        "answer refined by Riemannian gradient descent, {scene_n} nodes and {scene_m} edges; at 60 "
        "degrees their RMSE is {last_eigen_ra:.3g} and {last_refined:.3g} degrees. Right: EigenRA "
        "on four random graphs of {n} nodes; their RMSE at 5 degrees is {slopes} times sigma_R."
    ),
    notes=("The thesis does not print the Fiedler values of its four graphs.",),
    claims=CLAIMS,
)
