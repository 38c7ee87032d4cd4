"""Spanning trees and composition along them."""

import numpy as np
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import RotationGraph
from certpgo.graph.trees import compose, spanning_tree


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
