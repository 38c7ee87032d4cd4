"""Levenberg-Marquardt from random starts: GTSAM on the chordal cost."""

import numpy as np
import pytest

from certpgo import certify, registry
from certpgo.errors import SpecError
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.cycle_closed_form import stationary_point

pytest.importorskip("gtsam")


def method(**settings):
    return registry.get_solver("gtsam_random_starts")(**settings)


@pytest.mark.parametrize("d", [2, 3])
def test_it_minimises_the_weighted_chordal_cost(d):
    rng = np.random.default_rng(d)
    graph = synthetic.random_graph(12, 5.0, 0.3, rng, d=d).graph
    graph = graph.with_weights(rng.uniform(0.5, 4.0, graph.num_edges))
    problem = Quadratic(graph)
    solution = method(starts=5).solve(problem)
    assert problem.stationarity(solution.estimate) < 1e-5
    assert certify(problem, solution.estimate).verdict.value == "CERTIFIED"
    assert solution.counts["starts"] == 5


def test_from_random_starts_a_cycle_is_left_wound_up_now_and_then():
    problem = Quadratic(synthetic.cycle(20, 0.1, np.random.default_rng(0)).graph)
    best = problem.cost(stationary_point(problem.graph))
    costs = [method(seed=seed).solve(problem).cost for seed in range(12)]
    reached = [cost <= best * (1 + 1e-6) for cost in costs]
    assert any(reached)
    assert not all(reached)
    solution = method(starts=12).solve(problem)
    assert solution.cost == pytest.approx(best, rel=1e-9)
    assert 1 <= solution.counts["best ones"] < 12


def test_starts_are_drawn_from_the_seed_and_the_graph():
    problem = Quadratic(synthetic.cycle(20, 0.1, np.random.default_rng(0)).graph)
    first, again = (method().solve(problem).estimate.rotations for _ in range(2))
    np.testing.assert_array_equal(first, again)
    other = method(seed=1).solve(problem).estimate.rotations
    assert not np.array_equal(first, other)


def test_an_initial_estimate_is_the_first_start():
    instance, wound = synthetic.winding_cycle(12, 0.7, -1)
    problem = Quadratic(instance.graph)
    solution = method().solve(problem, initial=wound)
    assert solution.cost == pytest.approx(problem.cost(wound), rel=1e-9)


def test_random_turns_have_uniform_angles():
    registry.get_solver("gtsam_random_starts")
    from certpgo_baselines.gtsam_random_starts import random_turns

    angles = so.angle(random_turns(np.random.default_rng(0), 20_000, 3))
    # Uniform in [0, 2 pi] folds to uniform in [0, pi]; Haar's angles have a mean of 2.2.
    assert angles.mean() == pytest.approx(np.pi / 2, abs=0.03)


@pytest.mark.parametrize("settings", [{"starts": 0}, {"seed": -1}, {"max_iterations": 0}])
def test_impossible_settings_are_refused(settings):
    with pytest.raises(SpecError, match=r"at least 1|seed must not be negative"):
        method(**settings)
