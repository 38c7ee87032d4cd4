"""What an optimizer did: no start, another basin, a saddle, stopped early; and nothing else."""

import math

import numpy as np
import pytest
from strategies import pose_graph, rng_of

import certpgo
from certpgo import Estimate
from certpgo.diagnosis import optimizer
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.winding import wound
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.optimize.descent import descend

N = 30


def kinds(graph, estimate):
    return [one.kind for one in certpgo.diagnose(graph, estimate).findings]


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_of_an_optimum_or_of_true_poses(d):
    for seed in range(5):
        graph, R, t = pose_graph(rng_of(seed), N, d, extra=N, noise=0.3)
        for estimate in (Estimate(R, t), certpgo.solve(graph).estimate):
            examined = Examined(certpgo.Instance("graph", graph, np.arange(N)), estimate)
            assert not [*optimizer.found(examined)]


def test_nothing_of_true_poses_of_a_helix():
    for seed in range(10):
        made = helix(5, rng_of(seed))
        assert kinds(made, made.truth) == []


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("unset", [N, 12])
def test_poses_that_were_never_set(d, unset):
    graph = pose_graph(rng_of(1), N, d, extra=N, noise=0.03)[0]
    best = certpgo.solve(graph).estimate
    R, t = best.rotations.copy(), best.translations.copy()
    R[-unset:], t[-unset:] = np.eye(d), 0.0
    [first, *_] = certpgo.diagnose(graph, Estimate(R, t)).findings
    assert first.kind == "no-initialization"
    assert (str(unset) in first.said) == (unset < N)


@pytest.mark.parametrize("d", [2, 3])
def test_an_optimizer_that_stopped_early(d):
    graph = pose_graph(rng_of(2), N, d, extra=N, noise=0.03)[0]
    best = certpgo.solve(graph)
    rng = rng_of(3)
    off = best.estimate.translations + 0.3 * rng.standard_normal((N, d))
    begun = Estimate(best.estimate.rotations, off)
    if d == 3:  # after a step of descent from the tree
        tree = certpgo.graph.trees.tree_initialization(graph)
        begun = descend(best.problem, tree, monitor=lambda here: here.number >= 1).estimate
        begun = Estimate(begun.rotations, begun.translations + 0.2 * rng.standard_normal((N, d)))
    [first, *_] = certpgo.diagnose(graph, begun).findings
    assert first.kind == "stopped-early"
    assert first.cost == pytest.approx(best.cost)
    assert first.cost_as_given == pytest.approx(best.problem.cost(begun))
    assert first.said.startswith("the estimate is not at the optimum")
    assert "step" in first.said


def test_a_ring_that_is_wound_in_the_plane():
    instance, around = winding_cycle(30, 0.3, 2, 2)
    [first, *_] = certpgo.diagnose(instance, around).findings
    assert (first.kind, first.proven) == ("wrong-basin", True)
    assert sorted(first.edges) == list(range(30))
    found = wound(instance.graph, around, instance.truth)
    assert found.degrees == pytest.approx(720.0 + math.degrees(0.3), abs=1e-6)
    assert (found.usual, found.loops) == (pytest.approx(math.degrees(0.3), abs=1e-6), 1)
    assert wound(instance.graph, instance.truth, instance.truth) is None


def test_a_wound_loop_in_space_is_named_among_others():
    """Two rings that share a node: the second one is wound."""
    ring, around = winding_cycle(40, 0.1, 1)
    graph, n = ring.graph, 40
    edges = np.concatenate([graph.edges, np.where(graph.edges == 0, 0, graph.edges + n - 1)])
    R = np.concatenate([graph.rotations] * 2)
    two = certpgo.RotationGraph(2 * n - 1, edges, R, np.ones(2 * n))
    plain, turned = ring.truth.rotations, around.rotations
    aligned = plain[0] @ turned[0].T @ turned
    found = wound(
        two,
        Estimate(np.concatenate([plain, aligned[1:]])),
        Estimate(np.concatenate([plain, plain[1:]])),
    )
    assert (found.edges >= n).all()
    assert len(found.edges) == n
    assert found.loops == 1


def test_a_saddle():
    instance, around = winding_cycle(9, 0.3, 1)
    [first, *_] = certpgo.diagnose(instance, around).findings
    assert first.kind == "saddle"


def test_an_optimum_of_another_cost():
    made = helix(4, rng_of(0), rotation_noise=0.3, translation_noise=0.3)
    stiff = np.diag([40.0, 1.0, 4.0, 9.0, 1.0, 25.0]) + np.full((6, 6), 0.1)
    graph = made.graph.with_information(np.tile(stiff, (made.graph.num_edges, 1, 1)))
    other = certpgo.solve(graph, cost="chordal").estimate
    found = certpgo.diagnose(graph, other, cost="g2o").findings
    assert found[0].kind == "other-cost"  # its noise is not as stated either
    assert "chordal" in found[0].said


def test_a_node_that_is_free():
    made = helix(3, rng_of(0))
    fixes = made.truth.translations[[0, 8]]
    graph = certpgo.with_priors(made.graph, [0, 8], translations=fixes, tau=25.0)
    found = certpgo.diagnose(graph).findings
    assert [one.kind for one in found] == ["undetermined"]
