"""Matrix completion: the thesis' algorithms on full dense matrices, laws, and one another."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import strategies
from hypothesis import given, settings

from certpgo import registry
from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods import _memory
from certpgo.optimize.solution import Status
from certpgo.solve import metrics

NAMES = (
    "expectation_maximization",
    "damped_newton",
    "low_rank_sparse",
    "augmented_lagrangian",
)
DESCENTS = NAMES[:3]
ROBUST = NAMES[2:]
KINDS = ("rotations", "poses")


def solver(name, **options):
    return registry.get_solver(name)(**options)


def module(name="_completion"):
    registry.get_solver("damped_newton")  # loads the folder as a package
    return sys.modules[f"certpgo_baselines.{name}"]


def rng():
    return np.random.default_rng(17)


def instance(generator, kind, d, n=10, extra=20, noise=0.0):
    """A random problem with parallel and backward edges and uneven weights, and its truth."""
    graph, R, t = strategies.pose_graph(generator, n, d, extra=extra, noise=noise)
    if kind == "rotations":
        return Quadratic(graph.rotations_alone), Estimate(R)
    return Quadratic(graph), Estimate(R, t)


def shaken(estimate, generator, amount):
    n, d = estimate.num_nodes, estimate.d
    turns = so.exp(amount * generator.standard_normal((n, so.tangent_dim(d))))
    t = estimate.translations
    moved = None if t is None else t + amount * generator.standard_normal((n, d))
    return Estimate(estimate.rotations @ turns, moved)


def complete(kind, noise, n=20, d=3):
    """A complete graph of unit weights, and its truth."""
    generator = rng()
    made = synthetic.complete(n, noise, generator, d=d)
    return made if kind == "rotations" else posed(made, noise, generator)


def posed(made, noise, generator):
    graph, R = made.graph, made.truth.rotations
    t = generator.uniform(-3, 3, (graph.num_nodes, graph.d))
    i, j = graph.edges.T
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    steps += noise * generator.standard_normal(steps.shape)
    graph = PoseGraph(graph, steps, np.ones(graph.num_edges))
    return SimpleNamespace(graph=graph, truth=Estimate(R, t))


def with_outliers(graph, share, generator):
    rotation = graph.rotations_alone if graph.has_positions else graph
    bad = generator.permutation(rotation.num_edges)[: round(share * rotation.num_edges)]
    R = rotation.rotations.copy()
    R[bad] = so.random(generator, len(bad), rotation.d)
    turned = RotationGraph(rotation.num_nodes, rotation.edges, R, rotation.kappa)
    if rotation is graph:
        return turned
    t = graph.translations.copy()
    t[bad] = generator.uniform(-6, 6, (len(bad), rotation.d))
    return PoseGraph(turned, t, graph.tau)


def matrices(problem):
    """Mtilde_B and its mask W, dense, read from the formulas edge by edge."""
    rotation = problem.rotation.graph
    n, d = problem.n, problem.d
    b = d + problem.has_positions
    total, count = np.zeros((n, n, b, b)), np.zeros((n, n, 1, 1))
    for e, (i, j) in enumerate(rotation.edges):
        M = np.eye(b)
        M[:d, :d] = rotation.rotations[e]
        if b > d:
            M[:d, d] = problem.graph.translations[e]
        total[i, j] += M
        total[j, i] += np.linalg.inv(M)
        count[i, j] += 1
        count[j, i] += 1
    for k in range(n):
        total[k, k], count[k, k] = np.eye(b), 1
    blocks = total / np.maximum(count, 1)
    mask = np.broadcast_to(count > 0, blocks.shape)
    return tuple(np.swapaxes(a, 1, 2).reshape(b * n, b * n) for a in (blocks, mask))


def of_estimate(estimate):
    """M_B of an estimate, dense."""
    n, d = estimate.num_nodes, estimate.d
    b = d + (estimate.translations is not None)
    poses = np.zeros((n, b, b))
    poses[:, :d, :d] = estimate.rotations
    if b > d:
        poses[:, :d, d], poses[:, d, d] = estimate.translations, 1.0
    return np.vstack(np.linalg.inv(poses)) @ np.hstack(poses), b


def truncated(A, b):
    U, s, Vt = np.linalg.svd(A)
    return U[:, :b] * s[:b] @ Vt[:b]


def costs(solution):
    return np.array([iteration.cost for iteration in solution.trace])


def assert_same(estimate, other, atol):
    moved = estimate.anchored(0, like=other)
    np.testing.assert_allclose(moved.rotations, other.rotations, rtol=0, atol=atol)
    if other.translations is not None:
        np.testing.assert_allclose(moved.translations, other.translations, rtol=0, atol=atol)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_known_blocks_and_products_are_those_of_the_dense_matrices(d, kind):
    problem, truth = instance(rng(), kind, d, noise=0.2)
    known = module().Known.of(problem)
    M, W = matrices(problem)
    np.testing.assert_allclose(known.matrix(known.blocks).toarray(), M, atol=1e-12)
    L = module().low_rank(truth, problem)
    dense, _ = of_estimate(truth)
    np.testing.assert_allclose(L.C @ L.V.T, dense, atol=1e-11)
    np.testing.assert_allclose(known.matrix(known.at(L)).toarray(), W * dense, atol=1e-11)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_the_nearest_matrix_is_the_truncated_svd(d, kind):
    problem, truth = instance(rng(), kind, d, noise=0.2)
    known = module().Known.of(problem)
    L = module().low_rank(shaken(truth, rng(), 0.3), problem)
    change = known.matrix(known.blocks - known.at(L))
    found = module().nearest(change, L)
    dense = L.C @ L.V.T + change.toarray()
    np.testing.assert_allclose(found.C.T @ found.C, np.eye(len(found.C.T)), atol=1e-12)
    wanted = truncated(dense, len(found.C.T))
    distance, least = (np.linalg.norm(dense - A) for A in (found.C @ found.V.T, wanted))
    assert distance == pytest.approx(least, rel=1e-9)
    np.testing.assert_allclose(found.C @ found.V.T, wanted, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_expectation_maximization_is_algorithm_1(d, kind):
    problem, truth = instance(rng(), kind, d, noise=0.2)
    M, W = matrices(problem)
    start = shaken(truth, rng(), 0.1)
    L, b = of_estimate(start)
    expected = [0.5 * np.linalg.norm(W * (M - L)) ** 2]
    for _ in range(6):
        L = truncated(np.where(W, M, L), b)
        expected.append(0.5 * np.linalg.norm(W * (M - L)) ** 2)
    method = solver("expectation_maximization", max_iterations=6, tolerance=0.0)
    np.testing.assert_allclose(costs(method.solve(problem, initial=start)), expected, rtol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_low_rank_sparse_alternates_over_l_and_s(d, kind):
    problem, truth = instance(rng(), kind, d, noise=0.2)
    M, W = matrices(problem)
    start, threshold = shaken(truth, rng(), 0.1), 0.07
    L, b = of_estimate(start)
    expected = []
    for _ in range(7):
        residual = W * (M - L)
        S = np.sign(residual) * np.maximum(np.abs(residual) - threshold, 0.0)
        smooth = 0.5 * np.linalg.norm(residual - S) ** 2
        expected.append(smooth + threshold * np.abs(S).sum())
        L = truncated(np.where(W, M - S, L), b)
    method = solver("low_rank_sparse", threshold=threshold, max_iterations=6, tolerance=0.0)
    np.testing.assert_allclose(costs(method.solve(problem, initial=start)), expected, rtol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_augmented_lagrangian_is_gauss_seidel_on_full_matrices(d, kind):
    problem, truth = instance(rng(), kind, d, noise=0.2)
    M, W = matrices(problem)
    start, weight, mu, growth = shaken(truth, rng(), 0.1), 0.01, 0.1, 1.3
    product, b = of_estimate(start)
    V = np.linalg.svd(product)[2][:b].T
    B, Y = np.where(W, M, product), np.zeros_like(M)
    expected = []
    for _ in range(20):
        left, _, right = np.linalg.svd((B + Y / mu) @ V, full_matrices=False)
        C = left @ right
        left, s, right = np.linalg.svd((B + Y / mu).T @ C, full_matrices=False)
        V = left * np.maximum(s - weight / mu, 0.0) @ right
        product = C @ V.T
        near = product - Y / mu
        slack = M - near
        l1 = M - np.sign(slack) * np.maximum(np.abs(slack) - 1.0 / mu, 0.0)
        B = np.where(W, l1, near)
        Y = Y + mu * (B - product)
        mu *= growth
        residual = np.abs(W * (M - product)).sum()
        expected.append(residual + weight * np.linalg.norm(product, "nuc"))
    method = solver(
        "augmented_lagrangian",
        regularizer=weight,
        penalty=0.1,
        growth=growth,
        max_iterations=20,
        tolerance=0.0,
    )
    found = costs(method.solve(problem, initial=start))
    np.testing.assert_allclose(found[1:], expected, rtol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_newtons_derivatives_are_those_of_its_cost(d, kind, alpha):
    problem, truth = instance(rng(), kind, d, n=5, extra=4, noise=0.2)
    known = module().Known.of(problem)
    L = module().low_rank(shaken(truth, rng(), 0.3), problem)
    point = module("damped_newton").Point(known, L, alpha)
    H = point.hessian.toarray()
    np.testing.assert_array_equal(H, H.T)
    M, W = matrices(problem)
    size = sum(np.linalg.norm(F) ** 2 for F in (L.C, L.V))
    cost = 0.5 * (np.linalg.norm(W * (M - L.C @ L.V.T)) ** 2 + alpha * size)
    assert point.cost == pytest.approx(cost, rel=1e-12)
    step = 1e-5
    for direction in rng().standard_normal((4, len(point.x))):
        there, back = (point.at(point.x + s * step * direction) for s in (1, -1))
        slope = (there.cost - back.cost) / (2 * step)
        assert point.gradient @ direction == pytest.approx(slope, rel=1e-6)
        bend = (there.gradient - back.gradient) / (2 * step)
        np.testing.assert_allclose(H @ direction, bend, rtol=0, atol=1e-7 * np.abs(bend).max())


@pytest.mark.parametrize("name", DESCENTS)
@pytest.mark.parametrize("kind", KINDS)
def test_measurements_alone_are_a_start_with_zeros_for_the_rest(name, kind):
    problem, truth = instance(rng(), kind, 3, extra=40, noise=0.2)
    M, W = matrices(problem)
    residual = W * (M - truncated(M, of_estimate(truth)[1]))
    # So that no residual counts as an outlier's.
    options = {"threshold": 1e3} if name == "low_rank_sparse" else {}
    solution = solver(name, start="measurements", **options).solve(problem)
    expected = 0.5 * np.linalg.norm(residual) ** 2
    assert solution.trace[0].cost == pytest.approx(expected, rel=1e-5)
    assert solution.trace[0].cost > 2 * solution.trace[-1].cost


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("edges", [[[1, 0]], [[0, 1], [0, 1]], [[2, 1], [0, 2]]])
def test_the_smallest_graphs(name, d, kind, edges):
    edges = np.array(edges)
    m, n = len(edges), edges.max() + 1
    R = np.broadcast_to(so.random(rng(), 1, d), (m, d, d))
    graph = RotationGraph(n, edges, R, np.ones(m))
    if kind == "poses":
        graph = PoseGraph(graph, np.ones((m, d)), np.ones(m))
    solution = solver(name, start="tree").solve(Quadratic(graph))
    assert solution.cost < 1e-9
    assert solution.status is Status.CONVERGED


def test_balanced_factors_make_the_same_matrix():
    problem, truth = instance(rng(), "poses", 3)
    L = module().low_rank(truth, problem)
    balanced = module("damped_newton").balanced(L)
    np.testing.assert_allclose(balanced.C @ balanced.V.T, L.C @ L.V.T, atol=1e-11)
    np.testing.assert_allclose(balanced.C.T @ balanced.C, balanced.V.T @ balanced.V, atol=1e-11)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_exact_measurements_give_the_truth(name, d, kind):
    problem, truth = instance(rng(), kind, d, extra=60)
    # The penalty of the augmented Lagrangian grows like the inverse of the error.
    options = {"tolerance": 1e-11} if name == "augmented_lagrangian" else {}
    solution = solver(name, **options).solve(problem, initial=shaken(truth, rng(), 0.2))
    assert solution.status is Status.CONVERGED
    assert solution.iterations > 1
    assert_same(solution.estimate, truth, 1e-7)
    assert solver(name, **options).solve(problem).cost < 1e-9


@pytest.mark.parametrize("name", DESCENTS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_bipartite_graph_is_tied_together_by_its_identities(name, kind):
    k = np.arange(6)
    R = so.random(rng(), 6, 3)
    t = rng().standard_normal((6, 3))
    i, j = edges = np.stack([k, (k + 1) % 6])
    rotation = RotationGraph(6, edges.T, np.swapaxes(R[i], 1, 2) @ R[j], np.ones(6))
    steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i])
    truth = Estimate(R, t) if kind == "poses" else Estimate(R)
    graph = PoseGraph(rotation, steps, np.ones(6)) if kind == "poses" else rotation
    turned = R.copy()
    turned[::2] = so.exp(np.array([0.3, 0.2, 0.1])) @ R[::2]
    start = Estimate(turned, truth.translations)
    solution = solver(name, max_iterations=5000).solve(Quadratic(graph), initial=start)
    assert_same(solution.estimate, truth, 1e-3)


@pytest.mark.parametrize("name", DESCENTS)
@pytest.mark.parametrize("start", ["tree", "measurements"])
@settings(max_examples=15)
@given(strategies.seeds, strategies.dimensions)
def test_no_step_raises_the_cost(name, start, seed, d):
    for kind in KINDS:
        problem, _ = instance(strategies.rng_of(seed), kind, d, n=7, extra=6, noise=0.3)
        solution = solver(name, start=start, max_iterations=60).solve(problem)
        cost = costs(solution)
        assert len(cost) > 1
        assert (np.diff(cost) <= 1e-12 * cost[0]).all()


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(strategies.seeds, strategies.dimensions)
def test_moving_the_world_and_naming_nodes_anew_change_nothing(name, seed, d):
    generator = strategies.rng_of(seed)
    for kind in KINDS:
        problem, truth = instance(generator, kind, d, n=8, extra=20, noise=0.1)
        start = shaken(truth, generator, 0.1)
        method = solver(name, max_iterations=5)
        solution = method.solve(problem, initial=start)

        world = so.random(generator, 1, d)[0]
        moved = start.moved(world, generator.uniform(-9, 9, d))
        elsewhere = method.solve(problem, initial=moved)
        assert_same(elsewhere.estimate, solution.estimate, 1e-6)

        place = generator.permutation(problem.n)
        graph = relabelled(problem.graph, place)
        order = np.argsort(place)
        renamed = method.solve(Quadratic(graph), initial=start.subset(order))
        assert_same(renamed.estimate, solution.estimate.subset(order), 1e-6)

        backward = method.solve(Quadratic(reversed_graph(problem.graph)), initial=start)
        assert_same(backward.estimate, solution.estimate, 1e-6)


def relabelled(graph, place):
    rotation = graph.rotations_alone if graph.has_positions else graph
    named = RotationGraph(
        rotation.num_nodes, place[rotation.edges], rotation.rotations, rotation.kappa
    )
    return named if rotation is graph else PoseGraph(named, graph.translations, graph.tau)


def reversed_graph(graph):
    rotation = graph.rotations_alone if graph.has_positions else graph
    R = np.swapaxes(rotation.rotations, 1, 2)
    turned = RotationGraph(rotation.num_nodes, rotation.edges[:, ::-1], R, rotation.kappa)
    if rotation is graph:
        return turned
    t = -np.einsum("mab,mb->ma", R, graph.translations)
    return PoseGraph(turned, t, graph.tau)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_missing_is_the_eigenvectors_answer(d):
    problem = Quadratic(complete("rotations", 0.2, d=d).graph)
    eigenvectors = solver("eigen_ra", tol=1e-12).solve(problem)
    for name in DESCENTS[:2]:
        assert_same(solver(name).solve(problem).estimate, eigenvectors.estimate, 1e-7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_expectation_maximization_and_damped_newton_agree(d, kind):
    problem, _ = instance(rng(), kind, d, n=15, extra=80, noise=0.1)
    patient = solver("expectation_maximization", tolerance=1e-13, max_iterations=20_000)
    slow, fast = patient.solve(problem), solver("damped_newton").solve(problem)
    assert fast.status is Status.CONVERGED
    assert fast.iterations < slow.iterations
    assert fast.trace[-1].cost == pytest.approx(slow.trace[-1].cost, rel=1e-9)
    assert_same(fast.estimate, slow.estimate, 1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_outliers_move_least_squares_but_not_the_robust_methods(kind):
    made = complete(kind, 0.02, n=30)
    problem = Quadratic(with_outliers(made.graph, 0.15, rng()))

    def error(name):
        return metrics.angular_errors(solver(name).solve(problem).estimate, made.truth).rmse_deg

    affected = error("expectation_maximization")
    assert affected > 2.0
    for name in ROBUST:
        assert error(name) < min(0.8, affected / 4)


def test_the_relaxation_is_below_the_estimate_it_starts_from(dataset):
    problem = Quadratic(dataset("smallGrid3D").graph.rotations_alone).with_unit_weights()
    best = solver("riemannian_gradient").solve(problem)
    solution = solver("damped_newton").solve(problem, initial=best.estimate)
    # Each edge counts twice, and half.
    assert solution.trace[0].cost == pytest.approx(best.cost, rel=1e-9)
    assert 0.9 * best.cost < solution.trace[-1].cost < best.cost
    assert solution.cost == pytest.approx(best.cost, rel=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_monitor_stops_at_once(name):
    problem, _ = instance(rng(), "poses", 3, noise=0.2)
    solution = solver(name, tolerance=0.0).solve(problem, monitor=lambda it: it.number == 2)
    assert (solution.status, solution.iterations) == (Status.INTERRUPTED, 2)


@pytest.mark.parametrize("name", NAMES)
def test_an_iteration_limit_is_told_and_weights_are_said_to_be_unused(name):
    problem, truth = instance(rng(), "poses", 3, noise=0.2)
    method = solver(name, tolerance=0.0, max_iterations=3)
    solution = method.solve(problem, initial=truth)
    assert (solution.status, solution.iterations) == (Status.ITERATION_LIMIT, 3)
    assert "equal edge weights" in solution.note
    alike = method.solve(problem.with_unit_weights(), initial=truth)
    assert_same(alike.estimate, solution.estimate, 1e-12)


def test_newton_that_cannot_improve_has_stalled(monkeypatch):
    problem, _ = instance(rng(), "rotations", 2, noise=0.2)
    monkeypatch.setattr(module("damped_newton"), "STRONGEST", 1e-9)
    solution = solver("damped_newton", damping=1e-8).solve(problem)
    assert (solution.status, solution.iterations) == (Status.STALLED, 0)


def test_newton_refuses_a_factor_that_memory_is_too_small_for(monkeypatch):
    problem, _ = instance(rng(), "poses", 3)
    monkeypatch.setattr(_memory, "available_bytes", lambda: 1e5)
    with pytest.raises(InputError, match="Hessian of damped Newton would take about") as caught:
        solver("damped_newton").solve(problem)
    assert "\n" not in str(caught.value)
    assert solver("damped_newton", force=True).solve(problem).cost < 1e-9


@pytest.mark.parametrize("name", NAMES)
def test_an_initial_estimate_of_another_graph_is_refused(name):
    problem, _ = instance(rng(), "poses", 3)
    _, other = instance(rng(), "poses", 3, n=11)
    with pytest.raises(InputError, match="11 nodes"):
        solver(name).solve(problem, initial=other)


@pytest.mark.parametrize(
    ("name", "wrong", "message"),
    [
        *[(name, {"start": "trees"}, "did you mean tree") for name in NAMES],
        *[(name, {"max_iterations": 0}, "at least 1") for name in NAMES],
        *[(name, {"tolerance": -1e-3}, "not be negative") for name in NAMES],
        ("damped_newton", {"damping": 0.0}, "damping must be positive"),
        ("damped_newton", {"alpha": -1.0}, "alpha not negative"),
        ("low_rank_sparse", {"threshold": 0.0}, "threshold must be positive"),
        ("augmented_lagrangian", {"penalty": 0.0}, "penalty must be positive"),
        ("augmented_lagrangian", {"growth": 1.0}, "growth above 1"),
        ("augmented_lagrangian", {"regularizer": -1e-3}, "regularizer not negative"),
    ],
)
def test_settings_are_validated_at_construction(name, wrong, message):
    with pytest.raises(SpecError, match=message) as caught:
        solver(name, **wrong)
    assert "\n" not in str(caught.value)
