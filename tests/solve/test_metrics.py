"""Metrics: formulas as the thesis prints them, in its own frame, and alignment."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo.errors import InputError
from certpgo.graph import Estimate
from certpgo.linalg import rotations as so
from certpgo.solve import metrics


def in_the_thesis_frame(R, t):
    """Its R_i is our R_i^T, its t_i our -R_i^T t_i."""
    inverse = np.swapaxes(R, 1, 2)
    return inverse, -np.einsum("nab,nb->na", inverse, t)


@given(seeds, dimensions)
def test_f_ml_as_the_thesis_prints_it(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 6, d)
    R, t = so.random(rng, 6, d), rng.standard_normal((6, d))
    Q, s = in_the_thesis_frame(R, t)
    translations, rotations = 0.0, 0.0
    for e, (i, j) in enumerate(graph.edges):
        relative = Q[i] @ Q[j].T
        translations += np.sum((graph.translations[e] - s[i] + relative @ s[j]) ** 2)
        rotations += np.trace(graph.rotations[e] @ Q[j] @ Q[i].T)
    expected = rotations - 0.5 * translations
    assert metrics.f_ml(graph, Estimate(R, t)) == pytest.approx(expected, rel=1e-11, abs=1e-9)
    alone = metrics.f_ml(graph.rotations_alone, Estimate(R))
    assert alone == pytest.approx(rotations, rel=1e-11, abs=1e-9)


@given(seeds, dimensions)
def test_symmetry_as_the_thesis_prints_it(seed, d):
    rng = rng_of(seed)
    graph, _, _ = pose_graph(rng, 6, d)
    R, t = so.random(rng, 6, d), rng.standard_normal((6, d))
    _, s = in_the_thesis_frame(R, t)
    for e, (i, j) in enumerate(graph.edges):
        S = np.outer(s[j], s[i] - graph.translations[e]) @ graph.rotations[e]
        even, odd = np.linalg.norm(S + S.T), np.linalg.norm(S - S.T)
        value = metrics.symmetry(graph, Estimate(R, t))[e]
        assert value == pytest.approx((even - odd) / (even + odd), abs=1e-9)
        assert -1.0 <= value <= 1.0


@given(seeds, dimensions)
def test_symmetry_is_one_without_noise(seed, d):
    graph, R, t = pose_graph(rng_of(seed), 6, d, noise=0.0)
    assert metrics.mean_symmetry(graph, Estimate(R, t)) == pytest.approx(1.0, abs=1e-6)


@given(seeds, dimensions)
def test_positions_are_compared_after_the_best_rigid_motion(seed, d):
    rng = rng_of(seed)
    _, R, t = pose_graph(rng, 8, d)
    truth = Estimate(R, t)
    S, s = so.random(rng, 1, d)[0], 5.0 * rng.standard_normal(d)
    assert metrics.position_errors(truth.moved(S, s), truth).worst < 1e-12
    noisy = Estimate(R, t + 0.1 * rng.standard_normal((8, d)))
    found = metrics.position_errors(noisy, truth)
    assert 0.0 < found.mean <= found.rmse <= found.worst
    for _ in range(5):  # no other motion makes the sum of squares smaller
        turn = so.exp(0.1 * rng.standard_normal((1, so.tangent_dim(d))))[0]
        moved = noisy.moved(turn, 0.1 * rng.standard_normal(d)).translations
        other = np.sqrt(np.mean(np.sum((moved - t) ** 2, axis=1)))
        assert found.rmse <= other * (1.0 + 1e-12)


def test_positions_are_not_mirrored_and_may_lie_on_a_line():
    t = np.random.default_rng(0).standard_normal((10, 3))
    R = np.tile(np.eye(3), (10, 1, 1))
    assert metrics.position_errors(Estimate(R, t * [1, 1, -1]), Estimate(R, t)).worst > 0.1
    line = np.outer(np.arange(10.0), [1.0, 2.0, 3.0])
    assert metrics.position_errors(Estimate(R, line), Estimate(R, line[:, ::-1])).worst < 1e-12
    with pytest.raises(InputError, match="9 nodes"):
        metrics.position_errors(Estimate(R[1:], line[1:]), Estimate(R, line))


def test_a_pose_at_the_origin_counts_as_symmetric():
    graph, R, _ = pose_graph(np.random.default_rng(0), 4, 3)
    assert metrics.mean_symmetry(graph, Estimate(R, np.zeros((4, 3)))) == 1.0


@given(seeds, dimensions)
def test_errors_do_not_depend_on_the_gauge(seed, d):
    rng = rng_of(seed)
    truth = Estimate(so.random(rng, 15, d))
    v = 0.1 * rng.standard_normal((15, so.tangent_dim(d)))
    estimate = Estimate(truth.rotations @ so.exp(v))
    S = so.random(rng, 1, d)[0]
    for norm in ("l2", "l1"):
        here = metrics.angular_errors(estimate, truth, norm=norm)
        there = metrics.angular_errors(estimate.moved(S), truth, norm=norm)
        assert here.rmse_deg == pytest.approx(there.rmse_deg, rel=1e-6, abs=1e-9)
    l2 = metrics.angular_errors(estimate, truth)
    l1 = metrics.angular_errors(estimate, truth, norm="l1")
    assert l1.mean_deg <= l2.mean_deg * (1 + 1e-6)


def test_a_known_error_is_measured():
    truth = Estimate(np.tile(np.eye(3), (5, 1, 1)))
    turned = np.zeros((5, 3))
    turned[0, 2] = np.radians(10.0)
    estimate = Estimate(so.exp(turned))
    errors = metrics.angular_errors(estimate, truth, norm="l1")
    assert errors.median_deg == pytest.approx(0.0, abs=1e-6)
    assert errors.mean_deg == pytest.approx(2.0, abs=1e-5)
    assert errors.rmse_deg == pytest.approx(10.0 / np.sqrt(5.0), abs=1e-5)


def test_refusals():
    graph, R, _ = pose_graph(np.random.default_rng(0), 4, 3)
    with pytest.raises(InputError, match="no translations"):
        metrics.f_ml(graph, Estimate(R))
    with pytest.raises(InputError, match="4 nodes, the ground truth 3"):
        metrics.align(Estimate(R), Estimate(R[:3]))


@given(seeds, dimensions)
def test_f_gt_is_the_least_over_all_moves_of_the_world(seed, d):
    rng = rng_of(seed)
    true = Estimate(so.random(rng, 6, d), rng.standard_normal((6, d)))
    noise = so.exp(0.1 * rng.standard_normal((6, so.tangent_dim(d))))
    found = Estimate(true.rotations @ noise, true.translations + 0.1 * rng.standard_normal((6, d)))

    def unaligned(estimate):
        """Eq. 5.1 as printed, in the thesis' frame."""
        Q, s = in_the_thesis_frame(estimate.rotations, estimate.translations)
        P, r = in_the_thesis_frame(true.rotations, true.translations)
        return ((Q - P) ** 2).sum() + ((s - r) ** 2).sum()

    least = metrics.f_gt(found, true)
    S, shift = so.random(rng, 1, d)[0], rng.standard_normal(d)
    assert metrics.f_gt(true.moved(S, shift), true) == pytest.approx(0.0, abs=1e-12)
    assert metrics.f_gt(found.moved(S, shift), true) == pytest.approx(least)
    for _ in range(5):
        turn = so.exp(0.05 * rng.standard_normal((1, so.tangent_dim(d))))[0]
        assert unaligned(found.moved(turn, 0.05 * rng.standard_normal(d))) >= least - 1e-12
    assert metrics.f_gt(Estimate(found.rotations), true) < least
    anchored = metrics.f_gt(found, true, anchored=True)
    assert (
        least <= anchored == pytest.approx(metrics.f_gt(found.moved(S, shift), true, anchored=True))
    )
    one = found.anchored(0, true)
    inverse = -np.einsum("nba,nb->na", one.rotations, one.translations)
    meant = -np.einsum("nba,nb->na", true.rotations, true.translations)
    apart = ((one.rotations - true.rotations) ** 2).sum() + ((inverse - meant) ** 2).sum()
    assert anchored == pytest.approx(apart)
