"""Certificate matrices in rational arithmetic, and whether they are definite."""

from fractions import Fraction

import flint
import numpy as np
from scipy.spatial.transform import Rotation

from certpgo.graph import PoseGraph, RotationGraph


def exact_rotation(q):
    """R(q)/|q|^2 in rationals, of a quaternion x y z w or a half-angle pair c s of doubles."""
    q = [Fraction(float(v)) for v in q]
    square = sum(v * v for v in q)
    if len(q) == 2:
        c, s = q
        rows = [[c * c - s * s, -2 * c * s], [2 * c * s, c * c - s * s]]
    else:
        x, y, z, w = q
        rows = [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    return [[v / square for v in row] for row in rows]


def with_exact_rotations(graph):
    """The graph with rotations rounded from rationals, and those rationals."""
    R = graph.rotations
    if graph.d == 2:
        half = np.arctan2(R[:, 1, 0], R[:, 0, 0]) / 2
        q = np.c_[np.cos(half), np.sin(half)]
    else:
        q = Rotation.from_matrix(R).as_quat()
    exact = [exact_rotation(row) for row in q]
    rounded = np.array([[[float(v) for v in row] for row in block] for block in exact])
    rotation = RotationGraph(graph.num_nodes, graph.edges, rounded, graph.kappa)
    return PoseGraph(rotation, graph.translations, graph.tau), exact


def exact_certificate(graph, exact, multipliers, poses):
    """M - blkdiag(0, Lam') or L - blkdiag(Lam') in rationals, the first translation pinned."""
    n, d = graph.num_nodes, graph.d
    b = d + 1 if poses else d
    S = [[Fraction(0)] * (n * b) for _ in range(n * b)]

    def add(rows, vector):  # weight times the outer product of a sparse vector with itself
        for a, x in vector:
            for c, y in vector:
                S[a][c] += rows * x * y

    at = b - d
    for e, (i, j) in enumerate(graph.edges):
        kappa, tau = Fraction(graph.kappa[e]), Fraction(graph.tau[e])
        for c in range(d):  # column c of R_j - R_i R_ij
            column = [(int(i) * b + at + a, -exact[e][a][c]) for a in range(d)]
            add(kappa, [*column, (int(j) * b + at + c, Fraction(1))])
        if poses:
            lever = [(int(i) * b + 1 + a, -Fraction(graph.translations[e, a])) for a in range(d)]
            add(tau, [(int(j) * b, Fraction(1)), (int(i) * b, Fraction(-1)), *lever])
    for k in range(n):
        for a in range(d):
            for c in range(d):
                S[k * b + at + a][k * b + at + c] -= Fraction(multipliers[k, a, c])
    return [row[1:] for row in S[1:]] if poses else S


def positive_definite_in_balls(S, precision=400):
    """LDL^T in ball arithmetic: True only when every pivot is certainly positive."""
    flint.ctx.prec = precision
    A = [[flint.arb(flint.fmpq(v.numerator, v.denominator)) for v in row] for row in S]
    n = len(A)
    for k in range(n):
        if not A[k][k] > 0:
            return False
        for i in range(k + 1, n):
            if A[i][k] == 0:
                continue
            ratio = A[i][k] / A[k][k]
            for j in range(k + 1, n):
                A[i][j] -= ratio * A[k][j]
    return True
