"""Landmarks and ranges: GTSAM's answers, ours, and what each may claim.

    python -m reports.studies.maps [DATASET ...]

GTSAM's Levenberg-Marquardt begins at poses composed along a tree, with points where they are first
seen; ranges are its RangeFactor, sightings its BearingRangeFactor with noise to first order. Its
answers and ours are compared in our cost F. It has no certificate of its own for these; a
certificate of the relaxation alone, as of CORA or of GTSAM's certifiable range example, says
"certified" wherever the relaxation is solved, whether or not it is tight: the last column has that
beside our verdict.
"""

import time
import warnings

import gtsam
import numpy as np

import certpgo
from certpgo import Estimate, Instance, Quadratic, certify
from certpgo.graph.points import with_points
from certpgo.graph.trees import tree_initialization
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Sum, objective_of
from reports.studies._printing import options

DATASETS = (
    "cityTrees10000",
    "victoria_park",
    "VO_stereo_factors00s",
    "factor_graph_small",
    "goats_15",
    "goats_16",
    "mrclam5a",
    "plaza2",
    "single_drone",
)
ROW = "{:22}{:>13}{:>6}{:>12}{:>13}{:>10}{:>6}  {}"


def rows(name: str) -> str:
    """The line of a dataset."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        instance = datasets.load(name)
    problem = objective_of(instance, "chordal")
    begin = time.perf_counter()
    theirs = by_gtsam(instance, problem)
    seconds = time.perf_counter() - begin
    cost = problem.cost(theirs)
    begin = time.perf_counter()
    answer = certpgo.solve(problem)
    ours = time.perf_counter() - begin
    certificate = answer.certificate
    if isinstance(problem, Sum):
        excess = cost / max(answer.cost, 1e-12) - 1.0
        judged = "same" if excess < 1e-5 else f"+{100 * excess:.2g} %"
        solved = "is solved" in certificate.reason
        claim = f"certified at rank {answer.levels[-1].rank}" if solved else "none"
    else:
        judged = certify(problem, theirs, refine=False).verdict.value.lower()[:7]
        claim = "the same, as it is tight"
    said = f"{certificate.verdict.value}; of the relaxation alone: {claim}"
    mine = f"{answer.cost:.8g}", f"{certificate.relative_gap:.2g}", f"{ours:.1f}"
    return ROW.format(name, f"{cost:.8g}", f"{seconds:.1f}", judged, *mine, said)


def by_gtsam(instance: Instance, problem: Quadratic | Sum) -> Estimate:
    """The answer of Levenberg and Marquardt's method."""
    start = first_guess(problem)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph, d = instance.graph, instance.graph.d
    points = graph.is_point
    for k in range(graph.num_nodes):
        t = start.translations[k]
        values.insert(k, t if points[k] else _pose_of(start.rotations[k], t))
    rotation = graph.rotations_alone
    for e, (i, j) in enumerate(graph.edges.tolist()):
        kappa, tau, t = rotation.kappa[e], graph.tau[e], graph.translations[e]
        if points[j]:
            factors.add(sighting(i, j, t, tau))
        else:
            axes = 1 if d == 2 else 3
            turn, move = np.full(axes, 2.0 * kappa), np.full(d, tau)
            order = (move, turn) if d == 2 else (turn, move)
            noise = gtsam.noiseModel.Diagonal.Precisions(np.concatenate(order))
            between = gtsam.BetweenFactorPose2 if d == 2 else gtsam.BetweenFactorPose3
            factors.add(between(i, j, _pose_of(rotation.rotations[e], t), noise))
    if instance.graph.ranges is not None:
        for (i, j), distance, weight in zip(
            instance.graph.ranges.edges.tolist(),
            instance.graph.ranges.distances,
            instance.graph.ranges.weights,
            strict=True,
        ):
            noise = gtsam.noiseModel.Isotropic.Precision(1, weight)
            first, second = (j, i) if points[i] else (i, j)
            kind = "Pose" if not points[second] else ""
            name = f"RangeFactor{kind}{d}" if kind else f"RangeFactor{d}D"
            factors.add(getattr(gtsam, name)(first, second, distance, noise))
    first = int(graph.pose_nodes[0])
    fixed = gtsam.noiseModel.Constrained.All(3 if d == 2 else 6)
    prior = gtsam.PriorFactorPose2 if d == 2 else gtsam.PriorFactorPose3
    at = values.atPose2 if d == 2 else values.atPose3
    factors.add(prior(first, at(first), fixed))
    found = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    return _estimate_of(found, points, d)


def first_guess(problem: Quadratic | Sum) -> Estimate:
    """Poses along a tree, and points where they are first seen or some way off."""
    graph = problem.measured
    nodes = graph.pose_nodes
    between = np.isin(graph.edges, nodes).all(axis=1) & (graph.kappa > 0.0)
    alone = graph.with_edges(between).subgraph(nodes) if between.any() else None
    if alone is not None and alone.is_connected:
        start = with_points(graph, tree_initialization(alone), nodes)
    else:
        start = tree_initialization(problem.graph)
    t = start.translations.copy()
    if isinstance(problem, Sum):
        unseen = np.setdiff1d(np.setdiff1d(np.arange(problem.n), nodes), graph.edges)
        off = np.random.default_rng(0).standard_normal((len(unseen), problem.d))
        t[unseen] += float(np.median(graph.ranges.distances)) * off
    return Estimate(start.rotations, t)


def _pose_of(R: np.ndarray, t: np.ndarray) -> "gtsam.Pose2 | gtsam.Pose3":
    if len(t) == 2:
        return gtsam.Pose2(t[0], t[1], np.arctan2(R[1, 0], R[0, 0]))
    return gtsam.Pose3(gtsam.Rot3(R), t)


def sighting(i: int, j: int, t: np.ndarray, tau: float) -> "gtsam.NonlinearFactor":
    """A bearing and a range for where a point is seen."""
    length, sigma = float(np.linalg.norm(t)), float(tau) ** -0.5
    if len(t) == 2:
        noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma / length, sigma]))
        return gtsam.BearingRangeFactor2D(i, j, gtsam.Rot2.atan2(t[1], t[0]), length, noise)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma / length] * 2 + [sigma]))
    return gtsam.BearingRangeFactor3D(i, j, gtsam.Unit3(t), length, noise)


def _estimate_of(values: "gtsam.Values", points: np.ndarray, d: int) -> Estimate:
    R, t = np.tile(np.eye(d), (len(points), 1, 1)), np.zeros((len(points), d))
    for k, is_point in enumerate(points):
        if is_point:
            t[k] = values.atPoint2(k) if d == 2 else values.atPoint3(k)
        else:
            pose = values.atPose2(k) if d == 2 else values.atPose3(k)
            M = pose.matrix()
            R[k], t[k] = M[:d, :d], M[:d, d]
    return Estimate(so.project(R), t)


def main() -> None:
    """Print the table."""
    arguments = options(__doc__, datasets=DATASETS)
    print(ROW.format("graph", "GTSAM: F", "s", "is", "ours: F", "gap", "s", "verdict"))
    for name in arguments.datasets:
        print(rows(name), flush=True)


if __name__ == "__main__":
    main()
