"""Bounds from the parts between bridges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import certpgo
from certpgo import certify
from certpgo.certify import Tier, Verdict
from certpgo.certify.bridge_blocks import outside, parts, sum_of_bounds
from certpgo.certify.dual import DualBound
from certpgo.certify.normalized import NormalizedProblem
from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.bridges import bridges
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.minima import local_minimum


def ring(rng, n, d, noise):
    """A closed walk around a unit circle, measured with noise; edges, rotations, steps."""
    angle = 2.0 * np.pi * np.arange(n) / n
    place = np.zeros((n, d))
    place[:, 0], place[:, 1] = np.cos(angle), np.sin(angle)
    edges = np.stack([np.arange(n), (np.arange(n) + 1) % n], axis=1)
    R = so.exp(noise * rng.standard_normal((n, so.tangent_dim(d))))
    return edges, R, np.roll(place, -1, axis=0) - place + noise * rng.standard_normal((n, d))


def joined(seed, length, d=3, noise=1e-4, n=12):
    """Two rings and a bridge of that length between them."""
    rng = np.random.default_rng(seed)
    first, second = ring(rng, n, d, noise), ring(rng, n, d, noise)
    bridge = np.array([[3, n + 5]]), so.random(rng, 1, d), np.array([[length] + [0.0] * (d - 1)])
    edges = np.concatenate([first[0], second[0] + n, bridge[0]])
    R = np.concatenate([first[1], second[1], bridge[1]])
    t = np.concatenate([first[2], second[2], bridge[2]])
    m = len(edges)
    return PoseGraph(RotationGraph(2 * n, edges, R, np.ones(m)), t, np.ones(m))


@pytest.mark.parametrize("tier", [Tier.STANDARD, Tier.PROOF])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("length", [1e4, 1e8])
def test_a_long_bridge_takes_nothing_from_the_bound(d, length, tier):
    graph = joined(0, length, d)
    answer = certpgo.solve(graph)
    certificate = certify(Quadratic(graph), answer.estimate, tier=tier)
    assert certificate.verdict is Verdict.CERTIFIED
    # F* is the sum of the rings' optima, each certified by itself.
    alone = [certpgo.solve(graph.subgraph(np.arange(k, k + 12))).certificate for k in (0, 12)]
    low = sum(c.lower_bound for c in alone)
    high = sum(c.cost_upper for c in alone)
    assert 0.99 * low <= certificate.lower_bound <= high
    assert answer.certificate.lower_bound >= 0.99 * low


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([2, 3]))
def test_multipliers_of_parts_prove_the_whole(seed, d):
    """S >= 0 by its eigenvalues, at moderate lengths."""
    graph = joined(seed, 3.0, d, noise=1e-2, n=6)
    problem = Quadratic(graph)
    # Without tolerance the parts are asked.
    normalized = NormalizedProblem.of(problem, Tier.STANDARD, 0.0, 0.0)
    basin = local_minimum(normalized, certpgo.solve(graph).estimate)
    S = normalized.problem.certificate_matrix(basin.bound.multipliers).toarray()
    trace = np.trace(basin.bound.multipliers, axis1=1, axis2=2).sum()
    assert np.linalg.eigvalsh(S).min() >= -1e-14 * np.abs(S).max()
    assert trace == pytest.approx(basin.bound.value, rel=1e-14)


def test_a_small_part_is_not_lost_beside_an_exact_one():
    """F* = 0 in a part of weight 1e9; the other's optimum is far below rounding of that."""
    n = 6
    small, _ = winding_cycle(n, 1e-2, 0)
    exact, _ = winding_cycle(n, 0.0, 0)
    edges = np.concatenate([exact.graph.edges, small.graph.edges + n, [[0, n]]])
    R = np.concatenate([exact.graph.rotations, small.graph.rotations, np.eye(3)[None]])
    kappa = np.concatenate([np.full(n, 1e14), np.ones(n), [1.0]])
    problem = Quadratic(RotationGraph(2 * n, edges, R, kappa))
    optimum = 8 * n * np.sin(1e-2 / (2 * n)) ** 2
    estimate = Estimate(np.concatenate([exact.truth.rotations, small.truth.rotations]))
    certificate = certify(problem, estimate)
    assert certificate.cost_upper == pytest.approx(optimum, rel=1e-6)
    assert 0.99 * optimum <= certificate.lower_bound <= optimum * (1.0 + 1e-12)


def test_parts_of_an_unrefined_estimate_are_not_improved_either():
    graph = joined(0, 1e3)
    best = certpgo.solve(graph)
    turned = so.exp(1e-3 * np.random.default_rng(0).standard_normal((24, 3)))
    off = Estimate(best.estimate.rotations @ turned, best.estimate.translations)
    problem = Quadratic(graph)
    assert certify(problem, off).lower_bound >= 0.99 * best.cost
    assert certify(problem, off, refine=False).lower_bound == 0.0


def test_parts_are_what_bridges_leave():
    graph = joined(0, 5.0)
    problem = Quadratic(graph)
    found = parts(problem)
    assert [part.nodes.tolist() for part in found] == [list(range(12)), list(range(12, 24))]
    assert all(len(bridges(part.problem.graph)) == 0 for part in found)
    assert sum(part.problem.graph.num_edges for part in found) == graph.num_edges - 1
    assert outside(problem, found) == pytest.approx(26.0 / problem.scale, rel=1e-12)
    assert parts(found[0].problem) == []


def test_a_pair_measured_twice_between_bridges_is_a_part():
    edges = np.array([[0, 5], [0, 1], [1, 2], [2, 1], [2, 3], [3, 4]])
    graph = RotationGraph(6, edges, np.tile(np.eye(3), (6, 1, 1)), np.ones(6))
    assert [part.nodes.tolist() for part in parts(Quadratic(graph))] == [[1, 2]]


@given(st.integers(0, 1000))
def test_every_edge_is_a_bridge_or_in_a_part(seed):
    rng = np.random.default_rng(seed)
    n = 12
    tree = [(int(rng.integers(0, k)), k) for k in range(1, n)]
    edges = np.array(tree + [tuple(rng.choice(n, 2, replace=False)) for _ in range(5)])
    graph = RotationGraph(n, edges, np.tile(np.eye(2), (len(edges), 1, 1)), np.ones(len(edges)))
    cut = {tuple(pair) for pair in bridges(graph).tolist()}
    inside = sum(tuple(sorted(edge)) not in cut for edge in edges.tolist())
    found = parts(Quadratic(graph))
    assert sum(part.problem.graph.num_edges for part in found) == (inside if cut else 0)


def test_what_lies_outside_counts_by_weight_or_by_length():
    light = joined(0, 5.0).with_weights(tau=np.full(25, 1e-9))
    problem = Quadratic(light)
    inside = np.linalg.norm(light.translations[:-1], axis=1).sum()
    assert outside(problem, parts(problem)) == pytest.approx(5.0 / (inside + 5.0), rel=1e-12)
    rotation = problem.rotation
    assert outside(rotation, parts(rotation)) == pytest.approx(1.0 / 25.0, rel=1e-12)


def test_bounds_of_parts_add_up():
    problem = Quadratic(joined(0, 5.0))
    found = parts(problem)
    bounds = [
        DualBound(value, np.full((12, 3, 3), value), problem, shift, 1, nonzeros)
        for value, shift, nonzeros in ((0.25, 1e-9, 10), (0.5, 1e-7, 7))
    ]
    summed = sum_of_bounds(problem, found, lambda part: bounds[found.index(part)])
    assert (summed.value, summed.shift) == (np.nextafter(0.75, 0.0), 1e-7)
    assert (summed.factorizations, summed.nonzeros) == (2, 10)
    assert (summed.multipliers[:12] == 0.25).all()
    assert (summed.multipliers[12:] == 0.5).all()
    assert sum_of_bounds(problem, found, lambda part: None) is None


def test_a_tree_has_no_parts():
    path = RotationGraph(3, np.array([[0, 1], [1, 2]]), np.tile(np.eye(3), (2, 1, 1)), np.ones(2))
    assert parts(Quadratic(path)) == []
    assert certpgo.solve(path).verdict is Verdict.CERTIFIED
