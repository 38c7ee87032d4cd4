"""A session: the batch's optimum and verdict, and bounds that hold at every moment between."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

import certpgo
from certpgo import Instance, Session, Verdict
from certpgo.errors import GraphError, InputError, SpecError
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.objective.choose_cost import objective_of
from certpgo.solve import terms


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
    monkeypatch.setattr(terms, "Quadratic", None)
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
        assert standing.cost >= certpgo.Quadratic(prefix).cost(session.estimate) * (1 - 1e-12)
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
        session.add(one.rotations_alone, nodes)
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


def stated(rng):
    """A helix whose edges have full information matrices."""
    graph = helix(3, rng, rotation_noise=0.1, translation_noise=0.1).graph
    A = rng.standard_normal((graph.num_edges, 6, 6))
    matrices = np.diag([30.0, 40, 50, 80, 90, 100]) + A @ np.swapaxes(A, 1, 2)
    matrices = 0.5 * (matrices + np.swapaxes(matrices, 1, 2))
    graph = graph.with_information(Information.of(matrices, "g2o"))
    return Instance("helix", graph, np.arange(graph.num_nodes))


def with_fixes(rng):
    """A helix with measured positions of some poses, from the world."""
    made = helix(3, rng)
    nodes = np.arange(0, made.graph.num_nodes, 3)
    fixes = made.truth.translations[nodes] + 0.1 * rng.standard_normal((len(nodes), 3))
    graph = certpgo.with_priors(made.graph, nodes, translations=fixes, tau=100.0)
    world = graph.num_nodes - 1
    return Instance("fixes", graph, np.arange(graph.num_nodes), world=world)


def with_points(rng):
    """A chain of poses in the plane, two of which close a loop, that see points."""
    n, k = 12, 5
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    seen = np.array([(i, n + (i + j) % k) for i in range(n) for j in range(2)])
    edges = np.concatenate([chain, [[0, n - 1]], seen])
    places = np.concatenate([np.c_[np.arange(n), np.zeros(n)], rng.uniform(0, n, (k, 2))])
    t = np.diff(places[edges], axis=1)[:, 0] + 0.05 * rng.standard_normal((len(edges), 2))
    kappa = np.where(edges[:, 1] < n, 100.0, 0.0)
    rotation = RotationGraph(n + k, edges, np.tile(np.eye(2), (len(edges), 1, 1)), kappa)
    points = np.arange(n + k) >= n
    graph = PoseGraph(rotation, t, np.full(len(edges), 50.0), None, points)
    return Instance("points", graph, 3 * np.arange(n + k))


@pytest.mark.parametrize(
    ("made", "cost"),
    [
        (stated, "chordal"),
        (stated, "g2o"),
        (stated, "gtsam"),
        (with_fixes, "chordal"),
        (with_points, "chordal"),
    ],
)
def test_bounds_hold_whatever_comes_and_goes(made, cost):
    rng = np.random.default_rng(5)
    instance = made(rng)
    session, parts = Session(every=None, cost=cost), {}
    for number, (one, names) in enumerate(streamed(instance)):
        session.add(one, names)
        parts[number] = one
        chance = rng.random()
        if chance < 0.15:
            session.refresh()
        elif chance < 0.4:
            with contextlib.suppress(GraphError, InputError):
                session.remove(rng.choice(session.edges, 1 + rng.integers(2)))
        if number % 4 and number + 1 < instance.graph.num_edges:
            continue
        places = np.array([instance.labels.index(label) for label in session.nodes])
        order = certpgo.graph.streaming.arrivals(instance)[session.edges]
        now = instance.with_edges(order)
        part = Instance("part", now.graph.subgraph(places), instance.ids[places])
        try:
            problem = objective_of(part, cost)
        except GraphError:  # a single fix determines no rotation of the world
            continue
        best = certpgo.solve(part, cost=cost).certificate
        standing = session.standing
        assert standing.objective == best.objective
        assert standing.lower_bound <= best.cost_upper
        assert standing.cost >= problem.cost(session.estimate) * (1 - 1e-12)
        if standing.stated != "EXACT FIT":
            assert standing.tolerance == pytest.approx(
                1e-5 * standing.cost + min(1e-12 * best.scale, 1e-3 * standing.cost)
            )
        if standing.verdict is Verdict.CERTIFIED:
            assert standing.cost <= best.cost_upper + standing.tolerance
    last = session.refresh()
    assert last.cost == pytest.approx(certpgo.solve(part, cost=cost).cost, rel=1e-9)
    assert last.verdict is session.certificate.verdict


def test_another_programs_cost_needs_relative_poses():
    instance = with_points(np.random.default_rng(0))
    seen = instance.graph.kappa == 0.0
    matrices = np.stack([100.0 * np.eye(3), np.diag([50.0, 50.0, 0.0])])
    information = Information(matrices, seen.astype(int), "g2o")
    instance = replace(instance, graph=instance.graph.with_information(information))
    session = Session(every=None, cost="g2o")
    session.add(instance)
    before = session.refresh()
    with pytest.raises(GraphError, match="cost='g2o' needs relative poses, not positions alone"):
        session.remove(np.flatnonzero(~seen))
    assert session.standing == before
    assert before.verdict is Verdict.CERTIFIED


def test_a_file_is_followed_under_the_cost_of_its_program(dataset):
    instance = dataset("MIT")
    session = Session(every=300)
    for one in streamed(instance, 20):
        session.add(*one)
    best = certpgo.solve(instance)
    assert session.refresh().objective == best.certificate.objective
    assert session.standing.cost == pytest.approx(best.cost, rel=1e-9)
    assert session.certificate.verdict is Verdict.CERTIFIED


def test_a_position_that_comes_first_does_not_change_the_cost(tmp_path):
    weight = "4 0 0 0 0 0 4 0 0 0 0 9 0 0 0 8 1 0 8 0 8"
    lines = [
        f"EDGE_SE3:QUAT {i} {j} 1 0.2 0 0 0 {q} 1 {weight}"
        for i, j, q in ((0, 1, 0.5), (1, 2, 0.6), (0, 2, 1.0), (2, 0, -1.5))
    ]
    lines += [f"EDGE_SE3_XYZPRIOR {k} 0 {k} {k * k} 0 1 0 0 2 0 3" for k in range(3)]
    path = tmp_path / "first.g2o"
    path.write_text("\n".join(["PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1", *lines]) + "\n")
    whole = certpgo.read(path, quiet=True)
    session = Session()
    for part, names in streamed(whole):  # the first is where node 0 is
        session.add(part, names)
    certificate, expected = session.certificate, certpgo.solve(whole).certificate
    assert (
        certificate.objective
        == expected.objective
        != certpgo.solve(whole, cost="chordal").certificate.objective
    )
    assert session.standing.cost == pytest.approx(expected.cost_upper, rel=1e-6)


def test_measurements_without_what_the_cost_needs_are_refused(graph):
    session, instance = Session(), stated(np.random.default_rng(0))
    session.add(instance)
    with pytest.raises(InputError, match="needs information: graph"):
        session.add(graph)
    bad = graph.with_edges([0]).subgraph([0, 1]).with_information(-np.eye(6)[None])
    one = Instance("bad", bad, [0, 1])
    with pytest.raises(InputError, match="matrix of 0-1 is not positive definite"):
        session.add(one)
    assert session.standing.edges == instance.graph.num_edges
    with pytest.raises(SpecError, match="nothing"):
        Session(cost="nothing")
