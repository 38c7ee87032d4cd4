"""How long small graphs take: solved and certified one by one, and many of them by threads.

    OPENBLAS_NUM_THREADS=1 python -m reports.studies.small_graphs [--repeat N] [--out FILE]

Cycles of rotations and grids of poses, a new graph each time. Printed as CSV, in milliseconds per
graph: medians of `certpgo.solve` and `certpgo.certify` in process time, the wall time of
`certpgo.solve_many` with one thread and with two, and the second over the first.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from certpgo import Instance, certify, solve, solve_many
from certpgo.graph import Graph
from certpgo.io.datasets.synthetic import cycle, grid3d
from reports.studies._printing import options, print_table

FAMILIES: dict[str, Callable[[np.random.Generator], Instance]] = {
    **{f"cycle of {n}": partial(cycle, n, 0.1) for n in (3, 10, 30, 100)},
    **{f"grid of {side**3}": partial(grid3d, side) for side in (2, 3, 5, 10)},
}


def median(work: Callable[..., object], given: Sequence[tuple[object, ...]]) -> float:
    """Median milliseconds of process time of one call."""
    took = []
    for arguments in given:
        begin = time.process_time()
        work(*arguments)
        took.append(1e3 * (time.process_time() - begin))
    return float(np.median(took))


def together(graphs: Sequence[Graph], workers: int) -> float:
    """Milliseconds of wall time per graph."""
    begin = time.perf_counter()
    for _ in solve_many(graphs, workers=workers):
        pass
    return 1e3 * (time.perf_counter() - begin) / len(graphs)


def rows(repeat: int) -> Iterator[dict[str, object]]:
    """One per family."""
    for name, make in FAMILIES.items():

        def drawn(first: int, make: Callable[..., Instance] = make) -> list[Graph]:
            return [make(rng=np.random.default_rng(first + k)).graph for k in range(repeat)]

        graphs = drawn(0)
        solve(graphs[0])
        pairs = [(graph, solve(graph).estimate) for graph in graphs]
        alone, both = together(drawn(repeat), 1), together(drawn(2 * repeat), 2)
        yield {
            "graph": name,
            "solve": f"{median(solve, [(graph,) for graph in drawn(3 * repeat)]):.3f}",
            "certify": f"{median(certify, pairs):.3f}",
            "one thread": f"{alone:.3f}",
            "two threads": f"{both:.3f}",
            "ratio": f"{both / alone:.2f}",
        }


def main() -> None:
    """Print the table."""
    asked = options(__doc__, repeat=50, out=None)
    print_table(list(rows(asked.repeat)), asked.out)


if __name__ == "__main__":
    main()
