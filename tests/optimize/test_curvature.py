"""Negative curvature: closed forms on wound-up cycles, dense eigenvalues, none at an optimum."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import Estimate, PoseGraph
from certpgo.graph.relaxed_point import lifted
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import factor
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize import low_rank_descent as low_rank
from certpgo.optimize.curvature import negative_curvature, smallest_eigenvalues
from certpgo.optimize.riemannian_newton import NewtonSettings, newton


def eliminated(problem, point):
    """The certificate matrix, its translations eliminated, dense."""
    S = problem.certificate_matrix(problem.multipliers(point)).toarray()
    if not problem.has_positions:
        return S
    turns = np.arange(len(S)) % (problem.d + 1) > 0
    inner = np.linalg.pinv(S[np.ix_(~turns, ~turns)])
    return S[np.ix_(turns, turns)] - S[np.ix_(turns, ~turns)] @ inner @ S[np.ix_(~turns, turns)]


@pytest.mark.parametrize("engine", factor.engines())
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [5, 6, 20, 60])
@pytest.mark.parametrize("winding", [1, 2])
def test_wound_cycles_have_the_eigenvalue_of_the_closed_form(winding, n, d, engine, monkeypatch):
    monkeypatch.setenv("CERTPGO_ENGINE", engine)
    instance, wound = winding_cycle(n, 0.0, winding, d)
    expected = 2.0 * math.cos(2.0 * math.pi * winding / n) - 2.0
    for problem, point in (
        (Quadratic(instance.graph), wound),
        (Quadratic(instance.graph), lifted(wound, d + 2)),
        # Poses that all stand at the origin: their translations pull at nothing.
        (
            Quadratic(PoseGraph(instance.graph, np.zeros((n, d)), np.ones(n))),
            Estimate(wound.rotations, np.zeros((n, d))),
        ),
    ):
        value, direction = negative_curvature(problem, point)
        assert direction.shape == (n, d)
        # A Rayleigh quotient: an upper bound, and a good one.
        assert expected - 1e-12 <= value <= 0.9 * expected
        v = direction.ravel()
        quotient = v @ eliminated(problem, point) @ v / (v @ v)
        assert value == pytest.approx(quotient, rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [200, 2000])
def test_long_cycles_too(n, d):
    """Their matrix spans seven decades: a vector that is off by a little has any quotient."""
    instance, wound = winding_cycle(n, 0.0, 1, d)
    value, _ = negative_curvature(Quadratic(instance.graph), wound)
    assert value < 0.9 * (2.0 * math.cos(2.0 * math.pi / n) - 2.0)


@pytest.mark.parametrize("scale", [1e-8, 1e8])
def test_weights_of_any_scale(scale):
    instance, wound = winding_cycle(20, 0.3, 1)
    reference, _ = negative_curvature(Quadratic(instance.graph), wound)
    value, _ = negative_curvature(Quadratic(instance.graph.with_weights(scale)), wound)
    assert value == pytest.approx(scale * reference, rel=1e-6)


@settings(max_examples=40)
@given(seeds, dimensions, st.booleans())
def test_none_at_a_tight_optimum(seed, d, poses):
    graph, R, t = pose_graph(rng_of(seed), 8, d, noise=0.05)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    found = newton(problem, Estimate(R, t if poses else None)).estimate
    value, _ = negative_curvature(problem, problem.complete(found.rotations))
    assert value > -1e-8 * problem.curvature.mean()


@settings(max_examples=60)
@given(seeds, dimensions, st.booleans())
def test_it_is_found_where_there_is_some(seed, d, poses):
    """Loose relaxations: the value lies above the dense eigenvalue, and is as negative, nearly."""
    graph, R, t = pose_graph(rng_of(seed), 7, d, noise=1.5)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    found = newton(
        problem, Estimate(R, t if poses else None), NewtonSettings(max_iterations=200)
    ).estimate
    point = problem.complete(found.rotations)
    smallest = np.linalg.eigvalsh(eliminated(problem, point))[0]
    value, direction = negative_curvature(problem, point)
    mean = problem.curvature.mean()
    assert value >= smallest - 1e-9 * mean
    if smallest < -1e-3 * mean:
        assert value < 0.5 * smallest
        start = lifted(point, d + 1)
        assert problem.cost(low_rank.leave(problem, start, direction)) < problem.cost(point)


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("poses", [True, False])
def test_the_smallest_eigenvalues_are_as_many_as_asked_for(d, poses):
    """In ascending order, to three digits; of a matrix of that size no more than it has."""
    graph, R, _ = pose_graph(rng_of(d), 7, d, noise=1.0)
    problem = Quadratic(graph if poses else graph.rotations_alone)
    point = problem.complete(R)
    multipliers = problem.multipliers(point)
    dense = np.linalg.eigvalsh(eliminated(problem, point))
    for k in (1, d + 1, 7 * d, 7 * d + 5):
        found = smallest_eigenvalues(problem, multipliers, k)
        expected = dense[:k]
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3 * np.abs(dense).max())
