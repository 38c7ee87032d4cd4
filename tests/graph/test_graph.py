"""Graphs and estimates: validation, components, parallel edges, frames."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, rotation_graph, seeds

import certpgo
from certpgo.errors import GraphError
from certpgo.graph import Estimate, Instance, PoseGraph, RotationGraph
from certpgo.graph.components import rotations_alone
from certpgo.graph.graph import require_connected
from certpgo.graph.information import Information
from certpgo.graph.ranges import Ranges
from certpgo.linalg import rotations as so

EDGES = np.array([[0, 1], [1, 2], [2, 0]])
EYES = np.tile(np.eye(3), (3, 1, 1))


def test_arrays_are_read_only_and_the_caller_keeps_his():
    kappa = np.ones(3)
    graph = RotationGraph(3, EDGES, EYES, kappa)
    with pytest.raises(ValueError, match="read-only"):
        graph.kappa[0] = 2.0
    kappa[0] = 5.0
    assert graph.kappa[0] == 1.0
    assert (graph.d, graph.num_edges) == (3, 3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_nodes": 0}, "at least one node"),
        (
            {"edges": np.array([[0, 3], [1, 2], [2, 0]])},
            r"edge \(0, 3\): nodes are numbered 0 to 2",
        ),
        ({"edges": np.array([[0, 1], [1, 1], [2, 0]])}, r"edge \(1, 1\): .* from itself"),
        ({"edges": np.zeros((0, 2)), "rotations": np.zeros((0, 3, 3)), "kappa": []}, "non-empty"),
        ({"rotations": np.zeros((3, 4, 4))}, "d = 2 or 3"),
        ({"rotations": -EYES}, r"edge \(0, 1\): not a rotation, its determinant is -1$"),
        ({"rotations": 1e200 * EYES}, r"edge \(0, 1\): not a rotation, its entries are too large"),
        ({"rotations": 1.1 * EYES}, r"edge \(0, 1\): not a rotation, off by 2.1e-01"),
        ({"rotations": -EYES}, r"not a rotation"),
        (
            {"kappa": np.array([1.0, -1.0, 1.0])},
            r"edge \(1, 2\): kappa is -1.0; it must be positive",
        ),
        ({"kappa": np.array([1.0, np.nan, 1.0])}, "kappa is nan"),
        ({"kappa": np.ones(2)}, "kappa must have 3 entries"),
    ],
)
def test_rotation_graph_refuses(change, message):
    good = {"num_nodes": 3, "edges": EDGES, "rotations": EYES, "kappa": np.ones(3)}
    with pytest.raises(GraphError, match=message):
        RotationGraph(**(good | change))


@pytest.mark.parametrize(
    ("translations", "tau", "message"),
    [
        (np.zeros((3, 2)), np.ones(3), r"translations must be \(3, 3\)"),
        (np.full((3, 3), np.inf), np.ones(3), r"edge \(0, 1\): translation is not finite"),
        (np.zeros((3, 3)), np.full(3, -1.0), "tau is -1.0"),
    ],
)
def test_pose_graph_refuses(translations, tau, message):
    with pytest.raises(GraphError, match=message):
        PoseGraph(RotationGraph(3, EDGES, EYES, np.ones(3)), translations, tau)


def test_few_digits_are_cleaned_and_exact_ones_left_alone():
    R = so.random(np.random.default_rng(0), 3, 3)
    rounded = np.round(R, 8)
    graph = RotationGraph(3, EDGES, rounded, np.ones(3))
    assert so.worst_defect(graph.rotations)[1] < 1e-14
    np.testing.assert_allclose(graph.rotations, R, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(RotationGraph(3, EDGES, R, np.ones(3)).rotations, R)
    np.testing.assert_array_equal(Estimate(R).rotations, R)
    assert so.worst_defect(Estimate(rounded).rotations)[1] < 1e-14


def test_components_and_the_refusal_that_names_them():
    edges = np.array([[0, 1], [2, 3], [3, 4]])
    graph = RotationGraph(6, edges, EYES, np.ones(3))
    np.testing.assert_array_equal(graph.components, [0, 0, 1, 1, 1, 2])
    assert graph.component_sizes == (2, 3, 1)
    with pytest.raises(GraphError, match="3 components of 3, 2, 1 nodes") as refusal:
        require_connected(graph)
    assert refusal.value.component_sizes == (3, 2, 1)
    part = graph.subgraph(np.flatnonzero(graph.components == 1))
    np.testing.assert_array_equal(part.edges, [[0, 1], [1, 2]])
    require_connected(part)


@pytest.mark.parametrize(
    ("keep", "kappa"), [("all", [1, 2, 3, 4]), ("first", [1, 3]), ("last", [2, 4])]
)
def test_parallel_edges(keep, kappa):
    edges = np.array([[0, 1], [1, 0], [1, 2], [1, 2]])
    rotation = RotationGraph(3, edges, np.tile(np.eye(2), (4, 1, 1)), np.arange(1.0, 5.0))
    graph = PoseGraph(rotation, np.arange(8.0).reshape(4, 2), np.arange(1.0, 5.0))
    np.testing.assert_array_equal(graph.without_parallel_edges(keep).tau, kappa)
    np.testing.assert_array_equal(rotation.without_parallel_edges(keep).kappa, kappa)
    with pytest.raises(GraphError, match="keep must be"):
        graph.without_parallel_edges("some")


def test_weights_are_replaced_together_or_apart():
    graph, _, _ = pose_graph(np.random.default_rng(0), 5, 3)
    both = graph.with_weights(2.0, 3.0)
    assert set(both.kappa) == {2.0}
    assert set(both.tau) == {3.0}
    np.testing.assert_array_equal(graph.with_weights(tau=1.0).kappa, graph.kappa)
    assert set(graph.rotations_alone.with_weights(7.0).kappa) == {7.0}


@given(seeds, dimensions)
def test_subgraph_keeps_the_measurements(seed, d):
    graph, _, _ = pose_graph(rng_of(seed), 8, d)
    nodes = np.array([5, 1, 7, 2])
    part = graph.subgraph(nodes)
    assert part.num_nodes == 4
    inside = np.isin(graph.edges, nodes).all(axis=1)
    np.testing.assert_array_equal(nodes[part.edges], graph.edges[inside])
    np.testing.assert_array_equal(part.translations, graph.translations[inside])


@pytest.mark.parametrize(
    ("R", "t", "message"),
    [
        (np.zeros((2, 3)), None, r"\(n, d, d\)"),
        (np.stack([np.eye(3), 2 * np.eye(3)]), None, "node 1: not a rotation"),
        (np.stack([np.eye(3)] * 2), np.zeros((2, 2)), r"translations must be \(2, 3\)"),
        (np.stack([np.eye(3)] * 2), np.array([[0, 0, 0], [0, np.nan, 0]]), "node 1: translation"),
    ],
)
def test_estimate_refuses(R, t, message):
    with pytest.raises(GraphError, match=message):
        Estimate(R, t)


@given(seeds, dimensions)
def test_moving_and_anchoring(seed, d):
    rng = rng_of(seed)
    estimate = Estimate(so.random(rng, 5, d), rng.standard_normal((5, d)))
    anchored = estimate.anchored(3)
    np.testing.assert_allclose(anchored.rotations[3], np.eye(d), rtol=0, atol=1e-14)
    np.testing.assert_allclose(anchored.translations[3], 0.0, rtol=0, atol=1e-14)
    back = anchored.anchored(3, estimate)
    np.testing.assert_allclose(back.rotations, estimate.rotations, rtol=0, atol=1e-13)
    np.testing.assert_allclose(back.translations, estimate.translations, rtol=0, atol=1e-13)
    bare = Estimate(estimate.rotations)
    np.testing.assert_allclose(bare.anchored(3).rotations, anchored.rotations, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(
        estimate.subset(np.array([4, 0])).translations[0], estimate.translations[4]
    )
    assert bare.subset(np.array([1])).translations is None


def test_instance_checks_what_belongs_together():
    graph, _ = rotation_graph(np.random.default_rng(0), 4, 3)
    good = Instance("x", graph, np.array([10, 20, 30, 7]), options={"keep": "all"})
    with pytest.raises(TypeError):
        good.options["keep"] = "last"
    with pytest.raises(GraphError, match="4 distinct"):
        Instance("x", graph, np.array([1, 1, 2, 3]))
    with pytest.raises(GraphError, match="truth is for another graph"):
        Instance("x", graph, np.arange(4), truth=Estimate(EYES))


@pytest.mark.parametrize(
    ("edges", "shown"),
    [
        ([[0, 1], [1, 0.5]], "0.5"),
        ([[0, 1], [1, np.nan]], "nan"),
        ([["0", "1"], ["1", "2"]], "'0'"),
        ([[0, 1], [1, 2**64]], "18446744073709551616"),
        (np.array([[0, 1], [1, 2**63]], dtype=np.uint64), "9223372036854775808"),
    ],
)
def test_nodes_are_whole_numbers(edges, shown):
    with pytest.raises(GraphError, match=f"whole numbers of 64 bits expected, not {shown}"):
        RotationGraph(3, edges, np.array([np.eye(3)] * 2), np.ones(2))


def test_whole_numbers_of_any_type_are_nodes():
    edges = np.array([[0, 1], [1, 2]])
    for kind in (float, np.uint64, np.int32, object):
        graph = RotationGraph(3, edges.astype(kind), np.array([np.eye(3)] * 2), np.ones(2))
        assert graph.edges.tolist() == edges.tolist()
    with pytest.raises(GraphError, match=r"not 1\.5"):
        Instance("a", graph, np.array([0, 1.5, 2]))


@pytest.fixture
def ranged():
    """A square of poses with information about quaternions, flags, and three distances."""
    rng = np.random.default_rng(3)
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [0, 2]])
    graph = PoseGraph(
        RotationGraph(4, edges, so.random(rng, 5, 3), rng.uniform(1, 2, 5)),
        rng.normal(size=(5, 3)),
        rng.uniform(1, 2, 5),
        absolute=np.arange(5) == 3,
        blocks=(Ranges(4, [[0, 2], [3, 1], [2, 3]], np.array([1.0, 2.0, 3.0]), np.ones(3)),),
    )
    matrices = rng.normal(size=(5, 6, 6))
    matrices = matrices @ np.swapaxes(matrices, 1, 2)
    matrices = 0.5 * (matrices + np.swapaxes(matrices, 1, 2))
    return graph.with_information(Information.of(matrices, "g2o", "quaternion"))


@pytest.mark.parametrize(
    "nodes", [[3, 2, 0], [-1, 2, -4], np.array([True, False, True, True]), [2, 0, 3]]
)
def test_parts_have_the_distances_and_information_of_their_nodes_in_any_order(ranged, nodes):
    part, number = ranged.subgraph(nodes), np.arange(4)[nodes].tolist()
    kept = [2, 3, 4]  # those without node 1
    assert np.array(number)[part.edges].tolist() == ranged.edges[kept].tolist()
    assert (part.information_matrices == ranged.information_matrices[kept]).all()
    assert (part.information.residual, part.information.about) == ("g2o", "quaternion")
    assert np.array(number)[part.ranges.edges].tolist() == [[0, 2], [2, 3]]
    assert part.ranges.distances.tolist() == [1.0, 3.0]
    assert part.absolute.tolist() == [False, True, False]


def test_matrix_weights_leave_distances_and_flags(ranged):
    general = ranged.with_matrix_weights(np.tile(np.eye(4), (5, 1, 1)))
    assert general.information is None
    assert general.ranges is ranged.ranges
    assert general.absolute.tolist() == ranged.absolute.tolist()
    found = certpgo.solve(general).certificate
    assert 0.0 <= found.lower_bound <= found.cost_upper


def test_rotations_alone_leave_the_numbers_of_distances(ranged):
    instance = Instance("ranged", ranged, np.arange(4)).with_edges([0, 1, 2, 4])
    alone = rotations_alone(instance)
    assert alone.known_numbers.tolist() == [0, 1, 2, 4]
    assert alone.pairs.tolist() == ranged.edges[[0, 1, 2, 4]].tolist()
