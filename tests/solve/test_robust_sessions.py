"""Robust sessions keep what the robust fit keeps, under every cost and of all kinds."""

from dataclasses import replace

import numpy as np
import pytest
from features import added
from mixtures import COSTS, mixture

import certpgo
from certpgo import Instance, RobustSession
from certpgo.graph.streaming import streamed
from certpgo.objective.choose_cost import objective_of


def measured(d, wrong):
    """Poses, landmarks, GPS, distances and heights, of which one loop or distance is wrong."""
    rng = np.random.default_rng(d)
    graph, truth = mixture(rng, d)
    pairs, n = np.array([[0, 5], [3, 9]]), graph.num_nodes
    (i, j), up = pairs.T, np.tile(np.eye(d)[-1], (2, 1))
    v = np.einsum("mba,mb->ma", truth.rotations[i], truth.translations[j] - truth.translations[i])
    ranges = graph.ranges
    if wrong == "distance":
        lengths = ranges.distances.copy()
        lengths[0] += 30.0
        ranges = replace(ranges, distances=lengths)
    else:
        t = graph.translations.copy()
        t[16] += 30.0
        graph = replace(graph, translations=t)
    heights = added.Heights(n, pairs, up, v[:, -1], np.full(2, 40.0))
    return Instance("all", graph.with_blocks(ranges, heights), np.arange(n), world=n - 1)


@pytest.mark.parametrize("wrong", ["loop", "distance"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", COSTS)
def test_a_wrong_measurement_is_put_aside_under_each_cost(cost, d, wrong):
    whole = measured(d, wrong)
    session = RobustSession(every=None, cost=cost)
    for part, names in streamed(whole, 12):
        session.add(part, names)
    found = session.settle()
    [rejected] = session.rejected.tolist()
    one, _ = session._put_aside[rejected]
    assert isinstance(one, certpgo.Ranges if wrong == "distance" else certpgo.Graph)
    assert found.verdict.value == "CERTIFIED"
    if wrong == "loop":
        batch = certpgo.solve_robustly(whole, cost=cost)
        assert found.cost == pytest.approx(batch.certificate.cost_upper, rel=1e-6)
        assert found.objective == batch.certificate.objective
    # With what is put aside it is the whole again.
    session._keep({*session.edges.tolist(), rejected})
    assert len(session.edges) == len(whole.graph.pairs)
    instance, estimate = session.as_instance()
    assert session.standing.cost == pytest.approx(objective_of(instance, cost).cost(estimate))
    order = [instance.labels.index(label) for label in whole.labels]
    own = objective_of(whole, cost).cost(estimate.subset(np.array(order)))
    assert own == pytest.approx(session.standing.cost, rel=1e-9)


def test_the_default_cost_is_that_of_the_first_measurements():
    session = RobustSession(every=None)
    session.add(measured(3, "loop"))
    assert session.settle().objective.startswith("g2o's chi2")
