"""Why is my map wrong? Hypotheses are tried, never applied."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from certpgo.diagnosis import (
    estimates,
    ids,
    measurements,
    optimizer,
    priors,
    sensors,
    structure,
)
from certpgo.diagnosis import truth as of_truth
from certpgo.diagnosis.agreement import agreement
from certpgo.diagnosis.detectability import detectable
from certpgo.diagnosis.examined import Examined, KnownTruth
from certpgo.diagnosis.finding import Costs, Diagnosis, Finding
from certpgo.diagnosis.judged import single
from certpgo.diagnosis.standing import apart, undefined
from certpgo.errors import FormatError, GraphError, InputError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.components import connected_parts
from certpgo.graph.phrases import counted
from certpgo.io.accept_paths import AnyPath, as_instance, estimated
from certpgo.io.matching import places
from certpgo.io.reading import read
from certpgo.io.writing import AnyAnswer
from certpgo.optimize.monitor import Monitor, silent

#: Strength from which findings leave nothing to say of what could be seen.
SURE = 1.0
#: Nodes of the smallest part of a graph that is examined by itself.
SMALLEST = 3


def _of_estimate(examined: Examined) -> Iterator[Finding]:
    """The convention that explains the estimate, or else what an optimizer did."""
    convention = [*estimates.found(examined)]
    yield from convention or optimizer.found(examined)


#: What is looked for, each given what is examined.
CHECKS: tuple[Callable[[Examined], Iterator[Finding]], ...] = (
    _of_estimate,
    of_truth.found,
    measurements.found,
    optimizer.undetermined,
    priors.found,
    structure.found,
)


def first_finding(examined: Examined) -> Finding | None:
    """The convention that explains an estimate, or else its truth; None if none does.

    Without any search, where the least cost is known.
    """
    found = (finding for check in (estimates.found, of_truth.found) for finding in check(examined))
    return next(found, None)


def cause_in_measurements(examined: Examined) -> Finding | None:
    """What explains all measurements or a kind: an order of weights, a convention, a sensor.

    None if nothing does, or if one measurement is all that is wrong.
    """
    graph = examined.instance.graph
    if (order := undefined(graph, examined.trying)) is not None or graph.has_scales:
        return order
    none_alone = single(examined) is None
    told = measurements.convention(examined, none_alone)
    if told is not None or not none_alone:
        return told
    sensor = sensors.found(examined)
    return sensor.finding if sensor is not None and sensor.leaves_noise else None


def diagnose(
    graph: Graph | Instance | AnyPath,
    estimate: Estimate | AnyAnswer | AnyPath | None = None,
    *,
    truth: KnownTruth | Estimate | None = None,
    cost: str | None = None,
    time_limit: float | None = None,
    monitor: Monitor = silent,
    progress: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find what is wrong with a map: its measurements, an estimate, or its truth.

    Each mistake that people make is a hypothesis with a cost. Those that explain the map far better
    than what is given are told, with both costs.

    Parameters
    ----------
    graph : the measurements; or the instance that was read, or the path of its file
    estimate : of all its nodes, that is asked about, from any source
    truth : known poses of all nodes, or of some
    cost : as in `certpgo.solve`
    time_limit : seconds of each search; by default 2, and a thousandth for each measurement
    monitor : is called with each iteration of searches, and may stop these
    progress : is called with the kind of each mistake that is tried

    Raises
    ------
    InputError
        An estimate or a truth of another graph.

    Examples
    --------
    Poses of the world in the body, where those of the body in the world are meant:

    >>> import numpy as np
    >>> import certpgo
    >>> from certpgo.io.datasets.synthetic import helix
    >>> made = helix(6, np.random.default_rng(0))
    >>> R, t = made.truth.rotations, made.truth.translations
    >>> back = np.swapaxes(R, 1, 2)
    >>> inverse = certpgo.Estimate(back, -np.einsum("nab,nb->na", back, t))
    >>> certpgo.diagnose(made, inverse).findings[0].next
    'invert each pose'
    """
    instance = _opened(graph)
    known = truth
    if isinstance(known, Estimate):
        known = KnownTruth(np.arange(known.num_nodes), known)
    found = [*apart(instance)]
    whole = Examined(
        instance,
        truth=known,
        cost=cost,
        time_limit=time_limit,
        monitor=monitor,
        progress=progress,
    )
    parts = [whole]
    if not instance.measurements.is_connected:
        parts = [_part(whole, part) for part in connected_parts(instance, "each")]
    if estimate is not None:
        try:
            given = estimated(estimate, instance)
            parts = [replace(part, estimate=_of(part, instance, given)) for part in parts]
        except InputError as refusal:
            reason = ids.of_another(parts[0], estimate, refusal)
            if reason is None:
                raise
            found.append(reason)
    sized = [one for one in parts if one.instance.graph.num_nodes >= SMALLEST] or parts[:1]
    several = len(sized) > 1
    seen = [(one, finding) for one in sized for finding in _of_part(one, bool(found))]
    found += [_named(one, finding) if several else finding for one, finding in seen]
    found.sort(key=lambda one: -one.strength)
    could = ""
    if not any(finding.strength >= SURE for _, finding in seen):
        could = "; ".join(filter(None, (_detectable(one, several) for one in sized)))
    tried = len(whole.tried)
    said = f"{instance.name}, by {counted(tried, 'trial{s}')}"
    costs = None if found or several else _costs(sized[0])
    against = "; ".join(filter(None, (_against(one, several) for one in sized)))
    return Diagnosis(tuple(found), tried, said, could, costs, against)


def _costs(examined: Examined) -> Costs:
    """What an estimate costs that no mistake explains, and the best one."""
    certificate, given = examined.answer.certificate, examined.estimate
    bound = certificate.lower_bound
    return Costs(
        examined.best,
        bound if bound is not None and math.isfinite(bound) else None,
        None if given is None else examined.problem.cost(given),
        is_optimal=certificate.is_optimal,
    )


def _of_part(examined: Examined, wrong: bool) -> list[Finding]:
    """The findings of a connected part, with remarks if something is wrong there or elsewhere."""
    try:
        _ = examined.problem
    except GraphError as refusal:  # nothing can be computed of these measurements
        return [optimizer.indeterminate(str(refusal), strength=2.0)]
    found = [finding for check in CHECKS for finding in check(examined)]
    return [*found, *structure.remarks(examined)] if found or wrong else found


def _opened(graph: Any) -> Instance:
    """The instance; with nodes released where the file holds them and cannot be read so."""
    try:
        return as_instance(graph, "diagnose")
    except FormatError:
        raise
    except InputError:
        if not isinstance(graph, str | os.PathLike):
            raise
        return read(Path(graph), quiet=True, fixed=False)


def _part(whole: Examined, part: Instance) -> Examined:
    """A connected part, with the truth of its nodes."""
    known = whole.truth
    if known is not None:
        place = places(part.ids, whole.instance.ids[known.nodes])
        nodes = np.flatnonzero(place >= 0)
        clock, poses = known.clock, known.poses
        if len(known.nodes):
            poses = poses.subset(place[nodes])
        if clock is not None:
            clock = replace(clock, nodes=clock.nodes[places(part.ids, whole.instance.ids)])
        known = KnownTruth(nodes, poses, clock)
    return replace(whole, instance=part, truth=known)


def _of(part: Examined, instance: Instance, given: Estimate) -> Estimate | None:
    """The estimate of a part's nodes; None if it lacks some, such as a world of its own."""
    if part.instance is instance or not isinstance(given, Estimate):
        return given
    place = places(part.instance.ids, instance.ids)
    return given.subset(place) if (place >= 0).all() else None


def _named(examined: Examined, finding: Finding) -> Finding:
    """The finding, which says of which part it is."""
    return replace(finding, said=f"{examined.instance.name}: {finding.said}")


def _against(examined: Examined, named: bool) -> str:
    """How far off a part is from its truth; or empty."""
    with suppress(GraphError):
        said = agreement(examined)
        return f"{examined.instance.name}: {said}" if named and said else said
    return ""


def _detectable(examined: Examined, named: bool) -> str:
    """What errors of a part would have been seen; or empty."""
    seen, instance = detectable(examined), examined.instance
    if seen is None:
        return ""
    return f"{instance.name}: {seen.in_words(instance)}" if named else seen.in_words(instance)
