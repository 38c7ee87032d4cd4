"""The tilt of depths: exact from exact points, and none without one."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from certpgo.linalg import rotations as so
from certpgo.registration.camera import Camera
from certpgo.registration.features import Features
from certpgo.registration.pairs import FramePair
from certpgo.registration.synthetic import synthetic_sequence
from reports.studies.unknown_scales.depth_tilt import (
    StraightenedSequence,
    depth_tilt,
    straightened,
)

CAMERA = Camera(525.0, 525.0, 319.5, 239.5)
HIDDEN = np.array([0.5, 2.0, 1.3, 0.8, 1.7, 0.6])


def seen(tilt, *, noise=0.0):
    """Pairs and features of frames that turn before points, each in a unit of its own."""
    rng, n = np.random.default_rng(0), len(HIDDEN)
    world = rng.uniform([-1.0, -1.0, 1.5], [1.0, 1.0, 3.0], (100, 3))
    descriptors = rng.integers(0, 256, (100, 128), np.uint8)
    R = so.exp(np.c_[rng.uniform(-0.2, 0.2, (n, 2)), np.zeros(n)])
    t = rng.uniform(-0.2, 0.2, (n, 3))
    features = {}
    for k in range(n):
        local = (world - t[k]) @ R[k]
        # What is measured is straight if the tilt is applied.
        shares = straightened(local, tilt)[:, 2] / local[:, 2]
        shares = shares * (1.0 + noise * rng.standard_normal(100))
        features[k] = Features(np.zeros((100, 2)), HIDDEN[k] * local / shares[:, None], descriptors)
    pairs = []
    for i, j in combinations(range(n), 2):
        turn, shift = R[i].T @ R[j], HIDDEN[i] * R[i].T @ (t[j] - t[i])
        numbers = (100, 100, 1.0, False, 1.0, HIDDEN[i] / HIDDEN[j])
        pairs.append(FramePair(i, j, turn, shift, np.eye(7), *numbers))
    return pairs, features


@pytest.mark.parametrize("tilt", [(0.02, -0.015), (0.0, 0.05)])
def test_the_tilt_of_exact_points_is_exact(tilt):
    pairs, features = seen(tilt)
    assert depth_tilt(pairs, features, CAMERA) == pytest.approx(tilt, abs=1e-6)


def test_frames_are_straightened_as_their_points_are():
    frames, tilt = synthetic_sequence(2, size=(64, 48)), (0.02, -0.015)
    straight = StraightenedSequence.of(frames, tilt).chosen([1])
    seen = frames.camera.cloud(frames.frame(1).depth)
    found = frames.camera.cloud(straight.frame(0).depth)
    assert found == pytest.approx(straightened(seen, tilt), rel=1e-6)


def test_noise_is_not_taken_for_a_tilt():
    assert depth_tilt(*seen((0.0, 0.0), noise=0.004), CAMERA) == (0.0, 0.0)
    found = depth_tilt(*seen((0.02, -0.015), noise=0.004), CAMERA)
    assert found == pytest.approx((0.02, -0.015), abs=0.003)


def test_no_pairs_tell_no_tilt_nor_do_those_that_see_nothing_new():
    assert depth_tilt([], {}, CAMERA) == (0.0, 0.0)
    _, features = seen((0.02, 0.0))
    first, numbers = features[0], (100, 100, 1.0, False, 1.0, 1.0)
    still = FramePair(0, 1, np.eye(3), np.zeros(3), np.eye(7), *numbers)
    assert depth_tilt([still], {0: first, 1: first}, CAMERA) == (0.0, 0.0)
    none = Features(first.pixels[:0], first.points[:0], first.descriptors[:0])
    assert depth_tilt([still], {0: first, 1: none}, CAMERA) == (0.0, 0.0)


def test_a_tilt_is_not_believed_where_pairs_disagree_by_more():
    pairs, features = seen((0.02, -0.015), noise=0.004)
    loud = [replace(pair, chi2=1e6) for pair in pairs]
    assert depth_tilt(pairs, features, CAMERA) != (0.0, 0.0)
    assert depth_tilt(loud, features, CAMERA) == (0.0, 0.0)


def test_a_tilt_of_more_than_a_tenth_is_not_one():
    assert depth_tilt(*seen((0.0, 0.09)), CAMERA) != (0.0, 0.0)
    assert depth_tilt(*seen((0.0, 0.12)), CAMERA) == (0.0, 0.0)
