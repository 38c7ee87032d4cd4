"""Measurements from the world, of a part of a pose, and what they leave free."""

import numpy as np
import pytest
from strategies import pose_graph, rng_of

from certpgo import GraphError, InputError, Quadratic, with_priors
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.priors import handedness_is_open, origin_of, require_determined


def chain(d, kappa, tau, t=None):
    """A chain of poses a metre apart."""
    m = len(kappa)
    edges = np.stack([np.arange(m), np.arange(1, m + 1)], axis=1)
    rotation = RotationGraph(m + 1, edges, np.tile(np.eye(d), (m, 1, 1)), np.asarray(kappa))
    t = np.tile(np.eye(d)[0], (m, 1)) if t is None else t
    return PoseGraph(rotation, t, np.asarray(tau))


def test_the_world_is_the_last_node():
    graph, R, t = pose_graph(rng_of(0), 5, 3)
    joined = with_priors(graph, [1, 3, 3], R[[1, 3, 3]], t[[1, 3, 3]], kappa=[1.0, 2.0, 0.0], tau=4)
    assert joined.num_nodes == 6
    assert joined.edges[-3:].tolist() == [[5, 1], [5, 3], [5, 3]]
    assert joined.kappa[-3:].tolist() == [1.0, 2.0, 0.0]
    assert joined.tau[-3:].tolist() == [4.0] * 3
    np.testing.assert_allclose(joined.translations[-3:], t[[1, 3, 3]])
    assert joined.is_partial
    assert joined.is_general
    assert not graph.is_partial
    for whole in (with_priors(graph, [0], R[:1], t[:1], kappa=1.0, tau=1.0), graph):
        assert not whole.is_general


def test_edges_that_measure_nothing_are_refused():
    with pytest.raises(GraphError, match=r"edge \(1, 2\): kappa and tau are 0"):
        chain(2, [1.0, 0.0], [1.0, 0.0])
    with pytest.raises(GraphError, match=r"kappa is -1\.0; it must be positive"):
        chain(2, [1.0, -1.0], [1.0, 1.0])
    with pytest.raises(GraphError, match="kappa is 0; only edges of a pose graph"):
        Quadratic(chain(2, [1.0, 0.0], [1.0, 1.0]).rotations_alone)
    whole = chain(2, [1.0, 1.0], [1.0, 1.0])
    for given, words in (
        ({"kappa": 1.0}, "kappa and rotations are given together"),
        ({"rotations": np.eye(2)[None]}, "kappa and rotations are given together"),
        ({"tau": 1.0}, "tau and translations are given together"),
    ):
        with pytest.raises(InputError, match=words):
            with_priors(whole, [0], **given)
    with pytest.raises(InputError, match="by their numbers"):
        with_priors(whole, np.ones(3, dtype=bool), np.tile(np.eye(2), (3, 1, 1)), kappa=1.0)
    far = np.array([[5e5, 4.5e6], [5e5 + 3, 4.5e6], [5e5, 4.5e6 + 3]])
    with pytest.raises(
        InputError, match=r"lie around \[500000.0, 4500000.0\], far from the origin"
    ):
        with_priors(whole, [0, 1, 2], translations=far, tau=1.0)


def test_origins_are_subtracted_exactly():
    rng = rng_of(0)
    for size in (1e-3, 1.0, 300.0):
        near = size * rng.standard_normal((50, 3))
        assert not origin_of(near).any()
        there = near + np.array([4e6, -2e5, 7.0])
        origin = origin_of(there)
        assert origin[:2].all()
        np.testing.assert_array_equal((there - origin) + origin, there)
        assert np.abs(there - origin).max() < 20.0 * max(size, 1.0) + 8.0
    assert not origin_of(np.empty((0, 3))).any()


def test_free_nodes_are_named():
    require_determined(chain(3, [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]))
    with pytest.raises(GraphError, match=r"2 parts of the graph.* the position of node 3 is free"):
        Quadratic(chain(3, [1.0, 1.0, 1.0], [1.0, 1.0, 0.0]))
    with pytest.raises(GraphError, match="no measurement determines the rotation of node 3"):
        Quadratic(chain(3, [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]))
    graph = chain(2, [1.0, 1.0], [1.0, 1.0])
    # No position is measured from the world, which is put at the first node.
    require_determined(with_priors(graph, [0], np.eye(2)[None], kappa=1.0))
    with pytest.raises(GraphError, match="the rotation of node 3"):
        Quadratic(with_priors(graph, [0], translations=np.zeros((1, 2)), tau=1.0))


@pytest.mark.parametrize(
    ("positions", "expected"),
    [
        ([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 0.1]], True),
        ([[0, 0, 0], [9, 0, 0], [0, 9, 0], [9, 9, 9]], False),
        ([[0, 0, 0], [9, 0, 0]], True),
    ],
)
def test_positions_in_a_plane_leave_handedness_open(positions, expected):
    graph, R, _ = pose_graph(rng_of(1), 6, 3)
    nodes, p = np.arange(len(positions)), np.array(positions, dtype=float)
    assert handedness_is_open(with_priors(graph, nodes, translations=p, tau=1.0)) is expected
    joined = with_priors(
        graph, np.r_[nodes, 5], np.r_[R[nodes], R[5:]], np.r_[p, p[:1]],
        tau=1.0, kappa=np.r_[np.zeros(len(nodes)), 1.0],
    )  # fmt: skip
    assert not handedness_is_open(joined)
    assert not handedness_is_open(graph)
    flat = with_priors(pose_graph(rng_of(1), 6, 2)[0], nodes, translations=p[:, :2], tau=1.0)
    assert handedness_is_open(flat) is (len(positions) == 2)  # on a line
