"""Merged and sparsified graphs: bounds, terms and connectivities, against the oracle's."""

from __future__ import annotations

from itertools import combinations

import numpy as np

import certpgo
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import SAME, Claim, Findings, judge, poses_of
from reports.studies.bookkeeping.oracle import Cost, Poses

#: Choices of loop closures that are all tried.
CHOICES = 500


def judge_merge(rng: np.random.Generator, found: Findings) -> None:
    """Two or three maps of random nodes, with priors of one world."""
    of, owner = _cut(rng)
    # Priors belong to the map of their pose. The merged graph has the maps' measurements first.
    by, of_map = owner[of.edges[:, 0]], owner[of.edges[:, 1]]
    own = (by == of_map) | (by < 0)
    order = np.concatenate([*(np.flatnonzero(own & (of_map == k)) for k in set(owner) - {-1})])
    whole = of.subset(np.concatenate([order, np.flatnonzero(~own)]))
    maps = [_with_nodes(of.subset(own & (of_map == k))) for k in set(owner) - {-1}]
    between = _with_nodes(of.subset(~own))
    robust, name = bool(rng.random() < 0.3), str(rng.choice(["chordal", "g2o", "gtsam"]))
    with found.refusals("merge"):
        parts = [part.instance for part in maps]
        merged = certpgo.merge(parts, between.instance, robust=robust, cost=name)
        ours = _poses(merged, whole)
        kept = np.ones(whole.m, dtype=bool)
        if robust:
            kept[merged.disagreeing] = False
        judge(
            found,
            Cost(whole.subset(kept), name),
            [Claim.of("merged", merged.answer.certificate, ours)],
        )
        for part, answer in zip(maps, merged.parts, strict=True):
            judge(found, Cost(part, name), [Claim.of("map", answer.certificate, answer.estimate)])
        terms = Cost(whole, name).terms(ours)[merged.between]
        off = np.abs(terms - merged.terms).max(initial=0.0)
        slack = SAME * terms.sum() + 4.0 * Cost(whole, name).rounding(ours)
        found.require(off <= slack, f"merged: terms are off by {off:.3g}")


def _cut(rng: np.random.Generator) -> tuple[Measurements, Array]:
    """A graph, and the maps of its nodes (n,), -1 for the world; each map measures something."""
    while True:
        of = draw(rng, nodes=(6, 10), points=0.2)
        owner = _owners(rng, of)
        inside = owner[of.edges[:, 0]] == owner[of.edges[:, 1]]
        if set(owner[of.edges[inside, 0]]) == set(owner) - {-1}:
            return of, owner


def _with_nodes(part: Measurements) -> Measurements:
    return part.induced(np.unique(part.edges))


def _poses(merged: certpgo.Merged, of: Measurements) -> Poses:
    """The merged estimate in the order of the nodes."""
    x, known = merged.answer.estimate, merged.instance
    places = {node: k for k, node in enumerate(known.ids.tolist()) if k != known.world}
    nodes = [places[k] for k in of.ids[: of.n - of.world].tolist()]
    nodes += [known.world] if of.world and known.world is not None else []
    return poses_of(x.subset(np.array(nodes)))


def _owners(rng: np.random.Generator, of: Measurements) -> Array:
    """(n,) the map of each node, which grows from random poses; -1 for the world."""
    known = of.n - of.world
    seeds = rng.choice(np.flatnonzero(~of.points[:known]), int(rng.integers(2, 4)), replace=False)
    owner = np.full(of.n, -1)
    owner[seeds] = np.arange(len(seeds))
    edges = of.edges[of.edges[:, 0] < known]
    while (owner[:known] < 0).any():
        for i, j in edges[rng.permutation(len(edges))].tolist():
            if owner[i] >= 0 > owner[j]:
                owner[j] = owner[i]
            elif owner[j] >= 0 > owner[i] and not of.points[j]:
                owner[i] = owner[j]
    return owner


def judge_sparsify(rng: np.random.Generator, found: Findings) -> None:
    """Fewer loop closures: what is promised of both graphs, and of all choices."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.0, loops=1.5)
    keep, name = float(rng.uniform(0.2, 1.0)), str(rng.choice(["chordal", "g2o", "gtsam"]))
    with found.refusals("sparsify"):
        sparse = certpgo.sparsify(of.instance, keep, cost=name)
        whole, part = Cost(of, name), Cost(of.subset(sparse.kept), name)
        judge(found, whole, [Claim.of("whole", sparse.whole.certificate, sparse.whole.estimate)])
        claim = Claim.of("sparse", sparse.answer.certificate, sparse.answer.estimate)
        judge(found, part, [claim])
        own = whole.value(claim.estimate or whole.of.R)
        off = abs(own - sparse.cost)
        slack = SAME * own + 4.0 * whole.rounding(claim.estimate or whole.of.R)
        found.require(off <= slack, f"sparsify: the cost of all is {own!r}, not {sparse.cost!r}")
        _judge_connectivity(found, of, sparse)


def _judge_connectivity(found: Findings, of: Measurements, sparse: certpgo.Sparsified) -> None:
    full, own = connectivity(of, np.arange(of.m)), connectivity(of, sparse.kept)
    for name, said, true in (("full", sparse.full, full), ("own", sparse.connectivity, own)):
        found.require(abs(said - true) <= 1e-6 * full, f"sparsify: {name} {said!r}, not {true!r}")
    odometry = np.setdiff1d(sparse.kept, sparse.chosen)
    loops = np.setdiff1d(np.arange(of.m), odometry)
    found.require(len(loops) == sparse.loops, f"sparsify: {len(loops)} loops, not {sparse.loops}")
    count = len(sparse.chosen)
    for k, choice in enumerate(combinations(loops.tolist(), count)):
        if k >= CHOICES:
            break
        better = connectivity(of, np.concatenate([odometry, np.array(choice, dtype=int)]))
        if better > sparse.bound * (1.0 + SAME) + 1e-12 * full:
            found.false.append(f"sparsify: a choice has {better!r}, above {sparse.bound!r}")
            break


def connectivity(of: Measurements, chosen: Array) -> float:
    """The second eigenvalue of the Laplacian weighted by kappa."""
    L = np.zeros((of.n, of.n))
    for e in chosen:
        i, j = of.edges[e]
        L[[i, j], [i, j]] += of.kappa[e]
        L[[i, j], [j, i]] -= of.kappa[e]
    return float(np.linalg.eigvalsh(L)[1])
