"""Refreshed after each measurement, whatever the graph has: the batch's cost, verdict and bound."""

import pytest
from features import having, plain
from strategies import pose_graph, rng_of
from test_session import stated, with_fixes, with_points

import certpgo
from certpgo import RobustSession, Session, Verdict
from certpgo.errors import GraphError
from certpgo.graph.streaming import streamed


def plane():
    """Poses in the plane."""
    return pose_graph(rng_of(1), 8, 2, extra=8, noise=0.05)[0]


def follows(session, cost, measured):
    """Refresh after each measurement; returns how often the whole was solved as a batch."""
    compared = 0
    for number, (one, names) in enumerate(streamed(measured)):
        session.add(one, names)
        try:
            standing = session.refresh()
            best = None if number % 3 else certpgo.solve(session.graph, cost=cost).certificate
        except GraphError:  # some node is not determined yet
            continue
        if best is None:
            continue
        compared += 1
        near = {"rel": 1e-9, "abs": 1e-12 * best.scale}
        assert standing.cost == pytest.approx(best.cost_upper, **near)
        assert standing.verdict is best.verdict
        assert standing.lower_bound <= best.cost_upper
        assert best.lower_bound <= standing.cost
        assert session.certificate.verdict is standing.verdict
        if standing.verdict is Verdict.CERTIFIED:
            assert standing.gap <= standing.tolerance
    return compared


@pytest.mark.parametrize("feature", ["distances", "partial edges", "matrix weights", "arms"])
def test_after_each_of_a_graph_with_a_feature(feature):
    assert follows(Session(every=None), "chordal", having(feature)) > 3


@pytest.mark.parametrize(
    ("made", "cost"),
    [
        (lambda rng: plain(), "chordal"),
        (lambda rng: plane(), "chordal"),
        (with_fixes, "chordal"),
        (with_points, "chordal"),
        (stated, "g2o"),
        (stated, "gtsam"),
    ],
)
def test_after_each_under_a_cost(made, cost):
    assert follows(Session(every=None, cost=cost), cost, made(rng_of(2))) > 3


def test_after_each_that_agrees_with_the_others():
    assert follows(RobustSession(every=None), "chordal", plain()) > 3
