"""Rotation averaging by the scalar Laplacian: golden optima, laws, honesty where it stalls."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo.graph import Estimate, RotationGraph
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.laplacian_averaging import laplacian_gauss_newton
from certpgo.optimize.methods.laplacian_gauss_newton import LaplacianGaussNewton
from certpgo.optimize.riemannian_newton import newton
from certpgo.optimize.solution import Status

#: DESIGN section 5: rotations alone, the files' kappa.
OPTIMA = {
    "parking-garage": 0.001732578,
    "sphere2500": 885.362701,
    "torus3D": 12188.386283,
    "cubicle": 108.439655767,
}


def from_the_tree(problem, **options):
    tree = compose(problem.graph, spanning_tree(problem.graph))
    return laplacian_gauss_newton(problem, tree, **options)


def turned(rng, R, sigma):
    return R @ so.exp(sigma * rng.standard_normal((len(R), so.tangent_dim(R.shape[-1]))))


def never_rises(solution):
    costs = [step.cost for step in solution.trace]
    return all(b <= a * (1.0 + 1e-12) for a, b in itertools.pairwise(costs))


@pytest.mark.parametrize("name", OPTIMA)
def test_the_golden_optima_are_reached_from_the_spanning_tree(name, dataset):
    problem = Quadratic(dataset(name).graph.rotations_alone)
    solution = from_the_tree(problem)
    assert solution.status is Status.CONVERGED
    assert solution.cost == pytest.approx(OPTIMA[name], rel=2e-7)
    assert problem.stationarity(solution.estimate) < 1e-11
    assert solution.counts == {"factorizations": 1}
    assert never_rises(solution)


def test_it_stalls_where_the_residuals_are_large(dataset):
    problem = Quadratic(dataset("sphere_bignoise_vertex3").graph)
    solution = from_the_tree(problem.rotation)
    assert solution.status is Status.STALLED
    assert solution.trace[-1].gradient > 1e-3
    assert never_rises(solution)
    patient = LaplacianGaussNewton(max_iterations=5).solve(problem)
    assert patient.status in (Status.STALLED, Status.ITERATION_LIMIT)
    assert patient.cost == problem.cost(patient.estimate)


@settings(max_examples=40)
@given(seeds, dimensions)
def test_it_agrees_with_newton(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 9, d, noise=0.1)
    problem = Quadratic(graph)
    start = Estimate(turned(rng, R, 0.2))
    solution = laplacian_gauss_newton(problem, start)
    assert solution.status is Status.CONVERGED
    assert solution.cost == pytest.approx(newton(problem, start).cost, rel=1e-9)
    assert solution.cost == problem.cost(solution.estimate)
    assert never_rises(solution)


@settings(max_examples=30)
@given(seeds, dimensions)
def test_a_start_in_a_turned_world_gives_the_turned_answer(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 9, d, noise=0.1)
    problem = Quadratic(graph)
    start = Estimate(turned(rng, R, 0.2))
    S = so.random(rng, 1, d)[0]
    here, there = (
        laplacian_gauss_newton(problem, x, max_iterations=4, tolerance=0.0)
        for x in (start, start.moved(S))
    )
    np.testing.assert_allclose(
        there.estimate.rotations, S @ here.estimate.rotations, rtol=0, atol=1e-10
    )
    np.testing.assert_array_equal(here.estimate.rotations[0], start.rotations[0])  # held


@settings(max_examples=30)
@given(seeds, dimensions)
def test_other_names_for_the_nodes_give_the_same_answer(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 9, d, noise=0.1)
    start = Estimate(turned(rng, R, 0.2))
    name = rng.permutation(9)  # old node k is called name[k]
    renamed = RotationGraph(9, name[graph.edges], graph.rotations, graph.kappa)
    called = np.argsort(name)
    ours = laplacian_gauss_newton(Quadratic(graph), start)
    theirs = laplacian_gauss_newton(Quadratic(renamed), start.subset(called))
    assert theirs.cost == pytest.approx(ours.cost, rel=1e-9)
    back = theirs.estimate.subset(name).anchored(0).rotations
    np.testing.assert_allclose(back, ours.estimate.anchored(0).rotations, rtol=0, atol=1e-8)


@settings(max_examples=30)
@given(seeds, dimensions)
def test_noise_free_graphs_are_solved_exactly(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 9, d, noise=0.0)
    problem = Quadratic(graph)
    solution = laplacian_gauss_newton(problem, Estimate(turned(rng, R, 0.3)))
    assert solution.status is Status.CONVERGED
    assert solution.cost < 1e-20 * problem.scale
    assert from_the_tree(problem).iterations == 0


@settings(max_examples=30)
@given(seeds, dimensions)
def test_without_residuals_a_step_squares_the_distance(seed, d):
    rng = rng_of(seed)
    graph, R = rotation_graph(rng, 9, d, noise=0.0)
    start = Estimate(turned(rng, R, 1e-4))
    solution = laplacian_gauss_newton(Quadratic(graph), start, max_iterations=1)
    assert solution.trace[0].gradient > 1e-6
    assert solution.trace[1].gradient < 1e-6


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8])
def test_weights_of_any_scale(scale, d):
    graph, _ = rotation_graph(np.random.default_rng(d), 9, d, noise=0.1)
    one = from_the_tree(Quadratic(graph))
    other = from_the_tree(Quadratic(graph.with_weights(scale * graph.kappa)))
    assert other.status is one.status is Status.CONVERGED
    assert other.cost == pytest.approx(scale * one.cost, rel=1e-9)
    np.testing.assert_allclose(other.estimate.rotations, one.estimate.rotations, rtol=0, atol=1e-9)


@settings(max_examples=30)
@given(seeds, dimensions, st.sampled_from([2.0, 4.0, 8.0]))
def test_weights_of_different_size_in_one_graph(seed, d, decades):
    rng = rng_of(seed)
    graph, _ = rotation_graph(rng, 9, d, noise=0.05)
    kappa = 10.0 ** rng.uniform(-decades, decades, graph.num_edges)
    problem = Quadratic(graph.with_weights(kappa))
    solution = from_the_tree(problem)
    assert solution.status in (Status.CONVERGED, Status.STALLED)
    assert never_rises(solution)
    if solution.status is Status.CONVERGED:
        following = newton(problem, solution.estimate).cost
        assert solution.cost <= following + 1e-9 * solution.cost + 1e-16 * problem.scale


def test_limits_and_interruption():
    rng = np.random.default_rng(1)
    graph, R = rotation_graph(rng, 12, 3, noise=0.3)
    problem = Quadratic(graph)
    start = Estimate(turned(rng, R, 0.5))
    limited = laplacian_gauss_newton(problem, start, max_iterations=2)
    assert (limited.status, limited.iterations) == (Status.ITERATION_LIMIT, 2)
    stopped = laplacian_gauss_newton(problem, start, monitor=lambda step: step.number == 1)
    assert (stopped.status, stopped.iterations) == (Status.INTERRUPTED, 1)
    assert stopped.cost < problem.cost(start)


@pytest.mark.parametrize("patience", [1, 2, 5])
def test_as_many_slow_steps_as_patience_allows(patience):
    graph, _ = rotation_graph(np.random.default_rng(4), 30, 3, noise=1.0)
    problem = Quadratic(graph)
    solution = from_the_tree(problem, patience=patience)
    assert solution.status is Status.STALLED
    assert solution.iterations >= patience
    steps = list(itertools.pairwise(solution.trace))
    slow = [b.gradient > 0.5 * a.gradient and b.cost > 0.5 * a.cost for a, b in steps]
    assert all(slow[-patience:])
    assert not any(all(slow[k : k + patience]) for k in range(len(slow) - patience))


def test_the_method_completes_poses_and_takes_the_start_given():
    graph, R, t = pose_graph(np.random.default_rng(2), 12, 3)
    problem = Quadratic(graph)
    solution = LaplacianGaussNewton().solve(problem)
    assert "tree" in solution.seconds
    best = newton(problem.rotation, Estimate(R))
    assert problem.rotation.cost(solution.estimate) == pytest.approx(best.cost, rel=1e-9)
    completed = problem.complete(solution.estimate.rotations)
    np.testing.assert_array_equal(solution.estimate.translations, completed.translations)
    assert solution.cost == problem.cost(completed)
    told = LaplacianGaussNewton().solve(problem, initial=Estimate(R, t))
    assert "tree" not in told.seconds
    assert told.cost == pytest.approx(solution.cost, rel=1e-9)
