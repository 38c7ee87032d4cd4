"""The exponential and logarithm of similarities of space, x -> s R x + t.

Tangent vectors are [omega, upsilon, sigma]: the generator is [[sigma I + hat(omega), upsilon], [0,
0]], as in g2o and Sophus. With A = sigma I + hat(omega), exp(A) = s R and t = W upsilon for
W = (exp(A) - I) / A, whose eigenvalues are phi(z) = (exp(z) - 1) / z for z = sigma along omega, and
sigma +- i |omega| across: no cancellation near zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray

#: Step of central differences.
STEP = 1e-5


class Similarities(NamedTuple):
    """Rotations (k, d, d), translations (k, d) and scales (k,); x -> s R x + t."""

    rotations: FloatArray
    translations: FloatArray
    scales: FloatArray

    @classmethod
    def of(cls, R: FloatArray, t: FloatArray, s: FloatArray) -> Similarities:
        """Those of space, or of the plane as z = 0."""
        whole = np.tile(np.eye(3), (len(R), 1, 1))
        whole[:, : R.shape[1], : R.shape[1]] = R
        return cls(whole, np.pad(t, ((0, 0), (0, 3 - t.shape[1]))), s)

    def subset(self, chosen: IntArray) -> Similarities:
        """The chosen ones, in that order."""
        return Similarities(*(x[chosen] for x in self))

    def __matmul__(self, other: Similarities) -> Similarities:
        """Products, first the other."""
        R, t, s = self
        moved = t + s[:, None] * np.einsum("kab,kb->ka", R, other.translations)
        return Similarities(R @ other.rotations, moved, s * other.scales)

    @property
    def inverse(self) -> Similarities:
        """Inverses."""
        R, t, s = self
        back = -np.einsum("kba,kb->ka", R, t) / s[:, None]
        return Similarities(np.swapaxes(R, 1, 2), back, 1.0 / s)

    @property
    def logarithms(self) -> FloatArray:
        """Tangent vectors (k, 7) of those of space, with |omega| at most pi."""
        return log(*self)


def exp(v: FloatArray) -> Similarities:
    """Similarities of tangent vectors (k, 7)."""
    omega, upsilon, sigma = v[:, :3], v[:, 3:6], v[:, 6]
    along, across = _phi(omega, sigma)
    return Similarities(so.exp(omega), _apply(omega, upsilon, along, across), np.exp(sigma))


def log_derivatives(moved: Callable[[Similarities], Similarities]) -> FloatArray:
    """(k, 7, 7) of the logarithms of ``moved(exp(v))`` by v at zero: central differences."""
    columns = []
    for step in STEP * np.eye(7)[:, None]:
        ahead, back = moved(exp(step)).logarithms, moved(exp(-step)).logarithms
        columns.append((ahead - back) / (2.0 * STEP))
    return np.stack(columns, axis=2)


def log(R: FloatArray, t: FloatArray, s: FloatArray) -> FloatArray:
    """Tangent vectors (k, 7) of similarities, with |omega| at most pi."""
    omega, sigma = so.log(R), np.log(s)
    along, across = _phi(omega, sigma)
    upsilon = _apply(omega, t, 1.0 / along, 1.0 / across)
    return np.concatenate([omega, upsilon, sigma[:, None]], axis=1)


def _phi(omega: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Phi of sigma, and of sigma + i |omega|."""
    z = np.stack([sigma + 0j, sigma + 1j * np.linalg.norm(omega, axis=1)])
    near = np.abs(z) < 1e-3
    safe = np.where(near, 1.0, z)
    series = 1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0 * (1.0 + z / 5.0 * (1.0 + z / 6.0))))
    phi = np.where(near, series, np.expm1(safe) / safe)
    return phi[0].real, phi[1]


def _apply(omega: FloatArray, x: FloatArray, along: FloatArray, across: FloatArray) -> FloatArray:
    """The function of hat(omega) with these eigenvalues along and across omega, times x (k, 3)."""
    theta = np.linalg.norm(omega, axis=1)[:, None]
    axis = np.where(theta > 0.0, omega / np.where(theta > 0.0, theta, 1.0), [0.0, 0.0, 1.0])
    on_axis = axis * (axis * x).sum(axis=1, keepdims=True)
    off = x - on_axis
    turned = np.cross(axis, off)
    return np.asarray(
        along[:, None] * on_axis + across.real[:, None] * off + across.imag[:, None] * turned
    )
