"""Loop closures chosen in several ways: connectivity, and what the optimum loses.

    python -m reports.studies.sparsify [DATASET ...] [--keep SHARE] [--out FILE]

Choices of as many loop closures, odometry always kept: `certpgo.sparsify`'s; MAC's (arXiv
2403.19879), as its authors run it, by 20 Frank-Wolfe steps from the heaviest, with both of their
roundings, the largest fractions and Madow's systematic sample (several
seeds); the heaviest; evenly spread ones; random ones. Printed as CSV: lambda_2, its share
of the bound on all choices, by how much F of all measurements exceeds its optimum, the verdict of
the sparse graph, and the root mean square distance to the whole graph's optimum.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certpgo import solve, sparsify
from certpgo.io import datasets
from certpgo.objective.problem import problem_of
from certpgo.optimize import connectivity
from certpgo.solve.metrics import trajectory_errors
from reports.studies._printing import print_table

GRAPHS = ("sphere2500", "city10000")
#: Frank-Wolfe steps of MAC, and samples of its roundings.
STEPS, SAMPLES = 20, 5


def macs_fractions(
    measure: connectivity.Connectivity, loops: np.ndarray, start: np.ndarray
) -> np.ndarray:
    """(m,) fractions of edges after MAC's steps from a choice of loop closures."""
    among = np.flatnonzero(loops)
    fractions = np.where(loops, 0.0, 1.0)
    fractions[start] = 1.0
    for step in range(STEPS):
        gain = measure(fractions)[1][among]
        vertex = np.where(loops, 0.0, 1.0)
        vertex[among[np.argsort(-gain, kind="stable")[: len(start)]]] = 1.0
        fractions += 2.0 / (step + 2.0) * (vertex - fractions)
    return fractions


def madow(fractions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A systematic sample by fractions: where their sums pass u, u + 1, ... for a random u."""
    passed = np.floor(np.cumsum(fractions) - rng.random())
    return np.flatnonzero(np.diff(passed, prepend=-1.0) > 0.0)


def others(
    measure: connectivity.Connectivity, kappa: np.ndarray, loops: np.ndarray, count: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Other choices of ``count`` loop closures, by name."""
    among = np.flatnonzero(loops)
    heaviest = among[np.argsort(-kappa[among], kind="stable")[:count]]
    fractions = macs_fractions(measure, loops, heaviest)
    yield "MAC, nearest", among[np.argsort(-fractions[among], kind="stable")[:count]]
    for seed in range(SAMPLES):
        yield f"MAC, Madow {seed}", among[madow(fractions[among], np.random.default_rng(seed))]
    yield "heaviest", heaviest
    yield "even", among[(np.arange(count) + 0.5).astype(int) * len(among) // count]
    yield "random", np.random.default_rng(0).choice(among, count, replace=False)


def rows(name: str, keep: float) -> Iterator[dict[str, object]]:
    """One row for each way to choose."""
    instance = datasets.load(name)
    graph = instance.graph
    found = sparsify(instance, keep)
    problem = problem_of(graph)
    measure = connectivity.Connectivity(problem.rotation)
    loops = np.ones(graph.num_edges, dtype=bool)
    loops[np.setdiff1d(found.kept, found.chosen)] = False
    choices = [("certpgo", found.chosen)]
    choices += others(measure, problem.rotation.graph.kappa, loops, len(found.chosen))
    for method, chosen in choices:
        flags = np.where(loops, 0.0, 1.0)
        flags[chosen] = 1.0
        value = measure(flags)[0]
        answer = solve(graph.with_edges(flags > 0.0))
        moved = trajectory_errors(answer.estimate, found.whole.estimate)
        yield {
            "dataset": name,
            "kept": f"{len(found.chosen)} of {found.loops}",
            "choice": method,
            "lambda_2": f"{value:.4g}",
            "of bound": f"{100.0 * value / found.bound:.1f} %",
            "loss": f"{100.0 * (problem.cost(answer.estimate) / found.whole.cost - 1.0):.4g} %",
            "verdict": answer.verdict.value,
            "moved m": f"{moved.ate_m:.4g}",
        }


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("datasets", nargs="*", default=GRAPHS)
    parser.add_argument("--keep", type=float, default=0.2, help="share of the loop closures")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [row for name in options.datasets for row in rows(name, options.keep)]
    print_table(lines, options.out)


if __name__ == "__main__":
    main()
