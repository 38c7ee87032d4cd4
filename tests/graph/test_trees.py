"""Spanning trees and composition along them."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import RotationGraph
from certpgo.graph.trees import compose, spanning_tree
from certpgo.linalg import compiled


@given(seeds, dimensions)
def test_tree_edges_are_exact_in_the_composition(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 9, d)
    parents = spanning_tree(graph)
    estimate = compose(graph, parents)
    R, t = estimate.rotations, estimate.translations
    exact = 0
    for e, (i, j) in enumerate(graph.edges):
        rotation = np.abs(R[j] - R[i] @ graph.rotation.rotations[e]).max()
        move = np.abs(t[j] - t[i] - R[i] @ graph.translations[e]).max()
        exact += rotation < 1e-12 and move < 1e-11
    assert exact >= 8
    assert (parents < 0).sum() == 1
    np.testing.assert_array_equal(R[0].round(15), np.eye(d))


def test_lengths_choose_the_tree():
    triangle = RotationGraph(
        3, np.array([[0, 1], [1, 2], [0, 2]]), np.tile(np.eye(2), (3, 1, 1)), np.ones(3)
    )
    np.testing.assert_array_equal(spanning_tree(triangle)[1:], [0, 0])
    np.testing.assert_array_equal(spanning_tree(triangle, np.array([1.0, 1.0, 5.0]))[1:], [0, 1])


@pytest.mark.skipif(not compiled.AVAILABLE, reason="no compiled kernel")
@given(seeds, dimensions)
def test_the_kernel_finds_and_composes_the_tree_that_numpy_does(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 12, d)
    parents = spanning_tree(graph, root="center")
    estimate = compose(graph, parents)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "AVAILABLE", False)
        root = np.argmax(parents < 0)
        others = spanning_tree(graph, root="center")
        expected = compose(graph, others)
    assert others[root] < 0
    np.testing.assert_array_equal(np.delete(parents, root), np.delete(others, root))
    np.testing.assert_allclose(estimate.rotations, expected.rotations, atol=1e-13)
    np.testing.assert_allclose(estimate.translations, expected.translations, atol=1e-11)


@pytest.mark.skipif(not compiled.AVAILABLE, reason="no compiled kernel")
def test_the_kernel_refuses_what_is_no_tree():
    R, t = np.tile(np.eye(2), (3, 1, 1)), np.zeros((3, 2))
    for parents in ([1, 2, 0], [-1, 3, 0]):  # a cycle, an unknown node
        with pytest.raises(ValueError, match="parents"):
            compiled.kernel.compose(np.array(parents), 2, R, t)
    with pytest.raises(ValueError, match="same nodes"):
        compiled.kernel.compose(np.array([-1, 0]), 2, R, t)
    with pytest.raises(ValueError, match="pairs"):
        compiled.kernel.central_tree(np.array([[0, 3]]), np.empty(3, dtype=np.int64))
