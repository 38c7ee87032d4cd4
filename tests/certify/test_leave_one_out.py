"""Kept measurements that are proven to be worth keeping, against all choices without them."""

import itertools
import math

import numpy as np
import pytest
from strategies import point_graph, pose_graph, rng_of
from test_truncated import doubtful_graph

from certpgo import InputError, certify, solve
from certpgo.certify.leave_one_out import worth_keeping
from certpgo.certify.normalized import NormalizedProblem
from certpgo.certify.resistances import Resistances
from certpgo.errors import GraphError
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.blocks import add_to_diagonal
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.objective.truncated import Truncation
from certpgo.objective.truncated_cost import TruncatedCost
from certpgo.optimize.progress import Stop
from certpgo.solve.inconsistency import proven_worth


def least_without(graph, doubtful, price, e):
    """The lowest cost of all choices without a kept measurement, with all prices."""
    best = math.inf
    for choice in itertools.product((False, True), repeat=int(doubtful.sum())):
        taken = ~doubtful
        taken[doubtful] = choice
        taken[e] = False
        try:
            cost = solve(graph.reweighted(1.0 * taken)).cost
        except GraphError:  # it leaves a node free
            continue
        best = min(best, cost + price * float((~taken).sum()))
    return best


def worth(problem, estimate, price):
    prices = np.full(problem.graph.num_edges, price)
    return proven_worth(problem, estimate, prices, Stop())


@pytest.mark.parametrize("kind", ["poses", "points", "rotations"])
def test_resistances_are_what_solutions_give(kind):
    """The blocks of a selected inverse, and all products of columns that are solved for."""
    rng = rng_of(3)
    graph, truth = point_graph(rng, 9, 4, 3) if kind == "points" else pose_graph(rng, 9, 3)[:2]
    if kind != "points":
        graph = graph.rotations_alone if kind == "rotations" else graph
        truth = solve(graph, cost="chordal").estimate
    problem, prices = Quadratic(graph), np.ones(graph.num_edges)
    at = Truncation.at_point(graph, prices, truth)
    A = add_to_diagonal(problem.matrix, np.full(problem.matrix.shape[0], 0.1))
    found, every = Resistances.of(problem, A, at), np.arange(graph.num_edges)
    solved = found.products(every)[every, :, every]
    np.testing.assert_allclose(found.blocks, solved, rtol=1e-9, atol=1e-9 * np.abs(solved).max())


@pytest.mark.parametrize("seed", range(6))
def test_no_choice_without_a_proven_one_is_cheaper(seed):
    rng, price = rng_of(seed + 40), 12.0
    graph, doubtful = doubtful_graph(rng, 2 + seed % 2, poses=seed % 4 < 2, n=5, doubtful=2)
    problem = TruncatedCost(Quadratic(graph), np.where(doubtful, price, np.inf))
    found = certify(problem, solve(problem.kept).estimate)
    proven = worth(problem, found.refined, price)
    assert not proven[doubtful].any()
    for e in np.flatnonzero(proven):
        without = least_without(graph, doubtful, price, e)
        assert without >= found.refined_cost - found.tolerance


def test_what_costs_nearly_its_price_alone_is_decided_as_least_squares_decide():
    """Three parallel rotations by small angles: without one, the others fit each other."""
    graph = RotationGraph(
        2, [[0, 1]] * 4, so.exp(np.array([[0.0], [0.0], [0.01], [2.0]])), np.full(4, 1e4)
    )
    # F = 2 kappa (sum of squares): without the third, F falls to zero.
    best = so.exp(np.array([[0.01 / 3.0]]))[0]
    estimate = Estimate(np.stack([np.eye(2), best]))
    falls = 2e4 * 0.01**2 * 2.0 / 3.0
    for factor, expected in ((1.05, True), (0.95, False)):
        price = factor * falls
        prices = np.r_[np.full(3, np.inf), price]
        problem = TruncatedCost(Quadratic(graph), prices)
        proven = worth(problem, estimate, price)
        assert proven.tolist() == [True, True, expected, False]


def test_what_nothing_else_checks_is_worth_keeping(tmp_path):
    # A chain, of which the last step is a bridge, and a cycle before it.
    rng = rng_of(7)
    R = so.random(rng, 5, 3)
    edges = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (3, 4), (0, 1)])
    i, j = edges.T
    measured = np.swapaxes(R[i], 1, 2) @ R[j]
    measured[-1] = measured[-1] @ so.exp(np.array([[1.0, 1.0, 1.0]]))[0]
    graph = RotationGraph(5, edges, measured, np.full(7, 100.0))
    problem = TruncatedCost(Quadratic(graph), np.r_[np.full(6, np.inf), 20.0])
    assert worth(problem, Estimate(R), 20.0).tolist() == [True] * 6 + [False]
    # A rejected measurement across the bridge might fit without it.
    edges[-1] = (0, 4)
    other = RotationGraph(5, edges, measured, np.full(7, 100.0))
    problem = TruncatedCost(Quadratic(other), np.r_[np.full(6, np.inf), 20.0])
    assert not worth(problem, Estimate(R), 20.0)[5]


def test_no_measurement_of_an_uncertified_estimate_is_proven():
    rng = rng_of(41)
    graph, doubtful = doubtful_graph(rng, 3, poses=True)
    problem = TruncatedCost(Quadratic(graph), np.where(doubtful, 20.0, np.inf))
    far = Estimate(so.random(rng, 6, 3), rng.normal(size=(6, 3)))
    assert not worth(problem, far, 20.0).any()


def test_a_stop_ends_the_proofs():
    graph, doubtful = doubtful_graph(rng_of(46), 3, poses=True, doubtful=1)
    problem = TruncatedCost(Quadratic(graph), np.where(doubtful, 20.0, np.inf))
    found = certify(problem, solve(problem.kept).estimate)
    stopped = Stop()
    with stopped.within(0.0):
        proven = proven_worth(problem, found.refined, np.full(graph.num_edges, 20.0), stopped)
    assert proven.sum() < worth(problem, found.refined, 20.0).sum()


def test_other_costs_are_refused(tmp_path):
    import certpgo

    graph, doubtful = doubtful_graph(rng_of(46), 3, poses=True, doubtful=1)
    certpgo.write(tmp_path / "graph.g2o", graph)
    instance = certpgo.read(tmp_path / "graph.g2o")
    posed = objective_of(instance, "g2o")
    problem = TruncatedCost(posed, np.where(doubtful, 20.0, np.inf))
    normalized = NormalizedProblem.of(problem, "standard", 1e-5, 1e-5)
    start = solve(PoseGraph(graph.rotations_alone, graph.translations, graph.tau)).estimate
    with pytest.raises(InputError, match="under F alone"):
        worth_keeping(normalized, start, np.full(graph.num_edges, 20.0))
