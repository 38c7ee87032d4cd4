"""Similarities with weights in the unit of each frame, by re-weighting until the scales settle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from certpgo.errors import InputError
from certpgo.graph import Estimate, Graph, Instance
from certpgo.graph.display import Brief
from certpgo.io.accept_paths import AnyPath, measured
from certpgo.objective.choose_cost import objective_of, require_scales
from certpgo.objective.quadratic import Quadratic
from certpgo.solve.result import CertifiedSolution
from certpgo.solve.settings import SolveSettings
from certpgo.solve.solving import solve

#: Rounds at most, and the change of a logarithm of scale from which they have settled.
ROUNDS, SETTLED = 30, 1e-6


@dataclass(frozen=True, eq=False, repr=False)
class Reweighed(Brief):
    """A map whose weights are in the units of its own frames.

    Attributes
    ----------
    answer : the certified answer for ``graph``, whose scales are near 1
    graph : the measurements in the units of the estimate, see `Graph.in_units_of`: the
        cost of the answer is F of this graph
    estimate : the answer with the scales of the source's units
    rounds : how often weights were set
    settled : whether the scales no longer changed

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo import reweigh
    >>> from certpgo.io.datasets.monocular import random_maps
    >>> graph, _ = random_maps(np.random.default_rng(0), turn=0.02, scale=0.02, move=0.02)
    >>> reweigh(graph, rounds=1).rounds
    1
    """

    answer: CertifiedSolution
    graph: Graph
    estimate: Estimate
    rounds: int
    settled: bool


def reweigh(
    graph: Graph | Quadratic | Instance | AnyPath,
    settings: SolveSettings | None = None,
    *,
    rounds: int = ROUNDS,
    **options: Any,
) -> Reweighed:
    """Solve with weights kappa / s_j^2 and tau / s_i^2, the scales being those of the estimate.

    Weights of similarities are in the unit of the world, so residuals of frames with a small unit
    count less. Programs that weigh residuals in each frame's own unit have a cost that no quadratic
    form bounds from below. Here the weights are set by an estimate, the graph is solved and
    certified with them, and so on until the scales settle: the certificate is about F with the last
    weights, not about a cost in which they vary.

    Parameters
    ----------
    graph : with unknown scales; or its problem, the instance that was read, or its file's path
    rounds : largest number of solves
    settings, options : as for `certpgo.solve`

    Raises
    ------
    InputError
        No scale is unknown, there are distances, or no round; or as `certpgo.solve`.

    Examples
    --------
    >>> import numpy as np
    >>> from certpgo.io.datasets.monocular import random_maps
    >>> from certpgo.solve.reweighing import reweigh
    >>> graph, _ = random_maps(np.random.default_rng(0), turn=0.02, scale=0.02, move=0.02)
    >>> found = reweigh(graph)
    >>> found.settled, found.answer.verdict.value
    (True, 'CERTIFIED')
    """
    posed: Any = measured(graph)
    require_scales(posed)
    own: Any = objective_of(posed).graph
    if rounds < 1:
        raise InputError(f"re-weighting takes 1 round at least, not {rounds}")
    scales, count, settled = np.ones(own.num_nodes), 0, False
    while count < rounds and not settled:
        count += 1
        units = own.in_units_of(scales)
        answer = solve(units, settings, **options)
        found = answer.estimate.scales
        change = np.ones(own.num_nodes) if found is None else np.where(own.free, found, 1.0)
        scales = scales * change
        if own.in_mean_unit:  # a common factor is no change
            change = change / np.exp(np.log(change[own.free]).mean())
        settled = bool(np.abs(np.log(change[own.free])).max(initial=0.0) <= SETTLED)
    estimate = answer.estimate
    keyed = Estimate(estimate.rotations, estimate.translations, estimate.keys, scales)
    return Reweighed(answer, units, keyed, count, settled)
