"""Rejections under the costs of g2o and GTSAM."""

from dataclasses import replace

import numpy as np
import pytest
from strategies import definite, pose_graph, rng_of

from certpgo import certify, solve_robustly
from certpgo.certify.certificate import Verdict
from certpgo.graph import PoseGraph, RotationGraph
from certpgo.graph.information import InformationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import edge_cost
from certpgo.objective.information_problem import InformationProblem
from certpgo.objective.marginalized import isotropic_below
from certpgo.objective.problem import PoseProblem


@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("crossed", [True, False])
def test_isotropic_costs_are_below(cost, d, crossed):
    rng = rng_of(d)
    graph, *_ = pose_graph(rng, 40, d, extra=200)
    m, p = graph.num_edges, d * (d + 1) // 2
    information = definite(rng, m, p, condition=1e4) * np.exp(rng.normal(size=(m, 1, 1)))
    if not crossed:
        information[:, :d, d:] = information[:, d:, :d] = 0.0
    full = InformationGraph(graph, information)
    posed = InformationProblem(edge_cost(full, cost))
    below = isotropic_below(full, posed.edge_cost.turned_share)
    for size in (1e-3, 0.3, 3.0):
        E = so.exp(size * rng.standard_normal((m, so.tangent_dim(d))))
        Q = graph.rotation.rotations @ E
        v = graph.translations + size * rng.standard_normal((m, d))
        squares = ((Q - graph.rotation.rotations) ** 2).sum(axis=(1, 2))
        least = below.rotation.kappa * squares
        least += below.tau * ((v - graph.translations) ** 2).sum(axis=1)
        costs = posed.edge_cost.costs(v, Q)
        assert (least <= costs * (1.0 + 1e-12)).all()
    assert (least > 0.0).all()


def test_wrong_loops_are_rejected_and_certified(dataset):
    clean, rng = dataset("kitti_00"), rng_of(0)
    graph = clean.graph
    loops = np.flatnonzero(np.abs(np.diff(graph.edges, axis=1)[:, 0]) > 1)
    bad = np.sort(rng.choice(loops, 15, replace=False))
    R, t = np.array(graph.rotation.rotations), np.array(graph.translations)
    R[bad] = so.random(rng, 15, 2)
    t[bad] += 5.0 * rng.standard_normal((15, 2))
    rotation = RotationGraph(graph.num_nodes, graph.edges, R, graph.rotation.kappa)
    wrong = replace(clean, graph=PoseGraph(rotation, t, graph.tau))
    answer = solve_robustly(wrong, cost="g2o")
    assert np.array_equal(answer.solution.rejected, bad)
    assert answer.verdict is answer.rejection.verdict is Verdict.CERTIFIED
    again = certify(wrong, answer.estimate, cost="g2o", rejected=bad)
    assert again.verdict is Verdict.CERTIFIED
    assert again.objective.startswith("truncated cost, ")
    assert again.cost_upper == pytest.approx(
        answer.certificate.cost_upper + answer.rejection.prices.sum()
    )


def test_edges_with_matrix_weights_are_solved_but_their_rejections_not_certified():
    graph, *_ = pose_graph(rng_of(0), 12, 3, extra=40, noise=0.01)
    R = np.array(graph.rotation.rotations)
    R[-1] = so.random(rng_of(1), 1, 3)[0]
    n, kappa = graph.num_nodes, 5000.0 * np.ones(graph.num_edges)
    whole = PoseGraph(RotationGraph(n, graph.edges, R, kappa), graph.translations, kappa)
    K = 5000.0 * np.tile(np.diag([1.0, 1.0, 1.1]), (graph.num_edges, 1, 1))
    general = replace(whole, rotation=whole.rotation.with_matrix_weights(K))
    assert isinstance(PoseProblem(general), PoseProblem)
    answer = solve_robustly(general)
    assert answer.solution.rejected.tolist() == [graph.num_edges - 1]
    assert answer.rejection is None
    assert "rejections are not certified: edges with matrix weights" in answer.solution.note
