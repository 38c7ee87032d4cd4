"""Restarts against the answers of solve: a small sample of the benchmark."""

import numpy as np

from certpgo.certify import Verdict
from reports.harness.scaling import restarts

#: Graphs of the benchmark's that are small, in the plane and in space, of rotations and poses.
LARGEST = 18


def test_the_graphs_are_of_every_kind_and_can_be_had_again():
    made = list(restarts.graphs(24))
    kinds = {(graph.d, graph.has_positions) for graph in made}
    assert kinds == {(2, False), (2, True), (3, False), (3, True)}
    assert all(10 <= graph.num_nodes <= 80 for graph in made)
    for one, other in zip(made[:2], restarts.graphs(2), strict=True):
        np.testing.assert_array_equal(one.rotations, other.rotations)
    assert made[0].num_nodes != next(restarts.graphs(1, 1)).num_nodes


def test_restarts_beat_no_bounded_answer():
    small = [(k, g) for k, g in enumerate(restarts.graphs(48)) if g.num_nodes <= LARGEST]
    outcomes = [restarts.attacked(number, graph, 5) for number, graph in small]
    assert {outcome.verdict for outcome in outcomes} == {Verdict.BOUNDED, Verdict.CERTIFIED}
    assert max(outcome.excess for outcome in outcomes) <= 1e-6
