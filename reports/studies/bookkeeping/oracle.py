"""The truth without the package: costs from the documented formulas, descents by SciPy.

Poses move to t_i + dt_i and R_i exp(w_i), points to t_i + dt_i. Arrays of poses may have leading
axes, so that all differences of a Jacobian are one evaluation.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from reports.studies.bookkeeping.drawing import Measurements, rotations

Array = Any
Poses = tuple[Array, Array]
#: Steps of central differences, over 1 or the extent of positions.
STEP = 1e-6
#: Rounding errors of a residual, over the size of what it is a difference of.
ROUNDING = 32.0 * np.finfo(float).eps
#: The same of what is called an exact fit.
EXACT = 2.0**-36
#: Relative decrease at which descents end.
SAME = 1e-13


@dataclass(frozen=True, eq=False)
class Cost:
    """A cost as a sum of squared residuals.

    Attributes
    ----------
    of : the measurements
    name : "chordal", "rotations" alone, "mahalanobis" in the rotations, "g2o" or "gtsam"
    """

    of: Measurements
    name: str = "chordal"

    def residuals(self, poses: Poses) -> Array:
        """(..., M) whose squares add up to the cost."""
        R, t = poses
        found = self._between(*self._relative(R, t))
        if not len(self.of.pairs):
            return found
        i, j = self.of.pairs.T
        lengths = np.linalg.norm(t[..., j, :] - t[..., i, :], axis=-1)
        off = np.sqrt(self.of.precisions) * (self.of.distances - lengths)
        return np.concatenate([found, off], axis=-1)

    def terms(self, poses: Poses) -> Array:
        """(m,) of the measurements, without distances."""
        found = self._between(*self._relative(*poses))
        return (found.reshape(self.of.m, -1) ** 2).sum(axis=1)

    def value(self, poses: Poses) -> float:
        """The cost."""
        r = self.residuals(poses)
        return float(r @ r)

    def rounding(self, poses: Poses) -> float:
        """What rounding may change in it, and in that of poses to the last digit as near."""
        delta = ROUNDING * self._reach(poses)
        value = self.value(poses)
        return float((delta * (2.0 * np.sqrt(value) + delta)).sum() + 1e-13 * value)

    def exact(self, poses: Poses) -> float:
        """What it costs at most where all residuals are called rounding."""
        return float(((EXACT * self._reach(poses)) ** 2).sum())

    def _reach(self, poses: Poses) -> Array:
        """Weighed sizes of what residuals are differences of."""
        t, (i, j) = np.linalg.norm(poses[1], axis=1), self.of.edges.T
        reach = t[i] + t[j] + np.linalg.norm(self.of.steps, axis=1) + self.of.far
        sizes = self._sizes * np.stack([reach, np.full_like(reach, 4.0)], axis=1)
        a, b = self.of.pairs.T
        more = np.sqrt(self.of.precisions) * (t[a] + t[b] + self.of.distances)
        return np.concatenate([sizes.ravel(), more])

    def descent(self, poses: Poses) -> tuple[float, Poses]:
        """The end of SciPy's Levenberg-Marquardt, and the cost there."""
        best, value = poses, self.value(poses)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            for _ in range(4):
                moved = self._descended(best)
                new = self.value(moved)
                if not new < value:
                    break
                decrease, best, value = value - new, moved, new
                if decrease <= SAME * new or new <= self.rounding(moved):
                    break
        return value, best

    def best(self, starts: Iterable[Poses]) -> tuple[float, Poses]:
        """The least cost at the ends of descents."""
        return min((self.descent(start) for start in starts), key=lambda end: end[0])

    def jacobian(self, poses: Poses, *, body: bool = False) -> Array:
        """(M, rows) derivatives of the residuals; ``body`` if translations are in poses' frames."""
        return self._slopes(poses, np.zeros(self.rows), body)

    @property
    def rows(self) -> int:
        """Numbers by which poses move."""
        of = self.of
        if self.name == "rotations":
            return (of.d * (of.d - 1) // 2) * of.n
        return of.n * of.d + (of.d * (of.d - 1) // 2) * int((~of.points).sum())

    @cached_property
    def _is_free(self) -> Array:
        """(rows,) zero for the numbers by which held nodes would move."""
        of, q = self.of, self.of.d * (self.of.d - 1) // 2
        free = ~np.isin(np.arange(of.n), of.held)
        turns = np.repeat(free[~of.points], q)
        return turns if self.name == "rotations" else np.r_[np.repeat(free, of.d), turns]

    def moved(self, poses: Poses, x: Array, *, body: bool = False) -> Poses:
        """Poses moved by x (..., rows): translations of all nodes first, then rotations."""
        (R, t), of = poses, self.of
        d, q = of.d, of.d * (of.d - 1) // 2
        steps = 0 if self.name == "rotations" else of.n * d
        x = x * self._is_free
        dt = x[..., :steps].reshape(*x.shape[:-1], -1, d)
        if body:
            dt = (R @ dt[..., None])[..., 0]
        turned = np.broadcast_to(R, (*x.shape[:-1], *R.shape)).copy()
        w = x[..., steps:].reshape(*x.shape[:-1], -1, q)
        turned[..., ~of.points, :, :] = turned[..., ~of.points, :, :] @ rotations(w, d)
        return turned, t + dt if steps else np.broadcast_to(t, (*x.shape[:-1], *t.shape))

    def _relative(self, R: Array, t: Array) -> Poses:
        i, j = self.of.edges.T
        back = np.swapaxes(R[..., i, :, :], -1, -2)
        v = (back @ (t[..., j, :] - t[..., i, :])[..., None])[..., 0]
        return back @ R[..., j, :, :], v

    def _between(self, Q: Array, v: Array) -> Array:
        """(..., m k) residuals by the formulas of the cost."""
        of, lead = self.of, Q.shape[:-3]
        if self.name in ("chordal", "rotations"):
            turned = np.sqrt(of.kappa)[:, None, None] * (Q - of.turns)
            flat = turned.reshape(*lead, of.m, -1)
            if self.name == "rotations":
                return flat.reshape(*lead, -1)
            moved = np.sqrt(of.tau)[:, None] * (v - of.steps)
            return np.concatenate([moved, flat], axis=-1).reshape(*lead, -1)
        back = np.swapaxes(of.turns, 1, 2)
        E, y = back @ Q, (back @ (v - of.steps)[..., None])[..., 0]
        E = np.where(of.turned[:, None, None], E, np.eye(of.d))
        if self.name == "mahalanobis":
            y = np.sqrt(of.tau)[:, None] * (v - of.steps)
            b = self._roots @ (2.0 * vector_part(E))[..., None]
            return np.concatenate([y, b[..., 0]], axis=-1).reshape(*lead, -1)
        e = g2o(E, y) if self.name == "g2o" else gtsam(E, y)
        return (self._roots @ e[..., None])[..., 0].reshape(*lead, -1)

    @cached_property
    def _roots(self) -> Array:
        """(m, k, k) symmetric roots of the information, zero where nothing is measured."""
        of, d = self.of, self.of.d
        block = of.information[:, d:, d:] if self.name == "mahalanobis" else of.information
        values, vectors = np.linalg.eigh(block)
        return (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]) @ np.swapaxes(vectors, 1, 2)

    @cached_property
    def _sizes(self) -> Array:
        """(m, 2) square roots of the largest weights of translations and of rotations."""
        of, d = self.of, self.of.d
        traces = np.diagonal(of.information, axis1=1, axis2=2)
        both = np.stack([traces[:, :d].sum(axis=1), 4.0 * traces[:, d:].sum(axis=1)], axis=1)
        return np.sqrt(both)

    def _units(self, poses: Poses) -> Array:
        """(rows,) steps of differences."""
        of, d = self.of, self.of.d
        steps = 0 if self.name == "rotations" else of.n * d
        extent = max(1.0, float(np.abs(poses[1] - poses[1].mean(axis=0)).max()))
        return STEP * np.r_[np.full(steps, extent), np.ones(self.rows - steps)]

    def _slopes(self, poses: Poses, x: Array, body: bool = False) -> Array:
        """(M, rows) derivatives where the poses have moved by x."""
        units = self._units(poses)
        ahead, behind = (
            self.residuals(self.moved(poses, x + sign * np.diag(units), body=body))
            for sign in (1.0, -1.0)
        )
        return ((ahead - behind) / (2.0 * units[:, None])).T

    def _descended(self, poses: Poses) -> Poses:
        rows = self.rows
        # SciPy's method takes no fewer residuals than unknowns.
        lack = max(0, rows - len(self.residuals(poses)))

        def at(x: Array) -> Array:
            return np.pad(self.residuals(self.moved(poses, x)), (0, lack))

        def slopes(x: Array) -> Array:
            return np.pad(self._slopes(poses, x), ((0, lack), (0, 0)))

        found = least_squares(
            at,
            np.zeros(rows),
            slopes,
            method="lm",
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            max_nfev=60,
        )
        return self.moved(poses, found.x)


def g2o(E: Array, y: Array) -> Array:
    """y, then the angle, or the vector part of the unit quaternion with w >= 0."""
    return np.concatenate([y, angle(E) if E.shape[-1] == 2 else vector_part(E)], axis=-1)


def gtsam(E: Array, y: Array) -> Array:
    """V^-1 y, then Log E."""
    w = angle(E)
    theta = np.linalg.norm(w, axis=-1, keepdims=True)
    small = theta < 1e-2
    safe = np.where(small, 1.0, theta)
    exact = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    c = np.where(small, 1.0 / 12.0 + theta**2 / 720.0 + theta**4 / 30240.0, exact)
    once = _crossed(w, y)
    return np.concatenate([y - 0.5 * once + c * _crossed(w, once), w], axis=-1)


def angle(E: Array) -> Array:
    """(..., 1) or (..., 3) Log E."""
    if E.shape[-1] == 2:
        return np.arctan2(E[..., 1, 0] - E[..., 0, 1], E[..., 0, 0] + E[..., 1, 1])[..., None]
    return Rotation.from_matrix(E.reshape(-1, 3, 3)).as_rotvec().reshape(*E.shape[:-2], 3)


def vector_part(E: Array) -> Array:
    """sin(theta / 2) times the axis, (..., 1) or (..., 3)."""
    if E.shape[-1] == 2:
        return np.sin(0.5 * angle(E))
    q = Rotation.from_matrix(E.reshape(-1, 3, 3)).as_quat(canonical=True)
    return q[:, :3].reshape(*E.shape[:-2], 3)


def _crossed(w: Array, y: Array) -> Array:
    if y.shape[-1] == 3:
        return np.cross(w, y)
    return w * np.stack([-y[..., 1], y[..., 0]], axis=-1)
