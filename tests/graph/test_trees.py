"""Spanning trees and composition along them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.concatenate import joined
from certpgo.graph.edges import components_of
from certpgo.graph.trees import compose, spanning_tree, with_leaves_placed
from certpgo.linalg import compiled
from certpgo.linalg import rotations as so


@given(seeds, dimensions)
def test_tree_edges_are_exact_in_the_composition(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 9, d)
    parents = spanning_tree(graph)
    estimate = compose(graph, parents)
    R, t = estimate.rotations, estimate.translations
    exact = 0
    for e, (i, j) in enumerate(graph.edges):
        rotation = np.abs(R[j] - R[i] @ graph.rotations[e]).max()
        move = np.abs(t[j] - t[i] - R[i] @ graph.translations[e]).max()
        exact += rotation < 1e-12 and move < 1e-11
    assert exact >= 8
    assert (parents < 0).sum() == 1
    np.testing.assert_array_equal(R[0].round(15), np.eye(d))


@given(seeds, dimensions)
def test_leaves_are_placed_where_their_edge_has_no_residual(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 9, d)
    ends = np.array([[0, 9], [10, 3], [4, 11]])  # to a pose, from a pose, to a point
    q, n = d * (d - 1) // 2, 12
    turns = so.exp(rng.normal(size=(3, q)))
    turns[2] = np.eye(d)
    hung = PoseGraph(
        RotationGraph(n, ends, turns, np.array([2.0, 3.0, 0.0])),
        rng.normal(size=(3, d)),
        np.array([1.0, 2.0, 3.0]),
        np.where(np.arange(3)[:, None] < 2, rng.normal(size=(3, d)), 0.0),
        np.arange(n) == 11,
    )
    whole = joined([graph, hung], n, hung.is_point)
    R, t = so.exp(rng.normal(size=(n, q))), rng.normal(size=(n, d))
    R[11] = np.eye(d)
    before = Estimate(R, t)
    after = with_leaves_placed(whole, before)
    for e, (i, j) in enumerate(ends):
        R, t = after.rotations, after.translations
        seen = R[i].T @ (t[j] + R[j] @ hung.arms[e] - t[i])
        np.testing.assert_allclose(seen, hung.translations[e], atol=1e-12)
        if e < 2:
            np.testing.assert_allclose(R[i].T @ R[j], turns[e], atol=1e-12)
    moved = np.flatnonzero((after.translations != before.translations).any(axis=1))
    degrees = np.bincount(whole.edges.ravel(), minlength=n)
    assert set(moved) <= set(np.flatnonzero(degrees == 1))
    assert {9, 10, 11} <= set(moved)


def test_lengths_choose_the_tree():
    triangle = RotationGraph(
        3, np.array([[0, 1], [1, 2], [0, 2]]), np.tile(np.eye(2), (3, 1, 1)), np.ones(3)
    )
    np.testing.assert_array_equal(spanning_tree(triangle)[1:], [0, 0])
    np.testing.assert_array_equal(spanning_tree(triangle, np.array([1.0, 1.0, 5.0]))[1:], [0, 1])


@pytest.mark.skipif(not compiled.AVAILABLE, reason="no compiled kernel")
@given(seeds, dimensions, st.booleans())
def test_the_kernel_finds_and_composes_the_tree_that_numpy_does(seed, d, parallel):
    graph, _, _ = pose_graph(rng_of(seed), 12, d)
    if parallel:  # of these edges both take the heaviest, and of equals the first
        back = RotationGraph(
            12,
            np.concatenate([graph.edges, graph.edges[:, ::-1], graph.edges]),
            so.random(rng_of(seed), 3 * graph.num_edges, d),
            rng_of(seed).integers(1, 3, 3 * graph.num_edges).astype(float),
        )
        t = rng_of(seed).standard_normal((back.num_edges, d))
        graph = PoseGraph(back, t, np.ones(back.num_edges))
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
    pairs, one = np.array([[0, 1], [1, 2], [2, 0]]), np.ones(3)
    edges = pairs, R, None, one, None, t, None
    for parents in ([1, 2, 0], [-1, 3, 0]):  # a cycle, an unknown node
        with pytest.raises(ValueError, match="parents"):
            compiled.kernel.compose(edges, 2, np.array(parents), R, t)
    with pytest.raises(ValueError, match="parents"):  # not an edge
        compiled.kernel.compose(
            (pairs[:2], R[:2], None, one[:2], None, t[:2], None), 2, np.array([-1, 0, 0]), R, t
        )
    for wrong in (
        (edges, 2, np.array([-1, 0]), R, t),
        (edges, 2, np.array([-1, 0, 1]), R[1:], t),
        (edges, 2, np.array([-1, 0, 1]), R, t[1:]),
        ((pairs + 1, *edges[1:]), 2, np.array([-1, 0, 1]), R, t),
        ((*edges[:5], None, None), 2, np.array([-1, 0, 1]), R, t),
    ):
        with pytest.raises(ValueError, match="same nodes"):
            compiled.kernel.compose(*(x.copy() if isinstance(x, np.ndarray) else x for x in wrong))
    parents, order = np.empty((2, 3), dtype=np.int64)
    for wrong, root, nodes in ((3, -1, order), (2, 3, order), (2, -2, order), (2, 0, order[:2])):
        with pytest.raises(ValueError, match="pairs"):
            compiled.kernel.tree(np.array([[0, wrong]]), root, parents, nodes)
    with pytest.raises(ValueError, match="pairs"):
        compiled.kernel.components(np.array([[0, 3]]), np.empty(3, dtype=np.int64))


@given(st.integers(1, 12), st.data())
def test_components_are_those_of_scipy_counted_by_their_first_nodes(n, data):
    nodes = st.integers(0, n - 1)
    edges = np.array(data.draw(st.lists(st.tuples(nodes, nodes), max_size=12)), dtype=int)
    edges = edges.reshape(-1, 2)
    labels = components_of(n, edges)
    matrix = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    np.testing.assert_array_equal(labels, connected_components(matrix, directed=False)[1])
    firsts = np.unique(labels, return_index=True)[1]
    assert (np.diff(firsts) > 0).all()


def test_components_of_a_path_and_a_pair_apart():
    assert components_of(6, np.array([[4, 3], [0, 3], [5, 1]])).tolist() == [0, 1, 2, 0, 0, 1]
