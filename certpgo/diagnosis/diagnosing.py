"""Why is my map wrong? Hypotheses are tried, never applied."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from certpgo.diagnosis import estimates
from certpgo.diagnosis import truth as of_truth
from certpgo.diagnosis.examined import Examined, KnownTruth
from certpgo.diagnosis.finding import Diagnosis, Finding
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.phrases import counted
from certpgo.io.accept_paths import AnyPath, as_instance, estimated
from certpgo.io.writing import AnyAnswer
from certpgo.optimize.monitor import Monitor, silent

#: What is looked for, each given what is examined.
CHECKS: tuple[Callable[[Examined], Iterator[Finding]], ...] = (estimates.found, of_truth.found)


def first_finding(examined: Examined) -> Finding | None:
    """The convention that explains an estimate, or else its truth; None if none does.

    Without any search, where the least cost is known.
    """
    found = (finding for check in (estimates.found, of_truth.found) for finding in check(examined))
    return next(found, None)


def diagnose(
    graph: Graph | Instance | AnyPath,
    estimate: Estimate | AnyAnswer | AnyPath | None = None,
    *,
    truth: KnownTruth | Estimate | None = None,
    cost: str | None = None,
    time_limit: float | None = None,
    monitor: Monitor = silent,
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
    time_limit : seconds of each search
    monitor : is called with each iteration of searches, and may stop these

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
    instance = as_instance(graph, "diagnose")
    given = None if estimate is None else estimated(estimate, instance)
    known = truth
    if isinstance(known, Estimate):
        known = KnownTruth(np.arange(known.num_nodes), known)
    examined = Examined(instance, given, known, cost, None, time_limit, monitor)
    found = [finding for check in CHECKS for finding in check(examined)]
    found.sort(key=lambda one: -one.strength)
    tried = len(examined.tried)
    return Diagnosis(tuple(found), tried, f"{instance.name}, by {counted(tried, 'trial{s}')}")
