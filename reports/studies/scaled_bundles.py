"""Scaled bundle adjustment: verdicts, time and memory, and what holding the scale of a camera does.

    python -m reports.studies.scaled_bundles [FILE ...] [--cameras N ...] [--noise X ...]
        [--points K] [--seen M] [--out FILE]

For files of XM's observations, and for rings of cameras that see points at depths of a unit of each
camera's own, see `certpgo.io.datasets.monocular.ring_of_depths`: K points a camera, each seen by M
cameras. A scene is solved in the mean unit, and with the scale of the first camera held. Logarithms
of scales are those of the answer over the true ones, less that of the first camera: their mean over
the others is 0 where nothing shrinks. Of files, whose true scales are not known, the answer in the
mean unit counts as true. Seconds are of CPU time; memory is the process's largest so far.
"""

import argparse
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import certpgo
from certpgo.graph import Graph
from certpgo.io.datasets.monocular import ring_of_depths
from certpgo.linalg.arrays import FloatArray
from reports.studies._printing import print_table

Row = dict[str, object]


def rows(name: str, graph: Graph, true: FloatArray | None) -> Iterator[Row]:
    """The answers in the mean unit, and with the first camera's scale held."""
    n = len(graph.pose_nodes)
    free = graph.free.copy()
    free[graph.pose_nodes[0]] = False
    for unit, one in (("mean", graph), ("first camera", graph.with_unknown_scales(free))):
        begin = time.process_time()
        answer = certpgo.solve(one)
        seconds, memory = time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF)
        scales = answer.estimate.scales[:n]
        true = scales if true is None else true
        off = np.log(scales / true)
        off -= off[0]
        yield {
            "scene": name,
            "cameras": n,
            "points": graph.num_nodes - n,
            "sightings": graph.num_edges,
            "unit": unit,
            "verdict": answer.verdict.value,
            "cost": f"{answer.cost:.9g}",
            "gap / cost": f"{answer.certificate.gap / max(answer.cost, 1e-300):.1e}",
            "log scales, mean": f"{off[1:].mean():+.3f}",
            "spread": f"{off[1:].std():.3f}",
            "seconds": f"{seconds:.1f}",
            "GB": f"{memory.ru_maxrss / 1e6:.2f}",
        }


def scenes(
    files: list[str], cameras: list[int], noises: list[float], points: int, seen: int
) -> Iterator[tuple[str, Graph, FloatArray | None]]:
    """Names, graphs, and true scales of cameras where they are known."""
    for file in files:
        yield Path(file).parent.name, certpgo.read(file, quiet=True).graph, None
    for n in cameras:
        for noise in noises:
            rng = np.random.default_rng(0)
            graph, truth = ring_of_depths(n, points * n, min(seen, n // 2), rng, noise=noise)
            yield f"ring, {100 * noise:g} % of depth", graph, truth.scales[:n]


def main(arguments: list[str] | None = None) -> None:
    """Print the table, and write it to a file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", metavar="FILE")
    parser.add_argument("--cameras", type=int, nargs="+", default=[100], metavar="N")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.01, 0.03, 0.1], metavar="X")
    parser.add_argument("--points", type=int, default=20, metavar="K")
    parser.add_argument("--seen", type=int, default=15, metavar="M")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args(arguments)
    each = scenes(asked.files, asked.cameras, asked.noise, asked.points, asked.seen)
    print_table([row for scene in each for row in rows(*scene)], asked.out)


if __name__ == "__main__":
    main()
