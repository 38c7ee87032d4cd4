"""Procrustes: known and exact answers, conditions of the minimum, and agreement with a graph."""

import numpy as np
import pytest

import certpgo
from certpgo.linalg import rotations as so
from certpgo.linalg.procrustes import procrustes


def matched(seed, b, k, d, noise):
    """Points (b, k, d), and images of them under similarities with noise."""
    rng = np.random.default_rng(seed)
    R, t, s = so.random(rng, b, d), rng.uniform(-2, 2, (b, d)), rng.uniform(0.3, 3.0, b)
    source = rng.standard_normal((b, k, d))
    target = s[:, None, None] * source @ np.swapaxes(R, 1, 2) + t[:, None]
    return target + noise * rng.standard_normal(target.shape), source, (R, t, s)


def cost(target, source, R, t, s):
    """(b,) sums of squares."""
    moved = s[:, None, None] * source @ np.swapaxes(R, 1, 2) + t[:, None]
    return ((target - moved) ** 2).sum(axis=(1, 2))


def test_a_triangle_and_its_mirror_image_are_known():
    """Umeyama 1991's example, by hand: s R = [[3, 2], [-2, 3]] / 5, and 8/5 is left."""
    source = np.array([[[0.0, 0.0], [1.0, 0.0], [0.0, 2.0]]])
    target = source * [-1.0, 1.0]
    R, t, s = procrustes(target, source, scaled=True)
    assert R[0] == pytest.approx(np.array([[3.0, 2.0], [-2.0, 3.0]]) / np.sqrt(13.0))
    assert t[0] == pytest.approx([-0.8, 0.4])
    assert s[0] == pytest.approx(np.sqrt(13.0) / 5.0)
    assert cost(target, source, R, t, s)[0] == pytest.approx(1.6)


@pytest.mark.parametrize("d", [2, 3])
def test_similarities_and_motions_are_exact_without_noise(d):
    target, source, (R, t, s) = matched(0, 6, 5, d, 0.0)
    for found, wanted in zip(procrustes(target, source, scaled=True), (R, t, s), strict=True):
        assert found == pytest.approx(wanted, abs=1e-9)
    rigid = procrustes((target - t[:, None]) / s[:, None, None] + t[:, None], source)
    assert rigid[0] == pytest.approx(R, abs=1e-9)
    assert rigid[1] == pytest.approx(t, abs=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_nothing_near_is_better(d):
    target, source, _ = matched(1, 5, 8, d, 0.7)
    R, t, s = procrustes(target, source, scaled=True)
    least = cost(target, source, R, t, s)
    rng = np.random.default_rng(2)
    for _ in range(50):
        turn = so.exp(0.02 * rng.standard_normal((5, 1 if d == 2 else 3)))
        near = cost(target, source, turn @ R, t + 0.02 * rng.standard_normal((5, d)), s)
        scaled = cost(target, source, R, t, s * np.exp(0.02 * rng.standard_normal(5)))
        assert (np.minimum(near, scaled) > least).all()
    assert np.linalg.det(R) == pytest.approx(np.ones(5))


def test_a_scale_fits_at_least_as_well_as_none():
    target, source, _ = matched(3, 20, 6, 3, 0.3)
    rigid = cost(target, source, *procrustes(target, source))
    assert (cost(target, source, *procrustes(target, source, scaled=True)) <= rigid).all()


def test_two_clouds_agree_with_the_certified_graph_of_their_points():
    """Eliminating the points of a graph of sightings leaves half of the sum over their pairs."""
    target, source, (_, _, s) = matched(4, 1, 12, 3, 0.05)
    target = target / s[0]
    R, t, _ = procrustes(target, source)
    k = source.shape[1]
    edges = np.array([(pose, 2 + point) for pose in (0, 1) for point in range(k)])
    seen = np.concatenate([target[0], source[0]])
    rotation = certpgo.RotationGraph(
        2 + k, edges, np.tile(np.eye(3), (2 * k, 1, 1)), np.zeros(2 * k)
    )
    points = np.arange(2 + k) >= 2
    graph = certpgo.PoseGraph(rotation, seen, np.ones(2 * k), points=points)
    answer = certpgo.solve(graph)
    assert answer.verdict is certpgo.Verdict.CERTIFIED
    found = answer.estimate.anchored(0)
    assert found.rotations[1] == pytest.approx(R[0], abs=1e-6)
    assert found.translations[1] == pytest.approx(t[0], abs=1e-6)
    assert answer.cost == pytest.approx(0.5 * cost(target, source, R, t, np.ones(1))[0], rel=1e-6)
