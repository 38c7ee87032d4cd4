"""The compiled descent and bound of plain graphs: those of the general ways, by dense algebra."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo import PoseGraph, Quadratic
from certpgo.certify.dual import dual_bound
from certpgo.graph import Estimate
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so
from certpgo.objective.plain_graph import PlainGraph
from certpgo.optimize.descent import rested

pytestmark = pytest.mark.skipif(not compiled.AVAILABLE, reason="needs the compiled kernel")


def moved(rng, estimate, by):
    """Another estimate, whose angles and lengths are off by about so much."""
    R, t = estimate.rotations, estimate.translations
    turned = so.turned(R, by * rng.standard_normal((len(R), so.tangent_dim(R.shape[1]))))
    return Estimate(turned, t + by * rng.standard_normal(t.shape))


@given(seeds, dimensions)
def test_it_ends_where_descent_does_with_a_bound_that_dense_algebra_confirms(seed, d):
    rng = rng_of(seed)
    graph, *truth = pose_graph(rng, 9, d, extra=9, noise=0.03)
    problem = Quadratic(graph)
    assert PlainGraph.is_plain(problem)
    plain, best = PlainGraph(problem), rested(problem, Estimate(*truth))
    found = plain.settled(moved(rng, best, 0.002), 1e-10)
    assert found is not None
    end, multipliers = found
    assert problem.cost(end) == pytest.approx(problem.cost(best), rel=1e-9)
    np.testing.assert_allclose(multipliers, problem.multipliers(end), rtol=0, atol=1e-10)
    t = problem.with_optimal_translations(end).translations
    np.testing.assert_allclose(end.translations, t, rtol=0, atol=1e-9)
    proven = plain.proven(end, multipliers)
    assert proven is not None
    S = problem.certificate_matrix(proven).toarray()[1:, 1:]  # a position is pinned
    sizes = np.sqrt(np.diag(S))
    assert np.linalg.eigvalsh(S / np.outer(sizes, sizes))[0] >= -1e-14
    value, known = np.trace(proven, axis1=1, axis2=2).sum(), dual_bound(problem, end)
    assert value <= problem.enclosure(end)[1]
    assert value == pytest.approx(known.value, rel=1e-9, abs=1e-12 * problem.scale)


def test_a_minimum_that_is_not_the_least_is_not_proven():
    instance, around = winding_cycle(12, 0.0, 1)
    graph = instance.graph
    poses = PoseGraph(graph, np.zeros((graph.num_edges, graph.d)), np.ones(graph.num_edges))
    plain = PlainGraph(Quadratic(poses))
    start = Estimate(around.rotations, np.zeros((12, graph.d)))
    found = plain.settled(start, 1e-10)
    assert found is None or plain.proven(*found) is None


def test_a_start_that_is_far_is_left_to_others():
    rng = rng_of(3)
    graph, *_ = pose_graph(rng, 9, 3, extra=9, noise=0.03)
    problem, start = Quadratic(graph), Estimate(so.random(rng, 9, 3), np.zeros((9, 3)))
    found = PlainGraph(problem).settled(start, 1e-10)
    assert found is None or problem.cost(found[0]) <= problem.cost(start)
