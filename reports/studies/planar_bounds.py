"""Bounds in the plane over real and over complex numbers, at the certified search's estimate.

    python -m reports.studies.planar_bounds [NAME ...] [--time-limit SECONDS] [--out FILE]

For each graph and cost: the verdict and the cost of `certpgo.solve`; then, from its estimate alone,
the lower bounds of both relaxations of the first surrogate, as shares of the cost. Seconds are of
the search, in CPU time. Sets with strongly correlated noise are those of PUDQ, levels 1 to 5.
"""

import time
from collections.abc import Iterator

import certpgo
from certpgo.certify.bound import bound_by
from certpgo.io import datasets
from certpgo.objective.choose_cost import objective_of
from reports.studies._printing import options, print_table

NAMES = (
    *("M3500a", "M3500b", "M3500c", "pudq_Grid1000_1", "pudq_Grid1000_3", "pudq_Grid1000_5"),
    *("pudq_M3500_1", "pudq_M3500_4", "MIT", "intel", "kitti_00", "manhattan"),
)
COSTS = ("chordal", "g2o", "gtsam")


def rows(name: str, limit: float) -> Iterator[dict[str, object]]:
    """A row for each cost."""
    instance = datasets.load(name, download=False, quiet=True)
    for cost in COSTS:
        begin = time.process_time()
        answer = certpgo.solve(instance, cost=cost, time_limit=limit)
        seconds = time.process_time() - begin
        problem = objective_of(instance, cost)
        surrogate = problem.surrogate(answer.estimate)
        bounds = [bound_by(surrogate, answer.estimate, real=real) for real in (True, False)]
        over_real, over_complex = (
            max(0.0, found.value) / answer.cost if found else 0.0 for found in bounds
        )
        yield {
            "graph": name,
            "cost": cost,
            "verdict": answer.verdict.value,
            "at the estimate": f"{answer.cost:.9g}",
            "gap / cost": f"{answer.certificate.gap / answer.cost:.1e}",
            "1 - real bound": f"{1.0 - over_real:.1e}",
            "1 - better bound": f"{1.0 - over_complex:.1e}",
            "seconds": f"{seconds:.1f}",
        }


def main() -> None:
    """Print the table, and write it."""
    asked = options(__doc__, names=NAMES, time_limit=30.0, out=None)
    names = asked.names
    print_table([row for name in names for row in rows(name, asked.time_limit)], asked.out)


if __name__ == "__main__":
    main()
