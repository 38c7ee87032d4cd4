"""Iteratively reweighted EIG-SE(3)."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

from certpgo import io, registry
from certpgo.errors import SpecError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.solution import Status
from certpgo.solve import metrics

KINDS = ["poses", "rotations"]


def solver(**settings):
    return registry.get_solver("irls_eig_se3")(**settings)


def module():
    return sys.modules[type(solver()).__module__]


def graph_of(kind, seed, n, d, **options):
    make = pose_graph if kind == "poses" else rotation_graph
    return make(rng_of(seed), n, d, **options)


def with_outliers(graph, share, rng):
    """The graph with a share of its measurements replaced by random ones."""
    m, d = graph.num_edges, graph.d
    bad = rng.permutation(m)[: round(share * m)]
    R, t = graph.rotations.copy(), graph.translations.copy()
    R[bad] = so.random(rng, len(bad), d)
    if graph.has_positions:
        t[bad] = 3.0 * rng.standard_normal((len(bad), d))
    return replace(graph, rotations=R, translations=t)


def test_cauchy_weights_of_known_residuals():
    # A median deviation of 1: half the weight at 2.385 deviations of a normal law.
    known = module().cauchy_weights(np.array([0.0, 1.0, 2.0, 3.0, 2.385 * 1.4826]))
    assert known[0] == 1.0
    assert known[-1] == pytest.approx(0.5)


def test_residuals_without_spread_weigh_alike():
    np.testing.assert_array_equal(module().cauchy_weights(np.full(4, 0.3)), 1.0)


@pytest.mark.parametrize("d", [2, 3])
def test_residuals_are_those_of_the_blocks(d):
    graph, R, t = graph_of("poses", 5, 8, d)
    problem = Quadratic(graph)
    norms = module().residual_norms(problem, Estimate(R, t))
    for e, (i, j) in enumerate(graph.edges):
        T, measured = np.tile(np.eye(d + 1), (2, 1, 1)), np.eye(d + 1)
        for pose, node in zip(T, (i, j), strict=True):
            pose[:d, :d], pose[:d, d] = R[node], t[node]
        measured[:d, :d], measured[:d, d] = graph.rotations[e], graph.translations[e]
        assert norms[e] == pytest.approx(np.linalg.norm(measured - np.linalg.inv(T[0]) @ T[1]))


@pytest.mark.parametrize("kind", KINDS)
@given(seed=seeds, d=dimensions)
def test_exact_measurements_are_fitted(kind, seed, d):
    problem = Quadratic(graph_of(kind, seed, 9, d, noise=0.0)[0])
    assert solver(max_iterations=3).solve(problem).cost < 1e-12 * problem.scale


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("d", [2, 3])
def test_it_resists_outliers_that_mislead_the_plain_one(kind, d):
    graph, *truth = graph_of(kind, 8, 30, d, noise=0.005, extra=300, weights=False)
    problem = Quadratic(with_outliers(graph, 0.2, rng_of(9)))
    truth = Estimate(*truth)
    robust = solver().solve(problem)
    plain = registry.get_solver("eig_se3")().solve(problem)
    worst = [
        metrics.angular_errors(solution.estimate, truth).worst_deg for solution in (robust, plain)
    ]
    assert worst[0] < 0.7 < 2.5 < worst[1]
    if kind == "poses":
        errors = [
            metrics.position_errors(solution.estimate, truth).worst for solution in (robust, plain)
        ]
        assert errors[0] < 0.05 < 0.5 < errors[1]
    assert robust.status is Status.CONVERGED


def test_its_first_estimate_is_the_plain_one():
    problem = Quadratic(graph_of("poses", 3, 12, 3)[0])
    told = []
    solution = solver().solve(problem, monitor=lambda iteration: told.append(iteration) or True)
    assert (solution.status, solution.iterations) == (Status.INTERRUPTED, 0)
    assert solution.cost == registry.get_solver("eig_se3")().solve(problem).cost == told[0].cost


def test_an_iteration_limit_is_told():
    problem = Quadratic(graph_of("rotations", 3, 12, 3)[0])
    solution = solver(max_iterations=2, tolerance=0.0).solve(problem)
    assert (solution.status, solution.iterations) == (Status.ITERATION_LIMIT, 2)
    assert len(solution.trace) == 3


def test_the_graph_s_own_weights_play_no_part():
    graph = graph_of("rotations", 3, 12, 3)[0]
    estimates = [
        solver().solve(Quadratic(g)).estimate.rotations for g in (graph, graph.with_weights(1.0))
    ]
    np.testing.assert_array_equal(*estimates)


def test_ellis_island(dataset, dataset_path):
    instance = dataset("Ellis_Island")
    nodes, truth = io.read_truth(dataset_path("Ellis_Island_truth"), instance)
    solution = solver().solve(Quadratic(instance.graph))
    errors = metrics.angular_errors(solution.estimate.subset(nodes), truth, norm="l1")
    # Thesis Table 5.4 prints 3.07, 0.81 and 10.50.
    assert errors.median_deg == pytest.approx(0.81, abs=0.015)
    assert errors.mean_deg == pytest.approx(3.33, abs=0.02)
    assert errors.rmse_deg == pytest.approx(11.74, abs=0.05)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tolerance": -1.0}, "tolerance must not be negative"),
        ({"max_iterations": 0}, "max_iterations at least 1"),
        ({"tol": 1.0}, "tol must lie between 0 and 1"),
    ],
)
def test_settings_are_validated_at_construction(settings, message):
    with pytest.raises(SpecError, match=message):
        solver(**settings)
