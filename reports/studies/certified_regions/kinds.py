"""Random small graphs of all kinds, each with its certificate."""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import certpgo
from certpgo import Certificate, Estimate, Instance, Quadratic
from certpgo.graph import Graph, PoseGraph, RotationGraph
from certpgo.graph.constructors import of_couplings
from certpgo.graph.kinds import NODES, Node
from certpgo.io.datasets.monocular import random_maps
from certpgo.linalg import rotations as so
from certpgo.objective.choose_cost import Certifiable, objective_of
from certpgo.objective.manifolds import MANIFOLDS, POSE
from certpgo.objective.truncated_cost import TruncatedCost
from reports.studies.bookkeeping.drawing import (
    Measurements,
    draw,
    random_information,
    read_bytes,
)

#: A kind of measurement that the package does not know.
HEIGHTS = Path(__file__).parents[3] / "tests" / "data" / "observations" / "heights.py"
#: A kind of node that it does not know: a frame of either handedness.
MIRRORED = max(Node) + 1
#: How far positions are from the origin, metres, where they are far.
FAR = 1e6
#: Orders of magnitude of weights on either side of one.
ORDERS = 6.0

Drawn = tuple[Certifiable, Certificate]


def poses(rng: np.random.Generator, cost: str = "chordal", **options: float) -> Drawn:
    """Poses alone unless options say more; see `reports.studies.bookkeeping.drawing.draw`."""
    chosen = {"points": 0.0, "priors": 0.0, "distances": 0.0, "loops": 2.0} | options
    of = draw(rng, nodes=(4, 8), **chosen)  # type: ignore[arg-type]
    problem = objective_of(of.instance, cost)
    return problem, certpgo.certify(problem, _truth(of))


def rotations(rng: np.random.Generator) -> Drawn:
    """Rotations alone."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.0, loops=2.0)
    problem = Quadratic(of.graph.rotations_alone)
    return problem, certpgo.certify(problem, Estimate(of.R))


def proven(rng: np.random.Generator) -> Drawn:
    """Poses at the proof tier, whose residuals are measured."""
    of = draw(rng, nodes=(4, 7), points=0.3, priors=0.3, loops=2.0)
    problem = Quadratic(of.graph)
    return problem, certpgo.certify(problem, _truth(of), tier="proof")


def of_all_weights(rng: np.random.Generator, cost: str = "chordal") -> Drawn:
    """Weights over twelve orders of magnitude, of rotations and of translations."""
    of = draw(rng, nodes=(4, 8), points=0.2, priors=0.2, loops=2.0, full=0.0)
    weights = 10.0 ** rng.uniform(-ORDERS, ORDERS, (of.m, 2))
    d, p = of.d, of.information.shape[1]
    each = weights[:, np.r_[np.zeros(d, int), np.ones(p - d, int)]]
    information = each[:, :, None] * np.eye(p)
    information[~of.turned, d:] = 0.0
    problem = objective_of(replace(of, information=information).instance, cost)
    return problem, certpgo.certify(problem, _truth(of))


def far_away(rng: np.random.Generator) -> Drawn:
    """Priors of positions a thousand kilometres from the origin."""
    of = draw(rng, nodes=(4, 8), points=0.3, priors=1.0, loops=2.0)
    shift, priors = FAR * rng.standard_normal(of.d), of.edges[:, 0] == of.n - 1
    t, steps = of.t.copy(), of.steps.copy()
    t[:-1] += shift
    steps[priors] += shift
    of = replace(of, t=t, steps=steps)
    problem = Quadratic(of.graph)
    return problem, certpgo.certify(problem, _truth(of))


def held(rng: np.random.Generator, cost: str) -> Drawn:
    """Poses of which a file holds two."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.3, loops=2.0)
    of = replace(of, held=(0, of.n - 2 - of.world))
    answer = certpgo.solve(read_bytes(of.text.encode(), fixed="held"), cost=cost)
    return answer.problem, answer.certificate


def partial(rng: np.random.Generator) -> Drawn:
    """Some measurements of rotations alone, and some of translations alone."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.5, loops=3.0)
    kappa, tau = of.kappa.copy(), of.tau.copy()
    between = of.turned & (of.edges[:, 0] < of.n - of.world)
    loops = between & (np.arange(of.m) >= of.n - of.world - 1)
    loops = rng.permutation(np.flatnonzero(loops))
    kappa[loops[::3]] = tau[loops[1::3]] = 0.0
    world = of.edges[:, 0] == of.n - 1 if of.world else None
    rotation = RotationGraph(of.n, of.edges, of.turns, kappa)
    problem = Quadratic(PoseGraph(rotation, of.steps, tau, absolute=world))
    return problem, certpgo.certify(problem, _truth(of))


def general(rng: np.random.Generator) -> Drawn:
    """Matrix weights of rotations, and arms."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.0, loops=2.0)
    B = random_information(rng, of.m, of.d, of.d, False) / 0.05**2
    rotation = of_couplings(of.n, of.edges, of.turns, of.turns @ B)
    arms = 0.5 * rng.standard_normal((of.m, of.d))
    i, j = of.edges.T
    steps = of.steps + np.einsum("mba,mbc,mc->ma", of.R[i], of.R[j], arms)
    problem = Quadratic(PoseGraph(rotation, steps, of.tau, arms))
    return problem, certpgo.certify(problem, _truth(of))


def joint(rng: np.random.Generator) -> Drawn:
    """Two maps and what lies between them."""
    of = draw(rng, nodes=(7, 9), points=0.0, priors=0.0, loops=3.0)
    half = of.n // 2
    maps = [of.induced(np.arange(half)), of.induced(np.arange(half, of.n))]
    between = of.subset((of.edges < half).any(axis=1) & (of.edges >= half).any(axis=1))
    merged = certpgo.merge([part.instance for part in maps], between.instance)
    return merged.answer.problem, merged.answer.certificate


def truncated(rng: np.random.Generator, cost: str, alone: bool = False) -> Drawn:
    """Some measurements may be rejected, at prices about what they cost."""
    of = draw(rng, nodes=(4, 7), points=0.0, priors=0.0, loops=4.0, noises=(0.05, 0.3))
    graph: Graph | Instance = of.graph.rotations_alone if alone else of.instance
    whole, truth = objective_of(graph, cost), _truth(of, alone)
    prices = np.full(of.m, np.inf)
    few = of.n - 1 + rng.permutation(max(of.m - of.n + 1, 0))[:4]
    prices[few] = (whole.edge_costs(truth)[few] + 1e-3) * 10.0 ** rng.uniform(-1.0, 1.0, len(few))
    problem = TruncatedCost(whole, prices)  # type: ignore[arg-type]
    return problem, certpgo.certify(problem, truth)


def scaled(rng: np.random.Generator, measured: bool = False) -> Drawn:
    """Nodes of unknown scale, perhaps with distances and heights of those whose scale is known."""
    d, noise = int(rng.integers(2, 4)), float(rng.choice([1e-3, 0.03]))
    known = (1, 2, 3) if measured else tuple(range(1, 1 + int(rng.integers(3))))
    sizes = {"turn": noise, "scale": noise, "move": noise}
    graph, truth = random_maps(rng, d, 7, 12, known=known, points=1, **sizes)
    if measured:
        graph = graph.with_blocks(*_observed(rng, truth, np.array([0, *known]), noise))
    problem = objective_of(graph)
    return problem, certpgo.certify(problem, truth)


def own_measurements(rng: np.random.Generator, cost: str) -> Drawn:
    """Heights, of a file besides the package, and distances."""
    of = draw(rng, nodes=(4, 7), points=0.0, priors=0.0, loops=2.0, noises=(1e-3, 0.05))
    truth = _truth(of)
    graph = of.instance.graph.with_blocks(*_observed(rng, truth, np.arange(of.n), 0.03))
    problem = objective_of(graph, cost)
    return problem, certpgo.certify(problem, truth)


def own_nodes(rng: np.random.Generator, cost: str) -> Drawn:
    """Every third node is a frame of either handedness."""
    of = draw(rng, nodes=(4, 8), points=0.3, priors=0.0, loops=2.0)
    graph = of.instance.graph
    nodes = graph.nodes.copy()
    nodes[graph.pose_nodes[1::3]] = MIRRORED
    problem = objective_of(replace(graph, nodes=nodes), cost)
    return problem, certpgo.certify(problem, _truth(of))


def _with(draws: Callable[..., Drawn], *given: object, **options: object) -> Callable[..., Drawn]:
    return lambda rng: draws(rng, *given, **options)


KINDS: dict[str, Callable[[np.random.Generator], Drawn]] = {
    "rotations": rotations,
    "poses": poses,
    "points": _with(poses, points=1.0),
    "priors, GPS": _with(poses, points=0.3, priors=1.0),
    "held nodes": _with(held, "chordal"),
    "partial measurements": partial,
    "matrix weights, arms": general,
    "joint graphs": joint,
    "g2o's cost": _with(poses, "g2o", full=1.0),
    "g2o's cost, points and priors": _with(poses, "g2o", points=1.0, priors=1.0),
    "g2o's cost, held nodes": _with(held, "g2o"),
    "GTSAM's cost": _with(poses, "gtsam", full=1.0),
    "GTSAM's cost, points and priors": _with(poses, "gtsam", points=1.0, priors=1.0),
    "distances": _with(poses, distances=1.0),
    "distances, points, priors": _with(poses, points=0.5, priors=0.5, distances=1.0),
    "distances, g2o's cost": _with(poses, "g2o", distances=1.0),
    "distances, GTSAM's cost": _with(poses, "gtsam", distances=1.0),
    "truncated": _with(truncated, "chordal"),
    "truncated rotations": _with(truncated, "chordal", alone=True),
    "truncated, g2o's cost": _with(truncated, "g2o"),
    "truncated, GTSAM's cost": _with(truncated, "gtsam"),
    "scales": scaled,
    "scales, distances, heights": _with(scaled, measured=True),
    "own measurements": _with(own_measurements, "chordal"),
    "own measurements, g2o's cost": _with(own_measurements, "g2o"),
    "own nodes": _with(own_nodes, "chordal"),
    "own nodes, g2o's cost": _with(own_nodes, "g2o"),
    "twelve orders of weights": of_all_weights,
    "twelve orders, g2o's cost": _with(of_all_weights, "g2o"),
    "far from the origin": far_away,
    "proof tier": proven,
}


@contextmanager
def own_kinds() -> Iterator[None]:
    """The kind of node is known within."""
    kind = replace(POSE, name="poses of either handedness", rounded=so.orthonormal)
    NODES[MIRRORED], MANIFOLDS[MIRRORED] = "pose{s} of either handedness", kind
    try:
        yield
    finally:
        del NODES[MIRRORED], MANIFOLDS[MIRRORED]


@cache
def heights() -> Any:
    """The class of heights, of a file."""
    return runpy.run_path(str(HEIGHTS))["Heights"]


def _observed(
    rng: np.random.Generator, truth: Estimate, nodes: np.ndarray, noise: float
) -> list[certpgo.Ranges]:
    """Distances between nodes, and heights above planes through them."""
    t, n = truth.translations, truth.num_nodes
    pairs = np.array([rng.choice(nodes, 2, replace=False) for _ in range(6)])
    i, j = pairs.T
    apart = np.linalg.norm(t[j] - t[i], axis=1)
    measured = np.abs(apart + noise * rng.standard_normal(6))
    normals = so.random(rng, 6, truth.d)[:, 0]
    v = np.einsum("mba,mb->ma", truth.rotations[i], t[j] - t[i])
    above = (normals * v).sum(axis=1) + noise * rng.standard_normal(6)
    weights = rng.uniform(20.0, 60.0, (2, 6))
    return [
        certpgo.Ranges(n, pairs[:3], measured[:3], weights[0, :3]),
        heights()(n, pairs[3:], normals[3:], above[3:], weights[1, 3:]),
    ]


def _truth(of: Measurements, alone: bool = False) -> Estimate:
    return Estimate(of.R, None if alone else of.t)
