"""Rotation graphs made with stationary points and an optimum that are known, and kept known.

Relabelling, other frames, trees hung on, edges split into parallel ones and graphs joined at a node
change neither the optimum nor what is stationary.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from certpgo.graph import Estimate, Graph, PoseGraph, RotationGraph
from certpgo.io.datasets.synthetic import winding_cycle
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.quadratic import Quadratic


@dataclass(frozen=True, eq=False)
class Made:
    """A graph, rotations (n, d, d) of its optimum and of another point, and its F*."""

    graph: Graph
    best: FloatArray
    other: FloatArray
    optimum: float

    @property
    def d(self) -> int:
        """Dimension of space."""
        return self.graph.d

    @property
    def n(self) -> int:
        """Number of nodes."""
        return self.graph.num_nodes

    def rotations_problem(self) -> tuple[Quadratic, Estimate, Estimate]:
        """The problem, its optimum and the other point."""
        return Quadratic(self.graph), Estimate(self.best), Estimate(self.other)

    def poses_problem(self, tau: FloatArray) -> tuple[Quadratic, Estimate, Estimate]:
        """The same as poses that are all at one place: F* is that of the rotations."""
        still = np.zeros((self.graph.num_edges, self.d))
        origin = np.zeros((self.n, self.d))
        problem = Quadratic(PoseGraph(self.graph, still, tau))
        return problem, Estimate(self.best, origin), Estimate(self.other, origin)


def wound(n: int, theta: float, winding: int, d: int = 3) -> Made:
    """`winding_cycle` of unit weights, abs(theta) < pi."""
    instance, other = winding_cycle(n, theta, winding, d)
    _, best = winding_cycle(n, theta, 0, d)
    optimum = 8.0 * n * math.sin(theta / (2.0 * n)) ** 2
    return Made(instance.graph, best.rotations, other.rotations, optimum)


def wound_weighted(kappa: FloatArray, theta: float, winding: int, d: int) -> Made | None:
    """The same with weights: residuals alpha_e with kappa_e sin(alpha_e) the same for all edges.

    They add up to theta + 2 pi k; the point of winding 0 is optimal when they add up to at most pi.
    None when no residuals, at most one of them above a right angle, add up to that much.
    """
    n = len(kappa)
    plain = wound(n, theta, winding, d)
    best = _balanced(kappa, theta)
    other = _balanced(kappa, theta + 2.0 * math.pi * winding)
    if best is None or other is None:
        return None
    optimum = 8.0 * float(kappa @ np.sin(0.5 * best) ** 2)
    graph = plain.graph.with_weights(kappa)
    return Made(graph, _chained(best, d), _chained(other, d), optimum)


def relabelled(made: Made, rng: np.random.Generator) -> Made:
    """Other node numbers, a frame of its own for every node, and edges turned around."""
    n, graph = made.n, made.graph
    label, frames = rng.permutation(n), so.random(rng, n, made.d)
    i, j = graph.edges.T
    measured = np.swapaxes(frames[i], 1, 2) @ graph.rotations @ frames[j]
    edges = label[graph.edges]
    turned = rng.random(len(edges)) < 0.5
    edges[turned] = edges[turned][:, ::-1]
    measured[turned] = np.swapaxes(measured[turned], 1, 2)
    order = rng.permutation(len(edges))
    new = RotationGraph(n, edges[order], so.project(measured[order]), graph.kappa[order])
    back = np.argsort(label)
    world = so.random(rng, 1, made.d)
    best, other = (so.project(world @ R @ frames)[back] for R in (made.best, made.other))
    return replace(made, graph=new, best=best, other=other)


def with_tree(made: Made, leaves: int, kappa: float, rng: np.random.Generator) -> Made:
    """Nodes hung on by bridges, which cost nothing."""
    n, graph = made.n, made.graph
    best, other, edges = list(made.best), list(made.other), graph.edges.tolist()
    turns = so.random(rng, leaves, made.d)
    for turn in turns:
        parent = int(rng.integers(len(best)))
        edges.append([parent, len(best)])
        best.append(best[parent] @ turn)
        other.append(other[parent] @ turn)
    measured = np.concatenate([graph.rotations, turns])
    weights = np.concatenate([graph.kappa, np.full(leaves, kappa)])
    new = RotationGraph(n + leaves, np.array(edges), measured, weights)
    return replace(
        made, graph=new, best=so.project(np.array(best)), other=so.project(np.array(other))
    )


def with_parallels(made: Made, rng: np.random.Generator) -> Made:
    """Some edges split into two of the same measurement whose weights add up to theirs."""
    graph = made.graph
    split = rng.random(graph.num_edges) < 0.5
    share = np.where(split, 0.25, 1.0)  # a power of two, so that they add up exactly
    kappa = np.concatenate([share * graph.kappa, 0.75 * graph.kappa[split]])
    edges = np.concatenate([graph.edges, graph.edges[split][:, ::-1]])
    back = np.swapaxes(graph.rotations[split], 1, 2)
    measured = np.concatenate([graph.rotations, back])
    return replace(made, graph=RotationGraph(made.n, edges, measured, kappa))


def joined(a: Made, b: Made, bridge: float | None = None) -> Made:
    """Two graphs with one node in common, or joined by a bridge of that weight."""
    if bridge is not None:
        a = with_tree(a, 1, bridge, np.random.default_rng(0))
    shift = a.n - 1
    edges = np.concatenate([a.graph.edges, b.graph.edges + shift])
    measured = np.concatenate([a.graph.rotations, b.graph.rotations])
    kappa = np.concatenate([a.graph.kappa, b.graph.kappa])
    graph = RotationGraph(a.n + b.n - 1, edges, measured, kappa)
    points = [
        so.project(np.concatenate([A, (A[-1] @ B[0].T @ B)[1:]]))
        for A, B in ((a.best, b.best), (a.other, b.other))
    ]
    return Made(graph, points[0], points[1], a.optimum + b.optimum)


def _balanced(kappa: FloatArray, total: float) -> FloatArray | None:
    """Angles that add up to ``total``, of equal kappa sin(angle); at most one above pi/2."""
    weakest = kappa == kappa.min()
    if weakest.sum() > 1:
        weakest[:] = False

    def angles(force: float, beyond: bool) -> FloatArray:
        below = np.arcsin(np.minimum(force / kappa, 1.0))
        return np.where(weakest & beyond, np.pi - below, below)

    def excess(force: float, beyond: bool) -> float:
        return float(angles(force, beyond).sum()) - abs(total)

    grid = np.linspace(0.0, kappa.min(), 65)
    for beyond in (False, True):
        values = np.array([excess(force, beyond) for force in grid])
        crossings = np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0))
        if not len(crossings):
            continue
        low, high = grid[crossings[0]], grid[crossings[0] + 1]
        rises = values[crossings[0]] < 0.0
        for _ in range(200):
            middle = 0.5 * (low + high)
            if (excess(middle, beyond) < 0.0) == rises:
                low = middle
            else:
                high = middle
        return np.asarray(np.sign(total) * angles(low, beyond))
    return None


def _chained(residuals: FloatArray, d: int) -> FloatArray:
    """Rotations of a cycle of identity measurements but the last, with these residual angles."""
    angles = -np.concatenate([[0.0], np.cumsum(residuals[:-1])])
    return so.exp(angles[:, None] * np.eye(so.tangent_dim(d))[-1])
