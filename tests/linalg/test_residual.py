"""The measured residual of a factor: above the true one, and far below the a priori bound."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.certify import dual_bound
from certpgo.linalg import factor
from certpgo.linalg.arrays import CSC
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.linalg.residual import measured_residual
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton


def definite(seed, n=12, spread=3.0):
    """A sparse definite matrix whose rows differ in size by many powers of ten."""
    rng = rng_of(seed)
    B = rng.standard_normal((n, n)) * (rng.random((n, n)) < 0.4)
    D = np.diag(10.0 ** rng.uniform(-spread, spread, n))
    A = D @ (B @ B.T + np.eye(n)) @ D
    A = 0.5 * (A + A.T)
    return CSC(np.where(A == 0.0, 0.0, A))


@settings(max_examples=20)
@given(seeds)
def test_bounds_the_exact_residual(seed):
    A = definite(seed)
    n = A.shape[0]
    w = 10.0 ** rng_of(seed + 1).uniform(-2, 2, n)
    L, order = factor.factorize(A).lower()
    dense, lower = A.toarray()[np.ix_(order, order)], L.toarray()
    exact = np.zeros(n)
    for i in range(n):
        row = Fraction(0)
        for j in range(n):
            product = sum(Fraction(lower[i, k]) * Fraction(lower[j, k]) for k in range(n))
            row += abs(Fraction(dense[i, j]) - product) * Fraction(w[order[j]])
        exact[order[i]] = float(row)
    measured = measured_residual(A, L, order, w)
    assert np.all(measured >= exact)
    assert np.all(measured <= 1.1 * exact + 1e-20 * np.abs(A.toarray()) @ w)


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("name", ["smallGrid3D", "parking-garage", "intel", "kitti_05"])
def test_row_sums_stay_below_the_a_priori_bound(name, engine, dataset):
    """What the standard tier trusts of an engine, checked on real factors."""
    problem = Quadratic(dataset(name).graph, engine)
    M = problem.matrix
    A = add_to_diagonal(M, 1e-6 * M.diagonal().mean())
    w = 10.0 ** rng_of(0).uniform(-1, 1, A.shape[0])
    symbolic = problem.symbolic(A)
    L, order = symbolic.factor(A).lower()
    assert np.all(measured_residual(A, L, order, w) <= 1.01 * symbolic.rounding(A, w).sums)


def test_a_wrong_factor_is_found_out():
    A = definite(0)
    L, order = factor.factorize(A).lower()
    wrong = CSC((L.data * (1.0 + 1e-9), L.indices, L.indptr), shape=L.shape)
    right = measured_residual(A, L, order, np.ones(len(order)))
    assert np.all(measured_residual(A, wrong, order, np.ones(len(order))) > 1e3 * right)
    assert measured_residual(CSC(-A.toarray()), L, order, np.ones(len(order))) is None


@settings(max_examples=10)
@given(seeds, dimensions)
def test_measuring_sharpens_a_valid_bound(seed, d):
    graph, R, _ = pose_graph(rng_of(seed), 30, d, noise=0.02)
    problem = Quadratic(graph)
    point = problem.with_optimal_translations(newton(problem, problem.complete(R)).estimate)
    cost = problem.cost(point)
    plain = dual_bound(problem, point)
    # Worth measuring: what is asked for is within reach of it.
    sharper = dual_bound(problem, point, enough=cost - (cost - plain.value) / 20.0)
    assert plain.value <= sharper.value <= cost
    assert cost - sharper.value <= 0.7 * (cost - plain.value)


@pytest.mark.parametrize("name", ["ais2klinik"])
def test_long_chains_are_certified_by_measuring(dataset, name):
    from certpgo import solve

    answer = solve(dataset(name), cost="chordal")
    assert answer.verdict.value == "CERTIFIED"
    assert answer.cost == pytest.approx(188.5018, rel=1e-6)
