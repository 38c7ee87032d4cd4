"""g2o's chi2 and minorants of single edges in ball arithmetic, and random edges for them.

Poses are given by what the measurement leaves unexplained, y and an angle or a unit quaternion
(w, b), w >= 0, so that the cost needs no inverse function. Numbers are flint's balls at `BITS`.
"""

from dataclasses import dataclass

import numpy as np
from flint import arb, ctx

from certpgo.graph import PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.costs.g2o import G2oCost

#: About 90 digits.
BITS = 300
ctx.prec = BITS


def balls(A):
    """Doubles, to the last bit, as nested lists."""
    return [balls(row) for row in A] if np.ndim(A) else arb(float(A))


def product(A, B):
    return [[inner(row, column) for column in zip(*B, strict=True)] for row in A]


def applied(A, x):
    return [sum(a * b for a, b in zip(row, x, strict=True)) for row in A]


def inner(x, y):
    return sum(a * b for a, b in zip(x, y, strict=True))


def transposed(A):
    return [list(column) for column in zip(*A, strict=True)]


def inverse_transposed(A):
    """Of a 3 x 3 matrix: its cofactors over its determinant."""
    C = [
        [
            A[(i + 1) % 3][(j + 1) % 3] * A[(i + 2) % 3][(j + 2) % 3]
            - A[(i + 1) % 3][(j + 2) % 3] * A[(i + 2) % 3][(j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    determinant = inner(A[0], C[0])
    return [[x / determinant for x in row] for row in C]


def nearest_rotation(R):
    """The polar factor of a stored matrix, by Newton's iteration; in the plane in closed form."""
    A = balls(R)
    if len(A) == 2:
        x, z = A[0][0] + A[1][1], A[1][0] - A[0][1]
        r = (x * x + z * z).sqrt()
        return [[x / r, -z / r], [z / r, x / r]]
    for _ in range(4):  # 1e-15, 1e-30, 1e-60, 1e-120
        B = inverse_transposed(A)
        A = [[(x + y) / 2 for x, y in zip(*rows, strict=True)] for rows in zip(A, B, strict=True)]
    return A


def planar(angle):
    """The rotation by an angle."""
    c, s = angle.cos(), angle.sin()
    return [[c, -s], [s, c]]


def normalized(q):
    norm = inner(q, q).sqrt()
    return [x / norm for x in q]


def spatial(q):
    """The rotation of a unit quaternion (w, x, y, z), as in textbooks."""
    w, x, y, z = q
    return [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]


def quadratic(Omega, e):
    return inner(e, applied(Omega, e))


def residual(R, t, v, Q):
    """g2o's residual of exact v and Q: y, then the angle, or b with w >= 0."""
    back = transposed(R)
    y, E = applied(back, [a - b for a, b in zip(v, t, strict=True)]), product(back, Q)
    if len(t) == 2:
        return [*y, arb.atan2(E[1][0] - E[0][1], E[0][0] + E[1][1])]
    # The largest of the four columns of q q^T, which are linear in E.
    trace = E[0][0] + E[1][1] + E[2][2]
    z = [E[2][1] - E[1][2], E[0][2] - E[2][0], E[1][0] - E[0][1]]
    rows = [[1 + trace, *z]]
    for i in range(3):
        row = [z[i]] + [E[i][j] + E[j][i] for j in range(3)]
        row[1 + i] = 1 + 2 * E[i][i] - trace
        rows.append(row)
    k = max(range(4), key=lambda k: float(rows[k][k].mid()))
    q = normalized(rows[k])
    return [*y, *([-x for x in q[1:]] if q[0] < 0 else q[1:])]


def minorant(found, e, v, Q):
    """m_e(v, Q) of the stored doubles, without rounding."""
    d = len(v)
    arm = applied(Q, balls(found.a[e]))
    r = [v[k] + arm[k] - arb(float(found.b[e, k])) for k in range(d)]
    N = balls(found.N[e])
    linear = sum(inner(N[k], Q[k]) for k in range(d))
    return arb(float(found.tau[e])) * inner(r, r) - 2 * linear + arb(float(found.constant[e]))


# --- Random edges


@dataclass
class Edges:
    """Measured rotations R and translations t with information, and residuals (y, turn)."""

    cost: G2oCost
    y: np.ndarray
    turn: np.ndarray

    def point(self, e, R=None, y=None, turn=None):
        """Exact v and Q of an edge's residual, with the residual itself."""
        graph = self.cost.graph
        R = nearest_rotation(graph.rotations[e]) if R is None else R
        y = balls(self.y[e] if y is None else y)
        turn = self.turn[e] if turn is None else turn
        if graph.d == 2:
            angle = turn if isinstance(turn, arb) else arb(float(turn[0]))
            E, rest = planar(angle), [angle]
        else:
            q = normalized(balls(turn))
            E, rest = spatial(q), q[1:]
        v = [a + b for a, b in zip(applied(R, y), balls(graph.translations[e]), strict=True)]
        return v, product(R, E), [*y, *rest]


def information(rng, p, condition, isotropic=False):
    """A random matrix of that condition; or a scalar translational and no cross block."""
    d = 2 if p == 3 else 3
    B = np.linalg.qr(rng.standard_normal((p, p)))[0]
    Omega = (B * condition ** rng.uniform(-1.0, 0.0, p)) @ B.T
    Omega = 0.5 * (Omega + Omega.T)
    if isotropic:
        Omega[:d, d:] = Omega[d:, :d] = 0.0
        Omega[:d, :d] = np.exp(rng.standard_normal()) * np.eye(d)
    return Omega * 10.0 ** rng.uniform(-3.0, 3.0)


def turns(rng, m, d, far):
    """Angles (m, 1) in (-pi, pi], or quaternions (m, 4) with w >= 0; small ones unless ``far``."""
    size = np.pi * (rng.random(m) if far else 0.05 * rng.random(m))
    if d == 2:
        return (size * rng.choice([-1.0, 1.0], m))[:, None]
    axis = rng.standard_normal((m, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    return np.concatenate([np.cos(size / 2)[:, None], np.sin(size / 2)[:, None] * axis], axis=1)


def random_edges(rng, m, d, *, condition=1e4, cross=0.7, far=True, size=1.0):
    """Edges of random information, a share of them with cross terms, and random residuals."""
    p = d * (d + 1) // 2
    R = so.random(rng, m, d)
    t = 3.0 * rng.standard_normal((m, d))
    Omega = np.stack([information(rng, p, condition, rng.random() > cross) for _ in range(m)])
    edges = np.c_[np.arange(m), np.arange(1, m + 1)]
    graph = PoseGraph(RotationGraph(m + 1, edges, R, np.ones(m)), t, np.ones(m))
    cost = G2oCost(graph.with_information(Omega))
    return Edges(cost, size * rng.standard_normal((m, d)), turns(rng, m, d, far))


def rounded(edges):
    """The doubles (v, Q) nearest to the residuals, for functions of doubles."""
    v, Q = [], []
    for e in range(len(edges.y)):
        x, A, _ = edges.point(e)
        v.append([float(a.mid()) for a in x])
        Q.append([[float(a.mid()) for a in row] for row in A])
    return np.array(v), np.array(Q)
