"""Rotations are those of quaternions over their squared norms, to a few units in the last place."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from certpgo.errors import InputError
from certpgo.io.exact import circle, quaternion
from certpgo.linalg import rotations as so

EPSILON = 2.0**-52
numbers = st.floats(-1e3, 1e3).filter(lambda x: x == 0.0 or abs(x) > 1e-100)


def exact_rotation(q):
    """R(q)/|q|^2 in Fractions."""
    x, y, z, w = (Fraction(float(v)) for v in q)
    n = x * x + y * y + z * z + w * w
    R = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z],
    ]
    return np.array([[float(v / n) for v in row] for row in R])


@given(st.tuples(numbers, numbers, numbers, numbers).filter(any))
def test_quaternion_rotations_equal_fractions(q):
    found = quaternion.rotations(np.array([q]))[0]
    np.testing.assert_allclose(found, exact_rotation(q), rtol=0, atol=4 * EPSILON)


@pytest.mark.parametrize("scale", [4.0, 2.0**-500, 2.0**600, 5e-324, 3.0])
def test_the_norm_does_not_matter(scale):
    q = np.array([[1.0, -2.0, 3.0, 4.0]])
    R, S = quaternion.rotations(q), quaternion.rotations(q * scale)
    np.testing.assert_allclose(R, S, rtol=0, atol=2 * EPSILON)


def test_quaternions_are_x_y_z_w():
    q = np.random.default_rng(0).standard_normal((50, 4))
    expected = Rotation.from_quat(q).as_matrix()
    np.testing.assert_allclose(quaternion.rotations(q), expected, rtol=0, atol=1e-14)


def test_zero_quaternion_is_refused():
    with pytest.raises(InputError, match="must not be zero"):
        quaternion.rotations(np.array([[0.0, 0, 0, 1], [0, 0, 0, 0]]))


def test_roll_pitch_yaw_is_rz_ry_rx():
    angles = np.random.default_rng(0).uniform(-3, 3, (50, 3))
    found = quaternion.rotations(quaternion.from_roll_pitch_yaw(angles))
    expected = Rotation.from_euler("xyz", angles).as_matrix()
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("axis", "branch"),
    [([0.1, 0, 0], 3), ([3.1, 0, 0.1], 0), ([0.1, 3.1, 0], 1), ([0, 0.1, 3.1], 2)],
)
def test_shepperds_branches(axis, branch):
    R = so.exp(np.array([axis]))
    q = quaternion.from_matrices(R)
    assert np.argmax(np.abs(q[0])) == branch
    # The branch's own component is 4 |component|^2, so the whole is the unit one times 4 |it|.
    assert q[0, branch] == pytest.approx(np.linalg.norm(q[0]) ** 2 / 4, rel=1e-14)
    np.testing.assert_allclose(quaternion.rotations(q), R, rtol=0, atol=4 * EPSILON)


@given(st.integers(0, 2**32 - 1))
def test_matrices_survive_as_quaternions(seed):
    R = so.random(np.random.default_rng(seed), 20, 3)
    found = quaternion.rotations(quaternion.from_matrices(R))
    np.testing.assert_allclose(found, R, rtol=0, atol=1e-14)


def test_coarse_matrices_become_rotations_and_others_are_refused():
    R = np.round(so.random(np.random.default_rng(0), 20, 3), 5)
    assert so.worst_defect(quaternion.rotations(quaternion.from_matrices(R)))[1] < 1e-14
    for M in (2 * np.eye(3), np.diag([1.0, 1, -1]), np.zeros((3, 3)), np.eye(3) + 2e-3):
        with pytest.raises(InputError, match="rotation matrix"):
            quaternion.from_matrices(M[None])


def test_written_quaternions_are_unit_with_nonnegative_real_part():
    R = so.random(np.random.default_rng(0), 100, 3)
    q = quaternion.to_write(R)
    assert (q[:, 3] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, rtol=4 * EPSILON)
    np.testing.assert_allclose(quaternion.rotations(q), R, rtol=0, atol=1e-14)


def test_planar_rotations_equal_their_half_angles():
    theta = np.random.default_rng(0).uniform(-10, 10, 50)
    R = quaternion.planar_rotations(theta)
    for angle, found in zip(theta, R, strict=True):
        c, s = map(Fraction, circle.half_angle_pair(float(angle)))
        n = c * c + s * s
        cosine, sine = float((c * c - s * s) / n), float(2 * c * s / n)
        expected = [[cosine, -sine], [sine, cosine]]
        np.testing.assert_allclose(found, expected, rtol=0, atol=2 * EPSILON)


ANGLES = np.concatenate(
    [
        np.random.default_rng(0).uniform(-np.pi, np.pi, 2000),
        np.random.default_rng(1).uniform(-1e6, 1e6, 1000),
        np.pi * np.arange(-300, 300),
        np.pi / 2 * np.arange(-300, 300),
        10.0 ** np.random.default_rng(2).uniform(-320, 0, 300),
        [0.0, -0.0, 5e-324, 1e6, -1e6, 2.0**-27, np.nextafter(np.pi, 4)],
    ]
)


def test_batches_of_half_angles_equal_the_integer_series():
    c, s = circle.half_angles(ANGLES)
    pairs = np.array([circle.half_angle_pair(float(theta)) for theta in ANGLES])
    np.testing.assert_array_equal(c, pairs[:, 0])
    np.testing.assert_array_equal(s, pairs[:, 1])


def test_half_angles_are_within_an_ulp_of_the_c_library():
    c, s = circle.half_angles(ANGLES)
    assert (np.abs(c - np.cos(ANGLES / 2)) <= np.spacing(np.abs(c))).all()
    assert (np.abs(s - np.sin(ANGLES / 2)) <= np.spacing(np.abs(s))).all()


def test_known_half_angles():
    # sin and cos of 1 to 40 digits: 0.8414709848078965066525023216302989996226,
    # 0.5403023058681397174009366074429766037323.
    c, s = circle.half_angle_pair(2.0)
    assert c == float(Fraction("0.5403023058681397174009366074429766037323"))
    assert s == float(Fraction("0.8414709848078965066525023216302989996226"))
    assert circle.half_angle_pair(0.0) == (1.0, 0.0)
    # cos at the double nearest pi/2 is the distance of the two.
    assert circle.half_angle_pair(np.pi) == (6.123233995736766e-17, 1.0)


def test_double_double_pairs_are_far_better_than_their_margin():
    theta = ANGLES[np.abs(ANGLES) > 1e-100]
    cosine, sine = circle._double_double_pairs(0.5 * theta)
    for k in range(0, len(theta), 7):
        bits = 600
        exact = circle._series(float(theta[k]), bits)
        for (high, low), value in zip((cosine, sine), exact, strict=True):
            found = Fraction(float(high[k])) + Fraction(float(low[k]))
            true = Fraction(value, 1 << bits)
            assert abs(found - true) < abs(true) * Fraction(1, 1 << 90)


@pytest.mark.parametrize("theta", [1e6 + 1, -2e6, np.inf, np.nan])
def test_absurd_angles_are_refused(theta):
    with pytest.raises(InputError, match="radians"):
        circle.half_angle_pair(theta)
    with pytest.raises(InputError, match="radians"):
        circle.half_angles(np.array([0.0, theta]))
