import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from certpgo.assess.diagnostics import spectra, structure
from certpgo.graph import Instance, RotationGraph
from certpgo.graph.bridges import bridges
from certpgo.io.datasets import synthetic


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
