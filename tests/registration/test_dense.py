"""Generalized ICP: recovery, and information that predicts the errors of recovery."""

import numpy as np
import pytest

from certpgo.errors import InputError
from certpgo.linalg import rotations as so

pytest.importorskip("small_gicp")

from certpgo.registration import dense

MOTION = so.exp(np.array([0.5, -0.8, 1.2])), np.array([1.0, 2.0, 3.0])


def sides(rng, count, noise, *, number=3):
    """Points on faces of a unit cube, displaced across them."""
    faces = []
    for axis in range(number):
        face = rng.uniform(0.0, 1.0, (count, 3))
        face[:, axis] = noise * rng.standard_normal(count)
        faces.append(face)
    return np.concatenate(faces)


def pair(rng, number, count=3000):
    """A target cloud, another sample as the source, and a start near MOTION."""
    R, t = MOTION
    target = dense.prepare(sides(rng, count, 0.002, number=number))
    source = dense.prepare((sides(rng, count, 0.002, number=number) - t) @ R)
    step = 0.01 * rng.standard_normal(6)
    return target, source, (R @ so.exp(step[:3]), t + step[3:])


def error(found):
    """xi in found = MOTION exp(xi), to first order."""
    R, t = MOTION
    return np.r_[so.log(R.T @ found.R), R.T @ (found.t - t)]


def test_the_same_points_are_aligned_exactly():
    R, t = MOTION
    points = sides(np.random.default_rng(0), 3000, 0.002)
    target = dense.prepare(points, voxel=1e-5)
    source = dense.prepare((points - t) @ R, voxel=1e-5)
    found = dense.align(target, source, (R @ so.exp(np.full(3, 0.005)), t + 0.005))
    np.testing.assert_allclose(error(found), 0.0, atol=1e-9)
    assert found.rmse < 1e-9
    assert (found.inliers, found.overlap) == (9000, 1.0)
    assert np.isfinite(found.information).all()


@pytest.mark.parametrize("number", [3, 1], ids=["corner", "plane"])
def test_information_predicts_the_errors(number):
    """A plane is free to slide and turn, and the information says that too."""
    squares, whitened = [], []
    for seed in range(40):
        found = dense.align(*pair(np.random.default_rng(seed), number))
        xi = error(found)
        squares.append(xi @ found.information @ xi)
        whitened.append(np.linalg.cholesky(found.information).T @ xi)
    assert 0.5 < np.mean(squares) / 6 < 2.0
    assert (np.std(whitened, axis=0) < 2.0).all()


def test_a_plane_leaves_three_directions_unknown():
    found = dense.align(*pair(np.random.default_rng(0), 1))
    R, _ = MOTION
    covariance = np.linalg.inv(found.information)[3:, 3:]
    across, along = R.T @ np.eye(3)[0], R.T @ np.eye(3)[1]
    assert np.sqrt(across @ covariance @ across) < 0.003
    assert np.sqrt(along @ covariance @ along) > 0.02


def test_information_is_the_curvature_of_the_distances():
    """Order, frame and sign: it is that of distances across the surfaces under T exp(xi)."""
    rng = np.random.default_rng(0)
    target, source, begin = pair(rng, 3, count=30000)
    found = dense.align(target, source, begin, sigma=1.0)
    nearest, distances = target.nearest(source.points @ found.R.T + found.t)
    met = distances <= 0.08
    p, q, n = source.points[met], target.points[nearest[met]], target.normals[nearest[met]]

    def across(xi):
        moved = (p @ so.exp(xi[:3]).T + xi[3:]) @ found.R.T + found.t
        return np.sum(n * (moved - q), axis=1)

    step = 1e-6
    J = np.stack([(across(e) - across(-e)) / (2 * step) for e in step * np.eye(6)], axis=1)
    curvature = J.T @ J
    difference = np.abs(found.information - curvature).max() / np.abs(curvature).max()
    assert difference < 0.05  # normals of both scans, and the reach


def test_information_moves_with_the_source():
    rng = np.random.default_rng(3)
    target, source, begin = pair(rng, 3)
    S, s = so.exp(np.array([0.3, 0.2, -0.4])), np.array([0.5, 0.0, -1.0])
    found = dense.align(target, source, begin, sigma=0.002)
    moved = dense.prepare(source.points @ S.T + s, voxel=1e-5)
    again = dense.align(target, moved, (begin[0] @ S.T, begin[1] - begin[0] @ S.T @ s), sigma=0.002)
    # S' exp(xi) S'^-1 = exp(Ad xi) with S' = (S, s).
    adjoint = np.block([[S, np.zeros((3, 3))], [so.hat(s) @ S, S]])
    expected = np.linalg.inv(adjoint).T @ found.information @ np.linalg.inv(adjoint)
    np.testing.assert_allclose(again.information, expected, atol=0.02 * np.abs(expected).max())


def test_clouds_that_do_not_meet_have_no_motion():
    rng = np.random.default_rng(0)
    cloud = dense.prepare(sides(rng, 500, 0.002))
    assert dense.align(cloud, cloud, (np.eye(3), np.full(3, 10.0))) is None
    assert dense.align(cloud, dense.prepare(np.zeros((5, 3))), (np.eye(3), np.zeros(3))) is None
    assert dense.align(cloud, dense.prepare(np.zeros((0, 3))), (np.eye(3), np.zeros(3))) is None


@pytest.mark.parametrize(
    ("points", "voxel", "message"),
    [
        (np.zeros((4, 2)), 0.03, "(n, 3)"),
        (np.full((4, 3), np.nan), 0.03, "finite"),
        (np.zeros((4, 3)), 0.0, "positive"),
        (np.full((4, 3), 5e6), 1.0, "do not reach"),
    ],
)
def test_unusable_clouds_are_refused(points, voxel, message):
    with pytest.raises(InputError, match=message.replace("(", r"\(").replace(")", r"\)")):
        dense.prepare(points, voxel=voxel)
