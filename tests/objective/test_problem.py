"""Operators, objective, gradient and Hessian: against loops, dense algebra and Taylor's theorem."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dense_cost, dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import certify
from certpgo.errors import GraphError, InputError
from certpgo.graph import Estimate, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.factor import engines
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic


def some_estimate(rng, n, d):
    return Estimate(so.random(rng, n, d), 2.0 * rng.standard_normal((n, d)))


def stacked(estimate):
    """X = [t_1 R_1 ... t_n R_n], (d, (d+1) n)."""
    X = np.concatenate([estimate.translations[:, :, None], estimate.rotations], axis=2)
    return np.concatenate(list(X), axis=1)


@given(seeds, dimensions)
def test_cost_is_the_loop_and_the_quadratic_form(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 7, d)
    x = some_estimate(rng, 7, d)
    problem = Quadratic(graph)
    expected = dense_cost(graph, x.rotations, x.translations)
    assert problem.cost(x) == pytest.approx(expected, rel=1e-12)
    X = stacked(x)
    assert np.trace(X @ problem.matrix.toarray() @ X.T) == pytest.approx(expected, rel=1e-11)
    R = np.concatenate(list(x.rotations), axis=1)
    L = problem.rotation.matrix.toarray()
    assert np.trace(R @ L @ R.T) == pytest.approx(
        dense_cost(graph.rotations_alone, x.rotations), rel=1e-11
    )


@given(seeds, dimensions)
def test_matrices_are_symmetric_semidefinite_with_known_null_vectors(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 6, d)
    problem = Quadratic(graph)
    for A in (problem.matrix, problem.rotation.matrix):
        np.testing.assert_allclose(A.toarray(), A.toarray().T, rtol=0, atol=1e-12)
        assert np.linalg.eigvalsh(A.toarray())[0] > -1e-10
    ones = np.zeros(6 * (d + 1))
    ones[:: d + 1] = 1.0
    np.testing.assert_allclose(problem.matrix @ ones, 0.0, rtol=0, atol=1e-11)
    for A in (problem.elimination.laplacian, problem.rotation.laplacian):
        np.testing.assert_allclose(A @ np.ones(6), 0.0, rtol=0, atol=1e-12)


def test_laplacians_of_complete_and_cycle_graphs():
    n = 7
    i, j = np.triu_indices(n, 1)
    complete = RotationGraph(n, np.c_[i, j], np.tile(np.eye(2), (len(i), 1, 1)), np.ones(len(i)))
    L = operators.laplacian(operators.pattern(complete), complete.kappa)
    np.testing.assert_allclose(np.linalg.eigvalsh(L.toarray())[1:], n, rtol=1e-12, atol=0)
    ring = np.c_[np.arange(n), (np.arange(n) + 1) % n]
    cycle = RotationGraph(n, ring, np.tile(np.eye(2), (n, 1, 1)), np.ones(n))
    values = np.linalg.eigvalsh(
        operators.laplacian(operators.pattern(cycle), cycle.kappa).toarray()
    )
    assert values[1] == pytest.approx(2 * (1 - np.cos(2 * np.pi / n)), rel=1e-12)
    np.testing.assert_array_equal(operators.degrees(ring, np.ones(n), n), 2.0)


@given(seeds, dimensions)
def test_noise_free_graphs_cost_nothing_at_the_truth(seed, d):
    graph, R, t = pose_graph(rng_of(seed), 6, d, noise=0.0)
    problem = Quadratic(graph)
    truth = Estimate(R, t)
    assert problem.cost(truth) < 1e-24 * problem.scale
    assert problem.stationarity(truth) < 1e-13
    assert problem.residual_angles(truth).max() < 1e-13
    np.testing.assert_allclose(problem.complete(R).translations, t - t[0], rtol=0, atol=1e-10)


@given(seeds, dimensions)
def test_translations_minimise_the_cost(seed, d):
    rng = rng_of(seed)
    graph, R, _ = pose_graph(rng, 6, d)
    problem = Quadratic(graph)
    best = problem.complete(R)
    for _ in range(5):
        moved = Estimate(R, best.translations + 0.1 * rng.standard_normal((6, d)))
        assert problem.cost(moved) > problem.cost(best)
    np.testing.assert_allclose(problem.gradient(best)[:, :, 0], 0.0, rtol=0, atol=1e-10)


@given(seeds, dimensions)
def test_multipliers_add_up_to_the_cost(seed, d):
    rng = rng_of(seed)
    graph, R, _ = pose_graph(rng, 6, d)
    problem = Quadratic(graph)
    x = problem.complete(R)
    trace = np.trace(problem.multipliers(x), axis1=1, axis2=2).sum()
    assert trace == pytest.approx(problem.cost(x), rel=1e-10)
    rotation = problem.rotation
    trace = np.trace(rotation.multipliers(x), axis1=1, axis2=2).sum()
    assert trace == pytest.approx(rotation.cost(x), rel=1e-10)
    # Eriksson et al. eq. 16, as printed: Lam*_i = sum_j kappa R_ij R_j^T R_i, here for one node.
    at_zero = np.zeros((d, d))
    for e, (i, j) in enumerate(graph.edges):
        measured = graph.kappa[e] * graph.rotations[e]
        if i == 0:
            at_zero += measured @ R[j].T @ R[0]
        if j == 0:
            at_zero += measured.T @ R[i].T @ R[0]
    ours = rotation.node_weights[0] * np.eye(d) - rotation.multipliers(x)[0]
    np.testing.assert_allclose(ours, 0.5 * (at_zero + at_zero.T), rtol=0, atol=1e-10)


def moved_along(x, v):
    d = x.d
    p = so.tangent_dim(d)
    R = x.rotations @ so.exp(v[:, -p:])
    return Estimate(R, x.translations + v[:, :d] if v.shape[1] > p else None)


def taylor_errors(problem, x, v, steps):
    g = problem.first_order(x).tangent
    diagonal, upper = problem.hessian(x, problem.multipliers(x))
    H = problem.pattern.assemble(diagonal, upper)
    curvature = float(v.ravel() @ (H @ v.ravel()))
    errors = []
    for h in steps:
        model = problem.cost(x) + 2.0 * h * float(np.sum(g * v)) + h * h * curvature
        errors.append(abs(problem.cost(moved_along(x, h * v)) - model))
    return errors


@given(seeds, dimensions)
def test_gradient_and_hessian_by_the_slope_of_the_taylor_error(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, d, extra=4)
    for problem in (Quadratic(graph), Quadratic(graph.rotations_alone)):
        x = some_estimate(rng, 5, d)
        v = rng.standard_normal(problem.first_order(x).tangent.shape)
        coarse, fine = taylor_errors(problem, x, v, (2e-3, 1e-3))
        # Third order: halving the step divides the error by eight (or it is rounding).
        floor = 1e-11 * problem.cost(x)
        assert fine < coarse / 5.0 + floor


@given(seeds, dimensions)
def test_gauge_and_scaling_laws(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 6, d)
    problem = Quadratic(graph)
    x = some_estimate(rng, 6, d)
    moved = x.moved(so.random(rng, 1, d)[0], rng.standard_normal(d))
    assert problem.cost(moved) == pytest.approx(problem.cost(x), rel=1e-11)
    np.testing.assert_allclose(
        problem.multipliers(moved), problem.multipliers(x), rtol=0, atol=1e-9 * problem.scale
    )
    heavier = Quadratic(graph.with_weights(4.0 * graph.kappa, 4.0 * graph.tau))
    assert heavier.cost(x) == 4.0 * problem.cost(x)
    assert heavier.stationarity(x) == pytest.approx(problem.stationarity(x), rel=1e-12)


@given(seeds, dimensions)
def test_reversing_a_rotation_edge_changes_nothing(seed, d):
    rng = rng_of(seed)
    graph, _ = rotation_graph(rng, 6, d)
    reversed_ = RotationGraph(
        6, graph.edges[:, ::-1], np.swapaxes(graph.rotations, 1, 2), graph.kappa
    )
    x = Estimate(so.random(rng, 6, d))
    assert Quadratic(reversed_).cost(x) == pytest.approx(Quadratic(graph).cost(x), rel=1e-12)
    A = Quadratic(graph).matrix - Quadratic(reversed_).matrix
    assert abs(A).max() < 1e-12


def test_problems_refuse_what_is_not_theirs():
    rng = np.random.default_rng(0)
    graph, R, _t = pose_graph(rng, 5, 3)
    with pytest.raises(InputError, match="5 nodes in 3D, the graph 6 in 3D"):
        Quadratic(rotation_graph(rng, 6, 3)[0]).check(Estimate(R))
    with pytest.raises(InputError, match="no translations"):
        Quadratic(graph).check(Estimate(R))
    with pytest.raises(GraphError, match="no translations"):
        Quadratic(graph).cost(Estimate(R))
    edges = np.array([[0, 1], [2, 3]])
    apart = RotationGraph(4, edges, np.tile(np.eye(3), (2, 1, 1)), np.ones(2))
    with pytest.raises(GraphError, match="2 components"):
        Quadratic(apart)
    assert Quadratic(graph).rotation.n == 5
    assert Quadratic(graph).with_unit_weights().scale == pytest.approx(
        graph.num_edges + (graph.translations**2).sum()
    )
    assert Quadratic(graph.rotations_alone).rotation.with_unit_weights().scale == graph.num_edges


GOLDEN_SCALES = {"sphere2500": 4949, "torus3D": 9048}


@pytest.mark.parametrize("name", GOLDEN_SCALES)
def test_unit_weights_tie_cost_to_likelihood(name, dataset):
    """F = 2 d m - 2 f_ML at unit weights (DESIGN, golden values)."""
    from certpgo.solve import metrics

    graph = dataset(name).graph
    problem = Quadratic(graph).with_unit_weights()
    x = problem.complete(np.tile(np.eye(3), (graph.num_nodes, 1, 1)))
    expected = 6 * GOLDEN_SCALES[name] - 2 * metrics.f_ml(graph, x)
    assert problem.cost(x) == pytest.approx(expected, rel=1e-12)


def test_what_is_no_graph_is_refused():
    graph, R, _ = pose_graph(rng_of(0), 4, 3)
    for other in (Estimate(R), Quadratic(graph), None):
        with pytest.raises(InputError, match="a graph"):
            Quadratic(other)


@pytest.mark.parametrize("engine", engines())
def test_a_problem_has_its_engine_and_hands_it_on(engine):
    graph, _, _ = pose_graph(np.random.default_rng(0), 8, 3)
    problem = Quadratic(graph, engine)
    derived = (
        problem,
        problem.rotation,
        problem.scaled(0.5),
        problem.reweighted(np.ones(graph.num_edges)),
        problem.with_unit_weights(),
        problem.rotation.with_unit_weights(),
    )
    for other in derived:
        assert other.engine == engine
        assert other.symbolic(other.matrix).engine == engine
    assert certify(problem, problem.complete(np.tile(np.eye(3), (8, 1, 1)))).engine == engine
