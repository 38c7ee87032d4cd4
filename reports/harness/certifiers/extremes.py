"""Named families at the ends of arithmetic: weights, half-turns, contradictions, long bridges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from certpgo.graph import Estimate, PoseGraph, RotationGraph
from certpgo.linalg import rotations as so
from certpgo.objective.quadratic import Quadratic
from reports.harness.certifiers import made
from reports.harness.certifiers.points import (
    ZooPoint,
    best_of,
    stationary,
    truth_by_form,
    truth_by_oracle,
)


def half_turn_triangles(quick: bool) -> Iterator[ZooPoint]:
    """Three rotations, each measured a half-turn about another axis: F* = 6, and a saddle at 8."""
    x, y, z = (2.0 * np.outer(a, a) - np.eye(3) for a in np.eye(3))
    edges = np.array([[0, 1], [0, 2], [1, 2]])
    for k, frames in enumerate(so.random(np.random.default_rng(3), 2 if quick else 8, 3)):
        for measured in ((np.eye(3), x, y), (x, y, z), (x, np.eye(3), z)):
            turned = frames @ np.array(measured) @ frames.T
            problem = Quadratic(RotationGraph(3, edges, so.project(turned), np.ones(3)))
            rng = np.random.default_rng(np.random.SeedSequence((3, k)))
            starts = [Estimate(so.random(rng, 3, 3)) for _ in range(6)]
            saddle = problem.complete(frames @ np.array([np.eye(3), np.eye(3), x]) @ frames.T)
            points = [*best_of(problem, starts), saddle]
            truth = truth_by_oracle(problem, points[0])
            for name, point in (("best", points[0]), ("worst", points[-2]), ("saddle", saddle)):
                yield ZooPoint(f"frame {k}, {name}", problem, point, truth)


def contradicting(quick: bool) -> Iterator[ZooPoint]:
    """Two measurements of one step that say opposites with equal weight: 8 for every estimate."""
    for d, power in itertools.product((2, 3), (-390, 0, 390)):
        half = so.project(so.exp(math.pi * np.eye(so.tangent_dim(d))[-1:]))
        measured = np.concatenate([np.eye(d)[None], half])
        weights = np.full(2, 2.0**power)
        problem = Quadratic(RotationGraph(2, np.array([[0, 1], [0, 1]]), measured, weights))
        truth = truth_by_form(problem, Estimate(np.stack([np.eye(d)] * 2)), 8.0 * weights[0])
        for k, angle in enumerate((0.0, 0.3, 1.5, math.pi)):
            turn = so.exp(angle * np.eye(so.tangent_dim(d))[-1:])[0]
            point = Estimate(so.project(np.stack([np.eye(d), turn])))
            yield ZooPoint(f"{d}D weights 2^{power}, point {k}", problem, point, truth)


def uneven(quick: bool) -> Iterator[ZooPoint]:
    """Wound-up cycles with one edge measured again, wrongly, at a weight that hardly counts."""
    powers = ((0, -390), (0, -200), (0, -60), (60, 0), (200, 0))
    for d, n, (heavy, faint) in itertools.product((2, 3), (10, 60), powers):
        ring = made.wound(n, 0.3, 1, d)
        wrong = so.exp(np.eye(so.tangent_dim(d))[-1:])
        graph = RotationGraph(
            n,
            np.concatenate([ring.graph.edges, ring.graph.edges[:1]]),
            np.concatenate([ring.graph.rotations, wrong]),
            np.concatenate([np.full(n, 2.0**heavy), [2.0**faint]]),
        )
        problem = Quadratic(graph)
        best = stationary(problem, Estimate(ring.best))
        # The faint measurement adds at most 8 of its weight, which the slack contains.
        truth = truth_by_form(problem, best, 2.0**heavy * ring.optimum)
        yield ZooPoint(f"{d}D n={n} 2^{faint - heavy}, at the optimum", problem, best, truth)
        yield ZooPoint(
            f"{d}D n={n} 2^{faint - heavy}, wound up", problem, Estimate(ring.other), truth
        )


def long_bridges(quick: bool) -> Iterator[ZooPoint]:
    """Two wound-up cycles of poses and a bridge between them of up to 10^8 steps."""
    for d, n, length in itertools.product((2, 3), (10, 60), (1e2, 1e5, 1e8)):
        pair = made.joined(made.wound(n, 0.3, 1, d), made.wound(n, -0.2, 1, d), bridge=1.0)
        problem, best, other = pair.poses_problem(np.ones(pair.graph.num_edges))
        graph = problem.graph
        steps = np.zeros((graph.num_edges, d))
        steps[n, 0] = length  # the bridge hangs on the first cycle
        long = Quadratic(PoseGraph(graph.rotations_alone, steps, graph.tau))
        truth = truth_by_form(long, long.complete(best.rotations), pair.optimum)
        for name, point in (("at the optimum", best), ("wound up", other)):
            yield ZooPoint(
                f"{d}D n={n}, {length:g}, {name}", long, long.complete(point.rotations), truth
            )
