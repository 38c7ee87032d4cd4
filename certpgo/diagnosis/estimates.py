"""Conventions of an estimate, each judged by the cost of so reading it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from certpgo.diagnosis.conventions import (
    STEPS,
    Convention,
    NodeOrder,
    Reading,
    candidates,
    orders_of,
    read_by,
)
from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.diagnosis.screening import ALIKE, Sample
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown

#: A reading explains an estimate if it leaves at most this share of the cost, and of its excess.
SHARE = 0.1
#: An estimate is asked about if it costs this many times the least cost known.
WRONG = 2.0
#: It is near to the optimum, or else leaves hardly anything.
FAR, SURE = 100.0, 0.01
#: Readings that cost hardly more than the best are preferred if they are simpler.
HARDLY = 1.02
#: Units by their length in metres, and how closely a scale must meet one.
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2, "kilometres": 1e3, "feet": 0.3048}
NEAR = 0.02
#: The share of the cost of some measurements that a reading leaves if it may explain an estimate,
#: and the same over that of the best reading.
LIKELY, NEARLY = 0.5, 10.0


def found(examined: Examined) -> Iterator[Finding]:
    """The convention that explains the estimate best, if one does."""
    if examined.estimate is None or examined.instance.graph.has_scales:
        return
    estimate, d = examined.estimate, examined.instance.graph.d
    given = examined.problem.cost(estimate)
    if not given > WRONG * examined.best:
        return
    steps = () if examined.instance.graph.is_point.any() else STEPS
    readings: list[Reading] = [*candidates(d), *((one,) for one in steps)]
    readings += orders_of(examined.instance)
    trials = [
        _reordered(examined, estimate, one)
        if isinstance(one, NodeOrder)
        else _tried(examined, estimate, given, one)
        for one in _likely(examined, estimate, readings)
    ]
    best = min((trial.share for trial in trials), default=math.inf)
    if best == math.inf:
        return
    chosen = next(trial for trial in trials if trial.share <= HARDLY * best)
    cost = chosen.share * given
    near = cost < FAR * examined.best or chosen.share < SURE
    if near and cost < SHARE * _collapsed(examined) and explains(cost, given, examined.best):
        so_read, as_given = cost_shown(cost), cost_shown(given)
        said = in_words(chosen.said, "the estimate")
        said = f"{said}: so read it costs {so_read}, as it stands {as_given}"
        if cost > WRONG * examined.best:
            said = f"{said}, the optimum {cost_shown(examined.best)}"
        yield Finding(chosen.kind, said, chosen.next, cost, given)


def _collapsed(examined: Examined) -> float:
    """The cost of a map in one point, which any scale and any bent map may come near to."""
    best = examined.estimate
    if best is None or best.translations is None:
        return math.inf
    return examined.problem.cost(best.with_translations(0.0 * best.translations))


def explains(cost: float, given: float, best: float) -> bool:
    """Whether a hypothesis leaves little of a cost, and of what that is above the best one."""
    return cost < SHARE * given and cost - best < SHARE * (given - best)


@dataclass(frozen=True)
class _Trial:
    """A reading, and the share of the given cost that it leaves."""

    kind: str
    said: str
    next: str
    share: float


# --- Trials ---------------------------------------------------------------------------------------


def _likely(
    examined: Examined, estimate: Estimate, readings: Sequence[Reading]
) -> Iterator[Reading]:
    """The readings that may explain an estimate, by some measured poses."""
    for one in readings:
        named = "reordered" if isinstance(one, NodeOrder) else "+".join(of.kind for of in one)
        examined.trying(named or "scaled")
    if (sample := Sample.of(examined)) is None:
        yield from readings
        return
    given, nodes = estimate.subset(sample.nodes), sample.nodes
    poses, world = list[Estimate](), examined.instance.world
    for one in readings:
        if isinstance(one, NodeOrder):
            poses.append(one.read(estimate, nodes))
        elif all(convention.of_each for convention in one):
            poses.append(read_by(given, one))
        else:
            poses.append(read_by(estimate, one, world).subset(nodes))
    known = [one.has_pose[nodes] if isinstance(one, NodeOrder) else None for one in readings]
    shares = sample.shares(given, poses, known)
    most = min(LIKELY, NEARLY * float(shares.min()))
    yield from (one for one, share in zip(readings, shares.tolist(), strict=True) if share <= most)


def _tried(
    examined: Examined, estimate: Estimate, given: float, conventions: tuple[Convention, ...]
) -> _Trial:
    """The estimate, of a given cost, read by some conventions, in the unit that fits best."""
    poses = read_by(estimate, conventions, examined.instance.world)
    kind = conventions[0].kind if conventions else "as-given"
    said = ", and ".join(one.said for one in conventions)
    next = ", and ".join(one.next for one in conventions)
    cost = examined.problem.cost(poses)
    scale = best_scale(examined, poses)
    if scale is not None and abs(scale - 1.0) > NEAR and poses.translations is not None:
        t = scale * poses.translations
        scaled = examined.problem.cost(poses.with_translations(t))
        if scaled < SHARE * cost:
            unit, factor = unit_of(scale)
            if not conventions:
                kind = unit
            more = unit_in_words(unit, factor)
            said = f"{said}, and {more}" if said else more
            times = f"multiply its positions by {factor}"
            next, cost = f"{next}, and {times}" if next else times, scaled
    return _Trial(kind, said, next, cost / given)


def best_scale(examined: Examined, estimate: Estimate) -> float | None:
    """The factor of all positions that fits measured translations; None if none does."""
    graph, t = examined.instance.graph, estimate.translations
    if t is None or not graph.has_positions:
        return None
    i, j = graph.edges.T
    v = np.einsum("mba,mb->ma", estimate.rotations[i], t[j] - t[i])
    size = float(graph.tau @ (v * v).sum(axis=1))
    along = float(graph.tau @ (v * graph.translations).sum(axis=1))
    stated = float(graph.tau @ (graph.translations**2).sum(axis=1))
    # Noise is best scaled to nothing, which explains nothing.
    return along / size if along > 0.0 and along**2 > ALIKE * size * stated else None


def unit_of(scale: float) -> tuple[str, str]:
    """The unit of lengths that this factor turns into metres, or ``"scaled"``; and the factor."""
    for name, metres in UNITS.items():
        if abs(scale / metres - 1.0) < NEAR:
            return name, f"{metres:g}"
    return "scaled", f"{scale:.4g}"


def in_words(said: str, it: str) -> str:
    """What a convention says of an estimate or a truth."""
    return said.format(it=it, its=f"{it}'s")


def unit_in_words(unit: str, factor: str) -> str:
    """What `unit_of` says, in words."""
    return f"{{it}} is in {unit}" if unit in UNITS else f"{{its}} lengths are off by {factor}"


def _reordered(examined: Examined, estimate: Estimate, order: NodeOrder) -> _Trial:
    """The estimate in another order, judged by measurements between nodes that have a pose."""
    problem = examined.problem
    known = order.has_pose[problem.graph.edges].all(axis=1)
    both = order.read(estimate), estimate
    costs, given = (float(problem.edge_costs(one)[known].sum()) for one in both)
    said = f"{{its}} poses are of nodes in another order: {order.called}"
    share = costs / given if given > 0.0 else math.inf
    return _Trial("reordered", said, "give each pose the id of its node", share)
