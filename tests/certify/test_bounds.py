"""Bounds without a factorization: the papers' angles, and attempts to break them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, rotation_graph, seeds

from certpgo.certify.bounds import (
    alpha_max,
    cycle_bound,
    cycle_sum_holds,
    fiedler_value,
    normalized_fiedler_value,
    row_bound,
)
from certpgo.certify.bounds import bounds as bounds_of
from certpgo.graph import Estimate, RotationGraph
from certpgo.io import read
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton


def identity_graph(n, edges, kappa=None):
    edges = np.asarray(edges)
    kappa = np.ones(len(edges)) if kappa is None else kappa
    return RotationGraph(n, edges, np.tile(np.eye(3), (len(edges), 1, 1)), kappa)


def complete_graph(n):
    return identity_graph(n, np.c_[np.triu_indices(n, 1)])


def cycle_graph(n):
    return identity_graph(n, np.c_[np.arange(n), (np.arange(n) + 1) % n])


def published_alpha(graph):
    problem = Quadratic(graph)
    return alpha_max(fiedler_value(problem) / problem.node_weights.max())


def test_closed_forms_of_alpha_max():
    assert np.degrees(published_alpha(complete_graph(3))) == pytest.approx(60.0, abs=1e-6)
    assert np.degrees(published_alpha(cycle_graph(6))) == pytest.approx(23.9057, abs=5e-5)
    assert np.degrees(alpha_max(1.0)) == pytest.approx(42.9414, abs=5e-5)
    assert np.degrees(published_alpha(complete_graph(40))) > 42.9414
    # Two nodes have the largest connectivity, 2; small ones keep all digits.
    assert alpha_max(2.0) == pytest.approx(2.0 * np.arcsin((np.sqrt(5.0) - 1.0) / 2.0), rel=1e-12)
    assert published_alpha(complete_graph(2)) == pytest.approx(alpha_max(2.0), rel=1e-9)
    assert alpha_max(1e-13) == pytest.approx(1e-13, rel=1e-12)


@pytest.mark.parametrize("n", [3, 8, 25])
def test_fiedler_values_of_complete_and_cycle_graphs(n):
    assert fiedler_value(Quadratic(complete_graph(n))) == pytest.approx(n, rel=1e-9)
    expected = 2 * (1 - np.cos(2 * np.pi / n))
    assert fiedler_value(Quadratic(cycle_graph(n))) == pytest.approx(expected, rel=1e-9)
    # On regular graphs the normalized value is the same up to the degree.
    nu = normalized_fiedler_value(Quadratic(cycle_graph(n)))
    assert nu == pytest.approx(expected / 2, rel=1e-9)


#: DESIGN section 3, degrees: Theorem 4.1 and the normalized bound, on viewing graphs.
VIEWING_GRAPHS = {"Notre_Dame": (0.219, 27.30), "Ellis_Island": (0.244, 19.79)}


@pytest.mark.parametrize("name", VIEWING_GRAPHS)
def test_normalized_bound_on_viewing_graphs(name, dataset_path):
    graph = read(dataset_path(f"{name}.mat"), quiet=True).graph
    old, new = VIEWING_GRAPHS[name]
    assert np.degrees(published_alpha(graph)) == pytest.approx(old, abs=1e-3)
    ours = alpha_max(normalized_fiedler_value(Quadratic(graph)))
    assert np.degrees(ours) == pytest.approx(new, abs=1e-2)


def test_sphinx(dataset):
    problem = Quadratic(dataset("sphinx_SO3").graph).with_unit_weights()
    assert np.degrees(published_alpha(problem.graph)) == pytest.approx(8.879, abs=1e-3)
    ours = alpha_max(normalized_fiedler_value(problem))
    assert np.degrees(ours) == pytest.approx(14.122, abs=1e-3)


@settings(max_examples=60)
@given(seeds, dimensions)
def test_normalized_is_never_weaker(seed, d):
    graph, _ = rotation_graph(rng_of(seed), 8, d)
    problem = Quadratic(graph)
    dense = np.linalg.eigvalsh(problem.laplacian.toarray())[1]
    assert fiedler_value(problem) == pytest.approx(dense, rel=1e-7)
    scaling = np.diag(problem.node_weights**-0.5)
    nu = np.linalg.eigvalsh(scaling @ problem.laplacian.toarray() @ scaling)[1]
    assert normalized_fiedler_value(problem) == pytest.approx(nu, rel=1e-7)
    assert nu >= dense / problem.node_weights.max() * (1 - 1e-12)


def smallest_certificate_eigenvalue(problem, point):
    S = problem.certificate_matrix(problem.multipliers(point)).toarray()
    return np.linalg.eigvalsh(S)[0] / problem.node_weights.max()


@settings(max_examples=150)
@given(seeds, dimensions, st.sampled_from([0.02, 0.1, 0.3, 0.6]))
def test_stationary_points_within_a_bound_are_optimal(seed, d, noise):
    rng = rng_of(seed)
    n = int(rng.integers(3, 9))
    graph, R = rotation_graph(rng, n, d, extra=int(rng.integers(0, 2 * n)), noise=noise)
    problem = Quadratic(graph)
    point = newton(problem, Estimate(R), NewtonSettings(max_iterations=200)).estimate
    largest = problem.residual_angles(point).max()
    b = bounds_of(problem, point)
    within = (
        largest <= b.alpha_max
        or largest <= b.normalized_alpha_max
        or b.row_bound_holds
        or bool(b.cycle_sum_holds)
        or (b.cycle is not None and largest <= b.cycle)
    )
    if within:
        assert smallest_certificate_eigenvalue(problem, point) > -1e-9
    assert b.spectral <= problem.cost(point) * (1 + 1e-9) + 1e-12


def test_row_bound_sums_parallel_edges_before_norms():
    turn = so.exp(np.array([0.0, 0.0, 0.4]))
    graph = RotationGraph(2, np.array([[0, 1], [1, 0]]), np.stack([turn, turn]), np.ones(2))
    problem = Quadratic(graph)
    # The two measurements disagree symmetrically about the identity: off-diagonal sum 2 (1 - cos).
    rows = row_bound(problem, Estimate(np.tile(np.eye(3), (2, 1, 1))))
    np.testing.assert_allclose(rows, 2 * (1 - np.cos(0.4)), rtol=1e-12, atol=0)


@settings(max_examples=20)
@given(seeds, dimensions)
def test_row_bounds_are_those_of_the_certificate_matrix_in_the_gauge_of_the_estimate(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 6, d, noise=1.0)
    problem, point = Quadratic(graph), Estimate(so.random(rng, 6, d))
    S = problem.certificate_matrix(problem.multipliers(point)).toarray().reshape(6, d, 6, d)
    R = point.rotations
    turned = np.einsum("iab,ibjc,jdc->iajd", R, S, R)
    delta = turned - np.einsum("ij,ab->iajb", problem.laplacian.toarray(), np.eye(d))
    norms = np.linalg.norm(delta, 2, axis=(1, 3)).sum(axis=1)
    rows = row_bound(problem, point)
    np.testing.assert_allclose(rows, norms / problem.node_weights, rtol=1e-10, atol=0)


def test_every_bound_is_the_one_it_is_called():
    """A weighted star with a chord: its nodes differ in weight, and no two bounds agree."""
    edges, kappa = [[0, 1], [0, 2], [0, 3], [1, 2]], [1.0, 2.0, 5.0, 0.5]
    graph = identity_graph(4, edges, kappa)
    problem = Quadratic(graph)
    x = Estimate(so.exp(np.random.default_rng(0).uniform(-0.1, 0.1, (4, 3))))
    b = bounds_of(problem, x)
    L = problem.laplacian.toarray()
    scaling = np.diag(problem.node_weights**-0.5)
    nu = np.linalg.eigvalsh(scaling @ L @ scaling)[1]
    assert b.fiedler == pytest.approx(np.linalg.eigvalsh(L)[1], rel=1e-9)
    assert b.alpha_max == pytest.approx(alpha_max(np.linalg.eigvalsh(L)[1] / 8.0), rel=1e-9)
    assert b.normalized_alpha_max == pytest.approx(alpha_max(nu), rel=1e-9)
    assert (b.spectral, b.cycle, b.cycle_sum_holds) == (pytest.approx(0.0, abs=1e-9), None, None)
    # The row bound is about the worst node.
    far = Estimate(so.exp(np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 3.0]])))
    assert row_bound(problem, far).min() < nu < row_bound(problem, far).max()
    assert bounds_of(problem, far).row_bound_holds is False
    truth = Estimate(np.tile(np.eye(3), (4, 1, 1)))
    assert bounds_of(problem, truth).row_bound_holds is True


@pytest.mark.parametrize("k", [0, 1])
def test_cycle_bounds_know_the_winding(k):
    instance, estimate = winding_cycle(12, 0.7, k)
    problem = Quadratic(instance.graph)
    assert cycle_bound(instance.graph) == pytest.approx(np.pi / 12)
    assert cycle_sum_holds(problem, estimate) is (k == 0)
    largest = problem.residual_angles(estimate).max()
    assert bool(largest <= cycle_bound(instance.graph)) is (k == 0)


def test_weighted_cycles_may_exceed_pi_over_n_and_still_be_optimal():
    n = 5
    weights = np.array([1.0, 50.0, 50.0, 50.0, 50.0])
    turns = so.exp(np.r_[np.zeros((n - 1, 3)), [[0.0, 0.0, 2.5]]])
    flip = np.array([False, True, False, True, False])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    edges = np.where(flip[:, None], np.c_[j, i], np.c_[i, j])
    R = np.where(flip[:, None, None], np.swapaxes(turns, 1, 2), turns)
    problem = Quadratic(RotationGraph(n, edges, R, weights))
    assert cycle_bound(problem.graph) is None
    point = newton(problem, Estimate(np.tile(np.eye(3), (n, 1, 1)))).estimate
    angles = problem.residual_angles(point)
    assert angles.sum() == pytest.approx(2.5, rel=1e-9)
    assert angles.max() > np.pi / n
    assert cycle_sum_holds(problem, point) is True
    assert smallest_certificate_eigenvalue(problem, point) > -1e-9


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.5, 1.0 - 1e-6, 1.0 + 1e-6, 1.1]), st.booleans())
def test_the_cycle_sum_is_of_residuals_about_one_axis_and_of_one_sign(seed, turns, bent):
    """Residuals of any sizes along a cycle of edges either way, pi times `turns` in all."""
    rng, n = rng_of(seed), 6
    R, axis = so.random(rng, n, 3), rng.standard_normal(3)
    sizes = rng.uniform(0.2, 1.0, n)
    vectors = np.outer(np.pi * turns * sizes / sizes.sum(), axis / np.linalg.norm(axis))
    if bent:  # one of them about another axis, or the other way round
        vectors[2] = vectors[2][[1, 2, 0]] if seed % 2 else -vectors[2]
    i, j = np.arange(n), (np.arange(n) + 1) % n
    # R_i R_ij R_j^T is the residual in the world's frame.
    measured = np.swapaxes(R[i], 1, 2) @ so.exp(vectors) @ R[j]
    flip = rng.random(n) < 0.5
    edges = np.where(flip[:, None], np.c_[j, i], np.c_[i, j])
    measured = np.where(flip[:, None, None], np.swapaxes(measured, 1, 2), measured)
    order = rng.permutation(n)
    kappa = rng.uniform(0.5, 2.0, n)
    problem = Quadratic(RotationGraph(n, edges[order], measured[order], kappa))
    assert cycle_sum_holds(problem, Estimate(R)) is (turns <= 1.0 and not bent)
    exact = Quadratic(identity_graph(n, edges[order], kappa))
    assert cycle_sum_holds(exact, Estimate(np.tile(np.eye(3), (n, 1, 1)))) is True


def test_a_cycle_of_weights_that_differ_has_no_bound_by_its_length():
    for scale in (1e-3, 1e3):
        for last, equal in ((1.0 + 1e-8, True), (1.0 + 1e-4, False)):
            kappa = scale * np.array([1.0, 1.0, last])
            bound = cycle_bound(identity_graph(3, [[0, 1], [1, 2], [2, 0]], kappa))
            assert (bound is not None) == equal


def test_graphs_that_are_no_cycle_have_no_cycle_bound():
    problem = Quadratic(complete_graph(4))
    point = Estimate(np.tile(np.eye(3), (4, 1, 1)))
    assert cycle_bound(problem.graph) is None
    assert cycle_sum_holds(problem, point) is None
    assert bounds_of(problem, point).cycle is None


def test_bounds_need_stationarity():
    """K_4 with exact data: residuals of 44 < 54.4 degrees at a point that is not optimal."""
    problem = Quadratic(complete_graph(4))
    rng = np.random.default_rng(0)
    found = False
    for _ in range(200):
        x = Estimate(so.exp(0.4 * rng.standard_normal((4, 3))))
        if (
            problem.residual_angles(x).max() < published_alpha(problem.graph)
            and problem.cost(x) > 1
        ):
            found = True
    assert found
