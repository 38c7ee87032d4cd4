"""Regions at a level of probability: quantiles, closed forms and coverage."""

import math

import numpy as np
import pytest
from scipy import stats
from strategies import pose_graph, rng_of, rotation_graph

import certpgo
from certpgo import Estimate, InputError, NumericalError
from certpgo.graph.information import Information
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import objective_of
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.likelihood import excesses, quantile


def twice(d, kappa=3.0, tau=5.0, apart=0.02):
    """Two poses, measured twice, with residuals of translations that cancel."""
    edges, steps = np.array([[0, 1], [0, 1]]), np.zeros((2, d))
    steps[:, 0] = 1.0 + apart, 1.0 - apart
    rotation = certpgo.RotationGraph(2, edges, np.array([np.eye(d)] * 2), np.full(2, kappa))
    return certpgo.PoseGraph(rotation, steps, np.full(2, tau))


@pytest.mark.parametrize("d", [2, 3])
def test_two_poses_in_closed_form(d):
    """F = 2 kappa 8 sin^2(theta / 2) + 2 tau (|u|^2 + apart^2): the bound is sharp."""
    kappa, tau, apart, q = 3.0, 5.0, 0.02, 0.7
    answer = certpgo.solve(twice(d, kappa, tau, apart), cost="chordal")
    assert answer.cost == pytest.approx(2.0 * tau * apart**2, rel=1e-9)
    region = answer.region(1, 0, excess=q)
    assert region.metres == pytest.approx(math.sqrt(q / (2.0 * tau)), rel=1e-4)
    sine = math.sin(0.5 * math.radians(region.degrees))
    assert 8.0 * sine**2 == pytest.approx(q / (2.0 * kappa), rel=1e-4)
    np.testing.assert_allclose(region.position, np.eye(d)[0], atol=1e-7)
    np.testing.assert_allclose(region.rotation, np.eye(d), atol=1e-7)


def test_quantiles_are_those_of_chi_squared():
    graph = pose_graph(rng_of(0), 6, 3)[0]
    m = graph.num_edges
    for problem in (Quadratic(graph), objective_of(with_information(graph), "g2o")):
        each, exact = excesses(problem, 0.9), quantile(problem, 0.9)
        np.testing.assert_allclose(each, stats.chi2.ppf(0.9, 6), rtol=1e-12)
        assert exact == pytest.approx(stats.chi2.ppf(0.9, 6 * m), rel=1e-12)
    flat = Quadratic(pose_graph(rng_of(0), 6, 2)[0])
    m = flat.graph.num_edges
    np.testing.assert_allclose(excesses(flat, 0.9), 2.0 * stats.chi2.ppf(0.9, 3), rtol=1e-12)
    apart = stats.chi2.ppf(0.95, 2 * m) + 2.0 * stats.chi2.ppf(0.95, m)
    assert quantile(flat, 0.9) == pytest.approx(apart, rel=1e-12)
    rotations = Quadratic(rotation_graph(rng_of(0), 6, 2)[0])
    m = rotations.graph.num_edges
    assert quantile(rotations, 0.9) == pytest.approx(2.0 * stats.chi2.ppf(0.9, m), rel=1e-12)


def with_information(graph):
    """The same weights as information of g2o's cost."""
    m, d = graph.num_edges, graph.d
    if d == 3:
        return graph.with_information(
            Information.isotropic(graph.tau, 8.0 * graph.kappa, 3, "g2o", "quaternion")
        )
    W = np.zeros((m, 3, 3))
    W[:, [0, 1], [0, 1]], W[:, 2, 2] = graph.tau[:, None], graph.kappa
    return graph.with_information(Information.of(W, "g2o", "tangent"))


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("exact", [False, True])
def test_coverage_is_at_least_the_level(d, exact):
    """Of true poses, by noise as it is stated, but for chance: two standard deviations."""
    rng, inside, count = rng_of(d), 0, 40
    clean, R, t = pose_graph(rng, 5, d, noise=0.0, weights=False)
    truth = Estimate(R, t)
    sigma = 0.05
    for _ in range(count):
        graph = noisy(rng, clean, sigma)
        answer = certpgo.solve(graph, cost="g2o")
        try:
            inside += answer.region(3, 0, level=0.8, exact=exact).holds(truth)
        except NumericalError:  # by chance: the noise is larger than at this level
            assert exact
    assert inside >= 0.8 * count - 2.0 * math.sqrt(0.16 * count)


def uneven(rng, cost="chordal"):
    """A graph whose noise is along one axis but for a hundredth, correlated, with its truth."""
    clean, R, t = pose_graph(rng, 4, 3, noise=0.0, weights=False)
    m, axes = clean.num_edges, np.diag([1.0, 0.01, 0.01, 1.0, 0.01, 0.01])
    S = axes @ (np.eye(6) + 0.9 * (np.eye(6, k=3) + np.eye(6, k=-3))) @ axes * 0.02**2
    off = rng.standard_normal((m, 6)) @ np.linalg.cholesky(S).T
    turns = clean.rotations @ so.exp(off[:, 3:])
    W = np.linalg.inv(S)
    kappa, tau = (3.0 / np.trace(np.linalg.inv(W[k : k + 3, k : k + 3])) for k in (3, 0))
    rotation = certpgo.RotationGraph(4, clean.edges, turns, np.full(m, 0.5 * kappa))
    graph = certpgo.PoseGraph(rotation, clean.translations + off[:, :3], np.full(m, tau))
    W = np.tile(0.5 * (W + W.T), (m, 1, 1))
    return objective_of(graph.with_information(Information.of(W, "g2o")), cost), Estimate(R, t)


def test_averaged_information_has_no_chi_squared():
    """F at the truth is below the quantile as often as that says: its noise is along one axis."""
    below, count = 0, 100
    for k in range(count):
        problem, truth = uneven(rng_of(k))
        below += problem.cost(truth) <= quantile(problem, 0.9)
    assert below >= 0.9 * count - 2.0 * math.sqrt(0.09 * count)
    problem, _ = uneven(rng_of(0))
    plain = stats.chi2.ppf(0.9, 6 * problem.graph.num_edges)
    assert 3.0 * plain < quantile(problem, 0.9) < 30.0 * plain
    assert excesses(problem, 0.9).max() > 3.0 * stats.chi2.ppf(0.9, 6)
    np.testing.assert_allclose(
        excesses(uneven(rng_of(0), "g2o")[0], 0.9), stats.chi2.ppf(0.9, 6), rtol=1e-12
    )


def test_nothing_is_said_of_noise_that_is_not_stated():
    """F weighs all directions alike, of which one is left open."""
    graph = pose_graph(rng_of(4), 6, 3, noise=0.05)[0]
    W = with_information(graph).information_matrices.copy()
    W[2, 0, :] = W[2, :, 0] = 0.0
    answer = certpgo.solve(graph.with_information(Information.of(W, "g2o")), cost="chordal")
    assert answer.region(1, 0) is answer.regions() is answer.region(1, 0, exact=True) is None
    assert answer.region(1, 0, excess=1.0).metres < math.inf


def noisy(rng, clean, sigma):
    m, d, q = clean.num_edges, clean.d, 3 if clean.d == 3 else 1
    R = clean.rotations @ so.exp(sigma * rng.standard_normal((m, q)))
    steps = clean.translations + sigma * rng.standard_normal((m, d))
    rotation = certpgo.RotationGraph(clean.num_nodes, clean.edges, R, np.full(m, 0.5 / sigma**2))
    graph = certpgo.PoseGraph(rotation, steps, np.full(m, sigma**-2))
    W = np.tile(np.eye(d + q) / sigma**2, (m, 1, 1))
    return graph.with_information(Information.of(W, "g2o", "tangent"))


def test_regions_grow_with_the_level_and_hold_what_they_say():
    graph = pose_graph(rng_of(4), 7, 3, noise=0.05)[0]
    answer = certpgo.solve(graph, cost="chordal")
    levels = (0.5, 0.9, 0.99)
    found = [answer.region(5, 1, level=level) for level in levels]
    assert [one.metres for one in found] == sorted(one.metres for one in found)
    assert [one.degrees for one in found] == sorted(one.degrees for one in found)
    of_all = answer.regions(1, level=0.9)
    assert of_all.metres[5] == pytest.approx(found[1].metres, rel=1e-12)
    assert of_all.degrees[5] == pytest.approx(found[1].degrees, rel=1e-12)
    assert of_all.metres[1] == of_all.degrees[1] == 0.0
    default = answer.region(5)
    assert default.reference == answer.certificate.distance.reference
    assert default.metres == answer.region(5, level=0.95).metres
    assert answer.region(5, 1, level=0.9, exact=True).metres > found[1].metres
    assert answer.region(5, 1, excess=0.0).metres < 0.01


def test_what_a_region_cannot_be_of():
    answer = certpgo.solve(pose_graph(rng_of(4), 7, 3, noise=0.05)[0], cost="chordal")
    with pytest.raises(InputError, match="of a level or of an excess"):
        answer.region(1, 0, level=0.9, excess=1.0)
    with pytest.raises(InputError, match="a level lies between 0 and 1"):
        answer.region(1, 0, level=1.5)
    with pytest.raises(InputError, match="not among 0 to 6"):
        answer.region(7)
    with pytest.raises(InputError, match="the number of a node"):
        answer.region(1.5)
    with pytest.raises(InputError, match="node 2 is the reference itself"):
        answer.region(2, 2)
    with pytest.raises(InputError, match="finite"):
        answer.region(2, excess=math.inf)
    assert answer.region(2, 1, excess=-0.5 * answer.cost) is None
    worse = certpgo.solve(pose_graph(rng_of(4), 7, 3, noise=3.0)[0], cost="chordal")
    with pytest.raises(NumericalError, match="the noise is not as stated"):
        worse.region(1, 0, exact=True)
