"""The closed form of a single cycle, and its siblings that wind around it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

from certpgo import certify
from certpgo.certify import Verdict
from certpgo.certify.bounds import cycle_bound, cycle_sum_holds
from certpgo.errors import GraphError
from certpgo.graph import RotationGraph
from certpgo.graph.cycles import walk
from certpgo.io.datasets import synthetic
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.cycle_closed_form import CycleClosedForm, shares, stationary_point
from certpgo.solve.solving import solve

ROUNDING = 1e-12


def any_cycle(rng, n, d, spread):
    """A cycle with shuffled nodes, edges in any order and direction, weights of any size."""
    around = rng.permutation(n)
    edges = np.stack([around, np.roll(around, -1)], axis=1)[rng.permutation(n)]
    flip = rng.random(n) < 0.5
    edges[flip] = edges[flip][:, ::-1]
    return RotationGraph(n, edges, so.random(rng, n, d), np.exp(spread * rng.standard_normal(n)))


@given(seeds, st.integers(3, 60), dimensions, st.sampled_from([0.0, 0.5, 3.0]))
def test_the_closed_form_is_stationary_and_within_the_bounds_for_cycles(seed, n, d, spread):
    graph = any_cycle(rng_of(seed), n, d, spread)
    problem = Quadratic(graph)
    solution = CycleClosedForm().solve(problem)
    assert problem.stationarity(solution.estimate) < 1e-13 * n
    angles = problem.residual_angles(solution.estimate)
    assert angles.sum() <= np.pi * (1 + ROUNDING)
    # At a closing error of pi the sum is over or under by rounding.
    if angles.sum() < np.pi * (1 - ROUNDING):
        assert cycle_sum_holds(problem, solution.estimate) is True
    if spread == 0.0:
        assert angles.max() <= cycle_bound(graph) * (1 + ROUNDING)
    pulls = graph.kappa * np.sin(angles)
    np.testing.assert_allclose(pulls, pulls[0], rtol=1e-9, atol=1e-12 * graph.kappa.max())


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("spread", [0.0, 1.5])
@pytest.mark.parametrize("n", [3, 4, 11, 60])
def test_the_closed_form_is_the_certified_optimum(n, spread, d):
    rng = np.random.default_rng(n)
    for _ in range(6):
        graph = any_cycle(rng, n, d, spread)
        problem = Quadratic(graph)
        solution = CycleClosedForm().solve(problem)
        assert certify(problem, solution.estimate).verdict is Verdict.CERTIFIED
        certified = solve(graph)
        assert certified.verdict is Verdict.CERTIFIED
        assert solution.cost == pytest.approx(certified.cost, rel=1e-9, abs=1e-14)


@given(
    n=st.integers(3, 40),
    theta=st.floats(-3.0, 3.0),
    winding=st.integers(-2, 2),
    d=st.sampled_from([2, 3]),
)
def test_windings_of_equal_weights_have_their_closed_form(n, theta, winding, d):
    instance, _ = synthetic.winding_cycle(n, theta, 0, d)
    problem = Quadratic(instance.graph)
    # In space the axis is that of the closing error, whose angle is not negative.
    towards = -winding if d == 3 and theta < 0.0 else winding
    total = theta + 2 * np.pi * winding
    if abs(total) > n * np.pi:
        with pytest.raises(GraphError, match="no stationary point of winding"):
            stationary_point(instance.graph, towards)
        return
    point = stationary_point(instance.graph, towards)
    expected = 8 * n * np.sin(total / (2 * n)) ** 2
    assert problem.cost(point) == pytest.approx(expected, rel=1e-9, abs=ROUNDING)
    assert problem.stationarity(point) < ROUNDING


@pytest.mark.parametrize("winding", [1, -1, 2])
def test_windings_of_any_weights_are_stationary_and_worse(winding):
    graph = any_cycle(np.random.default_rng(5), 24, 3, 0.2)
    problem = Quadratic(graph)
    point = stationary_point(graph, winding)
    assert problem.stationarity(point) < ROUNDING
    assert problem.cost(point) > problem.cost(stationary_point(graph))
    verdict = certify(problem, point).verdict
    assert verdict is not Verdict.CERTIFIED


def test_a_weak_edge_may_turn_by_more_than_a_right_angle():
    kappa = np.array([100.0, 1.0, 100.0, 100.0])
    angles = shares(kappa, 3.0)
    assert angles[1] > np.pi / 2
    assert angles.sum() == pytest.approx(3.0, rel=ROUNDING)
    # No other split costs less.
    rng = np.random.default_rng(0)
    others = rng.dirichlet(np.ones(4), 20_000) * 3.0
    cost = (kappa * (1 - np.cos(others))).sum(axis=1)
    assert (kappa * (1 - np.cos(angles))).sum() <= cost.min()


@pytest.mark.parametrize("missed", [0.0, 1e-15, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("kappa", [(1, 2, 2), (1, 3, 3, 3), (2, 3, 6), (3, 5, 7.5), (1, 1, 5)])
def test_closing_errors_near_half_a_turn(kappa, missed):
    """The weakest edge's sine equals the sum of the others': the slope vanishes at pi."""
    kappa = np.array(kappa, dtype=float)
    total = np.pi - missed
    angles = shares(kappa, total)
    assert angles.sum() == pytest.approx(total, rel=4e-16 * len(kappa))
    pulls = kappa * np.sin(angles)
    np.testing.assert_allclose(pulls, pulls[0], rtol=1e-9, atol=1e-15 * kappa.max())
    turns = so.exp(np.r_[np.zeros((len(kappa) - 1, 3)), [[0.0, 0.0, total]]])
    around = np.arange(len(kappa))
    graph = RotationGraph(len(kappa), np.c_[around, np.roll(around, -1)], turns, kappa)
    solution = CycleClosedForm().solve(Quadratic(graph))
    assert solution.cost == pytest.approx((4.0 * kappa * (1 - np.cos(angles))).sum(), rel=1e-12)
    assert solution.cost == pytest.approx(solve(graph).cost, rel=1e-12)


@given(seeds, st.integers(3, 40), dimensions, st.sampled_from([0.0, 1e-9, 1.0]))
def test_the_bound_is_below_the_optimum_by_rounding(seed, n, d, size):
    rng = rng_of(seed)
    angles = size * rng.standard_normal(n)
    graph = RotationGraph(
        n,
        np.c_[np.arange(n), np.roll(np.arange(n), -1)],
        so.exp(angles[:, None] * np.eye(so.tangent_dim(d))[-1]),
        np.ones(n),
    )
    solution = CycleClosedForm().solve(Quadratic(graph))
    theta = abs(np.remainder(np.sum(angles) + np.pi, 2.0 * np.pi) - np.pi)
    exact = 8.0 * n * np.sin(theta / (2.0 * n)) ** 2
    assert 0.0 <= solution.lower_bound <= exact * (1 + 1e-15)
    assert solution.lower_bound >= exact * (1 - 1e-9) - 1e-20 * n


def test_perfect_measurements_cost_nothing():
    instance = synthetic.cycle(30, 0.0, np.random.default_rng(0))
    assert CycleClosedForm().solve(Quadratic(instance.graph)).cost < 1e-25


def test_the_walk_passes_every_edge_once():
    graph = any_cycle(np.random.default_rng(1), 9, 3, 0.0)
    around = walk(graph)
    here, there = around.nodes, np.roll(around.nodes, -1)
    expected = np.where(around.forward[:, None], np.c_[here, there], np.c_[there, here])
    np.testing.assert_array_equal(graph.edges[around.edges], expected)
    assert around.nodes[0] == 0


@pytest.mark.parametrize(
    "graph",
    [
        synthetic.complete(4, 0.1, np.random.default_rng(0)).graph,
        RotationGraph(2, [[0, 1], [1, 0]], np.tile(np.eye(3), (2, 1, 1)), np.ones(2)),
        RotationGraph(
            4, [[0, 1], [1, 2], [2, 0], [2, 3]], np.tile(np.eye(3), (4, 1, 1)), np.ones(4)
        ),
    ],
)
def test_other_graphs_are_refused_in_one_line(graph):
    with pytest.raises(GraphError, match="is not a single cycle") as refusal:
        CycleClosedForm().solve(Quadratic(graph))
    assert "\n" not in str(refusal.value)
