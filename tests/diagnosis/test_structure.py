"""The graph: parts, copies, contradictions, bridges, held nodes, and the ids of an estimate."""

import numpy as np
import pytest
from strategies import pose_graph, rng_of

import certpgo
from certpgo import Estimate, PoseGraph, RotationGraph
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.structure import _hanging, remarks
from certpgo.graph.concatenate import joined
from certpgo.graph.keys import Keys
from certpgo.io.datasets.synthetic import helix
from certpgo.linalg import rotations as so

N = 20


def walk(d, seed=0, noise=0.03):
    """An instance that states its noise, and its truth."""
    graph, truth = pose_graph(rng_of(seed), N, d, extra=N, noise=noise)[:2]
    return graph, truth


def found_in(*given, **options):
    return {one.kind: one for one in certpgo.diagnose(*given, **options).findings}


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_of_clean_graphs(d):
    for seed in range(10):
        graph, _ = walk(d, seed)
        assert not found_in(graph), seed


@pytest.mark.parametrize("d", [2, 3])
def test_copies(d):
    graph, _ = walk(d)
    m = graph.num_edges
    twice = graph.with_edges(np.r_[np.arange(m), 3, 3, 7])
    found = found_in(twice)["duplicated-edges"]
    assert found.edges == (m, m + 1, m + 2)
    assert "1.73 times" in found.said
    assert found_in(graph.with_edges(np.r_[np.arange(m), np.arange(m)]))["duplicated-edges"]


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("d", [2, 3])
def test_parallel_measurements_that_exclude_each_other(d, backward):
    made = helix(4, rng_of(1)) if d == 3 else None
    graph = made.graph if d == 3 else walk(2, 1)[0]
    m = graph.num_edges
    R, t = graph.rotations[5], graph.translations[5] + 2.0
    R = R @ so.exp(np.full((1, 1 if d == 2 else 3), 0.4))[0]
    pair = graph.edges[5]
    if backward:
        pair, R, t = pair[::-1], R.T, -R.T @ t
    kappa, tau = graph.kappa[5:6], graph.tau[5:6]
    n = graph.num_nodes
    wrong = PoseGraph(RotationGraph(n, pair[None], R[None], kappa), t[None], tau)
    found = found_in(joined([graph, wrong], n))["contradictory-edges"]
    assert found.edges == (5, m)
    assert found.proven


def test_parallel_measurements_that_agree():
    made = helix(4, rng_of(1))
    again = helix(4, rng_of(2)).graph
    R, t = made.truth.rotations, made.truth.translations
    i, j = again.edges.T
    rng = rng_of(3)
    Q = np.swapaxes(R[i], 1, 2) @ R[j] @ so.exp(0.02 * rng.standard_normal((len(i), 3)))
    s = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + 0.02 * rng.standard_normal((len(i), 3))
    other = PoseGraph(RotationGraph(len(R), again.edges, Q, again.kappa), s, again.tau)
    assert not found_in(joined([made.graph, other], len(R)))


def test_parts_are_examined_each():
    graph, _ = walk(3)
    shifted = PoseGraph(
        RotationGraph(2 * N + 1, graph.edges + N, graph.rotations, graph.kappa),
        graph.translations,
        graph.tau,
    )
    alone = joined([graph.with_edges(np.arange(graph.num_edges)), shifted], 2 * N + 1)
    diagnosis = certpgo.diagnose(alone)
    assert [one.kind for one in diagnosis.findings] == ["components", "unmeasured-nodes"]
    assert "20, 20" in diagnosis.findings[0].said
    m = graph.num_edges
    copied = alone.with_edges(np.r_[np.arange(2 * m), m + 2])
    found = found_in(copied)["duplicated-edges"]
    assert found.edges == (2 * m,)
    assert found.said.startswith("graph [20 nodes from id 20]")


def test_the_estimate_of_parts():
    graph, _ = walk(3)
    best = certpgo.solve(graph).estimate
    shifted = PoseGraph(
        RotationGraph(2 * N, graph.edges + N, graph.rotations, graph.kappa),
        graph.translations,
        graph.tau,
    )
    R, t = np.concatenate([best.rotations] * 2), np.concatenate([best.translations] * 2)
    both = joined([graph, shifted], 2 * N)
    assert list(found_in(both, Estimate(R, t))) == ["components"]
    t[N:] *= 1e3
    found = certpgo.diagnose(both, Estimate(R, t)).findings
    assert "millimetres" in [one.kind for one in found]


def test_a_bridge_is_remarked_where_something_is_wrong():
    graph, _ = walk(2)
    m = graph.num_edges
    other = PoseGraph(
        RotationGraph(2 * N, graph.edges + N, graph.rotations, graph.kappa),
        graph.translations,
        graph.tau,
    )
    link = PoseGraph(
        RotationGraph(2 * N, [[4, N + 6]], np.eye(2)[None], [1.0]), [[1.0, 0.0]], [1.0]
    )
    whole = joined([graph, other, link], 2 * N)
    assert not found_in(whole)
    instance = certpgo.Instance("two", whole, np.arange(2 * N))
    pair, nodes = _hanging(instance.measurements)
    assert pair == (4, N + 6)
    np.testing.assert_array_equal(nodes, np.arange(N, 2 * N))
    found = found_in(whole.with_edges(np.r_[np.arange(2 * m + 1), 0]))
    assert found["bridge"].edges == (2 * m,)
    assert "all of 20 nodes (20 to 39) hang on what is measured between 4 and 26," in (
        found["bridge"].said
    )
    ends = certpgo.Instance("two", whole, 3 * np.arange(2 * N))
    [bridge] = remarks(Examined(ends))
    assert "20 nodes (60, 63, 66, 69, ...)" in bridge.said


def test_held_nodes_leave_nothing(tmp_path):
    path = tmp_path / "held.g2o"
    path.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nFIX 0\nFIX 1\nEDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n"
    )
    assert found_in(path)["all-held"]


@pytest.mark.parametrize("offset", [100, -1, 3])
def test_ids_with_an_offset(offset):
    graph, _ = walk(3)
    best = certpgo.solve(graph).estimate
    instance = certpgo.Instance("graph", graph, np.arange(N) + 7)
    other = best.keyed(Keys(np.arange(N) + 7 + offset))
    found = found_in(instance, other)["other-ids"]
    assert found.next == f"add {-offset} to its ids"
    assert not found_in(instance, best.keyed(Keys(np.arange(N) + 7)))


def test_ids_of_another_file():
    graph, _ = walk(3)
    instance = certpgo.Instance("graph", graph, np.arange(N))
    other = certpgo.solve(walk(3, 5)[0]).estimate
    far = other.keyed(Keys(1000 + 17 * np.arange(N)))
    assert "0 of its 20 poses" in found_in(instance, far)["other-ids"].said


def test_an_estimate_that_lacks_nodes_is_refused():
    graph, _ = walk(3)
    instance = certpgo.Instance("graph", graph, np.arange(N))
    part = certpgo.solve(graph).estimate.subset(np.arange(N - 2)).keyed(Keys(np.arange(N - 2)))
    with pytest.raises(certpgo.InputError, match="lacks node 18"):
        certpgo.diagnose(instance, part)
