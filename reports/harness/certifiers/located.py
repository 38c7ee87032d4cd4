"""Named families with landmarks, priors, and edges that measure a rotation or a position alone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.graph.information import of_positions
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.choose_cost import CHORDAL, COSTS, Sum
from certpgo.objective.quadratic import Quadratic
from reports.harness.certifiers.oracle import RESIDUALS
from reports.harness.certifiers.points import (
    ZooPoint,
    best_of,
    truth_by_form,
    truth_by_oracle,
    truth_in_hand,
)


@dataclass(frozen=True)
class Extras:
    """What a random graph of poses along a walk measures beyond its odometry.

    Attributes
    ----------
    points : landmarks, each seen by four poses, or by all without odometry
    positions, attitudes : poses that are measured from the world
    turns, steps : edges between poses that measure a rotation, and a position, alone
    odometry : whether the steps of the walk are measured
    flat : whether all positions lie in a plane
    """

    points: int = 0
    positions: int = 0
    attitudes: int = 0
    turns: int = 0
    steps: int = 0
    odometry: bool = True
    flat: bool = False


LANDMARKS = Extras(points=6)
SIGHTINGS_ALONE = Extras(points=8, odometry=False)
PRIORS = Extras(positions=4, attitudes=2)
PRIORS_IN_A_PLANE = Extras(positions=4, flat=True)
PARTIAL = Extras(points=3, positions=2, turns=3, steps=3)


def exact(extras: Extras, quick: bool) -> Iterator[ZooPoint]:
    """Data without noise, the cost 0: the truth, and where descents from other starts end."""
    for cost, d, seed in _cases(extras, 2 if quick else 10):
        rng = np.random.default_rng(np.random.SeedSequence((7, d, seed)))
        problem, true = _problem(extras, cost, d, 0.0, rng)
        truth = truth_by_form(problem, true, 0.0)
        yield ZooPoint(f"{cost}, {d}D seed {seed}, the truth", problem, true, truth)
        for k, point in enumerate(best_of(problem, _starts(problem.n, d, rng))):
            yield ZooPoint(f"{cost}, {d}D seed {seed}, point {k}", problem, point, truth)


def noisy(extras: Extras, quick: bool) -> Iterator[ZooPoint]:
    """Noise from little to all: the best and the worst end of several descents."""
    for cost, d, seed in _cases(extras, 3 if quick else 30):
        rng = np.random.default_rng(np.random.SeedSequence((8, d, seed)))
        noise = 10.0 ** rng.uniform(-2.0, 0.3)
        problem, true = _problem(extras, cost, d, noise, rng)
        points = best_of(problem, [true, *_starts(problem.n, d, rng)])
        if isinstance(problem, Sum):
            truth = truth_in_hand(problem, points[0])
        else:
            truth = truth_by_oracle(problem, points[0])
        for name, point in (("best", points[0]), ("worst", points[-1])):
            yield ZooPoint(f"{cost}, {d}D seed {seed}, {name}", problem, point, truth)


def _cases(extras: Extras, seeds: int) -> Iterator[tuple[str, int, int]]:
    """Costs, dimensions and seeds; no cost but F has a rotation alone, or no whole edge."""
    whole = extras.odometry and not extras.attitudes and not extras.turns
    return itertools.product((CHORDAL, *(RESIDUALS if whole else ())), (2, 3), range(seeds))


def _starts(n: int, d: int, rng: np.random.Generator) -> list[Estimate]:
    return [
        Estimate(so.random(rng, n, d), 3.0 * rng.standard_normal((n, d)))  # of all nodes
        for _ in range(3)
    ]


def _problem(
    extras: Extras, cost: str, d: int, noise: float, rng: np.random.Generator
) -> tuple[Quadratic | Sum, Estimate]:
    """The problem, its nodes in any order but for the world, and the truth."""
    poses = int(rng.integers(4, 9))
    is_measured = extras.positions or extras.attitudes
    n, world = poses + extras.points + bool(is_measured), poses + extras.points
    R, t = so.random(rng, n, d), 3.0 * rng.standard_normal((n, d))
    if extras.flat:
        t[:, -1] = 0.0
    if is_measured:
        R[world], t[world] = np.eye(d), 0.0
    walk = [(k, k + 1) for k in range(poses - 1)] if extras.odometry else []
    seen = [
        (int(pose), poses + point)
        for point in range(extras.points)
        for pose in rng.choice(poses, 4 if extras.odometry else poses, replace=False)
    ]
    fixed = [(world, int(k)) for k in rng.choice(poses, extras.positions, replace=False)]
    turned = [(world, int(k)) for k in rng.choice(poses, extras.attitudes, replace=False)]
    chords = [tuple(rng.choice(poses, 2, replace=False)) for _ in range(extras.turns)]
    steps = [tuple(rng.choice(poses, 2, replace=False)) for _ in range(extras.steps)]
    edges = np.array([*walk, *seen, *fixed, *steps, *turned, *chords], dtype=np.intp)
    i, j = edges.T
    m, whole, moved = len(edges), len(walk), len(edges) - len(turned) - len(chords)
    back, k = np.swapaxes(R[i], 1, 2), np.arange(m)
    turns = back @ R[j] @ so.exp(noise * rng.standard_normal((m, so.tangent_dim(d))))
    there = (back @ (t[j] - t[i])[:, :, None])[:, :, 0] + noise * rng.standard_normal((m, d))
    kappa = np.where((k < whole) | (k >= moved), rng.uniform(0.5, 4.0, m), 0.0)
    tau = np.where(k < moved, rng.uniform(0.5, 4.0, m), 0.0)
    turns[kappa == 0.0] = np.eye(d)
    there[tau == 0.0] = 0.0
    flags = (np.arange(n) >= poses) & (np.arange(n) < world)
    rotation = RotationGraph(n, edges, so.project(turns), kappa)
    graph = PoseGraph(rotation, there, tau, points=flags if extras.points else None)
    true = Estimate(so.project(R), t)
    if cost == CHORDAL:
        return Quadratic(graph), true
    full = _information(m, d, rng)
    full[kappa == 0.0] = of_positions(full[kappa == 0.0, :d, :d])
    return Sum(graph.with_information(full), COSTS[cost]), true


def _information(m: int, d: int, rng: np.random.Generator) -> FloatArray:
    """(m, p, p) matrices in random directions, of eigenvalues over a decade."""
    p = d + so.tangent_dim(d)
    axes, _ = np.linalg.qr(rng.standard_normal((m, p, p)))
    full = (axes * 10.0 ** rng.uniform(-0.5, 0.5, (m, 1, p))) @ np.swapaxes(axes, 1, 2)
    return np.asarray(0.5 * (full + np.swapaxes(full, 1, 2)))
