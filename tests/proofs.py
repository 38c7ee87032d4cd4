"""Proofs of small graphs and the exact truth about them, shared by the tests of the checker."""

import io
import json
from dataclasses import replace
from fractions import Fraction

import numpy as np

import certpgo
from certpgo import checker
from certpgo.io.exact.circle import half_angle_pair
from certpgo.solve.proving import write_proof


def proven(folder, graph, name="graph"):
    """Paths of a graph file and of the proof of its optimum."""
    path, proof = folder / f"{name}.g2o", folder / f"{name}.cert"
    certpgo.write(path, graph)
    instance = certpgo.read(path, quiet=True)
    answer = certpgo.solve(instance.graph, cost="chordal")
    write_proof(proof, path, instance, answer.estimate, answer.certificate)
    return path, proof


def arrays_of(proof):
    with np.load(proof) as archive:
        return {name: archive[name].copy() for name in archive.files}


def claim_of(arrays):
    return json.loads(bytes(arrays["claim"]))


def with_claim(arrays, **changes):
    """The arrays with another header."""
    text = json.dumps({**claim_of(arrays), **changes}).encode()
    return {**arrays, "claim": np.frombuffer(text, dtype=np.uint8)}


def repacked(arrays):
    """A proof with these arrays and valid checksums, as bytes."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def verdict(path, proof, of=checker):
    """What a checker proves, or None."""
    try:
        return of.check(path, proof)
    except (of.Refused, of.Unreadable):
        return None


def exact_rotation(q):
    """R(q)/|q|^2 in rationals, by the definition."""
    q = [Fraction(float(x)) for x in q]
    if len(q) == 2:
        c, s = q
        entries, norm = [[c * c - s * s, -2 * c * s], [2 * c * s, c * c - s * s]], c * c + s * s
    else:
        x, y, z, w = q
        norm = x * x + y * y + z * z + w * w
        # v -> q v q*, column by column.
        cross = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        v = [x, y, z]
        entries = [
            [
                2 * v[a] * v[b] + 2 * w * cross[a][b] + (a == b) * (2 * w * w - norm)
                for b in range(3)
            ]
            for a in range(3)
        ]
    return [[entry / norm for entry in row] for row in entries]


def measured_by(path):
    """The measured rotations of a g2o file in rationals, by the definitions."""
    edges = [line.split() for line in path.read_text().splitlines() if line.startswith("EDGE")]
    return [
        exact_rotation(
            map(float, words[6:10])
            if words[0] == "EDGE_SE3:QUAT"
            else half_angle_pair(float(words[5]))
        )
        for words in edges
    ]


def exact_cost(graph, measurements, q, t=None):
    """F in rationals."""
    R = [exact_rotation(row) for row in q]
    d, total = len(R[0]), Fraction(0)
    for e in range(len(graph.i)):
        i, j = int(graph.i[e]), int(graph.j[e])
        measured = measurements[e]
        kappa, tau = Fraction(float(graph.kappa[e])), Fraction(float(graph.tau[e]))
        for a in range(d):
            for b in range(d):
                moved = sum(R[i][a][c] * measured[c][b] for c in range(d))
                total += kappa * (R[j][a][b] - moved) ** 2
            if t is not None:
                step = sum(R[i][a][c] * Fraction(float(graph.t[e][c])) for c in range(d))
                total += tau * (Fraction(float(t[j][a])) - Fraction(float(t[i][a])) - step) ** 2
    return total


def exact_matrix(graph, measurements, multipliers, poses, without=None):
    """M - blkdiag(0, Lam) in rationals, by the terms of F edge by edge, the first pose pinned.

    Or without all rows of a node.
    """
    d = graph.t.shape[1]
    b = d + poses
    N = graph.n * b
    A = [[Fraction(0)] * N for _ in range(N)]

    def add_square(terms, weight):
        for p, x in terms:
            for q, y in terms:
                A[p][q] += weight * x * y

    for e in range(len(graph.i)):
        i, j = int(graph.i[e]) * b, int(graph.j[e]) * b
        measured = measurements[e]
        kappa, tau = Fraction(float(graph.kappa[e])), Fraction(float(graph.tau[e]))
        # A row of X enters as R_j e_c - R_i (R_ij e_c), column by column.
        for c in range(d):
            terms = [(j + poses + c, Fraction(1))]
            terms += [(i + poses + a, -measured[a][c]) for a in range(d)]
            add_square(terms, kappa)
        if poses:
            step = [(i + 1 + a, -Fraction(float(graph.t[e][a]))) for a in range(d)]
            add_square([(j, Fraction(1)), (i, Fraction(-1)), *step], tau)
    rows, columns = np.triu_indices(d)
    for node in range(graph.n):
        for a, c, x in zip(rows, columns, multipliers[node], strict=True):
            p, q = node * b + poses + a, node * b + poses + c
            A[p][q] -= Fraction(float(x))
            if p != q:
                A[q][p] -= Fraction(float(x))
    kept = range(1, N) if poses else range(N)
    if without is not None:
        kept = [p for p in range(N) if p // b != without]
    return [[A[p][q] for q in kept] for p in kept]


def is_positive_semidefinite(A):
    """By L D L^T in rationals."""
    A = [row[:] for row in A]
    for k in range(len(A)):
        pivot = A[k][k]
        if pivot < 0 or (pivot == 0 and any(A[k][k:])):
            return False
        for p in range(k + 1, len(A)) if pivot else ():
            ratio = A[p][k] / pivot
            for q in range(k + 1, len(A)):
                A[p][q] -= ratio * A[k][q]
    return True


def without_bound(certificate):
    """The certificate, had nothing been proven."""
    return replace(certificate, multipliers=None)
