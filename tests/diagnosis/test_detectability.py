"""Minimal detectable errors: their information is that of the difference to the others."""

import numpy as np
import pytest
from scipy import stats
from strategies import pose_graph, rng_of

import certpgo
from certpgo import Marginals
from certpgo.diagnosis.detectability import by_marginals, detectable, informations, sizes_of
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.study import study
from certpgo.io.datasets.synthetic import helix, winding_cycle
from certpgo.objective.choose_cost import objective_of


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("cost", ["g2o", "gtsam"])
def test_what_is_checked_is_the_difference_to_the_others(d, cost):
    graph = pose_graph(rng_of(0), 12, d, extra=12, noise=0.0)[0]
    p = d * (d + 1) // 2
    stated = [np.diag(rng_of(k).uniform(1.0, 9.0, p)) for k in range(graph.num_edges)]
    graph = graph.with_information(np.array(stated))
    answer = certpgo.solve(graph, cost=cost)
    rows = np.arange(graph.num_edges)[-4:]
    W, checked = informations(study(answer.problem, answer.estimate, 0), rows)
    for one, other in zip(by_marginals(answer.marginals, rows), (W, checked), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-8)
    for k, row in enumerate(rows):
        others = graph.with_edges(np.delete(np.arange(graph.num_edges), row))
        without = objective_of(others, cost)
        i, j = graph.edges[row].tolist()
        predicted = Marginals(without, answer.estimate).relative(i, j)
        difference = np.linalg.inv(W[k]) + predicted
        np.testing.assert_allclose(np.linalg.inv(difference), checked[k], rtol=1e-6, atol=1e-8)


def test_relative_covariances_of_many_pairs():
    made = helix(4, rng_of(0))
    marginals = certpgo.solve(made).marginals
    pairs = np.concatenate([made.graph.edges, made.graph.edges[:5, ::-1]])
    found = marginals.relatives(pairs)
    for one, (i, j) in zip(found, pairs.tolist(), strict=True):
        np.testing.assert_allclose(one, marginals.relative(i, j), rtol=1e-9, atol=1e-14)


def test_errors_of_that_size_are_seen_as_often_as_stated():
    """By the exact test of a difference, whose law is normal, in the worst direction."""
    made = helix(4, rng_of(0))
    rows = np.arange(made.graph.num_edges)[-3:]
    W, checked = informations(Examined(made).first, rows)
    sizes = sizes_of(made.graph, rows, W, checked)
    level = stats.chi2.ppf(1.0 - 0.01 / made.graph.num_edges, 6)
    for k, size in enumerate(sizes.metres):
        u = np.linalg.eigh(checked[k, :3, :3])[1][:, 0]
        shifted = size * np.r_[u, np.zeros(3)]
        noise = rng_of(k).multivariate_normal(shifted, np.linalg.inv(checked[k]), 4000)
        seen = np.einsum("ka,ab,kb->k", noise, checked[k], noise) > level
        assert seen.mean() == pytest.approx(0.8, abs=0.03)


def test_a_measurement_with_such_an_error_disagrees():
    """An error of twice that size is found by the residuals, one of a tenth is not."""
    made = helix(6, rng_of(3))
    row = made.graph.num_edges - 2
    rows = np.array([row])
    sizes = sizes_of(made.graph, rows, *informations(Examined(made).first, rows))
    for factor, expected in ((2.5, True), (0.1, False)):
        t = made.graph.translations.copy()
        t[row] += factor * float(sizes.metres[0]) / np.sqrt(3.0)
        R = made.graph.rotations_alone
        wrong = certpgo.solve_robustly(certpgo.PoseGraph(R, t, made.graph.tau)).rejected
        assert (row in wrong) == expected


def test_bridges_and_trees_are_not_checked():
    made = helix(4, rng_of(0))
    bare = Examined(made.with_edges(np.arange(15)))
    assert "no loop closure" in detectable(bare).in_words(made)
    loop = Examined(made.with_edges(np.r_[np.arange(15), 20]))
    found = detectable(loop)
    assert np.isfinite(found.metres).all()
    ring, _ = winding_cycle(8, 0.1, 0)
    only = detectable(Examined(ring))
    assert only.metres is None
    assert "the only closure" in only.in_words(ring)


def test_nothing_found_has_a_number():
    diagnosis = certpgo.diagnose(helix(5, rng_of(0)))
    assert not diagnosis.findings
    assert "would have been seen with probability 0.8" in diagnosis.detectable
    weak = helix(4, rng_of(0), rotation_noise=1e-3, translation_noise=1e-3)
    graph = weak.graph
    factors = np.ones(graph.num_edges)
    factors[-1] = 1e-4
    said = certpgo.diagnose(graph.reweighted(factors)).detectable
    assert "but for 1 (weakest: 11 to 15" in said
