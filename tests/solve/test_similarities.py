"""Poses of unknown scale: the cost, its bound and its laws, against brute force."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

import certpgo
from certpgo import Estimate, Quadratic
from certpgo.errors import GraphError, InputError
from certpgo.graph import RotationGraph, SimilarityGraph
from certpgo.io.datasets.monocular import random_maps
from certpgo.linalg import rotations as so
from certpgo.optimize.levenberg_marquardt import descend
from certpgo.optimize.similarity_starts import STARTS
from certpgo.solve.bounds_table import ladder
from certpgo.solve.reweighing import reweigh

noises = st.sampled_from([0.05, 0.2, 0.4])


def cost_by_loops(graph, estimate):
    """F, edge by edge."""
    total, rotation = 0.0, graph.rotations_alone
    A = estimate.scales[:, None, None] * estimate.rotations
    for k, (i, j) in enumerate(graph.edges.tolist()):
        E = A[j] - graph.scales[k] * A[i] @ rotation.rotations[k]
        r = estimate.translations[j] - estimate.translations[i] - A[i] @ graph.translations[k]
        total += rotation.kappa[k] * (E * E).sum() + graph.tau[k] * (r * r).sum()
    return total


def two_maps(gap):
    """Two poses and two measurements of their ratio of scales that disagree: 2 and 2 + gap."""
    rotation = RotationGraph(2, [[0, 1], [0, 1]], [np.eye(2)] * 2, kappa=np.ones(2))
    scales = np.array([2.0, 2.0 + gap])
    free = np.array([False, True])
    return SimilarityGraph(rotation, np.zeros((2, 2)), np.ones(2), scales=scales, free=free)


def test_two_measurements_of_a_scale_are_averaged():
    """sum |A - s_k I|^2 over two s_k has its minimum at their mean: 2 (gap / 2)^2 d."""
    answer = certpgo.solve(two_maps(0.5))
    assert answer.verdict == "CERTIFIED"
    assert answer.estimate.scales.tolist() == pytest.approx([1.0, 2.25], rel=1e-9)
    assert answer.cost == pytest.approx(2.0 * 0.25**2 * 2, rel=1e-9)


def test_opposite_measurements_shrink_what_they_are_of():
    """Quarter turns to the left and right: the best A is cos(90 deg) I = 0, so scales shrink."""
    theta = 1.2
    turns = so.exp(np.array([[theta], [-theta]]))
    rotation = RotationGraph(2, [[0, 1], [0, 1]], turns, kappa=np.ones(2))
    graph = SimilarityGraph(rotation, np.zeros((2, 2)), np.ones(2), free=np.array([False, True]))
    answer = certpgo.solve(graph)
    assert answer.estimate.scales[1] == pytest.approx(np.cos(theta), rel=1e-9)
    assert answer.verdict == "CERTIFIED"
    assert answer.cost == pytest.approx(2 * 2 * np.sin(theta) ** 2, rel=1e-9)


@given(seeds, dimensions, noises, st.integers(0, 2))
@settings(max_examples=25)
def test_the_cost_is_that_of_its_edges(seed, d, noise, points):
    graph, truth = random_maps(rng_of(seed), d, turn=noise, scale=noise, points=points)
    problem = Quadratic(graph)
    expected = cost_by_loops(graph, truth)
    low, high = problem.enclosure(truth)
    assert low <= expected <= high
    assert high - low <= 1e-10 * high
    assert problem.cost(truth) == pytest.approx(expected, rel=1e-12)
    X = problem.blocks(truth)
    rows = np.concatenate([X.translations[:, None], np.swapaxes(X.rotations, 1, 2)], axis=1)
    rows = problem.pattern.layout_of(problem.matrix).pack(rows)
    assert np.trace(rows.T @ (problem.matrix @ rows)) == pytest.approx(expected, rel=1e-9)


@given(seeds, dimensions, noises, st.integers(0, 2))
@settings(max_examples=15)
def test_derivatives_are_those_of_the_cost(seed, d, noise, points):
    """At a stationary point the model is exact to third order: halving a step divides by 8."""
    rng = rng_of(seed)
    graph, truth = random_maps(rng, d, turn=noise, known=(2,), points=points)
    problem = Quadratic(graph)
    there = problem.linearized(descend(problem, truth).estimate)
    x = rng.standard_normal(there.layout.size)
    rows = there.layout.unpack(x)
    rows[~graph.free, -1] = 0.0  # of known scales
    x = there.layout.pack(rows)
    errors = []
    for h in (2e-3, 1e-3):
        model = there.cost + 2 * h * there.gradient @ x + h * h * (x @ (there.hessian @ x))
        errors.append(abs(there.moved(h * x).cost - model))
    assert errors[1] <= errors[0] / 5 + 1e-11 * there.cost


@given(seeds, dimensions, noises, noises, st.integers(0, 2))
@settings(max_examples=20)
def test_bounds_hold_for_all_that_descents_find(seed, d, turn, scale, points):
    """No descent from random starts ends below the bound, and certified ones are the best."""
    rng = rng_of(seed)
    graph, _ = random_maps(rng, d, turn=turn, scale=scale, move=turn, points=points)
    answer, problem = certpgo.solve(graph), Quadratic(graph)
    assert answer.certificate.lower_bound <= problem.enclosure(answer.estimate)[1]
    for _ in range(4):
        R = so.random(rng, graph.num_nodes, d)
        s = np.where(graph.free, np.exp(rng.standard_normal(graph.num_nodes)), 1.0)
        found = descend(problem, problem.complete(R, s)).estimate
        cost = cost_by_loops(graph, replace(found, scales=problem.scales.of(found)))
        assert cost >= answer.certificate.lower_bound * (1.0 - 1e-12)
        if answer.verdict == "CERTIFIED":
            assert cost >= answer.cost * (1.0 - 1e-5) - 1e-12 * problem.scale


@given(seeds, dimensions, noises)
@settings(max_examples=20)
def test_multipliers_of_unknown_scales_have_no_negative_trace(seed, d, noise):
    graph, truth = random_maps(rng_of(seed), d, turn=noise, scale=noise)
    problem = Quadratic(graph)
    answer = certpgo.certify(graph, truth)
    for Lam in (problem.multipliers(truth), answer.multipliers):
        for block in Lam[graph.free]:
            assert sum(map(Fraction, np.diag(block).tolist())) >= 0
        assert (Lam == np.swapaxes(Lam, 1, 2)).all()


@given(seeds, dimensions)
@settings(max_examples=10)
def test_certificates_prove_a_semidefinite_matrix(seed, d):
    """The multipliers of an answer, in dense arithmetic: S >= 0 but for rounding."""
    graph, truth = random_maps(rng_of(seed), d, points=1)
    problem = Quadratic(graph)
    found = certpgo.certify(graph, truth)
    S = problem.certificate_matrix(found.multipliers).toarray()
    values = np.linalg.eigvalsh(S)
    assert values[0] >= -1e-12 * values[-1]
    trace = np.trace(found.multipliers[problem.held], axis1=1, axis2=2).sum()
    assert found.lower_bound == pytest.approx(trace, rel=1e-12)


@given(seeds, dimensions)
@settings(max_examples=10)
def test_of_known_scales_it_is_the_problem_of_poses(seed, d):
    graph, truth = random_maps(rng_of(seed), d)
    known = replace(graph, scales=np.ones(graph.num_edges))
    known = Quadratic(known.with_unknown_scales(np.zeros(graph.num_nodes, bool)))
    flat = certpgo.PoseGraph(graph.rotations_alone, graph.translations, graph.tau)
    ours, theirs = certpgo.solve(known), certpgo.solve(flat)
    assert ours.verdict == theirs.verdict
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-7)
    assert ours.certificate.lower_bound == pytest.approx(theirs.certificate.lower_bound, rel=1e-4)
    poses = Estimate(truth.rotations, truth.translations)
    assert known.cost(poses) == pytest.approx(Quadratic(flat).cost(poses))


@given(seeds, dimensions, noises)
@settings(max_examples=10)
def test_laws_of_invariance(seed, d, noise):
    """Other names, another world frame, another unit of the world or of a free node: same verdict.

    In a unit of the world c times smaller, lengths are c times as many, tau is divided by c^2. In
    another unit of a free node j, of which c make one, s_ij and A_j are divided by c, lengths from
    j are multiplied; and kappa of what leads to j, c^2 times as much.
    """
    rng = rng_of(seed)
    graph, _ = random_maps(rng, d, turn=noise, scale=noise)
    answer = certpgo.solve(graph)

    def same(other, scales=None):
        assert other.verdict == answer.verdict
        assert other.cost == pytest.approx(answer.cost, rel=1e-7)
        assert other.certificate.lower_bound == pytest.approx(
            answer.certificate.lower_bound, rel=1e-6
        )
        if answer.verdict == "CERTIFIED" and scales is not None:
            assert other.estimate.scales == pytest.approx(scales, rel=1e-3)

    order = rng.permutation(graph.num_nodes)
    same(certpgo.solve(graph.subgraph(order)), answer.estimate.scales[order])
    same(
        certpgo.solve(
            replace(graph, translations=10.0 * graph.translations, tau=graph.tau / 100.0)
        ),
        answer.estimate.scales,
    )
    j, c = graph.num_nodes - 1, 3.0
    first, second = (graph.edges == j).T
    kappa = np.where(second, c**2, 1.0) * graph.kappa
    scales = graph.scales * np.where(first, c, 1.0) / np.where(second, c, 1.0)
    t = graph.translations * np.where(first, c, 1.0)[:, None]
    expected = answer.estimate.scales.copy()
    expected[j] /= c
    same(certpgo.solve(replace(graph, kappa=kappa, scales=scales, translations=t)), expected)


@given(seeds, dimensions)
@settings(max_examples=10)
def test_another_unit_of_the_map_is_another_cost(seed, d):
    """Where pose k is held, F of a map in its unit is F in the old one over s_k^2: a lower bound.

    A_i -> A_i / s_k and t -> t / s_k turn one feasible set into the other and divide F by s_k^2, so
    the optimum there is at most F / s_k^2 of each map here.
    """
    graph, _ = random_maps(rng_of(seed), d)
    here, k = certpgo.solve(graph), 3
    held = graph.with_unknown_scales(np.arange(graph.num_nodes) != k)
    there = certpgo.solve(held)
    s = here.estimate.scales
    moved = Estimate(here.estimate.rotations, here.estimate.translations / s[k], scales=s / s[k])
    assert Quadratic(held).cost(moved) == pytest.approx(here.cost / s[k] ** 2)
    assert there.certificate.lower_bound <= here.cost / s[k] ** 2 * (1 + 1e-9)


def test_all_starts_lead_to_the_optimum_where_noise_is_small():
    graph, _ = random_maps(np.random.default_rng(0), 3, 20, 40, turn=0.05, scale=0.05)
    problem = Quadratic(graph)
    best = certpgo.solve(graph)
    assert best.verdict == "CERTIFIED"
    for start in (compute(problem) for compute in STARTS):
        assert descend(problem, start.estimate).cost == pytest.approx(best.cost, rel=1e-9)


def test_a_loose_relaxation_has_a_bound_of_higher_rank():
    """Its bound is the minimum of the relaxation: an interior-point solver's 9.5788699."""
    rng, bounded = np.random.default_rng(5), 0
    for _ in range(40):
        graph, _ = random_maps(rng, 2, turn=0.8, scale=0.5, move=1.0)
        answer = certpgo.solve(graph)
        assert answer.verdict in ("CERTIFIED", "BOUNDED")
        bounded += answer.verdict == "BOUNDED"
        if answer.verdict == "BOUNDED":
            assert answer.certificate.lower_bound >= (1.0 - 1e-5) * answer.levels[-1].cost
    assert bounded


def test_estimates_of_others_are_judged():
    graph, truth = random_maps(np.random.default_rng(1), 3)
    found = certpgo.certify(graph, truth)
    assert found.verdict == "BOUNDED"
    assert found.basin_is_global
    assert certpgo.certify(graph, found.refined).verdict == "CERTIFIED"
    assert "similarities" in found.objective
    answer = certpgo.solve(graph, initial=truth)
    assert answer.verdict == "CERTIFIED"
    wrong = np.where(graph.free, truth.scales, 2.0)
    with pytest.raises(InputError, match="node 0 has scale 1 in the graph, 2 in the estimate"):
        certpgo.certify(graph, replace(truth, scales=wrong))


def test_graphs_that_mean_nothing_are_refused():
    graph, _ = random_maps(np.random.default_rng(1), 3, points=1)
    everything = ~graph.is_point
    for changed, said in (
        ({"scales": -graph.scales}, "a scale is a positive number"),
        ({"scales": graph.scales[1:]}, "scales must be"),
        ({"scales": np.full(graph.num_edges, np.nan)}, "a scale is a positive number"),
    ):
        with pytest.raises(GraphError, match=said):
            replace(graph, **changed)
    for free, said in (
        (everything[1:], "flags, one per node"),
        (np.ones(len(everything), bool), "a point has no scale"),
    ):
        with pytest.raises(GraphError, match=said):
            graph.with_unknown_scales(free)
    for ask in (certpgo.get_solver("spanning_tree")().solve, ladder):
        with pytest.raises(InputError, match="similarities"):
            ask(Quadratic(graph))
    with pytest.raises(GraphError, match="a scale is a positive number, not 0"):
        Estimate(np.array([np.eye(2)] * 2), scales=np.array([1.0, 0.0]))


# --- No known scale: the unit is the root mean square


def unscaled(graph):
    return graph.with_unknown_scales(~graph.is_point)


@given(seeds, dimensions, noises, noises, st.integers(0, 2))
@settings(max_examples=20)
def test_bounds_in_the_mean_unit_hold_for_all_that_descents_find(seed, d, turn, scale, points):
    rng = rng_of(seed)
    graph, truth = random_maps(rng, d, turn=turn, scale=scale, move=turn, points=points)
    graph = unscaled(graph)
    answer, problem = certpgo.solve(graph), Quadratic(graph)
    mean = np.mean(truth.scales[graph.free] ** 2)
    low, high = problem.enclosure(truth)
    assert low <= cost_by_loops(graph, truth) / mean <= high
    assert problem.cost(truth) == pytest.approx(low)
    for _ in range(4):
        R = so.random(rng, graph.num_nodes, d)
        s = np.where(graph.free, np.exp(rng.standard_normal(graph.num_nodes)), 1.0)
        found = descend(problem, problem.complete(R, s)).estimate
        cost = cost_by_loops(graph, found) / np.mean(found.scales[graph.free] ** 2)
        assert cost >= answer.certificate.lower_bound * (1.0 - 1e-12)
        if answer.verdict == "CERTIFIED":
            assert cost >= answer.cost * (1.0 - 1e-5) - 1e-12 * problem.scale


@given(seeds, dimensions, noises)
@settings(max_examples=15)
def test_the_mean_unit_is_nobodys(seed, d, noise):
    """A map in another unit costs the same, and its verdict is the same; so do other names."""
    rng = rng_of(seed)
    graph, truth = random_maps(rng, d, turn=noise, scale=noise)
    graph = unscaled(graph)
    problem, answer = Quadratic(graph), certpgo.solve(graph)
    larger = replace(truth, translations=3.0 * truth.translations, scales=3.0 * truth.scales)
    assert problem.cost(larger) == pytest.approx(problem.cost(truth))
    order = rng.permutation(graph.num_nodes)
    other = certpgo.solve(graph.subgraph(order))
    assert other.verdict == answer.verdict
    assert other.cost == pytest.approx(answer.cost, rel=1e-7)
    found = certpgo.certify(graph, larger)
    assert found.lower_bound == pytest.approx(answer.certificate.lower_bound, rel=1e-6)
    traces = np.trace(found.multipliers, axis1=1, axis2=2)
    assert found.lower_bound == pytest.approx(graph.num_nodes * traces.min(), rel=1e-12)


def test_derivatives_in_the_mean_unit_are_those_of_the_cost():
    graph, truth = random_maps(np.random.default_rng(3), 3, turn=0.3, points=1)
    problem = Quadratic(unscaled(graph))
    there = problem.linearized(descend(problem, truth).estimate)
    x = np.random.default_rng(0).standard_normal(there.layout.size)
    errors = []
    for h in (2e-3, 1e-3):
        model = there.cost + 2 * h * there.gradient @ x + h * h * (x @ (there.hessian @ x))
        errors.append(abs(there.moved(h * x).cost - model))
    assert errors[1] <= errors[0] / 5 + 1e-11 * there.cost


def test_a_known_scale_bears_the_whole_cost_and_a_mean_unit_does_not():
    """Euler: with one known scale its multiplier's trace is F, so a chain shrinks away from it."""
    graph, truth = random_maps(np.random.default_rng(2), 3, 60, 80, turn=0.1, scale=0.1)
    held, free = certpgo.solve(graph), certpgo.solve(unscaled(graph))
    Lam = held.certificate.multipliers
    assert np.trace(Lam[0]) == pytest.approx(held.cost, rel=1e-6)
    errors = [np.log(found.estimate.scales / truth.scales) for found in (held, free)]
    assert errors[0].mean() < -0.3  # a shrunk map
    assert errors[1].std() < 0.3


# --- Weights in the units of the frames


@given(seeds, dimensions, noises)
@settings(max_examples=10)
def test_other_units_of_nodes_are_other_weights(seed, d, noise):
    rng = rng_of(seed)
    graph, truth = random_maps(rng, d, turn=noise, points=1)
    s = np.where(graph.free, np.exp(rng.standard_normal(graph.num_nodes)), 1.0)
    i, j = graph.edges.T
    weighed = graph.with_weights(graph.kappa / s[j] ** 2, graph.tau / s[i] ** 2)
    moved = replace(truth, scales=truth.scales / s)
    expected = cost_by_loops(weighed, truth)
    assert cost_by_loops(graph.in_units_of(s), moved) == pytest.approx(expected, rel=1e-9)


def test_weights_of_the_frames_do_not_depend_on_their_units():
    """Another unit of every node, with the same weights in these, leads to the same map."""
    rng = np.random.default_rng(4)
    graph, truth = random_maps(rng, 3, 12, 24, turn=0.05, scale=0.05, move=0.05)
    graph = unscaled(graph)
    first = reweigh(graph)
    assert first.settled
    assert first.answer.verdict == "CERTIFIED"
    s = np.exp(rng.standard_normal(12))
    other = graph.in_units_of(s)
    second = reweigh(replace(other, tau=graph.tau))
    # kappa was in the units of the nodes, tau in that of the world: only scales are compared.
    assert np.log(first.answer.estimate.scales).std() < 1e-5
    assert np.log(first.estimate.scales / truth.scales).std() < 0.1
    assert np.log(second.estimate.scales * s / truth.scales).std() < 0.2


def test_graphs_without_unknown_scales_are_not_reweighed():
    graph, _ = random_maps(np.random.default_rng(0))
    with pytest.raises(InputError, match="no nodes of unknown scale"):
        reweigh(graph.rotations_alone)


@pytest.mark.parametrize("known", [(), (0,)])
def test_best_translations_are_stationary_in_any_unit(known):
    graph, truth = random_maps(np.random.default_rng(1), 3)
    free = np.ones(graph.num_nodes, dtype=bool)
    free[list(known)] = False
    problem = Quadratic(graph.with_unknown_scales(free))
    there = Estimate(truth.rotations, np.zeros((8, 3)), scales=3.0 * truth.scales)
    best = problem.with_optimal_translations(there)
    assert np.abs(problem.gradient(best)[:, :, 0]).max() < 1e-12 * problem.cost(best)
