"""Algorithm 1 of Eriksson et al. on cycles: the relaxation's error at several stopping rules."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from certpgo import Quadratic
from certpgo.io.datasets.synthetic import orbital
from certpgo.optimize.methods.block_coordinate_descent import BlockCoordinateDescent
from reports.studies.printed_rows.local_search import optimum

#: Errors of Algorithm 1 that Table 1 prints, by the number of cameras and sigma.
PRINTED = {(20, 0.2): 9.34e-10, (20, 0.5): 3.94e-08, (50, 0.2): 1.3e-09}
#: A run ends when a sweep gains less than this part of the objective (P).
RULES = (1e-8, 1e-10, 1e-12, 1e-14)
INSTANCES, SWEEPS = 10, 20_000


def rows() -> Iterator[tuple[str, ...]]:
    """A row for each size and noise: mean errors, ours at our own rule first."""
    for (n, sigma), printed in PRINTED.items():
        errors: list[list[float]] = []
        for number in range(INSTANCES):
            rng = np.random.default_rng([n, round(10 * sigma), number])
            graph = orbital(n, sigma, rng).graph
            best = float(optimum(graph.rotations[None])[0])
            errors.append([ours(Quadratic(graph)) - best, *_at_rules(Quadratic(graph), best)])
        means, largest = np.mean(errors, axis=0), np.max(errors, axis=0)
        cells = (f"{mean:.1e} ({most:.1e})" for mean, most in zip(means, largest, strict=True))
        yield str(n), f"{sigma:g}", f"{printed:.2e}", *cells


def ours(problem: Quadratic) -> float:
    """The relaxation's value where our implementation stops: at a gap of 1e-6 of F."""
    return BlockCoordinateDescent().solve(problem).relaxation.value


def _at_rules(problem: Quadratic, best: float) -> Iterator[float]:
    """The relaxation's value less the optimum, where each rule ends the run."""
    point = BlockCoordinateDescent().coordinates(problem, np.eye(problem.n * problem.d))
    whole = 2.0 * problem.d * float(problem.graph.kappa.sum())
    cost, left = point.evaluate()[0], list(RULES)
    for sweep in range(1, SWEEPS + 1):
        decrease, _ = point.sweep()
        cost -= decrease
        if sweep & (sweep - 1) == 0 and sweep >= 8:
            point.compress()
        while left and decrease <= left[0] * (whole - cost):
            left.pop(0)
            yield point.evaluate()[0] - best
        if not left:
            return
    for _ in left:  # at the limit
        yield point.evaluate()[0] - best
