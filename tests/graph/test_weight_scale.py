"""W, the scale of a cost: sums of weights, and what positions count."""

import numpy as np
import pytest
from hypothesis import given, settings
from strategies import dimensions, pose_graph, rng_of, seeds

import certpgo
from certpgo.graph import PoseGraph
from certpgo.graph.concatenate import joined
from certpgo.graph.scale import Scale
from certpgo.objective.quadratic import Quadratic


def with_fixes(seed, d, far, tau=4.0):
    graph, _, t = pose_graph(rng_of(seed), 6, d)
    fixed = certpgo.with_priors(graph, np.arange(6), translations=t, tau=tau)
    moved = fixed.translations.copy()
    moved[-6:, 0] += far
    return PoseGraph(fixed.rotations_alone, moved, fixed.tau, absolute=fixed.absolute), graph


@given(seeds, dimensions)
@settings(max_examples=20)
def test_w_is_the_sum_of_the_weights(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 6, d)
    expected = graph.kappa.sum() + graph.tau @ (graph.translations**2).sum(axis=1)
    assert Quadratic(graph).scale == pytest.approx(expected, rel=1e-14)
    arms = np.ones((graph.num_edges, d))
    general = PoseGraph(graph.rotations_alone, graph.translations, graph.tau, arms)
    assert Scale.of(general).total == pytest.approx(expected + d * graph.tau.sum(), rel=1e-14)


@given(seeds, dimensions)
@settings(max_examples=20)
def test_positions_count_by_the_typical_step_however_far_they_are(seed, d):
    far, graph = with_fixes(seed, d, 1e6)
    own = Scale.of(graph)
    typical = (own.move @ own.squares) / own.move.sum()
    assert far.absolute.sum() == 6
    assert Quadratic(far).scale == pytest.approx(own.total + 6 * 4.0 * typical, rel=1e-12)
    assert Quadratic(with_fixes(seed, d, 1e7)[0]).scale == Quadratic(far).scale


def test_positions_nearer_than_a_step_count_by_their_distance():
    turn = certpgo.RotationGraph(2, np.array([[0, 1]]), np.eye(2)[None], np.ones(1))
    graph = PoseGraph(turn, np.array([[10.0, 0.0]]), np.ones(1))
    fixed = certpgo.with_priors(graph, np.array([0]), translations=np.array([[3.0, 0.0]]), tau=2.0)
    assert Quadratic(fixed).scale == 1.0 + 100.0 + 18.0


def test_positions_count_nothing_where_rotations_alone_are_relative():
    turns = certpgo.RotationGraph(
        3, np.array([[0, 1], [1, 2]]), np.tile(np.eye(2), (2, 1, 1)), np.ones(2)
    )
    graph = PoseGraph(turns, np.zeros((2, 2)), np.zeros(2))
    fixes = np.array([[0.0, 0.0], [3.0, 4.0], [6.0, 8.0]])
    fixed = certpgo.with_priors(graph, np.arange(3), translations=fixes, tau=2.0)
    assert Scale.of(fixed).total == 2.0
    assert Scale.of(fixed.with_edges(fixed.absolute)).total == 2.0 * (25.0 + 100.0)


@given(seeds, dimensions)
@settings(max_examples=20)
def test_scales_of_parts_add_up(seed, d):
    graph, _ = with_fixes(seed, d, 1e3)
    chosen = rng_of(seed).random(graph.num_edges) < 0.5
    halves = [graph.with_edges(half) for half in (chosen, ~chosen)]
    assert (Scale.of(halves[0]) + Scale.of(halves[1])).total == pytest.approx(
        Scale.of(graph).total, rel=1e-12
    )
    whole = joined(halves, graph.num_nodes)
    assert whole.absolute.sum() == 6
    assert Scale.of(whole).total == pytest.approx(Scale.of(graph).total, rel=1e-12)


def test_which_measurements_are_absolute_is_kept(tmp_path):
    graph, _ = with_fixes(0, 3, 10.0)
    certpgo.write(tmp_path / "graph.npz", graph)
    again = certpgo.read(tmp_path / "graph.npz", quiet=True).graph
    np.testing.assert_array_equal(again.absolute, graph.absolute)
    np.testing.assert_array_equal(graph.subgraph(np.arange(7)).absolute, graph.absolute)
    assert graph.subgraph(np.arange(6)).absolute is None
    with pytest.raises(certpgo.GraphError, match="absolute must be 23 flags"):
        PoseGraph(graph.rotations_alone, graph.translations, graph.tau, absolute=[True])
