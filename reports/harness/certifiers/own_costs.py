"""Named families under the costs of g2o and GTSAM, with full information matrices."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator
from typing import cast

import numpy as np

from certpgo.errors import InputNotice
from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.graph.information import Information
from certpgo.graph.trees import compose, spanning_tree
from certpgo.io import datasets
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray, IntArray
from certpgo.objective.choose_cost import COSTS, Sum, objective_of
from certpgo.solve.solving import solve
from reports.harness.certifiers import made
from reports.harness.certifiers.oracle import RESIDUALS
from reports.harness.certifiers.points import (
    ZooPoint,
    best_of,
    stationary,
    truth_by_form,
    truth_in_hand,
)


def wound(quick: bool) -> Iterator[ZooPoint]:
    """Wound-up cycles at one place: rotations of equal weight, any information of translations.

    Where the cost is w sin^2(alpha/2) it is F of kappa = w/8. Where it is w alpha^2, n residuals
    that add up to at least theta cost at least w theta^2 / n.
    """
    theta, weight = 0.3, 8.0
    for cost, d, n in itertools.product(RESIDUALS, (2, 3), (10, 60) if quick else (10, 60, 200)):
        ring = made.wound(n, theta, 1, d)
        rng = np.random.default_rng(np.random.SeedSequence((n, d)))
        information = _information(n, d, 2.0, rng)
        information[:, d:] = information[:, :, d:] = 0.0
        information[:, d:, d:] = weight * np.eye(so.tangent_dim(d))
        problem = _problem(cost, ring.graph, np.zeros((n, d)), information)
        of_sines = cost == "g2o" and d == 3
        optimum = ring.optimum if of_sines else weight * theta**2 / n
        still = np.zeros((n, d))
        truth = truth_by_form(problem, Estimate(ring.best, still), optimum)
        for name, R in (("at the optimum", ring.best), ("wound up", ring.other)):
            yield ZooPoint(f"{cost}, {d}D n={n}, {name}", problem, Estimate(R, still), truth)


def exact(quick: bool) -> Iterator[ZooPoint]:
    """Data without noise, f* = 0: the truth, and where descents from other starts end."""
    for cost, d, seed in itertools.product(RESIDUALS, (2, 3), range(1 if quick else 10)):
        rng = np.random.default_rng(np.random.SeedSequence((1, d, seed)))
        problem, true = _measured(cost, d, 0.0, rng)
        truth = truth_by_form(problem, true, 0.0)
        yield ZooPoint(f"{cost}, {d}D seed {seed}, the truth", problem, true, truth)
        for k, point in enumerate(best_of(problem, _starts(problem, true, rng))):
            yield ZooPoint(f"{cost}, {d}D seed {seed}, point {k}", problem, point, truth)


def noisy(quick: bool) -> Iterator[ZooPoint]:
    """Noise from little to all: the best and the worst end of several descents."""
    for cost, d, seed in itertools.product(RESIDUALS, (2, 3), range(1 if quick else 30)):
        rng = np.random.default_rng(np.random.SeedSequence((2, d, seed)))
        noise = 10.0 ** rng.uniform(-2.0, 0.3)
        problem, true = _measured(cost, d, noise, rng)
        points = best_of(problem, [true, *_starts(problem, true, rng)])
        truth = truth_in_hand(problem, points[0])
        for name, point in (("best", points[0]), ("worst", points[-1])):
            yield ZooPoint(f"{cost}, {d}D seed {seed}, {name}", problem, point, truth)


def read(quick: bool) -> Iterator[ZooPoint]:
    """Files, where they are here: descents from their vertices, from trees and from turned poses.

    The optimum is the one that `solve` finds.
    """
    for name, cost in itertools.product(("MIT",) if quick else ("MIT", "intel"), RESIDUALS):
        if datasets.find(name) is None:
            continue
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", InputNotice)
            instance = datasets.load(name, download=False)
        problem = cast("Sum", objective_of(instance, cost))
        chordal = problem.chordal
        best = solve(problem).estimate
        truth = truth_in_hand(problem, best)
        rng = np.random.default_rng(3)
        starts = {
            "the file's vertices": instance.initial,
            "odometry": compose(chordal.graph, spanning_tree(chordal.graph)),
            "F's optimum": solve(instance).estimate,
            **{
                f"poses turned by {size:g}": _turned(problem, best, size, rng)
                for size in (0.3, 1.0, 3.0)
            },
        }
        if quick:
            starts = {"the file's vertices": instance.initial}
        yield ZooPoint(f"{name}, {cost}, the optimum", problem, best, truth)
        for start, estimate in starts.items():
            if estimate is not None:
                point = stationary(problem, estimate)
                yield ZooPoint(f"{name}, {cost}, from {start}", problem, point, truth)


def _problem(cost: str, rotation: Graph, t: FloatArray, information: FloatArray) -> Sum:
    d = rotation.d
    inverse = [
        np.trace(np.linalg.inv(information[:, block, block]), axis1=1, axis2=2)
        for block in (slice(d, None), slice(0, d))
    ]
    kappa, tau = (1.0 if d == 2 else 1.5) / inverse[0], d / inverse[1]
    stated = Information.of(information)
    graph = PoseGraph(rotation.with_weights(kappa), t, tau, information=stated)
    return Sum(graph, COSTS[cost])


def _information(m: int, d: int, decades: float, rng: np.random.Generator) -> FloatArray:
    """(m, p, p) matrices in random directions, of eigenvalues over some decades."""
    p = d * (d + 1) // 2
    axes, _ = np.linalg.qr(rng.standard_normal((m, p, p)))
    values = 10.0 ** rng.uniform(-decades / 2, decades / 2, (m, 1, p))
    full = (axes * values) @ np.swapaxes(axes, 1, 2)
    return np.asarray(0.5 * (full + np.swapaxes(full, 1, 2)))


def _measured(cost: str, d: int, noise: float, rng: np.random.Generator) -> tuple[Sum, Estimate]:
    """A closed walk with some chords, and the truth that was measured."""
    n = int(rng.integers(5, 16))
    edges = _edges(n, int(rng.integers(0, n)), rng)
    m = len(edges)
    true = Estimate(so.random(rng, n, d), 3.0 * rng.standard_normal((n, d)))
    R, t = true.rotations, true.translations
    i, j = edges.T
    turns = so.exp(noise * rng.standard_normal((m, so.tangent_dim(d))))
    back = np.swapaxes(R[i], 1, 2)
    step = (back @ (t[j] - t[i])[:, :, None])[:, :, 0]  # type: ignore[index]
    step += noise * rng.standard_normal((m, d))
    rotation = RotationGraph(n, edges, so.project(back @ R[j] @ turns), np.ones(m))
    decades = float(rng.choice([0.0, 0.5, 1.0, 2.0]))
    return _problem(cost, rotation, step, _information(m, d, decades, rng)), true


def _edges(n: int, chords: int, rng: np.random.Generator) -> IntArray:
    more = [tuple(rng.choice(n, 2, replace=False).tolist()) for _ in range(chords)]
    return np.array([(k, (k + 1) % n) for k in range(n)] + more, dtype=np.intp)


def _starts(problem: Sum, true: Estimate, rng: np.random.Generator) -> list[Estimate]:
    """The odometry, the truth wound up, and random rotations."""
    n, d = problem.n, problem.d
    tree = compose(problem.chordal.graph, spanning_tree(problem.chordal.graph))
    axis = np.eye(so.tangent_dim(d))[-1]
    turns = [so.exp(2.0 * math.pi * k / n * np.arange(n)[:, None] * axis) for k in (1, -1)]
    wound = [Estimate(so.project(turn @ true.rotations)) for turn in turns]
    return [tree, *wound, *(Estimate(so.random(rng, n, d)) for _ in range(2))]


def _turned(problem: Sum, point: Estimate, size: float, rng: np.random.Generator) -> Estimate:
    """Poses turned by some radians, with the translations that are best for F."""
    turns = so.exp(size * rng.standard_normal((problem.n, so.tangent_dim(problem.d))))
    return problem.chordal.complete(so.project(point.rotations @ turns))
