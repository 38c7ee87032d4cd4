"""Loop closures chosen in several ways: connectivity, and what the optimum loses.

    python -m reports.studies.sparsify [DATASET ...] [--keep SHARE] [--out FILE]

Choices of as many loop closures, odometry always kept: `certpgo.sparsify`'s two; MAC's (arXiv
2403.19879), as its authors run it, by 20 Frank-Wolfe steps from the heaviest, with both of their
roundings, the largest fractions and Madow's systematic sample (several seeds); the heaviest; evenly
spread ones; random ones; and all. Printed as CSV: lambda_2, its share of the bound on all choices,
how many of the measurements labelled wrong are kept, by how much F of the other measurements
exceeds its optimum, the verdict of the sparse graph, and how far it is from that optimum, root mean
square; of rotations whose truth is here, from the truth, with the median.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certpgo import Estimate, Instance, solve, sparsify
from certpgo.io import datasets
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import connectivity
from certpgo.solve.metrics import angular_errors, trajectory_errors
from reports.studies._printing import print_table

#: Graphs, and the share of loop closures to keep; more where some are wrong.
SHARES = {
    "sphere2500": 0.2,
    "city10000": 0.2,
    "intel": 0.2,
    "grid1000_10p_outliers": 0.5,
    "grid1000_50p_outliers": 0.5,
    "Ellis_Island": 0.5,
}
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


def distances(instance: Instance, best: Estimate, estimate: Estimate) -> dict[str, str]:
    """Metres and degrees from the optimum, or from the truth of a rotation graph."""
    known = datasets.truth(instance.name, instance)
    if best.translations is None and known is not None:
        nodes, truth = known
        errors = angular_errors(estimate.subset(nodes), truth, norm="l1")
        return {
            "moved m": "",
            "moved deg": f"{errors.rmse_deg:.4g}",
            "median deg": f"{errors.median_deg:.4g}",
        }
    moved = trajectory_errors(estimate, best)
    return {"moved m": f"{moved.ate_m:.4g}", "moved deg": f"{moved.ate_deg:.4g}", "median deg": ""}


def rows(name: str, keep: float) -> Iterator[dict[str, object]]:
    """One row for each way to choose."""
    instance = datasets.load(name)
    graph = instance.graph
    found = sparsify(instance, keep)
    wrong = np.zeros(graph.num_edges, dtype=bool)
    best = found.whole
    if instance.outliers is not None:
        wrong = instance.outliers
        best = solve(graph.with_edges(~wrong), cost="chordal")
    problem = Quadratic(graph.with_edges(~wrong))
    measure = connectivity.Connectivity(Quadratic(graph).rotation)
    loops = np.ones(graph.num_edges, dtype=bool)
    loops[np.setdiff1d(found.kept, found.chosen)] = False
    choices = [
        ("connectivity", found.chosen),
        ("spectrum", sparsify(instance, keep, by="spectrum").chosen),
        *others(measure, graph.kappa, loops, len(found.chosen)),
        ("all", np.flatnonzero(loops)),
    ]
    for method, chosen in choices:
        flags = np.where(loops, 0.0, 1.0)
        flags[chosen] = 1.0
        value = measure(flags)[0]
        answer = solve(graph.with_edges(flags > 0.0), cost="chordal")
        yield {
            "dataset": name,
            "kept": f"{len(chosen)} of {found.loops}",
            "choice": method,
            "lambda_2": f"{value:.4g}",
            "of bound": "" if method == "all" else f"{100.0 * value / found.bound:.1f} %",
            "wrong": f"{wrong[chosen].sum()} of {wrong.sum()}" if wrong.any() else "",
            "loss": f"{100.0 * (problem.cost(answer.estimate) / best.cost - 1.0):.4g} %",
            "verdict": answer.verdict.value,
            **distances(instance, best.estimate, answer.estimate),
        }


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("datasets", nargs="*", default=tuple(SHARES))
    parser.add_argument("--keep", type=float, help="share of the loop closures")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        row
        for name in options.datasets
        for row in rows(name, options.keep or SHARES.get(name, 0.2))
    ]
    print_table(lines, options.out)


if __name__ == "__main__":
    main()
