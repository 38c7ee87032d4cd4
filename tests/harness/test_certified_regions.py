"""A sample of `reports.studies.certified_regions`: no estimate is outside, and what is counted."""

import json

import numpy as np
import pytest
from strategies import pose_graph, rng_of

import certpgo
from certpgo import Estimate, Region
from reports.studies.certified_regions import basins, campaign, page, public
from reports.studies.certified_regions.__main__ import OUT
from reports.studies.certified_regions.campaign import Tally, Ways, examine, shares
from reports.studies.certified_regions.kinds import KINDS, own_kinds


def test_nothing_is_outside_in_a_sample_of_all_kinds(monkeypatch):
    monkeypatch.setattr(campaign, "REFERENCES", 1)
    found = {kind: Tally() for kind in KINDS}
    with own_kinds():
        for kind, tally in found.items():
            examine(kind, 1000, tally)
    assert [kind for kind, tally in found.items() if tally.outside] == []
    assert sum(tally.checks for tally in found.values()) > 1500
    assert max(tally.largest["ellipsoid"] for tally in found.values()) > 0.99
    assert sum(tally.refused for tally in found.values()) <= 3


def test_shares_are_those_of_the_limits():
    """A region of half a metre in one direction, and a quarter turn of a node of scale two."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    x = Estimate(np.tile(np.eye(2), (2, 1, 1)), np.zeros((2, 2)), scales=np.array([1.0, 2.0]))
    t, scales = np.array([[0.0, 0.0], [0.25, 0.0]]), np.array([1.0, 2.5])
    other = Estimate(turn @ np.array([np.eye(2), turn]), t @ turn.T, scales=scales)
    shape = np.diag([0.25, 1e4, 1e4])
    region = Region(1, 0, np.zeros(2), 2.0 * np.eye(2), 0.5, 120.0, 1.0, shape)
    found = shares(region, x, other)
    assert found["metres"] == pytest.approx(0.5)
    assert found["degrees"] == pytest.approx(0.75)
    assert found["scale"] == pytest.approx(0.5)
    V = 2.5 * turn - 2.0 * np.eye(2)
    assert found["ellipsoid"] ** 2 == pytest.approx(0.25 + (V**2).sum() / 1e4)
    assert region.holds(other)


def test_the_worst_moves_cost_one():
    graph, _, _ = pose_graph(rng_of(3), 8, 3, noise=0.01)
    answer = certpgo.solve(graph, cost="chordal")
    regions, best, reference = answer.certificate.regions, answer.certificate.best, 2
    step = 1e-3
    for move in public.Moves(answer, reference).of(5, np.eye(4)):
        assert not move[reference].any()
        cost = answer.problem.cost(public.moved(best, step * move))
        assert cost - answer.cost == pytest.approx(step**2, rel=1e-2)
    # By the bound too, before frames are made rotations again: of the smallest steps, then.
    ways = Ways(regions, best, reference)
    one, other = ways.worst(rng_of(0), 5, step)
    far = sum((one.translations - other.translations) ** 2).sum()
    assert far > 0.0
    assert (one.translations[reference] == best.translations[reference]).all()


def test_two_valleys_in_closed_form():
    """By Gauss and Newton, the variance of the opposite node is n / 8."""
    n, closing = 12, 143.0
    row = basins.of_cycle(n, closing)
    a, other = np.radians(closing) / n, (np.radians(closing) - 2.0 * np.pi) / n
    assert row["cost"] == pytest.approx(8.0 * n * np.sin(0.5 * a) ** 2)
    assert row["other cost"] == pytest.approx(8.0 * n * np.sin(0.5 * other) ** 2)
    needed = row["other cost"] - row["cost"]
    local = np.degrees(np.sqrt(np.array(basins.SHARES) * needed * n / 8.0))
    np.testing.assert_allclose(row["local degrees"], local, rtol=1e-6)
    assert row["holds"] == [False, False, True, True]
    assert max(row["local degrees"]) < 180.0


def test_the_page_is_that_of_the_records():
    records = json.loads(OUT.read_text())
    assert OUT.with_suffix(".md").read_text() == page.text(records)
    assert sum(tally["outside"] for tally in records["campaign"].values()) == 0
    assert sum(tally["checks"] for tally in records["campaign"].values()) >= 100_000
    assert sum(row["largest"]["ellipsoid"] >= 0.8 for row in records["sharpness"]) >= 3
