"""Merged and sparsified graphs: bounds, terms and connectivities, against the oracle's."""

from __future__ import annotations

from itertools import combinations

import numpy as np

import certpgo
from certpgo import Instance
from reports.studies.bookkeeping.drawing import Array, Measurements, draw
from reports.studies.bookkeeping.judging import SAME, Claim, Findings, judge
from reports.studies.bookkeeping.oracle import Cost

#: Choices of loop closures that are all tried.
CHOICES = 500


def judge_merge(rng: np.random.Generator, found: Findings) -> None:
    """Two or three maps of random nodes, which what they measure connects."""
    measured = False
    while not measured:
        of = draw(rng, nodes=(6, 10), priors=0.0, points=0.2)
        owner = _owners(rng, of)
        inside = owner[of.edges[:, 0]] == owner[of.edges[:, 1]]
        measured = set(owner[of.edges[inside, 0]]) == set(owner)
    across = owner[of.edges[:, 0]] != owner[of.edges[:, 1]]
    groups = [np.flatnonzero(owner == k) for k in np.unique(owner)]
    maps = [of.induced(group) for group in groups]
    # The merged graph has the maps' measurements first.
    order = np.concatenate([np.flatnonzero(_inside(of, group)) for group in groups])
    order = np.concatenate([order, np.flatnonzero(across)])
    place = np.argsort(np.concatenate(groups))
    whole = of.subset(order)
    between = of.subset(across)
    between = between.induced(np.unique(between.edges))
    robust = bool(rng.random() < 0.3)
    with found.refusals("merge"):
        parts: list[Instance] = [part.instance for part in maps]
        merged = certpgo.merge(parts, between.instance, robust=robust)
        x = merged.answer.estimate
        ours = x.rotations[place], x.translations[place]
        kept = np.ones(whole.m, dtype=bool)
        if robust:
            kept[merged.disagreeing] = False
        cost = Cost(whole.subset(kept))
        judge(found, cost, [Claim.of("merged", merged.answer.certificate, ours)])
        least = 0.0
        for part, answer in zip(maps, merged.parts, strict=True):
            own = Claim.of("map", answer.certificate, answer.estimate)
            least += judge(found, Cost(part), [own])
        terms = Cost(whole).terms(ours)[merged.between]
        off = np.abs(terms - merged.terms).max(initial=0.0)
        slack = SAME * terms.sum() + 4.0 * Cost(whole).rounding(ours)
        found.require(off <= slack, f"merged: terms are off by {off:.3g}")
        ids = whole.ids[np.concatenate(groups)]
        found.require((merged.instance.ids == ids).all(), "merged: other ids than the maps'")


def _inside(of: Measurements, group: Array) -> Array:
    return np.isin(of.edges, group).all(axis=1)


def _owners(rng: np.random.Generator, of: Measurements) -> Array:
    """(n,) the map of each node: those nearest to random poses, by the number of measurements."""
    poses = np.flatnonzero(~of.points)
    seeds = rng.choice(poses, int(rng.integers(2, 4)), replace=False)
    owner = np.full(of.n, -1)
    owner[seeds] = np.arange(len(seeds))
    while (owner < 0).any():
        for i, j in of.edges[rng.permutation(of.m)].tolist():
            a, b = owner[i], owner[j]
            if a >= 0 > b:
                owner[j] = a
            elif b >= 0 > a and not of.points[j]:
                owner[i] = b
    return owner


def judge_sparsify(rng: np.random.Generator, found: Findings) -> None:
    """Fewer loop closures: what is promised of both graphs, and of all choices."""
    of = draw(rng, nodes=(4, 8), points=0.0, priors=0.0, loops=1.5)
    keep = float(rng.uniform(0.2, 1.0))
    with found.refusals("sparsify"):
        sparse = certpgo.sparsify(of.instance, keep)
        whole, part = Cost(of), Cost(of.subset(sparse.kept))
        judge(found, whole, [Claim.of("whole", sparse.whole.certificate, sparse.whole.estimate)])
        claim = Claim.of("sparse", sparse.answer.certificate, sparse.answer.estimate)
        judge(found, part, [claim])
        own = whole.value(claim.estimate or whole.of.R)
        off = abs(own - sparse.cost)
        slack = SAME * own + 4.0 * whole.rounding(claim.estimate or whole.of.R)
        found.require(off <= slack, f"sparsify: F of all is {own!r}, not {sparse.cost!r}")
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
