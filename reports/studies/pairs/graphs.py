"""Small graphs with any of the features that go together or not."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from certpgo import Estimate, Instance, Ranges, with_directions, with_priors
from certpgo.graph import Graph, PoseGraph, RotationGraph
from certpgo.graph.concatenate import joined
from certpgo.graph.information import Information
from certpgo.linalg import rotations as so
from certpgo.linalg.arrays import BoolArray, FloatArray, IntArray
from reports.studies.bookkeeping.drawing import random_information
from reports.studies.certified_regions.kinds import heights

#: Poses, and the standard deviation of measurements, metres and radians.
N, NOISE = 10, 0.02
#: Steps between the poses of measurements: a ring with chords.
STEPS = (1, 2, 3)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A graph as it grows, with what was measured.

    Attributes
    ----------
    truth : of all nodes but a world, which the last one is where there is any
    fixed : nodes that its file fixes
    """

    rng: np.random.Generator
    graph: Graph
    truth: Estimate
    fixed: tuple[int, ...] = ()
    world: bool = False

    @property
    def instance(self) -> Instance:
        """The graph as if it were read from a file, with its truth as initial values."""
        n = self.graph.num_nodes
        world = n - 1 if self.world else None
        bare = Instance("drawn", self.graph, np.arange(n), fixed=self.fixed, world=world)
        scales = np.ones(self.truth.num_nodes) if self.graph.has_scales else None
        return replace(bare, initial=bare.with_world(replace(self.truth, scales=scales)))

    @property
    def positions(self) -> FloatArray:
        """(n, d) true positions; a graph that measures none has no truth for them."""
        if self.truth.translations is None:
            raise ValueError("rotations alone")
        return self.truth.translations

    def measuring(
        self, pairs: IntArray, *, turned: BoolArray | bool = True, moved: BoolArray | bool = True
    ) -> PoseGraph:
        """Measurements of these pairs (k, 2) of nodes, or of their rotations or positions alone."""
        (i, j), k = pairs.T, len(pairs)
        d, R, t = self.truth.d, self.truth.rotations, self.positions
        exact = np.swapaxes(R[i], 1, 2) @ R[j]
        noise = NOISE * self.rng.standard_normal((k, d + so.tangent_dim(d)))
        turns = exact @ so.exp(noise[:, d:])
        steps = np.einsum("mba,mb->ma", R[i], t[j] - t[i]) + noise[:, :d]
        full = random_information(self.rng, k, d + so.tangent_dim(d), d, True) / NOISE**2
        turned, moved = (np.broadcast_to(of, k) for of in (turned, moved))
        full[~turned, d:], full[~turned, :, d:] = 0.0, 0.0
        full[~moved, :d], full[~moved, :, :d] = 0.0, 0.0
        kappa, tau = _weights(full, d)
        rotation = RotationGraph(len(R), pairs, turns, kappa * turned)
        points = self.graph.is_point if self.graph is not None else None
        return PoseGraph(
            rotation,
            steps * moved[:, None],
            tau * moved,
            points=points,
            information=Information.of(full, "g2o", "quaternion"),
        )


def _weights(full: FloatArray, d: int) -> tuple[FloatArray, FloatArray]:
    """Concentrations (k,) of information matrices, as readers have them; infinite ones are 0."""
    lone = full + np.eye(full.shape[1]) * ~full.any(axis=1)[:, None, :]
    inverse = np.linalg.inv(lone)
    of_R, of_t = (np.trace(inverse[:, s, s], axis1=1, axis2=2) for s in (slice(d, None), slice(d)))
    return (1.0 if d == 2 else 3.0 / 8.0) / of_R, d / of_t


def plain(rng: np.random.Generator, d: int, *, wrong: bool = False) -> Drawn:
    """A ring of poses with chords, with full information; one more is wrong by far if asked for."""
    angles = 2.0 * np.pi * np.arange(N) / N
    axis = np.zeros((N, so.tangent_dim(d)))
    axis[:, -1] = angles + np.pi / 2.0
    t = np.zeros((N, d))
    t[:, :2] = 3.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    if d == 3:
        t[:, 2] = np.sin(2.0 * angles)
    pairs = np.array([[k, (k + step) % N] for step in STEPS for k in range(N)])
    drawn = Drawn(rng, None, Estimate(so.exp(axis), t))  # type: ignore[arg-type]
    graph = drawn.measuring(pairs)
    if wrong:
        one = drawn.measuring(np.array([[0, N // 2]]))
        far = replace(one, translations=one.translations + 2.0, rotations=_half_turned(one))
        graph = joined([graph, far], N)
    return replace(drawn, graph=graph)


def _half_turned(graph: Graph) -> FloatArray:
    turn = np.zeros((1, so.tangent_dim(graph.d)))
    turn[:, -1] = 2.0
    return np.asarray(graph.rotations @ so.exp(turn))


def _more(of: Drawn, part: Graph) -> Drawn:
    return replace(of, graph=joined([of.graph, part], of.graph.num_nodes, of.graph.is_point))


def _pairs(of: Drawn, step: int) -> IntArray:
    poses = np.arange(N)
    return np.stack([poses, (poses + step) % N], axis=1)


def full(of: Drawn) -> Drawn:
    """Nothing besides relative poses."""
    return of


def turns(of: Drawn) -> Drawn:
    """Relative rotations alone."""
    return _more(of, of.measuring(_pairs(of, 4), moved=False))


def steps(of: Drawn) -> Drawn:
    """Relative translations alone."""
    return _more(of, of.measuring(_pairs(of, 4), turned=False))


def landmarks(of: Drawn) -> Drawn:
    """Points that poses see."""
    d, n = of.graph.d, of.graph.num_nodes
    t = np.concatenate([of.positions, of.rng.standard_normal((2, d))])
    R = np.concatenate([of.truth.rotations, np.tile(np.eye(d), (2, 1, 1))])
    points = np.append(of.graph.is_point, [True, True])
    whole = joined([of.graph], n + 2, points)
    grown = replace(of, truth=Estimate(R, t), graph=whole)
    seen = np.array([[k, n + k % 2] for k in range(N)])
    return _more(grown, grown.measuring(seen, turned=False))


def _prior(of: Drawn, *, turned: bool, moved: bool) -> Drawn:
    nodes = np.arange(0, N, 2)
    k, d = len(nodes), of.graph.d
    R = of.truth.rotations[nodes] @ so.exp(NOISE * of.rng.standard_normal((k, so.tangent_dim(d))))
    t = of.positions[nodes] + NOISE * of.rng.standard_normal((k, d))
    graph = with_priors(
        of.graph,
        nodes,
        R if turned else None,
        t if moved else None,
        kappa=0.5 / NOISE**2 if turned else 0.0,
        tau=1.0 / NOISE**2 if moved else 0.0,
        world=of.graph.num_nodes - 1 if of.world else None,
    )
    return replace(of, graph=graph, world=True)


def positions(of: Drawn) -> Drawn:
    """Positions in the world, as of GPS."""
    return _prior(of, turned=False, moved=True)


def attitudes(of: Drawn) -> Drawn:
    """Rotations in the world."""
    return _prior(of, turned=True, moved=False)


def priors(of: Drawn) -> Drawn:
    """Poses in the world."""
    return _prior(of, turned=True, moved=True)


def directions(of: Drawn) -> Drawn:
    """Which way is up."""
    up = of.truth.rotations[:N, -1, :]
    world = of.graph.num_nodes - 1 if of.world else None
    graph = with_directions(of.graph, np.arange(N), up, kappa=1.0 / NOISE**2, world=world)
    return replace(of, graph=graph, world=True)


def distances(of: Drawn) -> Drawn:
    """Distances between poses."""
    pairs, n = _pairs(of, 4)[: N // 2], of.graph.num_nodes
    t, k = of.positions, N // 2
    apart = np.linalg.norm(t[pairs[:, 1]] - t[pairs[:, 0]], axis=1)
    apart += NOISE * of.rng.standard_normal(k)
    ranges = Ranges(n, pairs, apart, np.full(k, 1.0 / NOISE**2))
    return replace(of, graph=of.graph.with_blocks(*of.graph.blocks, ranges))


def own_kinds(of: Drawn) -> Drawn:
    """Heights, of a kind that the package does not know."""
    pairs, n, d = _pairs(of, 3), of.graph.num_nodes, of.graph.d
    i, j = pairs.T
    normals = np.tile(np.eye(d)[-1], (N, 1))
    v = np.einsum("mba,mb->ma", of.truth.rotations[i], of.positions[j] - of.positions[i])
    above = (normals * v).sum(axis=1) + NOISE * of.rng.standard_normal(N)
    block = heights()(n, pairs, normals, above, np.full(N, 1.0 / NOISE**2))
    return replace(of, graph=of.graph.with_blocks(*of.graph.blocks, block))


def scales(of: Drawn) -> Drawn:
    """Nodes of unknown scale."""
    g = of.graph
    if g.information is not None:
        g = g.with_weights(np.where(g.kappa > 0, np.median(g.kappa), 0.0), None)
    free = ~g.is_point
    free[[0, *([g.num_nodes - 1] if of.world else [])]] = False
    return replace(of, graph=g.with_unknown_scales(free))


def matrix_weights(of: Drawn) -> Drawn:
    """Matrix weights."""
    p = of.graph.d + of.graph.has_positions
    W = random_information(of.rng, of.graph.num_edges, p, of.graph.d, False) / NOISE**2
    # A point has no rotation.
    seen = of.graph.is_point[of.graph.edges[:, 1]]
    W[seen, 1:], W[seen, :, 1:] = 0.0, 0.0
    return replace(of, graph=of.graph.with_matrix_weights(W))


def arms(of: Drawn) -> Drawn:
    """Sensors that are mounted on their bodies."""
    g = of.graph
    arms = np.tile(np.where(g.is_point[g.edges[:, 1], None], 0.0, 0.1), g.d)
    moved = g.translations + np.einsum("mab,mb->ma", g.rotations, arms)
    return replace(of, graph=replace(g, arms=arms, translations=moved))


def rotations(of: Drawn) -> Drawn:
    """Rotations alone."""
    return replace(of, graph=of.graph.rotations_alone, truth=Estimate(of.truth.rotations))


def held(of: Drawn) -> Drawn:
    """Poses that the file fixes."""
    return replace(of, fixed=(0, 3))


#: What a graph may have, in the order in which it is given that.
KINDS: Mapping[str, Callable[[Drawn], Drawn]] = {
    "relative poses": full,
    "rotations alone": rotations,
    "relative rotations": turns,
    "relative translations": steps,
    "landmarks": landmarks,
    "unknown scales": scales,
    "priors": priors,
    "positions (GPS)": positions,
    "attitudes": attitudes,
    "matrix weights": matrix_weights,
    "directions": directions,
    "mounted sensors": arms,
    "distances": distances,
    "measurements of one's own": own_kinds,
    "held nodes": held,
}
#: Pairs that are no question.
NOTHING = {
    frozenset({"rotations alone", name}): "a graph of rotations has no positions"
    for name in KINDS
    if name not in ("relative poses", "rotations alone", "matrix weights", "held nodes")
}


def drawn(names: Iterable[str], seed: int, d: int, *, wrong: bool = False) -> Instance:
    """The instance of a small graph with these features."""
    of = plain(np.random.default_rng(seed), d, wrong=wrong)
    chosen = set(names)
    for name, give in KINDS.items():
        if name in chosen:
            of = give(of)
    return of.instance


def between(whole: Instance, offset: int) -> Instance:
    """What joins a map and its copy whose ids are raised: three poses are a step apart."""
    d, nodes = whole.graph.d, np.array([0, 2, 4])
    ids = np.concatenate([nodes, nodes + offset])
    pairs, same = np.array([[0, 3], [1, 4], [2, 5]]), np.tile(np.eye(d), (3, 1, 1))
    kappa, tau = np.full(3, 0.5 / NOISE**2), np.full(3, 1.0 / NOISE**2)
    rotation = RotationGraph(6, pairs, same, kappa)
    if not whole.graph.has_positions:
        return Instance("between", rotation, ids)
    apart = whole.initial.rotations[nodes, 0]  # type: ignore[union-attr]
    own = whole.graph.information
    stated = None if own is None else own.stating(kappa, tau)
    graph = PoseGraph(rotation, apart, tau, information=stated)
    if whole.graph.has_scales:
        graph = graph.with_unknown_scales(np.tile(whole.graph.free[nodes], 2))
    if whole.graph.has_couplings:
        graph = graph.with_matrix_weights(np.tile(np.eye(d + 1) / NOISE**2, (3, 1, 1)))
    return Instance("between", graph, ids)
