"""Chatterjee and Govindu's L1-IRLS."""

import sys

import numpy as np
import pytest
from hypothesis import given
from scipy.optimize import linprog
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import io, registry
from certpgo.errors import InputError, SpecError
from certpgo.graph import Estimate, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status
from certpgo.solve import metrics


def solver(**settings):
    return registry.get_solver("chatterjee_govindu")(**settings)


def module():
    return sys.modules[type(solver()).__module__]


def problem_with(seed, n, d, *, noise=0.05, extra=None, outliers=0.0):
    """A problem some of whose measurements are random, and the true rotations."""
    rng = rng_of(seed)
    graph, truth = rotation_graph(rng, n, d, noise=noise, extra=extra, weights=False)
    bad = rng.permutation(graph.num_edges)[: round(outliers * graph.num_edges)]
    R = graph.rotations.copy()
    R[bad] = so.random(rng, len(bad), d)
    return Quadratic(RotationGraph(n, graph.edges, R, graph.kappa)), Estimate(truth)


def test_l1_regression_of_two_nodes_takes_medians():
    rng = rng_of(1)
    b = rng.standard_normal((7, 3))
    problem = Quadratic(
        RotationGraph(2, np.tile([0, 1], (7, 1)), np.tile(np.eye(3), (7, 1, 1)), np.ones(7))
    )
    factor = module().laplacian_factor(problem, np.ones(7))
    delta = module().l1_regression(problem, factor, b, 1000)
    np.testing.assert_allclose(delta, [np.zeros(3), np.median(b, axis=0)], atol=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_l1_regression_agrees_with_linear_programming(d):
    problem, _ = problem_with(2, 8, d)
    m, n = problem.graph.num_edges, problem.n
    b = rng_of(3).standard_normal((m, so.tangent_dim(d)))
    factor = module().laplacian_factor(problem, np.ones(m))
    delta = module().l1_regression(problem, factor, b, 2000)
    i, j = problem.graph.edges.T
    A = np.zeros((m, n))
    A[np.arange(m), j] += 1.0
    A[np.arange(m), i] -= 1.0
    eye = np.eye(m)
    least = sum(
        linprog(
            np.r_[np.zeros(n), np.ones(m)],
            A_ub=np.block([[A, -eye], [-A, -eye]]),
            b_ub=np.r_[column, -column],
            bounds=[(None, None)] * n + [(0, None)] * m,
        ).fun
        for column in b.T
    )
    assert np.abs(A @ delta - b).sum() == pytest.approx(least, rel=1e-4)
    np.testing.assert_array_equal(delta[0], 0.0)


def test_weights_of_the_half_loss():
    np.testing.assert_allclose(module().half_weights(np.array([1.0, 4.0, 0.25])), [1, 0.125, 8])
    np.testing.assert_allclose(module().half_weights(np.array([0.0, 1e-9])), 1e8)


@pytest.mark.parametrize("d", [2, 3])
def test_residuals_vanish_to_first_order_with_the_turns(d):
    problem, truth = problem_with(4, 6, d)
    R = truth.rotations
    i, j = problem.graph.edges.T
    delta = 1e-6 * rng_of(5).standard_normal((6, so.tangent_dim(d)))
    # Exact measurements, so that the residual is small and turns add up.
    exact = Quadratic(
        RotationGraph(6, problem.graph.edges, np.swapaxes(R[i], 1, 2) @ R[j], np.ones(len(i)))
    )
    moved = module().logarithms(exact, so.exp(delta) @ R)
    np.testing.assert_allclose(moved, delta[i] - delta[j], atol=1e-10)


@given(seed=seeds, d=dimensions)
def test_exact_measurements_are_fitted(seed, d):
    problem, _ = problem_with(seed, 9, d, noise=0.0)
    solution = solver().solve(problem)
    assert solution.cost < 1e-20 * problem.scale
    assert solution.status is Status.CONVERGED
    assert set(solution.seconds) == {"start", "l1", "irls"}


@pytest.mark.parametrize("l1_iterations", [0, 10])
@pytest.mark.parametrize("d", [2, 3])
def test_it_resists_outliers_that_mislead_eigenvectors(d, l1_iterations):
    problem, truth = problem_with(6, 40, d, noise=0.005, extra=400, outliers=0.2)
    ours = solver(l1_iterations=l1_iterations).solve(problem)
    theirs = registry.get_solver("eigen_ra")().solve(problem)
    assert ours.status is Status.CONVERGED
    assert metrics.angular_errors(ours.estimate, truth).worst_deg < 0.7
    assert metrics.angular_errors(theirs.estimate, truth).worst_deg > 2.5


@given(seed=seeds, d=dimensions)
def test_no_small_turn_lowers_the_loss(seed, d):
    problem, _ = problem_with(seed, 8, d, noise=0.1)
    R = solver(tolerance=1e-7).solve(problem).estimate.rotations

    def loss(R):
        return np.sqrt(np.linalg.norm(module().logarithms(problem, R), axis=1)).sum()

    turns = 1e-3 * rng_of(seed).standard_normal((20, 8, so.tangent_dim(d)))
    assert loss(R) <= min(loss(so.exp(turn) @ R) for turn in turns)


@pytest.mark.parametrize("d", [2, 3])
def test_a_turned_world_turns_the_answer(d):
    problem, truth = problem_with(7, 12, d)
    S = so.random(rng_of(8), 1, d)[0]
    method = solver(l1_iterations=0)  # the l1 norm sees the axes of the world
    ours = method.solve(problem, initial=truth).estimate
    theirs = method.solve(problem, initial=truth.moved(S)).estimate
    np.testing.assert_allclose(theirs.rotations, S @ ours.rotations, atol=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_neither_names_nor_directions_of_edges_matter(d):
    problem, truth = problem_with(9, 12, d)
    graph, names = problem.graph, rng_of(10).permutation(12)
    flip = rng_of(11).random(graph.num_edges) < 0.5
    edges, R = names[graph.edges], graph.rotations.copy()
    edges[flip], R[flip] = edges[flip][:, ::-1], np.swapaxes(R[flip], 1, 2)
    other = Quadratic(RotationGraph(12, edges, R, graph.kappa))
    back = Estimate(truth.rotations[np.argsort(names)])
    # IRLS alone: the method of multipliers is stopped early, where its held node still shows.
    method = solver(l1_iterations=0, tolerance=1e-8, max_iterations=1000)
    ours = method.solve(problem, initial=truth).estimate.anchored(0)
    theirs = method.solve(other, initial=back).estimate.anchored(names[0])
    np.testing.assert_allclose(theirs.rotations[names], ours.rotations, atol=1e-6)


def test_translations_are_left_aside():
    graph = pose_graph(rng_of(12), 8, 3)[0]
    solution = solver().solve(Quadratic(graph))
    alone = solver().solve(Quadratic(graph.rotations_alone))
    assert solution.estimate.translations is None
    assert solution.cost == alone.cost
    method = type(solver())
    assert (method.poses, method.rotations) == (False, True)


def test_the_graph_s_own_weights_play_no_part():
    problem, _ = problem_with(13, 10, 3)
    heavier = Quadratic(problem.graph.with_weights(rng_of(1).uniform(1, 5, 29)))
    ours, theirs = (solver().solve(p).estimate.rotations for p in (problem, heavier))
    # Only the tree may choose the heavier of parallel edges.
    assert np.abs(ours - theirs).max() < 0.05


def test_it_can_be_stopped_and_limited():
    problem, truth = problem_with(14, 10, 3)
    stopped = solver().solve(problem, monitor=lambda iteration: iteration.number == 1)
    assert (stopped.status, stopped.iterations) == (Status.INTERRUPTED, 1)
    limited = solver(max_iterations=2, tolerance=0.0).solve(problem, initial=truth)
    assert (limited.status, limited.iterations) == (Status.ITERATION_LIMIT, 2)
    assert limited.cost == problem.cost(limited.estimate)


def test_an_initial_estimate_of_another_graph_is_refused():
    problem, _ = problem_with(15, 10, 3)
    with pytest.raises(InputError, match="10 in 3D"):
        solver().solve(problem, initial=problem_with(15, 9, 3)[1])


def test_ellis_island_is_as_accurate_as_printed(dataset, dataset_path):
    instance = dataset("Ellis_Island")
    nodes, truth = io.read_truth(dataset_path("Ellis_Island_truth"), instance)
    solution = solver().solve(Quadratic(instance.graph))
    errors = metrics.angular_errors(solution.estimate.subset(nodes), truth, norm="l1")
    # Thesis Table 5.4, from the authors' paper: 2.87, 0.51 and 10.36.
    assert errors.mean_deg == pytest.approx(2.87, abs=0.03)
    assert errors.median_deg == pytest.approx(0.51, abs=0.01)
    assert errors.rmse_deg == pytest.approx(10.36, abs=0.03)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"l1_iterations": -1}, "l1_iterations must not be negative"),
        ({"inner_iterations": 0}, "at least 1"),
        ({"max_iterations": 0}, "at least 1"),
        ({"tolerance": -1e-9}, "tolerance must not be negative"),
    ],
)
def test_settings_are_validated_at_construction(settings, message):
    with pytest.raises(SpecError, match=message):
        solver(**settings)
