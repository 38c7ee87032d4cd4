"""Proofs by cycles of wrenches: the identity they rest on, laws, and agreement with F*."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo import PoseGraph, RotationGraph, read, solve
from certpgo.certify.wrenches import _Exact, _passes, _rounded, prove_poses
from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import NewtonSettings, newton


def stationary(graph):
    problem = Quadratic(graph)
    start = solve(graph, cost="chordal").estimate
    return problem, newton(problem, start, NewtonSettings(max_iterations=100)).estimate


@given(seeds, dimensions)
@settings(max_examples=20)
def test_edges_add_up_to_the_certificate_matrix(seed, d):
    """S = sum Q_e(z_j - z_i) + 2 z_i Om_e z_j at stationary estimates, in units and frames."""
    problem, here = stationary(pose_graph(rng_of(seed), 5, d, extra=3)[0])
    exact = _Exact(problem, here)
    Q, Om = exact.forms()
    n, D = problem.n, d + 1
    total, gauge = np.zeros((n, D, n, D)), np.zeros((n, D, n, D))
    for e, (i, j) in enumerate(problem.graph.edges):
        total[i, :, i] += Q[e]
        total[j, :, j] += Q[e]
        total[i, :, j] += Om[e] - Q[e]
        total[j, :, i] += Om[e].T - Q[e]
    # Units: a power of two for lengths and for weights; positions are from the middle.
    length = np.median(exact.t / problem.graph.translations)
    for k in range(n):
        gauge[k, 0, k, 0] = 1.0 / length
        gauge[k, 1:, k, 0] = exact.p[k] / length
        gauge[k, 1:, k, 1:] = here.rotations[k]
    N = gauge.reshape(n * D, -1)
    S = problem.certificate_matrix(problem.multipliers(here)).toarray()
    expected = np.ldexp(N @ S @ N.T, -exact.weight)
    found = total.reshape(n * D, -1)
    assert np.abs(found - expected).max() < 1e-10 * np.abs(expected).max()


@given(seeds, st.integers(2, 5), st.sampled_from([3, 4]))
@settings(max_examples=40)
def test_a_cycle_of_matrix_springs_passes_where_its_form_is_positive(seed, m, D):
    rng = rng_of(seed)
    Q = rng.standard_normal((m, D, D))
    Q = Q @ np.swapaxes(Q, 1, 2) - rng.uniform(0.0, 1.0) * np.eye(D)
    Om = rng.uniform(0.0, 1.5) * rng.standard_normal((D, D))
    Om -= Om.T
    form = np.zeros((m, D, m, D))
    for k in range(m):
        j = (k + 1) % m
        form[k, :, k] += Q[k]
        form[j, :, j] += Q[k]
        form[k, :, j] += Om - Q[k]
        form[j, :, k] += Om.T - Q[k]
    form = form.reshape(m * D, -1)
    # All constant vectors are in its kernel.
    eigenvalues = np.linalg.eigvalsh(form)
    passes = _passes([_rounded(spring) for spring in Q], _rounded(Om))
    assert not passes or eigenvalues[0] > -1e-9
    assert passes or eigenvalues[0] < 1e-6


@given(seeds, dimensions, st.sampled_from([0.0, 1e-4, 1e-2]))
@settings(max_examples=8)
def test_the_bound_is_below_the_optimum_and_closes_there(seed, d, far):
    rng = rng_of(seed)
    graph = pose_graph(rng, 4, d, extra=2, noise=0.15)[0]
    problem, here = stationary(graph)
    best = solve(graph, cost="chordal").certificate
    turn = so.exp(far * rng.standard_normal((4, so.tangent_dim(d))))
    moved = here.translations + far * rng.standard_normal((4, d))
    proof = prove_poses(problem, Estimate(here.rotations @ turn, moved))
    assert proof.lower_bound <= best.cost_upper
    assert proof.cost >= best.lower_bound
    if far == 0.0 and proof.margin > 1e-3:
        assert proof.proven
        assert proof.cost - proof.lower_bound <= 1e-10 * proof.cost
    if proof.proven:
        assert proof.cost - best.cost_upper <= 2e-5 * proof.cost


def test_tiny_grid(dataset_path):
    problem, here = stationary(read(dataset_path("tinyGrid3D.g2o"), quiet=True).graph)
    proof = prove_poses(problem, here, most=0)
    assert proof.proven
    assert 0.5 < proof.margin < 1.0
    assert proof.lower_bound == pytest.approx(proof.cost, rel=1e-12)
    # Every edge of a cycle is held, and the shares of its wrench add up.
    for edge in set(proof.cycles.edges.tolist()):
        assert sum(proof.holding(edge).values()) == pytest.approx(1.0, abs=1e-6)
    assert proof.holding(0) == {}  # a bridge


def test_units_and_gauge():
    graph = pose_graph(rng_of(4), 4, 2, extra=2, noise=0.15)[0]
    problem, here = stationary(graph)
    proof = prove_poses(problem, here)
    turn = so.random(rng_of(1), 1, 2)[0]
    there = Estimate(turn @ here.rotations, here.translations @ turn.T + 5.0)
    again = prove_poses(problem, there)
    assert again.margin == pytest.approx(proof.margin, rel=1e-5)
    rotation = RotationGraph(4, graph.edges, graph.rotations, 7.0 * graph.kappa)
    scaled = PoseGraph(rotation, 10.0 * graph.translations, 0.07 * graph.tau)
    again = prove_poses(Quadratic(scaled), Estimate(here.rotations, 10.0 * here.translations))
    assert again.margin == pytest.approx(proof.margin, rel=1e-5)
    assert again.lower_bound == pytest.approx(7.0 * proof.lower_bound, rel=1e-9)


def test_refusals():
    graph = pose_graph(rng_of(4), 4, 2)[0]
    problem, here = stationary(graph)
    with pytest.raises(InputError, match="relative poses"):
        prove_poses(problem.rotation, Estimate(here.rotations))
    weights = np.tile(np.diag([1.0, 2.0, 3.0]), (graph.num_edges, 1, 1))
    with pytest.raises(InputError, match="isotropic"):
        prove_poses(Quadratic(graph.with_matrix_weights(weights)), here)
