"""A session: the batch's optimum and verdict, and bounds that hold at every moment between."""

import numpy as np
import pytest

import certpgo
from certpgo import PoseGraph, RotationGraph, Session, Verdict
from certpgo.datasets.synthetic import helix, winding_cycle
from certpgo.errors import GraphError, InputError


@pytest.fixture(scope="module")
def graph():
    return helix(4, np.random.default_rng(0)).graph


def stream(graph):
    """Edges by larger node, each as a graph of its own with the names of its two nodes."""
    order = np.argsort(graph.edges.max(axis=1), kind="stable")
    for edge in order.tolist():
        nodes = np.sort(graph.edges[edge])
        yield graph.with_edges([edge]).subgraph(nodes), nodes.tolist()


def same(session, graph):
    """Whether a session is at the batch's optimum of its measurements."""
    batch, standing = certpgo.solve(graph), session.standing
    W = batch.certificate.scale
    assert standing.cost == pytest.approx(batch.cost, rel=1e-9, abs=1e-12 * W)
    assert standing.verdict is batch.verdict is session.certificate.verdict
    return batch


def test_a_cycle_that_closes_has_its_closed_form():
    session = Session()
    for one in stream(winding_cycle(6, 0.3, 0)[0].graph):
        session.add(*one)
    assert session.refresh().verdict is Verdict.CERTIFIED
    assert session.standing.cost == pytest.approx(8 * 6 * np.sin(0.3 / 12) ** 2, rel=1e-9)


def test_an_open_chain_is_optimal_without_a_factorization(monkeypatch, graph):
    monkeypatch.setattr("certpgo.solvers.certified.terms.problem_of", None)
    session = Session(every=1)
    for one, nodes in stream(graph):
        if nodes[1] == nodes[0] + 1 and len(session.nodes) <= nodes[1]:
            session.add(one, nodes)
            assert session.standing.verdict is Verdict.CERTIFIED


def test_streaming_is_the_batch_and_bounds_between_hold(graph):
    session = Session(every=25)
    edges = []
    for count, (one, nodes) in enumerate(stream(graph), 1):
        before = session.lower_bound
        session.add(one, nodes)
        standing = session.standing
        edges.append((one, nodes))
        assert standing.lower_bound >= before
        assert standing.gap >= standing.cost - standing.lower_bound
        prefix = session.graph
        assert standing.cost >= certpgo.PoseProblem(prefix).cost(session.estimate) * (1 - 1e-12)
        if count % 25 == 0:
            same(session, prefix)
        elif count % 10 == 0:
            best = certpgo.solve(prefix).certificate
            assert standing.lower_bound <= best.cost_upper
            assert standing.cost >= best.lower_bound
    session.refresh()
    same(session, graph)


def test_the_order_of_edges_between_known_nodes_is_irrelevant(graph):
    session = Session(every=None)
    parts = list(stream(graph))
    chain = [p for p in parts if p[1][1] == p[1][0] + 1]
    others = [p for p in parts if p[1][1] != p[1][0] + 1]
    for one in [*chain, *reversed(others)]:
        session.add(*one)
    session.refresh()
    same(session, graph)


def test_removing_restores_and_never_keeps_a_bound_of_what_was_removed(graph):
    session = Session()
    session.add(graph)
    session.refresh()
    before = session.standing
    wrong = RotationGraph(2, [[0, 1]], [np.diag([1.0, -1.0, -1.0])], [1e3])
    bad = PoseGraph(wrong, [[5.0, 5.0, 5.0]], [1e3])
    session.add(bad, [0, graph.num_nodes - 1])
    assert session.standing.cost > 2.0 * before.cost
    assert session.standing.lower_bound == before.lower_bound
    assert session.refresh().lower_bound > 2.0 * before.cost
    back = session.remove([graph.num_edges])
    # The bound from before the edge came holds again, that with the edge does not.
    assert back.lower_bound == before.lower_bound
    assert session.refresh().cost == pytest.approx(before.cost, rel=1e-9)
    same(session, graph)
    assert session.remove([0]).lower_bound == 0.0
    assert 0 not in session.edges
    session.refresh()
    same(session, session.graph)


def test_names_stand_for_nodes(graph):
    session = Session()
    names = [f"x{k}" for k in range(graph.num_nodes)]
    session.add(graph, names)
    assert set(session.nodes) == set(names)
    assert session.certificate.verdict is Verdict.CERTIFIED


def test_what_cannot_be_added_or_removed_is_refused_and_changes_nothing(graph):
    session = Session()
    with pytest.raises(InputError, match="no measurements yet"):
        _ = session.estimate
    one, nodes = next(stream(graph))
    session.add(one, nodes)
    standing = session.standing
    with pytest.raises(GraphError, match="node 8 is not connected with those before it"):
        session.add(one, [8, 9])
    with pytest.raises(GraphError, match="poses in 3D and rotations in 3D"):
        session.add(one.rotation, nodes)
    with pytest.raises(InputError, match="2 different names are expected"):
        session.add(one, [1])
    with pytest.raises(InputError, match="takes graphs and instances, not an int"):
        session.add(3)
    with pytest.raises(InputError, match="there is no measurement 7"):
        session.remove([7])
    with pytest.raises(InputError, match="at least one measurement"):
        session.remove([0])
    with pytest.raises(InputError, match="not every 0"):
        Session(every=0)
    assert session.standing == standing
    session.add(graph.with_edges([1]).subgraph(graph.edges[1]), graph.edges[1].tolist())
    with pytest.raises(GraphError):
        session.remove([1])
    assert session.standing.edges == 2


def test_the_screen_never_certifies(graph):
    session = Session(tier="screen")
    session.add(graph)
    assert session.refresh().verdict is not Verdict.CERTIFIED
