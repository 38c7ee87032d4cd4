from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo.graph import Instance, PoseGraph, RotationGraph
from certpgo.graph.bridges import bridges
from certpgo.graph.components import connected_parts
from certpgo.graph.kinds import Kind
from certpgo.graph.ranges import Ranges
from certpgo.io.datasets import synthetic
from certpgo.objective.quadratic import Quadratic
from certpgo.optimize.methods.eigen_ma import EigenMA
from certpgo.solve import metrics
from certpgo.solve.diagnostics import SYMMETRIC, spectra, structure, symmetry


def graph_of(n, edges):
    m = len(edges)
    return RotationGraph(n, np.array(edges), np.broadcast_to(np.eye(3), (m, 3, 3)), np.ones(m))


def bridges_by_removal(graph):
    """The definition: pairs whose loss adds a component."""
    pairs = np.unique(np.sort(graph.edges, axis=1), axis=0)
    found = []
    for pair in pairs:
        rest = [k for k, e in enumerate(graph.edges) if sorted(e) != list(pair)]
        alone = len(graph.edges) - len(rest) == 1
        left = graph_of(graph.num_nodes, graph.edges[rest]) if rest else None
        before = len(graph.component_sizes)
        after = graph.num_nodes if left is None else len(left.component_sizes)
        if alone and after > before:
            found.append(tuple(int(x) for x in pair))
    return found


@st.composite
def graphs(draw):
    n = draw(st.integers(2, 9))
    pair = st.tuples(st.integers(0, n - 1), st.integers(0, n - 1)).filter(lambda e: e[0] != e[1])
    return graph_of(n, draw(st.lists(pair, min_size=1, max_size=14)))


@given(graphs())
def test_bridges_are_the_edges_whose_loss_disconnects(graph):
    assert [tuple(pair) for pair in bridges(graph)] == bridges_by_removal(graph)


def test_every_edge_of_a_path_is_a_bridge_and_none_of_a_cycle():
    path = [(k, k + 1) for k in range(9)]
    assert bridges(graph_of(10, path)).tolist() == [list(edge) for edge in path]
    assert len(bridges(graph_of(10, [*path, (9, 0)]))) == 0


def test_two_measurements_of_one_pair_check_each_other():
    assert len(bridges(graph_of(2, [(0, 1), (1, 0)]))) == 0


def test_structure_counts_what_is_there():
    graph = graph_of(6, [(0, 1), (1, 0), (1, 2), (3, 4)])
    found = structure(Instance("x", graph, ids=np.array([2, 3, 5, 7, 11, 13])))
    assert (found.kind, found.d, found.nodes, found.edges) == ("rotations", 3, 6, 4)
    assert (found.first_id, found.last_id, found.consecutive) == (2, 13, False)
    assert found.component_sizes == (3, 2, 1)
    assert (found.parallel_edges, found.bridges) == (1, 2)
    assert found.tau is None


def test_distances_join_nodes_and_check_measurements():
    # A chain of four poses; distances from the first and the third to a point, none from the last.
    rotation = RotationGraph(5, [[0, 1], [1, 2], [2, 3]], [np.eye(2)] * 3, np.ones(3))
    points = np.arange(5) == 4
    graph = PoseGraph(rotation, np.tile([1.0, 0.0], (3, 1)), np.ones(3), points=points)
    ranges = Ranges(5, [[0, 4], [2, 4]], [2.0, 2.0], [1.0, 1.0])
    chain = Instance("chain", graph.with_ranges(ranges), np.arange(5))
    found = structure(chain)
    assert found.measurements == {"between": 3, "range": 2}
    assert (found.component_sizes, found.bridges) == ((5,), 1)
    assert bridges(chain.measurements).tolist() == [[2, 3]]
    assert structure(replace(chain, graph=chain.graph.with_ranges(None))).component_sizes == (4, 1)
    (one,) = connected_parts(chain, "refuse")
    assert one is chain
    apart = replace(chain, graph=chain.graph.with_edges([0, 2]))  # 0-1-4-2-3
    assert structure(apart).component_sizes == (5,)
    near = replace(apart, graph=apart.graph.with_ranges(Ranges(5, [[2, 4]], [2.0], [1.0])))
    assert [part.ids.tolist() for part in connected_parts(near, "each")] == [[2, 3, 4], [0, 1]]
    assert connected_parts(near, "largest")[0].graph.ranges.edges.tolist() == [[0, 2]]


def test_kinds_follow_from_weights_points_and_the_world():
    edges = [[0, 1], [0, 1], [0, 1], [0, 2], [3, 0], [3, 1], [3, 1], [3, 2]]
    kappa, tau = [1, 1, 0, 0, 1, 0, 1, 0], [1, 0, 1, 1, 1, 1, 0, 1]
    rotation = RotationGraph(4, edges, [np.eye(2)] * 8, np.array(kappa, dtype=float))
    points = np.arange(4) == 2
    graph = PoseGraph(rotation, np.ones((8, 2)), np.array(tau, dtype=float), points=points)
    kinds = [
        "BETWEEN",
        "ROTATION",
        "TRANSLATION",
        "SIGHTING",
        "PRIOR",
        "POSITION",
        "ATTITUDE",
        "POSITION",
        "RANGE",
    ]
    ranges = Ranges(4, [[1, 2]], [1.0], [1.0])
    whole = Instance("all", graph.with_ranges(ranges), np.arange(4), world=3)
    assert [Kind(kind).name for kind in whole.measurements.kinds] == kinds
    assert whole.kinds == (1, 1, 4)
    # The same from flags of a graph alone, but for distances, which it has not.
    flagged = replace(graph, absolute=np.array(edges)[:, 0] == 3)
    assert [Kind(kind).name for kind in flagged.kinds] == kinds[:-1]
    assert rotation.kinds[0] == Kind.ROTATION
    assert not rotation.is_point.any()


@pytest.mark.parametrize("n", [3, 6])
def test_spectrum_of_the_complete_graph_in_closed_form(n):
    instance = synthetic.complete(n, 0.0, np.random.default_rng(0))
    unit = spectra(instance.graph)["unit"]
    np.testing.assert_allclose(unit.smallest, 0.0, atol=1e-9, rtol=0)
    assert unit.fiedler == pytest.approx(n, rel=1e-9)
    closed = 2 * np.arcsin(np.sqrt(0.25 + n / (2 * (n - 1))) - 0.5)
    assert unit.alpha_max == pytest.approx(closed, rel=1e-9)
    assert unit.normalized_alpha_max == pytest.approx(closed, rel=1e-9)


def test_inconsistency_of_half_turns_about_a_plane_cycle_in_closed_form():
    # theta = pi is as inconsistent as a cycle gets: 1 - cos(pi/n) over 1 - cos(2 pi/n).
    instance, _ = synthetic.winding_cycle(6, np.pi, 0, 2)
    for spectrum in spectra(instance.graph).values():
        expected = (1 - np.cos(np.pi / 6)) / (1 - np.cos(np.pi / 3))
        assert spectrum.inconsistency == pytest.approx(expected, rel=1e-9)


def test_edges_of_exact_measurements_are_symmetric():
    # t_i - t_ij = R_ji t_j in the thesis' frame, so that S_ij = t_j t_j^T
    rng = np.random.default_rng(0)
    found = symmetry(synthetic.helix(4, rng, rotation_noise=1e-9, translation_noise=1e-9))
    assert found.least == pytest.approx(1.0, abs=1e-6)
    assert (found.mean, found.share) == (pytest.approx(1.0, abs=1e-6), 1.0)


def test_the_least_symmetric_edge_is_named_by_its_nodes_ids():
    instance = synthetic.helix(4, np.random.default_rng(0))
    estimate = EigenMA().solve(Quadratic(instance.graph)).estimate
    each = metrics.symmetry(instance.graph, estimate)
    found = symmetry(instance)
    assert found.mean == pytest.approx(each.mean())
    assert found.least == each.min()
    assert found.edge == tuple(instance.ids[instance.graph.edges[each.argmin()]])
    assert found.share == np.mean(each >= SYMMETRIC)


def test_rotations_alone_have_no_symmetry():
    assert symmetry(synthetic.winding_cycle(5, 0.3, 0)[0]) is None
