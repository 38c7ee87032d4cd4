"""Two spectra compared: perfect measurements, Weyl's inequality, the thesis' conjecture."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, rotation_graph, seeds

from certpgo.errors import InputError
from certpgo.graph import Estimate, RotationGraph
from certpgo.io.datasets import synthetic, thesis
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.consistency import consistency, inconsistency, perturbation_bound

#: Rounding of an eigenvalue, over the largest eigenvalue.
ROUNDING = 1e-10


@pytest.mark.parametrize("d", [2, 3])
def test_a_cycle_in_closed_form(d):
    # Every turn of the plane through theta shifts the frequencies by theta / n; in 3D the axis
    # itself keeps those of the graph.
    n, theta = 8, 0.9
    instance, _ = synthetic.winding_cycle(n, theta, 0, d)
    k = np.arange(n)
    turned = np.sort(
        2 - 2 * np.cos((2 * np.pi * np.r_[k, -k] + np.r_[theta, -theta].repeat(n)) / n)
    )
    plain = 2 - 2 * np.cos(2 * np.pi * k / n)
    found = consistency(Quadratic(instance.graph), n)
    np.testing.assert_allclose(found.graph, np.sort(plain), rtol=0, atol=1e-9)
    expected = turned if d == 2 else np.sort(np.concatenate([turned, plain]))
    np.testing.assert_allclose(found.measured.ravel(), expected, rtol=0, atol=1e-9)
    smallest = 2 - 2 * np.cos(theta / n) if d == 2 else 0.0
    assert found.inconsistency == pytest.approx(smallest / plain[1], abs=1e-9)


@settings(max_examples=40)
@given(seeds, dimensions, st.integers(2, 9), st.data())
def test_spectra_against_dense_algebra(seed, d, n, data):
    graph, _ = rotation_graph(rng_of(seed), n, d)
    problem = Quadratic(graph)
    k = data.draw(st.integers(2, n))
    found = consistency(problem, k)
    L_G, L = problem.laplacian.toarray(), problem.matrix.toarray()
    atol = ROUNDING * np.linalg.norm(L, 2)
    np.testing.assert_allclose(found.graph, np.linalg.eigvalsh(L_G)[:k], rtol=0, atol=atol)
    dense = np.linalg.eigvalsh(L)[: k * d].reshape(k, d)
    np.testing.assert_allclose(found.measured, dense, rtol=0, atol=atol)


@pytest.mark.parametrize("n", [30, 300])
def test_perfect_measurements_repeat_the_graph_s_spectrum(n):
    graph, R = rotation_graph(np.random.default_rng(1), n, 3, noise=0.0)
    problem = Quadratic(graph)
    found = consistency(problem, 5)
    assert found.differences.max() < 1e-9
    assert found.inconsistency < 1e-9
    assert perturbation_bound(problem, Estimate(R)) < 1e-12


@settings(max_examples=60)
@given(seeds, dimensions, st.sampled_from([0.0, 1e-3, 0.3, 2.0]))
def test_no_difference_exceeds_the_perturbation_bound(seed, d, noise):
    graph, R = rotation_graph(rng_of(seed), 8, d, noise=noise)
    problem = Quadratic(graph)
    found = consistency(problem, 8)
    rounding = ROUNDING * found.graph[-1]
    for estimate in (R, so.random(rng_of(seed), 8, d)):
        assert found.differences.max() <= perturbation_bound(problem, Estimate(estimate)) + rounding


@given(seeds, dimensions)
def test_the_bound_is_that_of_the_blocks_of_p(seed, d):
    graph, R = rotation_graph(rng_of(seed), 6, d, extra=3, noise=0.5)
    problem = Quadratic(graph.without_parallel_edges("first"))
    D = np.zeros((6 * d, 6 * d))
    for k in range(6):
        D[d * k : d * (k + 1), d * k : d * (k + 1)] = R[k]
    H = D.T @ np.kron(problem.laplacian.toarray(), np.eye(d)) @ D
    P = problem.matrix.toarray() - H
    blocks = P.reshape(6, d, 6, d).swapaxes(1, 2)
    rows = np.linalg.norm(blocks, 2, axis=(2, 3)).sum(axis=1)
    bound = perturbation_bound(problem, Estimate(R))
    assert bound == pytest.approx(rows.max(), rel=1e-9)
    assert np.linalg.norm(P, 2) <= bound * (1 + 1e-12)
    assert np.linalg.norm(P, np.inf) <= np.sqrt(d) * bound * (1 + 1e-12)


@given(seeds, dimensions)
def test_inconsistency_knows_no_scale_and_no_gauge(seed, d):
    graph, _ = rotation_graph(rng_of(seed), 7, d)
    S = so.random(rng_of(seed), 7, d)
    i, j = graph.edges.T
    turned = np.swapaxes(S[i], 1, 2) @ graph.rotations @ S[j]
    other = RotationGraph(7, graph.edges, turned, 1e6 * graph.kappa)
    one, two = (consistency(Quadratic(g)).inconsistency for g in (graph, other))
    assert one == pytest.approx(two, rel=1e-6, abs=1e-9)


def mean_inconsistency(sigma_deg):
    def draw(seed):
        rng = np.random.default_rng(seed)
        graph = thesis.langevin_graph(60, 20.0, sigma_deg, rng, graph_seed=4).graph
        return consistency(Quadratic(graph)).inconsistency

    return float(np.mean([draw(seed) for seed in range(5)]))


def test_the_trend_of_conjecture_3_2_1_on_a_well_connected_graph():
    means = [mean_inconsistency(sigma) for sigma in (0.0, 5.0, 10.0, 20.0, 40.0, 60.0)]
    assert means[0] < 1e-9
    assert np.all(np.diff(means) > 0.0)
    for sigma in (120.0, 1e6):  # all but uniform
        assert 0.8 < mean_inconsistency(sigma) < 1.0


def test_the_conjecture_s_limit_is_no_bound_on_poorly_connected_graphs():
    clique = np.argwhere(np.tri(20, k=-1))
    edges = np.concatenate([clique, clique + 20, [[0, 20]]])
    R = so.random(np.random.default_rng(0), len(edges), 3)
    found = consistency(Quadratic(RotationGraph(40, edges, R, np.ones(len(edges)))))
    assert found.graph[1] <= 40 / 20**2  # the cut of one edge
    assert found.inconsistency > 100.0


def test_the_thesis_own_sphere_is_above_the_conjecture_s_limit(dataset):
    problem = Quadratic(dataset("sphere_bignoise_vertex3").graph.rotations_alone)
    found = consistency(problem.with_unit_weights())
    assert f"{found.measured[0, 0]:.1e}" == "2.2e-01"  # printed in Table 5.6
    assert found.inconsistency == pytest.approx(14.24, abs=0.005)  # ours


def test_a_smallest_eigenvalue_below_zero_by_rounding_is_perfect():
    assert inconsistency(-1e-18, 2.0) == 0.0


@pytest.mark.parametrize("k", [1, 7])
def test_as_many_eigenvalues_as_there_are(k):
    graph, _ = rotation_graph(np.random.default_rng(0), 6, 3)
    with pytest.raises(InputError, match="2 to 6 eigenvalues"):
        consistency(Quadratic(graph), k)
