"""EIG-SE(3): eigenvectors and singular vectors of the block matrix, against dense ones."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import registry
from certpgo.errors import SpecError
from certpgo.graph import PoseGraph
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status
from certpgo.solve import metrics

VECTORS = ["eigen", "singular"]
KINDS = ["poses", "rotations"]


def solver(**settings):
    return registry.get_solver("eig_se3")(**settings)


def parts():
    solver()
    return sys.modules["certpgo_baselines._eig_se3"]


def graph_of(kind, seed, n, d, **options):
    make = pose_graph if kind == "poses" else rotation_graph
    return make(rng_of(seed), n, d, **options)[0]


def cost(graph, **settings):
    return solver(**settings).solve(Quadratic(graph)).cost


def dense(problem, weights):
    """The thesis' matrix A of weighted blocks and the degrees, by a loop over the edges."""
    rotation, d = problem.rotation.graph, problem.d
    b = d + problem.graph.has_positions
    A, degree = np.zeros((problem.n, b, problem.n, b)), np.zeros(problem.n)
    for e, (i, j) in enumerate(rotation.edges):
        M = np.eye(b)
        M[:d, :d] = rotation.rotations[e]
        if b > d:
            M[:d, d] = problem.graph.translations[e]
        A[i, :, j] += weights[e] * M
        A[j, :, i] += weights[e] * np.linalg.inv(M)
        degree[[i, j]] += weights[e]
    return A.reshape(problem.n * b, -1), np.repeat(degree, b)


def test_the_printed_digits_of_the_sphere(dataset):
    graph = dataset("sphere_bignoise_vertex3", unit_weights=True).graph
    solution = solver().solve(Quadratic(graph))
    assert f"{metrics.f_ml(graph, solution.estimate):.1f}" == "-516589.2"
    assert solution.status is Status.CLOSED_FORM


@pytest.mark.parametrize("vectors", VECTORS)
@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, d=dimensions)
def test_exact_measurements_are_fitted(kind, vectors, seed, d):
    problem = Quadratic(graph_of(kind, seed, 9, d, noise=0.0))
    solution = solver(vectors=vectors).solve(problem)
    assert solution.cost < 1e-14 * problem.scale
    assert set(solution.seconds) == {"eigen", "round"}


@pytest.mark.parametrize("vectors", VECTORS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [2, 3])
def test_two_or_three_nodes_are_enough(n, d, kind, vectors):
    problem = Quadratic(graph_of(kind, 1, n, d, noise=0.0, extra=0))
    assert solver(vectors=vectors).solve(problem).cost < 1e-14 * problem.scale


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("noise", [0.05, 0.5, 2.0])
@given(seed=seeds, d=dimensions)
def test_eigenvectors_are_those_of_the_dense_matrix(kind, noise, seed, d):
    problem = Quadratic(graph_of(kind, seed, 12, d, noise=noise, extra=24))
    weights, loop = problem.rotation.graph.kappa, 0.7
    A, degree = dense(problem, weights)
    P = (A + loop * np.eye(len(A))) / (degree + loop)[:, None]
    V = parts().leading_eigenvectors(problem, weights, loop, tol=1e-10)
    np.testing.assert_allclose(np.linalg.norm(V, axis=0), 1.0)
    values = np.sum(V * (P @ V), axis=0)
    np.testing.assert_allclose(P @ V, V * values, atol=1e-6)
    leading = np.sort(np.linalg.eigvals(P).real)[::-1][: V.shape[1]]
    np.testing.assert_allclose(np.sort(values)[::-1], leading, atol=1e-6)


def test_noise_puts_eigenvectors_of_the_graph_in_place_of_rotations():
    for noise, spurious in ((0.01, False), (2.0, True)):
        problem = Quadratic(pose_graph(rng_of(3), 30, 3, noise=noise, extra=60)[0])
        ones = np.ones(problem.graph.num_edges)
        V = parts().leading_eigenvectors(problem, ones, 1.0, tol=1e-9)
        last = V.reshape(-1, 4, 4)[:, 3]
        assert (np.ptp(last, axis=0) > 1e-9).any() == spurious
        assert np.ptp(last[:, 0]) < 1e-12 < abs(last[0, 0])


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, d=dimensions)
def test_singular_vectors_span_what_the_dense_ones_span(kind, seed, d):
    problem = Quadratic(graph_of(kind, seed, 10, d, noise=0.1))
    weights = problem.rotation.graph.kappa
    A, degree = dense(problem, weights)
    V = parts().trailing_singular_vectors(problem, weights, tol=1e-10)
    b = V.shape[1]
    _, s, Vt = np.linalg.svd(np.diag(degree) - A)
    reached = np.linalg.norm((np.diag(degree) - A) @ V)
    np.testing.assert_allclose(reached, np.linalg.norm(s[-b:]), rtol=1e-5)
    np.testing.assert_allclose(Vt[:-b] @ V, 0.0, atol=1e-5)


def test_on_regular_graphs_rotations_are_those_of_eigen_ra():
    graph = synthetic.complete(9, 0.3, rng_of(2)).graph
    problem = Quadratic(graph)
    theirs = registry.get_solver("eigen_ra")(weights="unit", tol=1e-10).solve(problem)
    for vectors in VECTORS:
        assert solver(vectors=vectors).solve(problem).cost == pytest.approx(theirs.cost, rel=1e-9)


@pytest.mark.parametrize("vectors", VECTORS)
@pytest.mark.parametrize("d", [2, 3])
def test_small_noise_moves_it_from_eigen_ma_as_little(vectors, d):
    graph = pose_graph(rng_of(4), 20, d, noise=1e-5, extra=60, weights=False)[0]
    problem = Quadratic(graph)
    ours = solver(vectors=vectors).solve(problem).estimate.anchored(0)
    theirs = registry.get_solver("eigen_ma")(tol=1e-10).solve(problem).estimate.anchored(0)
    assert np.abs(ours.rotations - theirs.rotations).max() < 1e-4
    assert np.abs(ours.translations - theirs.translations).max() < 1e-3
    # Nothing beats the least squares to first order.
    assert problem.cost(ours) > 0.99 * problem.cost(theirs)


@pytest.mark.parametrize("vectors", VECTORS)
@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, d=dimensions)
def test_neither_names_nor_directions_of_edges_matter(kind, vectors, seed, d):
    rng = rng_of(seed)
    graph = graph_of(kind, seed, 10, d, noise=0.05)
    names = rng.permutation(10)
    assert cost(relabelled(graph, names), vectors=vectors) == pytest.approx(
        cost(graph, vectors=vectors), rel=1e-4
    )
    flip = rng.random(graph.num_edges) < 0.5
    # Reversed translations have other residuals: rotations are what stays.
    problem = Quadratic(graph).rotation
    other = Quadratic(reversed_where(graph, flip))
    estimates = [solver(vectors=vectors).solve(p).estimate for p in (Quadratic(graph), other)]
    costs = [problem.cost(estimate) for estimate in estimates]
    assert costs[0] == pytest.approx(costs[1], rel=1e-4)


def relabelled(graph, names):
    return replace(graph, edges=names[graph.edges])


def reversed_where(graph, flip):
    edges, R, t = (a.copy() for a in (graph.edges, graph.rotations, graph.translations))
    edges[flip] = edges[flip][:, ::-1]
    R[flip] = np.swapaxes(R[flip], 1, 2)
    if graph.has_positions:
        t[flip] = -np.einsum("mab,mb->ma", R[flip], t[flip])
    return replace(graph, edges=edges, rotations=R, translations=t)


@pytest.mark.parametrize("kind", KINDS)
def test_graph_weights_are_kappa_alone_up_to_their_unit(kind):
    graph = graph_of(kind, 6, 12, 3, noise=0.1)

    def weighted(kappa):
        if kind == "rotations":
            return graph.with_weights(kappa)
        return graph.with_weights(kappa, graph.tau)

    problem = Quadratic(graph)
    costs = [
        problem.cost(solver(weights=weights).solve(Quadratic(weighted(kappa))).estimate)
        for weights, kappa in (
            ("graph", graph.kappa),
            ("graph", 4.0 * graph.kappa),
            ("graph", np.ones(graph.num_edges)),
            ("unit", graph.kappa),
        )
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-9)
    assert costs[2] == pytest.approx(costs[3], rel=1e-12)
    assert costs[0] != pytest.approx(costs[2], rel=1e-3)


def test_the_unit_of_length_does_not_matter_to_eigenvectors():
    graph = pose_graph(rng_of(7), 15, 3, noise=0.05)[0]
    longer = PoseGraph(graph.rotations_alone, 100.0 * graph.translations, graph.tau)
    ours, theirs = (solver().solve(Quadratic(g)).estimate.anchored(0) for g in (graph, longer))
    np.testing.assert_allclose(theirs.rotations, ours.rotations, atol=1e-8)
    np.testing.assert_allclose(theirs.translations, 100.0 * ours.translations, atol=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"vectors": "left"}, "unknown vectors 'left'"),
        ({"weights": "tau"}, "unknown weights 'tau'"),
        ({"tol": 0.0}, "tol must lie between 0 and 1"),
    ],
)
def test_settings_are_validated_at_construction(settings, message):
    with pytest.raises(SpecError, match=message):
        solver(**settings)
