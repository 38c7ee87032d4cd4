"""The rotation groups SO(2) and SO(3), in batches.

Rotations are arrays (..., d, d). Tangent vectors are body-frame angles, (..., 1) for d = 2 and
(..., 3) for d = 3, in radians: a rotation R moves to R exp(v).
"""

from __future__ import annotations

import math

import numpy as np

from certpgo.errors import InputError
from certpgo.linalg import compiled
from certpgo.linalg.arrays import FloatArray

#: Largest entry of R^T R - I of a rotation matrix: six decimals are enough.
DEFECT_TOLERANCE = 1e-5

#: Entries of R^T R - I up to which their squares are far below rounding.
NEARLY = 1e-9
#: Eigenvalues of Z^T Z, over the largest, that may be rounding.
SINGULAR = 1e-13
#: Entries of R^T R - I up to this are rounding of doubles and kept.
ROUNDING_DEFECT = 1e-14


def tangent_dim(d: int) -> int:
    """Dimension of SO(d): 1 for d = 2, 3 for d = 3."""
    return d * (d - 1) // 2


def hat(v: FloatArray) -> FloatArray:
    """Skew-symmetric matrices (..., d, d) of tangent vectors (..., 1) or (..., 3)."""
    v = np.asarray(v, dtype=np.float64)
    if v.shape[-1] == 1:
        out = np.zeros((*v.shape[:-1], 2, 2))
        out[..., 0, 1] = -v[..., 0]
        out[..., 1, 0] = v[..., 0]
        return out
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1] = -v[..., 2]
    out[..., 0, 2] = v[..., 1]
    out[..., 1, 0] = v[..., 2]
    out[..., 1, 2] = -v[..., 0]
    out[..., 2, 0] = -v[..., 1]
    out[..., 2, 1] = v[..., 0]
    return out


def vee(A: FloatArray) -> FloatArray:
    """Tangent vector of the skew part (A - A^T)/2; inverse of `hat` on skew matrices."""
    A = np.asarray(A, dtype=np.float64)
    if A.shape[-1] == 2:
        return 0.5 * (A[..., 1, 0] - A[..., 0, 1])[..., None]
    return 0.5 * np.stack(
        [
            A[..., 2, 1] - A[..., 1, 2],
            A[..., 0, 2] - A[..., 2, 0],
            A[..., 1, 0] - A[..., 0, 1],
        ],
        axis=-1,
    )


def exp(v: FloatArray) -> FloatArray:
    """Rotations (..., d, d) by the angles of tangent vectors (Rodrigues' formula)."""
    v = np.asarray(v, dtype=np.float64)
    if v.shape[-1] == 1:
        c, s = np.cos(v[..., 0]), np.sin(v[..., 0])
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    theta = np.linalg.norm(v, axis=-1)[..., None, None]
    K = hat(v)
    a = np.sinc(theta / np.pi)
    b = 0.5 * np.sinc(theta / (2 * np.pi)) ** 2
    R: FloatArray = np.eye(3) + a * K + b * (K @ K)
    return R


def turned(R: FloatArray, v: FloatArray, *, left: bool = False) -> FloatArray:
    """R exp(v), or exp(v) R on the ``left``, for rotations (n, d, d) and tangents v (n, p)."""
    if not compiled.AVAILABLE:
        return exp(v) @ R if left else R @ exp(v)
    R, v = np.ascontiguousarray(R), np.ascontiguousarray(v)
    out = np.empty_like(R)
    compiled.kernel.turn(R, v, R.shape[-1], left, out)
    return out


def angle(R: FloatArray) -> FloatArray:
    """Rotation angles (...,) in [0, pi], accurate near both 0 and pi."""
    R = np.asarray(R, dtype=np.float64)
    sine = np.linalg.norm(vee(R), axis=-1)
    trace = np.trace(R, axis1=-2, axis2=-1)
    cosine = 0.5 * trace if R.shape[-1] == 2 else 0.5 * (trace - 1.0)
    return np.asarray(np.arctan2(sine, cosine))


def log(R: FloatArray) -> FloatArray:
    """Tangent vectors of norm at most pi with exp(log(R)) = R; at pi, one of the two."""
    R = np.asarray(R, dtype=np.float64)
    skew = vee(R)
    if R.shape[-1] == 2:
        return np.asarray(np.arctan2(skew, 0.5 * np.trace(R, axis1=-2, axis2=-1)[..., None]))
    theta = angle(R)[..., None]
    near_pi = theta[..., 0] > 3.0
    v = skew / np.sinc(np.where(theta > 3.0, 0.0, theta) / np.pi)
    if np.any(near_pi):
        v[near_pi] = _log_near_pi(R[near_pi], skew[near_pi], theta[near_pi])
    return v


def _log_near_pi(R: FloatArray, skew: FloatArray, theta: FloatArray) -> FloatArray:
    # The skew part vanishes; the axis is in the symmetric part,
    # (R + R^T)/2 = cos I + (1 - cos) a a^T, whose largest column is safe to normalize.
    cosine = np.cos(theta)[..., None]
    outer = 0.5 * (R + np.swapaxes(R, -1, -2)) - cosine * np.eye(3)
    k = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    axis = np.take_along_axis(outer, k[:, None, None], axis=-1)[..., 0]
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    sign = np.where(np.sum(axis * skew, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return np.asarray(sign * theta * axis)


def project(A: FloatArray) -> FloatArray:
    """The rotations nearest to matrices (n, d, d) in the Frobenius norm.

    The polar factor by Newton's iteration (Higham, Functions of Matrices, 8.3) on the whole batch,
    or near rotations by a step of Newton and Schulz (8.20), which squares the distance; blocks with
    determinant near or below zero, where the nearest rotation is not the polar factor, by singular
    value decomposition.
    """
    A = np.asarray(A, dtype=np.float64)
    if A.shape[-1] == 2:
        a, b = A[..., 0, 0] + A[..., 1, 1], A[..., 1, 0] - A[..., 0, 1]
        r = np.hypot(a, b)
        safe = np.where(r > 0.0, r, 1.0)
        c, s = np.where(r > 0.0, a / safe, 1.0), np.where(r > 0.0, b / safe, 0.0)
        return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    flat = A.reshape(-1, 3, 3)
    if worst_defect(flat)[1] < NEARLY:
        return np.asarray(A + 0.5 * A @ (np.eye(3) - np.swapaxes(A, -1, -2) @ A))
    X = np.ascontiguousarray(np.moveaxis(flat, 0, -1))
    scale = np.sqrt(np.einsum("ijn,ijn->n", X, X))
    determinant = determinants(flat)
    regular = determinant > 1e-3 * scale**3
    out = np.empty_like(flat)
    if np.any(regular):
        out[regular] = np.moveaxis(_polar(X[:, :, regular]), -1, 0)
    if not np.all(regular):
        U, _, Vt = np.linalg.svd(flat[~regular])
        U[:, :, 2] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        out[~regular] = U @ Vt
    return out.reshape(A.shape)


def inverse_square_roots(M: FloatArray) -> FloatArray:
    """M^(-1/2) for symmetric positive definite matrices (k, d, d), in closed form.

    With U = M^(1/2) and the invariants of U from the eigenvalues of M, the Cayley-Hamilton theorem
    gives U as a quotient of polynomials of M (Franca 1989), and then the inverse of U.
    """
    d = M.shape[-1]
    identity = np.eye(d)
    if d == 2:
        determinant = np.sqrt(determinants(M))[:, None, None]
        trace = np.sqrt(np.trace(M, axis1=1, axis2=2)[:, None, None] + 2.0 * determinant)
        return np.asarray(((trace**2 - determinant) * identity - M) / (trace * determinant))
    roots = np.sqrt(np.linalg.eigvalsh(M))
    a, b, c = roots.T[:, :, None, None]
    first, second, third = a + b + c, a * b + b * c + c * a, a * b * c
    U = (first * third * identity + (first**2 - second) * M - M @ M) / (first * second - third)
    return np.asarray((M - first * U + second * identity) / third)


def determinants(A: FloatArray) -> FloatArray:
    """Determinants (n,) of matrices (n, d, d)."""
    if A.shape[-1] == 2:
        return np.asarray(A[:, 0, 0] * A[:, 1, 1] - A[:, 0, 1] * A[:, 1, 0])
    a, b, c = np.moveaxis(A, 0, -1)
    return np.asarray(
        a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


def is_mostly_reflected(blocks: FloatArray) -> bool:
    """Whether most matrices (n, d, d) have a negative determinant.

    A basis is known only up to reflection; the right one makes most determinants positive.
    """
    return bool(np.median(np.sign(determinants(blocks))) < 0)


def _polar(X: FloatArray) -> FloatArray:
    """Orthogonal polar factors of matrices (3, 3, n) with positive determinant."""
    X = X * np.sqrt(3.0 / np.einsum("ijn,ijn->n", X, X))
    for _ in range(30):
        C, determinant = _cofactors(X)
        Y = C / determinant
        change = np.abs(Y - X).max()
        if change > 0.5:  # far away: balance the norms of X and its inverse
            gamma = (np.einsum("ijn,ijn->n", Y, Y) / np.einsum("ijn,ijn->n", X, X)) ** 0.25
            X, Y = gamma * X, Y / gamma
        X = 0.5 * (X + Y)
        if change < 1e-9:  # convergence is quadratic
            break
    return X


def _cofactors(X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Cofactor matrices (3, 3, n) and determinants (n,) of matrices (3, 3, n)."""
    C = np.empty_like(X)
    for i in range(3):
        p, q = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            C[i, j] = X[p, r] * X[q, s] - X[p, s] * X[q, r]
    return C, np.einsum("jn,jn->n", X[0], C[0])


def worst_defect(R: FloatArray) -> tuple[int, float]:
    """Index of the matrix (n, d, d) farthest from being a rotation, and how far.

    The distance is the largest entry of |R^T R - I|; infinite for a negative determinant or an
    entry that is not finite.
    """
    if len(R) == 0:
        return 0, 0.0
    if compiled.AVAILABLE:
        return compiled.kernel.worst_defect(np.ascontiguousarray(R, dtype=np.float64), R.shape[-1])
    with np.errstate(invalid="ignore", over="ignore"):
        defect, determinant = _defects(R), determinants(R)
    defect = np.where(np.isfinite(defect) & (determinant > 0.0), defect, np.inf)
    worst = int(np.argmax(defect))
    return worst, float(defect[worst])


def rotation_defect(R: FloatArray) -> float:
    """An upper bound on the Frobenius distance of stored matrices (n, d, d) from SO(d).

    The polar factor Q of A satisfies |A - Q| <= |A^T A - I| / (1 + sigma_min(A)).
    """
    d = R.shape[-1]
    return 0.51 * float(d) * (worst_defect(R)[1] + 8.0 * float(np.finfo(float).eps))


def shortfall(R: FloatArray, defect: float) -> str:
    """In what a matrix (d, d) fails to be a rotation, given its defect."""
    if np.isfinite(defect):
        return f"not a rotation, off by {defect:.1e}"
    determinant = float(determinants(R[None])[0]) if np.abs(R).max() < 1e100 else np.nan
    if determinant <= 0.0:
        return f"not a rotation, its determinant is {determinant:.2g}"
    return "not a rotation, its entries are too large"


def _defects(R: FloatArray) -> FloatArray:
    """Largest entry of |R^T R - I| of each matrix (n, d, d)."""
    d = R.shape[-1]
    gram = np.einsum("nij,nik->jkn", R, R)
    return np.asarray(np.abs(gram - np.eye(d)[:, :, None]).reshape(d * d, -1).max(axis=0))


def nearest_to_rounding(R: FloatArray) -> FloatArray:
    """R (n, d, d) with matrices that are off by more than rounding projected to SO(d).

    Others stay the same, bit for bit.
    """
    if worst_defect(R)[1] <= ROUNDING_DEFECT:
        return R
    off = _defects(R) > ROUNDING_DEFECT
    out = R.copy()
    out[off] = project(R[off])
    return out


def random(rng: np.random.Generator, n: int, d: int) -> FloatArray:
    """Uniform rotations, (n, d, d)."""
    if d == 2:
        return exp(rng.uniform(-np.pi, np.pi, (n, 1)))
    q = rng.standard_normal((n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return _of_unit_spinors(q)


def langevin(rng: np.random.Generator, concentration: float, m: int, d: int) -> FloatArray:
    """Exact samples of the isotropic Langevin distribution about I, (m, d, d); thesis A.1.

    The density is proportional to exp(k tr R): for large k the rotation vector has a standard
    deviation of 1/sqrt(2 k) per axis; in 2D angles have a von Mises distribution of concentration
    2 k. The thesis' Lang(I, 1/sigma_R^2), eq. 2.5, is k = 1/sigma_R^2: sigma_R/sqrt(2) per axis.

    A rotation by an angle t is a unit spinor (v, w) with |v| = |sin(t/2)|, on the circle for d = 2
    and the 3-sphere for d = 3, and tr R = d - 4 |v|^2. So spinors have Bingham's density
    exp(-4 k |v|^2), sampled by rejection from normalized Gaussian vectors (Kent, Ganeiber, Mardia,
    "A new method to simulate the Bingham and related distributions", 2013). With q = 2 or 4
    coordinates, any b in (0, q] and u = 1 + 8 k |v|^2 / b, these have a density proportional to
    u^(-q/2), and

        exp(-4 k |v|^2) = exp(-b (u - 1) / 2) <= exp((b - q) / 2) (q / b)^(q/2) u^(-q/2),

    as the quotient of both sides is largest at u = q / b. The b of highest acceptance is the root
    of 1/b + (q - 1)/(b + 8 k) = 1: it decreases from q at k = 0, where all are accepted, to 1 as k
    grows, and the acceptance to sqrt(e/(2 pi)) = 0.658 for d = 2, sqrt(e^3/(32 pi)) = 0.447 for 3.

    Parameters
    ----------
    concentration : k, from 0 (uniform) to infinity (the identity)

    Raises
    ------
    InputError
        The concentration is negative or not a number.
    """
    if not concentration >= 0.0:
        raise InputError(f"the concentration must not be negative: {concentration}")
    k8, q = 8.0 * concentration, 2 * d - 2
    if np.isinf(k8):
        return np.broadcast_to(np.eye(d), (m, d, d)).copy()
    p = 0.5 * (k8 - q)
    root = np.hypot(p, np.sqrt(k8))
    b = k8 / (root + p) if p > 0.0 else root - p
    out, missing = np.empty((m, q)), np.arange(m)
    while len(missing):
        x = rng.standard_normal((len(missing), q))
        x[:, :-1] /= np.sqrt(1.0 + k8 / b)
        x /= np.linalg.norm(x, axis=1, keepdims=True)
        u = 1.0 + k8 / b * np.einsum("ma,ma->m", x[:, :-1], x[:, :-1])
        accepted = rng.random(len(x)) <= (b * u / q) ** (q // 2) * np.exp(0.5 * (q - b * u))
        out[missing[accepted]] = x[accepted]
        missing = missing[~accepted]
    return _of_unit_spinors(out)


def _of_unit_spinors(x: FloatArray) -> FloatArray:
    """Rotations of (v, w) = (axis sin(t/2), cos(t/2)), (n, 2) or (n, 4)."""
    K = hat(x[:, :-1])
    R: FloatArray = np.eye(K.shape[-1]) + 2.0 * x[:, -1, None, None] * K + 2.0 * (K @ K)
    return R


def aligning(g: FloatArray, h: FloatArray) -> FloatArray:
    """(k, d, d) rotations by the smallest angle from unit vectors g (k, d) to one h (d,)."""
    d = len(h)
    if d == 2:
        angle = np.arctan2(h[1], h[0]) - np.arctan2(g[:, 1], g[:, 0])
        return exp(angle[:, None])
    axis = np.cross(g, h)
    sine, cosine = np.linalg.norm(axis, axis=1), g @ h
    across = np.cross(h, np.eye(3)[np.argmin(np.abs(h))])
    # Opposite vectors have no axis of their own.
    unit = np.where(sine[:, None] > 0.0, axis / np.maximum(sine, 1e-300)[:, None], across)
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    return exp(np.arctan2(sine, cosine)[:, None] * unit)


def tangent_basis(Y: FloatArray) -> FloatArray:
    """(n, q, r, d) orthonormal bases of the tangent spaces of St(r, d) at blocks (n, r, d).

    Rotations within the columns' span, Y hat(e_k) / sqrt(2), then directions out of it.
    """
    n, r, d = Y.shape
    generators = hat(np.eye(tangent_dim(d))) / math.sqrt(2.0)
    within = Y[:, None] @ generators
    if r == d:
        return within
    normal = np.linalg.qr(Y, mode="complete")[0][:, :, d:]
    out = np.einsum("nra,bc->nabrc", normal, np.eye(d)).reshape(n, -1, r, d)
    return np.concatenate([within, out], axis=1)


def orthonormal(Z: FloatArray) -> FloatArray:
    """The polar factors of blocks (n, r, d); of a singular block one of several."""
    values, vectors = np.linalg.eigh(np.swapaxes(Z, 1, 2) @ Z)
    singular = ~(values[:, 0] > SINGULAR * values[:, -1])
    sizes = np.sqrt(np.where(singular[:, None], 1.0, values))
    root = (vectors / sizes[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    found = np.asarray(Z @ root)
    if singular.any():
        left, _, right = np.linalg.svd(Z[singular], full_matrices=False)
        found[singular] = left @ right
    return found
