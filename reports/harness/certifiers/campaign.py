"""Small random instances whose optimum is known, by kind and seed, in blocks.

A draw whose optimum stays open is still checked for false certificates, but it is no instance,
and the next one is drawn.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from certpgo.errors import NumericalError
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.quadratic import Quadratic
from reports.harness.certifiers import made
from reports.harness.certifiers.made import Made
from reports.harness.certifiers.opinions import Certifier, tally_of
from reports.harness.certifiers.points import (
    Known,
    Truth,
    ZooPoint,
    best_of,
    truth_by_form,
    truth_by_oracle,
    truth_by_search,
)
from reports.harness.experiments.zoo_records import ALL, BLOCK, Tally, total

#: Sorts of instances: a draw whose optimum stays open, and one that local descent may miss.
SET_ASIDE, WOUND_OR_LOOSE = "set aside", "wound-up or loose"
#: Draws after which a kind has nothing to offer for a seed.
MOST_DRAWS = 200

Posed = tuple[Quadratic, list[Estimate], Truth]


@dataclass(frozen=True)
class InstanceKind:
    """Instances of one sort.

    Attributes
    ----------
    name : what reports call it
    share : of the campaign
    draw : a problem, points of it and the truth; None when the draw came to nothing
    """

    name: str
    share: float
    draw: Callable[[np.random.Generator], Posed | None]


def draws(kind: InstanceKind, seed: int) -> Iterator[list[ZooPoint]]:
    """Problems with up to two points each, until the optimum of one is known.

    Every second seed's weights are multiplied by a power of two.
    """
    place = [k.name for k in KINDS].index(kind.name)
    rng = np.random.default_rng(np.random.SeedSequence((place, seed)))
    for draw in range(MOST_DRAWS):
        try:
            drawn = kind.draw(rng)
        except NumericalError:
            continue
        if drawn is None:
            continue
        problem, points, truth = drawn
        factor = 2.0 ** int(rng.choice([-40, -20, 20, 40])) if seed % 2 else 1.0
        truth = replace(truth, upper=factor * truth.upper, lower=factor * truth.lower)
        scaled = problem.scaled(factor)
        name = f"seed {seed}, draw {draw}"
        yield [
            ZooPoint(f"{name}, point {k}", scaled, point, truth) for k, point in enumerate(points)
        ]
        if truth.known is not Known.OPEN:
            return


def block(kind: InstanceKind, first: int, asked: dict[str, Certifier]) -> Tally:
    """Counts over a block of seeds."""
    tallies = []
    for seed in range(first, first + BLOCK):
        for cases in draws(kind, seed):
            tallies.append(Tally(instances=Counter(_facts(kind, cases[0]))))
            tallies += [tally_of(case, asked) for case in cases]
    return total(tallies)


def _facts(kind: InstanceKind, case: ZooPoint) -> Iterator[str]:
    if case.truth.known is Known.OPEN:
        yield SET_ASIDE
        return
    yield ALL
    yield case.truth.known.value
    poses = case.problem.has_positions
    yield f"{case.problem.d}D {'poses' if poses else 'rotations'}"
    if case.truth.loose or kind.draw is _wound:
        yield WOUND_OR_LOOSE


def _wound(rng: np.random.Generator) -> Posed | None:
    """A wound-up cycle, perhaps of uneven weights, perhaps two of them, dressed up."""
    found = _ring(rng)
    if found is None:
        return None
    if rng.random() < 0.2 and found.n <= 6:
        second = _ring(rng, d=found.d, largest=6)
        if second is not None:
            bridge = 10.0 ** rng.uniform(-4, 4) if rng.random() < 0.5 else None
            found = made.joined(found, second, bridge)
    problem, best, other = _dressed(found, rng)
    return problem, _some([other, best], rng), truth_by_form(problem, best, found.optimum)


def _ring(rng: np.random.Generator, d: int = 0, largest: int = 12) -> Made | None:
    n = int(rng.integers(3, largest + 1))
    d = d or int(rng.integers(2, 4))
    short = 10.0 ** rng.uniform(-4, 0)
    theta = rng.uniform(0.0, 3.1) if rng.random() < 0.8 else math.pi - short
    winding = int(rng.choice([-1, 1, -2, 2, -3])) if n > 6 else int(rng.choice([-1, 1]))
    if rng.random() < 0.5:
        return made.wound(n, theta, winding, d)
    for decades in (3.0, 1.0, 0.5, 0.2):  # the wilder the weights, the rarer are such points
        kappa = 10.0 ** rng.uniform(0.0, decades, n)
        found = made.wound_weighted(kappa, theta, winding, d)
        if found is not None:
            return found
    return None


def _dressed(plain: Made, rng: np.random.Generator) -> tuple[Quadratic, Estimate, Estimate]:
    """The same problem with bridges, parallel edges, other labels; perhaps as poses."""
    if rng.random() < 0.3:
        plain = made.with_tree(plain, int(rng.integers(1, 4)), 10.0 ** rng.uniform(-4, 4), rng)
    if rng.random() < 0.3:
        plain = made.with_parallels(plain, rng)
    plain = made.relabelled(plain, rng)
    if rng.random() < 0.3:
        return plain.poses_problem(10.0 ** rng.uniform(-4, 4, plain.graph.num_edges))
    return plain.rotations_problem()


def _searched(rng: np.random.Generator) -> Posed | None:
    """Three or four rotations in the plane, most of them loose, dressed up."""
    n = 3 if rng.random() < 0.01 else 4
    edges = np.argwhere(np.tri(n, k=-1).T)
    edges = np.concatenate([edges, edges[: rng.integers(0, 3)]])
    graph = _rotations(edges, so.random(rng, n, 2), 10.0, float(rng.integers(0, 3)), rng)
    found = truth_by_search(Quadratic(graph))
    if found is None or (not found[0].loose and rng.random() < 0.98):
        return None
    truth, best = found
    problem = Quadratic(graph)
    starts = [Estimate(so.random(rng, n, 2)) for _ in range(6)]
    worst = best_of(problem, starts)[-1]
    plain = Made(graph, best.rotations, worst.rotations, problem.cost(best))
    dressed, first, second = _dressed(plain, rng)
    upper = truth_by_oracle(dressed, first).upper
    # What dressing does to the data is rounding.
    lower = truth.lower - 1e-14 * problem.scale
    return dressed, [first, second], Truth(upper, lower, Known.SEARCH, truth.loose)


def _exact(rng: np.random.Generator) -> Posed | None:
    """A closed walk measured without noise, F* = 0, and where a start that winds around ends."""
    n, d = int(rng.integers(5, 13)), int(rng.integers(2, 4))
    chords = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(rng.integers(0, 2))]
    edges = np.array([(k, (k + 1) % n) for k in range(n)] + chords, dtype=np.intp)
    problem, best = _measured(edges, d, 0.0, rng)
    turns = [k * 2.0 * np.pi * np.arange(n)[:, None] / n for k in (1, -1, 2)]
    axis = np.eye(so.tangent_dim(d))[-1]
    starts = [Estimate(so.project(so.exp(turn * axis) @ best.rotations)) for turn in turns]
    points = best_of(problem, starts)
    truth = truth_by_form(problem, best, 0.0)
    return problem, _some([points[-1], best], rng), truth


def _noisy(rng: np.random.Generator) -> Posed | None:
    """Random graphs with noise from none to all: the best descent, and the worst."""
    n, d = int(rng.integers(3, 13)), int(rng.integers(2, 4))
    noise = 10.0 ** rng.uniform(-4.0, 0.3) if rng.random() < 0.6 else 10.0
    extra = int(rng.integers(1, 2 * n)) if rng.random() < 0.4 else int(rng.integers(1, 4))
    problem, true = _measured(_edges(n, extra, rng), d, noise, rng)
    points = best_of(problem, [true, *(_start(problem, rng) for _ in range(3))])
    if not points:
        return None
    truth = truth_by_oracle(problem, points[0])
    worst = problem.cost(points[-1]) > (1.0 + 1e-4) * problem.cost(points[0])
    return problem, [points[0], *([points[-1]] if worst else [])], truth


def _displaced(rng: np.random.Generator) -> Posed | None:
    """The same, moved a little: points that are not stationary, near the optimum or not."""
    drawn = _noisy(rng)
    if drawn is None:
        return None
    problem, points, truth = drawn
    moved = []
    for point in points:
        size = 10.0 ** rng.uniform(-9.0, -1.0)
        turns = so.exp(size * rng.standard_normal((problem.n, so.tangent_dim(problem.d))))
        near = problem.complete(so.project(point.rotations @ turns))
        if near.translations is not None and rng.random() < 0.5:
            # Far from the origin, where doubles are coarse, or with translations of their own.
            t = near.translations + 10.0 ** rng.uniform(0.0, 8.0) * np.abs(near.translations).max()
            if rng.random() < 0.5:
                t = near.translations * (1.0 + size * rng.standard_normal(t.shape))
            near = Estimate(near.rotations, t)
        moved.append(near)
    return problem, moved, truth


def _uneven(rng: np.random.Generator) -> Posed | None:
    """What breaks arithmetic: the best descent, and a point that is not stationary."""
    problem = Quadratic(uneven_graph(rng))
    starts = [_start(problem, rng) for _ in range(4)]
    points = best_of(problem, starts)
    if not points:
        return None
    start = problem.complete(starts[0].rotations)
    return problem, [points[0], start], truth_by_oracle(problem, points[0])


def uneven_graph(rng: np.random.Generator) -> Graph:
    """A tiny graph of weights over up to 60 decades, half-turns, contradicting parallel edges."""
    n, d = int(rng.integers(2, 7)), int(rng.integers(2, 4))
    edges = _edges(n, int(rng.integers(0, 2 * n)), rng)
    if rng.random() < 0.5:
        edges = np.concatenate([edges, edges[rng.integers(0, len(edges), 2)]])
    m = len(edges)
    true = so.random(rng, n, d) if rng.random() < 0.7 else np.tile(np.eye(d), (n, 1, 1))
    measured = _rotations(edges, true, float(rng.choice([0.0, 1e-6, 1e-2])), 0.0, rng).rotations
    half = so.exp(math.pi * np.eye(so.tangent_dim(d)))[rng.integers(0, so.tangent_dim(d), m)]
    turned = (rng.random(m) < rng.choice([0.0, 0.3]))[:, None, None]
    decades = float(rng.choice([0.0, 3.0, 15.0, 30.0, 60.0]))
    kappa = 10.0 ** (rng.uniform(-30.0, 30.0) + _spread(decades, m, rng))
    rotations = so.project(np.where(turned, measured @ half, measured))
    rotation = RotationGraph(n, edges, rotations, kappa)
    if rng.random() < 0.5:
        return rotation
    lengths = 10.0 ** (rng.uniform(-6.0, 6.0) + _spread(decades / 5.0, m, rng))
    tau = kappa.mean() / lengths**2 * 10.0 ** _spread(decades, m, rng)
    return PoseGraph(rotation, lengths[:, None] * rng.standard_normal((m, d)), tau)


def _spread(decades: float, count: int, rng: np.random.Generator) -> FloatArray:
    return rng.uniform(-decades / 2, decades / 2, count)


def _measured(
    edges: IntArray, d: int, noise: float, rng: np.random.Generator
) -> tuple[Quadratic, Estimate]:
    """Rotations or poses, and the truth that was measured."""
    n, m = int(edges.max()) + 1, len(edges)
    decades = float(rng.choice([0.0, 1.0, 3.0, 6.0]))
    true = so.random(rng, n, d)
    rotation = _rotations(edges, true, noise, decades, rng)
    if rng.random() < 0.5:
        return Quadratic(rotation), Estimate(true)
    length = 10.0 ** (rng.uniform(-6.0, 6.0) if rng.random() < 0.3 else 0.0)
    t = length * rng.standard_normal((n, d))
    if rng.random() < 0.2:
        t[: n // 2] = t[0]  # some at one place
    i, j = edges.T
    step = np.einsum("mba,mb->ma", true[i], t[j] - t[i])
    step += noise * length * rng.standard_normal((m, d))
    tau = 10.0 ** rng.uniform(-decades / 2, decades / 2, m) / length**2
    graph = PoseGraph(rotation, step, tau)
    return Quadratic(graph), Estimate(true, t)


def _rotations(
    edges: IntArray, true: FloatArray, noise: float, decades: float, rng: np.random.Generator
) -> Graph:
    (n, d, _), m = true.shape, len(edges)
    i, j = edges.T
    turns = so.exp(noise * rng.standard_normal((m, so.tangent_dim(d))))
    measured = so.project(np.swapaxes(true[i], 1, 2) @ true[j] @ turns)
    kappa = 10.0 ** rng.uniform(-decades / 2, decades / 2, m)
    return RotationGraph(n, edges, measured, kappa)


def _edges(n: int, extra: int, rng: np.random.Generator) -> IntArray:
    """A random tree or a path, and further, possibly parallel edges, in any direction."""
    is_path = rng.random() < 0.5
    tree = [(k - 1 if is_path else int(rng.integers(0, k)), k) for k in range(1, n)]
    more = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(extra)]
    edges = np.array(tree + more, dtype=np.intp)
    flip = rng.random(len(edges)) < 0.5
    edges[flip] = edges[flip][:, ::-1]
    return edges


def _start(problem: Quadratic, rng: np.random.Generator) -> Estimate:
    return Estimate(so.random(rng, problem.n, problem.d))


def _some(points: list[Estimate], rng: np.random.Generator) -> list[Estimate]:
    """The first of the points, and in a third of the instances the others too."""
    return points if rng.random() < 1.0 / 3.0 else points[:1]


KINDS = (
    InstanceKind("wound-up, random", 0.25, _wound),
    InstanceKind("exact data, random", 0.1, _exact),
    InstanceKind("up to four in the plane, random", 0.15, _searched),
    InstanceKind("noise, random", 0.3, _noisy),
    InstanceKind("not stationary, random", 0.1, _displaced),
    InstanceKind("uneven weights, random", 0.1, _uneven),
)


def kind_called(name: str) -> InstanceKind:
    """The kind called ``name``."""
    return next(kind for kind in KINDS if kind.name == name)


def blocks(total: int) -> Iterator[tuple[InstanceKind, int]]:
    """The blocks, kind and first seed, that make a campaign of at least ``total`` instances."""
    for kind in KINDS:
        for first in range(0, math.ceil(kind.share * total), BLOCK):
            yield kind, first
