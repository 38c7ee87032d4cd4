"""Roundings of one point of the relaxation: all of them estimates, the most promising first."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import Estimate
from certpgo.graph.relaxed_point import Lift
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.randomized_rounding import _Candidates, roundings


def some_problem(seed, d, poses, noise=0.5):
    graph, _, _ = pose_graph(rng_of(seed), 9, d, noise=noise)
    return Quadratic(graph if poses else graph.rotations_alone)


def some_lift(rng, n, rank, d):
    return Lift(np.linalg.qr(rng.standard_normal((n, rank, d)))[0])


@settings(max_examples=20)
@given(seeds, dimensions, st.booleans())
def test_costs_are_those_of_one_at_a_time_and_sweeps_lower_them(seed, d, poses):
    problem = some_problem(seed, d, poses)
    many = _Candidates(problem, np.stack([so.random(rng_of(k), 9, d) for k in range(5)]))
    one_by_one = [problem.cost(problem.complete(R)) for R in many.rotations]
    before = many.costs()
    np.testing.assert_allclose(before, one_by_one, rtol=1e-12)
    many.sweep()  # the first one has no momentum yet: none can rise
    assert np.all(many.costs() <= before * (1.0 + 1e-12))


@settings(max_examples=8)
@given(seeds, dimensions, st.integers(0, 3), st.booleans())
def test_roundings_are_rotations_by_ascending_cost_and_can_be_had_again(seed, d, more, poses):
    problem = some_problem(seed, d, poses)
    point = some_lift(rng_of(seed), 9, d + more, d)
    best = problem.complete(so.random(rng_of(seed), 9, d))
    found = list(roundings(problem, point, best, np.random.default_rng(0)))
    assert 1 <= len(found) <= 8
    for estimate in found:
        problem.check(estimate)
        assert so.worst_defect(estimate.rotations)[1] < 1e-12
    costs = [problem.cost(estimate) for estimate in found]
    assert all(a < b for a, b in itertools.pairwise(costs))
    again = roundings(problem, point, best, np.random.default_rng(0))
    assert [problem.cost(estimate) for estimate in again] == costs


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("reflected", [False, True])
def test_a_point_that_is_an_estimate_in_disguise_is_found_again(d, reflected):
    """Either orientation: a turned and maybe reflected optimum rounds to the optimum."""
    problem = some_problem(1, d, poses=False, noise=0.0)
    graph, R, _ = pose_graph(rng_of(1), 9, d, noise=0.0)
    Q = np.linalg.qr(np.random.default_rng(2).standard_normal((d + 1, d)))[0]
    if reflected:
        Q = Q * np.r_[-1.0, np.ones(d - 1)]
    far = Estimate(so.random(np.random.default_rng(3), 9, d))
    found = next(roundings(problem, Lift(Q @ R), far, np.random.default_rng(0)))
    assert problem.cost(found) < 1e-6 * graph.kappa.sum()
