"""Costs of the register recomputed by NumPy and SciPy alone.

    python -m reports.studies.optima_by_scipy [NAME ...]

For every pose graph whose proof is carried and whose g2o file is here: F, or g2o's chi^2, of the
estimate in the proof, from the file's numbers as the few lines below read them; and for small
graphs the cost at which `scipy.optimize.least_squares` ends, from that estimate after a shake. No
code of the package computes these; it only says which entries there are and where their files are.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_array
from scipy.spatial.transform import Rotation

from certpgo.optima import Optimum, Register
from certpgo.optima.verifying import local_file

#: Poses up to which the cost is minimised too, and the size of the shake.
SMALL, SHAKE = 130, 1e-2
#: Largest relative difference between costs of the same estimate.
SAME = 1e-9
TAGS = {"EDGE_SE2": 3, "EDGE_SE3:QUAT": 6}


@dataclass
class Edges:
    """Measurements of a g2o file: ends, translations, rotations, information."""

    i: np.ndarray
    j: np.ndarray
    t: np.ndarray
    R: np.ndarray
    information: np.ndarray

    @property
    def d(self) -> int:
        """Dimension of space."""
        return self.t.shape[1]


def read_g2o(path: Path) -> Edges:
    """The edges of a file, its nodes numbered by ascending ids."""
    found = []
    for line in path.read_text().splitlines():
        words = line.split()
        if not words or words[0] not in TAGS:
            continue
        p = TAGS[words[0]]
        numbers = np.array(words[3:], dtype=float)
        pose, upper = numbers[: 3 if p == 3 else 7], numbers[3 if p == 3 else 7 :]
        Omega = np.full((p, p), np.nan)
        if len(upper):
            Omega[np.triu_indices(p)] = upper
            Omega.T[np.triu_indices(p)] = upper
        d = 2 if p == 3 else 3
        R = planar(pose[2]) if d == 2 else Rotation.from_quat(pose[3:]).as_matrix()
        found.append((int(words[1]), int(words[2]), pose[:d], R, Omega))
    i, j, t, R, Omega = map(np.array, zip(*found, strict=True))
    ids = np.unique([i, j])
    return Edges(np.searchsorted(ids, i), np.searchsorted(ids, j), t, R, Omega)


def planar(theta: float) -> np.ndarray:
    """A rotation of the plane."""
    return np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])


def estimate_in(proof: Path) -> tuple[np.ndarray, np.ndarray]:
    """Rotations and translations of the estimate in a proof file."""
    with np.load(proof) as archive:
        q, t = archive["rotations"], archive["translations"]
    if q.shape[1] == 4:
        return Rotation.from_quat(q).as_matrix(), t
    return np.array([planar(2.0 * np.arctan2(s, c)) for c, s in q]), t


def chordal(edges: Edges, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Residuals whose squares add up to F, with the weights of SE-Sync."""
    d, Omega = edges.d, edges.information
    moved = np.linalg.inv(Omega[:, :d, :d])
    tau = d / np.trace(moved, axis1=1, axis2=2)
    if d == 2:
        kappa = Omega[:, 2, 2]
    else:
        kappa = 3.0 / (2.0 * np.trace(np.linalg.inv(Omega[:, 3:, 3:]), axis1=1, axis2=2))
    tau, kappa = (np.where(np.isnan(w), 1.0, w) for w in (tau, kappa))
    turned = R[edges.j] - R[edges.i] @ edges.R
    shifted = t[edges.j] - t[edges.i] - np.einsum("mab,mb->ma", R[edges.i], edges.t)
    m = len(tau)
    columns = [np.sqrt(kappa)[:, None] * turned.reshape(m, -1), np.sqrt(tau)[:, None] * shifted]
    return np.hstack(columns)


def g2o(edges: Edges, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Residuals whose squares add up to g2o's chi^2."""
    step = np.einsum("mba,mb->ma", R[edges.i], t[edges.j] - t[edges.i])
    shifted = np.einsum("mba,mb->ma", edges.R, step - edges.t)
    turned = np.swapaxes(edges.R, 1, 2) @ np.swapaxes(R[edges.i], 1, 2) @ R[edges.j]
    if edges.d == 2:
        angle = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])[:, None]
    else:
        q = Rotation.from_matrix(turned).as_quat()
        angle = q[:, :3] * np.where(q[:, 3:] < 0.0, -1.0, 1.0)
    roots = np.linalg.cholesky(edges.information)
    return np.einsum("mba,mb->ma", roots, np.hstack([shifted, angle]))


RESIDUALS = {"chordal": chordal, "g2o": g2o}


def minimised(edges: Edges, cost: str, R: np.ndarray, t: np.ndarray) -> float:
    """The cost at which least squares end, from an estimate that is shaken first."""
    n, d = t.shape
    turns = 1 if d == 2 else 3
    p = d + turns

    def posed(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moves = x.reshape(n, p)
        if d == 2:
            return R @ np.array([planar(theta) for theta in moves[:, 2]]), t + moves[:, :2]
        return R @ Rotation.from_rotvec(moves[:, 3:]).as_matrix(), t + moves[:, :3]

    def residuals(x: np.ndarray) -> np.ndarray:
        return RESIDUALS[cost](edges, *posed(x)).ravel()

    rows = len(residuals(np.zeros(n * p))) // len(edges.i)
    pattern = lil_array((rows * len(edges.i), n * p), dtype=bool)
    for k, ends in enumerate(zip(edges.i, edges.j, strict=True)):
        for node in ends:
            pattern[rows * k : rows * (k + 1), p * node : p * (node + 1)] = True
    start = SHAKE * np.random.default_rng(0).standard_normal(n * p)
    limits = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14, "max_nfev": 60}
    found = least_squares(residuals, start, jac_sparsity=pattern, **limits)
    return 2.0 * float(found.cost)


def candidates(register: Register, names: list[str] | None = None) -> list[tuple[Optimum, Path]]:
    """The entries that can be recomputed, with their files."""
    found = []
    for entry in register.optima:
        plain = entry.kind == "poses" and not (entry.sizes.points or entry.sizes.priors)
        if not (entry.kept and plain and entry.cost in RESIDUALS) or dict(entry.reading):
            continue
        if names and entry.name not in names:
            continue
        path = local_file(entry)
        if path is not None and "EDGE_SE" in path.read_text()[:10_000_000]:
            found.append((entry, path))
    return found


def recomputed(register: Register, entry: Optimum, path: Path) -> tuple[float, float | None]:
    """The cost of the kept estimate, and for small graphs of the minimum next to it."""
    edges = read_g2o(path)
    R, t = estimate_in(register.proof(entry))
    cost = float((RESIDUALS[entry.cost](edges, R, t) ** 2).sum())
    small = entry.sizes.poses <= SMALL
    return cost, minimised(edges, entry.cost, R, t) if small else None


def main() -> int:
    """Run the study."""
    register, worst = Register(), 0.0
    chosen = candidates(register, sys.argv[1:])
    for entry, path in chosen:
        cost, least = recomputed(register, entry, path)
        off = abs(cost - entry.upper) / max(entry.upper, 1e-12)
        worst = max(worst, off)
        shown = "" if least is None else f"  least squares {least:.12g}"
        print(f"{entry.name:32} {entry.cost:8} {entry.upper:.12g}  {cost:.12g}  {off:.1e}{shown}")
    print(f"{len(chosen)} entries, the largest relative difference {worst:.1e}")
    return int(worst > SAME)


if __name__ == "__main__":
    sys.exit(main())
