"""What taking back a rejected measurement costs at least, and sets that cannot all be right."""

import numpy as np
import pytest
from strategies import rng_of
from test_truncated import doubtful_graph

from certpgo import Instance, solve, solve_robustly, with_priors
from certpgo.certify.rises import LOAD
from certpgo.errors import InputError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.succession import succession
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.methods._robust import connected
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import budgets, cores, odometry, proven_rises, rises_over
from certpgo.solve.outlier_report import outlier_report


@pytest.mark.parametrize("seed", range(8))
def test_rises_are_below_those_of_the_optimum(seed):
    rng = rng_of(seed)
    graph, doubtful = doubtful_graph(rng, 2 + seed % 2, poses=seed % 4 < 2)
    problem = TruncatedCost(Quadratic(graph), np.where(doubtful, 10.0, np.inf))
    kept = solve(problem.kept)
    found = proven_rises(problem, kept.estimate, Stop())
    assert (found > 0.0).any()
    for e, rise in zip(problem.rejected, found, strict=True):
        factors = np.where(doubtful, 0.0, 1.0)
        factors[e] = 1.0
        with_e = solve(graph.reweighted(factors), initial=kept.estimate)
        assert rise <= with_e.cost - kept.certificate.lower_bound + 1e-9 * kept.cost


@pytest.mark.parametrize("d", [2, 3])
def test_the_rise_of_a_small_angle_is_that_of_linear_least_squares(d):
    # Weights 3 and 1: the resistance of the kept one is 1/3, of which the load takes a share.
    angle = 0.01
    turn = so.exp(np.array([[angle] if d == 2 else [0.0, 0.0, angle]]))
    graph = RotationGraph(2, [[0, 1]] * 2, np.concatenate([np.eye(d)[None], turn]), [3.0, 1.0])
    problem = TruncatedCost(Quadratic(graph), [np.inf, 1.0])
    [rise] = proven_rises(problem, Estimate(np.tile(np.eye(d), (2, 1, 1))), Stop())
    assert rise == pytest.approx(2.0 * angle**2 / (1.0 + 1.0 / (3.0 * LOAD)), rel=1e-4)


def test_budgets_are_quantiles_in_space_and_above_them_in_the_plane():
    rng = rng_of(0)
    for d, poses in ((3, True), (3, False), (2, True), (2, False)):
        graph, _ = doubtful_graph(rng, d, poses=poses)
        [budget] = set(budgets(Quadratic(graph), 0.01))
        turns = (rng.normal(size=(100_000, so.tangent_dim(d))) ** 2).sum(axis=1)
        squares = turns * (2.0 if d == 2 else 1.0)
        if poses:
            squares = squares + (rng.normal(size=(100_000, d)) ** 2).sum(axis=1)
        beyond = float((squares > budget).mean())
        assert beyond < 0.0115
        assert beyond > 0.0085 or (d == 2 and poses)


def steps_of(graph):
    """Measurements from each node to the next one by number."""
    order = succession(Instance("graph", graph, np.arange(graph.num_nodes)))
    return odometry(graph, order)


@pytest.mark.parametrize("seed", range(6))
def test_no_right_measurement_is_refuted(seed):
    rng = rng_of(seed)
    instance = synthetic.grid3d(3, rng)
    graph = instance.graph
    problem, stop, trusted = Quadratic(graph), Stop(), steps_of(graph)
    weights = np.where(trusted | (rng.random(graph.num_edges) < 0.6), 1.0, 0.0)
    weights = connected(problem, weights, np.ones_like(weights))
    prices, doubtful = np.where(weights > 0.0, np.inf, 10.0), np.flatnonzero(weights == 0.0)
    truncated = TruncatedCost(problem, prices)
    budget = budgets(problem)
    found = proven_rises(truncated, solve(truncated.kept).estimate, stop)
    assert (found <= budget[doubtful]).all()
    over = rises_over(problem, trusted, doubtful, stop)
    assert over is None or (over <= budget[doubtful]).all()
    assert cores(problem, np.isinf(prices), doubtful, budget, stop) == []


def test_cores_share_nothing_and_each_has_a_wrong_measurement(dataset):
    instance = dataset("grid1000_10p_outliers")
    report = outlier_report(solve_robustly(instance, cost="g2o"))
    members = np.concatenate(report.cores)
    assert len(np.unique(members)) == len(members)
    assert all(instance.outliers[core].any() for core in report.cores)
    # All that are wrong, but for a loop that has no path of its own.
    assert (len(report.cores), len(report.cores_over_odometry)) == (49, 50)
    assert all(edge.is_refuted and edge.rise > 200.0 for edge in report.edges)
    assert [edge.rise for edge in report.edges] == sorted(edge.rise for edge in report.edges)


def test_wrong_loops_are_refuted_by_odometry_alone(dataset):
    graph, rng = dataset("kitti_00").graph, rng_of(0)
    ends = rng.choice(graph.num_nodes, (20, 2), replace=False)
    rotation = RotationGraph(
        graph.num_nodes,
        np.concatenate([graph.edges, ends]),
        np.concatenate([graph.rotations, so.random(rng, 20, 2)]),
        np.r_[graph.kappa, np.full(20, np.median(graph.kappa))],
    )
    tau = np.r_[graph.tau, np.full(20, np.median(graph.tau))]
    steps = np.concatenate([graph.translations, rng.normal(size=(20, 2))])
    problem = Quadratic(PoseGraph(rotation, steps, tau))
    trusted = steps_of(problem.graph)
    loops = np.flatnonzero(~trusted)
    found = rises_over(problem, trusted, loops, Stop())
    wrong = loops >= graph.num_edges
    refuted = found > budgets(problem)[loops]
    assert refuted[wrong].sum() >= 18
    assert not refuted[~wrong].any()


def test_without_trusted_measurements_nothing_is_known_over_them():
    graph = synthetic.grid3d(2, rng_of(0)).graph
    none = np.zeros(graph.num_edges, dtype=bool)
    assert rises_over(Quadratic(graph), none, np.arange(graph.num_edges), Stop()) is None


def test_a_report_that_is_stopped_says_so():
    rng = rng_of(5)
    graph = doubtful_graph(rng, 2, poses=False, n=12, doubtful=1)[0]
    R = np.array(graph.rotations)
    R[-1] = R[-1] @ so.exp(np.array([[2.5]]))[0]
    answer = solve_robustly(RotationGraph(12, graph.edges, R, graph.kappa))
    whole, stopped = outlier_report(answer), outlier_report(answer, time_limit=0.0)
    assert (whole.is_complete, stopped.is_complete) == (True, False)
    assert whole.edges[-1].rise > 0.0
    assert not any(edge.rise for edge in stopped.edges)
    assert stopped.cores == ()


def test_a_world_is_not_the_next_node():
    graph, _ = doubtful_graph(rng_of(0), 3, poses=True)
    rotation = np.eye(3)[None]
    last, origin = np.array([graph.num_nodes - 1]), np.zeros((1, 3))
    known = with_priors(graph, last, rotation, origin, kappa=1.0, tau=1.0)
    assert not (steps_of(known) & known.absolute).any()
    assert steps_of(known).sum() == graph.num_nodes - 1


def chain(ids, **more):
    """A chain of nodes with these ids, and an instance of it."""
    n = len(ids)
    edges = np.column_stack([np.arange(n - 1), np.arange(1, n)])
    graph = RotationGraph(n, edges, np.tile(np.eye(2), (n - 1, 1, 1)), np.ones(n - 1))
    return Instance("chain", graph, np.array(ids), **more)


A, B = ord("a") << 56, ord("b") << 56


@pytest.mark.parametrize(
    ("instance", "by", "expected"),
    [
        (chain([0, 1, 2, 3, 4]), "id", [1, 1, 1, 1]),
        (chain([0, 10, 20, 30, 1000]), "id", [1, 1, 1, 0]),  # every tenth, and another map
        (chain([A, A + 1, A + 2, B, B + 1]), "id", [1, 1, 0, 1]),
        (chain([0, 1, 2, 3], names=("a1.png", "a2.png", "b3.png", "b4.png")), "name", [1, 0, 1]),
        (chain([0, 1, 2], names=("left", "middle", "right")), "id", [1, 1]),
        # Node 2 comes first; there is a long pause before the last.
        (chain([0, 1, 2, 3], times_ns=np.array([10, 20, 0, 900])), "time", [1, 0, 0]),
        (chain([0, 1, 2, 3], times_ns=np.array([5, 5, 6, 7])), "id", [1, 1, 1]),
    ],
)
def test_odometry_is_from_a_pose_to_the_next_by_time_name_or_id(instance, by, expected):
    order = succession(instance)
    assert order.by == by
    assert odometry(instance.graph, order).tolist() == [bool(one) for one in expected]


def test_a_report_needs_rejections_and_a_level():
    clean = synthetic.grid3d(2, rng_of(0)).graph
    answer = solve_robustly(clean)
    assert answer.rejection is None
    with pytest.raises(InputError, match="rejects no measurement"):
        outlier_report(answer)
