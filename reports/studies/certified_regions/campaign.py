"""Estimates near and far, in the worst directions too, held against the regions of each other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from certpgo import CertPGOError, Estimate, Region
from certpgo.certify.regions import Regions
from certpgo.graph.kinds import Node
from certpgo.linalg import factor
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.linalg.blocks import pinned
from certpgo.objective.choose_cost import Certifiable
from certpgo.objective.lifting import quarter_turn
from reports.studies.certified_regions.kinds import KINDS

#: Sizes of moves at random, radians and metres; the last are anywhere.
SIZES = (1e-6, 1e-3, 0.1, 1.0, 30.0)
#: Poses from which nodes are seen, nodes that are moved the worst way, and pairs of these moves.
REFERENCES, NODES, PAIRS = 2, 3, 2
#: Powers of ten between which what a worst move costs is, of weights of order one.
COSTS = (-10.0, 3.0)
#: The quantities that are bounded.
QUANTITIES = ("ellipsoid", "metres", "degrees", "scale")


@dataclass
class Tally:
    """What was found of a kind.

    Attributes
    ----------
    graphs : tried
    refused : of these, drawn graphs that are no problem, as they are not connected
    unknown : of these, without regions as nothing could be proven
    checks : pairs of estimates, seen from a pose, times other nodes
    outside : checks in which an estimate was outside its region
    largest : share of the bounds that was reached, by quantity
    seeds : of graphs with estimates outside
    """

    graphs: int = 0
    refused: int = 0
    unknown: int = 0
    checks: int = 0
    outside: int = 0
    largest: dict[str, float] = field(default_factory=lambda: dict.fromkeys(QUANTITIES, 0.0))
    seeds: list[int] = field(default_factory=list)


def examine(kind: str, seed: int, tally: Tally) -> None:
    """Draw a graph and hold estimates against its regions."""
    rng = np.random.default_rng([seed, list(KINDS).index(kind)])
    before = os.environ.get("CERTPGO_ENGINE")
    os.environ["CERTPGO_ENGINE"] = factor.engines()[seed % len(factor.engines())]
    tally.graphs += 1
    try:
        problem, certificate = KINDS[kind](rng)
        known, outside = certificate.regions, tally.outside
        if known is None or certificate.distance is None:
            tally.unknown += 1
            return
        for pair in pairs(rng, problem, known, certificate.best):
            _judge(problem, known, *pair, tally)
        if tally.outside > outside:
            tally.seeds.append(seed)
    except CertPGOError:
        tally.refused += 1
    finally:
        if before is None:
            del os.environ["CERTPGO_ENGINE"]
        else:
            os.environ["CERTPGO_ENGINE"] = before


def pairs(
    rng: np.random.Generator, problem: Certifiable, known: Regions, best: Estimate
) -> Iterator[tuple[int, Estimate, Estimate]]:
    """A pose, and two estimates that are seen from it."""
    rigid = np.flatnonzero(np.isin(problem.graph.nodes, (Node.POSE, Node.ROTATION)))
    for reference in rng.permutation(rigid)[:REFERENCES].tolist():
        ways = Ways(known, best, reference)
        for size in SIZES:
            yield reference, best, moved(rng, best, size)
        yield reference, *(moved(rng, best, float(rng.choice(SIZES[:4]))) for _ in range(2))
        others = np.setdiff1d(np.arange(problem.n), [reference])
        for node in rng.permutation(others)[:NODES].tolist():
            for _ in range(PAIRS):
                step = float(np.sqrt(10.0 ** rng.uniform(*COSTS)))
                one, other = ways.worst(rng, node, step)
                yield reference, best, turned(rng, one)
                yield reference, other, turned(rng, one)


class Ways:
    """The moves that are worst for a node, by the bound.

    Parameters
    ----------
    known : whose certificate matrix says what moves cost at least
    best : where moves begin
    reference : the pose that stays
    """

    def __init__(self, known: Regions, best: Estimate, reference: int) -> None:
        form = known.form
        self.best, self.layout = best, form.pattern.layout_of(form.matrix)
        self.is_scaled = form.graph.nodes == Node.SCALED
        rows = self.rows(reference)
        A = pinned(form.certificate_matrix(known.bound.multipliers), rows).toarray()
        sizes = np.sqrt(np.maximum(A.diagonal(), 1e-300))
        self.inverse = np.linalg.pinv(A / np.outer(sizes, sizes)) / np.outer(sizes, sizes)
        self.inverse[rows] = self.inverse[:, rows] = 0.0

    def rows(self, node: int) -> FloatArray:
        """Rows of a node."""
        return np.asarray(self.layout.first_row(node) + np.arange(self.layout.sizes[node]))

    def worst(self, rng: np.random.Generator, node: int, step: float) -> tuple[Estimate, Estimate]:
        """Two estimates, moved one way and the other along an eigenvector of the node's block."""
        own = self.rows(node)
        values, vectors = np.linalg.eigh(self.inverse[np.ix_(own, own)])
        k = int(rng.integers(len(own)))
        if not values[k] > 0.0:
            k = len(own) - 1
        along = self.inverse[:, own] @ vectors[:, k] / np.sqrt(max(values[k], 1e-300))
        columns = step * self.layout.unpack(along)
        v = rng.standard_normal(self.best.d)
        v /= np.linalg.norm(v)
        return self._moved(v, columns), self._moved(v, -columns)

    def _moved(self, v: FloatArray, columns: FloatArray) -> Estimate:
        x, d = self.best, self.best.d
        s = np.ones(x.num_nodes) if x.scales is None else x.scales
        A = s[:, None, None] * x.rotations + v[:, None] * columns[:, None, -d:]
        R = so.project(A)
        still = ~columns[:, -d:].any(axis=1)
        R[still] = x.rotations[still]
        scales = x.scales
        if scales is not None:
            sizes = np.maximum(np.einsum("nab,nab->n", R, A) / d, 1e-3 * s)
            scales = np.where(self.is_scaled, sizes, scales)
        t = x.translations
        if t is not None:
            t = t + columns[:, :1] * v
            if columns.shape[1] == d + 2:
                t = t + columns[:, 1:2] * quarter_turn(v)
        return Estimate(R, t, scales=scales)


def moved(rng: np.random.Generator, x: Estimate, size: float) -> Estimate:
    """The estimate with every node moved by about as much, and all of them elsewhere."""
    n, d = x.num_nodes, x.d
    R = x.rotations @ so.exp(size * rng.standard_normal((n, so.tangent_dim(d))))
    t, s = x.translations, x.scales
    if t is not None:
        t = t + size * rng.standard_normal((n, d))
    if s is not None:
        s = np.where(s == 1.0, 1.0, s * np.exp(min(size, 2.0) * rng.standard_normal(n)))
    return turned(rng, Estimate(R, t, scales=s))


def turned(rng: np.random.Generator, x: Estimate) -> Estimate:
    """The same estimate in another frame of the world."""
    Q, t = so.random(rng, 1, x.d)[0], x.translations
    if t is not None:
        t = t @ Q.T + rng.standard_normal(x.d)
    return Estimate(Q @ x.rotations, t, scales=x.scales)


def _judge(
    problem: Certifiable,
    known: Regions,
    reference: int,
    x: Estimate,
    other: Estimate,
    tally: Tally,
) -> None:
    """Whether the region of each node holds the other estimate, if it may cost as much as that."""
    costs = [problem.enclosure(point)[1] for point in (x, other)]
    if not np.isfinite(costs).all():
        return
    here = replace(known, estimate=x, cost=costs[0] / known.unit)
    excess = costs[1] - costs[0]
    excess += 1e-15 * abs(excess)
    for node in np.setdiff1d(np.arange(problem.n), [reference]).tolist():
        region = here.region(node, reference, excess)
        if region is None:
            continue
        found = shares(region, x, other)
        tally.checks += 1
        tally.outside += max(found.values()) > 1.0 or not region.holds(other)
        for quantity, share in found.items():
            tally.largest[quantity] = max(tally.largest[quantity], share)


def shares(region: Region, x: Estimate, other: Estimate) -> dict[str, float]:
    """How much of the bounds of x's region another estimate takes, by quantity."""
    positions, frames, sizes = zip(*(_seen(y, region) for y in (x, other)), strict=True)
    columns, found = [], {}
    if positions[0] is not None and region.metres is not None:
        u = positions[1] - positions[0]
        columns.append(u[:, None])
        found["metres"] = float(np.linalg.norm(u)) / region.metres
    if region.rotation is not None:
        V = sizes[1] * frames[1] - sizes[0] * frames[0]
        if len(region.shape) > len(columns) + len(V):
            columns.append(quarter_turn(columns[0][:, 0])[:, None])
        columns.append(V)
        size = float(np.linalg.norm(frames[1] - frames[0])) / np.sqrt(8.0)
        if region.degrees < 180.0:
            found["degrees"] = np.degrees(2.0 * np.arcsin(min(size, 1.0))) / region.degrees
        if region.scale > 0.0:
            found["scale"] = abs(float(sizes[1] - sizes[0])) / region.scale
    elif len(region.shape) > 1:
        columns.append(quarter_turn(columns[0][:, 0])[:, None])
    U = np.concatenate(columns, axis=1)
    found["ellipsoid"] = float(np.sqrt(_in_shape(region.shape, U)))
    return found


def _seen(x: Estimate, region: Region) -> tuple[FloatArray | None, FloatArray, float]:
    """Position, rotation and scale of the node in the frame of the reference, with more digits."""
    j, i = region.node, region.reference
    R = x.rotations[[i, j]].astype(np.longdouble)
    s = 1.0 if x.scales is None else x.scales[j]
    if x.translations is None:
        return None, R[0].T @ R[1], s
    t = x.translations[[i, j]].astype(np.longdouble)
    return (t[1] - t[0]) @ R[0], R[0].T @ R[1], s


def _in_shape(shape: FloatArray, U: FloatArray) -> float:
    """tr(U shape^-1 U^T), by columns of length one."""
    size = np.sqrt(np.diagonal(shape))
    L = np.linalg.cholesky(shape / np.outer(size, size))
    return float((np.linalg.solve(L, (U / size).T.astype(float)) ** 2).sum())
