"""Gradient descent on the rotation group: where it ends, and that its steps are safe."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo.graph import Estimate
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.riemannian_gradient import RiemannianGradient
from certpgo.optimize.solution import Status
from certpgo.solve.solving import solve


@pytest.mark.parametrize("rule", ["barzilai_borwein", "constant"])
@pytest.mark.parametrize("d", [2, 3])
def test_both_rules_reach_the_certified_optimum(rule, d):
    instance = synthetic.random_graph(40, 6.0, 0.2, np.random.default_rng(d), d=d)
    problem = Quadratic(instance.graph)
    solution = RiemannianGradient(rule=rule).solve(problem)
    assert solution.status is Status.CONVERGED
    assert problem.stationarity(solution.estimate) <= 1e-9
    assert solution.cost == pytest.approx(solve(instance.graph).cost, rel=1e-10)


def test_it_descends_on_poses_with_translations_at_their_best():
    problem = Quadratic(synthetic.grid3d(3, np.random.default_rng(1)).graph)
    solution = RiemannianGradient().solve(problem)
    assert solution.status is Status.CONVERGED
    assert solution.cost == pytest.approx(solve(problem.graph).cost, rel=1e-10)


@settings(max_examples=40)
@given(seeds, dimensions)
def test_the_constant_step_lowers_the_cost_from_anywhere(seed, d):
    rng = rng_of(seed)
    problem = Quadratic(rotation_graph(rng, 8, d, noise=1.0)[0])
    start = Estimate(so.random(rng, 8, d))
    costs = [it.cost for it in _trace(problem, start)]
    assert np.all(np.diff(costs) <= 1e-12 * costs[0])


@settings(max_examples=20)
@given(seeds, dimensions)
def test_the_constant_step_lowers_the_cost_of_poses_from_anywhere(seed, d):
    rng = rng_of(seed)
    graph, _, t = pose_graph(rng, 6, d, noise=1.0)
    problem = Quadratic(graph)
    costs = [it.cost for it in _trace(problem, Estimate(so.random(rng, 6, d), t))]
    assert np.all(np.diff(costs) <= 1e-12 * costs[0])


def _trace(problem, start):
    solver = RiemannianGradient(rule="constant", max_iterations=30)
    solution = solver.solve(problem, initial=start)
    # The safe step is never shortened: each moves by half its gradient.
    assert solution.status is not Status.STALLED
    return solution.trace


def test_it_is_local():
    instance, wound = synthetic.winding_cycle(12, 0.7, -1)
    problem = Quadratic(instance.graph)
    near = Estimate(wound.rotations @ so.exp(0.01 * np.random.default_rng(0).normal(size=(12, 3))))
    solution = RiemannianGradient().solve(problem, initial=near)
    assert solution.cost == pytest.approx(problem.cost(wound), rel=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_perfect_measurements_are_fitted_to_the_tolerance(seed):
    instance = synthetic.random_graph(30, 4.0, 0.0, np.random.default_rng(0))
    problem = Quadratic(instance.graph)
    start = Estimate(so.random(np.random.default_rng(seed), 30, 3))
    solution = RiemannianGradient().solve(problem, initial=start)
    assert solution.status is Status.CONVERGED
    assert solution.cost < 1e-15 * problem.scale
