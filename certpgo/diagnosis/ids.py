"""Estimates whose ids are of another file, or of this one with an offset."""

from __future__ import annotations

import os
import warnings
from contextlib import suppress
from typing import Any

import numpy as np

from certpgo.diagnosis.examined import Examined
from certpgo.diagnosis.finding import Finding
from certpgo.errors import CertPGOError
from certpgo.graph import Estimate
from certpgo.graph.phrases import cost_shown, counted
from certpgo.io.estimates import read_estimate
from certpgo.io.matching import places
from certpgo.linalg.arrays import IntArray

#: Offsets that are tried, and ids of an estimate by which they are found.
OFFSETS, SAMPLED = 8, 300
#: Measurements that have to be covered, and the share of the poses.
LEAST, SHARE = 3, 0.5
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
