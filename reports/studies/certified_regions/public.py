"""Regions of public graphs: how sharp, and how wide and slow next to covariances."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

import certpgo
from certpgo import CertifiedSolution, Estimate, Marginals
from certpgo.certify.regions import Regions
from certpgo.errors import InputError, NumericalError
from certpgo.graph.kinds import Node
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import pinned
from certpgo.solve.likelihood import LEVEL, quantiles_of_nodes
from reports.studies.certified_regions.campaign import shares

#: Sets whose regions are compared with covariances.
SETS = (
    "smallGrid3D",
    "parking-garage",
    "sphere400",
    "sphere2500",
    "torus3D",
    "cubicle",
    "MIT",
    "intel",
    "ring",
    "kitti_00",
    "manhattan",
    "city10000",
)
#: Sets on which an adversary looks for estimates near the limit.
ATTACKED = ("smallGrid3D", "MIT", "intel", "manhattan", "sphere2500")
#: Costs under which widths are compared.
COSTS = ("chordal", "g2o")
#: Nodes that are compared, and rounds of times.
NODES, ROUNDS = 13, 5
#: Excesses over the optimum of the adversary's estimates, over its cost.
STEPS = 10.0 ** np.arange(-4.0, 0.1, 0.5)

Row = dict[str, Any]


def solved(name: str, cost: str) -> CertifiedSolution:
    """The certified answer of a public set."""
    return certpgo.solve(datasets.load(name), cost=cost)


def regions_of(answer: CertifiedSolution) -> Regions:
    """What its bound says of where estimates are."""
    if answer.certificate.regions is None:
        raise NumericalError(f"nothing is proven of regions: {answer.certificate.reason}")
    return answer.certificate.regions


def chosen(answer: CertifiedSolution, reference: int, count: int = NODES) -> list[int]:
    """Poses spread over the graph, without the reference."""
    rigid = np.isin(answer.graph.nodes, (Node.POSE, Node.ROTATION))
    others = np.setdiff1d(np.flatnonzero(rigid), [reference])
    return others[np.linspace(0, len(others) - 1, count).round().astype(int)].tolist()


def all_widths() -> list[Row]:
    """Of the sets, under each cost that their information allows."""
    rows = []
    for cost in COSTS:
        for name in SETS:
            with suppress(InputError):
                rows.append(widths(name, cost))
    return rows


def widths(name: str, cost: str) -> Row:
    """Half-widths of regions over those of covariances, at one level; and the times of both."""
    answer = solved(name, cost)
    regions = regions_of(answer)
    reference = regions.anchor
    most = level_of(answer)
    found = regions.distance(reference, most)
    marginals = Marginals(answer.problem, answer.estimate, reference)
    nodes = chosen(answer, reference)
    d, metres, degrees = answer.problem.d, [], []
    for node in nodes:
        covariance = marginals.covariance(node)
        local = np.sqrt(most[node] * np.array(_largest(covariance, d)))
        metres.append(found.metres[node] / local[0])
        if found.degrees[node] < 180.0:
            degrees.append(found.degrees[node] / np.degrees(local[1]))
    return {
        "graph": name,
        "cost": cost,
        "poses": answer.graph.num_nodes,
        "verdict": str(answer.verdict),
        "metres": [median(metres), max(metres)],
        "degrees": [median(degrees), max(degrees)] if degrees else None,
        "without angle": len(nodes) - len(degrees),
        "widest metres": float(found.metres.max()),
        **_times(answer, regions, reference),
    }


def level_of(answer: CertifiedSolution) -> FloatArray:
    """(n,) quantiles that regions and covariances are compared at, whatever noise is stated."""
    problem = answer.problem
    return np.asarray(problem.double.max() * quantiles_of_nodes(problem, LEVEL))


def _largest(covariance: FloatArray, d: int) -> tuple[float, float]:
    """The largest variances of the position, and of the rotation."""
    turned = covariance[d:, d:]
    return (
        float(np.linalg.eigvalsh(covariance[:d, :d])[-1]),
        float(np.linalg.eigvalsh(turned)[-1]),
    )


def _times(answer: CertifiedSolution, regions: Regions, reference: int) -> Row:
    """Process seconds of all regions and of all covariances, in turn, with fresh factorizations."""
    most = level_of(answer)

    def of_regions() -> None:
        replace(regions, bound=replace(regions.bound)).distance(reference, most)

    def of_covariances() -> None:
        _ = Marginals(answer.problem, answer.estimate, reference).covariances

    took = in_turn(of_regions, of_covariances)
    return {
        "regions ms": 1e3 * median(took[0]),
        "covariances ms": 1e3 * median(took[1]),
        "time": median(a / b for a, b in zip(*took, strict=True)),
    }


def in_turn(*works: Callable[[], object], rounds: int = ROUNDS) -> list[list[float]]:
    """Process seconds of each, one after the other, after one round that is not counted."""
    took: list[list[float]] = [[] for _ in works]
    for k in range(rounds + 1):
        for work, seconds in zip(works, took, strict=True):
            begin = time.process_time()
            work()
            if k:
                seconds.append(time.process_time() - begin)
    return took


def attacked(name: str, cost: str) -> Row:
    """The largest share of regions that estimates along the worst moves of single nodes take."""
    answer = solved(name, cost)
    problem, certificate = answer.problem, answer.certificate
    regions, best = regions_of(answer), certificate.best
    largest = dict.fromkeys(("ellipsoid", "metres", "degrees"), 0.0)
    checks, floor = 0, problem.enclosure(best)[1]
    here = replace(regions, estimate=best, cost=floor / regions.unit)
    reference = regions.anchor
    neighbours = answer.graph.edges[(answer.graph.edges == reference).any(axis=1)]
    nodes = {*chosen(answer, reference), *neighbours.ravel().tolist()} - {reference}
    moves = Moves(answer, reference)
    for node in sorted(nodes):
        for move in moves.of(node, here.region(node, reference, 1.0).shape):
            for step in np.sqrt(STEPS * floor):
                other = moved(best, step * move)
                excess = problem.enclosure(other)[1] - floor
                region = here.region(node, reference, excess + 1e-15 * abs(excess))
                checks += 1
                for quantity, share in shares(region, best, other).items():
                    largest[quantity] = max(largest[quantity], share)
    return {"graph": name, "cost": cost, "estimates": checks, "largest": largest}


class Moves:
    """Least moves of all nodes, to first order, that move one of them the worst way."""

    def __init__(self, answer: CertifiedSolution, reference: int) -> None:
        problem, self.x = answer.problem, answer.certificate.best
        layout = self.layout = problem.tangent_layout
        rows = layout.first_row(reference) + np.arange(layout.sizes[reference])
        A = pinned(problem.gauss_newton(self.x), rows)
        self.factor = problem.symbolic(A).factor(A)
        self.frame = self.x.rotations[reference]

    def of(self, node: int, shape: FloatArray) -> Iterator[FloatArray]:
        """(n, b) moves that cost one: the worst for the ellipsoid, the position, and the angle."""
        layout, d = self.layout, self.x.d
        rows = layout.first_row(node) + np.arange(layout.sizes[node])
        right = np.zeros((layout.size, len(rows)))
        right[rows, np.arange(len(rows))] = 1.0
        columns = self.factor.solve(right)
        covariance = columns[rows]
        # Moves v, w of the node change U by J (v, w), its rows one after the other.
        R, q = self.frame.T @ self.x.rotations[node], so.tangent_dim(d)
        turns = np.stack([R @ generator for generator in so.hat(np.eye(q))])
        J = np.zeros((d, 1 + d, d + q))
        J[:, 0, :d] = self.frame.T
        J[:, 1:, d:] = np.moveaxis(turns, 0, -1)
        K = np.einsum("abi,bc,acj->ij", J, np.linalg.inv(shape), J)
        L = np.linalg.cholesky(covariance)
        for form in (K, np.diag([1.0] * d + [0.0] * q), np.diag([0.0] * d + [1.0] * q)):
            worst = L @ np.linalg.eigh(L.T @ form @ L)[1][:, -1]
            yield layout.unpack(columns @ np.linalg.solve(covariance, worst))


def moved(x: Estimate, move: FloatArray) -> Estimate:
    """Positions moved in the world, and rotations in their own frames."""
    d = x.d
    return Estimate(x.rotations @ so.exp(move[:, d:]), x.translations + move[:, :d])
