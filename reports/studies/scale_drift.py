"""A monocular map whose scale drifts: how far off maps are, and where descents end.

    python -m reports.studies.scale_drift [--every K] [--walk S ...] [--seeds N]
    python -m reports.studies.scale_drift --basins [--every K] [--seeds N] [--by-gtsam] [--unit M]

The trajectory is the optimum of kitti_00, in space, every K-th pose. Odometry knows no scale, whose
logarithm walks with steps of S; loops measure the scale too. The table has the root mean square
error of positions, after the best similarity, of odometry, of the graph taken as one of poses, of F
with the unit of the mean, and of the same with pose 0 as the unit, the last three with their
verdicts; then the error of `fit_logarithms`, its cost over two, which is GTSAM's error, and the
relative gap of its bound for these scales.

With --basins the table has a row a setting, of --seeds graphs, and a column a start: odometry;
GTSAM's FastSync with M metres as its unit, or the length of the drive; the answer of `solve` after
10 s at most; and scales that fit best, then poses, where `fit_logarithms` begins. From each a
descent on the cost of logarithms, or GTSAM's on the same cost, takes at most 300 steps. An end is
in a wrong basin if it costs over 1 % more than the least of these ends and of that from the truth.
A cell has their number, how many of these were still descending, and the median errors of the
starts and ends.
"""

import argparse
import math
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

import certpgo
from certpgo import Estimate
from certpgo.errors import GraphError
from certpgo.graph import Graph
from certpgo.io import datasets
from certpgo.io.datasets.monocular import drifting, in_one_unit, keyframes, odometry
from certpgo.linalg.arrays import IntArray
from certpgo.objective.logarithms import LogarithmCost
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.similarity_starts import separate_start
from certpgo.optimize.solution import Status
from certpgo.solve.logarithms import STEPS, TOLERANCE
from certpgo.solve.metrics import position_errors

ROW = "{:>6}{:>6}{:>10}{:>19}{:>19}{:>9}{:>19}{:>28}"
#: Seconds for each search, and for that of a start.
LIMIT, SHORT = 60.0, 10.0
#: Steps of the logarithm of scale, and of rotations, radians, in the settings of --basins.
SETTINGS = (
    *((walk, 0.002) for walk in (0.005, 0.01, 0.02, 0.04)),
    *((0.02, turn) for turn in (0.06, 0.1, 0.15)),
)
#: Above this share of the least cost an end is in another basin.
MARGIN = 0.01


class End(NamedTuple):
    """Where a descent ends, or None if it diverged; GTSAM's error there; whether it was cut."""

    estimate: Estimate | None
    cost: float
    cut: bool


def error(found: Estimate | None, truth: Estimate) -> float:
    """Root mean square of positions after the best similarity, metres."""
    return math.inf if found is None else position_errors(found, truth, scaled=True).rmse


def drives(
    truth: Estimate, loops: IntArray, seeds: int, **noise: float
) -> Iterator[tuple[int, Graph, Estimate]]:
    """Each seed with its graph, and the truth with scales."""
    for seed in range(seeds):
        yield seed, *drifting(truth, loops, np.random.default_rng(seed), **noise)


def fast_sync(graph: Graph, unit: float) -> Estimate:
    """GTSAM's FastSync in a unit of length, each measurement with the one weight 2 kappa.

    It minimises |X_j - X_i S_ij|^2 over matrices, one of which is the identity, and takes rotation,
    translation and scale from each.
    """
    import gtsam

    measured = replace(graph, translations=graph.translations / unit)
    factors, _ = certpgo.to_gtsam(measured, odometry(measured))
    isotropic = gtsam.NonlinearFactorGraph()
    for k, kappa in enumerate(graph.kappa.tolist()):
        factor, noise = factors.at(k), gtsam.noiseModel.Isotropic.Precision(7, 2.0 * kappa)
        step = gtsam.BetweenFactorSimilarity3(*factor.keys(), factor.measured(), noise)
        isotropic.push_back(step)
    found = certpgo.from_gtsam(factors, gtsam.fastSyncSimilarity3(isotropic))[1]
    return replace(found, translations=unit * found.translations)


def length(graph: Graph) -> float:
    """The length of the drive in the units of its frames."""
    return float(np.linalg.norm(graph.translations[: graph.num_nodes - 1], axis=1).sum())


def starts(unit: float | None) -> dict[str, Callable[[Graph], Estimate]]:
    """Where descents begin, with the unit of FastSync, metres."""
    return {
        "odometry": odometry,
        "FastSync": lambda graph: fast_sync(graph, unit or length(graph)),
        "solve": lambda graph: certpgo.solve(graph, time_limit=SHORT).estimate,
        "scales, then poses": lambda graph: separate_start(Quadratic(graph)),
    }


def descent(graph: Graph, start: Estimate) -> End:
    """The end of ours from a start."""
    problem = LogarithmCost(graph)
    end = descend(problem, start, tolerance=TOLERANCE, max_iterations=STEPS)
    return End(end.estimate, end.cost / 2.0, end.status is Status.ITERATION_LIMIT)


def by_gtsam(graph: Graph, start: Estimate) -> End:
    """The end of GTSAM's Levenberg and Marquardt."""
    import gtsam

    factors, values = certpgo.to_gtsam(graph, start)
    whole = gtsam.NonlinearFactorGraph(factors)
    fixed = gtsam.noiseModel.Isotropic.Sigma(7, 1e-6)
    whole.add(gtsam.PriorFactorSimilarity3(0, values.atSimilarity3(0), fixed))
    settings = gtsam.LevenbergMarquardtParams()
    settings.setMaxIterations(STEPS)
    optimizer = gtsam.LevenbergMarquardtOptimizer(whole, values, settings)
    end = optimizer.optimize()
    try:
        found = certpgo.from_gtsam(factors, end)[1]
    except GraphError:  # scales beyond all bounds
        return End(None, math.inf, False)
    cost = factors.error(end)
    if math.isnan(cost):
        return End(None, math.inf, False)
    return End(found, cost, optimizer.iterations() >= STEPS)


def basins(
    truth: Estimate,
    loops: IntArray,
    seeds: int,
    begin: dict[str, Callable[[Graph], Estimate]],
    to_end: Callable[[Graph, Estimate], End],
) -> Iterator[str]:
    """The lines of the table of ends."""
    yield f"| walk | turn, rad | {' | '.join(begin)} |"
    yield "| --- " * (2 + len(begin)) + "|"
    for walk, turn in SETTINGS:
        off, costs, cut = [], [], []
        for _, graph, scaled in drives(truth, loops, seeds, walk=walk, turn=turn):
            maps = [*(start(graph) for start in begin.values()), scaled]
            ends = [to_end(graph, start) for start in maps]
            off.append(
                [[error(x, truth) for x in maps], [error(end.estimate, truth) for end in ends]]
            )
            costs.append([end.cost for end in ends])
            cut.append([end.cut for end in ends])
        wrong = np.array(costs) > (1.0 + MARGIN) * np.min(costs, axis=1, keepdims=True)
        unfinished = (wrong & np.array(cut)).sum(axis=0)
        before, after = np.median(off, axis=0)
        cells = [
            f"{wrong[:, k].sum()}{f' ({unfinished[k]} cut)' if unfinished[k] else ''}: "
            f"{before[k]:.1f} to {after[k]:.1f} m"
            for k in range(len(begin))
        ]
        yield f"| {walk:.1%} | {turn:g} | {' | '.join(cells)} |"


def errors(truth: Estimate, loops: IntArray, seeds: int, walks: list[float]) -> Iterator[str]:
    """The lines of the table of errors."""
    names = ("walk", "seed", "odometry", "poses", "mean unit", "seconds", "pose 0", "logarithms")
    yield ROW.format(*names)
    for walk in walks:
        for seed, graph, _ in drives(truth, loops, seeds, walk=walk):
            held = graph.with_unknown_scales(np.arange(graph.num_nodes) != 0)
            begun = time.perf_counter()
            answer = certpgo.solve(graph, time_limit=LIMIT)
            seconds = time.perf_counter() - begun
            flat = certpgo.solve(in_one_unit(graph), time_limit=LIMIT)
            anchored = certpgo.solve(held, time_limit=LIMIT)
            begin = f"{error(odometry(graph), truth):.2f}"
            poses, mean, first = (
                f"{error(found.estimate, truth):.2f}, {found.verdict}"
                for found in (flat, answer, anchored)
            )
            fit = certpgo.fit_logarithms(graph, time_limit=LIMIT)
            gap = 1.0 - fit.lower_bound(1.0) / fit.cost
            fitted = f"{error(fit.estimate, truth):.2f} m, {fit.cost / 2.0:.1f}, {gap:.1%}"
            yield ROW.format(walk, seed, begin, poses, mean, f"{seconds:.2f}", first, fitted)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--walk", type=float, nargs="+", default=[0.005, 0.01, 0.02])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--basins", action="store_true")
    parser.add_argument("--by-gtsam", action="store_true")
    parser.add_argument("--unit", type=float, help="of FastSync, metres")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    instance = datasets.load("kitti_00", download=False, quiet=True)
    driven = certpgo.solve(instance).estimate
    truth, loops = keyframes(driven, instance.graph.edges, asked.every)
    print(f"{truth.num_nodes} poses, {len(loops)} loops")
    if asked.basins:
        to_end = by_gtsam if asked.by_gtsam else descent
        lines = basins(truth, loops, asked.seeds, starts(asked.unit), to_end)
    else:
        lines = errors(truth, loops, asked.seeds, asked.walk)
    for line in lines:
        print(line, flush=True)


if __name__ == "__main__":
    main()
