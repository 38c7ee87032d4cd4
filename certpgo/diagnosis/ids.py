"""Ids of another file, or of this one with an offset; and those that two robots use."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.components import restricted
from certpgo.graph.edges import components_of
from certpgo.graph.phrases import cost_shown, counted
from certpgo.io.estimates import read_estimate
from certpgo.io.matching import places
from certpgo.linalg.arrays import BoolArray, IntArray
from certpgo.objective.choose_cost import objective_of
from certpgo.optimize.descent import descend
from certpgo.optimize.initialization import start_of
from certpgo.solve.fit import fit_of

#: Offsets that are tried, and ids of an estimate by which they are found.
OFFSETS, SAMPLED = 8, 300
#: Measurements that have to be covered, and the share of the poses.
LEAST, SHARE = 3, 0.5
#: Steps that are measured twice, and the share of the shorter trajectory's, of two robots; what
#: their maps cost at most, over that of one, where the noise is not stated.
STEPS, OVERLAP, APART = 4, 0.5, 0.1
#: Cost of each measurement, over that of the best estimate, up to which an offset fits.
FITS = 100.0


def of_another(examined: Examined, given: Any, refusal: Exception) -> Finding | None:
    """Why an estimate that was refused is of other nodes; None if its ids are not the reason."""
    estimate = _as_it_is(given)
    if estimate is None or estimate.keys.ids is None or estimate.d != examined.instance.graph.d:
        return None
    instance = examined.instance
    own, ids = instance.ids[instance.poses], estimate.keys.ids
    examined.trying("other-ids")
    here = int(np.isin(ids, own).sum())
    trials = [(_cost(examined, estimate, ids + by), by) for by in _offsets(own, ids)]
    known = [(cost, by) for cost, by in trials if cost is not None]
    if known:
        cost, by = min(known)
        usual = examined.best / instance.graph.num_edges
        if by and cost <= FITS * max(usual, 1e-12):
            moved = int(np.isin(ids + by, own).sum())
            return Finding(
                "other-ids",
                f"the estimate has other ids than the graph: with {by:+d} added to each, {moved} "
                f"of its {counted(len(ids), 'pose{s}')} fit, and a measurement costs "
                f"{cost_shown(cost)} on average, in the best estimate {cost_shown(usual)}; as "
                f"they are: {refusal}",
                f"add {by} to its ids",
                strength=2.0,
            )
        if by == 0:
            return None
    if here > SHARE * len(ids):
        return None
    return Finding(
        "other-ids",
        f"the estimate is of another graph: {here} of its {counted(len(ids), 'pose{s}')} have ids "
        "of the graph's nodes, and no offset fits",
        "take the estimate that was computed from this graph",
        strength=2.0,
    )


def _as_it_is(given: Any) -> Estimate | None:
    """The estimate in its own order."""
    if isinstance(given, str | os.PathLike):
        with suppress(CertPGOError), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return read_estimate(str(given))
        return None
    found = getattr(given, "estimate", given)
    return found if isinstance(found, Estimate) else None


def _offsets(own: IntArray, ids: IntArray) -> list[int]:
    """None, and those by which most ids become those of nodes."""
    some = ids[np.linspace(0, len(ids) - 1, min(SAMPLED, len(ids))).astype(np.intp)]
    values, counts = np.unique(own[:, None] - some, return_counts=True)
    often = values[np.argsort(-counts, kind="stable")[:OFFSETS]].tolist()
    ends = [int(own.min() - ids.min()), int(own.max() - ids.max())]
    return [*dict.fromkeys([0, *ends, *often])]


def _cost(examined: Examined, estimate: Estimate, ids: IntArray) -> float | None:
    """The cost of a measurement on average, of those between nodes that have a pose."""
    instance, problem = examined.instance, examined.problem
    place = places(instance.ids, ids)
    if instance.world is not None:
        place[instance.world] = -1
    has_pose, chosen = place >= 0, np.maximum(place, 0)
    covered = has_pose[problem.graph.edges].all(axis=1)
    if covered.sum() < LEAST or has_pose.sum() < SHARE * min(len(ids), len(place)):
        return None
    t = estimate.translations
    if instance.graph.has_positions and t is None:
        return None
    filled = Estimate(estimate.rotations[chosen], None if t is None else t[chosen])
    if not instance.graph.has_positions:
        filled = filled.with_translations(None)
    return float(problem.edge_costs(filled)[covered].mean())


def used_twice(examined: Examined) -> Finding | None:
    """That a file holds the maps of two robots, whose poses have the same ids.

    The second begins where a step is measured that was measured before.
    """
    instance, fit = examined.instance, examined.fit
    graph, steps = instance.graph, _steps(examined)
    pairs = np.sort(graph.edges, axis=1) @ [graph.num_nodes, 1]
    numbers = instance.known_numbers[: graph.num_edges]
    rows = np.flatnonzero(steps)[np.argsort(numbers[steps], kind="stable")]
    _, first, counts = np.unique(pairs[rows], return_index=True, return_counts=True)
    twice = int((counts > 1).sum())
    if graph.has_scales or twice < STEPS or (fit is not None and not fit.is_unusually_large):
        return None
    examined.trying("ids-used-twice")
    again = np.setdiff1d(np.arange(len(rows)), first)
    start = numbers[rows[again[0]]]
    of_second = numbers >= start
    sizes = [int(steps[of].sum()) for of in (of_second, ~of_second)]
    if twice < OVERLAP * min(sizes):
        return None
    given, costs = examined.best, []
    with suppress(CertPGOError, np.linalg.LinAlgError):
        both = [_map_of(examined, of) for of in (~of_second, of_second)]
        costs = [cost for cost, _ in both]
        if not (sum(costs) < APART * given or all(usual for _, usual in both)):
            return None
    if len(costs) < 2:
        return None
    apart = " and ".join(map(cost_shown, costs))
    return Finding(
        "ids-used-twice",
        f"two maps use the same ids: {counted(twice, 'step{s}')} between poses that follow each "
        f"other are measured again from measurement {start} on; those before and those from there "
        f"cost {apart} by themselves, as it stands {cost_shown(given)}",
        f"add {int(instance.ids.max()) + 1} to the ids of the second map, and keep measurements "
        "between both",
        sum(costs),
        given,
    )


def _steps(examined: Examined) -> BoolArray:
    """(m,) whole measurements between poses that follow each other, all of them."""
    return examined.whole & examined.order.are_steps(examined.instance.graph.edges)


def _map_of(examined: Examined, chosen: BoolArray) -> tuple[float, bool]:
    """The least cost of some measurements, of their largest component; and whether it is usual."""
    whole = examined.instance.with_edges(chosen)
    labels = components_of(whole.graph.num_nodes, whole.graph.edges)
    nodes = np.flatnonzero(labels == np.argmax(np.bincount(labels)))
    part = replace(restricted(whole, nodes, whole.name), initial=None)
    problem = objective_of(part, examined.problem.cost_name)
    end = descend(problem, start_of(problem.chordal).estimate, monitor=examined.monitor)
    fit = fit_of(part, problem, end.estimate)
    return end.cost, fit is not None and not fit.is_unusually_large
