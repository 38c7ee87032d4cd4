"""Algorithm 3 of Moreira 2020 line by line, dense, and the number of every reading of a line.

A second implementation: it shares no step with `certpgo.optimize.methods.eigen_rao`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph import Estimate, Graph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray
from certpgo.solve.metrics import angular_errors
from reports.figures import _scenes

#: Mean, median and RMSE of EigenRAO on Ellis Island, degrees.
PRINTED = np.array([1.43, 0.27, 5.37])
#: Iterations that are looked at, and those that the algorithm may take.
ITERATIONS = 30


@dataclass(frozen=True)
class Reading:
    """How the lines are read; the defaults follow the pseudocode where the text agrees with it.

    Attributes
    ----------
    a, b, eta : parameters, section 4.6
    exponent : of the loss, eq. 4.9: ``"pi - e/2"``, or ``"(pi - e)/2"``
    scale : e is this times the angle: 1, sqrt(2) for the Frobenius norm of a logarithm
    degrees : the loss takes e in degrees
    clipped : a negative loss is zero
    numerator : of line 12, ``"W"`` (the text) or ``"E"`` (the print)
    pairs : the sum of line 12 is over all pairs, also those without a measurement, not over edges
    diagonal : of the weighted matrix: ``"degrees"``, or the ``"sums"`` of weights
    anchored : the eigenvectors are first multiplied by the inverse of the first block (B.6)
    magnitude : of the eigenvalues the smallest magnitudes are taken, not the smallest
    replaced : line 9 replaces measurements
    cumulative : line 9 replaces what the iteration before left, not what was measured
    symmetrized : line 14
    """

    a: float = -1.75
    b: float = 0.85
    eta: float = math.pi / 2.0
    exponent: str = "pi - e/2"
    scale: float = 1.0
    degrees: bool = False
    clipped: bool = True
    numerator: str = "W"
    pairs: bool = False
    diagonal: str = "degrees"
    anchored: bool = False
    magnitude: bool = False
    replaced: bool = True
    cumulative: bool = False
    symmetrized: bool = True


PLAIN = Reading()
#: What is read otherwise than `PLAIN`, by the line that leaves it open.
READINGS: dict[str, tuple[str, Reading]] = {
    "as printed, with W in line 12": ("", PLAIN),
    "anchored projection (B.6)": ("6", replace(PLAIN, anchored=True)),
    "smallest eigenvalues by magnitude": ("6", replace(PLAIN, magnitude=True)),
    "diagonal: sums of the weights": ("6", replace(PLAIN, diagonal="sums")),
    "e: the norm, sqrt(2) angles": ("7", replace(PLAIN, scale=math.sqrt(2.0))),
    "e: half the angle, a quaternion's": ("7", replace(PLAIN, scale=0.5)),
    "nothing is replaced": ("9", replace(PLAIN, replaced=False)),
    "replaced for good": ("9", replace(PLAIN, cumulative=True)),
    "threshold 30 degrees": ("9", replace(PLAIN, eta=math.radians(30.0))),
    "threshold 10 degrees": ("9", replace(PLAIN, eta=math.radians(10.0))),
    "loss a + b exp((pi - e)/2)": ("10", replace(PLAIN, exponent="(pi - e)/2")),
    "the same, and negative where it is": (
        "10",
        replace(PLAIN, exponent="(pi - e)/2", clipped=False),
    ),
    "the same of the norm": (
        "7, 10",
        replace(PLAIN, exponent="(pi - e)/2", scale=math.sqrt(2.0)),
    ),
    "loss of degrees": ("10", replace(PLAIN, degrees=True)),
    "loss of degrees, negative where it is": ("10", replace(PLAIN, degrees=True, clipped=False)),
    "a = 0": ("10", replace(PLAIN, a=0.0)),
    "E, as printed": ("12", replace(PLAIN, numerator="E")),
    "E, and the loss (pi - e)/2": (
        "10, 12",
        replace(PLAIN, numerator="E", exponent="(pi - e)/2"),
    ),
    "sums over all pairs": ("12", replace(PLAIN, pairs=True)),
    "E, and sums over all pairs": ("12", replace(PLAIN, numerator="E", pairs=True)),
    "not symmetrized": ("14", replace(PLAIN, symmetrized=False)),
}


def rows() -> Iterator[tuple[str, ...]]:
    """A row for each reading: the iteration nearest to print, and the last one."""
    instance, nodes, truth = _scenes.with_truth("Ellis_Island", None)
    graph = instance.graph.subgraph(nodes)
    for name, (line, reading) in READINGS.items():
        errors = np.array([_errors(R, truth) for R in _iterations(graph, reading)])
        logs = np.log(errors / PRINTED)
        off, scaled = np.exp(np.abs(logs).max(axis=1)), np.exp(np.ptp(logs, axis=1) / 2.0)
        best = int(off.argmin())
        yield (
            line,
            name,
            str(best),
            *(f"{error:.2f}" for error in errors[best]),
            f"{off[best]:.2f}",
            f"{scaled.min():.2f}",
            " / ".join(f"{error:.2f}" for error in errors[-1]),
        )


def _errors(R: FloatArray, truth: Estimate) -> tuple[float, float, float]:
    found = angular_errors(Estimate(R), truth, norm="l1")
    return found.mean_deg, found.median_deg, found.rmse_deg


def _iterations(graph: Graph, reading: Reading) -> Iterator[FloatArray]:
    """World <- camera rotations (n, 3, 3) of each iteration."""
    n = graph.num_nodes
    measured, edges = _blocks(graph)
    degrees = edges.sum(axis=1).astype(float)
    off = ~np.eye(n, dtype=bool) if reading.pairs else edges
    W, current = np.ones((n, n)), measured
    for _ in range(ITERATIONS + 1):
        X = _eigenvectors(W * edges, current, degrees, reading)
        yield np.swapaxes(X, 1, 2)
        relative = np.einsum("iab,jcb->ijac", X, X)
        angles = so.angle(np.einsum("ijba,ijbc->ijac", measured, relative).reshape(-1, 3, 3))
        e = reading.scale * angles.reshape(n, n) * edges
        far = (e > reading.eta)[:, :, None, None] & reading.replaced
        current = np.where(far, relative, current if reading.cumulative else measured)
        rho = _loss(np.degrees(e) if reading.degrees else e, reading)
        W = W * rho
        sums = (W * off).sum(axis=1)
        numerator = W if reading.numerator == "W" else rho
        W = degrees[:, None] * numerator / np.where(sums > 0.0, sums, np.inf)[:, None]
        np.fill_diagonal(W, 1.0)
        if reading.symmetrized:
            W = 0.5 * (W + W.T)


def _loss(e: FloatArray, reading: Reading) -> FloatArray:
    exponent = math.pi - e / 2.0 if reading.exponent == "pi - e/2" else (math.pi - e) / 2.0
    rho = reading.a + reading.b * np.exp(exponent)
    return np.asarray(np.maximum(rho, 0.0) if reading.clipped else rho)


def _blocks(graph: Graph) -> tuple[FloatArray, BoolArray]:
    """Rtilde (n, n, 3, 3), with identities on its diagonal, and the adjacency matrix."""
    n, (i, j) = graph.num_nodes, graph.edges.T
    blocks, edges = np.zeros((n, n, 3, 3)), np.zeros((n, n), dtype=bool)
    blocks[i, j], blocks[j, i] = graph.rotations, np.swapaxes(graph.rotations, 1, 2)
    blocks[np.arange(n), np.arange(n)] = np.eye(3)
    edges[i, j] = edges[j, i] = True
    return blocks, edges


def _eigenvectors(
    W: FloatArray, blocks: FloatArray, degrees: FloatArray, reading: Reading
) -> FloatArray:
    """The thesis' rotations (n, 3, 3): EigenRA of the weighted matrix, line 6."""
    n = len(W)
    matrix = -W[:, :, None, None] * blocks
    diagonal = degrees if reading.diagonal == "degrees" else W.sum(axis=1)
    matrix[np.arange(n), np.arange(n)] = diagonal[:, None, None] * np.eye(3)
    values, vectors = np.linalg.eigh(matrix.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n))
    chosen = np.argsort(np.abs(values) if reading.magnitude else values, kind="stable")[:3]
    X = vectors[:, chosen].reshape(n, 3, 3)
    if reading.anchored:
        X = X @ np.linalg.inv(X[0])
    if np.mean(np.linalg.det(X) < 0.0) > 0.5:
        X = X * np.array([1.0, 1.0, -1.0])
    return np.asarray(so.project(X))
