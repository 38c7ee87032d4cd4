"""Three local minima of one orbital camera problem; ``python eriksson2018_figure1.py [OUT]``.

After Eriksson et al. 2018, Figure 1, whose problem is not public: cameras once around an object, a
cycle of measurements and one more across, seen from random starts. Each independent loop of
measurements may close with or without a full turn too much, so that one loop has two minima and
two have four; the three lowest are drawn, each with the verdict of the certificate.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np

from certpgo import Certificate, Estimate, RotationProblem, certify, metrics
from certpgo.datasets import synthetic
from certpgo.io.wording import counted
from certpgo.linalg import so
from certpgo.linalg.arrays import FloatArray
from certpgo.newton import newton

CAMERAS, SIGMA, SEED, STARTS = 40, 0.1, 0, 60
#: Costs that differ by less than this part are of one minimum.
SAME = 1e-6
#: Smallest eigenvalue of the Hessian at a minimum, over the largest weight of a node; its gauge has
#: three zeros.
DEFINITE, GAUGE = 1e-9, 3
WORDS = {
    "CERTIFIED": "CERTIFIED: no other answer is better",
    "REFUTED": "REFUTED: a better answer is in hand",
}


@dataclass(frozen=True, eq=False)
class Minimum:
    """A local minimum, aligned with the truth, and how many starts ended there."""

    estimate: Estimate
    cost: float
    certificate: Certificate
    starts: int


def problem() -> tuple[RotationProblem, Estimate]:
    """The near-cycle, and the true rotations."""
    rng = np.random.default_rng(SEED)
    instance = synthetic.orbital(CAMERAS, SIGMA, rng, closures=1, reach=CAMERAS // 2)
    return RotationProblem(instance.graph), instance.truth


def minima(starts: int = STARTS) -> list[Minimum]:
    """The local minima that Newton's method reaches from random starts, lowest first."""
    cameras, truth = problem()
    rng = np.random.default_rng(SEED)
    ends: list[tuple[float, Estimate]] = []
    for _ in range(starts):
        start = Estimate(so.random(rng, cameras.n, cameras.d))
        end = newton(cameras, start, max_iterations=300).estimate
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


def is_minimum(cameras: RotationProblem, point: Estimate) -> bool:
    """Whether the point is stationary and its Hessian definite but for the gauge."""
    if cameras.stationarity(point) > 1e-9:
        return False
    blocks = cameras.hessian(point, cameras.multipliers(point))
    eigenvalues = np.linalg.eigvalsh(cameras.pattern.assemble(*blocks).toarray())
    scaled = eigenvalues / cameras.node_weights.max()
    return bool(scaled[0] > -DEFINITE and scaled[GAUGE] > DEFINITE)


def draw(found: list[Minimum], out: Path) -> None:
    """Cameras by their rotations alone: each looks along its own x axis at the object."""
    matplotlib.use("Agg")
    matplotlib.rcParams["svg.hashsalt"] = "certpgo"  # the same file every time
    from matplotlib import pyplot

    cameras, _ = problem()
    figure = pyplot.figure(figsize=(12.0, 4.8))
    for place, minimum in enumerate(found, start=1):
        axes = figure.add_subplot(1, len(found), place, projection="3d")
        _draw_cameras(axes, cameras, minimum.estimate)
        angle = np.degrees(cameras.residual_angles(minimum.estimate).max())
        axes.set_title(
            f"F = {minimum.cost:.4g}, residuals up to {angle:.3g} degrees\n"
            f"{WORDS.get(minimum.certificate.verdict.value, minimum.certificate.verdict.value)}\n"
            f"{counted(minimum.starts, 'random start{s}')} ended here",
            fontsize=9,
        )
    figure.tight_layout()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, metadata={"Date": None} if out.suffix == ".svg" else None)
    pyplot.close(figure)


def _draw_cameras(axes, cameras: RotationProblem, estimate: Estimate) -> None:
    """Cameras on a sphere around the object, in the order of the orbit; measurements as lines."""
    R = estimate.rotations
    centres = R[:, :, 0]
    colours = matplotlib.colormaps["viridis"](np.linspace(0.0, 1.0, len(R)))
    residuals = cameras.residual_angles(estimate)
    for (i, j), angle in zip(cameras.graph.edges, residuals, strict=True):
        shade = min(angle / 0.5, 1.0)
        axes.plot(*centres[[i, j]].T, color=(shade, 0.1, 0.1), linewidth=0.8 + shade, alpha=0.8)
    for rotation, colour in zip(R, colours, strict=True):
        corners = _frustum(rotation)
        for a, b in ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)):
            axes.plot(*corners[[a, b]].T, color=colour, linewidth=0.8)
    axes.scatter([0.0], [0.0], [0.0], color="black", s=12)
    axes.set_box_aspect((1, 1, 1), zoom=1.4)
    axes.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    axes.set_axis_off()


def _frustum(rotation: FloatArray) -> FloatArray:
    """(5, 3) centre and image corners of a camera that looks at the origin."""
    x, y, z = rotation.T
    image = [0.86 * x + 0.07 * (s * y + t * z) for s, t in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
    return np.array([x, *image])


def main(arguments: list[str] | None = None) -> list[Minimum]:
    """Find, draw, and say what was drawn."""
    default = Path(__file__).parents[1] / "results" / "eriksson2018_figure1.svg"
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, nargs="?", default=default, help="an SVG or PNG file")
    parser.add_argument("--starts", type=int, default=STARTS)
    options = parser.parse_args(arguments)
    if options.starts < 1:
        parser.error(f"--starts must be at least 1, not {options.starts}")
    found = minima(options.starts)[:3]
    if not found:
        parser.exit(1, f"no minimum from {counted(options.starts, 'start{s}')}: try more\n")
    draw(found, options.out)
    for minimum in found:
        ended = counted(minimum.starts, "start{s}")
        print(f"F {minimum.cost:.6g} {minimum.certificate.verdict.value} {ended}")
    print(f"written to {options.out}")
    return found


if __name__ == "__main__":
    main()
