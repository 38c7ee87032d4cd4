"""Three local minima of one orbital camera problem.

After Eriksson et al. 2018, Figure 1, whose problem the paper does not give: cameras once around an
object, a cycle of measurements and one more across, seen from random starts. Each independent loop
of measurements may close with or without a full turn too much, so that one loop has two minima and
two have four; the three lowest are drawn, each with the verdict of the certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certpgo import Certificate, Estimate, Quadratic, certify
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.optimize.riemannian_newton import NewtonSettings, newton
from certpgo.solve import metrics
from reports.harness.experiments.claims import Claim
from reports.harness.experiments.figure import Data, Figure

from . import _style

CAMERAS, SIGMA, SEED, STARTS, QUICK_STARTS = 40, 0.1, 0, 60, 25
#: Costs that differ by less than this part are of one minimum.
SAME = 1e-6
#: Smallest eigenvalue of the Hessian at a minimum, over the largest weight of a node; its gauge has
#: three zeros.
DEFINITE, GAUGE = 1e-9, 3
#: Which corners of a camera its lines join.
FRUSTUM = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))
WORDS = {
    "CERTIFIED": "CERTIFIED: none is better",
    "REFUTED": "REFUTED: a better one is in hand",
}


@dataclass(frozen=True, eq=False)
class Minimum:
    """A local minimum, aligned with the truth, and how many starts ended there."""

    estimate: Estimate
    cost: float
    certificate: Certificate
    starts: int


def problem() -> tuple[Quadratic, Estimate]:
    """The near-cycle, and the true rotations."""
    rng = np.random.default_rng(SEED)
    instance = synthetic.orbital(CAMERAS, SIGMA, rng, closures=1, reach=CAMERAS // 2)
    return Quadratic(instance.graph), instance.truth


def minima(starts: int) -> list[Minimum]:
    """The local minima that Newton's method reaches from random starts, lowest first."""
    cameras, truth = problem()
    rng = np.random.default_rng(SEED)
    ends: list[tuple[float, Estimate]] = []
    for _ in range(starts):
        start = Estimate(so.random(rng, cameras.n, cameras.d))
        end = newton(cameras, start, NewtonSettings(max_iterations=300)).estimate
        if is_minimum(cameras, end):
            ends.append((cameras.cost(end), end))
    ends.sort(key=lambda end: end[0])
    costs = np.array([cost for cost, _ in ends])
    first = np.flatnonzero(np.diff(costs, prepend=-np.inf) > SAME * costs)
    return [
        Minimum(
            estimate=ends[k][1].moved(metrics.align(ends[k][1], truth)),
            cost=ends[k][0],
            certificate=certify(cameras, ends[k][1]),
            starts=int(following - k),
        )
        for k, following in zip(first, [*first[1:], len(ends)], strict=True)
    ]


def is_minimum(cameras: Quadratic, point: Estimate) -> bool:
    """Whether the point is stationary and its Hessian definite but for the gauge."""
    if cameras.stationarity(point) > 1e-9:
        return False
    blocks = cameras.hessian(point, cameras.multipliers(point))
    eigenvalues = np.linalg.eigvalsh(cameras.pattern.assemble(*blocks).toarray())
    scaled = eigenvalues / cameras.node_weights.max()
    return bool(scaled[0] > -DEFINITE and scaled[GAUGE] > DEFINITE)


def compute(quick: bool, data: Path | None) -> Data:
    """The three lowest minima."""
    starts = QUICK_STARTS if quick else STARTS
    cameras, _ = problem()
    found = minima(starts)[:3]
    return {
        "cameras": CAMERAS,
        "starts": starts,
        "edges": cameras.graph.edges.tolist(),
        "minima": [
            {
                "cost": minimum.cost,
                "verdict": minimum.certificate.verdict.value,
                "starts": minimum.starts,
                "residuals_deg": np.degrees(cameras.residual_angles(minimum.estimate)).tolist(),
                "rotations": minimum.estimate.rotations.tolist(),
            }
            for minimum in found
        ],
    }


def draw(figure, record: Data) -> None:
    """Cameras by their rotations alone: each looks along its own x axis at the object."""
    figure.set_size_inches(_style.PAGE, 0.36 * _style.PAGE)
    for place, minimum in enumerate(record["minima"], start=1):
        axes = figure.add_subplot(1, len(record["minima"]), place, projection="3d")
        _draw_cameras(axes, record["edges"], minimum)
        axes.set_title(
            f"F = {minimum['cost']:.4g}, residuals to {max(minimum['residuals_deg']):.3g} deg\n"
            f"{WORDS.get(minimum['verdict'], minimum['verdict'])}\n"
            f"{minimum['starts']} of {record['starts']} random starts ended here"
        )


def _draw_cameras(axes, edges: list[list[int]], minimum: Data) -> None:
    """Cameras on a sphere around the object, in the order of the orbit; measurements as lines."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    R = np.array(minimum["rotations"])
    centres = R[:, :, 0]
    shade = np.minimum(np.array(minimum["residuals_deg"]) / 30.0, 1.0)
    reds = [(s, 0.1, 0.1, 0.8) for s in shade]
    axes.add_collection(
        Line3DCollection(centres[np.array(edges)], colors=reds, linewidths=0.6 + shade)
    )
    lines, colours = [], []
    for k, rotation in enumerate(R):
        lines.extend(_frustum(rotation)[np.array(FRUSTUM)])
        along = k / len(R)
        colours.extend([(0.0, 0.25 + 0.5 * along, 0.75 - 0.3 * along)] * len(FRUSTUM))
    axes.add_collection(Line3DCollection(lines, colors=colours, linewidths=0.6))
    axes.scatter([0.0], [0.0], [0.0], color=_style.BLACK, s=8)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axes.set_box_aspect((1, 1, 1), zoom=1.4)
    axes.set_axis_off()


def _frustum(rotation: FloatArray) -> FloatArray:
    """(5, 3) centre and image corners of a camera that looks at the origin."""
    x, y, z = rotation.T
    image = [0.86 * x + 0.07 * (s * y + t * z) for s, t in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return np.array([x, *image])


def has_local_minima(record: Data) -> bool:
    """Whether one minimum is certified and the others are refuted."""
    first, *others = (minimum["verdict"] for minimum in record["minima"])
    return first == "CERTIFIED" and set(others) == {"REFUTED"}


CLAIMS = (
    Claim(
        "One rotation averaging problem has several local minima, of which one is global",
        has_local_minima,
        "section 1, Figure 1",
    ),
)

FIGURE = Figure(
    name="eriksson2018_figure1",
    title="Three local minima of one orbital camera problem",
    source="Eriksson, Olsson, Kahl, Chin, CVPR 2018, Figure 1; the paper does not give its problem",
    compute=compute,
    draw=draw,
    caption=(
        "{cameras} cameras once around an object, a cycle of measurements and one more across, the "
        "redder the larger their residuals; the three lowest of the minima that Newton's method "
        "reaches from {starts} random starts, with the verdicts of their certificates."
    ),
    claims=CLAIMS,
)
