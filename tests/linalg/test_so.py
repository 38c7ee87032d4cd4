"""Rotation kernels: known values, group laws, and the ends of the angle range."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import dimensions, rng_of, seeds

from certpgo.linalg import rotations as so


def test_quarter_turn_about_z():
    R = so.exp(np.array([0.0, 0.0, np.pi / 2]))
    np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(so.exp(np.array([np.pi / 2])), [[0, -1], [1, 0]], rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, 3.0, np.pi - 1e-8, np.pi])
@pytest.mark.parametrize("d", [2, 3])
def test_log_inverts_exp_at_every_angle(d, angle):
    axis = np.array([1.0]) if d == 2 else np.array([2.0, -1.0, 2.0]) / 3.0
    R = so.exp(angle * axis)
    np.testing.assert_allclose(so.exp(so.log(R[None])[0]), R, rtol=0, atol=1e-13)
    assert so.angle(R) == pytest.approx(angle, abs=1e-14)


def test_log_of_half_turns_about_each_axis():
    for axis in np.eye(3):
        v = so.log(so.exp(np.pi * axis)[None])[0]
        np.testing.assert_allclose(np.abs(v), np.pi * axis, rtol=0, atol=1e-14)


@given(seeds, dimensions)
def test_hat_and_vee_are_inverse_and_skew(seed, d):
    v = rng_of(seed).standard_normal((4, so.tangent_dim(d)))
    K = so.hat(v)
    np.testing.assert_array_equal(K, -np.swapaxes(K, 1, 2))
    np.testing.assert_array_equal(so.vee(K), v)


@given(seeds, dimensions)
def test_exp_is_a_rotation_and_its_inverse_is_the_transpose(seed, d):
    v = rng_of(seed).uniform(-4, 4, (5, so.tangent_dim(d)))
    R = so.exp(v)
    assert so.worst_defect(R)[1] < 1e-14
    np.testing.assert_allclose(so.exp(-v), np.swapaxes(R, 1, 2), rtol=0, atol=1e-14)


@given(seeds, dimensions, st.sampled_from([1e-3, 0.3, 1.0, 5.0]))
def test_project_is_nearest_idempotent_and_proper(seed, d, noise):
    rng = rng_of(seed)
    A = so.random(rng, 6, d) + noise * rng.standard_normal((6, d, d))
    P = so.project(A)
    assert so.worst_defect(P)[1] < 1e-12
    np.testing.assert_allclose(so.project(P), P, rtol=0, atol=1e-14)
    U, s, Vt = np.linalg.svd(A)
    s[:, -1] *= np.sign(np.linalg.det(U @ Vt))
    nearest = np.trace(np.swapaxes(P, 1, 2) @ A, axis1=1, axis2=2)
    np.testing.assert_allclose(nearest, s.sum(axis=1), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("noise", [1e-15, 1e-12, 2e-10, 1e-9, 1e-8])
def test_matrices_near_rotations_are_projected_like_others(noise):
    rng = np.random.default_rng(0)
    R = so.random(rng, 50, 3) + noise * rng.uniform(-1.0, 1.0, (50, 3, 3))
    U, _, Vt = np.linalg.svd(R)
    nearest = so.project(R)
    np.testing.assert_allclose(nearest, U @ Vt, rtol=0, atol=1e-14)  # of the SVD
    assert so.worst_defect(nearest)[1] < 1e-15


@pytest.mark.parametrize("d", [2, 3])
def test_project_of_singular_and_reflected_blocks(d):
    blocks = np.stack([np.zeros((d, d)), np.diag([1.0] * (d - 1) + [-1.0]), np.eye(d) * 1e-200])
    P = so.project(blocks)
    assert so.worst_defect(P)[1] < 1e-12


@given(seeds, dimensions)
def test_angle_is_symmetric_and_invariant(seed, d):
    rng = rng_of(seed)
    R, S = so.random(rng, 3, d), so.random(rng, 3, d)
    np.testing.assert_allclose(so.angle(np.swapaxes(R, 1, 2)), so.angle(R), rtol=0, atol=1e-13)
    turned = S @ R @ np.swapaxes(S, 1, 2)
    np.testing.assert_allclose(so.angle(turned), so.angle(R), rtol=0, atol=1e-7)


def test_worst_defect_names_the_worst_matrix():
    R = np.tile(np.eye(3), (4, 1, 1))
    R[2, 0, 1] = 1e-3
    index, defect = so.worst_defect(R)
    assert index == 2
    assert 1e-3 <= defect < 1.1e-3
    R[1] = np.diag([1.0, 1.0, -1.0])
    assert so.worst_defect(R) == (1, np.inf)
    R[0, 0, 0] = np.nan
    assert so.worst_defect(R) == (0, np.inf)
    assert so.worst_defect(np.empty((0, 3, 3))) == (0, 0.0)


def test_nearest_to_rounding_touches_only_what_is_off():
    R = so.random(np.random.default_rng(0), 3, 3)
    off = R.copy()
    off[1] *= 1.0 + 1e-8
    cleaned = so.nearest_to_rounding(off)
    np.testing.assert_array_equal(cleaned[[0, 2]], R[[0, 2]])
    np.testing.assert_allclose(cleaned[1], R[1], rtol=0, atol=1e-15)
    assert so.nearest_to_rounding(R) is R


@pytest.mark.parametrize("d", [2, 3])
def test_random_rotations_have_the_uniform_moments(d):
    R = so.random(np.random.default_rng(1), 20000, d)
    assert so.worst_defect(R)[1] < 1e-13
    assert np.abs(R.mean(axis=0)).max() < 0.03
    np.testing.assert_allclose((R**2).mean(axis=0), np.full((d, d), 1 / d), rtol=0, atol=0.02)


def test_determinants_agree_with_lapack():
    A = np.random.default_rng(2).standard_normal((7, 3, 3))
    np.testing.assert_allclose(so.determinants(A), np.linalg.det(A), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        so.determinants(A[:, :2, :2]), np.linalg.det(A[:, :2, :2]), rtol=1e-12, atol=1e-14
    )


def test_polar_factors_of_singular_blocks_are_orthonormal():
    rng = np.random.default_rng(0)
    Z = rng.standard_normal((4, 5, 3))
    Z[1, :, 2] = Z[1, :, 0]
    Z[2] = 0.0
    Z[3, :, 1:] = 1e-12 * Z[3, :, :1]
    with np.errstate(all="raise"):
        Y = so.orthonormal(Z)
    np.testing.assert_allclose(np.swapaxes(Y, 1, 2) @ Y, np.tile(np.eye(3), (4, 1, 1)), atol=1e-12)
    U, _, V = np.linalg.svd(Z[0], full_matrices=False)
    np.testing.assert_allclose(Y[0], U @ V, atol=1e-13)
