"""Joint graphs keep which scales are unknown, and what is measured of them."""

import numpy as np
import pytest

import certpgo
from certpgo import GraphError, Quadratic
from certpgo.graph.concatenate import joined
from certpgo.io.datasets.monocular import in_one_unit, random_maps


@pytest.mark.parametrize("known", [(), (3,)])
def test_parts_of_a_map_are_joined_to_the_map(known):
    graph, truth = random_maps(np.random.default_rng(0), 3, known=known, points=1)
    m = graph.num_edges
    order = np.random.default_rng(1).permutation(m)
    parts = [graph.with_edges(order[: m // 2]), graph.with_edges(order[m // 2 :])]
    whole = joined(parts, graph.num_nodes, graph.is_point)
    assert np.array_equal(whole.nodes, graph.nodes)
    assert np.array_equal(whole.scales, graph.scales[order])
    assert Quadratic(whole).cost(truth) == pytest.approx(Quadratic(graph).cost(truth), rel=1e-12)


def test_nodes_are_renumbered_with_their_kinds():
    graph, _ = random_maps(np.random.default_rng(0), 2, points=2)
    to = np.random.default_rng(1).permutation(graph.num_nodes)
    whole = joined([graph], graph.num_nodes, graph.is_point[np.argsort(to)], [to])
    assert np.array_equal(whole.nodes[to], graph.nodes)


def test_what_a_part_does_not_measure_says_nothing_of_its_nodes():
    """Other measurements number the same nodes, and need not know their kinds."""
    graph, _ = random_maps(np.random.default_rng(0), 3, known=(1, 2))
    among_known = in_one_unit(graph).with_edges([0, 1])
    whole = joined([graph, among_known], graph.num_nodes)
    assert np.array_equal(whole.nodes, graph.nodes)


def test_a_scale_is_unknown_to_all_or_known_to_all():
    graph, _ = random_maps(np.random.default_rng(0), 3)
    for parts in ([graph, in_one_unit(graph)], [in_one_unit(graph), graph]):
        with pytest.raises(GraphError, match="node 1: its scale is unknown to some"):
            joined(parts, graph.num_nodes)


def test_a_joint_graph_in_its_mean_unit_stays_in_it():
    graph, _ = random_maps(np.random.default_rng(2), 3)
    graph = graph.with_unknown_scales(~graph.is_point)
    halves = [graph.with_edges(np.arange(7)), graph.with_edges(np.arange(7, graph.num_edges))]
    whole = joined(halves, graph.num_nodes)
    assert whole.in_mean_unit
    assert certpgo.solve(whole).cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)
