"""The compiled descent and bound of plain graphs: those of the general ways, by dense algebra."""

import numpy as np
import pytest
from features import having
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo import PoseGraph, Quadratic
from certpgo.certify.dual import dual_bound
from certpgo.graph import Estimate
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.objective.plain_edges import PlainEdges
from certpgo.optimize.descent import rested

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="needs the compiled kernel")


def moved(rng, estimate, by):
    """Another estimate, whose angles and lengths are off by about so much."""
    R, t = estimate.rotations, estimate.translations
    turned = so.turned(R, by * rng.standard_normal((len(R), so.tangent_dim(R.shape[1]))))
    return Estimate(turned, t + by * rng.standard_normal(t.shape))


def plain_edges(graph):
    """All of a graph, edge by edge, between nodes that are numbered the other way around."""
    n, found = graph.num_nodes, PlainEdges(graph.d)
    for edge in range(graph.num_edges):
        ends = graph.edges[edge]
        assert found.extended(graph.with_edges([edge]).subgraph(ends), n - 1 - ends) is found
    return found


def reversed_(estimate):
    """With the nodes the other way around."""
    return Estimate(estimate.rotations[::-1], estimate.translations[::-1])


@given(seeds, dimensions)
def test_it_ends_where_descent_does_with_a_bound_that_dense_algebra_confirms(seed, d):
    rng = rng_of(seed)
    graph, *truth = pose_graph(rng, 9, d, extra=9, noise=0.03)
    problem, plain = Quadratic(graph), plain_edges(graph)
    best = rested(problem, Estimate(*truth))
    found = plain.settled(reversed_(moved(rng, best, 0.0002)), 1e-10)
    assert found is not None
    assert found.proven is not None
    end, proven = reversed_(found.estimate), found.proven[::-1]
    assert problem.cost(end) <= found.cost == pytest.approx(problem.cost(best), rel=1e-9)
    assert found.cost == pytest.approx(problem.enclosure(end)[1], rel=1e-14)
    expected = problem.multipliers(end)
    np.testing.assert_allclose(found.multipliers[::-1], expected, rtol=0, atol=1e-10)
    t = problem.with_optimal_translations(end).translations
    np.testing.assert_allclose(np.ptp(end.translations - t, axis=0), 0.0, atol=1e-9)
    S = problem.certificate_matrix(proven).toarray()[1:, 1:]  # a position is pinned
    sizes = np.sqrt(np.diag(S))
    assert np.linalg.eigvalsh(S / np.outer(sizes, sizes))[0] >= -1e-14
    value, known = np.trace(proven, axis1=1, axis2=2).sum(), dual_bound(problem, end)
    assert value <= found.cost
    assert value == pytest.approx(known.value, rel=1e-9, abs=1e-12 * problem.scale)


def test_a_minimum_that_is_not_the_least_is_not_proven():
    instance, around = winding_cycle(12, 0.0, 1)
    graph, m, d = instance.graph, instance.graph.num_edges, instance.graph.d
    poses = PoseGraph(graph, np.zeros((m, d)), np.ones(m))
    plain = PlainEdges(d).extended(poses, np.arange(12))
    found = plain.settled(Estimate(around.rotations, np.zeros((12, d))), 1e-10)
    assert found is None or found.proven is None


def test_a_start_that_is_far_is_left_to_others():
    rng = rng_of(3)
    graph, *_ = pose_graph(rng, 9, 3, extra=9, noise=0.03)
    start = Estimate(so.random(rng, 9, 3), np.zeros((9, 3)))
    found = plain_edges(graph).settled(start, 1e-10)
    assert found is None or Quadratic(graph).stationarity(found.estimate) < 1e-4


@pytest.mark.parametrize("feature", ["distances", "partial edges", "matrix weights", "arms"])
def test_graphs_with_more_are_left_to_others(feature):
    graph = having(feature)
    assert PlainEdges(graph.d).extended(graph, np.arange(graph.num_nodes)) is None


@given(seeds, dimensions)
def test_new_nodes_begin_where_measurements_put_them(seed, d):
    rng = rng_of(seed)
    graph, *truth = pose_graph(rng, 9, d, extra=9, noise=0.03)
    plain = PlainEdges(d).extended(graph, np.arange(9))
    best = rested(Quadratic(graph), Estimate(*truth))
    R, t = np.array(best.rotations), np.array(best.translations)
    R[4:], t[4:] = so.random(rng, 5, d), rng.standard_normal((5, d))
    found = plain.settled(Estimate(R, t), 1e-10, 4)
    assert found is not None
    assert found.cost == pytest.approx(Quadratic(graph).cost(best), rel=1e-9)
    with pytest.raises(ValueError, match="the first of the nodes"):
        plain.settled(best, 1e-10, 10)
