"""Low-rank optimization: Taylor slopes, golden optima at several ranks, the way out of a saddle."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift, lifted
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.rotations import tangent_basis
from certpgo.objective import operators
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.curvature import negative_curvature
from certpgo.optimize.low_rank_descent import _Tangent, descend, leave
from certpgo.optimize.methods.low_rank import LowRank
from certpgo.optimize.riemannian_newton import newton
from certpgo.optimize.solution import Status

SMALL_GRID = 1025.398056  # DESIGN section 5


def some_point(rng, n, rank, d):
    Y = np.linalg.qr(rng.standard_normal((n, rank, d)))[0]
    return Lift(Y, 2.0 * rng.standard_normal((n, rank)))


def polar(Z):
    U, _, Vt = np.linalg.svd(Z, full_matrices=False)
    return U @ Vt


def orthonormality(Y):
    return np.abs(np.swapaxes(Y, 1, 2) @ Y - np.eye(Y.shape[2])).max()


def never_rises(trace):
    return all(b.cost <= a.cost * (1.0 + 1e-13) for a, b in itertools.pairwise(trace))


def wound(n, winding, theta=0.0, d=3):
    instance, estimate = winding_cycle(n, theta, winding, d)
    return Quadratic(instance.graph), estimate


@given(seeds, dimensions, st.integers(0, 3))
def test_bases_of_tangent_spaces_are_orthonormal_and_complete(seed, d, more):
    rank = d + more
    Y = some_point(rng_of(seed), 5, rank, d).rotations
    B = tangent_basis(Y)
    assert B.shape == (5, so.tangent_dim(d) + more * d, rank, d)
    flat = B.reshape(5, B.shape[1], -1)
    np.testing.assert_allclose(
        flat @ np.swapaxes(flat, 1, 2), np.tile(np.eye(B.shape[1]), (5, 1, 1)), rtol=0, atol=1e-14
    )
    skew = np.swapaxes(Y, 1, 2)[:, None] @ B
    np.testing.assert_allclose(skew, -np.swapaxes(skew, 2, 3), rtol=0, atol=1e-14)


def displaced(problem, tangent, basis, x):
    """The point moved by x, turns and translations alike, in a retraction of second order."""
    q = basis.shape[1]
    steps = x.reshape(problem.n, -1)
    Y = polar(tangent.point.rotations + np.einsum("nq,nqrd->nrd", steps[:, -q:], basis))
    t = tangent.point.translations
    return Lift(Y, None if t is None else t + steps[:, :-q])


@settings(max_examples=40)
@given(seeds, dimensions, st.integers(0, 2), st.booleans())
def test_gradient_and_hessian_by_the_slope_of_the_taylor_error(seed, d, more, poses):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, d, extra=4)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    point = some_point(rng, 5, d + more, d)
    tangent = _Tangent(problem, point if poses else point.with_translations(None))
    basis = tangent_basis(point.rotations)
    x = rng.standard_normal(tangent.gradient.shape)
    slope, curvature = float(tangent.gradient @ x), float(x @ (tangent.hessian @ x))
    errors = []
    for h in (2e-3, 1e-3):
        model = tangent.cost + 2.0 * h * slope + h * h * curvature
        errors.append(abs(problem.cost(displaced(problem, tangent, basis, h * x)) - model))
    coarse, fine = errors
    # Third order: halving the step divides the error by eight (or it is rounding).
    assert fine < coarse / 5.0 + 1e-11 * tangent.cost
    H = tangent.hessian.toarray()
    np.testing.assert_allclose(H, H.T, rtol=0, atol=1e-11)


@given(seeds, dimensions, st.booleans())
def test_at_rank_d_the_hessian_is_newtons(seed, d, poses):
    rng = rng_of(seed)
    graph, R, t = pose_graph(rng, 5, d, extra=4)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    multipliers = problem.multipliers(Estimate(R, t))
    hats = so.hat(np.eye(so.tangent_dim(d)))
    blocks = operators.lifted_hessian(problem.graph, R[:, None] @ hats, multipliers)
    ours = problem.pattern.assemble(*blocks).toarray()
    theirs = problem.pattern.assemble(*problem.hessian(Estimate(R, t), multipliers)).toarray()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11)


@given(seeds, dimensions, st.integers(0, 2), st.booleans())
def test_the_metric_is_the_hessian_without_multipliers(seed, d, more, poses):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 5, d, extra=4)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    point = some_point(rng, 5, d + more, d)
    tangent = _Tangent(problem, point if poses else point.with_translations(None))
    basis = tangent_basis(point.rotations)
    zero = np.zeros((5, d, d))
    G = problem.pattern.assemble(*operators.lifted_hessian(problem.graph, basis, zero)).toarray()
    assert np.linalg.eigvalsh(G)[0] > -1e-10
    # A range vector, so that the shift hardly shows.
    b = G @ rng.standard_normal(len(G))
    x = tangent.metric().solve(b)
    np.testing.assert_allclose(G @ x, b, rtol=0, atol=1e-5 * np.abs(b).max())


@pytest.mark.parametrize("more", [0, 1, 2])
def test_the_published_optimum_at_several_ranks(more, dataset):
    problem = Quadratic(dataset("smallGrid3D").graph)
    solution = LowRank(rank=3 + more).solve(problem)
    assert solution.status is Status.CONVERGED
    assert solution.cost == pytest.approx(SMALL_GRID, rel=1e-9)
    assert solution.trace[-1].cost == pytest.approx(SMALL_GRID, rel=1e-9)
    assert never_rises(solution.trace)
    rotations = LowRank(rank=3 + more).solve(problem.rotation)
    best = newton(problem.rotation, Estimate(solution.estimate.rotations))
    assert rotations.cost == pytest.approx(best.cost, rel=1e-9)


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("poses", [True, False])
@pytest.mark.parametrize("d", [2, 3])
def test_the_optimum_of_small_graphs_at_every_rank(d, poses, engine, monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    graph, R, t = pose_graph(np.random.default_rng(d), 15, d, noise=0.1)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    best = newton(problem, Estimate(R, t if poses else None))
    for rank in (d, d + 1, d + 2):
        solution = LowRank(rank=rank).solve(problem)
        assert solution.status is Status.CONVERGED
        assert solution.cost == pytest.approx(best.cost, rel=1e-9)
        assert never_rises(solution.trace)
        assert f"rank {rank}" in solution.note
    assert LowRank().solve(problem).note.startswith(f"rank {d + 1}")


@settings(max_examples=20)
@given(seeds, dimensions, st.booleans())
def test_random_starts_end_at_the_optimum_in_enough_dimensions(seed, d, poses):
    """With little noise the relaxation is tight and has no other minima at rank d + 2."""
    graph, R, t = pose_graph(rng_of(seed), 10, d, noise=0.05)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    best = newton(problem, Estimate(R, t if poses else None))
    solution = LowRank(rank=d + 2, seed=seed).solve(problem)
    assert never_rises(solution.trace)
    assert solution.cost == pytest.approx(best.cost, rel=1e-8)


@settings(max_examples=20)
@given(seeds, dimensions, st.integers(0, 2))
def test_descent_stays_on_the_manifold_and_ends_stationary(seed, d, more):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 8, d, noise=0.5)
    problem = Quadratic(graph)
    found = descend(problem, some_point(rng, 8, d + more, d), d + more, tolerance=1e-9)
    assert found.status in (Status.CONVERGED, Status.STALLED)
    assert orthonormality(found.point.rotations) < 1e-13
    assert found.cost == problem.cost(found.point)
    assert never_rises(found.trace)
    assert _Tangent(problem, found.point).stationarity < 1e-7
    # Its translations are the best for its blocks.
    np.testing.assert_allclose(
        problem.gradient(found.point)[:, :, 0], 0.0, rtol=0, atol=1e-9 * problem.scale
    )


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("winding", [1, 2])
@pytest.mark.parametrize("n", [5, 20, 60])
def test_wound_cycles_are_left_along_the_negative_curvature(n, winding, d):
    problem, estimate = wound(n, winding, d=d)
    before = problem.cost(estimate)
    _, direction = negative_curvature(problem, estimate)
    start = lifted(estimate, d + 1)
    after = leave(problem, start, direction)
    assert problem.cost(after) < 0.99 * before
    assert orthonormality(after.rotations) < 1e-13
    # Without it there is no way: the point is stationary at every rank.
    stuck = descend(problem, estimate, d + 1)
    assert (stuck.status, len(stuck.trace)) == (Status.CONVERGED, 1)
    assert stuck.cost == pytest.approx(before, rel=1e-12)
    found = descend(problem, estimate, d + 1, direction=direction)
    assert never_rises(found.trace)
    assert found.cost < 0.6 * before


def test_leaving_a_minimum_stays_there():
    problem, best = wound(12, 0, theta=0.4)
    start = lifted(best, 4)
    direction = np.random.default_rng(0).standard_normal((12, 3))
    after = leave(problem, start, direction)
    assert problem.cost(after) == pytest.approx(problem.cost(best), rel=1e-12)
    assert problem.cost(after) <= problem.cost(best)


def test_interruption_and_the_iteration_limit():
    graph, _, _ = pose_graph(np.random.default_rng(0), 12, 3)
    problem = Quadratic(graph)
    start = some_point(np.random.default_rng(1), 12, 5, 3)
    whole = descend(problem, start, 5)
    stopped = descend(problem, start, 5, monitor=lambda step: step.number == 3)
    assert (stopped.status, stopped.trace[-1].number) == (Status.INTERRUPTED, 3)
    assert stopped.cost == whole.trace[3].cost < whole.trace[0].cost
    limited = descend(problem, start, 5, max_iterations=2)
    assert (limited.status, limited.trace[-1].number) == (Status.ITERATION_LIMIT, 2)
    assert set(whole.counts) == {"factorizations", "products"}
    solution = LowRank(rank=5, seed=1).solve(problem, monitor=lambda step: step.number == 1)
    assert (solution.status, solution.iterations) == (Status.INTERRUPTED, 1)
    assert solution.cost == problem.cost(solution.estimate)


def test_forcing_terms_are_those_asked_for():
    graph, _, _ = pose_graph(np.random.default_rng(0), 12, 3)
    start = some_point(np.random.default_rng(1), 12, 5, 3)
    loose, tight = (descend(Quadratic(graph), start, 5, loosest=term) for term in (0.1, 1e-6))
    steps = [len(found.trace) - 1 for found in (loose, tight)]
    assert tight.counts["products"] / steps[1] > 1.5 * loose.counts["products"] / steps[0]


def test_a_step_whose_decrease_is_rounding_has_no_gain(monkeypatch):
    """As in Newton's method: actual over predicted decrease says nothing there."""
    monkeypatch.setattr(low_rank, "ROUNDING", 1e-6)
    graph, _, _ = pose_graph(np.random.default_rng(0), 12, 3)
    start = some_point(np.random.default_rng(1), 12, 5, 3)
    found = descend(Quadratic(graph), start, 5)
    gains = [step.gain for step in found.trace[1:]]
    assert gains[-1] is None
    assert None not in gains[:4]
    assert all(step.accepted for step in found.trace if step.gain is None)


@pytest.mark.parametrize("d", [2, 3])
def test_ranks_below_the_dimension_are_refused(d):
    graph, _, _ = pose_graph(np.random.default_rng(0), 5, d)
    for rank in (d - 1, 0, -1):
        with pytest.raises(SpecError, match=f"rank must be at least {d} here, not {rank}"):
            LowRank(rank=rank).solve(Quadratic(graph))


def test_noise_free_graphs_cost_nothing():
    graph, _, _ = pose_graph(np.random.default_rng(5), 10, 3, noise=0.0)
    solution = LowRank(rank=5, seed=2).solve(Quadratic(graph))
    assert solution.cost < 1e-15 * Quadratic(graph).scale
