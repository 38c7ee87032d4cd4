"""How tight the relaxation of an inertial pose graph is: preintegrated measurements, known biases.

    python -m reports.studies.inertial --graphs 12 [--sizes N ...] [--starts N] [--out FILE]

Nodes are rotations R_k, positions p_k and velocities v_k; gravity is a vector g of known length.
Consecutive keyframes, dt apart, are measured by preintegration (Forster et al., TRO 2017, eq. 33),

    kappa |R_k+1 - R_k dR|_F^2 + nu |v_k+1 - v_k - g dt - R_k dv|^2
                               + tau |p_k+1 - p_k - v_k dt - g dt^2/2 - R_k dp|^2,

and loop closures by relative poses. This is a quadratic form tr(X Q X^T) of X = [R p v g] with
R_k^T R_k = I and |g| fixed: multipliers are symmetric blocks of rotations and one number of g, as
if gravity were a rotation with a single column. A stationary point is the global optimum if
S = Q - blkdiag(Lam) is positive semidefinite; if it is not, the relaxation is loose or the point
is not optimal, so the best of several descents is judged, the truth among their starts.

Prints, for each kind of graph, how many were tight, how many were not, and how large the smallest
eigenvalue of S after the d that vanish is, relative to the weight of the rotations.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from reports.studies._printing import print_table

G, DT = 9.81, 0.5
#: Standard deviations between two keyframes, rad, m/s and m, of a cheap sensor; and of loops.
GYRO, VELOCITY, POSITION = 0.005, 0.02, 0.01
LOOP_TURN, LOOP_MOVE = 0.02, 0.05
#: Eigenvalues below minus this share of the largest diagonal entry of Q are negative.
NEGATIVE = 1e-10
KINDS = {
    "as specified": {},
    "noise times 5": {"noise": 5.0},
    "noise times 20": {"noise": 20.0},
    "noise times 50": {"noise": 50.0},
    "gyroscope times 50": {"gyro": 50.0},
    "accelerometer times 50": {"accelerometer": 50.0},
    "loops times 20": {"loops": 20.0},
    "no acceleration": {"force": 0.0},
    "two loops": {"share": 0.0},
}


@dataclass(frozen=True)
class Inertial:
    """A graph as a quadratic form: residuals X B with X = [R_0 p_0 v_0 R_1 ... g], (3, 5 n + 1)."""

    n: int
    B: sp.csr_array
    truth: FloatArray

    @property
    def form(self) -> sp.csr_array:
        """(N, N) with F(X) = tr(X Q X^T)."""
        return sp.csr_array(self.B @ self.B.T)

    @property
    def rotations(self) -> IntArray:
        """(n, 3) the columns of X that are rotations."""
        return 5 * np.arange(self.n)[:, None] + np.arange(3)


def inertial_graph(
    rng: np.random.Generator,
    n: int,
    noise: float = 1.0,
    gyro: float = 1.0,
    accelerometer: float = 1.0,
    loops: float = 1.0,
    force: float = 1.0,
    share: float = 0.2,
) -> Inertial:
    """A smooth random flight around the origin, and measurements of it."""
    spin = np.cumsum(rng.normal(0.0, 0.15, (n, 3)), axis=0)
    R = [np.eye(3)]
    a = force * rng.standard_normal((n, 3))
    p, v = [np.zeros(3)], [force * rng.standard_normal(3)]
    for k in range(n - 1):
        R.append(R[-1] @ so.exp(DT * spin[k]))
        a[k] -= force * (0.3 * p[-1] + 0.8 * v[-1])
        p.append(p[-1] + DT * v[-1] + DT**2 / 2 * a[k])
        v.append(v[-1] + DT * a[k])
    g = np.array([0.0, 0.0, -G])
    X = np.column_stack([*(np.column_stack(x) for x in zip(R, p, v, strict=True)), g])
    columns: list[FloatArray] = []

    def measured(terms: dict[int, float], k: int, sigma: float, spread: float) -> None:
        """Add |sum of c X[:, j] - R_k (what it is in frame k, with noise)|^2 / sigma^2."""
        y = R[k].T @ sum(c * X[:, j] for j, c in terms.items())
        y = y + spread * sigma * rng.standard_normal(3)
        column = np.zeros(5 * n + 1)
        for j, c in terms.items():
            column[j] += c
        column[5 * k : 5 * k + 3] -= y
        columns.append(column / sigma)

    def turned(i: int, j: int, sigma: float, spread: float) -> None:
        """Add |R_j - R_i (their measured rotation)|^2 / (2 sigma^2)."""
        between = R[i].T @ R[j] @ so.exp(spread * sigma * rng.standard_normal(3))
        for c in range(3):
            column = np.zeros(5 * n + 1)
            column[5 * j + c] = 1.0
            column[5 * i : 5 * i + 3] -= between[:, c]
            columns.append(column / (np.sqrt(2.0) * sigma))

    for k in range(n - 1):
        a_k, b_k, last = 5 * k, 5 * k + 5, 5 * n
        turned(k, k + 1, GYRO, noise * gyro)
        by_force = noise * accelerometer
        measured({b_k + 4: 1.0, a_k + 4: -1.0, last: -DT}, k, VELOCITY, by_force)
        p_terms = {b_k + 3: 1.0, a_k + 3: -1.0, a_k + 4: -DT, last: -(DT**2) / 2}
        measured(p_terms, k, POSITION, by_force)
    pairs = [(0, n - 1), (0, n // 2)]
    pairs += [tuple(sorted(rng.choice(n, 2, replace=False))) for _ in range(int(share * n))]
    for i, j in pairs:
        turned(i, j, LOOP_TURN, noise * loops)
        measured({5 * j + 3: 1.0, 5 * i + 3: -1.0}, i, LOOP_MOVE, noise * loops)
    return Inertial(n, sp.csr_array(np.column_stack(columns)), X)


def tangents(graph: Inertial, X: FloatArray) -> sp.csr_array:
    """(3 N, t) from small turns, moves and a tilt of gravity to vec(dX), column by column."""
    N = X.shape[1]
    rows, columns, values = [], [], []

    def put(column: int, at: int, block: FloatArray) -> None:
        r, c = np.nonzero(np.ones_like(block))
        rows.append(3 * column + r)
        columns.append(at + c)
        values.append(block[r, c])

    at = 0
    for k, turning in enumerate(graph.rotations):
        for axis, column in enumerate(turning):
            put(column, at, -X[:, turning] @ so.hat(np.eye(3)[axis]))
        put(5 * k + 3, at + 3, np.eye(3))
        put(5 * k + 4, at + 6, np.eye(3))
        at += 9
    put(N - 1, at, np.linalg.svd(X[:, -1:])[0][:, 1:])
    shape = (3 * N, at + 2)
    flat = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
    return sp.csr_array(sp.coo_array(flat, shape=shape))


def moved(graph: Inertial, X: FloatArray, step: FloatArray) -> FloatArray:
    """The point after a step in the tangent space."""
    X = X.copy()
    for k, turning in enumerate(graph.rotations):
        X[:, turning] = X[:, turning] @ so.exp(step[9 * k : 9 * k + 3])
        X[:, 5 * k + 3] += step[9 * k + 3 : 9 * k + 6]
        X[:, 5 * k + 4] += step[9 * k + 6 : 9 * k + 9]
    g = X[:, -1] + np.linalg.svd(X[:, -1:])[0][:, 1:] @ step[-2:]
    X[:, -1] = G * g / np.linalg.norm(g)
    return X


def cost(graph: Inertial, X: FloatArray) -> float:
    """F(X)."""
    return float(np.sum((graph.B.T @ X.T) ** 2))


def multipliers(graph: Inertial, X: FloatArray) -> sp.csr_array:
    """(N, N) Lam: symmetric blocks of rotations, one number of gravity, nothing of p and v."""
    XQ = (graph.form @ X.T).T
    blocks: list[FloatArray] = []
    for turning in graph.rotations:
        Lam = X[:, turning].T @ XQ[:, turning]
        blocks += [0.5 * (Lam + Lam.T), np.zeros((2, 2))]
    blocks.append(np.array([[X[:, -1] @ XQ[:, -1] / G**2]]))
    return sp.csr_array(sp.block_diag(blocks))


def descend(graph: Inertial, X: FloatArray, steps: int = 100) -> FloatArray:
    """Levenberg-Marquardt, then Newton's steps as long as the gradient shrinks."""
    damping, F = 1e-4, cost(graph, X)
    for _ in range(steps):
        candidate = moved(graph, X, _step(graph, X, graph.form, damping)[0])
        lower = cost(graph, candidate)
        done = abs(F - lower) <= 1e-12 * F
        if lower <= F:
            X, F, damping = candidate, lower, damping / 10
        else:
            damping *= 10
        if done or damping > 1e6:
            break
    step, size = _step(graph, X, graph.form - multipliers(graph, X), 0.0)
    for _ in range(steps):
        candidate = moved(graph, X, step)
        step, smaller = _step(graph, candidate, graph.form - multipliers(graph, candidate), 0.0)
        if not smaller < 0.5 * size:
            break
        X, size = candidate, smaller
    return X


def _step(
    graph: Inertial, X: FloatArray, form: sp.csr_array, damping: float
) -> tuple[FloatArray, float]:
    """A step by a quadratic form's Hessian, and the length of the gradient of F."""
    T, of_rows = tangents(graph, X), sp.eye_array(3)
    gradient = T.T @ (sp.kron(graph.form, of_rows) @ X.T.ravel())
    H = sp.csc_array(T.T @ (sp.kron(form, of_rows) @ T))
    # The moves and turns of everything cost nothing.
    weight = damping * H.diagonal() + 1e-12 * H.diagonal().max()
    return spla.spsolve(H + sp.diags_array(weight), -gradient), float(np.linalg.norm(gradient))


def smallest(graph: Inertial, X: FloatArray) -> tuple[float, float]:
    """The least eigenvalue of S, and the least that does not vanish on X, over max |diag Q|."""
    S = (graph.form - multipliers(graph, X)).toarray()
    scale = graph.form.diagonal().max()
    moving = np.zeros(len(S))
    moving[3:-1:5] = 1.0  # one move of all positions costs nothing
    null = np.linalg.qr(np.column_stack([X.T, moving]))[0]
    values = np.linalg.eigvalsh(S)
    rest = np.linalg.eigvalsh(S + scale * null @ null.T)
    return float(values[0] / scale), float(rest[0] / scale)


def judged(
    rng: np.random.Generator, n: int, starts: int, **kind: float
) -> tuple[float, float, bool]:
    """The smallest eigenvalues at the best point, and whether only the truth led to it."""
    graph = inertial_graph(rng, n, **kind)
    best = descend(graph, graph.truth)
    from_truth = cost(graph, best)
    for _ in range(starts):
        X = moved(graph, graph.truth, rng.standard_normal(9 * n + 2))
        found = descend(graph, X)
        if cost(graph, found) < cost(graph, best) * (1 - 1e-9):
            best = found
    return *smallest(graph, best), cost(graph, best) < from_truth * (1 - 1e-9)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--graphs", type=int, default=12)
    parser.add_argument("--sizes", type=int, nargs="+", default=[7, 30, 100])
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    table = []
    for kind, settings in KINDS.items():
        for n in options.sizes:
            starts = options.starts if n <= 30 else 0
            found = [
                judged(np.random.default_rng((n, seed)), n, starts, **settings)
                for seed in range(options.graphs)
            ]
            least = np.array([value for value, _, _ in found])
            table.append(
                {
                    "graphs": kind,
                    "keyframes": n,
                    "tight": int((least > -NEGATIVE).sum()),
                    "not tight": int((least <= -NEGATIVE).sum()),
                    "below the truth's": sum(other for _, _, other in found),
                    "median smallest eigenvalue": f"{np.median([x for _, x, _ in found]):.1e}",
                    "least": f"{least.min():.1e}",
                }
            )
    print_table(table, options.out)


if __name__ == "__main__":
    main()
