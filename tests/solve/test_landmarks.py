"""Graphs with points: published and computed optima, laws, and the same with points as poses."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dense_cost, dimensions, point_graph, rng_of, seeds

import certpgo
from certpgo import Estimate, GraphError, Quadratic, certify, solve
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.factor import engines
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.riemannian_newton import newton

few = settings(max_examples=12)


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("cityTrees_reduced_1k", 47.5011386),
        ("cityTrees10000", 603.545321),
        ("victoriaPark_reduced_1k", 93.7543815),
        ("victoria_park", 10287.9124),
        ("VO_stereo_factors00s", 20950.2628),
    ],
)
def test_optima(dataset, name, optimum):
    answer = solve(dataset(name), cost="chordal")
    assert answer.verdict.value == "CERTIFIED"
    assert f"{answer.cost:.9g}" == f"{optimum:.9g}"


def test_stereo_from_random_rotations(dataset):
    graph = dataset("VO_stereo_factors00s").graph
    n = graph.num_nodes
    start = Estimate(so.random(rng_of(1), n, 3), np.zeros((n, 3)))
    answer = solve(graph, initial=start, try_own_start=False)
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(20950.2628, rel=3e-9)


def test_stereo_with_odometry(dataset, dataset_path):
    graph = dataset("VO_stereo_factors00s").graph
    path = dataset_path("VO_stereo_factors00s")
    path = path.with_name("VO_camera_poses00s.txt")
    if not path.exists():
        pytest.skip(f"{path.name}: file not here")
    cameras = certpgo.read_estimate(path)
    R, t, k = cameras.rotations, cameras.translations, np.arange(76)
    back = np.swapaxes(R[:-1], 1, 2)
    steps = (back @ (t[1:] - t[:-1])[:, :, None])[:, :, 0]
    rotation = RotationGraph(
        graph.num_nodes,
        np.concatenate([np.stack([k, k + 1], axis=1), graph.edges]),
        np.concatenate([back @ R[1:], graph.rotations]),
        np.r_[np.full(76, 5000.0), np.zeros(graph.num_edges)],
    )
    moved = np.concatenate([steps, graph.translations])
    tau = np.r_[np.full(76, 400.0), graph.tau]
    answer = solve(PoseGraph(rotation, moved, tau, points=graph.is_point))
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(21064.8184, rel=5e-9)


def as_poses(graph):
    """The same problem with a rotation for each point, measured once: it is met exactly."""
    first = {int(j): int(i) for i, j in graph.edges[::-1] if graph.is_point[j]}
    extra = np.array([[i, j] for j, i in first.items()])
    k, d = len(extra), graph.d
    rotation = RotationGraph(
        graph.num_nodes,
        np.concatenate([graph.edges, extra]),
        np.concatenate([graph.rotations, np.tile(np.eye(d), (k, 1, 1))]),
        np.r_[graph.kappa, np.ones(k)],
    )
    moved = np.concatenate([graph.translations, np.zeros((k, d))])
    return PoseGraph(rotation, moved, np.r_[graph.tau, np.zeros(k)])


@given(seeds, dimensions)
@few
def test_a_point_is_a_pose_whose_rotation_does_not_matter(seed, d):
    rng = rng_of(seed)
    graph, _ = point_graph(rng, int(rng.integers(2, 6)), 5, d, odometry=bool(seed % 2))
    ours, theirs = solve(graph), solve(as_poses(graph))
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-7, abs=1e-9)
    assert ours.certificate.lower_bound <= theirs.cost
    assert theirs.certificate.lower_bound <= ours.cost * (1.0 + 1e-12)
    assert {ours.verdict.value, theirs.verdict.value} <= {"CERTIFIED", "BOUNDED"}


@given(seeds, dimensions)
@few
def test_matrices_are_those_of_the_cost(seed, d):
    rng = rng_of(seed)
    graph, _ = point_graph(rng, 4, 3, d)
    problem, n = Quadratic(graph), graph.num_nodes
    estimate = Estimate(so.random(rng, n, d), rng.standard_normal((n, d)))
    value = dense_cost(graph, estimate.rotations, estimate.translations)
    assert problem.cost(estimate) == pytest.approx(value)
    M = problem.matrix.toarray()
    assert M.shape == (4 * (d + 1) + 3,) * 2
    blocks = [
        np.concatenate([estimate.translations[k][:, None], estimate.rotations[k]], axis=1)
        if k in problem.poses
        else estimate.translations[k][:, None]
        for k in range(n)
    ]
    X = np.concatenate(blocks, axis=1)
    assert float(np.trace(X @ M @ X.T)) == pytest.approx(value)
    # The rotations that estimates hold for points change nothing.
    other = estimate.rotations.copy()
    other[graph.is_point] = so.random(rng, 3, d)
    turned = Estimate(other, estimate.translations)
    assert problem.cost(turned) == pytest.approx(value)
    first = problem.first_order(turned)
    np.testing.assert_array_equal(first.multipliers[graph.is_point], 0.0)
    np.testing.assert_array_equal(first.tangent[graph.is_point, d:], 0.0)
    # The multipliers' traces add up to F where the translations are optimal.
    best = problem.with_optimal_translations(turned)
    total = np.trace(problem.first_order(best).multipliers, axis1=1, axis2=2).sum()
    assert total == pytest.approx(problem.cost(best), rel=1e-6)


@given(seeds, dimensions)
@few
def test_the_hessian_is_the_derivative_of_the_gradient(seed, d):
    rng = rng_of(seed)
    graph, _ = point_graph(rng, 3, 3, d)
    problem, n, q = Quadratic(graph), graph.num_nodes, so.tangent_dim(d)
    point = Estimate(so.random(rng, n, d), rng.standard_normal((n, d)))
    layout = problem.tangent_layout
    first = problem.first_order(point)
    blocks = problem.hessian(point, first.multipliers)
    H = problem.pattern.assemble(*blocks, d).toarray()
    x = rng.standard_normal(layout.size)
    step = layout.unpack(x)

    def slope(h):
        moved = Estimate(
            point.rotations @ so.exp(h * step[:, -q:]), point.translations + h * step[:, :d]
        )
        return problem.cost(moved)

    h = 1e-4
    second = (slope(h) - 2.0 * slope(0.0) + slope(-h)) / h**2
    assert 2.0 * x @ H @ x == pytest.approx(second, rel=1e-4, abs=1e-4)


@given(seeds, dimensions)
@few
def test_bounds_are_below_what_descents_find(seed, d):
    rng = rng_of(seed)
    graph, _ = point_graph(rng, 4, 5, d, noise=1.5, odometry=bool(seed % 2))
    answer, problem, n = solve(graph), Quadratic(graph), graph.num_nodes
    for _ in range(5):
        start = problem.complete(so.random(rng, n, d))
        cost = newton(problem, start).cost
        assert answer.certificate.lower_bound <= cost * (1.0 + 1e-12)
        assert answer.cost <= cost * (1.0 + 1e-6) or answer.verdict.value == "BOUNDED"


@given(seeds, dimensions)
@few
def test_gauge_relabelling_and_scale(seed, d):
    rng = rng_of(seed)
    graph, _ = point_graph(rng, 4, 4, d)
    answer, n = solve(graph), graph.num_nodes
    S = so.random(rng, 1, d)[0]
    moved = answer.estimate.moved(S, rng.standard_normal(d))
    assert Quadratic(graph).cost(moved) == pytest.approx(answer.cost)
    assert certify(Quadratic(graph), moved).verdict is answer.verdict
    order = rng.permutation(n)
    again = solve(graph.subgraph(order))
    assert again.cost == pytest.approx(answer.cost, rel=1e-6)
    np.testing.assert_array_equal(graph.subgraph(order).is_point, graph.is_point[order])
    heavier = graph.reweighted(np.full(graph.num_edges, 8.0))
    assert solve(heavier).cost == pytest.approx(8.0 * answer.cost, rel=1e-6)


@pytest.mark.parametrize("tier", ["screen", "standard"])
def test_every_engine(tier):
    graph, _ = point_graph(rng_of(3), 8, 20, 3)
    found = {}
    for engine in engines():
        problem = Quadratic(graph, engine)
        estimate = newton(problem, solve(graph).estimate, near=True).estimate
        found[engine] = certify(problem, estimate, tier=tier).lower_bound
    values = list(found.values())
    np.testing.assert_allclose(values, values[0], rtol=1e-6)


def test_higher_ranks():
    """Low-rank descent from rank 4 ends where Newton's method does."""
    graph, _ = point_graph(rng_of(5), 6, 10, 3)
    problem = Quadratic(graph)
    answer = solve(graph)
    start = low_rank.lifted(problem.complete(so.random(rng_of(6), 16, 3)), 5)
    found = low_rank.descend(problem, start, 5)
    assert found.cost == pytest.approx(answer.cost, rel=1e-9)


def test_robust():
    graph, _ = point_graph(rng_of(7), 12, 20, 2, noise=0.02)
    graph = graph.with_weights(tau=np.full(graph.num_edges, 2500.0))
    rotation = graph.rotations_alone.with_weights(np.where(graph.kappa > 0, 2500.0, 0.0))
    graph = PoseGraph(rotation, graph.translations, graph.tau, points=graph.is_point)
    seen = np.flatnonzero(graph.is_point[graph.edges[:, 1]])
    wrong = seen[::9]
    moved = graph.translations.copy()
    moved[wrong] += 4.0
    spoiled = PoseGraph(rotation, moved, graph.tau, points=graph.is_point)
    answer = certpgo.solve_robustly(spoiled)
    rejected = np.asarray(answer.solution.rejected)
    assert set(wrong) <= set(rejected)
    assert len(rejected) <= len(wrong) + 2
    assert answer.verdict.value == "CERTIFIED"


def test_what_is_refused():
    rotation = RotationGraph(3, [[0, 1], [0, 2]], np.tile(np.eye(2), (2, 1, 1)), [1.0, 0.0])
    steps, tau = np.ones((2, 2)), np.ones(2)
    graph = PoseGraph(rotation, steps, tau, points=[False, False, True])
    assert graph.pose_nodes.tolist() == [0, 1]
    with pytest.raises(GraphError, match=r"edge \(0, 1\): a point has no rotation"):
        PoseGraph(rotation, steps, tau, points=[False, True, False])
    with pytest.raises(GraphError, match="edges lead to points, not from"):
        PoseGraph(rotation, steps, tau, points=[True, False, False])
    with pytest.raises(GraphError, match="points must be 3 flags"):
        PoseGraph(rotation, steps, tau, points=[True])
    with pytest.raises(GraphError, match="a point has no rotation"):
        graph.with_weights(kappa=1.0)
    with pytest.raises(certpgo.NumericalError, match="rotations cannot be averaged alone"):
        certpgo.get_solver("eigen_ma")().solve(Quadratic(graph))


def test_no_warnings_without_any_measured_rotation():
    graph, _ = point_graph(rng_of(9), 5, 9, 3, odometry=False)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert solve(graph).verdict.value == "CERTIFIED"
        certpgo.solve_robustly(graph)
