"""Exact rotations: from the numbers in a file to rotation matrices, without a square root.

For any non-zero quaternion of doubles R(q)/|q|^2 is exactly a rotation; the matrices returned here
are its entries to a few units in the last place. Other representations are converted to
quaternions, or in 2D half-angle pairs, by the fixed formulas below, on which proofs rely.
Quaternions are x y z w, the real part last.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from certpgo.errors import InputError
from certpgo.io.exact.circle import half_angles
from certpgo.linalg.arrays import BoolArray, FloatArray

#: How far a 3x3 matrix in a file may be from a rotation, entrywise in M^T M - I.
MATRIX_TOLERANCE = 1e-3

#: A quaternion whose norm is off 1 by more is worth a notice.
NORM_TOLERANCE = 1e-3

#: Numbers of a norm that is off 1 by more are no quaternion of a trajectory.
UNIT_TOLERANCE = 0.1


def rotations(q: FloatArray) -> FloatArray:
    """Rotations R(q)/|q|^2, (k, 3, 3), of quaternions (k, 4); InputError for a zero one."""
    largest = np.abs(q).max(axis=-1, initial=0.0)
    if not (largest > 0.0).all():
        raise InputError("a quaternion must not be zero")
    # Scaling by a power of two is exact, and keeps the squares in range.
    x, y, z, w = np.ldexp(q, -np.frexp(largest)[1][:, None]).T
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    norm = (xx + yy) + (zz + ww)
    R = np.empty((len(q), 3, 3))
    R[:, 0, 0] = ((ww + xx) - (yy + zz)) / norm
    R[:, 1, 1] = ((ww + yy) - (xx + zz)) / norm
    R[:, 2, 2] = ((ww + zz) - (xx + yy)) / norm
    for i, j, a, b in ((0, 1, x * y, z * w), (2, 0, x * z, y * w), (1, 2, y * z, x * w)):
        R[:, i, j] = 2.0 * (a - b) / norm
        R[:, j, i] = 2.0 * (a + b) / norm
    return R


def unit_rotations(poses: FloatArray, columns: Sequence[int]) -> FloatArray:
    """Rotations (k, 3, 3) of rows x y z qx qy qz qw (k, 7), whose quaternions are unit ones.

    Parameters
    ----------
    columns : (7,) of the file in which these numbers are

    Raises
    ------
    InputError
        A quaternion is zero, or far from a unit one, as other columns are read for it; the message
        says which would fit.
    """
    R = rotations(poses[:, 3:])
    far = _off_unit(poses[:, 3:])
    if not far.any():
        return R
    row, q = poses[np.argmax(far)], poses[np.argmax(far), 3:]
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(q))
    first, last = min(columns[3:]), max(columns[3:])
    said = f"a unit quaternion expected in columns {first} to {last}, not one of norm {norm:.3g}"
    in_order = row[np.argsort(columns)]
    for begin, orders in (
        (0, "qx qy qz qw x y z or qw qx qy qz x y z"),
        (3, "x y z qx qy qz qw or x y z qw qx qy qz"),
    ):
        place = sorted(columns)[begin : begin + 4]
        if place != sorted(columns[3:]) and not _off_unit(in_order[None, begin : begin + 4]).any():
            said += f"; columns {place[0]} to {place[-1]} are one, as in {orders}"
    raise InputError(said)


def _off_unit(q: FloatArray) -> BoolArray:
    with np.errstate(over="ignore"):
        return np.asarray(np.abs(np.linalg.norm(q, axis=-1) - 1.0) > UNIT_TOLERANCE)


def planar_rotations(theta: FloatArray) -> FloatArray:
    """Rotations (k, 2, 2) by angles (k,): [[c^2-s^2, -2cs], [2cs, c^2-s^2]]/(c^2+s^2).

    (c, s) are the correctly rounded cosine and sine of half the angle; see `half_angles`.
    """
    c, s = half_angles(theta)
    norm = c * c + s * s
    R = np.empty((len(theta), 2, 2))
    R[:, 0, 0] = R[:, 1, 1] = (c - s) * (c + s) / norm
    R[:, 1, 0] = 2.0 * c * s / norm
    R[:, 0, 1] = -R[:, 1, 0]
    return R


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """Hamilton products p q of quaternions (k, 4), in this fixed order of operations."""
    px, py, pz, pw = p.T
    qx, qy, qz, qw = q.T
    return np.stack(
        [
            (pw * qx + px * qw) + (py * qz - pz * qy),
            (pw * qy + py * qw) + (pz * qx - px * qz),
            (pw * qz + pz * qw) + (px * qy - py * qx),
            (pw * qw - px * qx) - (py * qy + pz * qz),
        ],
        axis=-1,
    )


def from_roll_pitch_yaw(angles: FloatArray) -> FloatArray:
    """Quaternions (k, 4) of Rz(yaw) Ry(pitch) Rx(roll), angles (k, 3) in that order, radians.

    Three half-angle pairs, multiplied as (q_z q_y) q_x.
    """
    c, s = half_angles(angles)
    zero = np.zeros(len(angles))
    qx = np.stack([s[:, 0], zero, zero, c[:, 0]], axis=-1)
    qy = np.stack([zero, s[:, 1], zero, c[:, 1]], axis=-1)
    qz = np.stack([zero, zero, s[:, 2], c[:, 2]], axis=-1)
    return product(product(qz, qy), qx)


def from_matrices(M: FloatArray, name: Callable[[int], str] | None = None) -> FloatArray:
    """Quaternions (k, 4), not normalized, of 3x3 matrices, by Shepperd's branches.

    The largest of the trace and the three diagonal entries selects the branch (ties in the order
    trace, xx, yy, zz), so that the corresponding component is not small. InputError for a matrix
    that is not a rotation to `MATRIX_TOLERANCE`, which names it if they have names.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # if not rotations
        defect = np.abs(np.swapaxes(M, -1, -2) @ M - np.eye(3)).max(axis=(-2, -1), initial=0.0)
        positive = np.einsum("ni,ni->n", np.cross(M[:, 0], M[:, 1]), M[:, 2]) > 0.0
    if (wrong := ~((defect <= MATRIX_TOLERANCE) & positive)).any():
        said = f"nine numbers of a rotation matrix, orthogonal to {MATRIX_TOLERANCE:g}"
        raise InputError(f"{name(int(np.argmax(wrong)))}: {said} expected" if name else said)
    xx, yy, zz = M[:, 0, 0], M[:, 1, 1], M[:, 2, 2]
    trace = (xx + yy) + zz
    x, y, z = M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]
    xy, xz, yz = M[:, 1, 0] + M[:, 0, 1], M[:, 0, 2] + M[:, 2, 0], M[:, 2, 1] + M[:, 1, 2]
    branches = np.array(
        [
            [x, y, z, 1.0 + trace],
            [1.0 + (xx - yy - zz), xy, xz, x],
            [xy, 1.0 + (yy - xx - zz), yz, y],
            [xz, yz, 1.0 + (zz - xx - yy), z],
        ]
    )
    choice = np.argmax([trace, xx, yy, zz], axis=0)
    q: FloatArray = branches[choice, :, np.arange(len(M))]
    return q


def off_norm(q: FloatArray) -> int:
    """How many quaternions (k, 4) have a norm off 1 by more than `NORM_TOLERANCE`."""
    with np.errstate(over="ignore"):
        return int(np.count_nonzero(np.abs(np.linalg.norm(q, axis=-1) - 1.0) > NORM_TOLERANCE))


def to_write(R: FloatArray) -> FloatArray:
    """Unit quaternions (k, 4) of rotations (k, 3, 3), or (k, 2, 2) about z, with w >= 0."""
    q = from_matrices(embedded(R))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[:, 3:] < 0.0, -q, q) + 0.0


def embedded_translations(t: FloatArray | None) -> FloatArray | None:
    """Translations (k, 3); planar ones (k, 2) are embedded at z = 0, None stays None."""
    if t is None or t.shape[-1] == 3:
        return t
    return np.pad(t, ((0, 0), (0, 1)))


def embedded(R: FloatArray) -> FloatArray:
    """Rotations (k, 3, 3); planar ones (k, 2, 2) are embedded about the z axis."""
    if R.shape[-1] == 3:
        return R
    out = np.zeros((len(R), 3, 3))
    out[:, :2, :2] = R
    out[:, 2, 2] = 1.0
    return out
