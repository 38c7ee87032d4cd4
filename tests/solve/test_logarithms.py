"""The cost of logarithms of similarities: its values, and its bound near an answer's scales."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import (
    Estimate,
    InputError,
    fit_logarithms,
    reweigh,
)
from certpgo.graph import RotationGraph, SimilarityGraph
from certpgo.graph.ranges import Ranges
from certpgo.io.datasets.monocular import random_maps
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.logarithms import LogarithmCost, logarithmic_mean
from certpgo.objective.quadratic import Quadratic

noises = st.sampled_from([0.05, 0.3, 1.0])


def maps(seed, d, noise=0.1, known=True):
    graph, truth = random_maps(rng_of(seed), d, turn=noise, scale=noise, move=noise)
    return (graph if known else graph.with_unknown_scales(np.ones(8, dtype=bool))), truth


def nearby(rng, estimate, free, within):
    """Another map, whose scales are within a factor of those of an estimate."""
    n, d = estimate.num_nodes, estimate.d
    turn = so.exp(rng.choice([0.1, 1.0, 3.0]) * rng.standard_normal((n, so.tangent_dim(d))))
    t = estimate.translations + rng.choice([0.1, 3.0]) * rng.standard_normal((n, d))
    s = np.where(free, np.exp(np.log(within) * rng.uniform(-1.0, 1.0, n)), 1.0)
    return Estimate(estimate.rotations @ turn, t, scales=s * estimate.scales)


def test_two_measurements_of_a_scale_have_their_geometric_mean():
    rotation = RotationGraph(2, [[0, 1], [0, 1]], [np.eye(2)] * 2, kappa=np.array([1.0, 1.0]))
    graph = SimilarityGraph(rotation, np.zeros((2, 2)), np.ones(2), scales=np.array([2.0, 8.0]))
    found = fit_logarithms(graph)
    assert found.estimate.scales.tolist() == pytest.approx([1.0, 4.0], rel=1e-9)
    assert found.cost == pytest.approx(2 * 2 * np.log(2.0) ** 2, rel=1e-12)
    # F over scales of 1: weights 1 / L(1, 2)^2 for errors of 1/2 and 1, d = 2.
    assert found.lower_bound(1.0) < found.cost


def test_the_errors_are_logarithms_of_matrices():
    """One edge, against SciPy's logarithm of a matrix."""
    graph, truth = maps(3, 3, 0.4)
    cost = LogarithmCost(graph).edge_costs(truth)

    def matrix(R, t, s):
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = s * R, t
        return M

    X = [matrix(*x) for x in zip(truth.rotations, truth.translations, truth.scales, strict=True)]
    for k, (i, j) in enumerate(graph.edges.tolist()):
        S = matrix(graph.rotations[k], graph.translations[k], graph.scales[k])
        E = scipy.linalg.logm(np.linalg.inv(S) @ np.linalg.inv(X[i]) @ X[j]).real
        omega, sigma = np.array([E[2, 1], E[0, 2], E[1, 0]]), E[0, 0]
        kappa, tau = graph.kappa[k], graph.tau[k] * graph.scales[k] ** 2
        expected = kappa * (2 * omega @ omega + 3 * sigma**2) + tau * E[:3, 3] @ E[:3, 3]
        assert cost[k] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_the_cost_is_twice_the_error_of_gtsam(d):
    gtsam = pytest.importorskip("gtsam")
    if not hasattr(gtsam, "BetweenFactorSimilarity2"):
        pytest.skip("this GTSAM has no Similarity2")
    graph, truth = maps(1, d, 0.5, known=False)
    theirs, values = certpgo.to_gtsam(Quadratic(graph), truth)
    assert LogarithmCost(graph).cost(truth) == pytest.approx(2 * theirs.error(values), rel=1e-12)


@given(seeds, dimensions)
@settings(max_examples=10)
def test_units_of_nodes_do_not_matter(seed, d):
    graph, truth = maps(seed, d, 0.3, known=False)
    s = np.exp(rng_of(seed).standard_normal(8))
    moved = replace(truth, scales=truth.scales / s)
    expected = LogarithmCost(graph).edge_costs(truth)
    found = LogarithmCost(graph.in_units_of(s)).edge_costs(moved)
    assert found == pytest.approx(expected, rel=1e-9)


@given(seeds, dimensions, noises, st.sampled_from([1.0, 1.05, 1.5, 3.0]), st.booleans())
@settings(max_examples=40)
def test_the_quadratic_cost_is_below_edge_by_edge(seed, d, noise, within, known):
    graph, truth = maps(seed, d, noise, known)
    problem, rng = LogarithmCost(graph), rng_of(seed)
    there = nearby(rng, truth, graph.free, within)
    ratio = there.scales / truth.scales
    unit = np.sqrt(np.mean(ratio**2))  # that of the minorant
    beta = max((ratio / unit).max(), (unit / ratio).max())
    moved = replace(there, scales=ratio)
    below = problem.minorant(truth).edge_costs(moved)
    assert (below <= beta**2 * problem.edge_costs(there) * (1.0 + 1e-9) + 1e-20).all()


@pytest.mark.parametrize(("seed", "d"), [(0, 2), (1, 3)])
def test_no_map_with_such_scales_costs_less_than_the_bound(seed, d):
    graph, _ = maps(seed, d, 0.2)
    found, problem = fit_logarithms(graph), LogarithmCost(graph)
    assert found.solution.status == "converged"
    assert found.nearby.verdict == "CERTIFIED"
    assert 0.8 * found.cost < found.lower_bound(1.0) < found.cost
    for k in range(20):
        there = nearby(rng_of(k), found.estimate, graph.free, 1.2)
        ratio = there.scales / found.estimate.scales
        unit = np.sqrt(np.mean(ratio**2))
        beta = max((ratio / unit).max(), (unit / ratio).max())
        assert problem.cost(there) > found.lower_bound(beta)


def test_descent_from_elsewhere_ends_at_the_same_map():
    graph, truth = maps(2, 3, 0.05)
    ends = [fit_logarithms(graph), fit_logarithms(graph, initial=truth)]
    assert ends[0].cost == pytest.approx(ends[1].cost, rel=1e-9)
    assert ends[0].estimate.scales == pytest.approx(ends[1].estimate.scales, rel=1e-6)


def test_an_instance_keeps_its_ids():
    graph, _ = maps(2, 3, 0.05)
    instance = certpgo.Instance("map", graph, 10 * np.arange(8))
    assert fit_logarithms(instance).estimate.keys.ids.tolist() == list(range(0, 80, 10))


def test_distances_are_refused_not_dropped():
    graph, _ = maps(0, 3)
    ranges = Ranges(8, [[0, 1]], np.ones(1), np.ones(1))
    mixed = graph.with_ranges(ranges)
    for posed in (mixed, objective_of(mixed)):
        for fit in (fit_logarithms, reweigh):
            with pytest.raises(InputError, match="distances with nodes of unknown scale are for"):
                fit(posed)


def test_other_graphs_and_factors_are_refused():
    graph, _ = maps(0, 3)
    with pytest.raises(InputError, match="unknown scale"):
        fit_logarithms(graph.rotations_alone)
    with pytest.raises(InputError, match="without points"):
        fit_logarithms(random_maps(np.random.default_rng(0), points=1)[0])
    with pytest.raises(InputError, match="at least 1"):
        fit_logarithms(graph).lower_bound(0.9)


def test_logarithmic_means():
    assert logarithmic_mean(np.array([0.0, 1.0, -1.0])) == pytest.approx(
        [1.0, np.e - 1.0, 1.0 - np.exp(-1.0)]
    )
