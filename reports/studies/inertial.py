"""Inertial pose graphs: what is certified, by noise and length.

    python -m reports.studies.inertial [--graphs 12] [--sizes N ...] [--out FILE]

A smooth random flight, whose consecutive keyframes, half a second apart, are joined by
preintegrated measurements with known biases (`certpgo.graph.preintegrated`), others by loops.
Neither the direction of gravity nor velocities are known. Printed for each kind: verdicts of
`certpgo.solve`, the median gap over the cost, the median error of velocities in the frame of the
first pose, and seconds of CPU time.
"""

import argparse
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.graph.inertial import GRAVITY
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from reports.studies._printing import print_table

DT = 0.5
#: Standard deviations between two keyframes, rad, m/s and m, of a cheap sensor; and of loops.
GYRO, VELOCITY, POSITION = 0.005, 0.02, 0.01
LOOP_TURN, LOOP_MOVE = 0.02, 0.05
KINDS: Mapping[str, dict[str, float]] = {
    "as specified": {},
    "noise times 5": {"noise": 5.0},
    "noise times 20": {"noise": 20.0},
    "noise times 50": {"noise": 50.0},
    "gyroscope times 50": {"gyro": 50.0},
    "accelerometer times 50": {"accelerometer": 50.0},
    "loops times 20": {"loops": 20.0},
    "no acceleration": {"force": 0.0},
    "two loops": {"share": 0.0},
}


def flight(
    rng: np.random.Generator,
    n: int,
    noise: float = 1.0,
    gyro: float = 1.0,
    accelerometer: float = 1.0,
    loops: float = 1.0,
    force: float = 1.0,
    share: float = 0.2,
) -> tuple[Graph, Estimate, FloatArray]:
    """A random flight of n keyframes: what is measured, its true poses and velocities (n, 3)."""
    spin = np.cumsum(rng.normal(0.0, 0.15, (n, 3)), axis=0)
    R, p, v = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3)), np.zeros((n, 3))
    v[0], a = force * rng.standard_normal(3), force * rng.standard_normal((n, 3))
    for k in range(n - 1):
        R[k + 1] = R[k] @ so.exp(DT * spin[k])
        a[k] -= force * (0.3 * p[k] + 0.8 * v[k])
        p[k + 1] = p[k] + DT * v[k] + DT**2 / 2 * a[k]
        v[k + 1] = v[k] + DT * a[k]

    def turned(i: Any, j: Any, sigma: float) -> FloatArray:
        off = so.exp(sigma * rng.standard_normal((len(i), 3)))
        return np.asarray(np.swapaxes(R[i], 1, 2) @ R[j] @ off)

    def seen(i: Any, x: FloatArray, sigma: float) -> FloatArray:
        there = (np.swapaxes(R[i], 1, 2) @ x[:, :, None])[:, :, 0]
        return np.asarray(there + sigma * rng.standard_normal((len(i), 3)))

    pairs = [(0, n - 1), (0, n // 2)]
    pairs += [tuple(sorted(rng.choice(n, 2, replace=False))) for _ in range(int(share * n))]
    i, j = edges = np.array(pairs).T
    spread = noise * loops
    kappa = np.full(len(i), 0.5 / LOOP_TURN**2)
    closures = RotationGraph(n, edges.T, turned(i, j, spread * LOOP_TURN), kappa)
    moved = seen(i, p[j] - p[i], spread * LOOP_MOVE)
    graph = PoseGraph(closures, moved, np.full(len(i), LOOP_MOVE**-2))
    i, j, by_force = np.arange(n - 1), np.arange(1, n), noise * accelerometer
    fallen = p[j] - p[i] - DT * v[i] - DT**2 / 2 * GRAVITY
    graph = certpgo.with_preintegrated(
        graph,
        np.column_stack([i, j]),
        np.full(n - 1, DT),
        turned(i, j, noise * gyro * GYRO),
        seen(i, v[j] - v[i] - DT * GRAVITY, by_force * VELOCITY),
        seen(i, fallen, by_force * POSITION),
        kappa=0.5 / GYRO**2,
        weights=np.array([VELOCITY, POSITION]) ** -2,
    )
    return graph, Estimate(R, p), v


def rows(graphs: int, sizes: list[int]) -> Iterator[dict[str, object]]:
    """A row for each kind and size."""
    for kind, settings in KINDS.items():
        for n in sizes:
            verdicts, gaps, errors, begun = Counter[str](), [], [], time.process_time()
            for seed in range(graphs):
                graph, _, v = flight(np.random.default_rng((n, seed)), n, **settings)
                answer = certpgo.solve(graph, time_limit=60.0)
                verdicts[answer.verdict.value] += 1
                gaps.append(answer.certificate.gap / answer.cost)
                found = graph.blocks[0].velocities(answer.estimate.anchored(0))[1]  # type: ignore[attr-defined]
                errors.append(float(np.sqrt(np.mean((found - v) ** 2))))
            yield {
                "graphs": kind,
                "keyframes": n,
                **{name: verdicts[name] for name in ("CERTIFIED", "BOUNDED", "UNDECIDED")},
                "gap / cost": f"{np.median(gaps):.1e}",
                "velocities off, m/s": f"{np.median(errors):.3f}",
                "seconds each": f"{(time.process_time() - begun) / graphs:.2f}",
            }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--graphs", type=int, default=12)
    parser.add_argument("--sizes", type=int, nargs="+", default=[7, 30, 100])
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    print_table(list(rows(chosen.graphs, chosen.sizes)), chosen.out)


if __name__ == "__main__":
    main()
