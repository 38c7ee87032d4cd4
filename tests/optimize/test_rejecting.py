"""Wrong measurements in a stream: named, rejected, and taken back when the evidence returns."""

import numpy as np
import pytest

import certpgo
from certpgo import PoseGraph, RobustSession, Session, Verdict
from certpgo.graph import RotationGraph
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.synthetic import helix
from certpgo.io.datasets.thesis import langevin_graph
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from certpgo.solve import robust_session
from certpgo.solve.outliers import agrees
from certpgo.solve.session_outliers import suspicion
from certpgo.solve.settings import SolveSettings

#: Weight of the wrong loop's rotation.
KAPPA = 1e4


def steps(n=12, kappa=400.0):
    """A chain of exact steps in the plane, of ``n`` poses, 0.05 radians each stated as noise."""
    edges = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    rotation = RotationGraph(n, edges, np.tile(np.eye(2), (n - 1, 1, 1)), np.full(n - 1, kappa))
    return PoseGraph(rotation, np.tile([1.0, 0.0], (n - 1, 1)), np.full(n - 1, 100.0))


def closing(angle, shift, kappa=400.0):
    """A loop closure from the first to the last pose of the chain."""
    rotation = RotationGraph(2, [[0, 1]], so.exp(np.array([[angle]])), [kappa])
    return PoseGraph(rotation, [[11.0 + shift, 0.0]], [100.0])


@pytest.fixture(scope="module")
def wrong_loop():
    """A helix and the number of a wrong loop after all its edges."""
    graph = helix(4, np.random.default_rng(0)).graph
    assert graph.kappa.max() <= KAPPA
    wrong = RotationGraph(2, [[0, 1]], [np.diag([1.0, -1.0, -1.0])], [float(graph.kappa.max())])
    return graph, PoseGraph(wrong, [[5.0, 5.0, 5.0]], [float(graph.tau.max())]), graph.num_edges


def test_a_robust_fit_names_what_least_squares_spreads_below_the_stated_noise():
    """A wrong loop along an exact ladder whose weights state far too much noise."""
    n = 24
    edges = np.array([(k, k + s) for s in (1, 2) for k in range(n - s)] + [(0, n - 1)])
    R = np.tile(np.eye(2), (len(edges), 1, 1))
    R[-1] = so.exp(np.array([[2.2]]))[0]
    t = np.outer(np.diff(edges, axis=1)[:, 0], [1.0, 0.0])
    rotation = RotationGraph(n, edges, R, np.full(len(edges), 50.0))
    problem = Quadratic(PoseGraph(rotation, t, np.full(len(edges), 0.01)))
    estimate = certpgo.solve(problem.graph).estimate
    assert agrees(problem, estimate)
    numbers = np.arange(len(edges))
    for tier, named in (("standard", False), ("screen", True)):  # the latter never certifies
        found = suspicion(
            problem,
            estimate,
            certpgo.certify(problem, estimate, tier=tier),
            numbers,
            range(n),
            SolveSettings(),
        )
        assert (found is not None) is named
    assert found.edges.tolist() == [len(edges) - 1]
    assert found.without.verdict is Verdict.CERTIFIED


def test_a_wrong_loop_is_named_and_the_graph_without_it_is_offered(wrong_loop):
    graph, bad, number = wrong_loop
    session = Session()
    session.add(graph)
    session.refresh()
    assert session.suspicion() is None
    clean = session.certificate
    session.add(bad, [0, graph.num_nodes - 1])
    found = session.suspicion()
    assert found.edges.tolist() == [number]
    assert found.nodes == ((0, graph.num_nodes - 1),)
    assert found.without.verdict is Verdict.CERTIFIED
    assert found.without.cost == pytest.approx(clean.cost_upper, rel=1e-9)
    assert found.certificate.lower_bound > found.without.cost
    assert "1 of" in str(found)
    assert f"(0-{graph.num_nodes - 1})" in str(found)
    assert len(session.edges) == number + 1  # nothing was removed
    session.remove(found.edges)
    assert session.suspicion() is None


def test_a_wrong_loop_never_enters_where_the_rest_contradicts_it(wrong_loop):
    graph, bad, number = wrong_loop
    session = RobustSession(every=50)
    for one in streamed(graph):
        session.add(*one)
    session.add(bad, [0, graph.num_nodes - 1])
    standing = session.refresh()
    assert session.rejected.tolist() == [number]
    assert standing.verdict is Verdict.CERTIFIED
    assert standing.cost == pytest.approx(certpgo.solve(graph).cost, rel=1e-9)
    batch = certpgo.solve_robustly(session.graph)
    assert session.settle().cost == pytest.approx(batch.cost, rel=1e-9)


def test_what_was_accepted_too_early_goes():
    session = RobustSession(every=None)
    session.add(steps())
    session.add(closing(0.9, 1.0), [0, 11])  # alone, it is within the noise of eleven steps
    session.refresh()
    assert session.rejected.size == 0
    assert 11 in session.edges
    for _ in range(6):
        session.add(closing(0.0, 0.0), [0, 11])
    session.refresh()
    assert session.rejected.tolist() == [11]
    assert session.standing.cost == pytest.approx(0.0, abs=1e-9)
    assert session.settle().verdict is Verdict.CERTIFIED
    assert session.edges.tolist() == [k for k in range(18) if k != 11]


def test_what_is_put_aside_returns_without_a_new_fit(monkeypatch):
    session = RobustSession(every=None)
    session.add(steps())
    for _ in range(3):
        session.add(closing(0.0, 0.0), [0, 11])
    session.refresh()
    session._keep(set(range(13)))
    assert session.rejected.tolist() == [13]
    monkeypatch.setattr(robust_session, "select", None)
    session.refresh()
    assert session.rejected.size == 0
    assert session.edges.tolist() == list(range(14))


def test_an_answer_names_what_is_rejected_and_what_costs_most():
    made = helix(4, np.random.default_rng(0))
    ids = np.arange(made.graph.num_nodes) + 100
    named = certpgo.Instance("helix", made.graph, ids)
    plain = certpgo.solve(named)
    assert plain.rejected.tolist() == []
    terms = plain.problem.edge_costs(plain.estimate)
    costliest = plain.costliest
    assert [edge.cost for edge in costliest] == sorted(terms, reverse=True)[: len(costliest)]
    first = costliest[0]
    assert first.ids == tuple((made.graph.edges[first.edge] + 100).tolist())
    wrong = np.array(made.graph.rotations)
    wrong[-1] = wrong[-1] @ np.diag([1.0, -1.0, -1.0])
    rotation = RotationGraph(made.graph.num_nodes, made.graph.edges, wrong, made.graph.kappa)
    robust = certpgo.solve_robustly(PoseGraph(rotation, made.graph.translations, made.graph.tau))
    assert robust.rejected.tolist() == [made.graph.num_edges - 1]
    assert robust.rejected[0] not in {edge.edge for edge in robust.costliest}


def test_what_a_session_says_of_rejections_names_measurements_by_their_numbers(wrong_loop):
    graph, bad, number = wrong_loop
    session = RobustSession(every=None)
    session.add(graph)
    session.add(bad, [0, graph.num_nodes - 1])
    session.settle()
    loop = int(np.flatnonzero(np.abs(np.diff(graph.edges, axis=1)[:, 0]) > 1)[0])
    session.remove([loop])
    assert session.rejection().edges.tolist() == session.rejected.tolist() == [number]


def test_an_answer_names_its_measurements_by_their_numbers_whatever_was_left_out(wrong_loop):
    """What a robust fit rejects, and what an instance lacks."""
    instance = langevin_graph(40, 12.0, 3.0, np.random.default_rng(0), outliers=0.15)
    graph, _, number = wrong_loop
    whole = certpgo.Instance("all", graph, np.arange(graph.num_nodes))
    for answer, edges in (
        (certpgo.solve_robustly(instance.graph), instance.graph.edges),
        (certpgo.solve_robustly(instance), instance.graph.edges),
        (certpgo.solve(whole.with_edges(np.arange(1, number))), graph.edges),
    ):
        assert answer.problem.graph.num_edges < len(edges)
        for edge in answer.costliest:
            assert edge.ids == tuple(edges[edge.edge])
            assert edge.edge not in answer.rejected
