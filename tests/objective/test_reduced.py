"""Translations eliminated: against dense Schur complements."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.errors import NumericalError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.reduced import ELIMINATED_SHIFTS, SHIFTS, Reduced
from certpgo.optimize.riemannian_newton import newton


def dense(problem, matrix=None):
    """The Schur complement of a matrix on the rotations."""
    A = (problem.matrix if matrix is None else matrix).toarray()
    if not problem.has_positions:
        return A
    turns = np.arange(len(A)) % (problem.d + 1) > 0
    inner = np.linalg.pinv(A[np.ix_(~turns, ~turns)])
    return A[np.ix_(turns, turns)] - A[np.ix_(turns, ~turns)] @ inner @ A[np.ix_(~turns, turns)]


def some_problem(rng, d, poses, n=7):
    graph, R, t = pose_graph(rng, n, d)
    return Quadratic(graph if poses else graph.rotations_alone), Estimate(R, t if poses else None)


@settings(max_examples=40)
@given(seeds, dimensions, st.booleans())
def test_products_and_solves_are_those_of_the_schur_complement(seed, d, poses):
    rng = rng_of(seed)
    problem, _ = some_problem(rng, d, poses)
    mean = float(problem.rotation.node_weights.mean())
    Q = Reduced(problem, shifts=(0.1 * mean,))
    N = problem.n * d
    assert Q.shape == (N, N)
    assert Q.shift == 0.1 * mean
    A = dense(problem) + Q.shift * np.eye(N)
    B = rng.standard_normal((N, 4))
    np.testing.assert_allclose(Q @ B, A @ B, rtol=0, atol=1e-10)
    np.testing.assert_allclose(Q.solve(B), np.linalg.solve(A, B), rtol=0, atol=1e-10)
    np.testing.assert_allclose(Q @ Q.solve(B), B, rtol=0, atol=1e-10)


@settings(max_examples=40)
@given(seeds, dimensions, st.booleans())
def test_the_quadratic_form_is_the_cost_with_the_best_translations(seed, d, poses):
    rng = rng_of(seed)
    problem, _ = some_problem(rng, d, poses)
    Q = Reduced(problem)
    for rank in (d, d + 2):
        Y = np.linalg.qr(rng.standard_normal((problem.n, rank, d)))[0]
        best = problem.with_optimal_translations(Lift(Y, rng.standard_normal((problem.n, rank))))
        B = np.swapaxes(Y, 1, 2).reshape(-1, rank)
        form = float(np.sum(B * (Q @ B))) - Q.shift * d * problem.n
        assert form == pytest.approx(problem.cost(best), rel=1e-10)


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_the_default_shift_is_the_smallest_that_serves(d, poses, engine, monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    rng = np.random.default_rng(d)
    problem, _ = some_problem(rng, d, poses)
    mean = float(problem.rotation.node_weights.mean())
    Q = Reduced(problem)
    assert Q.shift == mean * (ELIMINATED_SHIFTS if poses else SHIFTS)[0]
    assert Q.shift < 1e-8 * mean
    A = dense(problem) + Q.shift * np.eye(problem.n * d)
    B = rng.standard_normal((problem.n * d, 2))
    X = Q.solve(B)
    off = np.linalg.norm(A @ X - B) / (np.linalg.norm(A, 2) * np.linalg.norm(X))
    assert off < 1e-13
    padded = np.zeros((problem.matrix.shape[0], 2))
    width = d + 1 if poses else d
    turns = np.arange(len(padded)) % width >= width - d
    padded[turns] = B
    np.testing.assert_array_equal(Q.factor.solve(padded)[turns], X)


@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_a_certificate_matrix_is_eliminated_alike(d, poses):
    rng = np.random.default_rng(10 + d)
    problem, start = some_problem(rng, d, poses)
    x = problem.complete(newton(problem, start).estimate.rotations)
    matrix = problem.certificate_matrix(problem.multipliers(x))
    S = Reduced(problem, matrix, (0.01,))
    A = dense(problem, matrix)
    N = problem.n * d
    B = rng.standard_normal((N, 3))
    np.testing.assert_allclose(S @ B - S.shift * B, A @ B, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        S.solve(B), np.linalg.solve(A + 0.01 * np.eye(N), B), rtol=0, atol=1e-8
    )
    # The stationary point is in its null space.
    X = np.swapaxes(x.rotations, 1, 2).reshape(-1, d)
    np.testing.assert_allclose(S @ X, S.shift * X, rtol=0, atol=1e-9)


def test_shifts_are_tried_until_one_makes_the_matrix_definite():
    instance, wound = winding_cycle(20, 0.0, 1)
    problem = Quadratic(instance.graph)  # lambda_min = 2 cos(2 pi / 20) - 2 = -0.098
    matrix = problem.certificate_matrix(problem.multipliers(wound))
    assert Reduced(problem, matrix, (1e-9, 0.09, 0.11, 0.5)).shift == 0.11
    with pytest.raises(NumericalError, match="could not be factorized"):
        Reduced(problem, matrix, (1e-9, 0.09))


def test_a_turned_world_changes_nothing():
    """Products act on rows of the world's axes, each alike."""
    rng = np.random.default_rng(3)
    problem, x = some_problem(rng, 3, True)
    Q = Reduced(problem)
    B = np.swapaxes(x.rotations, 1, 2).reshape(-1, 3)
    S = so.random(rng, 1, 3)[0]
    np.testing.assert_allclose(Q @ (B @ S.T), (Q @ B) @ S.T, rtol=0, atol=1e-11)
