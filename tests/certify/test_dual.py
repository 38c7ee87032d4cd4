"""The factorization bound against exact eigenvalues and interval arithmetic."""

import math
from fractions import Fraction

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.certify import certificate_matrix, cost_upper, dual_bound
from certpgo.estimate import Estimate
from certpgo.linalg import factor, so
from certpgo.newton import newton
from certpgo.problem import PoseProblem, RotationProblem, problem_of


def optimum(seed, d, poses, n=7, noise=0.15):
    graph, R, t = pose_graph(rng_of(seed), n, d, noise=noise)
    problem = problem_of(graph if poses else graph.rotation)
    point = newton(problem, Estimate(R, t if poses else None)).estimate
    return problem, problem.complete(point.rotations)


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("poses", [True, False])
@settings(max_examples=25)
@given(seed=seeds, d=dimensions)
def test_the_shifted_matrix_is_positive_definite_in_ball_arithmetic(engine, poses, seed, d):
    """S(Lam') less its gauge, by a Cholesky factorization in 200-bit balls: an independent oracle."""
    problem, point = optimum(seed, d, poses)
    bound = dual_bound(problem, point)
    if bound is None:
        return
    S = certificate_matrix(problem, bound.multipliers).toarray()
    if poses:
        S = np.delete(np.delete(S, 0, 0), 0, 1)  # one translation pinned
    flint.ctx.prec = 200
    ball = flint.arb_mat(len(S), len(S), [flint.arb(float(x)) for x in S.ravel()])
    # Raises when some pivot cannot be shown positive: a failure of the bound.
    assert ball.cho() if hasattr(ball, "cho") else _cholesky_succeeds(S)
    assert bound.value <= math.fsum(np.trace(bound.multipliers, axis1=1, axis2=2))


def _cholesky_succeeds(S):
    """LDL^T in exact rational arithmetic."""
    A = [[Fraction(float(x)) for x in row] for row in S]
    n = len(A)
    for k in range(n):
        if A[k][k] <= 0:
            return False
        for i in range(k + 1, n):
            factor_ = A[i][k] / A[k][k]
            if factor_:
                for j in range(k, n):
                    A[i][j] -= factor_ * A[k][j]
    return True


@settings(max_examples=25)
@given(seed=seeds, d=dimensions)
def test_bound_is_sharp_at_tight_optima(seed, d):
    problem, point = optimum(seed, d, poses=True, noise=0.02)
    bound = dual_bound(problem, point)
    assert bound is not None
    assert bound.value <= problem.cost(point)
    assert problem.cost(point) - bound.value < 1e-8 * problem.scale
    assert bound.shift > 0.0
    assert bound.factorizations <= 8


def test_certificate_matrix_annihilates_the_stationary_point():
    problem, point = optimum(1, 3, poses=True)
    S = certificate_matrix(problem, problem.multipliers(point))
    X = np.concatenate([point.translations[:, :, None], point.rotations], axis=2)
    XT = np.swapaxes(X, 1, 2).reshape(-1, 3)
    np.testing.assert_allclose(S @ XT, 0.0, rtol=0, atol=1e-9)
    eigenvalues = np.linalg.eigvalsh(S.toarray())
    assert eigenvalues[0] > -1e-9
    assert eigenvalues[4] > 1e-4


def test_indefinite_certificate_matrices_give_the_eigenvalue_bound():
    """For rotations the best uniform shift is -lambda_min: the search must come close to it."""
    for seed in range(30):
        graph, R, _ = pose_graph(np.random.default_rng(seed), 6, 3, noise=1.0)
        problem = RotationProblem(graph.rotation)
        point = newton(problem, Estimate(R), max_iterations=300).estimate
        smallest = np.linalg.eigvalsh(
            certificate_matrix(problem, problem.multipliers(point)).toarray()
        )[0]
        ideal = problem.cost(point) + 18 * min(smallest, 0.0)
        bound = dual_bound(problem, point)
        if smallest < -1e-6 and ideal > 0.1 * problem.cost(point):
            assert bound is not None
            assert bound.value <= ideal + 1e-9
            assert bound.value >= ideal - 0.2 * 18 * abs(smallest)
            return
    pytest.fail("no instance with a loose relaxation among the seeds")


def test_screening_trusts_the_factorization_and_bounds_more():
    problem, point = optimum(3, 3, poses=True, noise=0.05)
    assert dual_bound(problem, point, rounding=False).value >= dual_bound(problem, point).value


@settings(max_examples=20)
@given(seed=seeds, d=dimensions)
def test_cost_upper_is_above_the_exact_cost(seed, d):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 4, d, extra=2, noise=1e-6)
    problem = PoseProblem(graph)
    x = Estimate(R, t)
    exact = Fraction(0)
    for e, (i, j) in enumerate(graph.edges):
        for a in range(d):
            r = Fraction(t[j, a]) - Fraction(t[i, a])
            for b in range(d):
                r -= Fraction(R[i, a, b]) * Fraction(graph.translations[e, b])
                E = Fraction(R[j, a, b])
                for c in range(d):
                    E -= Fraction(R[i, a, c]) * Fraction(graph.rotation.rotations[e, c, b])
                exact += Fraction(graph.rotation.kappa[e]) * E * E
            exact += Fraction(graph.tau[e]) * r * r
    upper = cost_upper(problem, x)
    assert Fraction(upper) >= exact
    assert upper <= float(exact) * (1 + 1e-6) + 1e-20 * problem.scale
    assert so.worst_defect(R)[1] < 1e-13
