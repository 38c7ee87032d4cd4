"""The parts of the factorization bound, each against dense or rational arithmetic."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.certify import dual
from certpgo.certify.assembly_errors import assembly_errors
from certpgo.certify.multipliers import Shifted, _exponent
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import factor, rounding_bound, superlu
from certpgo.linalg.arrays import CSC
from certpgo.linalg.rotations import rotation_defect
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.riemannian_newton import newton

U = 2.0**-53


def optimum(seed, d, poses, n=6):
    graph, R, t = pose_graph(rng_of(seed), n, d)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    point = newton(problem, Estimate(R, t if poses else None)).estimate
    return problem, problem.complete(point.rotations)


def attempts(problem, point):
    return dual.Attempts(problem, point, True, -np.inf, True)


# --- What rounding demands


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_rounding_is_the_a_priori_bound_of_the_factor(seed, poses, engine, monkeypatch):
    """(k + 8) u |L| |L|^T by rows, the geometric mean of k's in place of k where that is less."""
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    problem, point = optimum(seed, 2 + seed % 2, poses)
    tries = attempts(problem, point)
    multipliers = tries.shifted.less(1e-9, tries.guess)
    delta = tries.rounding_of(multipliers, tries.guess, measure=False)
    F = tries.symbolic.factor(tries.matrix(multipliers, tries.guess))
    L, order = F.nonzeros if engine == "superlu" else F.lower()
    w, N = tries.weights, len(order)
    sizes, counts = np.abs(L.toarray()), np.bincount(L.indices, minlength=N) + 8.0
    if engine == "multifrontal":  # without the zeros that it stores
        counts = tries.symbolic.lengths[order] + 8.0
    products = sizes @ sizes.T
    own = counts[:, None] * products
    mean = np.sqrt(np.outer(counts, counts)) * products
    expected = np.zeros(N)
    expected[order] = U * np.minimum(own @ w[order], mean @ w[order])
    if engine == "superlu":
        expected[order] += F.excess(w[order])
    expected += assembly_errors(problem, multipliers, w, tries.is_rotation)
    expected /= w
    if poses:
        expected[tries.pin] = 0.0
    assert np.all(delta >= expected)
    assert np.all(delta <= 1.002 * expected)
    assert (delta[tries.pin] == 0.0) if poses else (tries.pin is None)


@given(seeds, dimensions, st.booleans(), st.integers(-8, 8))
@settings(max_examples=40)
def test_radii_bound_the_rounding_of_every_sum(seed, d, poses, exponent):
    """Every entry by (k + 4) u of the sizes that it adds up, and what its rotations are off by."""
    graph, R, _ = pose_graph(rng_of(seed), 5, d, noise=1.0)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    multipliers = problem.multipliers(problem.complete(R))
    radii, sizes, wobbly, w, _ = radii_and_sizes(problem, multipliers, poses, 2.0**exponent)
    degrees = np.bincount(graph.edges.ravel(), minlength=5)
    b = d + poses
    sums = np.repeat(degrees + 4.0, b) * U
    exact = sums * (sizes @ w) + rotation_defect(graph.rotations) * (wobbly @ w)
    assert np.all(radii >= exact * (1 - 1e-12))


def radii_and_sizes(problem, multipliers, poses, weight):
    """The radii, and dense sums of sizes: of all terms, of those with measured rotations."""
    n, d = problem.n, problem.d
    b = d + poses
    turns = np.arange(n * b) % b >= poses
    w = np.where(turns, 1.0, weight)
    radii = assembly_errors(problem, multipliers, w, turns)
    graph = problem.rotation.graph
    sizes, wobbly = np.zeros((2, n * b, n * b))
    for e, (i, j) in enumerate(graph.edges):
        p, q = (slice(k * b + poses, k * b + b) for k in (i, j))
        for A in (sizes, wobbly):
            A[p, p] += graph.kappa[e] * np.eye(d)
            A[q, q] += graph.kappa[e] * np.eye(d)
            A[p, q] += graph.kappa[e] * np.abs(graph.rotations[e])
            A[q, p] += graph.kappa[e] * np.abs(graph.rotations[e]).T
        if poses:
            tau, t = problem.graph.tau[e], np.abs(problem.graph.translations[e])
            for r, c in ((i, i), (j, j), (i, j), (j, i)):
                sizes[r * b, c * b] += tau
            for r in (i, j):
                sizes[r * b, p] += tau * t
                sizes[p, r * b] += tau * t
            sizes[p, p] += tau * np.outer(t, t)
    for k in range(n):
        sizes[k * b + poses : k * b + b, k * b + poses : k * b + b] += np.abs(multipliers[k])
    return radii, sizes, wobbly, w, turns


def test_radii_are_no_larger_than_they_must_be():
    """Eighth turns, and arms along an axis: there the norms that stand for sizes are the sizes."""
    turn = np.sqrt(0.5) * np.array([[1.0, -1.0], [1.0, 1.0]])
    edges = np.array([[0, 1], [2, 1], [0, 2], [0, 2]])
    rotation = RotationGraph(3, edges, np.tile(turn, (4, 1, 1)), np.array([1.0, 2.0, 3.0, 4.0]))
    steps = np.array([[2.0, 0.0], [3.0, 0.0], [0.0, 0.0], [0.0, 0.0]])
    problem = Quadratic(PoseGraph(rotation, steps, np.array([0.5, 0.25, 4.0, 1.0])))
    multipliers = np.array([[[3.0, -1.0], [-1.0, 3.0]], [[1.0, 0.5], [0.5, 1.0]], np.eye(2)])
    radii, sizes, wobbly, w, turns = radii_and_sizes(problem, multipliers, True, 8.0)
    sums = np.repeat(np.bincount(edges.ravel()) + 4.0, 3) * U
    exact = sums * (sizes @ w) + rotation_defect(rotation.rotations) * (wobbly @ w)
    first = np.arange(9) % 3 == 1
    np.testing.assert_allclose(radii[first], exact[first], rtol=1e-12, atol=0)
    # A pose's own arms are counted twice in the row of its translation.
    moves = ~turns
    assert np.all(radii[moves] >= exact[moves])
    np.testing.assert_allclose(radii[3], exact[3], rtol=1e-12, atol=0)
    assert np.all(radii[moves] <= 1.3 * exact[moves])


@pytest.mark.parametrize("engine", factor.engines())
def test_only_factors_whose_rows_have_the_right_norms_are_cholesky_factors(engine):
    B = rng_of(0).standard_normal((8, 8))
    A = CSC(B @ B.T + np.eye(8))
    L, order = factor.factorize(A, engine=engine).lower()
    squares = np.empty(8)
    squares[order] = (L.toarray() ** 2).sum(axis=1)
    assert rounding_bound.is_cholesky(squares, A)
    for k in range(8):
        for factor_, passes in ((1.0 + 1e-8, True), (1.0 + 1e-4, False), (1.0 - 1e-4, False)):
            other = squares.copy()
            other[k] *= factor_
            assert rounding_bound.is_cholesky(other, A) == passes


@pytest.mark.parametrize("engine", factor.engines())
def test_a_factor_that_is_no_cholesky_factor_bounds_nothing(engine, monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    problem, point = optimum(0, 2, False)
    tries = attempts(problem, point)
    multipliers, none = tries.shifted.less(1e-9, tries.guess), np.zeros(len(tries.weights))
    for measure in (False, True):
        assert tries.rounding_of(multipliers, none, measure) is not None
    for engine_of in (factor, superlu):
        monkeypatch.setattr(engine_of, "is_cholesky", lambda squares, A: False)
    assert tries.rounding_of(multipliers, none, measure=False) is None
    if engine == "multifrontal":
        assert tries.rounding_of(multipliers, none, measure=True) is None
    tries.rounding = False  # where rounding is not bounded, it is trusted
    assert tries.rounding_of(multipliers, none, measure=False) is none


@pytest.mark.parametrize("poses", [True, False])
def test_what_is_factorized_is_the_certificate_matrix_less_the_demand(poses):
    problem, point = optimum(1, 3, poses)
    tries = attempts(problem, point)
    N, multipliers = len(tries.weights), tries.shifted.multipliers
    S = problem.certificate_matrix(multipliers).toarray()
    if poses:
        assert tries.guess[tries.pin] == 0.0
        free = ~tries.is_rotation
        free[tries.pin] = False
        assert np.all(tries.guess[free] > 0.0)
        S[tries.pin] = S[:, tries.pin] = 0.0
    assert np.all(tries.guess[tries.is_rotation] == 0.0)
    demand = np.where(np.arange(N) % 4 == 0, 0.25, 0.0)
    for asked in (np.zeros(N), demand):
        A = tries.matrix(multipliers, asked).toarray()
        if poses:
            assert A[tries.pin, tries.pin] > 0.0
            A[tries.pin, tries.pin] = -asked[tries.pin]
        np.testing.assert_array_equal(A, S - np.diag(asked))


@pytest.mark.parametrize("enough", [0.5, 0.99])
def test_measuring_is_worth_it_where_rounding_is_what_is_missing(enough, monkeypatch):
    problem, point = optimum(2, 3, True)
    tries = attempts(problem, point)
    tries.cost, tries.enough = 1.0, enough
    monkeypatch.setattr(dual, "MEASURING_GAIN", 10.0)
    allowed, small = 1.0 - enough, dual.LARGEST_ROUNDING * tries.unit

    def worth(missing, shift):
        return tries.is_worth_measuring(1.0 - missing, shift)

    assert worth(9.9 * allowed, 0.9 * small)
    assert not worth(10.1 * allowed, 0.9 * small)
    assert not worth(9.9 * allowed, 1.1 * small)
    monkeypatch.setattr(tries, "symbolic", SimpleNamespace(measurable=False))
    assert not worth(9.9 * allowed, 0.9 * small)
    monkeypatch.undo()
    tries.rounding = False
    assert not worth(9.9 * allowed, 0.9 * small)


# --- The family of multipliers


@settings(max_examples=20)
@given(seeds, dimensions, st.booleans())
def test_the_gauge_pays_for_the_demand_of_the_translations(seed, d, poses):
    """In the null vectors, what Lam' is less by makes up for the demand on the diagonal."""
    problem, point = optimum(seed, d, poses)
    shifted = Shifted.of(problem, point)
    N = problem.matrix.shape[0]
    b = N // problem.n
    demand = np.where(np.arange(N) % b < poses, rng_of(seed).uniform(0, 1, N), 0.0)
    less = shifted.less(0.25, demand)
    np.testing.assert_array_equal(less, np.swapaxes(less, 1, 2))  # to the last bit
    taken = problem.multipliers(point) - less
    for u in np.eye(d):
        turned = point.rotations.transpose(0, 2, 1) @ u
        gained = np.einsum("na,nab,nb->", turned, taken, turned)
        asked = 0.25 * problem.n
        if poses:
            arms = point.translations - point.translations[shifted.pin]
            asked += float(demand[::b] @ (arms @ u) ** 2)
        assert gained == pytest.approx(asked, rel=1e-10)
    assert shifted.unit == pytest.approx(
        U * problem.matrix.diagonal()[np.arange(N) % b >= poses].mean(), rel=1e-12
    )


def shifted_exponents():
    arms = 3.0 * np.ones((40, 2))  # a root mean square of 4.24
    return [_exponent(size * arms) for size in (1.0, 0.03, 0.0)]


def test_the_pin_is_the_most_central_pose_and_translations_count_by_a_typical_arm():
    t = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [4.0, 6.0], [0.0, 10.0]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]])
    rotation = RotationGraph(5, edges, np.tile(np.eye(2), (5, 1, 1)), np.ones(5))
    steps = t[edges[:, 1]] - t[edges[:, 0]]
    problem = Quadratic(PoseGraph(rotation, steps, np.ones(5)))
    shifted = Shifted.of(problem, Estimate(np.tile(np.eye(2), (5, 1, 1)), t))
    assert shifted.pin == 3
    np.testing.assert_array_equal(shifted.arms, t - t[3])
    rms = np.sqrt(np.mean(np.sum((t - t[3]) ** 2, axis=1)))
    weight = shifted.weights[0]
    assert np.frexp(weight)[0] == 0.5
    assert 2**-0.5 <= weight / rms <= 2**0.5
    np.testing.assert_array_equal(shifted.weights, np.tile([weight, 1.0, 1.0], 5))
    assert shifted_exponents() == [2, -3, 0]
    together = Shifted.of(problem, Estimate(np.tile(np.eye(2), (5, 1, 1)), np.zeros((5, 2))))
    np.testing.assert_array_equal(together.weights, np.ones(15))


# --- The bound


@given(seeds, dimensions, st.booleans())
@settings(max_examples=20)
def test_a_bound_is_its_trace_rounded_down(seed, d, poses):
    problem, point = optimum(seed, d, poses)
    tries = attempts(problem, point)
    multipliers = tries.shifted.multipliers
    rng, N = rng_of(seed), len(tries.weights)
    reduction = np.where(tries.is_rotation, rng.uniform(0, 1e-3, N), 0.0)
    bound = tries.bound(multipliers, reduction)
    rows = np.arange(d)
    wanted = [Fraction(x) for x in multipliers[:, rows, rows].ravel()]
    taken = [Fraction(x) for x in reduction[tries.is_rotation]]
    proven = [Fraction(x) for x in bound.multipliers[:, rows, rows].ravel()]
    for x, y, z in zip(proven, wanted, taken, strict=True):
        assert y - z - (abs(y) + abs(z)) * Fraction(4 * U) <= x < y - z
    exact = sum(proven)
    assert exact - Fraction(4 * U) * abs(exact) <= Fraction(bound.value) < exact
    most = max(y - x for x, y in zip(proven, wanted, strict=True))
    assert bound.shift == pytest.approx(float(most), rel=1e-6)
    off = ~np.eye(d, dtype=bool)
    np.testing.assert_array_equal(bound.multipliers[:, off], multipliers[:, off])
