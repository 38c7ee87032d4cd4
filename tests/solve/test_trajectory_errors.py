"""Trajectory errors: by hand, and laws."""

import numpy as np
import pytest
from hypothesis import given
from strategies import dimensions, pose_graph, rng_of, seeds

from certpgo import Estimate, InputError
from certpgo.linalg import rotations as so
from certpgo.linalg.procrustes import procrustes
from certpgo.solve.metrics import align_positions, trajectory_errors


def turned(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s], [s, c]])


def test_a_square_by_hand():
    truth = Estimate(np.array([np.eye(2)] * 4), np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]]))
    # One corner is 0.4 m further out along the diagonal, and turned by 8 degrees.
    out = np.array([0.4, 0.4]) / np.sqrt(2.0)
    R, t = truth.rotations.copy(), truth.translations.copy()
    R[2], t[2] = turned(8.0), t[2] + out
    found = trajectory_errors(Estimate(R, t), truth)
    # Alignment moves by a quarter of the error; no turn, as it is along the diagonal.
    assert found.poses == 4
    assert found.ate_m == pytest.approx(np.sqrt((3 * 0.1**2 + 0.3**2) / 4), rel=1e-12)
    assert found.ate_deg == pytest.approx(np.sqrt(8.0**2 / 4), rel=1e-9)
    # Steps 0-1, 1-2, 2-3: the first is exact, the second ends in the moved corner, and the third
    # is seen from the turned one.
    last = np.linalg.norm(turned(-8.0) @ ([-2.0, 0.0] - out) - [-2.0, 0.0])
    assert found.rpe_m == pytest.approx(np.sqrt((0.4**2 + last**2) / 3), rel=1e-12)
    assert found.rpe_deg == pytest.approx(np.sqrt(2 * 8.0**2 / 3), rel=1e-9)


@given(seeds, dimensions)
def test_the_frame_does_not_matter(seed, d):
    rng = rng_of(seed)
    _, R, t = pose_graph(rng, 7, d)
    truth = Estimate(R, t)
    estimate = Estimate(so.random(rng, 7, d), t + 0.1 * rng.standard_normal(t.shape))
    moved = estimate.moved(so.random(rng, 1, d)[0], rng.standard_normal(d))
    there = truth.moved(so.random(rng, 1, d)[0], rng.standard_normal(d))
    one, other = trajectory_errors(estimate, truth), trajectory_errors(moved, there)
    for name in ("ate_m", "ate_deg", "rpe_m", "rpe_deg"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-7, abs=1e-7)


@given(seeds, dimensions)
def test_rotations_alone_have_no_metres(seed, d):
    rng = rng_of(seed)
    truth = Estimate(so.random(rng, 6, d))
    found = trajectory_errors(truth.moved(so.random(rng, 1, d)[0]), truth)
    assert (found.ate_m, found.rpe_m) == (None, None)
    assert found.ate_deg == pytest.approx(0.0, abs=1e-6)
    assert found.rpe_deg == pytest.approx(0.0, abs=1e-6)


def test_a_straight_line_is_turned_by_its_rotations():
    t = np.outer(np.arange(5.0), [1.0, 0.0, 0.0])
    truth = Estimate(np.array([np.eye(3)] * 5), t)
    found = trajectory_errors(truth.moved(so.exp(np.array([0.3, -0.2, 0.9]))), truth)
    assert found.ate_deg == pytest.approx(0.0, abs=1e-6)
    assert found.ate_m == pytest.approx(0.0, abs=1e-12)


def test_truth_with_metres_needs_an_estimate_with_metres():
    truth = Estimate(np.array([np.eye(2)] * 3), np.arange(6.0).reshape(3, 2))
    with pytest.raises(InputError, match="no translations"):
        trajectory_errors(truth.with_translations(None), truth)


@given(seeds, dimensions)
def test_the_unit_of_a_map_without_one_does_not_matter(seed, d):
    rng = rng_of(seed)
    _, R, t = pose_graph(rng, 7, d)
    truth = Estimate(R, t)
    off = Estimate(R, t + 0.1 * rng.standard_normal(t.shape))
    one = trajectory_errors(off, truth, scaled=True)
    other = trajectory_errors(off.with_translations(0.01 * off.translations), truth, scaled=True)
    for name in ("ate_m", "ate_deg", "rpe_m", "rpe_deg"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-7, abs=1e-7)
    assert one.ate_m <= trajectory_errors(off, truth).ate_m + 1e-12
    _, _, s = procrustes(truth.translations[None], off.translations[None], scaled=True)
    fitted = align_positions(off, truth, scaled=True).translations
    spread, before = (
        np.ptp(fitted, axis=0),
        np.ptp(align_positions(off, truth).translations, axis=0),
    )
    np.testing.assert_allclose(spread, s[0] * before, rtol=1e-9)


def test_a_straight_map_is_scaled_too():
    t = np.outer(np.arange(5.0), [1.0, 0.0, 0.0])
    truth = Estimate(np.array([np.eye(3)] * 5), t)
    turned_map = truth.moved(so.exp(np.array([0.3, -0.2, 0.9])))
    found = trajectory_errors(
        turned_map.with_translations(7.0 * turned_map.translations), truth, scaled=True
    )
    assert found.ate_m == pytest.approx(0.0, abs=1e-12)
    assert found.rpe_m == pytest.approx(0.0, abs=1e-12)
