"""Rejections as proof files claim them: edges of negative weight that the checker verifies."""

from __future__ import annotations

import numpy as np

from certpgo import checker
from certpgo.certify.cost_proof import LOWER
from certpgo.linalg.arrays import FloatArray
from certpgo.objective.truncated import Truncation
from certpgo.objective.truncated_cost import TruncatedCost

#: Shares by which centres move away from measurements until these reach their prices.
OUT = tuple(2.0**-k for k in range(50, 26, -4))


def claimed_rejections(
    graph: checker.Graph, problem: TruncatedCost, at: Truncation, W: FloatArray
) -> checker.Rejections:
    """What minorants with weights W claim; those whose prices are not reached get none."""
    if graph.N is not None:
        return _claimed_couplings(graph, problem, at, W)
    moved, C = at.moved, at.centres(W)
    from_measured = C - np.dstack([at.translations, at.graph.rotations])[:, :, 1 - moved :]

    def claimed() -> checker.Rejections:
        return checker.Rejections(
            rejected=problem.rejected.astype(np.intp),
            prices=at.prices,
            kappa=W[:, moved, moved],
            centres=C[:, :, moved:],
            tau=W[:, 0, 0] * moved,
            arms=C[:, :, 0] * moved,
        )

    held = np.zeros(len(C), dtype=bool)
    for share in OUT:
        given = claimed()
        held = checker.rejections_hold(graph, given)
        if held.all():
            return given
        C = C + np.where(held, 0.0, share)[:, None, None] * from_measured
    W[~held] = 0.0
    return claimed()


def _claimed_couplings(
    graph: checker.Graph, problem: TruncatedCost, at: Truncation, W: FloatArray
) -> checker.Rejections:
    """The same of a graph with couplings; constants are lowered until they are accepted."""
    found = at.minorants(W)
    constants, sizes = found.constant, np.abs(found.constant) + at.prices
    for share in LOWER:
        given = checker.Rejections(
            rejected=problem.rejected.astype(np.intp),
            prices=at.prices,
            kappa=constants,
            centres=found.N,
            tau=-found.tau,
            arms=found.b,
        )
        held = checker.coupled_rejections_hold(graph, given)
        if held.all():
            return given
        constants = np.where(held, constants, found.constant - share * sizes)
    W[~held] = 0.0
    return given._replace(
        kappa=np.where(held, given.kappa, 0.0),
        centres=np.where(held[:, None, None], found.N, 0.0),
        tau=np.where(held, -found.tau, 0.0),
    )
