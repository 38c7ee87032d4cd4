"""Problems and certificates go to other processes, with all that was computed of them."""

import pickle

import numpy as np
import pytest
from mixtures import mixture, scaled_mixture
from strategies import pose_graph, rng_of, rotation_graph

import certpgo
from certpgo.graph.streaming import streamed
from certpgo.io.datasets.monocular import random_maps
from certpgo.io.datasets.synthetic import grid3d
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.truncated_cost import rejecting


def posed(kind):
    rng = rng_of(1)
    if kind == "rotations":
        return objective_of(rotation_graph(rng, 8, 3)[0])
    if kind == "rejections":
        return rejecting(objective_of(pose_graph(rng, 8, 2)[0]), [3], 0.99)
    if kind == "no known scale":
        return objective_of(random_maps(rng, 3, 6, 9)[0])
    if kind == "scales":
        return objective_of(scaled_mixture(rng, 3, heights=0)[0])
    graph = mixture(rng, 2)[0]
    return objective_of(graph if kind == "distances" else graph.with_blocks(), kind_of_cost(kind))


def kind_of_cost(kind):
    return "chordal" if kind in ("distances", "points") else kind


def test_instances_and_answers_are_the_same_there():
    instance = grid3d(2, np.random.default_rng(0))
    answer = certpgo.solve(instance)
    there = pickle.loads(pickle.dumps(answer))
    assert there.instance.options == instance.options
    assert (there.cost, there.verdict) == (answer.cost, answer.verdict)
    np.testing.assert_array_equal(there.estimate.rotations, answer.estimate.rotations)


KINDS = ["rotations", "points", "distances", "no known scale", "scales", "g2o", "gtsam"]


@pytest.mark.parametrize("kind", [*KINDS, "rejections"])
def test_they_are_the_same_there(kind):
    problem = posed(kind)
    point = certpgo.solve(problem.kept if kind == "rejections" else problem).estimate
    judged = certpgo.certify(problem, point)
    there = pickle.loads(pickle.dumps(problem))
    again = certpgo.certify(there, point)
    assert again.objective == judged.objective
    assert again.verdict is judged.verdict
    assert (again.cost_upper, again.lower_bound) == (judged.cost_upper, judged.lower_bound)
    sent = pickle.loads(pickle.dumps(judged))
    assert (sent.verdict, sent.gap) == (judged.verdict, judged.gap)
    if judged.distance is not None:
        np.testing.assert_array_equal(sent.distance.degrees, judged.distance.degrees)


def test_sessions_go_on_there():
    graph = grid3d(2, np.random.default_rng(0)).graph
    session = certpgo.Session(every=None)
    for one, nodes in streamed(graph):
        session.add(one, nodes)
        session.refresh()
        there = pickle.loads(pickle.dumps(session))
        assert there.standing.cost == session.standing.cost
        assert there.certificate.verdict is session.certificate.verdict
    there.add(graph, np.arange(graph.num_nodes))
    assert there.refresh().verdict.value == "CERTIFIED"
