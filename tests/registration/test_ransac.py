"""RANSAC and refinement: exact motions, laws, and outliers."""

import numpy as np
import pytest

from certpgo.errors import SpecError
from certpgo.linalg import rotations as so
from certpgo.registration.ransac import THESIS, RansacSettings, register

SIGMA = 0.002


def matches(rng, k, outliers=0.0, sigma=SIGMA):
    """Matched points, their covariances, the motion, and which are right."""
    R, t = so.random(rng, 1, 3)[0], rng.uniform(-2, 2, 3)
    source = rng.uniform([-1, -1, 1], [1, 1, 3], (k, 3))
    target = source @ R.T + t + sigma * rng.standard_normal((k, 3))
    right = np.arange(k) >= outliers * k
    target[~right] = t + R @ [0, 0, 2] + rng.uniform(-1, 1, (int((~right).sum()), 3))
    noise = np.tile(0.5 * sigma**2 * np.eye(3), (k, 1, 1))
    return target, source, (noise, noise), (R, t), right


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.6])
def test_nearly_all_inliers_are_found(outliers):
    shares = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        p, q, noise, _, right = matches(rng, 300, outliers)
        motion = register(p, q, noise, rng)
        shares.append(motion.inliers[right].mean())
        assert motion.inliers[~right].sum() <= 2
    assert min(shares) >= 0.95


def test_the_covariance_is_that_of_the_errors():
    """Normalized squared errors have mean 6, within 5 standard errors of 200 trials."""
    errors = []
    for seed in range(200):
        rng = np.random.default_rng([1, seed])
        p, q, noise, (R, t), _ = matches(rng, 60)
        m = register(p, q, noise, rng)
        xi = np.concatenate([so.log(m.R.T @ R), m.R.T @ (t - m.t)])
        errors.append(xi @ m.information @ xi)
    assert np.mean(errors) == pytest.approx(6.0, abs=5 * np.sqrt(12 / 200))


def test_it_moves_with_both_frames():
    rng = np.random.default_rng(3)
    p, q, noise, _, _ = matches(rng, 100)
    S, s = so.random(rng, 1, 3)[0], np.array([3.0, 1, -2])
    a = register(p, q, noise, np.random.default_rng(0))
    b = register(p @ S.T + s, q, noise, np.random.default_rng(0))
    assert np.abs(b.R - S @ a.R).max() < 1e-6
    assert np.abs(b.t - (S @ a.t + s)).max() < 1e-6


def test_nothing_matches_by_chance():
    rng = np.random.default_rng(4)
    noise = np.tile(SIGMA**2 * np.eye(3), (200, 1, 1))
    p, q = rng.uniform(-1, 1, (2, 200, 3))
    assert register(p, q, (noise, noise), rng) is None


def test_few_matches_and_points_on_a_line_are_no_motion():
    rng = np.random.default_rng(5)
    p, q, noise, _, _ = matches(rng, 29)
    assert register(p, q, noise, rng) is None
    line = np.outer(np.linspace(1, 2, 60), [0.1, 0.2, 1.0])
    noise = np.tile(SIGMA**2 * np.eye(3), (60, 1, 1))
    assert register(line, line, (noise, noise), rng) is None


def test_the_thesis_gates_by_a_squared_distance():
    rng = np.random.default_rng(6)
    p, q, noise, _, right = matches(rng, 400, 0.3, sigma=0.0005)
    motion = register(p, q, noise, rng, THESIS)
    assert motion.inliers[right].mean() > 0.97
    off = (p - motion.t) @ motion.R - q
    assert ((off**2).sum(axis=1)[motion.inliers] <= THESIS.threshold_m2).all()


@pytest.mark.parametrize("wrong", [{"iterations": 0}, {"share": 1.5}, {"threshold_m2": -1.0}])
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(SpecError):
        RansacSettings(**wrong)


def similar(rng, k, scale, outliers=0.0):
    """As `matches`, where lengths in the target are ``scale`` times those in the source."""
    p, q, (noise, _), (R, t), right = matches(rng, k, outliers)
    return scale * p, q, (scale**2 * noise, noise), (R, scale * t), right


@pytest.mark.parametrize("scale", [0.5, 1.0, 2.0])
def test_nearly_all_inliers_of_a_similarity_are_found(scale):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        p, q, noise, _, right = similar(rng, 300, scale, 0.5)
        motion = register(p, q, noise, rng, scaled=True)
        assert motion.inliers[right].mean() >= 0.95
        assert motion.inliers[~right].sum() <= 3
        assert motion.scale == pytest.approx(scale, rel=1e-3)


def test_a_scale_has_the_stated_covariance_and_no_bias():
    """Normalized squared errors have mean 7, and logarithms of scale mean 0, within 5 deviations.

    Noise of 3 % of the points' spread in both: the slope of a regression would be 1e-3 too small.
    """
    squares, logs, stated = [], [], []
    for seed in range(100):
        rng = np.random.default_rng([2, seed])
        p, q, _, (R, t), _ = matches(rng, 100, sigma=0.0)
        p, q = p + 0.02 * rng.standard_normal(p.shape), q + 0.02 * rng.standard_normal(q.shape)
        noise = np.tile(0.02**2 * np.eye(3), (100, 1, 1))
        m = register(p, q, (noise, noise), rng, scaled=True)
        log = -np.log(m.scale)
        xi = np.concatenate([so.log(m.R.T @ R), m.R.T @ (t - m.t) / m.scale, [log]])
        squares.append(xi @ m.information @ xi)
        logs.append(log)
        stated.append(np.linalg.inv(m.information)[6, 6])
    assert np.mean(squares) == pytest.approx(7.0, abs=5 * np.sqrt(14 / 100))
    assert abs(np.mean(logs)) < 5 * np.sqrt(np.mean(stated) / 100)


def test_another_unit_changes_the_scale_alone():
    rng = np.random.default_rng(3)
    p, q, (C, D), _, _ = matches(rng, 100)
    a = register(p, q, (C, D), np.random.default_rng(0), scaled=True)
    b = register(p, 4.0 * q, (C, 16.0 * D), np.random.default_rng(0), scaled=True)
    assert np.abs(b.R - a.R).max() < 1e-12
    assert np.abs(b.t - a.t).max() < 1e-12
    assert 4.0 * b.scale == pytest.approx(a.scale, rel=1e-12)
