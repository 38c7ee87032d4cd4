"""A monocular map whose scale drifts: before, after and beside others, with certificates.

    python -m reports.studies.scale_drift [--every K] [--walk S ...] [--seeds N]

The trajectory is the optimum of kitti_00, in space, every K-th pose. Odometry knows no scale, whose
logarithm walks with steps of S; loops measure the scale too. The table has the root mean square
error of positions, after the best similarity, of odometry, of the graph taken as one of poses, of F
with the unit of the mean, of the same with pose 0 as the unit, and of GTSAM's Similarity3 by
descent from odometry and from our answer, with GTSAM's error; then the error of `fit_logarithms`,
its cost over two, which is GTSAM's error, and the relative gap of its bound for these scales.
"""

import argparse
import time
import warnings
from dataclasses import replace

import numpy as np

import certpgo
from certpgo import Estimate
from certpgo.graph import SimilarityGraph
from certpgo.io import datasets
from certpgo.io.datasets.monocular import drifting, in_one_unit
from certpgo.objective.similarity_problem import SimilarityProblem
from certpgo.solve.metrics import position_errors

ROW = "{:>6}{:>6}{:>10}{:>10}{:>10}{:>10}{:>13}{:>12}{:>22}{:>22}{:>28}"
#: Seconds for each search.
LIMIT = 60.0


def trajectory(every: int) -> tuple[Estimate, np.ndarray]:
    """Every so many poses of kitti_00 in space, and the loops between them."""
    instance = datasets.load("kitti_00", download=False, quiet=True)
    best = certpgo.solve(instance).estimate
    kept = np.arange(0, best.num_nodes, every)
    R = np.tile(np.eye(3), (len(kept), 1, 1))
    R[:, :2, :2] = best.rotations[kept]
    t = np.concatenate([best.translations[kept], np.zeros((len(kept), 1))], axis=1)
    i, j = np.sort(instance.graph.edges // every, axis=1).T
    loops = np.unique(np.stack([i, j], axis=1)[(j - i > 1) & (j < len(kept))], axis=0)
    return Estimate(R, t), loops


def error(found: Estimate, truth: Estimate) -> float:
    """Root mean square of positions after the best similarity, metres."""
    return position_errors(found, truth, scaled=True).rmse


def odometry(graph: SimilarityGraph) -> Estimate:
    """Poses composed step by step, of scale 1."""
    n = graph.num_nodes
    R, t = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
    for k in range(n - 1):
        R[k + 1] = R[k] @ graph.rotation.rotations[k]
        t[k + 1] = t[k] + R[k] @ graph.translations[k]
    return Estimate(R, t, scales=np.ones(n))


def by_gtsam(problem: SimilarityProblem, start: Estimate) -> tuple[Estimate, float]:
    """Levenberg and Marquardt's end from a start, with GTSAM's error."""
    import gtsam

    graph, values = certpgo.to_gtsam(problem, start)
    whole = gtsam.NonlinearFactorGraph(graph)
    fixed = gtsam.noiseModel.Isotropic.Sigma(7, 1e-6)
    whole.add(gtsam.PriorFactorSimilarity3(0, values.atSimilarity3(0), fixed))
    end = gtsam.LevenbergMarquardtOptimizer(whole, values).optimize()
    return certpgo.from_gtsam(graph, end)[1], graph.error(end)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--walk", type=float, nargs="+", default=[0.005, 0.01, 0.02])
    parser.add_argument("--seeds", type=int, default=3)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    truth, loops = trajectory(asked.every)
    print(f"{truth.num_nodes} poses, {len(loops)} loops")
    names = ("walk", "seed", "odometry", "poses", "mean unit", "pose 0", "verdict", "seconds")
    print(ROW.format(*names, "GTSAM from odometry", "GTSAM from ours", "logarithms"))
    for walk in asked.walk:
        for seed in range(asked.seeds):
            graph, _ = drifting(truth, loops, np.random.default_rng(seed), walk=walk)
            held = replace(graph, free=np.arange(graph.num_nodes) != 0)
            begun = time.perf_counter()
            answer = certpgo.solve(graph, time_limit=LIMIT)
            seconds = time.perf_counter() - begun
            start = odometry(graph)
            flat = certpgo.solve(in_one_unit(graph), time_limit=LIMIT).estimate
            anchored = certpgo.solve(held, time_limit=LIMIT).estimate
            errors = [error(found, truth) for found in (start, flat, answer.estimate, anchored)]
            theirs = []
            for begin in (start, answer.estimate):
                found, cost = by_gtsam(SimilarityProblem(graph), begin)
                theirs.append(f"{error(found, truth):.2f} m, {cost:.1f}")
            fit = certpgo.fit_logarithms(graph, time_limit=LIMIT)
            gap = 1.0 - fit.lower_bound(1.0) / fit.cost
            off = error(fit.estimate, truth)
            theirs.append(f"{off:.2f} m, {fit.cost / 2.0:.1f}, {gap:.1%}")
            shown = (f"{x:.2f}" for x in errors)
            print(
                ROW.format(walk, seed, *shown, answer.verdict, f"{seconds:.2f}", *theirs),
                flush=True,
            )


if __name__ == "__main__":
    main()
